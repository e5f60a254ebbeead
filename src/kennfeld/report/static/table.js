"use strict";
// One parameter: its picture, and a table whose cells show the value, the change, the deviation or the samples.

DRAW.parameter = (host, f) => {
  const counts = f.axes.map((axis) => axis.points.length);
  const planes = f.axes.slice(0, 2), further = f.axes.slice(2);
  const state = { slice: further.map((axis) => Math.floor(axis.points.length / 2)), mode: "after" };
  const redraws = [];
  const flat = (i, j) => {
    let at = i;
    [...(planes.length > 1 ? [j] : []), ...state.slice].forEach((k, d) => { at = at * counts[d + 1] + k; });
    return at;
  };
  const nx = counts[0], ny = planes.length > 1 ? counts[1] : 1;
  const plane = (values) => Array.from({ length: nx }, (_, i) => Array.from({ length: ny }, (_, j) => values[flat(i, j)]));
  const holes = (values) => (values ? plane(values).map((row) => row.map((value) => value === 0)) : null);
  const changed = JSON.stringify(f.before) !== JSON.stringify(f.after);
  const words = (i, j) => {
    const at = flat(i, j), before = f.before[at], after = f.after[at];
    const coordinates = f.axes.map((axis, d) => {
      const k = d === 0 ? i : d === 1 ? j : state.slice[d - 2];
      return [`${axis.title} ${say(axis.points[k], 6)} ${axis.unit}`];
    });
    const lines = [...coordinates, [`${changed ? "after" : "value"} ${say(after, 6)} ${f.unit}`, COLOUR.after]];
    if (changed) lines.push([`before ${say(before, 6)}, change ${say(after - before, 4)}`]);
    if (f.deviation) lines.push([deviationText(f.deviation[at])]);
    if (f.samples) lines.push([f.samples[at] ? `${f.samples[at]} training samples` : "no training data"]);
    if (f.bySmoothness && f.bySmoothness[at]) lines.push(["determined by smoothness alone"]);
    if (f.informed && !f.informed[at]) lines.push(["undetermined: start kept"]);
    if (f.locked[at]) lines.push(["locked"]);
    if (f.bound[at]) lines.push([f.bound[at] > 0 ? "at the upper bound" : "at the lower bound"]);
    return lines;
  };
  if (further.length) host.append(sliders(further, state, () => redraws.forEach((redraw) => redraw())));
  const row = make("div", { class: "row two pictures" });
  host.append(row);
  if (nx > 1 && ny > 1) {
    const left = make("div", {}), right = make("div", {});
    row.append(left, right);
    const surface = new Surface(left, {
      x: planes[0], y: planes[1], unit: f.unit, tip: words,
      before: changed ? plane(f.before) : null, after: plane(f.after), empty: holes(f.samples),
    });
    redraws.push(() => surface.set(changed ? plane(f.before) : null, plane(f.after), holes(f.samples)));
    const draw = () => { right.replaceChildren(); slices(right, f, planes, plane(f.before), plane(f.after), changed); };
    draw();
    redraws.push(draw);
  } else {
    row.classList.add("single");
    const picture = make("div", {});
    row.append(picture);
    const draw = () => { picture.replaceChildren(); curve(picture, f, nx > 1 ? 0 : 1, flat, words); };
    draw();
    redraws.push(draw);
  }
  const cells = make("div", { class: "scroll" });
  host.append(modes(f, state, changed, () => fill(cells, f, planes, nx, ny, flat, state, words)), cells, ...marks(f));
  redraws.push(() => fill(cells, f, planes, nx, ny, flat, state, words));
  fill(cells, f, planes, nx, ny, flat, state, words);
};

function deviationText(value) {
  if (value === null) return "standard deviation: not known";
  if (value === -1) return "standard deviation: not determined";
  return value === 0 ? "standard deviation 0: fixed by a limit" : `standard deviation ${say(value, 3)}`;
}

function sliders(further, state, changed) {
  return make("div", { class: "legend" }, ...further.map((axis, d) => {
    const text = make("output", {}), name = withUnit(axis.title, axis.unit);
    const showValue = () => { text.textContent = `${name} = ${say(axis.points[state.slice[d]], 6)}`; };
    const slider = make("input", { type: "range", min: 0, max: axis.points.length - 1, step: 1, "aria-label": name });
    slider.value = state.slice[d];
    slider.addEventListener("input", () => { state.slice[d] = Number(slider.value); showValue(); changed(); });
    showValue();
    return make("label", { class: "slider" }, slider, text);
  }));
}

