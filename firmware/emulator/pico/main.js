"use strict";

// One chip for a parent process, or one after the other: a line of JSON with its parameters, those of ``pico_parameters``,
// makes a new one; then a line for each stretch of virtual time
//     {send: hex, calls: [[method, ...arguments]], until_ns, until}
// answered by {received: hex, now_ns, results: [of the calls, which come after the stretch]}, or {error}.
// Ends with its standard input. Its argument is the file of another chip than the Pico's.
const fs = require("fs");
const { Chip } = require(process.argv[2] ?? "./chip.js");

function* lines() {
  const chunk = Buffer.alloc(65536);
  let text = "";
  for (let n; (n = fs.readSync(0, chunk)) > 0; ) {
    text += chunk.toString("utf8", 0, n);
    for (let end; (end = text.indexOf("\n")) >= 0; text = text.slice(end + 1)) yield JSON.parse(text.slice(0, end));
  }
}

let chip = null;

function answer(asked) {
  if (asked.command !== undefined) {
    chip = null;
    chip = new Chip(asked);
    return {};
  }
  chip.send(Buffer.from(asked.send, "hex"));
  if (asked.until_ns !== null) chip.run(asked.until_ns, asked.until);
  const results = asked.calls.map(([method, ...given]) => chip[method](...given) ?? null);
  return { received: chip.received().toString("hex"), now_ns: chip.now_ns, results };
}

for (const asked of lines()) {
  let said;
  try {
    said = answer(asked);
  } catch (error) {
    said = { error: error.message };
  }
  fs.writeSync(1, JSON.stringify(said) + "\n");
}
