// The picture of a project: measured and calculated over time, or calculated over measured.

import { area, extent, line, type Pen, widened } from "../../drawing/canvas";
import { token } from "../../drawing/colours";
import { Picture } from "../../instruments/picture";
import type { PictureLines } from "../../replies";

const numbers = (values: (number | null)[]): number[] => values.map((value) => value ?? NaN);

export function Preview({ own, title }: { own: PictureLines; title: string }) {
  const [x, measured, now, start] = [own.x, own.measured, own.now, own.start].map(numbers) as [
    number[],
    number[],
    number[],
    number[],
  ];
  const draw = (pen: Pen, width: number, height: number) => {
    const box = { left: 52, right: width - 14, top: 10, bottom: height - 34 };
    if (own.timed) {
      const plot = area(pen, box, extent(x), widened(extent(measured, now, start), 0.04), { title: "time [s]" });
      plot.clip(() => {
        for (const [values, colour, size] of [
          [start, "before", 1.2],
          [measured, "ink", 1.6],
          [now, "model", 1.2],
        ] as const)
          line(pen, x.map(plot.x), values.map(plot.y), token(colour), size);
      });
    } else {
      const range = widened(extent(measured, now), 0.04);
      const plot = area(pen, box, range, range, { title: "measured" });
      plot.clip(() => {
        line(pen, range.map(plot.x), range.map(plot.y), token("ink"), 1);
        pen.fillStyle = token("model");
        measured.forEach((value, k) => pen.fillRect(plot.x(value) - 1, plot.y(now[k]!) - 1, 2, 2));
      });
    }
    pen.fillStyle = token("text");
    pen.textAlign = "left";
    pen.textBaseline = "top";
    pen.fillText(title, box.left + 6, box.top + 5);
  };
  return <Picture label={`Picture of ${title}`} draw={draw} of={[own]} />;
}
