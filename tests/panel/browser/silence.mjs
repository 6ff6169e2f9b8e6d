// The page's connection in a world whose clock this file moves: when does it say that nothing comes any more?
//
//   node silence.mjs    prints [what, ms after the last message] of each thing that the connection said

class Clock {
  now_ms = 1000;
  #due = [];

  set(call, every_ms, once) {
    this.#due.push({ call, every_ms, once, at_ms: this.now_ms + every_ms });
    return this.#due.at(-1);
  }

  clear(timer) {
    this.#due = this.#due.filter((one) => one !== timer);
  }

  pass(ms) {
    for (const until_ms = this.now_ms + ms; this.now_ms < until_ms; ) {
      this.now_ms += 1;
      for (const one of this.#due.filter((one) => one.at_ms <= this.now_ms)) {
        if (one.once) this.clear(one);
        else one.at_ms += one.every_ms;
        one.call();
      }
    }
  }
}

const clock = new Clock();
const sockets = [];
class Socket extends EventTarget {
  static OPEN = 1;
  readyState = 1;
  sent = [];

  constructor() {
    super();
    sockets.push(this);
  }

  send(text) {
    this.sent.push(JSON.parse(text).type);
  }

  close() {
    this.readyState = 3;
  }

  says(type) {
    this.dispatchEvent(Object.assign(new Event("message"), { data: JSON.stringify({ type }) }));
  }
}
Object.defineProperty(globalThis, "performance", { value: { now: () => clock.now_ms } });
Object.assign(globalThis, {
  setTimeout: (call, ms) => clock.set(call, ms, true), setInterval: (call, ms) => clock.set(call, ms, false),
  clearTimeout: (timer) => clock.clear(timer), addEventListener() {}, document: new EventTarget(),
  location: { protocol: "http:", host: "127.0.0.1:8470" }, WebSocket: Socket,
  CustomEvent: globalThis.CustomEvent ?? class extends Event {},
});

const { Connection } = await import("../../../rig/panel/static/connection.js");
const connection = new Connection();
const said = [];
let last_ms = clock.now_ms;
for (const type of ["alive", "silent"]) connection.addEventListener(type, () => said.push([type, clock.now_ms - last_ms]));
const hear = () => {
  last_ms = clock.now_ms;
  sockets.at(-1).says("idle");
};

connection.open();
hear();
for (let k = 0; k < 40; k++) {
  clock.pass(290); // a page hears something at least four times a second; some are late
  hear();
}
const lively = said.length;
clock.pass(1000); // the panel freezes: its socket stays open
const sent = [connection.send({ type: "jog" }), connection.send({ type: "stop" }), sockets.at(-1).sent];
hear();
clock.pass(100);
last_ms = clock.now_ms;
sockets.at(-1).dispatchEvent(new Event("close")); // the panel dies
clock.pass(100);
const again = sockets.length;
clock.pass(300);
console.log(JSON.stringify({ lively, said, sent, connects_again: sockets.length > again }));
process.exit();
