// START: check first, show what will happen, ask once. The sheet leaves Stop in reach.

import { ASIDE, ask, byId, element, setText, show } from "./dom.js";
import { fixed } from "./words.js";

const range = (pair) => (pair ? `${fixed(pair[0], 2)} … ${fixed(pair[1], 2)}` : "none");

const PLAN = [
  ["Largest drive", "V", (plan) => fixed(plan.largest_drive_V, 2)],
  ["Distance to stop", "rad", (plan) => fixed(plan.stopping_distance_rad, 2)],
  ["Soft limits", "rad", (plan) => range(plan.soft_rad)],
  ["Hard limits", "rad", (plan) => range(plan.hard_rad)],
  ["Lasts at most", "s", (plan) => fixed(plan.lasts_s, 0)],
];

const SIGNS = { error: "✕", warning: "!", ok: "✓", note: "·" };

export class Start {
  #confirmation = null;

  constructor(stop) {
    byId("start").addEventListener("click", () => this.check());
    byId("confirm").addEventListener("click", () => this.#confirm());
    byId("cancel").addEventListener("click", () => this.close());
    stop.addEventListener("pressed", () => this.close());
  }

  /** Ask the server what `rig check` says, and show it. Nothing moves. */
  async check() {
    const button = byId("start");
    button.disabled = true;
    setText(button, "Checking…");
    this.#confirmation = null;
    byId("plan").replaceChildren();
    byId("check-lines").replaceChildren();
    show(byId("sheet-error"), false);
    try {
      this.#showCheck(await ask("/api/check", {}, ASIDE));
    } catch (error) {
      this.#refuse(error.message);
    }
    button.disabled = false;
    setText(button, "Check and start…");
    show(byId("sheet"), true);
    byId("sheet").focus();
  }

  /** Close the sheet. Nothing has started. */
  close() {
    if (byId("sheet").hidden) return;
    show(byId("sheet"), false);
    this.#confirmation = null;
    byId("start").focus();
  }

  #showCheck(answer) {
    const { plan, lines, may_run, confirmation } = answer;
    for (const [name, unit, read] of plan ? PLAN : []) {
      byId("plan").append(element("div", {}, element("dt", { textContent: `${name}, ${unit}` }), element("dd", { textContent: read(plan) })));
    }
    for (const { severity, text } of lines ?? []) {
      byId("check-lines").append(element("li", { className: `line-${severity}` }, element("span", { className: "sign", textContent: SIGNS[severity] ?? "·", ariaLabel: severity }), text));
    }
    if (may_run) this.#confirmation = confirmation;
    else this.#refuse("rig refuses to run this config. Mend what the list says, then check again.");
    show(byId("confirm"), Boolean(may_run));
  }

  async #confirm() {
    if (this.#confirmation === null) return;
    const button = byId("confirm");
    button.disabled = true;
    try {
      await ask("/api/start", { confirmed: true, confirmation: this.#confirmation });
      this.close();
    } catch (error) {
      this.#refuse(error.message);
    }
    button.disabled = false;
  }

  #refuse(words) {
    show(byId("confirm"), false);
    setText(byId("sheet-error"), words);
    show(byId("sheet-error"), true);
  }
}
