"use strict";

const [IRQ0_INTE, IRQ1_INTS] = [0x12c, 0x140];
const [SM0_CLKDIV, SM_BYTES, SMS_END] = [0xc8, 0x18, 0x128];
const FULL_SPEED = 0x10000;
const LONGEST_ROUND = 32; // instructions: as many as there are

function stateOf(machine) {
  const { pc, x, y, inputShiftReg, inputShiftCount, outputShiftReg, outputShiftCount, rxFIFO, txFIFO, pio } = machine;
  const words = [rxFIFO.itemCount, txFIFO.itemCount, pio.irq];
  return [pc, x, y, inputShiftReg, inputShiftCount, outputShiftReg, outputShiftCount, ...words];
}

// Steps a machine while its pins stay as they are. Rounds that change nothing are passed over: they are all alike.
function run(machine, cycles) {
  let left = cycles;
  let [before, round] = [null, 0];
  while (left > 0) {
    if (before === null || round === LONGEST_ROUND) [before, round] = [stateOf(machine), 0];
    machine.step();
    left--;
    round++;
    if (machine.pc === before[0] && stateOf(machine).every((value, i) => value === before[i])) left %= round;
  }
}

// Has rp2040js's PIO run on the cycles of the system clock, up to now() whenever the program looks at it or a pin changes. Its
// machines see pins and FIFOs; what else they can do is a broken rule: interrupts, waiting, outputs, a divider of the clock.
function connectPio(pio, { now, hold }) {
  let at = now();
  let isStopped = false;
  const advance = () => {
    const cycles = now() - at;
    at += cycles;
    if (cycles <= 0 || isStopped) return;
    for (const machine of pio.machines) {
      if (!machine.enabled) continue;
      run(machine, cycles);
      hold(!machine.waiting, "a state machine that waits, which this emulator does not have");
    }
    hold(pio.pinDirections === 0, "a state machine that drives a pin, which this emulator does not have");
  };
  const [read, write] = [pio.readUint32.bind(pio), pio.writeUint32.bind(pio)];
  pio.run = () => {}; // outside of time
  pio.readUint32 = (offset) => {
    advance();
    return read(offset);
  };
  pio.writeUint32 = (offset, value) => {
    advance();
    const isDivider = offset >= SM0_CLKDIV && offset < SMS_END && (offset - SM0_CLKDIV) % SM_BYTES === 0;
    hold(!isDivider || value === FULL_SPEED, "a PIO divider that this emulator does not have");
    hold(offset < IRQ0_INTE || offset > IRQ1_INTS, "an interrupt of a PIO, which this emulator does not have");
    write(offset, value);
  };
  return { advance, stop: () => (isStopped = true) };
}

module.exports = { connectPio };
