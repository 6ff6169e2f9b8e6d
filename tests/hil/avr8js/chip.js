"use strict";

// The Uno's chip on avr8js with the exact motor behind its pins, in virtual time: the very .hex that is flashed.
//
// The motor sees what the levels at the bridge's pins make of its supply, mean over a PWM period: with the timer's
// buffered compare register the drive changes up to 50 us after the program has written it. (firmware/emulator/chip.c
// gives it what Timer1 is set to, at once.)
//
// What avr8js 0.20 does not do as the chip does, and what is done about it here:
//   - events wait for the end of an instruction, and for one another: each has its own cycle;
//   - it sets a timer's compare flag as the counter reaches the value, the chip one count of the timer later: so here;
//   - a write to UCSRB forgets a received byte that has not been read: it is told again;
//   - its receiver holds one byte: two wait here, as in the chip, and one more is an overrun;
//   - a byte to send waits until the last bit of the one before has gone, so that 2 us lie between any two: left so;
//   - it takes ICR1 in any mode of Timer1, the chip only where ICR1 is TOP (section 16.6 of its data sheet): so here;
//   - a pin that is given to Timer1 begins at its port's level, on the chip at that of OC1x, which only a match changes and
//     which is kept meanwhile (16.7.3, 16.8.1): so here;
//   - sleep is no operation: the main loop spins instead, which is the same to all but the processor's load;
//   - a reset leaves registers as they were, and power on no cause: they are cleared, and it is set.
const {
  AVRADC, AVRClock, AVRIOPort, AVRTimer, AVRUSART, AVRWatchdog, CPU, avrInstruction,
  adcConfig, portBConfig, portDConfig, timer1Config, timer2Config, usart0Config, watchdogConfig,
} = require("avr8js");
const fs = require("fs");
const { Motor } = require("./motor.js");

const HZ = 16e6;
const NS = 1e9 / HZ;
const FLASH_BYTES = 0x8000;
const RAM_BYTES = 0x800;
const DIRECTION = 1 << 0; // D8, port B
const PWM = 1 << 1; // D9, IN1
const IN2 = 1 << 2; // D10
const ICR_IS_TOP = [8, 10, 12, 14]; // modes of Timer1
const [ENABLE, SET, CLEAR] = [1, 2, 3]; // what avr8js has a timer do with a pin
const LED = 1 << 5; // D13
const ESTOP = 4; // D4, of port D
const PWM_CYCLES = 800; // 20 kHz: the motor sees the mean over a period
const HOLD_CLOCKS = 1.5; // of the converter, from the start of a conversion to the sample
const ADC_MAX = 1023;
const RECEIVER = 2; // bytes
const FIRST_REGISTER = 0x20;
const LAST_REGISTER = 0xff;
const SREG = 0x5f;
const INTERRUPTS = 0x80;
const RXC = 0x80;
const MCUSR = 0x54;
const POWER_ON = 1;
const SLEEP = 0x9588;
const ENDLESS = 0xcfff; // rjmp to itself: where a program without an end is sent when it ends

function flash(path) {
  const bytes = new Uint8Array(FLASH_BYTES).fill(0xff);
  for (const line of fs.readFileSync(path, "latin1").split("\n")) {
    const record = Buffer.from(line.trim().slice(1), "hex");
    if (record[3] === 0) bytes.set(record.subarray(4, 4 + record[0]), record.readUInt16BE(1));
  }
  return new Uint16Array(bytes.buffer);
}

class Chip {
  // hex: path; byte_ns: that a byte takes the host; motor, and the bench around it: rad_per_count, centre_counts, supply_V;
  // bridge: PWM_DIR or IN1_IN2
  constructor({ hex, byte_ns, motor, bench, bridge }) {
    this.bench = bench;
    this.bridge = bridge;
    this.byte_ns = byte_ns;
    this.motor = new Motor(motor);
    this.now_ns = 0;
    this.toDevice = []; // [byte, arrives_ns]
    this.toHost = [];
    this.waiting = []; // in the receiver
    this.unread = false; // the byte in UDR
    this.counts = { overruns: 0, resets: 0 };
    this.impulse = 0; // integral of the bridge's conduction, -1 to 1, over cycles: in this PWM period
    this.lookImpulse = 0; // in the periods since the last look
    this.level = 0;
    this.longestPulse = 0; // that the bridge conducts without a break, since the last look, cycles
    this.levelSince = this.periodSince = this.lookSince = 0;
    this.#connect(flash(hex));
    this.cpu.data[MCUSR] = POWER_ON;
  }

