"use strict";
// Charts with axes: one or more panes over a common x axis, zoom by dragging, a crosshair, a legend that hides and shows.

class Chart {
  // spec: { height, x: {title, range}, panes: [{title, share, log, range, zero, layers}], nearest }
  // layer: { type, name, colour, x, y, ... }; types are drawn by the functions in LAYERS below
  constructor(host, spec) {
    this.spec = spec;
    this.hidden = new Set();
    this.zoom = null;
    for (const pane of spec.panes) for (const layer of pane.layers) if (layer.off) this.hidden.add(layer.name);
    this.legend(host);
    this.box = make("div", { class: "canvas" });
    host.append(this.box);
    const { canvas, redraw } = canvasIn(this.box, spec.height, (pen, width, height) => this.draw(pen, width, height));
    this.redraw = redraw;
    this.listen(canvas);
  }

  legend(host) {
    const named = new Map();
    for (const pane of this.spec.panes) {
      for (const layer of pane.layers) if (layer.name && !named.has(layer.name)) named.set(layer.name, layer);
    }
    if (named.size < 2 || this.spec.legend === false) return;
    const entries = [...named].map(([name, layer]) => {
      const swatch = make("i", {});
      swatch.style.background = layer.colour;
      const button = make("button", { type: "button", "aria-pressed": String(!this.hidden.has(name)) }, swatch, name);
      button.addEventListener("click", () => {
        if (!this.hidden.delete(name)) this.hidden.add(name);
        button.setAttribute("aria-pressed", String(!this.hidden.has(name)));
        this.redraw();
      });
      return button;
    });
    host.append(make("div", { class: "legend" }, ...entries));
  }

  visible(pane) {
    return pane.layers.filter((layer) => !this.hidden.has(layer.name));
  }

  xRange() {
    if (this.zoom) return this.zoom;
    if (this.spec.x.range) return this.spec.x.range;
    const all = this.spec.panes.flatMap((pane) => pane.layers.filter((layer) => layer.x).map((layer) => layer.x));
    return widened(extent(...all), this.spec.x.margin ?? 0);
  }

  yRange(pane, [from, to]) {
    if (pane.range) return pane.range;
    let low = Infinity, high = -Infinity;
    const take = (value) => {
      if (pane.log && !(value > 0)) return;
      if (value < low) low = value;
      if (value > high && Number.isFinite(value)) high = value;
    };
    for (const layer of this.visible(pane)) {
      if (layer.reach) layer.reach.forEach(take);
      for (const ys of [layer.y, layer.y2]) {
        if (ys && layer.x) for (let i = 0; i < ys.length; i++) if (layer.x[i] >= from && layer.x[i] <= to) take(ys[i]);
      }
    }
    if (!(low <= high)) return pane.log ? [0.1, 1] : [0, 1];
    if (pane.zero) { low = Math.min(low, 0); high = Math.max(high, 0); }
    if (pane.log) return low === high ? [low / 2, high * 2] : [low / 1.2, high * 1.2];
    const [a, b] = widened([low, high], 0.06);
    return pane.floor ? [0, b] : [a, b];
  }

  draw(pen, width, height) {
    const left = this.spec.left || 62, right = 12, bottom = this.spec.x.title === "" ? 22 : 38, top = 8, gap = 14;
    const x = this.xRange(), room = height - top - bottom - gap * (this.spec.panes.length - 1);
    const shares = this.spec.panes.reduce((sum, pane) => sum + (pane.share || 1), 0);
    this.frames = [];
    let at = top;
    for (const pane of this.spec.panes) {
      const tall = (room * (pane.share || 1)) / shares;
      const frame = { pane, left, top: at, width: width - left - right, height: tall, x, y: this.yRange(pane, x) };
      frame.px = (value) => left + ((value - x[0]) / (x[1] - x[0])) * frame.width;
      const [y0, y1] = pane.log ? frame.y.map(Math.log10) : frame.y;
      const flat = pane.log ? Math.log10 : (value) => value;
      frame.py = (value) => frame.top + frame.height - ((flat(value) - y0) / (y1 - y0)) * frame.height;
      this.frames.push(frame);
      at += tall + gap;
      this.drawPane(pen, frame, at > height - bottom);
    }
    if (this.spec.x.title) {
      pen.fillStyle = COLOUR.text;
      pen.textAlign = "center";
      pen.fillText(this.spec.x.title, left + (width - left - right) / 2, height - 5);
    }
  }

