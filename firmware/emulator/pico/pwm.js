"use strict";

const { Peripheral } = require("./peripheral.js");

const [CSR, DIV, CTR, CC, TOP] = [0x00, 0x04, 0x08, 0x0c, 0x10];
const SLICE_BYTES = 0x14;
const ENABLED = 1;
const DIV_BY_1 = 0x10;
const ALIKE = 2; // whole periods after a write, from which on all are the same

// Slice 0 of the PWM, edge by edge, at full speed in trailing-edge mode (data sheet, 4.5.2): what it is compared with comes
// into force as the counter wraps to 0, or at once while it stands still. What else the slice can do is a broken rule.
class Pwm extends Peripheral {
  // now(): in cycles of the system clock; changed(cycle): an output may have; skips(cycles): whole periods that are alike
  constructor({ now, changed, skips, hold }) {
    super();
    Object.assign(this, { now, changed, skips, hold });
    this.at = now(); // up to where it has been followed
    this.count = 0;
    this.top = this.nextTop = 0xffff;
    this.compare = [0, 0];
    this.nextCompare = [0, 0];
    this.level = [false, false];
    this.control = 0;
    this.periods = 0;
  }

  readUint32(offset) {
    this.advance(this.now());
    switch (offset) {
      case CSR:
        return this.control;
      case DIV:
        return DIV_BY_1;
      case CTR:
        return this.count;
      case CC:
        return (this.nextCompare[0] | (this.nextCompare[1] << 16)) >>> 0;
      case TOP:
        return this.nextTop;
    }
    return 0;
  }

  writeUint32(offset, value) {
    const now = this.now();
    this.advance(now);
    this.periods = 0;
    this.hold(offset < SLICE_BYTES, "a PWM slice that this emulator does not have");
    switch (offset) {
      case CSR:
        this.hold((value & ~ENABLED) === 0, "a PWM mode that this emulator does not have");
        this.control = value & ENABLED;
        break;
      case DIV:
        this.hold(value === DIV_BY_1, "a PWM divider that this emulator does not have");
        break;
      case CTR:
        this.count = value & 0xffff;
        break;
      case CC:
        this.nextCompare = [value & 0xffff, value >>> 16];
        break;
      case TOP:
        this.nextTop = value & 0xffff;
        break;
    }
    if (!this.runs) this.#latch();
    this.#show();
    this.changed(now);
  }

  get runs() {
    return (this.control & ENABLED) !== 0;
  }

  #latch() {
    this.compare = this.nextCompare;
    this.top = this.nextTop;
  }

  // While it stands still its outputs stay as they are.
  #show() {
    if (this.runs) this.level = [this.count < this.compare[0], this.count < this.compare[1]];
  }

  // Until the next count at which something happens; a counter above TOP wraps at its largest value.
  #far() {
    const end = this.count > this.top ? 0x10000 : this.top + 1;
    let next = end;
    for (const compare of this.compare) if (compare > this.count && compare < next) next = compare;
    return [next - this.count, next === end];
  }

  advance(cycle) {
    while (this.runs && this.at < cycle) {
      const [far, wraps] = this.#far();
      if (this.at + far > cycle) {
        this.count += cycle - this.at;
        break;
      }
      this.at += far;
      this.count = wraps ? 0 : this.count + far;
      if (wraps) {
        this.#latch();
        this.periods = Math.min(this.periods + 1, ALIKE + 1);
      }
      this.#show();
      this.changed(this.at);
      if (wraps && this.periods > ALIKE) {
        const period = this.top + 1;
        const skipped = Math.floor((cycle - this.at) / period) * period;
        this.at += skipped;
        this.skips(skipped, period);
      }
    }
    this.at = Math.max(this.at, cycle);
  }

  // The next cycle at which an output may change; Infinity while it stands still.
  get next() {
    return this.runs ? this.at + this.#far()[0] : Infinity;
  }

  // Share of the time for which an output is high, from the next period on.
  share(output) {
    if (!this.runs) return this.level[output] ? 1 : 0;
    return Math.min(this.nextCompare[output] / (this.nextTop + 1), 1);
  }
}

module.exports = { Pwm };
