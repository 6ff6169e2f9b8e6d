// Calibrate: what rig says, the question that is open, and the buttons that answer it. The server has the calibration:
// a page that is opened anew, or another operator's, goes on where it is.

import { ENTER_TICKS, ask, byId, element, setText, show, withCode } from "./dom.js";

const TABLE = /\S {2,}\S|\n /; // columns, or an indented list: keep its lines as they are

export class Calibrate extends EventTarget {
  #shown = null;
  #may = false;
  #rests = true;
  #number = null; // of the question that is on the screen
  #reads = 0;

  constructor(connection) {
    super();
    byId("calibrate-begin").addEventListener("click", () => this.#send("/api/calibration/begin", {}));
    byId("answer").addEventListener("submit", (event) => {
      event.preventDefault();
      this.#submit(event.submitter?.value);
    });
    connection.addEventListener("calibration", () => this.read());
    connection.addEventListener("alive", () => this.read());
  }

  /** Whether a calibration goes on. */
  get goesOn() {
    return this.#shown !== null && this.#shown.end === null;
  }

  /** Whether this page may answer, and whether nothing else drives. */
  allow(may, rests) {
    this.#may = may;
    this.#rests = rests;
    this.#buttons();
  }

  /** Read where the calibration is. */
  async read() {
    const number = ++this.#reads;
    let found;
    try {
      found = (await ask("/api/calibration")).calibration;
    } catch {
      return; // the silence watch says that the server is gone
    }
    if (number < this.#reads) return; // a later look is on its way
    this.#shown = found;
    this.#draw();
    this.dispatchEvent(new CustomEvent("changed"));
  }

  #draw() {
    const { said = [], question = null, does = null, end = null } = this.#shown ?? {};
    show(byId("calibrate-intro"), this.#shown === null);
    show(byId("calibrate-begin"), this.#shown === null || end !== null);
    setText(byId("calibrate-begin"), end === null ? "Calibrate…" : "Calibrate again…");
    byId("said").replaceChildren(...said.map(shownAs));
    show(byId("does"), does !== null);
    setText(byId("does"), does === null ? "" : `rig ${does}…`);
    show(byId("calibrate-end"), end !== null);
    byId("calibrate-end").className = `note ${end?.written ? "good" : "warn"}`;
    setText(byId("calibrate-end"), end === null ? "" : `${end.words}\n${end.cure}`);
    if (question !== null && question.number === this.#number) return;
    this.#number = question?.number ?? null;
    show(byId("answer"), question !== null);
    byId("answer").replaceChildren(...(question === null ? [] : fields(question)));
    this.#buttons();
    const last = byId(question !== null ? "answer" : end !== null ? "calibrate-begin" : "does");
    if (!byId("calibrate-view").hidden) last.scrollIntoView({ block: "nearest" });
    // at the end there is nothing to answer: the next Tab goes on from what was said last
    if (end !== null && document.activeElement === document.body && !byId("calibrate-view").hidden) byId("calibrate-end").focus();
    // into the field to type in, or onto the button that says what was done by hand; never onto a button that drives
    if (question !== null && this.#may && !byId("calibrate-view").hidden) (document.querySelector("#answer .typed, #answer [data-done]") ?? byId("question")).focus();
  }

  #buttons() {
    byId("calibrate-begin").disabled = !this.#may || !this.#rests;
    for (const one of byId("answer").elements) one.disabled = !this.#may;
  }

  #submit(value) {
    const form = byId("answer");
    const typed = form.querySelector(".typed");
    const steps = [...form.querySelectorAll("input[type=checkbox]")];
    if (value === "(skip)") this.#send("/api/calibration/answer", { skip: true });
    else if (value === "(end)") this.#send("/api/calibration/answer", { end: true });
    else if (steps.length > 0) this.#send("/api/calibration/answer", { steps: steps.filter((one) => one.checked).map((one) => one.value) });
    else if (value !== undefined && value !== "(typed)") this.#send("/api/calibration/answer", { answer: value });
    else if (typed.value.trim() === "" && typed.dataset.default === undefined) typed.focus(); // an empty answer has its own button
    else this.#send("/api/calibration/answer", { answer: typed.value });
  }

  async #send(path, body) {
    const question = this.#number;
    this.#number = null; // answered: the next one is drawn, or this one again if the answer is refused
    byId("answer").replaceChildren();
    show(byId("answer"), false);
    show(byId("calibrate-error"), false);
    try {
      await ask(path, { ...body, question });
    } catch (error) {
      setText(byId("calibrate-error"), error.message);
      show(byId("calibrate-error"), true);
    }
    this.read();
  }
}

/** Something that was said, or answered. */
function shownAs({ kind, words, drawings }) {
  const text = TABLE.test(words) || kind === "refused" ? words : words.replaceAll(/\n/g, " ");
  const item = element("li", { className: `said-${kind}${TABLE.test(words) ? " table" : ""}` });
  item.append(element(kind === "step" && !TABLE.test(words) ? "h3" : "p", {}, ...withCode(text)));
  for (const { svg } of drawings) {
    const drawn = new DOMParser().parseFromString(svg, "image/svg+xml").documentElement;
    const caption = element("figcaption", { textContent: drawn.querySelector("title").textContent, ariaHidden: "true" }); // the drawing's name
    item.append(element("figure", {}, caption, document.importNode(drawn, true)));
  }
  return item;
}

/** The fields and buttons of a question. */
function fields({ words, kind, default: usual = "", choices = [], empty = "", commands = [], skips }) {
  const button = (text, value, className = "") => element("button", { type: "submit", value, textContent: text, className });
  const asked = element("h3", { id: "question", tabIndex: -1, textContent: sentence(words) });
  const rows = [asked];
  const buttons = element("div", { className: "buttons" });
  if (kind === "steps") {
    rows.push(element("div", { className: "steps" }, ...choices.map(([name, what]) => element("label", {}, element("input", { type: "checkbox", title: ENTER_TICKS, value: name, checked: true }), element("span", {}, element("b", { textContent: name }), ` ${what}`)))));
    buttons.append(button("Begin with these", "(typed)", "go"));
  } else if (kind === "choice") {
    buttons.append(...choices.map(([name, meaning]) => button(meaning ? `${sentence(name)}: ${meaning}` : sentence(name), name)));
  } else if (kind === "enter") {
    const done = button(sentence(empty), "", "go");
    done.dataset.done = "";
    buttons.append(done);
  } else {
    const typed = element("input", { type: "text", className: "typed", value: usual, autocomplete: "off", spellcheck: false, inputMode: "text" });
    if (usual) typed.dataset.default = usual;
    typed.setAttribute("aria-labelledby", "question");
    rows.push(typed);
    buttons.append(button(kind === "angle" ? "The shaft stands there" : "That is it", "(typed)", "go"));
    if (empty) buttons.append(button(sentence(empty), ""));
    buttons.append(...commands.map(([answer, meaning]) => button(sentence(meaning), answer, "quiet")));
  }
  if (skips && !choices.some(([, meaning]) => meaning === "leave this step out")) buttons.append(button("Leave this step out", "(skip)", "quiet"));
  buttons.append(button("End without writing", "(end)", "quiet"));
  return [...rows, buttons];
}

const sentence = (words) => words.charAt(0).toUpperCase() + words.slice(1);
