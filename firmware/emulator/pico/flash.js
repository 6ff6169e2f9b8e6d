"use strict";

const fs = require("fs");

const BLOCK = 512;
const [MAGIC_0, MAGIC_1, MAGIC_END] = [0x0a324655, 0x9e5d5157, 0x0ab16f30];
const RP2040_FAMILY = 0xe48bff56;
const FLASH = 0x10000000;
const BOOT2_BYTES = 256;

// What the boot program writes to the flash of a file in the form UF2, as bytes from the flash's beginning.
function readUf2(path) {
  const file = fs.readFileSync(path);
  const parts = [];
  for (let at = 0; at + BLOCK <= file.length; at += BLOCK) {
    const word = (index) => file.readUInt32LE(at + 4 * index);
    const isRight = word(0) === MAGIC_0 && word(1) === MAGIC_1 && file.readUInt32LE(at + BLOCK - 4) === MAGIC_END;
    if (!isRight || word(7) !== RP2040_FAMILY) throw new Error(`${path}: no UF2 file for an RP2040`);
    parts.push([word(3) - FLASH, file.subarray(at + 32, at + 32 + word(4))]);
  }
  if (parts.length === 0) throw new Error(`${path}: an empty file`);
  const flash = new Uint8Array(Math.max(...parts.map(([at, bytes]) => at + bytes.length))).fill(0xff);
  for (const [at, bytes] of parts) flash.set(bytes, at);
  return flash;
}

// Whether the first 256 bytes end with the checksum of the others, without which the chip starts nothing: 2.8.1.
function boot2Fits(flash) {
  let crc = 0xffffffff;
  for (const byte of flash.subarray(0, BOOT2_BYTES - 4)) {
    crc ^= byte << 24;
    for (let bit = 0; bit < 8; bit++) crc = crc < 0 ? (crc << 1) ^ 0x04c11db7 : crc << 1;
  }
  return new DataView(flash.buffer, flash.byteOffset).getUint32(BOOT2_BYTES - 4, true) === crc >>> 0;
}

module.exports = { readUf2, boot2Fits, BOOT2_BYTES };
