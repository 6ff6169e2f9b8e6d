"use strict";

// One chip for a parent process, or one after the other: a line of JSON with its parameters, those with a program, makes
// a new one; then a line for each stretch of virtual time
//     {until_ns, until_byte, send: hex, happens: [name of a method of the chip]}
// answered by a line {received: hex, ...what there is to look at}. Ends with its standard input.
const fs = require("fs");
const { Chip } = require("./chip.js");

function* lines() {
  const chunk = Buffer.alloc(65536);
  let text = "";
  for (let n; (n = fs.readSync(0, chunk)) > 0; ) {
    text += chunk.toString("utf8", 0, n);
    for (let end; (end = text.indexOf("\n")) >= 0; text = text.slice(end + 1)) yield JSON.parse(text.slice(0, end));
  }
}

let chip = null;
for (const asked of lines()) {
  if (asked.hex !== undefined) {
    chip = new Chip(asked);
    continue;
  }
  for (const what of asked.happens) chip[what]();
  chip.send(Buffer.from(asked.send, "hex"));
  chip.run(asked.until_ns, asked.until_byte);
  fs.writeSync(1, JSON.stringify({ received: chip.received().toString("hex"), ...chip.look() }) + "\n");
}