// Lines over the longer axis, a line for each breakpoint of the other.
function slices(host, f, planes, before, after, changed) {
  const along = planes[0].points.length >= planes[1].points.length ? 0 : 1, across = 1 - along;
  const x = numbers(planes[along].points), lines = planes[across].points;
  const every = Math.max(1, Math.ceil(lines.length / 10));
  const get = (values, k) => numbers(along === 0 ? values.map((row) => row[k]) : values[k]);
  const chosen = lines.map((_, k) => k).filter((k) => k % every === 0 || k === lines.length - 1);
  const hue = (k) => css(mixed([[200, 120, 50], [196, 60, 80], [110, 60, 150], [31, 95, 191]], lines.length > 1 ? k / (lines.length - 1) : 0));
  const layers = [];
  if (changed) for (const k of chosen) layers.push({ type: "line", colour: "#c3c7cc", width: 0.9, x, y: get(before, k) });
  for (const k of chosen) layers.push({ type: "line", colour: hue(k), width: 1.4, dots: true, size: 1.7, x, y: get(after, k), at: k });
  const title = withUnit(planes[across].title, planes[across].unit);
  host.append(make("div", { class: "legend tight" }, make("span", {}, `${title}:`), ...chosen.map((k) => {
    const swatch = make("i", {});
    swatch.style.background = hue(k);
    return make("span", { class: "key" }, swatch, say(lines[k], 4));
  }), changed ? make("span", { class: "hint" }, "before in grey") : null));
  new Chart(host, {
    height: (width) => Math.max(240, Math.min(380, width * 0.68)), zoom: false, legend: false,
    x: { title: withUnit(planes[along].title, planes[along].unit), margin: 0.02 }, panes: [{ title: withUnit(f.name, f.unit), layers }],
    tip(value, frame, px, py) {
      const i = nearest(x, value);
      let best = 24, line = null;
      for (const layer of layers) {
        const distance = layer.at === undefined ? Infinity : Math.abs(frame.py(layer.y[i]) - py);
        if (distance < best) { best = distance; line = layer; }
      }
      return line && { x: x[i], lines: [[`${planes[along].title} ${say(x[i], 6)}`], [`${planes[across].title} ${say(lines[line.at], 6)}`],
        [`${say(line.y[i], 6)} ${f.unit}`, line.colour]] };
    },
  });
}

function curve(host, f, direction, flat, words) {
  const axis = f.axes[direction], x = numbers(axis.points), at = (k) => (direction === 0 ? flat(k, 0) : flat(0, k));
  const pick = (values) => axis.points.map((_, k) => values[at(k)]);
  const changed = JSON.stringify(f.before) !== JSON.stringify(f.after);
  const after = numbers(pick(f.after)), layers = [];
  if (f.deviation) {
    const spread = pick(f.deviation), by = spread.map((value) => (value !== null && value >= 0 ? 2 * value : NaN));
    const open = axis.points.filter((_, k) => spread[k] === -1);
    if (open.length) layers.push({ type: "upright", name: "not determined", colour: "#c98a1b", dash: [3, 3], at: open });
    layers.push({ type: "band", name: "± 2 standard deviations", colour: COLOUR.after, alpha: 0.15, x, y: after.map((v, k) => v + by[k]), y2: after.map((v, k) => v - by[k]) });
  }
  if (changed) layers.push({ type: "line", name: "before", colour: COLOUR.before, width: 1.4, dots: true, size: 2.2, x, y: numbers(pick(f.before)) });
  const hollow = f.samples ? pick(f.samples).map((count) => count === 0) : null;
  layers.push({ type: "line", name: changed ? "after" : "value", colour: COLOUR.after, width: 1.8, dots: true, size: 2.8, hollow, x, y: after });
  const panes = [{ title: withUnit(f.name, f.unit), share: 3, layers }];
  if (f.samples) {
    panes.push({ title: "samples", floor: true, zero: true, layers: [{ type: "stems", colour: "#aab4c0", width: 5, x, y: numbers(pick(f.samples)) }] });
  }
  new Chart(host, {
    height: 300, zoom: false, x: { title: withUnit(axis.title, axis.unit), margin: 0.03 }, panes,
    tip(value) { const k = nearest(x, value); return { x: x[k], lines: words(direction === 0 ? k : 0, direction === 0 ? 0 : k) }; },
  });
}

