// uPlot, if it is there: loading it, and what all plots of the page have in common.

import { element } from "./dom.js";
import { colour, onTheme } from "./theme.js";

let uPlot = null;
const plots = [];

/** Load uPlot. False if it is missing: then there are no curves, and all else works. */
export async function loadPlots() {
  try {
    uPlot = (await import("/static/vendor/uPlot.esm.js")).default;
  } catch {
    return false;
  }
  document.head.append(element("link", { rel: "stylesheet", href: "/static/vendor/uPlot.min.css" }));
  onTheme(() => plots.forEach((plot) => plot.redraw(false)));
  return true;
}

/** Whether curves can be drawn. */
export const canPlot = () => uPlot !== null;

/** Put the recordings of several runs on one axis of times. */
export const join = (tables) => uPlot.join(tables);

/** Steps, for a value that holds until the next row. */
export const steps = () => uPlot.paths.stepped({ align: 1 });

/** The font of a canvas: a share of the page's, which grows with the screen. */
export const font = (share = 0.8) => `${Math.round(share * parseFloat(getComputedStyle(document.documentElement).fontSize))}px system-ui, sans-serif`;

/** An axis in the page's colours. */
export function axis(options = {}) {
  return {
    stroke: () => colour("--muted"),
    font: font(),
    labelFont: font(),
    grid: { stroke: () => colour("--grid"), width: 1 },
    ticks: { stroke: () => colour("--grid"), width: 1, size: 4 },
    ...options,
  };
}

/** A plot that fills its box, now and after each change of the box. */
export function plotIn(box, options, data) {
  const size = () => ({ width: Math.max(80, box.clientWidth), height: Math.max(60, box.clientHeight) });
  const plot = new uPlot({ ...size(), legend: { show: false }, ...options }, data, box);
  const observer = new ResizeObserver(() => {
    if (box.clientWidth > 0) plot.setSize(size());
  });
  observer.observe(box);
  plots.push(plot);
  return {
    plot,
    remove() {
      observer.disconnect();
      plots.splice(plots.indexOf(plot), 1);
      plot.destroy();
    },
  };
}

/** Draw a level line over a plot, with its name at the right edge. */
export function level(plot, value, name, stroke, dash) {
  const { ctx, bbox } = plot;
  const y = plot.valToPos(value, "y", true);
  if (y < bbox.top - 1 || y > bbox.top + bbox.height + 1) return;
  const ratio = devicePixelRatio;
  ctx.save();
  ctx.strokeStyle = ctx.fillStyle = stroke;
  ctx.lineWidth = 1.5 * ratio;
  ctx.setLineDash(dash.map((length) => length * ratio));
  ctx.beginPath();
  ctx.moveTo(bbox.left, y);
  ctx.lineTo(bbox.left + bbox.width, y);
  ctx.stroke();
  if (name) {
    ctx.font = font(0.75 * ratio);
    ctx.textAlign = "right";
    ctx.textBaseline = value > 0 ? "top" : "bottom";
    ctx.fillText(name, bbox.left + bbox.width - 4 * ratio, y + (value > 0 ? 3 : -3) * ratio);
  }
  ctx.restore();
}
