// Past runs: the list, two or more laid over each other from their first switch, and a run's report.

import { ASIDE, ENTER_TICKS, ask, byId, element, setText, show } from "./dom.js";
import { axis, canPlot, join, plotIn } from "./plot.js";
import { colour } from "./theme.js";
import { PARAMETERS, fixed, moment, withInterval } from "./words.js";

const SETTLED_MS = 400; // somebody ticks several runs, one after the other
const QUESTIONS = [
  ["measurably", "Do they differ by more than their noise explains?"],
  ["beyond_scatter", "Do they differ by more than one motor does from run to run?"],
];

const MOST = 6;
const COLOURS = ["--run-1", "--run-2", "--run-3", "--run-4", "--run-5", "--run-6"];
const VERDICTS = { ok: "ok", doubtful: "doubtful", refused: "refused", failed: "failed" };

export class Runs {
  #runs = [];
  #ticked = []; // names, in the order of ticking: the order of the colours
  #read = new Map(); // name -> the run's series and numbers
  #drawn = null;
  #compared = 0;

  constructor() {
    byId("reload").addEventListener("click", () => this.reload());
    byId("find").addEventListener("input", () => this.#list());
  }

  /** Read the list of runs anew. */
  async reload() {
    const note = byId("runs-note");
    try {
      this.#runs = (await ask("/api/runs")).runs;
      show(note, this.#runs.length === 0);
      setText(note, "No run in this folder yet.");
      this.#ticked = this.#ticked.filter((name) => this.#runs.some((run) => run.name === name));
      this.#list();
    } catch (error) {
      setText(note, error.message);
      show(note, true);
    }
  }

  /** Show a run's report in its sandbox. */
  report(name) {
    setText(byId("report-title"), `Report of ${name}`);
    byId("report").src = `/runs/${encodeURIComponent(name)}/report.html`;
  }

  #list() {
    const wanted = byId("find").value.trim().toLowerCase();
    const head = element("tr", {}, ...["", "Run", "When", "Verdict", ...PARAMETERS.map((p) => `${p.symbol}, ${p.unit}`), "Lasts", ""].map((text) => element("th", { textContent: text, scope: "col" })));
    const rows = this.#runs.filter((run) => `${run.name} ${run.verdict ?? ""} ${run.fault ?? ""}`.toLowerCase().includes(wanted)).map((run) => this.#row(run));
    byId("runs-table").replaceChildren(element("thead", {}, head), element("tbody", {}, ...rows));
  }

  #row(run) {
    const tick = element("input", { type: "checkbox", title: ENTER_TICKS, checked: this.#ticked.includes(run.name), ariaLabel: `Lay ${run.name} over others` });
    tick.addEventListener("change", () => this.#tick(run.name, tick));
    const verdict = (run.rehearsal ? "rehearsal: " : "") + (run.fault ?? VERDICTS[run.verdict] ?? "–");
    const kind = run.rehearsal ? "plain" : run.fault || run.verdict === "failed" ? "bad" : run.verdict === "ok" ? "good" : "plain";
    const open = run.report ? element("a", { href: `#report/${encodeURIComponent(run.name)}`, textContent: "Report", ariaLabel: `Report of ${run.name}` }) : "";
    const cell = (label, ...children) => {
      const td = element("td", {}, ...children);
      td.dataset.label = label;
      return td;
    };
    return element(
      "tr",
      {},
      cell("", element("label", { className: "tick" }, tick)),
      cell("Run", element("span", { className: "run-name", textContent: run.name })),
      cell("When", moment(run.when)),
      cell("Verdict", element("span", { className: `chip ${kind}`, textContent: verdict, title: (run.says ?? []).join("; ") })),
      ...PARAMETERS.map((p) => cell(`${p.symbol}, ${p.unit}`, withInterval(run.estimate?.[p.key]))),
      cell("Lasts", Number.isFinite(run.lasts_s) ? `${fixed(run.lasts_s, 1)} s` : "–"),
      cell("", open),
    );
  }

  async #tick(name, tick) {
    const note = byId("runs-note");
    show(note, false);
    if (!tick.checked) this.#ticked = this.#ticked.filter((other) => other !== name);
    else if (this.#ticked.length >= MOST) {
      tick.checked = false;
      setText(note, `At most ${MOST} runs at once: untick one first.`);
      show(note, true);
      return;
    } else this.#ticked.push(name);
    setText(byId("overlay-empty"), "Reading…");
    try {
      if (!this.#read.has(name)) this.#read.set(name, await ask(`/api/runs/${encodeURIComponent(name)}`, undefined, ASIDE));
    } catch (error) {
      this.#ticked = this.#ticked.filter((other) => other !== name);
      tick.checked = false;
      setText(note, error.message);
      show(note, true);
    }
    this.#overlay();
  }

  #overlay() {
    this.#drawn?.remove();
    this.#drawn = null;
    const runs = this.#ticked.map((name) => this.#read.get(name)).filter(Boolean);
    setText(byId("overlay-empty"), "Tick two runs or more in the list.");
    show(byId("overlay-empty"), runs.length === 0);
    show(byId("overlay-body"), runs.length > 0);
    if (runs.length === 0) return;
    this.#numbers(runs);
    this.#compare();
    if (!canPlot()) return;
    const aligned = runs.map((run) => {
      const zero = run.first_switch_s ?? run.series.t_s[0] ?? 0;
      return [run.series.t_s.map((t) => t - zero), run.series.y_rad];
    });
    this.#drawn = plotIn(byId("plot-overlay"), {
      scales: { x: { time: false } },
      axes: [axis({ label: "time since the first switch, s", labelSize: 18, size: 38 }), axis({ label: "position, rad", labelSize: 18, size: 56 })],
      series: [{}, ...runs.map((_, k) => ({ stroke: () => colour(COLOURS[k]), width: 1.6, dash: k % 2 ? [7, 3] : [], spanGaps: true, points: { show: false } }))],
    }, join(aligned));
  }