function modes(f, state, changed, redraw) {
  const options = { [changed ? "after" : "value"]: "after" };
  if (changed) Object.assign(options, { before: "before", change: "change", "relative change": "relative" });
  if (f.deviation) options["standard deviation"] = "deviation";
  if (f.samples) options["training samples"] = "samples";
  const choose = (mode) => { state.mode = mode; redraw(); };
  return make("div", { class: "legend choice-row" }, choiceButtons(options, state.mode, choose));
}

function fill(host, f, planes, nx, ny, flat, state, words) {
  const value = {
    after: (k) => f.after[k],
    before: (k) => f.before[k],
    change: (k) => f.after[k] - f.before[k],
    relative: (k) => (f.before[k] ? (100 * (f.after[k] - f.before[k])) / Math.abs(f.before[k]) : null),
    deviation: (k) => (f.deviation[k] === -1 ? Infinity : f.deviation[k]),
    samples: (k) => f.samples[k],
  }[state.mode];
  const all = [];
  for (let i = 0; i < nx; i++) for (let j = 0; j < ny; j++) all.push(value(flat(i, j)));
  const known = all.filter((v) => Number.isFinite(v));
  const [low, high] = extent(known), most = Math.max(...known.map(Math.abs), 0);
  const signed = state.mode === "change" || state.mode === "relative";
  const paint = (v) => {
    if (!Number.isFinite(v) || !(high > low || signed)) return null;
    if (signed) return most ? pale(mixed(DIVERGING, 0.5 + (0.5 * v) / most), 0.35) : null;
    if (state.mode === "deviation") return mixed(AMBER, high > 0 ? v / high : 0);
    if (state.mode === "samples") return mixed(BLUES, high > 0 ? v / high : 0);
    return pale(mixed(HEIGHTS, (v - low) / (high - low)), 0.62);
  };
  const places = state.mode === "samples" ? 0 : most > 0 ? Math.max(0, Math.min(8, 3 - Math.floor(Math.log10(most)))) : 0;
  const text = (v) => {
    if (!Number.isFinite(v)) return v === Infinity ? "∞" : "–";
    return most >= 1e7 || (most > 0 && most < 1e-5) ? v.toExponential(2) : v.toFixed(places);
  };
  const cell = (i, j) => {
    const k = flat(i, j), v = value(k), names = [];
    if (f.samples && f.samples[k] === 0) names.push("nodata");
    if (f.informed && !f.informed[k]) names.push("kept");
    if (f.bound[k]) names.push("bound");
    if (f.locked[k]) names.push("locked");
    const node = make("td", { class: names.join(" ") }, text(v));
    const colour = paint(v);
    if (colour) node.style.backgroundColor = css(colour);
    node.addEventListener("pointermove", (event) => tooltip.show(event, words(i, j)));
    node.addEventListener("pointerleave", () => tooltip.hide());
    return node;
  };
  // x runs across and y down, as calibration tools show a map
  const across = planes[0].points.map((point) => make("th", { scope: "col" }, say(point, 5)));
  const corner = planes.length > 1 ? `${withUnit(planes[1].title, planes[1].unit)} ↓  ${withUnit(planes[0].title, planes[0].unit)} →` : withUnit(planes[0].title, planes[0].unit);
  const rows = Array.from({ length: ny }, (_, j) => make("tr", {},
    make("th", { scope: "row" }, planes.length > 1 ? say(planes[1].points[j], 5) : withUnit(f.name, f.unit)),
    ...Array.from({ length: nx }, (_, i) => cell(i, j))));
  host.replaceChildren(make("table", { class: `grid${nx > 14 ? " dense" : ""}` },
    make("thead", {}, make("tr", {}, make("th", { class: "corner" }, corner), ...across)), make("tbody", {}, ...rows)));
}

// What the marks of the cells mean; only those that occur.
function marks(f) {
  const entry = (names, text) => make("span", {}, make("i", { class: `sample ${names}` }), text);
  const entries = [];
  if (f.samples && f.samples.includes(0)) entries.push(entry("nodata", "no training data"));
  if (f.informed && f.informed.includes(0)) entries.push(entry("nodata kept", "undetermined: start kept"));
  if (f.bound.some((side) => side !== 0)) entries.push(entry("bound", "at a bound"));
  if (f.locked.includes(1)) entries.push(entry("locked", "locked"));
  return entries.length ? [make("div", { class: "marks" }, ...entries)] : [];
}
