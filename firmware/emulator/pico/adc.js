"use strict";

const { Peripheral } = require("./peripheral.js");

const [CS, RESULT] = [0x00, 0x04];
const [ENABLED, START_ONE, START_MANY, READY] = [0x001, 0x004, 0x008, 0x100];
const ROUND_ROBIN = 0x1f0000;
const KEPT = ENABLED | 0x7000; // of what is written: and the channel
const CONVERSION_NS = 96 * (1e9 / 48e6); // section 4.9

// The converter, one conversion at a time, of the channel asked for (data sheet, 4.9). What it holds is what there was as the
// conversion began. Its FIFO, free running and round robin are broken rules: rp2040js has them, but not as the chip does.
class Adc extends Peripheral {
  // createAlarm(f): of the chip's clock; sample(channel): counts now
  constructor({ createAlarm, sample, hold }) {
    super();
    Object.assign(this, { sample, hold });
    this.control = 0;
    this.ready = false;
    this.is_dead = false; // it never is done
    this.held = this.result = 0;
    this.done = createAlarm(() => {
      this.ready = true;
      this.result = this.held;
    });
  }

  readUint32(offset) {
    if (offset === CS) return this.control | (this.ready ? READY : 0);
    return offset === RESULT ? this.result : 0;
  }

  writeUint32(offset, value) {
    this.hold(offset === CS, "a register of the converter that this emulator does not have");
    this.hold((value & (START_MANY | ROUND_ROBIN)) === 0, "the converter runs freely, which this emulator does not have");
    this.hold(!(this.control & ENABLED) || this.ready || this.is_dead, "ADC_CS written while a conversion runs, section 4.9");
    this.control = value & KEPT;
    this.ready = (value & ENABLED) !== 0 && !this.is_dead;
    if ((value & START_ONE) === 0 || !this.ready) return;
    this.ready = false;
    this.held = this.sample((value >> 12) & 7);
    this.done.schedule(CONVERSION_NS);
  }
}

module.exports = { Adc };
