// Position and drive over the last seconds, with the travel limits.

import { byId } from "./dom.js";
import { axis, canPlot, level, plotIn, steps } from "./plot.js";
import { firstFrom, roundUp } from "./rows.js";
import { colour } from "./theme.js";

const WINDOW_S = 12;
const AXIS_PX = 52; // the same for both plots, so that their times stand below each other

export class Scope {
  #rows;
  #limits = null;
  #zoomed = false;
  #position = null;
  #drive = null;
  #reach_rad = 1;

  constructor(rows) {
    this.#rows = rows;
    const button = byId("zoom");
    button.addEventListener("click", () => {
      this.#zoomed = !this.#zoomed;
      button.setAttribute("aria-pressed", String(this.#zoomed));
      this.draw();
    });
  }

  /** Set up both plots. Without uPlot nothing is drawn. */
  start() {
    if (!canPlot()) return;
    const times = { scales: { x: { time: false, range: () => this.#span() } }, cursor: { drag: { x: false, y: false }, sync: { key: "scope" } } };
    this.#position = plotIn(byId("plot-y"), {
      ...times,
      scales: { ...times.scales, y: { range: () => this.#reach() } },
      axes: [axis({ size: 8, values: (_, ticks) => ticks.map(() => "") }), axis({ size: AXIS_PX, label: "rad", labelSize: 16 })],
      series: [{}, { stroke: () => colour("--position"), width: 2, points: { show: false } }],
      hooks: { draw: [(plot) => this.#drawLimits(plot)] },
    }, [[], []]).plot;
    this.#drive = plotIn(byId("plot-u"), {
      ...times,
      scales: { ...times.scales, y: { range: () => this.#volts() } },
      axes: [axis({ size: 34, label: "time since the start of the run, s", labelSize: 16 }), axis({ size: AXIS_PX, label: "V", labelSize: 16 })],
      series: [{}, { stroke: () => colour("--drive"), fill: () => colour("--drive-fill"), width: 1.5, points: { show: false }, paths: steps() }],
    }, [[], []]).plot;
  }

  /** Take the travel limits and the largest drive of the run. */
  limits(limits) {
    this.#limits = limits;
  }

  /** Draw the newest rows. */
  draw() {
    if (!this.#position) return;
    const { t_s, y_rad, u_V } = this.#rows;
    const from = Math.max(0, firstFrom(t_s, this.#span()[0]) - 1);
    const times = t_s.slice(from);
    this.#grow(y_rad.slice(from));
    this.#position.setData([times, y_rad.slice(from)]);
    this.#drive.setData([times, u_V.slice(from)]);
  }

  #span() {
    const last = Math.max(this.#rows.last_s ?? 0, WINDOW_S);
    return [last - WINDOW_S, last];
  }

  // the zoomed scale grows at once and shrinks late, so that it does not breathe with the motion
  #grow(positions) {
    const size = positions.reduce((most, y) => Math.max(most, Math.abs(y ?? 0)), 0);
    const wanted = roundUp(Math.max(size * 1.05, 0.01));
    if (wanted > this.#reach_rad || wanted < this.#reach_rad / 2) this.#reach_rad = wanted;
  }

  #reach() {
    const outer = this.#limits?.hard_rad ?? this.#limits?.soft_rad;
    if (this.#zoomed || !outer) return [-this.#reach_rad, this.#reach_rad];
    const margin = 0.06 * (outer[1] - outer[0]);
    const seen = this.#reach_rad;
    return [Math.min(outer[0] - margin, seen > -outer[0] + margin ? -seen : 0), Math.max(outer[1] + margin, seen > outer[1] + margin ? seen : 0)];
  }

  #volts() {
    const most = this.#rows.u_V.reduce((size, u) => Math.max(size, Math.abs(u ?? 0)), 0);
    const size = roundUp(Math.max(most * 1.1, 0.2));
    return [-size, size];
  }

  #drawLimits(plot) {
    const soft = this.#limits?.soft_rad;
    const hard = this.#limits?.hard_rad;
    if (soft) for (const value of soft) level(plot, value, "soft", colour("--soft"), [6, 5]);
    if (hard) for (const value of hard) level(plot, value, "hard", colour("--hard"), []);
  }
}
