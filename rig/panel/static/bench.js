// The bench view: the newest message of the run as numbers, and the curves drawn once a frame.

import { byId, element, setText, show, withCode } from "./dom.js";
import { Narrowing } from "./narrowing.js";
import { Phase } from "./phase.js";
import { Rows } from "./rows.js";
import { Scope } from "./scope.js";
import { DRAWS, fixed, whole, whyOld } from "./words.js";

const FAULTS_KEPT = 20;

export class Bench {
  #rows = new Rows();
  #scope = new Scope(this.#rows);
  #phase = new Phase(this.#rows);
  #narrowing = new Narrowing();
  #run = null;
  #frame = 0;
  #live = null;
  #onDrawn;

  /** onDrawn is called with the number of each message that is on the screen. */
  constructor(onDrawn) {
    this.#onDrawn = onDrawn;
  }

  /** Set up the curves, if uPlot is there. */
  start() {
    this.#scope.start();
  }

  /** Name of the run that is shown; null while there is none. */
  get run() {
    return this.#run;
  }

  /** Take a "live" message. */
  live(message) {
    this.#begin(message.run, message.rows?.t_s?.[0]);
    this.#live = message;
    this.#rows.add(message.rows);
    this.#scope.limits(message.limits);
    this.#phase.planes(message.planes);
    this.#frame ||= requestAnimationFrame(() => this.#draw());
  }

  /** Take an "estimate" message. */
  estimate(message) {
    if (message.run) this.#begin(message.run);
    this.#narrowing.take(message);
  }

  /** Take a "fault" message: its cause and its cure, newest first. */
  fault({ run, t_s, code, cause, detail, cure }) {
    if (run) this.#begin(run);
    const list = byId("faults");
    const when = Number.isFinite(t_s) ? `${fixed(t_s, 1)} s` : "";
    list.prepend(
      element("article", { className: "fault" }, element("h3", {}, code, element("small", { textContent: when })), element("p", {}, ...withCode(detail ? `${cause}: ${detail}.` : `${cause}.`)), element("p", { className: "cure" }, element("b", { textContent: "Do: " }), ...withCode(`${cure}.`))),
    );
    while (list.children.length > FAULTS_KEPT) list.lastChild.remove();
    show(byId("no-faults"), false);
  }

  /** Take an "ended" message. What the run said last is shown where no fault says it. */
  ended({ run, why, verdict, exit, words }) {
    this.#rest();
    setText(byId("stage"), "ended");
    setText(byId("words"), why || verdict || "");
    if (exit && words && (!run || byId("faults").children.length === 0)) {
      this.fault({ code: why || "The run failed", cause: words.trim().replace(/\.$/, ""), cure: "mend this, check, and start again" });
    }
  }

  /** No run drives; a command may be opening its device, and say why that takes long. */
  idle(opening, says) {
    const was = this.#live;
    this.#rest();
    if (opening || was) setText(byId("stage"), opening ? "opening" : "ended");
    if (opening || was) setText(byId("words"), opening ? says || `rig ${opening} opens the device` : "");
  }

  #rest() {
    this.#live = null;
    setText(byId("stage-left"), "–");
    setText(byId("run-left"), "–");
    for (const id of ["y", "u", "age"]) setText(byId(id), "–"); // of now, and there is none
    show(byId("computing"), false);
    document.body.classList.remove("old");
  }

  // a new run, or the same one from its beginning: nothing of the old one may stay
  #begin(run, first_s) {
    const again = Number.isFinite(first_s) && this.#rows.last_s !== null && first_s < this.#rows.last_s - 60;
    if (run === this.#run && !again) return;
    this.#run = run;
    this.#rows.clear();
    this.#narrowing.clear();
    byId("faults").replaceChildren();
    show(byId("no-faults"), true);
  }

  #draw() {
    this.#frame = 0;
    const live = this.#live;
    if (live === null) return;
    const { y_rad, u_V } = this.#rows;
    const number = (id, text) => setText(byId(id), text);
    setText(byId("stage"), live.is_over ? "report" : (live.stage ?? "starting"));
    setText(byId("words"), live.is_over ? DRAWS : (live.words ?? ""));
    number("stage-left", fixed(live.stage_left_s, 1));
    number("run-left", fixed(live.run_left_s, 1));
    number("y", fixed(y_rad.at(-1), 3, { signed: true }));
    // 0 as soon as the device has confirmed it: the newest row is from before
    number("u", fixed(live.drive_is_off && u_V.length > 0 ? 0 : u_V.at(-1), 2, { signed: true }));
    number("amplitude", fixed(live.amplitude_rad, 3));
    number("period", fixed(live.period_s, 3));
    number("cycles", whole(live.cycles));
    number("late", whole(live.loop?.late));
    number("skipped", whole(live.loop?.skipped));
    number("link-errors", whole(live.loop?.link_errors));
    number("age", whole(live.age_ms));
    const old = whyOld(live);
    document.body.classList.toggle("old", old !== "");
    show(byId("computing"), old !== "");
    if (old) setText(byId("computing"), old);
    this.#scope.draw();
    this.#phase.draw();
    this.#onDrawn(live.n);
  }
}
