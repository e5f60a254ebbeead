"use strict";
// What every picture shares: colours, numbers, elements, canvases and the tooltip.

const COLOUR = {
  measured: "#16191d", before: "#9aa0a6", after: "#1f5fbf", error: "#c4372c",
  grid: "#e9ebee", axis: "#8b9198", text: "#3d4248", band: "#eef0f3",
};
const FONT = "11px system-ui, -apple-system, 'Segoe UI', Roboto, sans-serif";

function make(tag, attributes, ...children) {
  const node = document.createElement(tag);
  for (const [key, value] of Object.entries(attributes || {})) {
    if (key === "class") node.className = value;
    else if (key.startsWith("on")) node.addEventListener(key.slice(2), value);
    else if (value !== false && value !== null && value !== undefined) node.setAttribute(key, value === true ? "" : value);
  }
  node.append(...children.filter((child) => child !== null && child !== undefined));
  return node;
}

function numbers(values) {
  return Float64Array.from(values || [], (value) => (value === null ? NaN : value));
}

function say(value, digits = 4) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  if (size !== 0 && (size < 1e-4 || size >= 1e7)) return value.toExponential(digits - 1);
  const places = size === 0 ? 0 : Math.max(0, digits - 1 - Math.floor(Math.log10(size)));
  const text = value.toFixed(Math.min(places, 12));
  return text.includes(".") ? text.replace(/\.?0+$/, "") : text;
}

function withUnit(title, unit) {
  return unit && unit !== "-" && unit !== "1" ? `${title} [${unit}]` : title;
}

function extent(...arrays) {
  let low = Infinity, high = -Infinity;
  for (const values of arrays) {
    for (const value of values) {
      if (value < low) low = value;
      if (value > high && value !== Infinity) high = value;
    }
  }
  return low <= high && Number.isFinite(low) ? [low, high] : [0, 1];
}

function widened([low, high], share) {
  if (low === high) {
    const by = Math.abs(low) * 0.05 || 0.5;
    return [low - by, high + by];
  }
  const by = (high - low) * share;
  return [low - by, high + by];
}

function tickStep(low, high, count) {
  const raw = (high - low) / Math.max(count, 1);
  const power = 10 ** Math.floor(Math.log10(raw));
  return [1, 2, 2.5, 5, 10].map((factor) => factor * power).find((step) => step >= raw * 0.999) || raw;
}

function ticks(low, high, count) {
  if (!(high > low)) return [low];
  const step = tickStep(low, high, count), values = [];
  for (let i = Math.ceil(low / step - 1e-9); i * step <= high + step * 1e-9; i++) values.push(i * step);
  return values;
}

function logTicks(low, high) {
  const values = [];
  const from = Math.floor(Math.log10(low)), to = Math.ceil(Math.log10(high));
  const factors = to - from <= 2 ? [1, 2, 5] : [1];
  for (let power = from; power <= to; power++) {
    for (const factor of factors) {
      const value = factor * 10 ** power;
      if (value >= low * 0.999 && value <= high * 1.001) values.push(value);
    }
  }
  return values.length ? values : [low, high];
}

function tickText(value, low, high) {
  const step = Math.abs(high - low) / 6;
  if (value !== 0 && (Math.abs(value) >= 1e6 || step < 1e-5)) return value.toExponential(Math.abs(value) >= 1e6 ? 1 : 2);
  const places = step > 0 ? Math.max(0, Math.min(8, 1 - Math.floor(Math.log10(step)))) : 2;
  return String(Number(value.toFixed(places)));
}

// Buttons of which one is pressed: names and values of the options, the first value, and what to do on a choice.
function choiceButtons(options, selected, choose) {
  const buttons = Object.entries(options).map(([name, value]) => {
    const button = make("button", { type: "button", "aria-pressed": String(value === selected) }, name);
    button.addEventListener("click", () => {
      for (const each of buttons) each.setAttribute("aria-pressed", String(each === button));
      choose(value);
    });
    return button;
  });
  return make("span", { class: "choice" }, ...buttons);
}

// A canvas as wide as its host, sharp on screens and on paper.
function canvasIn(host, height, draw) {
  const canvas = make("canvas", {});
  host.append(canvas);
  let width = 0;
  const redraw = () => {
    const now = Math.floor(host.clientWidth);
    if (now < 40) return;
    width = now;
    const tall = typeof height === "function" ? height(width) : height;
    const ratio = Math.max(window.devicePixelRatio || 1, 2);
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(tall * ratio);
    const pen = canvas.getContext("2d");
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, tall);
    pen.font = FONT;
    draw(pen, width, tall);
  };
  new ResizeObserver(() => { if (Math.floor(host.clientWidth) !== width) redraw(); }).observe(host);
  redraw();
  return { canvas, redraw };
}

const tooltip = (() => {
  let node = null;
  return {
    show(event, lines) {
      if (!node) document.body.append((node = make("div", { class: "tooltip" })));
      node.replaceChildren(...lines.map(([text, colour]) => {
        const line = make("div", {}, text);
        if (colour) line.style.color = colour;
        return line;
      }));
      node.style.display = "block";
      const right = event.clientX + 16 + node.offsetWidth < window.innerWidth;
      node.style.left = `${right ? event.clientX + 14 : event.clientX - node.offsetWidth - 12}px`;
      node.style.top = `${Math.min(event.clientY + 14, window.innerHeight - node.offsetHeight - 6)}px`;
    },
    hide() { if (node) node.style.display = "none"; },
  };
})();

function mixed(stops, share) {
  const at = Math.max(0, Math.min(1, Number.isFinite(share) ? share : 0)) * (stops.length - 1);
  const i = Math.min(Math.floor(at), stops.length - 2), t = at - i;
  return stops[i].map((value, k) => Math.round(value + t * (stops[i + 1][k] - value)));
}
const HEIGHTS = [[43, 64, 124], [36, 108, 158], [44, 152, 155], [108, 190, 122], [191, 214, 88], [247, 226, 98]];
const DIVERGING = [[33, 82, 163], [120, 164, 214], [247, 247, 247], [228, 146, 124], [178, 42, 36]];
const AMBER = [[255, 255, 255], [253, 226, 176], [240, 164, 88]];
const BLUES = [[255, 255, 255], [205, 222, 243], [120, 164, 214]];
const css = (rgb, alpha = 1) => `rgba(${rgb[0]},${rgb[1]},${rgb[2]},${alpha})`;
const pale = (rgb, by = 0.55) => rgb.map((value) => Math.round(value + (255 - value) * by));