  drawPane(pen, frame, last) {
    const { pane, left, top, width, height, x, y } = frame;
    const xs = ticks(x[0], x[1], Math.max(3, width / 80)).filter((value) => !this.spec.x.whole || Number.isInteger(value));
    const ys = pane.log ? logTicks(y[0], y[1]) : ticks(y[0], y[1], Math.max(2, height / 32)).filter((value) => !pane.floor || Number.isInteger(value));
    pen.strokeStyle = COLOUR.grid;
    pen.lineWidth = 1;
    pen.beginPath();
    for (const value of xs) { pen.moveTo(frame.px(value), top); pen.lineTo(frame.px(value), top + height); }
    for (const value of ys) { pen.moveTo(left, frame.py(value)); pen.lineTo(left + width, frame.py(value)); }
    pen.stroke();
    pen.save();
    pen.beginPath();
    pen.rect(left, top, width, height);
    pen.clip();
    for (const layer of this.visible(pane)) LAYERS[layer.type](pen, layer, frame);
    pen.restore();
    pen.strokeStyle = COLOUR.axis;
    pen.strokeRect(left + 0.5, top + 0.5, width - 1, height - 1);
    pen.fillStyle = COLOUR.text;
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    for (const value of ys) pen.fillText(pane.log ? powerText(value) : pane.floor ? countText(value) : tickText(value, y[0], y[1]), left - 6, frame.py(value));
    pen.textBaseline = "alphabetic";
    pen.textAlign = "center";
    if (last) {
      for (const value of xs) pen.fillText(tickText(value, x[0], x[1]), frame.px(value), top + height + 15);
    }
    pen.save();
    pen.translate(12, top + height / 2);
    pen.rotate(-Math.PI / 2);
    pen.fillText(fitted(pen, pane.title, height + 20), 0, 0);
    pen.restore();
  }

  listen(canvas) {
    const mark = make("div", { class: "mark" }), cross = make("div", { class: "cross" });
    this.box.append(mark, cross);
    let from = null;
    const place = (event) => {
      const area = canvas.getBoundingClientRect();
      return [event.clientX - area.left, event.clientY - area.top];
    };
    const inside = (px) => {
      const frame = this.frames[0];
      const share = Math.max(0, Math.min(1, (px - frame.left) / frame.width));
      return frame.x[0] + share * (frame.x[1] - frame.x[0]);
    };
    const lay = (a, b) => {
      const first = this.frames[0], end = this.frames[this.frames.length - 1];
      const px = (value) => Math.max(first.left, Math.min(first.left + first.width, value));
      Object.assign(mark.style, {
        display: "block", left: `${Math.min(px(a), px(b))}px`, width: `${Math.abs(px(b) - px(a))}px`,
        top: `${first.top}px`, height: `${end.top + end.height - first.top}px`,
      });
    };
    canvas.addEventListener("pointerdown", (event) => {
      if (this.spec.zoom === false || event.button !== 0 || !this.frames) return;
      from = place(event)[0];
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (!this.frames) return;
      const [px, py] = place(event);
      if (from !== null && Math.abs(px - from) > 4) lay(from, px);
      this.point(event, px, py, cross);
    });
    canvas.addEventListener("pointerup", (event) => {
      const to = place(event)[0];
      mark.style.display = "none";
      if (from !== null && Math.abs(to - from) > 6) {
        const ends = [inside(from), inside(to)].sort((a, b) => a - b);
        if (ends[1] > ends[0]) { this.zoom = ends; this.redraw(); }
      }
      from = null;
    });
    canvas.addEventListener("pointerleave", () => { tooltip.hide(); cross.style.display = "none"; });
    canvas.addEventListener("dblclick", () => { this.zoom = null; this.redraw(); });
  }

  point(event, px, py, cross) {
    const frame = this.frames.find((f) => px >= f.left && px <= f.left + f.width && py >= f.top - 8 && py <= f.top + f.height + 8);
    if (!frame || !this.spec.tip) { tooltip.hide(); cross.style.display = "none"; return; }
    const value = frame.x[0] + ((px - frame.left) / frame.width) * (frame.x[1] - frame.x[0]);
    const tip = this.spec.tip(value, frame, px, py, (name) => !this.hidden.has(name));
    if (!tip) { tooltip.hide(); cross.style.display = "none"; return; }
    tooltip.show(event, tip.lines);
    if (tip.x === undefined) return;
    const end = this.frames[this.frames.length - 1];
    Object.assign(cross.style, {
      display: "block", left: `${frame.px(tip.x)}px`, top: `${this.frames[0].top}px`,
      height: `${end.top + end.height - this.frames[0].top}px`,
    });
  }
}

