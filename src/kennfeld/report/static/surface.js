"use strict";
// A surface over two axes that can be turned, before in grey and after in colour; plain 2D canvas, so it needs no WebGL.

class Surface {
  // spec: { x, y: {title, unit, points}, unit, before, after: [nx][ny], empty: [nx][ny] or null, tip(i, j) }
  constructor(host, spec) {
    this.spec = spec;
    this.turn = { azimuth: -0.62, elevation: 0.46 };
    this.show = { before: spec.before !== null, after: true };
    host.append(this.buttons());
    this.box = make("div", { class: "canvas surface" });
    host.append(this.box);
    const { canvas, redraw } = canvasIn(this.box, (width) => Math.max(260, Math.min(400, width * 0.72)), (pen, w, h) => this.draw(pen, w, h));
    canvas.tabIndex = 0;
    this.redraw = redraw;
    this.listen(canvas);
  }

  buttons() {
    const entry = (key, name, colour) => {
      const swatch = make("i", {});
      swatch.style.background = colour;
      const button = make("button", { type: "button", "aria-pressed": "true" }, swatch, name);
      button.addEventListener("click", () => {
        this.show[key] = !this.show[key];
        button.setAttribute("aria-pressed", String(this.show[key]));
        this.redraw();
      });
      return button;
    };
    const entries = this.spec.before === null ? [] : [entry("before", "before", COLOUR.before)];
    entries.push(entry("after", this.spec.before === null ? "value" : "after", css(HEIGHTS[2])));
    return make("div", { class: "legend" }, ...entries, make("span", { class: "hint" }, "drag to rotate, double-click to reset"));
  }

  set(before, after, empty) {
    Object.assign(this.spec, { before, after, empty });
    this.redraw();
  }

  project(x, y, z) {
    const { azimuth: a, elevation: e } = this.turn;
    const u = x * Math.cos(a) - y * Math.sin(a), v = x * Math.sin(a) + y * Math.cos(a);
    const depth = v * Math.cos(e) - z * Math.sin(e);
    const size = (1 / (1 + 0.16 * depth)) * this.scale;
    return [this.middle[0] + u * size, this.middle[1] - (z * Math.cos(e) + v * Math.sin(e)) * size, depth];
  }

  // The box as large as the picture allows, with room for the numbers around it.
  fit(width, height) {
    this.middle = [0, 0];
    this.scale = 1;
    const ends = [-1, 1], xs = [], ys = [];
    for (const a of ends) for (const b of ends) for (const c of [-0.58, 0.58]) {
      const [sx, sy] = this.project(a, b, c);
      xs.push(sx);
      ys.push(sy);
    }
    const [left, right] = extent(xs), [top, bottom] = extent(ys);
    this.scale = Math.min((width - 120) / (right - left), (height - 74) / (bottom - top));
    this.middle = [width / 2 - ((left + right) / 2) * this.scale, height / 2 - 10 - ((top + bottom) / 2) * this.scale];
  }

  draw(pen, width, height) {
    const { x, y, before, after } = this.spec;
    this.fit(width, height);
    const shown = [...(this.show.before && before ? before : []), ...(this.show.after ? after : [])].map((row) => Array.from(row));
    const reach = extent(...(shown.length ? shown : after.map((row) => Array.from(row))));
    const flat = !(reach[1] > reach[0]);
    const [low, high] = flat ? widened(reach, 0) : reach;
    this.low = low; this.high = high;
    const place = (points) => {
      const first = points[0], span = points[points.length - 1] - first || 1;
      return points.map((value) => ((value - first) / span) * 2 - 1);
    };
    const px = place(x.points), py = place(y.points), pz = (z) => ((z - low) / (high - low)) * 1.16 - 0.58;
    this.box3(pen, px, py, low, high, pz);
    const faces = [];
    if (this.show.before && before) this.faces(faces, px, py, before, pz, "before");
    if (this.show.after) this.faces(faces, px, py, after, pz, "after");
    faces.sort((a, b) => b.depth - a.depth);
    for (const face of faces) this.face(pen, face);
    this.points = after.map((row, i) => Array.from(row, (z, j) => this.project(px[i], py[j], pz(z))));
    if (this.at) {
      const [i, j] = this.at, [sx, sy] = this.points[i][j];
      pen.beginPath(); pen.arc(sx, sy, 4, 0, 7);
      pen.fillStyle = "#fff"; pen.fill(); pen.strokeStyle = COLOUR.measured; pen.lineWidth = 1.5; pen.stroke();
    }
  }