  /** Is it one motor? What rig compare says of the ticked runs. */
  async #compare() {
    const number = ++this.#compared;
    const place = byId("compared");
    const names = [...this.#ticked];
    show(place, names.length > 1);
    if (names.length < 2) return;
    place.replaceChildren(element("p", { className: "muted", textContent: "Comparing…" }));
    await new Promise((done) => setTimeout(done, SETTLED_MS));
    if (number !== this.#compared) return;
    let shown;
    try {
      const found = await ask(`/api/compare?${new URLSearchParams(names.map((name) => ["run", name]))}`, undefined, ASIDE);
      shown = found.comparison === null ? [element("p", { className: "note", textContent: found.why })] : answers(found.comparison);
    } catch (error) {
      shown = [element("p", { className: "note", textContent: error.message })];
    }
    if (number === this.#compared) place.replaceChildren(element("h3", { textContent: "Is it one motor?" }), ...shown);
  }

  #numbers(runs) {
    const titles = ["Run", "First switch at", ...PARAMETERS.map((p) => `${p.symbol}, ${p.unit}`)];
    const head = element("tr", {}, ...titles.map((text) => element("th", { textContent: text, scope: "col" })));
    const rows = runs.map((run, k) => {
      const key = element("span", { className: `swatch run-${k + 1}` });
      const first = Number.isFinite(run.first_switch_s) ? `${fixed(run.first_switch_s, 2)} s` : "no switch: its start";
      const row = element("tr", {}, element("td", {}, key, run.name), element("td", { textContent: first }), ...PARAMETERS.map((p) => element("td", { textContent: withInterval(run.estimate?.[p.key]) })));
      [...row.cells].forEach((cell, at) => (cell.dataset.label = titles[at])); // a narrow page has no head
      return row;
    });
    byId("overlay-table").replaceChildren(element("thead", {}, head), element("tbody", {}, ...rows));
  }
}

/** Both answers of a comparison, the trends that show, and what else there is to know. */
function answers({ trends, left_out, notes, ...found }) {
  const said = QUESTIONS.map(([key, question]) => element("p", { className: `note ${found[key].differs ? "warn" : "good"}` }, `${question} `, element("b", { textContent: found[key].words })));
  const more = [
    ...trends.filter((trend) => trend.shows).map((trend) => `Trend over ${trend.over}: ${PARAMETERS.find((p) => p.key === trend.parameter)?.symbol} ${fixed(trend.slope, 2, { signed: true })} ±${fixed((trend.ci95[1] - trend.ci95[0]) / 2, 2)} ${trend.unit}.`),
    ...left_out.map((one) => `Left out: ${one.folder.split("/").at(-1)}: ${one.reason}.`),
    ...notes,
  ];
  return [...said, element("ul", {}, ...more.map((text) => element("li", { textContent: text })))];
}