function powerText(value) {
  const power = Math.round(Math.log10(value)), digits = "⁰¹²³⁴⁵⁶⁷⁸⁹";
  if (Math.abs(power) < 5 || Math.abs(Math.log10(value) - power) > 1e-9) return say(value, 2);
  return `10${power < 0 ? "⁻" : ""}${[...String(Math.abs(power))].map((digit) => digits[Number(digit)]).join("")}`;
}

function countText(value) {
  if (value >= 1e7) return `${say(value / 1e6, 3)}M`;
  return value >= 1e4 ? `${say(value / 1e3, 4)}k` : say(value, 4);
}

function fitted(pen, text, room) {
  if (pen.measureText(text).width <= room) return text;
  let cut = text;
  while (cut.length > 3 && pen.measureText(`${cut}…`).width > room) cut = cut.slice(0, -1);
  return `${cut}…`;
}

const LAYERS = {
  line(pen, layer, frame) {
    pen.strokeStyle = layer.colour;
    pen.lineWidth = layer.width || 1.2;
    pen.lineJoin = "round";
    pen.setLineDash(layer.dash || []);
    pen.globalAlpha = layer.alpha ?? 1;
    pen.beginPath();
    let down = false;
    const breaks = layer.breaks ? new Set(layer.breaks) : null;
    for (let i = 0; i < layer.x.length; i++) {
      const value = layer.y[i];
      if (!Number.isFinite(value)) { down = false; continue; }
      const x = frame.px(layer.x[i]), y = frame.py(value);
      if (!down || (breaks && breaks.has(layer.x[i]))) pen.moveTo(x, y); else pen.lineTo(x, y);
      down = true;
      // a lone point between gaps is no line
      if (!Number.isFinite(layer.y[i - 1]) && !Number.isFinite(layer.y[i + 1])) pen.rect(x - 0.8, y - 0.8, 1.6, 1.6);
    }
    pen.stroke();
    pen.setLineDash([]);
    if (layer.dots) LAYERS.dots(pen, layer, frame);
    pen.globalAlpha = 1;
  },
  dots(pen, layer, frame) {
    pen.fillStyle = layer.colour;
    pen.strokeStyle = layer.colour;
    pen.globalAlpha = layer.alpha ?? 1;
    const size = layer.size || 2;
    for (let i = 0; i < layer.x.length; i++) {
      if (!Number.isFinite(layer.y[i])) continue;
      pen.beginPath();
      pen.arc(frame.px(layer.x[i]), frame.py(layer.y[i]), size, 0, 7);
      if (layer.hollow && layer.hollow[i]) {
        pen.save(); pen.fillStyle = "#fff"; pen.fill(); pen.restore();
        pen.lineWidth = 1.2; pen.stroke();
      } else pen.fill();
    }
    pen.globalAlpha = 1;
  },
  band(pen, layer, frame) {
    pen.fillStyle = layer.colour;
    pen.globalAlpha = layer.alpha ?? 0.18;
    const known = (i) => Number.isFinite(layer.y[i]) && Number.isFinite(layer.y2[i]);
    for (let first = 0; first < layer.x.length; first++) {
      if (!known(first)) continue;
      let last = first;
      while (last + 1 < layer.x.length && known(last + 1)) last++;
      pen.beginPath();
      for (let i = first; i <= last; i++) pen[i > first ? "lineTo" : "moveTo"](frame.px(layer.x[i]), frame.py(layer.y[i]));
      for (let i = last; i >= first; i--) pen.lineTo(frame.px(layer.x[i]), frame.py(layer.y2[i]));
      pen.fill();
      first = last;
    }
    pen.globalAlpha = 1;
  },
  stems(pen, layer, frame) {
    pen.strokeStyle = layer.colour;
    pen.lineWidth = layer.width || 2;
    pen.beginPath();
    for (let i = 0; i < layer.x.length; i++) {
      if (!Number.isFinite(layer.y[i])) continue;
      pen.moveTo(frame.px(layer.x[i]), frame.py(0));
      pen.lineTo(frame.px(layer.x[i]), frame.py(layer.y[i]));
    }
    pen.stroke();
  },
  bars(pen, layer, frame) {
    const [low, high] = layer.ends, wide = (high - low) / layer.counts.length;
    pen.fillStyle = layer.colour;
    pen.globalAlpha = layer.alpha ?? 0.85;
    layer.counts.forEach((count, i) => {
      const a = frame.px(low + i * wide), b = frame.px(low + (i + 1) * wide), y = frame.py(count);
      pen.fillRect(a, y, Math.max(b - a - 0.5, 0.7), frame.py(0) - y);
    });
    pen.globalAlpha = 1;
  },
  level(pen, layer, frame) {
    pen.strokeStyle = layer.colour;
    pen.lineWidth = layer.width || 1;
    pen.setLineDash(layer.dash || []);
    pen.beginPath();
    for (const value of layer.at) { pen.moveTo(frame.left, frame.py(value)); pen.lineTo(frame.left + frame.width, frame.py(value)); }
    pen.stroke();
    pen.setLineDash([]);
  },
  upright(pen, layer, frame) {
    pen.strokeStyle = layer.colour;
    pen.lineWidth = 1;
    pen.setLineDash(layer.dash || []);
    pen.beginPath();
    for (const value of layer.at) { pen.moveTo(frame.px(value), frame.top); pen.lineTo(frame.px(value), frame.top + frame.height); }
    pen.stroke();
    pen.setLineDash([]);
  },
  diagonal(pen, layer, frame) {
    pen.strokeStyle = layer.colour;
    pen.lineWidth = 1;
    pen.beginPath();
    pen.moveTo(frame.px(frame.x[0]), frame.py(frame.x[0]));
    pen.lineTo(frame.px(frame.x[1]), frame.py(frame.x[1]));
    pen.stroke();
  },
};

