// Jog by hold. While a button is held the page renews a lease of 150 ms every 50 ms. Whatever ends the hold ends the
// renewing: let go, lost pointer, another window, a hidden or closed page, Stop. What this page misses, the lease ends.

import { ask, byId, setText } from "./dom.js";

const RENEW_MS = 50;
const OPENS = "Opening the device…";

export class Jog {
  #connection;
  #timer = 0;
  #held = null;
  #allowed = false;
  #lease = 0;

  constructor(connection, stop) {
    this.#connection = connection;
    this.#bind(byId("jog-minus"), -1);
    this.#bind(byId("jog-plus"), +1);
    byId("jog-ready").addEventListener("click", () => this.#beginOrEnd());
    const level = byId("jog-level");
    level.addEventListener("input", () => setText(byId("jog-level-out"), `${level.value} %`));
    addEventListener("blur", () => this.release());
    addEventListener("pagehide", () => this.release());
    document.addEventListener("visibilitychange", () => this.release());
    stop.addEventListener("pressed", () => this.release());
    connection.addEventListener("silent", () => this.release());
    // a hold that was lost on the way: the server takes no other one until it hears that it is over
    connection.addEventListener("alive", () => connection.send({ type: "release" }));
    connection.addEventListener("ended", () => {
      if (byId("jog-state").textContent === OPENS) setText(byId("jog-state"), "The jog did not begin.");
    });
    connection.addEventListener("refused", ({ detail }) => {
      this.release();
      setText(byId("jog-state"), `${detail.what}: ${detail.cure}.`);
    });
  }

  /** Let the buttons work only while a jog runs and this page has the bench. */
  allow(allowed) {
    if (!allowed) this.release();
    if (allowed === this.#allowed) return;
    this.#allowed = allowed;
    for (const id of ["jog-minus", "jog-plus"]) byId(id).disabled = !allowed;
    setText(byId("jog-ready"), allowed ? "End the jog" : "Get ready to jog");
    setText(byId("jog-state"), allowed ? "Hold a button to turn." : "The jog is over.");
  }

  /** End the hold, and say so to the server. */
  release() {
    if (this.#held === null) return;
    clearInterval(this.#timer);
    this.#held.classList.remove("held");
    this.#held = null;
    this.#connection.send({ type: "release" });
    setText(byId("jog-state"), "Released.");
  }

  #bind(button, direction) {
    button.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      button.setPointerCapture(event.pointerId);
      this.#hold(button, direction);
    });
    for (const kind of ["pointerup", "pointercancel", "lostpointercapture", "blur", "keyup"]) {
      button.addEventListener(kind, () => this.release());
    }
    button.addEventListener("keydown", (event) => {
      if (event.key === "Enter" && !event.repeat) this.#hold(button, direction);
    });
    // a long press on a touch screen is a hold, not a menu
    button.addEventListener("contextmenu", (event) => event.preventDefault());
  }

  #hold(button, direction) {
    this.release();
    if (button.disabled || document.hidden) return;
    this.#held = button;
    button.classList.add("held");
    setText(byId("jog-state"), direction < 0 ? "Turning backwards while you hold." : "Turning forwards while you hold.");
    const renew = () => {
      const share = (direction * Number(byId("jog-level").value)) / 100;
      if (!this.#connection.send({ type: "jog", volts_share: share, lease: ++this.#lease })) this.release();
    };
    renew();
    if (this.#held !== null) this.#timer = setInterval(renew, RENEW_MS);
  }

  async #beginOrEnd() {
    const state = byId("jog-state");
    setText(state, this.#allowed ? "Ending the jog…" : OPENS);
    try {
      await ask(this.#allowed ? "/api/jog/end" : "/api/jog/start", {});
    } catch (error) {
      setText(state, error.message);
    }
  }
}
