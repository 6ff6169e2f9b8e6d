// The socket to the panel's server: what comes in is dispatched by type, and silence is noticed.
//
// The server says something at least four times a second, idle too. After SILENT_MS without a message the page must not
// look live: the socket can be open while the server is frozen, the machine asleep or the cable out.

export const SILENT_MS = 700;
const WATCH_MS = 100;
const RETRY_MS = [250, 500, 1000, 2000];

export class Connection extends EventTarget {
  #socket = null;
  #heard_ms = -Infinity;
  #tries = 0;
  #alive = null; // not known until the first message, or until it stays out
  #retry = 0;

  /** Whether a message came within SILENT_MS. */
  get alive() {
    return this.#alive === true;
  }

  /** Connect, and connect again whenever the socket closes. */
  open() {
    setTimeout(() => this.#watch(), SILENT_MS + 1);
    setInterval(() => this.#alive !== null && this.#watch(), WATCH_MS);
    // a page that slept must not show old numbers for even one frame more
    document.addEventListener("visibilitychange", () => this.#watch());
    addEventListener("offline", () => this.#watch());
    this.#connect();
  }

  /** Send a message; false if it could not be handed over. A page that hears nothing sends nothing but Stop. */
  send(message) {
    if (this.#socket?.readyState !== WebSocket.OPEN) return false;
    if (!this.alive && message.type !== "stop") return false;
    this.#socket.send(JSON.stringify(message));
    return true;
  }

  #connect() {
    clearTimeout(this.#retry);
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const socket = new WebSocket(`${scheme}://${location.host}/ws`);
    this.#socket = socket;
    socket.addEventListener("message", (event) => this.#take(event.data));
    socket.addEventListener("close", () => {
      if (socket !== this.#socket) return;
      const wait = RETRY_MS[Math.min(this.#tries++, RETRY_MS.length - 1)];
      this.#retry = setTimeout(() => this.#connect(), wait);
      this.#heard_ms = -Infinity;
      this.#watch();
    });
  }

  #take(data) {
    let message;
    try {
      message = JSON.parse(data);
    } catch {
      return; // the silence watch speaks if nothing readable comes
    }
    this.#heard_ms = performance.now();
    this.#tries = 0;
    this.#watch();
    this.dispatchEvent(new CustomEvent(message.type, { detail: message }));
  }

  #watch() {
    const silent_ms = performance.now() - this.#heard_ms;
    const alive = silent_ms < SILENT_MS;
    if (alive !== this.#alive) {
      this.#alive = alive;
      this.dispatchEvent(new CustomEvent(alive ? "alive" : "silent"));
    }
    // a socket that stays open and silent is half open: take a new one
    if (!alive && silent_ms > 5 * SILENT_MS && Number.isFinite(silent_ms) && this.#socket?.readyState === WebSocket.OPEN) {
      this.#heard_ms = -Infinity;
      const old = this.#socket;
      this.#connect();
      old.close();
    }
  }
}