function nearest(x, value) {
  let low = 0, high = x.length - 1;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (x[middle] < value) low = middle + 1; else high = middle;
  }
  return low > 0 && value - x[low - 1] < x[low] - value ? low - 1 : low;
}

// The layer and the index of the point nearest to a pixel, null if all are further away than `reach` pixels.
function nearestPoint(layers, frame, px, py, reach) {
  let best = reach, point = null;
  for (const layer of layers) {
    for (let i = 0; i < layer.x.length; i++) {
      const distance = Math.hypot(frame.px(layer.x[i]) - px, frame.py(layer.y[i]) - py);
      if (distance < best) { best = distance; point = [layer, i]; }
    }
  }
  return point;
}

// The pictures by kind

const DRAW = {
  strip(host, f) {
    const x = numbers(f.x), breaks = f.pieces;
    const trace = (name) => numbers(f[name]);
    const steady = !f.time && f.whole;
    const lay = (name, label, colour, more) =>
      ({ type: "line", name: label, colour, x, y: trace(name), width: f.whole ? 1.1 : 0.9, breaks, dots: f.whole && x.length <= 200, size: 1.8, ...more });
    const pieces = { type: "upright", colour: "#c9ced4", at: f.pieces, dash: [3, 3] };
    const same = JSON.stringify(f.before) === JSON.stringify(f.after);
    const panes = [
      { title: withUnit("value", f.unit), share: 1.7, layers: [pieces,
        ...(same ? [] : [lay("before", "model before", COLOUR.before, { off: true })]),
        lay("measured", "measured", COLOUR.measured, { width: f.whole ? 2 : 1.3 }),
        lay("after", same ? "model" : "model after", COLOUR.after, { alpha: steady ? 0.85 : 0.9 })] },
      { title: withUnit("error", f.unit), share: 1, zero: true, layers: [pieces,
        { type: "level", colour: COLOUR.axis, at: [0] },
        ...(same ? [] : [lay("errorBefore", "error before", "#d8a9a4", { off: true })]),
        lay("error", same ? "error" : "error after", COLOUR.error)] },
    ];
    const named = panes.flatMap((pane) => pane.layers).filter((layer) => layer.y);
    new Chart(host, {
      height: 340, x: { title: withUnit(f.xTitle, f.xUnit) }, panes,
      tip(value, frame, px, py, shown) {
        if (!x.length) return null;
        let i = nearest(x, value);
        if (f.whole) return { x: x[i], lines: [[`${f.xTitle} ${say(x[i], 7)} ${f.xUnit}`], ...named.filter((l) => shown(l.name))
          .map((l) => [`${l.name} ${say(l.y[i], 5)}`, l.colour])] };
        i -= i % 2;
        return { x: x[i], lines: [[`from ${say(x[i], 7)} ${f.xUnit}`], ...named.filter((l) => shown(l.name))
          .map((l) => [`${l.name} ${say(l.y[i], 4)} to ${say(l.y[i + 1], 4)}`, l.colour])] };
      },
    });
  },

  scatter(host, f) {
    const measured = numbers(f.measured), before = numbers(f.before), after = numbers(f.after);
    const same = JSON.stringify(f.before) === JSON.stringify(f.after);
    const layers = [{ type: "diagonal", colour: COLOUR.axis }];
    const size = measured.length > 800 ? 1.5 : 2.2;
    if (!same) layers.push({ type: "dots", name: "before", colour: COLOUR.before, x: measured, y: before, size, alpha: 0.65 });
    layers.push({ type: "dots", name: same ? "model" : "after", colour: COLOUR.after, x: measured, y: after, size, alpha: 0.7 });
    const both = widened(extent(measured, after), 0.04);
    new Chart(host, {
      height: 300, zoom: false, x: { title: withUnit("measured", f.unit), range: both },
      panes: [{ title: withUnit("calculated", f.unit), layers, range: widened(extent(measured, after, same ? after : before), 0.04) }],
      tip(value, frame, px, py, shown) {
        const point = nearestPoint(layers.filter((layer) => layer.y && shown(layer.name)), frame, px, py, 14);
        if (!point) return null;
        const [layer, i] = point;
        return { lines: [[`sample ${f.number[i]}`], [`measured ${say(layer.x[i], 5)}`], [`${layer.name} ${say(layer.y[i], 5)}`, layer.colour],
          [`error ${say(layer.y[i] - layer.x[i], 4)}`, COLOUR.error]] };
      },
    });
  },

  histograms(host, f) {
    const title = withUnit("error", f.unit);
    const same = JSON.stringify(f.own.before) === JSON.stringify(f.own.after);
    const bars = (part, name, colour, alpha) =>
      ({ type: "bars", name, colour, alpha, ...part, x: numbers(part.ends), reach: [0, Math.max(...part.counts)] });
    const zero = { type: "upright", colour: COLOUR.axis, at: [0], dash: [2, 2] };
    const beyond = (part) => (part.beyond ? `, ${part.beyond} beyond the ends` : "");
    const tip = (parts) => (value) => {
      const lines = parts.filter(([, p]) => value >= p.ends[0] && value <= p.ends[1]).map(([name, p, colour]) => {
        const wide = (p.ends[1] - p.ends[0]) / p.counts.length;
        const i = Math.min(p.counts.length - 1, Math.floor((value - p.ends[0]) / wide));
        return [`${name}: ${p.counts[i]} from ${say(p.ends[0] + i * wide, 3)} to ${say(p.ends[0] + (i + 1) * wide, 3)}`, colour];
      });
      return lines.length ? { lines } : null;
    };
    const grid = make("div", { class: "three" });
    host.append(grid);
    const add = (heading, panes, parts) => {
      const cell = make("div", { class: same ? "wide" : "" }, make("div", { class: "heading" }, heading));
      grid.append(cell);
      new Chart(cell, { height: 146, left: 54, zoom: false, legend: false, x: { title: parts.length > 1 ? title : "" }, panes, tip: tip(parts) });
    };
    const pane = (...layers) => [{ title: "samples", floor: true, zero: true, layers: [...layers, zero] }];
    const { before, after } = f.own, b = COLOUR.before, a = COLOUR.after;
    if (same) { add(title + beyond(after), pane(bars(after, "error", a)), [["error", after, a], ["error", after, a]]); return; }
    add(`before${beyond(before)}`, pane(bars(before, "before", b)), [["before", before, b]]);
    add(`after${beyond(after)}`, pane(bars(after, "after", a)), [["after", after, a]]);
    add("both on one axis", pane(bars(f.equal.after, "after", a, 0.75), bars(f.equal.before, "before", b, 0.8)),
      [["before", f.equal.before, b], ["after", f.equal.after, a]]);
    grid.lastChild.classList.add("wide");
  },

  autocorrelation(host, f) {
    const x = numbers(f.lags), y = numbers(f.values);
    new Chart(host, {
      height: 190, x: { title: f.unit === "s" ? "later by [s]" : "later by [samples]" },
      panes: [{ title: "correlation", range: [Math.min(-0.15, Math.min(...y) * 1.1), 1.05], layers: [
        { type: "band", colour: "#b9c0c8", alpha: 0.45, x: numbers([x[0], x[x.length - 1]]), y: [f.band, f.band], y2: [-f.band, -f.band] },
        { type: "level", colour: COLOUR.axis, at: [0] },
        { type: "line", colour: COLOUR.error, width: 1.4, x, y }] }],
      tip(value) { const i = nearest(x, value); return { x: x[i], lines: [[`${say(x[i], 5)} ${f.unit} later`], [`correlation ${say(y[i], 3)}`, COLOUR.error]] }; },
    });
  },

  convergence(host, f) {
    const hues = { plain: "#16191d", exact: COLOUR.after };
    let smooth = 0;
    const starts = new Set(f.stages.map((s) => s.start)).size > 1;
    const layers = f.stages.map((stage) => {
      const key = stage.name.split(" ")[0];
      const colour = hues[stage.name] || hues[key] || css(mixed([[236, 170, 90], [196, 90, 60], [140, 60, 120]], (smooth++ % 8) / 7));
      const name = starts ? `${stage.name}, start ${stage.start}` : stage.name;
      return { type: "line", name, colour, width: 1.4, dots: true, size: 1.8, x: numbers(stage.x), y: numbers(stage.cost), rmse: stage.rmse };
    });
    if (f.before > 0) layers.unshift({ type: "level", name: "before", colour: COLOUR.before, dash: [4, 3], at: [f.before], reach: [f.before] });
    new Chart(host, {
      height: 280, legend: layers.length <= 24, x: { title: "accepted step", margin: 0.02, whole: true }, panes: [{ title: "cost", log: true, layers }],
      tip(value, frame, px, py, shown) {
        const point = nearestPoint(layers.filter((layer) => layer.x && shown(layer.name)), frame, px, py, 16);
        if (!point) return null;
        const [layer, i] = point;
        return { lines: [[layer.name, layer.colour], [`step ${layer.x[i]}`], [`cost ${say(layer.y[i], 6)}`], [`RMSE ${say(layer.rmse[i], 4)}`]] };
      },
    });
  },

  cells(host, f) {
    const uses = Object.keys(f.uses), modes = { "mean error": "mean", RMSE: "rmse", samples: "samples" };
    const state = { use: uses[0], mode: "mean" };
    const choice = (key, options) => choiceButtons(options, state[key], (value) => { state[key] = value; redraw(); });
    host.append(make("div", { class: "legend" }, choice("mode", modes),
      uses.length > 1 ? choice("use", Object.fromEntries(uses.map((use) => [use, use]))) : null));
    const box = make("div", { class: "canvas" });
    host.append(box);
    const flat = f.axes.length === 1;
    const xs = f.axes[0].points, ys = flat ? [0, 1] : f.axes[1].points;
    const rows = (values) => (flat ? values.map((value) => [value]) : values);
    const left = flat ? 16 : 62, right = 74, top = 6, bottom = 38;
    let shape = null;
    const { canvas, redraw } = canvasIn(box, flat ? 130 : 250, (pen, width, height) => {
      const values = rows(f.uses[state.use][state.mode]);
      const wide = width - left - right, tall = height - top - bottom;
      // cells are drawn of equal size: breakpoints that lie close together stay readable
      const nx = values.length, ny = values[0].length;
      shape = { nx, ny, wide, tall };
      const known = values.flat().filter((value) => value !== null);
      const most = Math.max(...known.map(Math.abs), 1e-300);
      const paint = { mean: (v) => css(mixed(DIVERGING, 0.5 + (0.5 * v) / most)), rmse: (v) => css(mixed(AMBER, v / most)), samples: (v) => css(mixed(BLUES, v / most)) }[state.mode];
      for (let i = 0; i < nx; i++) {
        for (let j = 0; j < ny; j++) {
          const value = values[i][j], empty = f.uses[state.use].samples[i] === 0 || (!flat && f.uses[state.use].samples[i][j] === 0);
          const a = left + (i / nx) * wide, b = top + (1 - (j + 1) / ny) * tall;
          if (empty) hatch(pen, a, b, wide / nx, tall / ny);
          else { pen.fillStyle = paint(value); pen.fillRect(a, b, wide / nx - 0.5, tall / ny - 0.5); }
        }
      }
      pen.strokeStyle = COLOUR.axis;
      pen.strokeRect(left, top, wide, tall);
      pen.fillStyle = COLOUR.text;
      pen.textAlign = "center";
      edges(xs, nx, Math.floor(wide / 46)).forEach((i) => pen.fillText(say(xs[i], 4), left + (i / nx) * wide, top + tall + 14));
      pen.fillText(withUnit(f.axes[0].title, f.axes[0].unit), left + wide / 2, height - 5);
      if (!flat) {
        pen.textAlign = "right";
        edges(ys, ny, Math.floor(tall / 18)).forEach((j) => pen.fillText(say(ys[j], 4), left - 5, top + (1 - j / ny) * tall + 4));
        pen.save(); pen.translate(12, top + tall / 2); pen.rotate(-Math.PI / 2); pen.textAlign = "center";
        pen.fillText(fitted(pen, withUnit(f.axes[1].title, f.axes[1].unit), tall), 0, 0); pen.restore();
      }
      scale(pen, width - right + 12, top, tall, most, state.mode === "mean", paint);
    });
    canvas.addEventListener("pointermove", (event) => {
      const area = canvas.getBoundingClientRect();
      const i = Math.floor(((event.clientX - area.left - left) / shape.wide) * shape.nx);
      const j = Math.floor((1 - (event.clientY - area.top - top) / shape.tall) * shape.ny);
      if (i < 0 || j < 0 || i >= shape.nx || j >= shape.ny) { tooltip.hide(); return; }
      const of = f.uses[state.use], get = (name) => rows(of[name])[i][j];
      const span = (axis, k) => `${axis.title} ${say(axis.points[k], 5)}${axis.points.length > 1 ? ` to ${say(axis.points[k + 1], 5)}` : ""} ${axis.unit}`;
      tooltip.show(event, [[span(f.axes[0], i)], ...(flat ? [] : [[span(f.axes[1], j)]]), [`mean error ${say(get("mean"), 4)} ${f.unit}`, COLOUR.error],
        [`RMSE ${say(get("rmse"), 4)} ${f.unit}`], [`${get("samples")} samples, ${state.use}`]]);
    });
    canvas.addEventListener("pointerleave", () => tooltip.hide());
  },
};

