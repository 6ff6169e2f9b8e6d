"use strict";

// The Raspberry Pi Pico's chip on rp2040js with the bench behind its pins, in virtual time: the very .uf2 that is flashed.
//
// As behind the Uno's emulated chip (../chip.c) the bench gets the mean of a PWM period, at once; the levels at the pins
// are followed edge by edge beside it.
//
// What rp2040js 1.4.1 does not do as the chip does, and what is done about it here:
//   - it has no boot program: the first 256 bytes are checked and run from memory, as the chip does (data sheet, 2.8.1);
//   - its converter in round robin converts channel 0 alone, its PWM has no edges in phase-correct mode, its serial port
//     sends in no time and never overruns: adc.js, pwm.js and uart.js take their place;
//   - WFI with interrupts masked enters the handler, and one that came before is slept through: it only ends the sleep;
//   - entering an interrupt and leaving it take no time: 15 and 13 cycles here (ARM DDI 0484C, and 2.4);
//   - CHIP_RESET cannot be read, and all peripherals are out of reset from the start;
//   - its timer counts on through a reset: what the program reads and sets of it is from the reset on;
//   - its watchdog calls back, for ever, and its reset() erases the flash: a reset is a new chip on the same clock;
//   - its PIO runs outside its time, and steps machines that are off: pio.js steps it;
//   - its peripherals take no note of what the data sheet forbids: the first rule that the program breaks is kept.
// Flash takes it no time: the program runs from memory, which takes the chip none, either. There is one core.
const { RP2040 } = require("rp2040js");
const { Adc } = require("./adc.js");
const { Peripheral } = require("./peripheral.js");
const { connectPio } = require("./pio.js");
const { Pwm } = require("./pwm.js");
const { Uart } = require("./uart.js");
const { readUf2, boot2Fits, BOOT2_BYTES } = require("./flash.js");

const SimulationClock = new RP2040().clock.constructor; // not exported

const [BOOT2_AT, RAM, RAM_END] = [0x20041f00, 0x20000000, 0x20042000];
const [UART0, ADC, PWM, WATCHDOG, CHIP_RESET] = [0x40034, 0x4004c, 0x40050, 0x40058, 0x40064];
const [IO_BANK0, PADS_BANK0, RESETS] = [0x40014, 0x4001c, 0x4000c];
const PIOS = [0x50200, 0x50300];
const IN_RESET = { [PIOS[0]]: 10, [PIOS[1]]: 11, [IO_BANK0]: 5, [PADS_BANK0]: 8, [PWM]: 14, 0x40054: 21, [UART0]: 22, [ADC]: 0 }; // bits of RESETS
const [RESET, RESET_DONE, ALL_RESETS] = [0x0, 0x8, 0x1ffffff];
const [TIMER_IRQ, UART_IRQ] = [0, 20];
const TIMER = 0x40054;
const IS_TIME = new Set([0x10, 0x28]); // registers: ALARM0, TIMERAWL
const [NULL, FUNCTION_PWM, FUNCTION_SIO] = [0x1f, 4, 5];
const [PIN_A, PIN_B, PIN_LED] = [16, 17, 25]; // boards/pico/wiring.h
const CONTACTS = { e_stop: [14, 1], end_low: [12, 2], end_high: [13, 4] }; // pins, and bits of the bench's contacts
const CHANNELS = [2, 3]; // of an encoder
const WIRES = [[PIN_A, 18, 1], [PIN_B, 19, 2]]; // of a loop-back: from, to, and bits of those that are there
const [ESTOP_WIRE, ESTOP_WIRE_BIT] = [15, 4];
const LOOK_NS = 100e3; // at the shaft, at least so often
const HAND_NS = 50e3; // between two edges of a shaft that was put elsewhere
const ENTRY_CYCLES = 15;
const EXIT_CYCLES = 13;
const ENDLESS = 0xe7fe; // an instruction that jumps to itself: where a program without an end is sent when it ends
const DRIVE_STEPS = 31250; // of the bridge's duty, as the bench counts it: whole ones for each unit
const SUPPLY_FULL_V = 20; // motor supply that reads full scale: a divider by 6
const ADC_MAX = 4095;
const PAINT = 0xa7a7a7a7; // of memory that nobody has written
const CAUSES = { 1: 1 << 8, 2: 1 << 16, 4: 1 << 8 }; // CHIP_RESET for rig_reset_cause: a brown-out is a power-on

