"use strict";

// What a peripheral of rp2040js is asked for: reads, and writes in their four ways (data sheet, 2.1.2).
class Peripheral {
  rawWriteValue = 0; // as written, before set, clear or toggle

  writeUint32Atomic(offset, value, way) {
    this.rawWriteValue = value;
    const before = way === 0 ? 0 : this.readUint32(offset);
    this.writeUint32(offset, [value, before ^ value, before | value, before & ~value][way] >>> 0);
  }
}

module.exports = { Peripheral };