function edges(points, count, most) {
  const all = Array.from({ length: Math.min(points.length, count + 1) }, (_, i) => i);
  const every = Math.max(1, Math.ceil(all.length / Math.max(most, 2)));
  return all.filter((i) => i % every === 0);
}

function scale(pen, x, y, tall, most, signed, paint) {
  const steps = 40, low = signed ? -most : 0;
  for (let i = 0; i < steps; i++) {
    pen.fillStyle = paint(low + ((i + 0.5) / steps) * (most - low));
    pen.fillRect(x, y + tall - ((i + 1) / steps) * tall, 10, tall / steps + 0.6);
  }
  pen.strokeStyle = COLOUR.axis;
  pen.strokeRect(x, y, 10, tall);
  pen.fillStyle = COLOUR.text;
  pen.textAlign = "left";
  pen.fillText(say(most, 3), x + 15, y + 8);
  pen.fillText(say(low, 3), x + 15, y + tall);
  if (signed) pen.fillText("0", x + 15, y + tall / 2 + 4);
}

function hatch(pen, x, y, wide, tall) {
  pen.save();
  pen.beginPath();
  pen.rect(x, y, wide - 0.5, tall - 0.5);
  pen.clip();
  pen.fillStyle = "#f6f7f8";
  pen.fillRect(x, y, wide, tall);
  pen.strokeStyle = "#c6cbd1";
  pen.lineWidth = 0.8;
  pen.beginPath();
  for (let k = -tall; k < wide; k += 5) { pen.moveTo(x + k, y + tall); pen.lineTo(x + k + tall, y); }
  pen.stroke();
  pen.restore();
}
