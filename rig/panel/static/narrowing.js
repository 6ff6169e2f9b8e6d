// The live estimate: each parameter with its 95 % interval, and how the interval has narrowed so far.

import { byId, element, setText } from "./dom.js";
import { colour, onTheme } from "./theme.js";
import { PARAMETERS, percent, withInterval } from "./words.js";

const WIDEST = 8; // newest half widths: wider intervals are cut off, else the newest would be too thin to see

export class Narrowing {
  #history = [];
  #parts = [];

  constructor() {
    for (const { key, symbol, name, unit } of PARAMETERS) {
      const [letter, index] = symbol.split("_");
      const title = element("h3", {}, letter, index ? element("sub", { textContent: index }) : null, element("small", { textContent: `${name}, ${unit}` }));
      const value = element("span", { className: "estimate-value", textContent: "–" });
      const share = element("span", { className: "share", textContent: "–" });
      const canvas = element("canvas", { ariaHidden: "true" });
      const numbers = element("p", { className: "numbers" }, value, share);
      byId("parameters").append(element("div", { className: "parameter", id: `estimate-${key}` }, title, numbers, canvas));
      this.#parts.push({ key, value, share, canvas });
      new ResizeObserver(() => this.draw()).observe(canvas);
    }
    onTheme(() => this.draw());
  }

  /** Forget the estimates: another run begins. */
  clear() {
    this.#history = [];
    this.#write();
  }

  /** Take an estimate: {t_s, tau_s: [value, half], K_rad_s_V: ..., fc_V: ..., remark}. */
  take(estimate) {
    const last = this.#history.at(-1);
    if (last && estimate.t_s <= last.t_s) return;
    this.#history.push(estimate);
    this.#write();
  }

  #write() {
    const last = this.#history.at(-1);
    for (const { key, value, share } of this.#parts) {
      setText(value, withInterval(last?.[key]));
      setText(share, last?.[key] ? percent(last[key]) : "–");
    }
    setText(byId("estimate-remark"), last?.remark ?? "");
    this.draw();
  }

  /** Draw each interval over time. */
  draw() {
    for (const part of this.#parts) this.#drawOne(part);
  }

  #drawOne({ key, canvas }) {
    const width = canvas.clientWidth;
    const height = canvas.clientHeight;
    if (width === 0) return;
    const ratio = devicePixelRatio;
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
    const ctx = canvas.getContext("2d");
    ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
    const points = this.#history.filter((estimate) => estimate[key] && Number.isFinite(estimate[key][1])).map((e) => ({ t: e.t_s, value: e[key][0], half: e[key][1] }));
    ctx.strokeStyle = colour("--grid");
    ctx.beginPath();
    ctx.moveTo(0, height / 2);
    ctx.lineTo(width, height / 2);
    ctx.stroke();
    if (points.length === 0) return;
    const last = points.at(-1);
    const widest = Math.max(...points.map((p) => Math.abs(p.value - last.value) + p.half));
    const reach = Math.max(Math.min(widest, WIDEST * last.half), 1e-12);
    const span = Math.max(last.t - points[0].t, 1e-9);
    const x = (t) => (points.length === 1 ? width - 4 : 4 + ((width - 8) * (t - points[0].t)) / span);
    const y = (v) => height / 2 - ((height / 2 - 3) * Math.max(-1.2, Math.min(1.2, (v - last.value) / reach)));
    ctx.fillStyle = colour("--estimate-fill");
    ctx.beginPath();
    points.forEach((p) => ctx.lineTo(x(p.t), y(p.value + p.half)));
    [...points].reverse().forEach((p) => ctx.lineTo(x(p.t), y(p.value - p.half)));
    ctx.closePath();
    ctx.fill();
    ctx.strokeStyle = colour("--estimate");
    ctx.lineWidth = 2;
    ctx.beginPath();
    points.forEach((p) => ctx.lineTo(x(p.t), y(p.value)));
    ctx.stroke();
    // the newest interval, also while it is the only one
    line(ctx, x(last.t), y(last.value + last.half), y(last.value - last.half));
  }
}

function line(ctx, x, y0, y1) {
  ctx.beginPath();
  ctx.moveTo(x, y0);
  ctx.lineTo(x, y1);
  ctx.stroke();
}