  faces(into, px, py, z, pz, which) {
    for (let i = 0; i + 1 < px.length; i++) {
      for (let j = 0; j + 1 < py.length; j++) {
        const corners = [[i, j], [i + 1, j], [i + 1, j + 1], [i, j + 1]];
        const heights = corners.map(([a, b]) => z[a][b]);
        if (!heights.every(Number.isFinite)) continue;
        const at = corners.map(([a, b], k) => this.project(px[a], py[b], pz(heights[k])));
        const mean = heights.reduce((sum, value) => sum + value, 0) / 4;
        const empty = which === "after" && this.spec.empty && corners.some(([a, b]) => this.spec.empty[a][b]);
        const slope = pz(heights[1]) - pz(heights[0]) + pz(heights[2]) - pz(heights[3]);
        into.push({ at, which, mean, empty, light: Math.tanh(slope * 1.2), depth: at.reduce((sum, p) => sum + p[2], 0) / 4 });
      }
    }
  }

  face(pen, face) {
    pen.beginPath();
    face.at.forEach(([x, y], k) => pen[k ? "lineTo" : "moveTo"](x, y));
    pen.closePath();
    if (face.which === "before") {
      pen.fillStyle = "rgba(150,156,163,0.16)";
      pen.strokeStyle = "rgba(105,111,118,0.6)";
    } else {
      let colour = mixed(HEIGHTS, (face.mean - this.low) / (this.high - this.low));
      colour = colour.map((value) => Math.max(0, Math.min(255, value * (1 + 0.1 * face.light))));
      pen.fillStyle = css(face.empty ? pale(colour, 0.6) : colour, 0.93);
      pen.strokeStyle = "rgba(20,30,45,0.38)";
    }
    pen.lineWidth = 0.6;
    pen.lineJoin = "round";
    pen.fill();
    if (face.empty) {
      const xs = face.at.map((p) => p[0]), ys = face.at.map((p) => p[1]);
      const [a, b] = [Math.min(...xs), Math.max(...xs)], [c, d] = [Math.min(...ys), Math.max(...ys)];
      pen.save();
      pen.clip();
      pen.beginPath();
      for (let k = a - (d - c); k < b; k += 5) { pen.moveTo(k, d); pen.lineTo(k + (d - c), c); }
      pen.strokeStyle = "rgba(60,66,72,0.45)";
      pen.stroke();
      pen.restore();
      pen.beginPath();
      face.at.forEach(([x, y], k) => pen[k ? "lineTo" : "moveTo"](x, y));
      pen.closePath();
    }
    pen.stroke();
  }