class ChipReset extends Peripheral {
  constructor(had) {
    super();
    this.had = had;
  }

  readUint32(offset) {
    return offset === 8 ? this.had : 0;
  }

  writeUint32() {}
}

class Chip {
  // uf2: path; byte_ns: that a byte takes the host; addon: path of the bench (bench_for_node.c), and its options as
  // [name, value]; bridge: PWM_DIR or IN1_IN2; dead_time_s of the bridge, once in a PWM period; clock_error_ppm of the chip's clock;
  // wires: of a loop-back on a bare board, bits of WIRES; null: the board is on its bench
  constructor({ uf2, byte_ns, addon, options, bridge, dead_time_s, clock_error_ppm, wires }) {
    const given = Object.fromEntries(options);
    this.encoder = given.encoder === "1";
    if (!this.encoder && given["counts-max"] !== String(ADC_MAX)) throw new Error(`the chip's converter reads 0 to ${ADC_MAX}`);
    if (given["clock-start-us"] !== undefined && given["clock-start-us"] !== "0") throw new Error("the chip's clock starts at 0");
    this.flash = readUf2(uf2);
    this.bench = require(addon);
    this.motor = this.bench.make([...options, ["drive-counts", String(DRIVE_STEPS)]]);
    Object.assign(this, { bridge, byte_ns, dead_time_s, wires: wires ?? null });
    this.rate = 1 + 1e-6 * clock_error_ppm; // of the chip's clock, which counts `clock`'s nanoseconds
    this.clock = new SimulationClock();
    this.now_ns = 0;
    this.boot_until_ns = 0;
    this.toDevice = []; // [byte, arrives_ns]
    this.toHost = [];
    this.open = new Set(); // contacts
    this.resets = this.overruns = this.crashed = 0;
    this.brokenRule = "";
    this.shownSteps = this.encoder ? this.bench.encoder(this.motor)[0] : 0; // of the encoder, at its pins
    this.units = 0; // of DRIVE_STEPS
    this.pinChanged_ns = -1;
    this.conducts = 0; // the bridge, now: -1, 0, 1
    this.conductsFrom = this.longestPulse = 0; // cycles
    this.awake = this.longestTick = this.longestMask = 0; // cycles
    this.#start(CAUSES[1], 0);
    this.#paint();
  }

