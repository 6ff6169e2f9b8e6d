"use strict";

const { Peripheral } = require("./peripheral.js");

const [DR, FR, IBRD, FBRD, LCR_H, CR, IMSC, RIS, MIS, ICR] = [0x00, 0x18, 0x24, 0x28, 0x2c, 0x30, 0x38, 0x3c, 0x40, 0x44];
const [BUSY, RXFE, TXFF, RXFF, TXFE] = [0x08, 0x10, 0x20, 0x40, 0x80]; // of FR
const [RX, TX, OVERRUN] = [0x10, 0x20, 0x400]; // of the interrupts
const [ENABLED, SENDS, RECEIVES] = [0x001, 0x100, 0x200]; // of CR
const EIGHT_BITS = 0x60; // of LCR_H, and no FIFOs
const BITS_PER_BYTE = 10;

// A serial port with the times of its wire (data sheet, 4.2), without its FIFOs: one byte waits each way, and one more
// received is an overrun. It asks for a byte to send only as one that it had leaves.
class Uart extends Peripheral {
  // createAlarm(f): of the chip's clock; clock_hz(); interrupt(is_on); sends(byte, time_ns): until its last bit
  constructor({ createAlarm, clock_hz, interrupt, sends, hold }) {
    super();
    Object.assign(this, { clock_hz, interrupt, sends, hold });
    this.received = null;
    this.next = null; // to send
    this.leaving = false; // a byte is on the wire
    this.divisor = [0, 0];
    this.line = this.control = this.mask = this.raw = 0;
    this.overruns = 0;
    this.left = createAlarm(() => this.#leave());
  }

  get byte_ns() {
    const divisor = this.divisor[0] + this.divisor[1] / 64;
    return (BITS_PER_BYTE * 16 * divisor * 1e9) / this.clock_hz();
  }

  get #is_on() {
    return (this.control & ENABLED) !== 0;
  }

  #tell() {
    this.interrupt((this.raw & this.mask) !== 0);
  }

  // Its last bit has arrived.
  receive(byte) {
    if (!this.#is_on || !(this.control & RECEIVES)) return;
    if (this.received !== null) {
      this.overruns++;
      this.raw |= OVERRUN;
    } else {
      this.received = byte;
      this.raw |= RX;
    }
    this.#tell();
  }

  #begin(byte) {
    this.leaving = true;
    this.raw |= TX; // there is room again
    this.sends(byte, this.byte_ns);
    this.left.schedule(this.byte_ns);
    this.#tell();
  }

  #leave() {
    this.leaving = false;
    if (this.next === null) return;
    const byte = this.next;
    this.next = null;
    this.#begin(byte);
  }

  readUint32(offset) {
    switch (offset) {
      case DR: {
        const byte = this.received ?? 0;
        this.received = null;
        this.raw &= ~RX;
        this.#tell();
        return byte;
      }
      case FR:
        return (
          (this.received === null ? RXFE : RXFF) | (this.next === null ? TXFE : TXFF) | (this.leaving ? BUSY : 0)
        );
      case IBRD:
      case FBRD:
        return this.divisor[offset === IBRD ? 0 : 1];
      case LCR_H:
        return this.line;
      case CR:
        return this.control;
      case IMSC:
        return this.mask;
      case RIS:
        return this.raw;
      case MIS:
        return this.raw & this.mask;
    }
    return 0;
  }

  writeUint32(offset, value) {
    switch (offset) {
      case DR:
        this.#write(value & 0xff);
        break;
      case IBRD:
      case FBRD:
        this.hold(!this.#is_on, "the serial port's rate changed while it is on, section 4.2");
        this.divisor[offset === IBRD ? 0 : 1] = value;
        break;
      case LCR_H:
        this.hold(!this.#is_on, "the serial port set up while it is on, section 4.2");
        this.hold(value === EIGHT_BITS, "a serial line that this emulator does not have: 8 bits, no parity, no FIFOs");
        this.line = value;
        break;
      case CR:
        this.hold(this.line === EIGHT_BITS && this.divisor[0] > 0, "the serial port on before it is set up, section 4.2");
        this.control = value;
        break;
      case IMSC:
        this.mask = value;
        break;
      case ICR:
        this.raw &= ~value;
        break;
    }
    this.#tell();
  }

  #write(byte) {
    this.hold(this.#is_on && (this.control & SENDS) !== 0, "a byte sent while the serial port is off, section 4.2");
    this.hold(this.next === null, "a byte sent where there is no room: TXFF, section 4.2");
    this.raw &= ~TX;
    if (this.leaving) this.next = byte;
    else this.#begin(byte);
  }
}

module.exports = { Uart };
