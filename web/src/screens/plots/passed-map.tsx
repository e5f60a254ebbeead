// The grid points of a table with the weight of the brushed samples in each; a click lights up the samples of a point.

import { useEffect, useLayoutEffect, useRef } from "preact/hooks";
import { type Box, canvasIn, extent, type Pen } from "../../drawing/canvas";
import { css, height as heightColour, token } from "../../drawing/colours";
import { cellIn } from "../../drawing/grid";
import { hatch } from "../../drawing/marks";
import { plain, significant, withUnit } from "../../drawing/numbers";
import { tipOn } from "../../hover-tip";
import { cellTitle } from "../../instruments/map-table";
import { placeText } from "../../instruments/pictures";
import { brush } from "../../plots";
import type { EditedTable } from "../../replies";
import { selection, table, theme } from "../../store";

interface Passed {
  weights: Float32Array | undefined;
}

export function PassedMap(props: Passed) {
  if (table.value !== null && ![1, 2].includes(table.value.axes.length))
    return <p class="pad q">Curves and maps are shown here; choose one above.</p>;
  return <PassedPicture {...props} />;
}

function PassedPicture({ weights }: Passed) {
  const host = useRef<HTMLDivElement>(null);
  const redraw = useRef<() => void>(() => {});
  const latest = useRef(weights);
  latest.current = weights;
  useLayoutEffect(() => {
    const {
      canvas,
      redraw: again,
      close,
    } = canvasIn(host.current!, (pen, wide, high) => {
      if (table.value !== null) draw(pen, wide, high, table.value, latest.current);
    });
    redraw.current = again;
    canvas.style.cursor = "pointer";
    canvas.onclick = (event) => pick(canvas, event);
    const silence = tipOn(canvas, (x, y) => passedTip(canvas, latest.current, x, y));
    return () => {
      silence();
      close();
    };
  }, []);
  useEffect(() => redraw.current(), [weights, table.value, brush.value, theme.value]);
  return (
    <div
      class="body canvas"
      ref={host}
      aria-label="Grid points that brushed samples pass; click one to light up its samples"
    />
  );
}

const boxOf = (width: number, height: number): Box => ({ left: 44, right: width - 14, top: 8, bottom: height - 34 });
const counts = (own: EditedTable): [number, number] => [
  own.axes[0]?.points.length ?? 1,
  own.axes[1]?.points.length ?? 1,
];

const pointAt = (canvas: HTMLCanvasElement, own: EditedTable, x: number, y: number): [number, number] | null =>
  cellIn(boxOf(canvas.clientWidth, canvas.clientHeight), ...counts(own), x, y);

function passedTip(
  canvas: HTMLCanvasElement,
  weights: Float32Array | undefined,
  x: number,
  y: number,
): string[] | null {
  const own = table.value;
  const at = own === null ? null : pointAt(canvas, own, x, y);
  if (own === null || at === null) return null;
  const cell = at[0] * counts(own)[1] + at[1];
  const weight = weights ? [`weight of the brushed samples ${significant(weights[cell] ?? 0, 3)}`] : [];
  return [...cellTitle(own, cell).split("\n"), ...weight, placeText(own.axes, at)];
}

function pick(canvas: HTMLCanvasElement, event: MouseEvent): void {
  const own = table.value;
  if (own === null) return;
  const at = pointAt(canvas, own, event.offsetX, event.offsetY);
  if (at === null) return;
  const [[i, j], ny] = [at, counts(own)[1]];
  brush.value = { point: { parameter: own.name, value: i * ny + j } };
  selection.value = { x: [i, i], y: [j, j], active: [i, j] };
}

function draw(pen: Pen, width: number, height: number, own: EditedTable, weights: Float32Array | undefined): void {
  const box = boxOf(width, height);
  const [nx, ny] = counts(own);
  const [w, h] = [(box.right - box.left) / nx, (box.bottom - box.top) / ny];
  const [low, high] = extent(own.values);
  const most = weights ? Math.max(...weights, 1e-9) : 1;
  const chosen =
    brush.value !== null && "point" in brush.value && brush.value.point.parameter === own.name
      ? brush.value.point.value
      : -1;
  own.values.forEach((value, k) => {
    const [x, y] = [box.left + Math.floor(k / ny) * w, box.bottom - ((k % ny) + 1) * h];
    pen.fillStyle = css(heightColour(high > low ? (value - low) / (high - low) : 0.5), 0.4);
    pen.beginPath();
    pen.rect(x, y, w - 1, h - 1);
    pen.fill();
    if (own.samples?.[k] === 0) hatch(pen);
    const weight = weights?.[k] ?? 0;
    if (weight > 0) {
      pen.fillStyle = token("lit");
      pen.beginPath();
      pen.arc(x + w / 2, y + h / 2, 1.5 + (Math.min(w, h, 24) / 2 - 2) * Math.sqrt(weight / most), 0, 7);
      pen.fill();
    }
    if (k === chosen) {
      pen.strokeStyle = token("ink");
      pen.lineWidth = 1.5;
      pen.strokeRect(x, y, w - 1, h - 1);
    }
  });
  labels(pen, own, weights, box, w, h);
}

function labels(pen: Pen, own: EditedTable, weights: Float32Array | undefined, box: Box, w: number, h: number): void {
  const [xs, ys] = [own.axes[0]?.points ?? [], own.axes[1]?.points ?? []];
  pen.fillStyle = token("quiet");
  pen.textBaseline = "alphabetic";
  pen.textAlign = "right";
  pen.fillText(own.axes.map((axis) => withUnit(axis.input, axis.unit)).join(", "), box.right, box.bottom + 28);
  pen.textAlign = "left";
  if (weights)
    pen.fillText(`${weights.filter((weight) => weight > 0).length} of ${weights.length}`, box.left, box.bottom + 28);
  pen.textAlign = "right";
  pen.textBaseline = "middle";
  ys.forEach((value, j) => {
    if (j % Math.ceil(ys.length / 6) === 0) pen.fillText(plain(value, 3), box.left - 5, box.bottom - (j + 0.5) * h);
  });
  pen.textBaseline = "top";
  pen.textAlign = "center";
  xs.forEach((value, i) => {
    if (i % Math.ceil(xs.length / 5) === 0) pen.fillText(plain(value, 4), box.left + (i + 0.5) * w, box.bottom + 4);
  });
}
