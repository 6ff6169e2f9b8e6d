// Stop: one button and two keys, always there. It never asks. It goes out twice, by the socket and by a request of its
// own, and the page says what became of it: received, drive at 0, or that it did not get through.

import { ask, byId, setText } from "./dom.js";

const GIVE_UP_MS = 900;
const ONE_PRESS_MS = 1000; // a touch and the click that follows it

const WORDS = {
  ready: "",
  unreachable: "Stop cannot work: not connected. Use the e-stop.",
  asked: "Stop asked…",
  received: "Stop received. Waiting for the drive to be at 0…",
  zero: "Stopped: the drive is at 0.",
  nothing: "Stop received. This panel knows of no run that drives.",
  lost: "Stop did not get through. Use the e-stop.",
  driving: "Stop was received, but the drive may not be at 0. Use the e-stop.",
};

const isText = (node) => node?.matches?.("textarea, [contenteditable], input:not([type=range], [type=checkbox])") ?? false;
const isStopKey = (event) => event.key === "Escape" || (event.key === " " && !isText(event.target)); // a space may be typed

export class Stop extends EventTarget {
  #connection;
  #state = "ready";
  #asked = 0;
  #pressed_ms = -Infinity;
  #timer = 0;

  constructor(connection) {
    super();
    this.#connection = connection;
    // at the touch, and from a second finger too: a click comes only when the first one is let go. Enter and screen
    // readers click without a touch
    byId("stop").addEventListener("pointerdown", () => this.press());
    byId("stop").addEventListener("click", () => {
      if (performance.now() - this.#pressed_ms > ONE_PRESS_MS) this.press();
    });
    // before any element sees the key, so that space on a button stops, and presses nothing
    const onKey = (event) => {
      if (!isStopKey(event)) return;
      event.preventDefault();
      if (event.type !== "keydown") return;
      if (!event.repeat) this.press();
    };
    addEventListener("keydown", onKey, { capture: true });
    addEventListener("keyup", onKey, { capture: true });
    connection.addEventListener("stop", (event) => this.#answer(event.detail));
    connection.addEventListener("silent", () => this.#show("unreachable"));
    connection.addEventListener("alive", () => {
      if (this.#state === "unreachable") this.#show("ready");
    });
  }

  /** Ask for Stop. */
  async press() {
    const number = ++this.#asked;
    this.#pressed_ms = performance.now();
    this.#show("asked");
    this.dispatchEvent(new CustomEvent("pressed"));
    this.#connection.send({ type: "stop" });
    this.#giveUp();
    try {
      const answer = await ask("/api/stop", {}, { timeout_ms: GIVE_UP_MS });
      if (number === this.#asked) this.#answer(answer);
    } catch {
      // the timer says so, if the socket does not answer either
    }
  }

  /** A run has begun: what was said of an earlier Stop is over. */
  forget() {
    if (this.#connection.alive && ["zero", "nothing"].includes(this.#state)) this.#show("ready");
  }

  #answer(answer) {
    if (!answer?.received) return;
    if (!answer.run && answer.drive_zero === null && !answer.why) {
      if (this.#state === "driving") this.#show("ready"); // another run has begun
      if (this.#state === "asked" || this.#state === "lost") this.#show("nothing");
      return;
    }
    if (answer.why) {
      this.#show("driving", answer.why);
    } else if (answer.drive_zero === true) {
      this.#show("zero");
    } else if (answer.drive_zero === false) {
      this.#show("driving", answer.why);
    } else if (this.#state === "asked" || this.#state === "lost") {
      this.#show("received"); // what becomes of it comes over the socket, within about a second
    }
  }

  // the socket may answer before the request does, or instead of it
  #giveUp() {
    clearTimeout(this.#timer);
    this.#timer = setTimeout(() => {
      if (this.#state === "asked") this.#show("lost");
    }, GIVE_UP_MS);
  }

  #show(state, why = "") {
    this.#state = state;
    byId("dock").dataset.state = state;
    setText(byId("stop-state"), why ? `${WORDS[state]} (${why})` : WORDS[state]);
  }
}