  #connect(program) {
    const cpu = (this.cpu = new CPU(program, RAM_BYTES));
    this.portB = new AVRIOPort(cpu, portBConfig);
    this.portD = new AVRIOPort(cpu, portDConfig); // its contacts are closed to ground
    this.portB.addListener(() => this.#pinsChanged());
    this.#connectTimer1(new AVRTimer(cpu, timer1Config));
    this.#connectClock(new AVRTimer(cpu, timer2Config));
    this.#connectSerial((this.uart = new AVRUSART(cpu, usart0Config, HZ)));
    this.#connectConverter(new AVRADC(cpu, adcConfig));
    new AVRWatchdog(cpu, watchdogConfig, new AVRClock(cpu, HZ));
    const reset = cpu.reset.bind(cpu);
    cpu.reset = () => {
      this.counts.resets++;
      this.unread = false;
      this.waiting = [];
      cpu.data.fill(0, FIRST_REGISTER, LAST_REGISTER + 1);
      this.uart.reset();
      this.timer1.reset();
      this.outputs = {};
      this.#pinsChanged();
      reset();
    };
  }

  #connectClock(timer) {
    const { cpu } = this;
    const setFlag = cpu.setInterruptFlag.bind(cpu);
    cpu.setInterruptFlag = (interrupt) => {
      if (interrupt === timer.OCFA || interrupt === timer.OCFB) cpu.addClockEvent(() => setFlag(interrupt), timer.divider);
      else setFlag(interrupt);
    };
  }

  #connectTimer1(timer) {
    const { cpu, portB } = this;
    const { ICR, TCCRA } = timer1Config;
    this.timer1 = timer;
    this.outputs = {}; // OC1x by pin: SET or CLEAR
    const writeIcr = cpu.writeHooks[ICR];
    cpu.writeHooks[ICR] = (...written) => (ICR_IS_TOP.includes(timer.WGM) ? writeIcr(...written) : true);
    const override = portB.timerOverridePin.bind(portB);
    portB.timerOverridePin = (pin, what) => {
      const isConnected = cpu.data[TCCRA] >> (1 << pin === PWM ? 6 : 4) & 3;
      if (what === SET || what === CLEAR) this.outputs[pin] = what;
      if (what !== ENABLE) override(pin, what);
      else if (isConnected) override(pin, this.outputs[pin] ?? CLEAR);
    };
  }

  // ---- serial port

  #connectSerial(uart) {
    const { cpu } = this;
    const { UDR, UCSRA, UCSRB } = usart0Config;
    const read = cpu.readHooks[UDR];
    cpu.readHooks[UDR] = (address) => {
      const byte = read(address);
      this.unread = false;
      this.#feed();
      return byte;
    };
    const control = cpu.writeHooks[UCSRB];
    cpu.writeHooks[UCSRB] = (...written) => {
      const done = control(...written);
      if (this.unread && !(cpu.data[UCSRA] & RXC)) cpu.setInterruptFlag(uart.RXC);
      return done;
    };
    uart.onByteTransmit = (byte) => {
      const last_ns = this.toHost.length ? this.toHost.at(-1)[1] : 0;
      this.toHost.push([byte, Math.max(last_ns, cpu.cycles * NS) + uart.cyclesPerChar * NS]);
      this.transmits = true;
    };
  }

  #feed() {
    if (!this.unread && this.waiting.length > 0) {
      this.unread = true;
      this.uart.writeByte(this.waiting.shift(), true);
    }
  }

  #receive(byte) {
    if (!this.uart.rxEnable) return;
    if (this.waiting.length + (this.unread ? 1 : 0) >= RECEIVER) this.counts.overruns++;
    else this.waiting.push(byte);
    this.#feed();
  }

  send(bytes) {
    for (const byte of bytes) {
      const last_ns = this.toDevice.length ? this.toDevice.at(-1)[1] : 0;
      this.toDevice.push([byte, Math.max(last_ns, this.now_ns) + this.byte_ns]);
    }
  }

  // ---- converter

  #connectConverter(adc) {
    adc.onADCRead = (input) => {
      let counts = 0; // what is not wired reads 0
      if (input.channel === 0) {
        this.cpu.addClockEvent(() => (counts = this.#positionCounts()), HOLD_CLOCKS * adc.prescaler);
      }
      this.cpu.addClockEvent(() => adc.completeADCRead(counts), adc.sampleCycles);
    };
  }

  #positionCounts() {
    const { y_rad, v_rad_per_s } = this.motor;
    const now_rad = y_rad + (v_rad_per_s * (this.cpu.cycles - this.periodSince)) / HZ;
    const counts = Math.floor(this.bench.centre_counts + now_rad / this.bench.rad_per_count + 0.5);
    return Math.min(Math.max(counts, 0), ADC_MAX);
  }

  // ---- bridge: what the levels at its pins make of the supply

  #pinsChanged() {
    const { cycles } = this.cpu;
    this.#integrate(cycles);
    const high = this.cpu.data[portBConfig.DDR] & this.portB.lastValue; // floating: pulled down
    const level =
      this.bridge === "IN1_IN2" ? (high & PWM ? 1 : 0) - (high & IN2 ? 1 : 0) : high & PWM ? (high & DIRECTION ? -1 : 1) : 0;
    if (level === this.level) return;
    this.#endPulse(cycles);
    this.level = level;
    this.pulseSince = cycles;
  }

  #endPulse(cycles) {
    if (this.level !== 0) this.longestPulse = Math.max(this.longestPulse, cycles - this.pulseSince);
  }

  #integrate(until) {
    this.impulse += this.level * (until - this.levelSince);
    this.levelSince = until;
  }

  #endPeriod() {
    this.periodSince += PWM_CYCLES;
    this.#integrate(this.periodSince);
    this.motor.advance((this.impulse / PWM_CYCLES) * this.bench.supply_V, PWM_CYCLES / HZ);
    this.lookImpulse += this.impulse;
    this.impulse = 0;
  }

  // ---- running

  // To until_ns, or to the arrival of the next byte at the host if untilByte and that is sooner.
  run(until_ns, untilByte) {
    const { cpu } = this;
    for (;;) {
      const stop_ns = untilByte && this.toHost.length > 0 ? Math.min(until_ns, this.toHost[0][1]) : until_ns;
      const stop = Math.ceil(stop_ns / NS - 1e-6);
      this.transmits = false;
      while (cpu.cycles < stop && !this.transmits) {
        if (this.toDevice.length > 0 && cpu.cycles * NS >= this.toDevice[0][1]) this.#receive(this.toDevice.shift()[0]);
        this.#step();
        if (cpu.cycles - this.periodSince >= PWM_CYCLES) this.#endPeriod();
      }
      if (cpu.cycles >= stop) {
        this.now_ns = Math.max(this.now_ns, stop_ns);
        return;
      }
    }
  }

  // One instruction, with the interrupt that it lets in, and each event at its own cycle: edges of the PWM are exact.
  #step() {
    const { cpu } = this;
    let from = cpu.cycles;
    avrInstruction(cpu);
    while (cpu.cycles > from) {
      this.#eventsBetween(from, cpu.cycles);
      from = cpu.cycles;
      this.#tick(); // may enter an interrupt, which takes cycles, too
    }
  }

  #tick() {
    const { cpu } = this;
    const { cycles } = cpu;
    do cpu.tick(); // one event
    while (cpu.cycles === cycles && cpu.nextClockEvent?.cycles <= cycles);
  }

  #eventsBetween(from, end) {
    const { cpu } = this;
    const flags = cpu.data[SREG];
    cpu.data[SREG] = flags & ~INTERRUPTS; // they come after the instruction
    for (cpu.cycles = from + 1; cpu.cycles < end; cpu.cycles++) this.#tick();
    cpu.cycles = end;
    cpu.data[SREG] = flags;
  }

  received() {
    const bytes = [];
    while (this.toHost.length > 0 && this.toHost[0][1] <= this.now_ns) bytes.push(this.toHost.shift()[0]);
    return Buffer.from(bytes);
  }

  contact(is_open) {
    this.portD.setPin(ESTOP, is_open);
  }

  hang() {
    while (this.cpu.progMem[this.cpu.pc] !== SLEEP) this.#step(); // out of interrupts
    this.cpu.pc = this.cpu.progMem.indexOf(ENDLESS);
  }

  // The drive is the mean at the pins since the last look.
  look() {
    const { cpu, motor } = this;
    const cycles = this.periodSince - this.lookSince;
    const mean = cycles > 0 ? this.lookImpulse / cycles : 0;
    this.lookImpulse = 0;
    this.lookSince = this.periodSince;
    this.#endPulse(cpu.cycles);
    const longest_pulse_s = this.longestPulse / HZ;
    this.longestPulse = 0;
    return {
      pin_V: mean * this.bench.supply_V,
      y_rad: motor.y_rad,
      v_rad_per_s: motor.v_rad_per_s,
      longest_pulse_s,
      led: (cpu.data[portBConfig.DDR] & cpu.data[portBConfig.PORT] & LED) !== 0,
      ...this.counts,
    };
  }
}

module.exports = { Chip };