  // Floor, back walls and the numbers along the edges that face the viewer.
  box3(pen, px, py, low, high, pz) {
    const { x, y, unit } = this.spec;
    const floor = pz(low), roof = pz(high);
    const deep = (a, b) => this.project(a, b, floor)[2];
    const backX = deep(1, 0) > deep(-1, 0) ? 1 : -1, backY = deep(0, 1) > deep(0, -1) ? 1 : -1;
    const line = (...points) => {
      pen.beginPath();
      points.forEach((p, k) => { const [sx, sy] = this.project(...p); pen[k ? "lineTo" : "moveTo"](sx, sy); });
      pen.stroke();
    };
    pen.lineWidth = 1;
    const marks = (axis, pixels) => {
      const first = axis.points[0], span = axis.points[axis.points.length - 1] - first || 1;
      return ticks(first, first + span, pixels).map((value) => [value, ((value - first) / span) * 2 - 1]);
    };
    const xs = marks(x, 5), ys = marks(y, 5), zs = ticks(low, high, 4).map((value) => [value, pz(value)]);
    pen.strokeStyle = COLOUR.grid;
    for (const [, a] of xs) line([a, -backY, floor], [a, backY, floor], [a, backY, roof]);
    for (const [, b] of ys) line([-backX, b, floor], [backX, b, floor], [backX, b, roof]);
    for (const [, z] of zs) line([-backX, backY, z], [backX, backY, z], [backX, -backY, z]);
    pen.strokeStyle = COLOUR.axis;
    line([-backX, -backY, floor], [backX, -backY, floor]);
    line([-backX, -backY, floor], [-backX, backY, floor]);
    pen.fillStyle = COLOUR.text;
    const label = (text, at, away, far, title) => {
      const [ax, ay] = this.project(...at), [bx, by] = this.project(...away);
      const long = Math.hypot(ax - bx, ay - by) || 1, aside = (ax - bx) / long;
      pen.textAlign = !title || Math.abs(aside) < 0.25 ? "center" : aside > 0 ? "left" : "right";
      pen.fillText(text, ax + aside * far, ay + ((ay - by) / long) * far + 4);
    };
    for (const [value, a] of xs) label(say(value, 4), [a, -backY, floor], [a, 0, floor], 17);
    for (const [value, b] of ys) label(say(value, 4), [-backX, b, floor], [0, b, floor], 20);
    label(withUnit(x.title, x.unit), [0, -backY, floor], [0, 0, floor], 34, true);
    label(withUnit(y.title, y.unit), [-backX, 0, floor], [0, 0, floor], 40, true);
    // height is written along the upright edge at the side of the picture
    const sides = [[-backX, backY], [backX, -backY]];
    const left = this.project(...sides[0], floor)[0] < this.project(...sides[1], floor)[0] ? sides[0] : sides[1];
    pen.strokeStyle = COLOUR.axis;
    line([...left, floor], [...left, roof]);
    pen.textAlign = "right";
    for (const [value, z] of zs) {
      const [sx, sy] = this.project(...left, z);
      pen.fillText(tickText(value, low, high), sx - 6, sy + 4);
    }
    const [sx, sy] = this.project(...left, roof);
    if (unit && unit !== "-") pen.fillText(`[${unit}]`, sx - 4, sy - 12);
  }

  listen(canvas) {
    let from = null;
    canvas.addEventListener("pointerdown", (event) => {
      from = [event.clientX, event.clientY, this.turn.azimuth, this.turn.elevation];
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointerup", () => { from = null; });
    canvas.addEventListener("pointermove", (event) => {
      if (from) {
        this.turn.azimuth = from[2] + (event.clientX - from[0]) * 0.009;
        this.turn.elevation = Math.max(0, Math.min(1.5, from[3] + (event.clientY - from[1]) * 0.007));
        tooltip.hide();
        this.redraw();
        return;
      }
      this.point(event, canvas);
    });
    canvas.addEventListener("pointerleave", () => { tooltip.hide(); if (this.at) { this.at = null; this.redraw(); } });
    canvas.addEventListener("dblclick", () => { this.turn = { azimuth: -0.62, elevation: 0.46 }; this.redraw(); });
    canvas.addEventListener("keydown", (event) => {
      const by = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.08], ArrowDown: [0, 0.08] }[event.key];
      if (!by) return;
      event.preventDefault();
      this.turn.azimuth += by[0];
      this.turn.elevation = Math.max(0, Math.min(1.5, this.turn.elevation + by[1]));
      this.redraw();
    });
  }

  point(event, canvas) {
    const area = canvas.getBoundingClientRect();
    const x = event.clientX - area.left, y = event.clientY - area.top;
    let best = 18, nearest = null;
    this.points.forEach((row, i) => row.forEach(([sx, sy, depth], j) => {
      const distance = Math.hypot(sx - x, sy - y) + depth; // of two points at the same place, the one in front
      if (distance < best) { best = distance; nearest = [i, j]; }
    }));
    const changed = String(nearest) !== String(this.at || null);
    this.at = nearest;
    if (changed) this.redraw();
    if (nearest) tooltip.show(event, this.spec.tip(...nearest)); else tooltip.hide();
  }
}
