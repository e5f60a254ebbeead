// The whole dataset, small, with the stretch that the strips show; the stretch can be dragged.

import { useEffect, useLayoutEffect, useRef } from "preact/hooks";
import { canvasIn, extent, line, widened } from "../drawing/canvas";
import { token } from "../drawing/colours";
import { overview } from "../plot-data";
import { dataset, stretch, visible, zoom } from "../plots";
import { theme } from "../store";
import { LEFT, RIGHT } from "./strip-pointer";

export function Overview() {
  const host = useRef<HTMLDivElement>(null);
  const redraw = useRef<() => void>(() => {});
  useLayoutEffect(() => {
    const {
      canvas,
      redraw: again,
      close,
    } = canvasIn(host.current!, (pen, wide, high) => {
      const data = overview.value;
      const own = dataset.value;
      // a target may be missing
      const values = [...(data?.lines.values() ?? [])].find((each) => each.some(Number.isFinite));
      if (data === null || values === undefined || own === undefined) return;
      const x = (value: number) => LEFT + ((value - own.begin) / (own.end - own.begin)) * (wide - LEFT - RIGHT);
      const [low, most] = widened(extent(values), 0.08);
      line(
        pen,
        Float64Array.from(data.x, (value) => x(value + data.begin)),
        Float64Array.from(values, (value) => high - 4 - ((value - low) / (most - low)) * (high - 8)),
        token("before"),
        1,
      );
      const { begin, end } = visible.value;
      pen.fillStyle = token("accent");
      pen.globalAlpha = 0.14;
      pen.fillRect(x(begin), 1, x(end) - x(begin), high - 2);
      pen.globalAlpha = 1;
      pen.strokeStyle = token("accent");
      pen.strokeRect(x(begin) + 0.5, 1.5, x(end) - x(begin) - 1, high - 3);
      pen.fillStyle = token("accent");
      for (const at of [begin, end]) pen.fillRect(Math.round(x(at)) - 2, high / 2 - 6, 4, 12);
    });
    redraw.current = again;
    let grip: { kind: "begin" | "end" | "middle"; offset: number } | null = null;
    const position = (event: PointerEvent) => {
      const own = dataset.value!;
      const box = canvas.getBoundingClientRect();
      return own.begin + ((event.clientX - box.left - LEFT) / (box.width - LEFT - RIGHT)) * (own.end - own.begin);
    };
    const move = (event: PointerEvent) => {
      const own = dataset.value!;
      const { begin, end } = visible.value;
      const at = Math.max(own.begin, Math.min(own.end, position(event)));
      if (grip!.kind === "begin") stretch.value = at < end ? { begin: at, end } : stretch.value;
      else if (grip!.kind === "end") stretch.value = at > begin ? { begin, end: at } : stretch.value;
      else {
        const from = Math.max(own.begin, Math.min(own.end - (end - begin), position(event) - grip!.offset));
        stretch.value = { begin: from, end: from + end - begin };
      }
    };
    canvas.onpointerdown = (event) => {
      if (dataset.value === undefined) return;
      canvas.setPointerCapture(event.pointerId);
      const { begin, end } = visible.value;
      const at = position(event);
      const near = ((dataset.value.end - dataset.value.begin) * 6) / canvas.clientWidth;
      const kind = Math.abs(at - begin) < near ? "begin" : Math.abs(at - end) < near ? "end" : "middle";
      grip = { kind, offset: at >= begin && at <= end ? at - begin : (end - begin) / 2 };
      zoom(visible.value); // one step of the history for the whole drag
      if (kind === "middle") move(event);
    };
    canvas.onpointermove = (event) => {
      if (grip !== null) move(event);
    };
    canvas.onpointerup = () => {
      grip = null;
    };
    return close;
  }, []);
  useEffect(() => redraw.current(), [overview.value, visible.value, theme.value]);
  return <div class="canvas" ref={host} aria-label="Overview of the whole dataset; drag the stretch or its ends" />;
}