  #hold(kept, rule) {
    if (!kept && this.brokenRule === "") this.brokenRule = rule;
  }

  // ---- time: of the chip's clock, and the true one

  get #true_ns() {
    return this.clock.nanos / this.rate;
  }

  get #cycle() {
    return Math.round((this.clock.nanos - this.startedAt) * this.mcu.clkSys * 1e-9);
  }

  #advanceBench() {
    this.bench.advance(this.motor, this.#true_ns * 1e-9);
  }

  // ---- a reset

  #start(chipReset, watchdogReason) {
    for (let alarm = this.clock.nextAlarm; alarm; alarm = this.clock.nextAlarm) alarm.cancel();
    if (this.uart) this.overruns += this.uart.overruns;
    this.startedAt = this.clock.nanos;
    const mcu = (this.mcu = new RP2040(this.clock));
    mcu.flash.fill(0xff);
    mcu.flash.set(this.flash);
    mcu.logger = { debug() {}, info() {}, warn: (...words) => this.#log(words), error: (...words) => this.#log(words) };
    this.chipReset = chipReset;
    this.pendingReset = false;
    this.dead = 0; // interrupts that never come
    this.stalled = null;
    this.depth = []; // of interrupts: [number, cycles so far]
    this.debt = this.masked = 0; // cycles
    this.#connect(watchdogReason);
    this.ends = this.clock.createAlarm(() => this.#showEnds());
    this.#boot();
    this.#pinsChanged();
    if (this.encoder) {
      this.shaft = this.clock.createAlarm(() => this.#lookAtShaft());
      this.shaft.schedule(0);
    }
  }

  #log(words) {
    const text = words.join(": ");
    if (!text.includes("Watchdog")) this.#hold(false, text);
  }

  // What the chip's boot program does with a program in flash.
  #boot() {
    const { mcu } = this;
    const { core } = mcu;
    if (!boot2Fits(this.flash)) throw new Error("the program's first 256 bytes do not have their checksum: the chip would not start it");
    mcu.sram.set(this.flash.subarray(0, BOOT2_BYTES), BOOT2_AT - RAM);
    core.SP = BOOT2_AT;
    core.LR = 0;
    core.PC = BOOT2_AT;
    core.waiting = false;
  }

  #paint() {
    for (let at = 0; at < BOOT2_AT - RAM; at += 4) this.mcu.sramView.setUint32(at, PAINT, true);
  }

  #connect(watchdogReason) {
    const { mcu, clock } = this;
    const hold = (kept, rule) => this.#hold(kept, rule);
    const createAlarm = (callback) => clock.createAlarm(callback);
    this.uart = new Uart({
      createAlarm,
      hold,
      clock_hz: () => mcu.clkPeri,
      interrupt: (isOn) => mcu.setInterrupt(UART_IRQ, isOn),
      sends: (byte, time_ns) => {
        this.toHost.push([byte, (clock.nanos + time_ns) / this.rate]);
        this.lookAgain = true;
      },
    });
    this.adc = new Adc({ createAlarm, hold, sample: (channel) => this.#sample(channel) });
    this.pwm = new Pwm({
      hold,
      now: () => this.#cycle,
      changed: (cycle) => this.#levelsMayHaveChanged(cycle),
      skips: (cycles, period) => {
        if (this.pwm.at - cycles - this.conductsFrom < period) this.conductsFrom += cycles;
      },
    });
    this.conductsFrom = 0;
    this.pios = PIOS.map((at) => connectPio(mcu.peripherals[at], { hold, now: () => this.#cycle }));
    const watchdog = mcu.peripherals[WATCHDOG];
    watchdog.reason = watchdogReason;
    if (watchdogReason !== 0) watchdog.scratchData.set(this.scratch);
    this.scratch = watchdog.scratchData; // outlives a reset by the watchdog: 4.7.4
    watchdog.onWatchdogTrigger = () => {
      watchdog.alarm.enable = false;
      this.pendingReset = true;
    };
    Object.assign(mcu.peripherals, {
      [UART0]: this.uart,
      [ADC]: this.adc,
      [PWM]: this.pwm,
      [CHIP_RESET]: new ChipReset(this.chipReset),
    });
    this.#connectTimer();
    this.#connectResets();
    this.#connectPins();
    this.#connectCore();
  }

  // A reset sets the timer to 0; that of rp2040js is the clock that outlives it.
  #connectTimer() {
    const timer = this.mcu.peripherals[TIMER];
    const before_us = Math.floor(this.clock.nanos / 1000);
    const [read, write] = [timer.readUint32.bind(timer), timer.writeUint32.bind(timer)];
    timer.readUint32 = (offset) => (IS_TIME.has(offset) ? (read(offset) - before_us) >>> 0 : read(offset));
    timer.writeUint32 = (offset, value) => write(offset, IS_TIME.has(offset) ? (value + before_us) >>> 0 : value);
  }

  #connectResets() {
    const { mcu } = this;
    const resets = mcu.peripherals[RESETS];
    resets.reset = ALL_RESETS;
    const read = resets.readUint32.bind(resets);
    resets.readUint32 = (offset) => (offset === RESET_DONE ? ~read(RESET) & ALL_RESETS : read(offset));
    for (const [at, bit] of Object.entries(IN_RESET)) {
      const peripheral = mcu.peripherals[at];
      const write = peripheral.writeUint32.bind(peripheral);
      peripheral.writeUint32 = (offset, value) => {
        const isInReset = ((resets.reset >> bit) & 1) !== 0;
        this.#hold(!isInReset, "a register written while its peripheral is in reset, section 2.14");
        if (!isInReset) write(offset, value);
      };
    }
  }

  #connectPins() {
    const { mcu } = this;
    const pwmWrite = this.pwm.writeUint32.bind(this.pwm);
    this.pwm.writeUint32 = (offset, value) => {
      pwmWrite(offset, value);
      this.#pinsChanged();
    };
    const after = (part) => {
      const write = part.writeUint32.bind(part);
      part.writeUint32 = (offset, value) => {
        this.pwm.advance(this.#cycle);
        write(offset, value);
        this.#pinsChanged();
      };
    };
    after(mcu.peripherals[PADS_BANK0]);
    const io = mcu.peripherals[IO_BANK0];
    const ioWrite = io.writeUint32.bind(io);
    io.writeUint32 = (offset, value) => {
      this.pwm.advance(this.#cycle);
      ioWrite(offset, value);
      if (offset < 0xf0) this.#pinsChanged();
    };
    const { sio } = mcu;
    const sioWrite = sio.writeUint32.bind(sio);
    sio.writeUint32 = (offset, value) => {
      const isOutput = offset >= 0x10 && offset < 0x30;
      if (isOutput) this.pwm.advance(this.#cycle);
      sioWrite(offset, value);
      if (isOutput) this.#pinsChanged();
    };
  }

  #connectCore() {
    const { mcu } = this;
    const { core } = mcu;
    core.setInterrupt = (number, isOn) => {
      const bit = 1 << number;
      if (isOn && !(core.pendingInterrupts & bit)) {
        core.pendingInterrupts |= bit;
        core.interruptsUpdated = true;
      } else if (!isOn) {
        core.pendingInterrupts &= ~bit;
      }
    };
    const enter = core.exceptionEntry.bind(core);
    core.exceptionEntry = (number) => {
      this.debt += ENTRY_CYCLES;
      this.depth.push([number, 0]);
      enter(number);
    };
    const leave = core.exceptionReturn.bind(core);
    core.exceptionReturn = (how) => {
      this.debt += EXIT_CYCLES;
      const [number, cycles] = this.depth.pop() ?? [0, 0];
      if (number === 16 + TIMER_IRQ) this.longestTick = Math.max(this.longestTick, cycles + EXIT_CYCLES);
      leave(how);
    };
  }

  // ---- wire

  // The host sends bytes from now on.
  send(bytes) {
    for (const byte of bytes) {
      const last_ns = this.toDevice.length ? this.toDevice.at(-1)[1] : 0;
      this.toDevice.push([byte, Math.max(last_ns, this.now_ns) + this.byte_ns]);
    }
  }

  // What has arrived at the host by now.
  received() {
    const bytes = [];
    while (this.toHost.length > 0 && this.toHost[0][1] <= this.now_ns) bytes.push(this.toHost.shift()[0]);
    return Buffer.from(bytes);
  }

  // ---- converter

  #sample(channel) {
    this.#advanceBench();
    if (channel === 0) return this.bench.position(this.motor);
    if (channel === 1) return Math.max(this.bench.tachometer(this.motor), 0);
    if (channel === 2) return Math.min(Math.floor((this.bench.look(this.motor)[4] / SUPPLY_FULL_V) * ADC_MAX), ADC_MAX);
    return 0;
  }

  // ---- pins and bridge

  // 0 and 1: low and high, 2: whatever slice 0 makes of it, 3: the opposite of that. A pin that is no output is pulled down.
  #output(pin) {
    const gpio = this.mcu.gpio[pin];
    const { functionSelect, outputOverride } = gpio;
    if (functionSelect === NULL || gpio.outputDisable) return 0;
    const isSio = functionSelect === FUNCTION_SIO;
    if (isSio && !((this.mcu.sio.gpioOutputEnable >>> pin) & 1)) return 0;
    if (outputOverride > 1) return outputOverride - 2;
    if (isSio) return ((this.mcu.sio.gpioValue >>> pin) & 1) ^ outputOverride;
    return functionSelect === FUNCTION_PWM ? 2 + outputOverride : 0;
  }

  #level(pin) {
    const output = this.#output(pin);
    if (output < 2) return output;
    return Number(this.pwm.level[pin - PIN_A]) ^ (output - 2);
  }

  #duty(pin) {
    const output = this.#output(pin);
    if (output < 2) return output;
    const share = this.pwm.share(pin - PIN_A);
    return output === 2 ? share : 1 - share;
  }

  // How much of the supply the bridge passes, as shares of the pins or as levels.
  #passes(of) {
    const a = of(PIN_A);
    const b = of(PIN_B);
    return this.bridge === "PWM_DIR" ? (b > 0 ? -a : a) : a - b;
  }

  #levelsMayHaveChanged(cycle) {
    const now = this.#passes((pin) => this.#level(pin));
    if (now === this.conducts) return;
    if (this.conducts !== 0) this.longestPulse = Math.max(this.longestPulse, cycle - this.conductsFrom);
    this.conducts = now;
    this.conductsFrom = cycle;
  }

  // What dead time leaves of a duty.
  #conducted(duty) {
    const size = Math.abs(duty);
    if (this.dead_time_s === 0 || size === 0 || size === 1) return duty;
    return Math.sign(duty) * Math.max(size - (this.dead_time_s * this.mcu.clkSys) / (this.pwm.nextTop + 1), 0);
  }

  #pinsChanged() {
    this.#levelsMayHaveChanged(this.#cycle);
    const units = Math.round(this.#conducted(this.#passes((pin) => this.#duty(pin))) * DRIVE_STEPS);
    if (units !== this.units) {
      this.#advanceBench();
      this.bench.drive(this.motor, units);
      this.units = units;
      this.pinChanged_ns = this.#true_ns;
    }
    if (this.#output(PIN_LED) === 1) {
      this.#advanceBench();
      this.bench.arm(this.motor); // lit: armed
    }
    this.#tellContacts();
    this.#showEnds();
  }

  // The edges of the bridge's outputs go through the wires of a loop-back as they come. An end without one is pulled up.
  #showEnds() {
    if (this.wires === null) return;
    this.pwm.advance(this.#cycle);
    for (const [from, to, bit] of WIRES) {
      this.mcu.gpio[from].rawInputValue = this.#level(from) === 1; // a pin reads its own level
      this.#setInput(to, this.wires & bit ? this.#level(from) === 1 : this.mcu.gpio[to].pullupEnabled);
    }
    this.ends.cancel();
    const cycles = this.pwm.next - this.#cycle;
    if (cycles < Infinity) this.ends.schedule((Math.max(cycles, 1) * 1e9) / this.mcu.clkSys);
  }

  // A contact is closed to ground; an open one is pulled up where the pad does.
  #tellContacts() {
    if (this.wires !== null) {
      const isLow = (this.wires & ESTOP_WIRE_BIT) !== 0 && this.#isLowOutput(ESTOP_WIRE);
      for (const [name, [pin]] of Object.entries(CONTACTS)) {
        this.#setInput(pin, !(name === "e_stop" && isLow) && this.mcu.gpio[pin].pullupEnabled);
      }
      return;
    }
    const byBench = this.encoder ? this.bench.contacts(this.motor) : 0;
    for (const [name, [pin, bit]] of Object.entries(CONTACTS)) {
      const isOpen = this.open.has(name) || (byBench & bit) !== 0;
      this.#setInput(pin, isOpen && this.mcu.gpio[pin].pullupEnabled);
    }
  }

  #isLowOutput(pin) {
    const { sio, gpio } = this.mcu;
    const isOutput = gpio[pin].functionSelect === FUNCTION_SIO && ((sio.gpioOutputEnable >>> pin) & 1) !== 0;
    return isOutput && ((sio.gpioValue >>> pin) & 1) === 0;
  }

  #setInput(pin, isHigh) {
    const gpio = this.mcu.gpio[pin];
    if (isHigh === gpio.rawInputValue) return;
    for (const pio of this.pios) pio.advance();
    gpio.setInputValue(isHigh);
  }

  // Turns the encoder's pins by one edge, if the shaft has, and comes again when the next one is due.
  #lookAtShaft() {
    this.#advanceBench();
    const [steps, toNext, rate] = this.bench.encoder(this.motor);
    const behind = Math.abs(steps - this.shownSteps);
    this.shownSteps += Math.sign(steps - this.shownSteps);
    const levels = this.bench.levels(this.motor, this.shownSteps);
    CHANNELS.forEach((pin, bit) => this.#setInput(pin, ((levels >> bit) & 1) !== 0));
    this.#tellContacts();
    const due_ns = rate > 0 ? ((1e9 * toNext) / rate) * this.rate + 1 : Infinity;
    this.shaft.schedule(Math.min(due_ns, behind > 1 ? HAND_NS : LOOK_NS));
  }

  // ---- running

  // To until_ns of true time, or to what arrives at the host if that is sooner: until 1: a byte; 2: the end of a frame.
  run(until_ns, until) {
    for (;;) {
      const arrives = until && this.toHost.find(([byte]) => until === 1 || byte === 0);
      const stop_ns = arrives ? Math.min(until_ns, arrives[1]) : until_ns;
      if (this.now_ns < this.boot_until_ns) {
        this.#waitInBoot(stop_ns);
        if (stop_ns < this.boot_until_ns) return;
      }
      this.lookAgain = false;
      this.#runTo(stop_ns * this.rate);
      if (!this.lookAgain) {
        this.now_ns = Math.max(this.now_ns, stop_ns);
        this.#advanceBench();
        return;
      }
    }
  }

  // Pins float, bytes are lost.
  #waitInBoot(until_ns) {
    const end_ns = Math.min(until_ns, this.boot_until_ns);
    while (this.toDevice.length > 0 && this.toDevice[0][1] <= end_ns) this.toDevice.shift();
    this.now_ns = Math.max(this.now_ns, end_ns);
    this.clock.nanosCounter = Math.max(this.clock.nanosCounter, this.now_ns * this.rate);
    this.startedAt = this.clock.nanosCounter;
  }

  // In the chip's nanoseconds; stops early where lookAgain is set.
  #runTo(stop) {
    const { clock } = this;
    while (clock.nanos < stop && !this.lookAgain) {
      if (this.pendingReset) {
        this.resets++;
        this.#start(this.chipReset, 1);
      }
      if (this.toDevice.length > 0 && clock.nanos >= this.toDevice[0][1] * this.rate) {
        this.uart.receive(this.toDevice.shift()[0]);
      }
      this.#step(stop);
    }
  }

  #step(stop) {
    const { clock, mcu } = this;
    const { core } = mcu;
    const cycle_ns = 1e9 / mcu.clkSys;
    if (core.waiting) {
      if ((core.pendingInterrupts & core.enabledInterrupts) !== 0) {
        core.waiting = false;
        return;
      }
      let to = stop;
      if (this.toDevice.length > 0) to = Math.min(to, this.toDevice[0][1] * this.rate);
      if (clock.nextAlarm) to = Math.min(to, clock.nextAlarm.nanos);
      clock.tick(Math.max(1, Math.ceil((to - clock.nanos) / cycle_ns - 1e-6)) * cycle_ns); // on the grid of the cycles
      return;
    }
    if (this.stalled !== null) this.#stall();
    const cycles = core.executeInstruction() + this.debt;
    this.debt = 0;
    this.awake += cycles;
    if (this.depth.length > 0) this.depth.at(-1)[1] += cycles;
    if (core.PM) {
      this.masked += cycles;
      if (this.masked > this.longestMask) this.longestMask = this.masked;
    } else {
      this.masked = 0;
    }
    clock.tick(cycles * cycle_ns);
    if (this.dead !== 0) core.enabledInterrupts &= ~this.dead;
  }

  // ---- what may happen to it

  // By anything but the watchdog, which needs no help; then boot_s until the program begins.
  reset(cause, boot_s) {
    this.resets++;
    this.boot_until_ns = this.now_ns + 1e9 * boot_s;
    this.#start(CAUSES[cause], 0);
  }

  contact(name, isOpen) {
    if (isOpen) this.open.add(name);
    else this.open.delete(name);
    this.#tellContacts();
  }

  rewire(drive, sensor) {
    this.#advanceBench();
    this.bench.rewire(this.motor, drive, sensor);
  }

  place(y_rad, v_rad_per_s) {
    this.#advanceBench();
    this.bench.place(this.motor, y_rad, v_rad_per_s);
  }

  #trap() {
    for (let at = 0; at < BOOT2_AT - RAM; at += 2) {
      if (this.mcu.sramView.getUint16(at, true) === ENDLESS) return RAM + at;
    }
    throw new Error("the firmware has no endless loop to hang it in");
  }

  // The main loop stops, with interrupts ("everything") or without, or what it lives by: the tick's interrupt, the converter,
  // what counts the encoder.
  hang(what) {
    const { core } = this.mcu;
    if (what === "tick") {
      this.dead |= 1 << TIMER_IRQ;
      core.enabledInterrupts &= ~this.dead;
    } else if (what === "converter") {
      this.adc.is_dead = true;
      this.adc.ready = false;
      this.adc.done.cancel();
    } else if (what === "counter") {
      for (const pio of this.pios) pio.stop();
    } else {
      for (let i = 0; i < 100000 && (core.IPSR !== 0 || core.PM) && !core.waiting; i++) this.#step(Infinity);
      core.PC = this.#trap();
      core.waiting = false;
      core.PM = what === "everything";
      core.interruptsUpdated = true;
    }
  }

  // The main loop's next round, or the next tick, takes so much longer; interrupts go on.
  stall(what, ns) {
    this.stalled = { inTick: what === "tick", ns, trap: this.#trap() };
  }

  #stall() {
    const { stalled, clock } = this;
    const { core } = this.mcu;
    const isThere = core.IPSR === (stalled.inTick ? 16 + TIMER_IRQ : 0) && !core.PM && core.enabledInterrupts & (1 << TIMER_IRQ);
    if (stalled.until === undefined && isThere) {
      stalled.until = clock.nanos + stalled.ns;
      stalled.goesOn = core.PC;
      core.PC = stalled.trap;
    } else if (clock.nanos >= stalled.until && isThere && core.PC === stalled.trap) {
      core.PC = stalled.goesOn;
      this.stalled = null;
    }
  }

  // ---- what is true of it

  // Greatest depth of the stack since power on.
  stack_bytes() {
    const { sramView } = this.mcu;
    let [longest, length, end] = [0, 0, RAM_END - RAM];
    for (let at = 0; at < BOOT2_AT - RAM; at += 4) {
      length = sramView.getUint32(at, true) === PAINT ? length + 4 : 0;
      if (length > longest) [longest, end] = [length, at + 4];
    }
    return 0x40000 - end;
  }

  look() {
    const [pin_V, motor_V, y_rad, v_rad_per_s] = this.bench.look(this.motor);
    const us = (cycles) => (1e6 * cycles) / this.mcu.clkSys;
    return {
      t_s: this.now_ns * 1e-9,
      pin_V,
      motor_V,
      y_rad,
      v_rad_per_s,
      pin_changed_s: this.pinChanged_ns * 1e-9,
      awake_share: this.clock.nanos > 0 ? (this.awake * (1e9 / this.mcu.clkSys)) / this.clock.nanos : 0,
      masked_us: us(this.longestMask),
      tick_us: us(this.longestTick),
      led: this.#output(PIN_LED) === 1,
      resets: this.resets,
      overruns: this.overruns + this.uart.overruns,
    };
  }

  broken_rule() {
    return this.brokenRule;
  }

  // For which the bridge has conducted without a break, edge by edge, since the last call.
  longest_pulse_s() {
    const cycle = this.#cycle;
    this.pwm.advance(cycle);
    if (this.conducts !== 0) this.longestPulse = Math.max(this.longestPulse, cycle - this.conductsFrom);
    const longest = this.longestPulse;
    this.longestPulse = 0;
    return longest / this.mcu.clkSys;
  }
}

module.exports = { Chip };
