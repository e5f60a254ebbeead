import { expect, test } from "vitest";
import type { Pen } from "../src/drawing/canvas";
import { SvgPen } from "../src/drawing/svg";

function drawn(draw: (pen: Pen) => void): string {
  const pen = new SvgPen(null, "#ccc");
  draw(pen as unknown as Pen);
  return pen.picture(100, 50, "#fff", "A & B");
}

test("a path becomes a path with its colour, width and dashes", () => {
  const svg = drawn((pen) => {
    pen.beginPath();
    pen.moveTo(1, 2);
    pen.lineTo(3.456, 4);
    pen.strokeStyle = "#123456";
    pen.lineWidth = 1.5;
    pen.setLineDash([3, 2]);
    pen.stroke();
  });
  expect(svg).toContain(
    '<path d="M1,2L3.46,4" fill="none" stroke="#123456" stroke-width="1.5" stroke-linejoin="round" stroke-dasharray="3 2"/>',
  );
});

test("texts are escaped, and stand where the canvas puts them", () => {
  const svg = drawn((pen) => {
    pen.font = "10px sans-serif";
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    pen.fillText("a < b", 20, 10);
  });
  expect(svg).toContain('x="20" y="13.5"');
  expect(svg).toContain('text-anchor="end"');
  expect(svg).toContain(">a &lt; b</text>");
  expect(svg).toContain("<title>A &amp; B</title>");
});

test("what is restored has its state back, and clips hold what lies within", () => {
  const svg = drawn((pen) => {
    pen.fillStyle = "red";
    pen.save();
    pen.beginPath();
    pen.rect(0, 0, 5, 5);
    pen.clip();
    pen.translate(2, 3);
    pen.fillStyle = "blue";
    pen.fillRect(0, 0, 9, 9);
    pen.restore();
    pen.fillRect(1, 1, 2, 2);
  });
  expect(svg).toContain(
    '<g clip-path="url(#clip1)"><rect x="0" y="0" width="9" height="9" fill="blue" transform="translate(2 3)"/></g>',
  );
  expect(svg).toContain('<rect x="1" y="1" width="2" height="2" fill="red"/>');
  expect(svg).toContain('<clipPath id="clip1"><path d="M0,0h5v5h-5Z"/></clipPath>');
});

test("a whole circle is two arcs, and a pattern the hatching", () => {
  const svg = drawn((pen) => {
    pen.beginPath();
    pen.arc(10, 10, 4, 0, 2 * Math.PI);
    pen.fillStyle = {} as CanvasPattern;
    pen.fill();
  });
  expect(svg).toContain('d="M14,10A4,4 0 0 1 6,10A4,4 0 0 1 14,10Z" fill="url(#hatch)"');
});
