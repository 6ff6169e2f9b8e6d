// The phase portrait of the relay: position over its integral z, on the planes where each relay switches. On a canvas
// of our own, so that it is there without uPlot too.

import { byId } from "./dom.js";
import { font } from "./plot.js";
import { firstFrom, roundUp } from "./rows.js";
import { colour, onTheme } from "./theme.js";
import { fixed } from "./words.js";

const TRAIL_S = 6;
const PIECES = 12; // the trail fades from piece to piece
const MARGIN = { left: 56, right: 14, top: 12, bottom: 34 };

export class Phase {
  #rows;
  #canvas = byId("phase");
  #planes = null;
  #reach = { z: 0.1, y: 0.5 };

  constructor(rows) {
    this.#rows = rows;
    new ResizeObserver(() => this.draw()).observe(this.#canvas);
    onTheme(() => this.draw());
  }

  /** Take the planes where the relays of this stage switch, and their gains; null where no relay drives. */
  planes(planes) {
    this.#planes = planes;
  }

  /** Draw the last seconds. */
  draw() {
    const canvas = this.#canvas;
    const width = canvas.clientWidth;
    const height = canvas.clientHeight;
    if (width === 0) return;
    const ratio = devicePixelRatio;
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
    }
    const ctx = canvas.getContext("2d");
    ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
    ctx.clearRect(0, 0, width, height);
    ctx.font = font();
    const { t_s, y_rad, z_rad_s } = this.#rows;
    const from = firstFrom(t_s, (this.#rows.last_s ?? 0) - TRAIL_S);
    this.#scale(z_rad_s, y_rad, from);
    const box = { x: MARGIN.left, y: MARGIN.top, w: width - MARGIN.left - MARGIN.right, h: height - MARGIN.top - MARGIN.bottom };
    const at = {
      x: (z) => box.x + box.w * (0.5 + z / this.#reach.z / 2),
      y: (y) => box.y + box.h * (0.5 - y / this.#reach.y / 2),
    };
    this.#drawGrid(ctx, box, at);
    this.#drawPlanes(ctx, box, at);
    this.#drawTrail(ctx, box, at, from);
  }

  #scale(zs, ys, from) {
    let z = 0;
    let y = 0;
    for (let k = from; k < zs.length; k++) {
      if (zs[k] === null) continue;
      z = Math.max(z, Math.abs(zs[k]));
      y = Math.max(y, Math.abs(ys[k]));
    }
    const wanted = { z: roundUp(Math.max(1.1 * z, 0.005)), y: roundUp(Math.max(1.1 * y, 0.02)) };
    for (const name of ["z", "y"]) {
      if (wanted[name] > this.#reach[name] || wanted[name] < this.#reach[name] / 2.5) this.#reach[name] = wanted[name];
    }
  }

  #drawGrid(ctx, box, at) {
    ctx.strokeStyle = colour("--grid");
    ctx.fillStyle = colour("--muted");
    ctx.lineWidth = 1;
    ctx.strokeRect(box.x, box.y, box.w, box.h);
    ctx.textAlign = "center";
    ctx.textBaseline = "top";
    for (const share of [-1, -0.5, 0, 0.5, 1]) {
      const z = share * this.#reach.z;
      line(ctx, at.x(z), box.y, at.x(z), box.y + box.h);
      if (share !== 0.5 && share !== -0.5) ctx.fillText(short(z), Math.min(at.x(z), box.x + box.w - 8), box.y + box.h + 4);
    }
    ctx.fillText("z, rad s", box.x + box.w * 0.75, box.y + box.h + 18);
    ctx.textAlign = "right";
    ctx.textBaseline = "middle";
    for (const share of [-1, -0.5, 0, 0.5, 1]) {
      const y = share * this.#reach.y;
      line(ctx, box.x, at.y(y), box.x + box.w, at.y(y));
      ctx.fillText(short(y), box.x - 5, Math.max(box.y + 5, Math.min(at.y(y), box.y + box.h - 5)));
    }
    ctx.save();
    ctx.translate(10, box.y + box.h * 0.375); // between two numbers
    ctx.rotate(-Math.PI / 2);
    ctx.textAlign = "center";
    ctx.fillText("y, rad", 0, 0);
    ctx.restore();
  }

  #drawPlanes(ctx, box, at) {
    const planes = this.#planes;
    if (!planes) return;
    ctx.save();
    ctx.beginPath();
    ctx.rect(box.x, box.y, box.w, box.h);
    ctx.clip();
    ctx.lineWidth = 1.6;
    ctx.setLineDash([7, 4]);
    ctx.strokeStyle = colour("--plane");
    for (const y of planes.y_rad ?? []) line(ctx, box.x, at.y(y), box.x + box.w, at.y(y));
    for (const z of planes.z_rad_s ?? []) line(ctx, at.x(z), box.y, at.x(z), box.y + box.h);
    ctx.restore();
    const { h1_V, h2_V } = planes;
    if (!Number.isFinite(h1_V) || !Number.isFinite(h2_V) || !planes.z_rad_s?.length) return;
    ctx.fillStyle = colour("--drive");
    ctx.textBaseline = "top";
    for (const [sy, sz] of [[1, 1], [1, -1], [-1, 1], [-1, -1]]) {
      ctx.textAlign = sz > 0 ? "right" : "left";
      const drive = `${fixed(-h1_V * sy - h2_V * sz, 2, { signed: true })} V`;
      ctx.fillText(drive, sz > 0 ? box.x + box.w - 6 : box.x + 6, sy > 0 ? box.y + 6 : box.y + box.h - 18);
    }
  }

  #drawTrail(ctx, box, at, from) {
    const { t_s, y_rad, z_rad_s } = this.#rows;
    const count = t_s.length - from;
    if (count < 2) return;
    ctx.save();
    ctx.beginPath();
    ctx.rect(box.x, box.y, box.w, box.h);
    ctx.clip();
    ctx.strokeStyle = colour("--position");
    ctx.lineWidth = 2;
    ctx.lineJoin = "round";
    for (let piece = 0; piece < PIECES; piece++) {
      ctx.globalAlpha = (piece + 1) / PIECES;
      ctx.beginPath();
      let pen = false;
      const last = from + Math.ceil((count * (piece + 1)) / PIECES);
      for (let k = from + Math.floor((count * piece) / PIECES); k <= Math.min(last, t_s.length - 1); k++) {
        if (z_rad_s[k] === null) pen = false;
        else if (pen) ctx.lineTo(at.x(z_rad_s[k]), at.y(y_rad[k]));
        else ctx.moveTo(at.x(z_rad_s[k]), at.y(y_rad[k]), (pen = true));
      }
      ctx.stroke();
    }
    ctx.globalAlpha = 1;
    if (z_rad_s.at(-1) !== null) {
      ctx.fillStyle = colour("--position");
      ctx.beginPath();
      ctx.arc(at.x(z_rad_s.at(-1)), at.y(y_rad.at(-1)), 5, 0, 2 * Math.PI);
      ctx.fill();
    }
    ctx.restore();
  }
}

const short = (value) => String(Number(value.toPrecision(2))).replace("-", "−");

function line(ctx, x0, y0, x1, y1) {
  ctx.beginPath();
  ctx.moveTo(x0, y0);
  ctx.lineTo(x1, y1);
  ctx.stroke();
}
