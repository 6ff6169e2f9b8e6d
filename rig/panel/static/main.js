// The page's beginning: it connects the parts, and says which of them the reader sees.

import { Bench } from "./bench.js";
import { Calibrate } from "./calibrate.js";
import { Connection } from "./connection.js";
import { ask, byId, setText, show } from "./dom.js";
import { Jog } from "./jog.js";
import { loadPlots } from "./plot.js";
import { Runs } from "./runs.js";
import { Start } from "./start.js";
import { Stop } from "./stop.js";
import { startTheme } from "./theme.js";

const body = document.body;
startTheme();
const connection = new Connection();
const stop = new Stop(connection); // first of all, so that it works whatever else fails
const jog = new Jog(connection, stop);
const start = new Start(stop);
const calibrate = new Calibrate(connection);
const runs = new Runs();
const SEEN_EVERY = 5; // the server slows down for a page that does not answer
let seen = 0;
const bench = new Bench((number) => {
  if (number >= seen + SEEN_EVERY || number < seen) connection.send({ type: "seen", n: (seen = number) });
});

let state = { operator: false, has_token: false, config: null };
let command = null; // of the run that drives
let opened = false; // a jog that waits for a hold: its device is open
let ending = false; // the run has its end, and its process not yet
let opens = null; // command that was started, and opens its device
let opensWith = ""; // the last that it said

const VIEWS = ["bench", "calibrate", "runs", "report"];

function route() {
  const [view, name] = location.hash.slice(1).split("/");
  const shown = VIEWS.includes(view) ? view : "bench";
  body.dataset.view = shown;
  for (const one of VIEWS) show(byId(`${one}-view`), one === shown);
  for (const one of ["bench", "calibrate", "runs"]) byId(`to-${one}`).ariaCurrent = (shown === "report" ? "runs" : shown) === one ? "page" : null;
  if (shown === "runs") runs.reload();
  if (shown === "report") runs.report(decodeURIComponent(name ?? ""));
}

/** What the bench does: the command that drives ("run", "jog"...), or null. */
function drives(next) {
  command = next;
  if (next !== null) opens = null;
  else opened = ending = false;
  body.dataset.bench = next === null ? "idle" : "driving";
  setText(byId("lamp"), next === null ? (opens ? "Opening" : "Idle") : ending ? "Ending" : next === "jog" ? "Jogging" : "Running");
  buttons();
}

function buttons() {
  const mine = state.operator && connection.alive;
  const rests = command === null && opens === null;
  byId("start").disabled = !mine || !rests || calibrate.goesOn || !state.config;
  byId("jog").disabled = !mine || !(rests || opened) || calibrate.goesOn || !state.config;
  calibrate.allow(mine && Boolean(state.config), rests);
  jog.allow(mine && command === "jog" && opened);
  show(byId("take"), !state.operator && state.has_token);
  const note = byId("watcher");
  show(note, !state.operator || !state.config || calibrate.goesOn);
  setText(
    note,
    state.operator && state.config
      ? "A calibration goes on: finish it, or end it, under Calibrate."
      : state.operator
      ? "No config: start the panel as rig panel CONFIG to start runs here."
      : state.has_token
        ? "Another page has the bench. You watch. Stop works."
        : "You watch. Stop works. To start runs, open the address that rig panel printed.",
  );
}

async function readState() {
  try {
    state = { ...state, ...(await ask("/api/state")) };
    setText(byId("config-name"), state.config ?? "");
  } catch {
    // the silence watch says that the server is gone
  }
  buttons();
}

connection.addEventListener("live", ({ detail }) => {
  bench.live(detail);
  if (command === null) stop.forget();
  const waits = detail.command === "jog" && detail.stage === "jog" && !detail.drive_is_off;
  if (command !== (detail.command ?? "run") || opened !== waits || ending !== detail.is_over) {
    [opened, ending] = [waits, detail.is_over];
    drives(detail.command ?? "run");
  }
  // the report's frame would swallow Stop's keys
  if (document.activeElement === byId("report")) {
    document.activeElement.blur();
    window.focus();
  }
});
connection.addEventListener("estimate", ({ detail }) => bench.estimate(detail));
connection.addEventListener("fault", ({ detail }) => bench.fault(detail));
connection.addEventListener("ended", ({ detail }) => {
  bench.ended(detail);
  drives(null);
  if (body.dataset.view === "runs") runs.reload();
});
connection.addEventListener("idle", ({ detail }) => {
  const opening = detail.opening ?? null;
  if (command === null && body.dataset.bench === "idle" && opening === opens && detail.words === opensWith) return;
  [opens, opensWith] = [opening, detail.words];
  bench.idle(opening, detail.words);
  drives(null);
});
connection.addEventListener("trouble", ({ detail }) => {
  bench.fault({ code: detail.code ?? "Not readable", cause: detail.what, cure: detail.cure ?? "check the disk and the folder of runs" });
});
connection.addEventListener("operator", ({ detail }) => {
  state.operator = detail.you;
  buttons();
});
connection.addEventListener("alive", () => {
  body.dataset.link = "alive";
  show(byId("silence"), false);
  setText(byId("silence"), "");
  document.title = "rig panel";
  readState();
});
connection.addEventListener("silent", () => {
  body.dataset.link = "silent";
  body.dataset.bench = "unknown";
  command = null;
  setText(byId("lamp"), "Not connected");
  setText(byId("silence"), "Not connected: use the e-stop");
  show(byId("silence"), true);
  document.title = "Not connected – rig panel";
  buttons();
});

calibrate.addEventListener("changed", buttons);
byId("take").addEventListener("click", () => connection.send({ type: "take" }));
addEventListener("hashchange", route);
// space is Stop everywhere, so Enter ticks a box
addEventListener("keydown", (event) => {
  if (event.key !== "Enter" || !event.target.matches("input[type=checkbox]")) return;
  event.preventDefault();
  event.target.click();
});

connection.open();
const curves = await loadPlots();
show(byId("no-uplot"), !curves);
for (const id of ["plot-y", "plot-u", "plot-overlay", "zoom"]) show(byId(id), curves);
bench.start();
route();
