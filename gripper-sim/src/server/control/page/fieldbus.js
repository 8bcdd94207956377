"use strict";
// The fieldbus monitor: buses, data exchange, and both images as bytes, bits and values.
let registers = {}, exchanged = null;
onHello.push(() => { registers = {}; exchanged = null; for (const body of ["output_registers", "input_registers"]) $(body).replaceChildren(); });
const word = (bytes, at) => bytes[at] * 256 + bytes[at + 1];
const int = (bytes, at) => (word(bytes, at) << 16) >> 16;
const user = (name, byte) => [0, 1, 2, 3, 4, 5, 6, 7].filter(bit => byte >> bit & 1).map(bit => name + (bit + 1)).join(" ") || "none";

// Shows the registers of one image, and marks the one that changed last.
function image(body, table, time) {
  table.forEach(([name, value, raw], at) => {
    const key = body + name, before = registers[key];
    const isNew = before && before.raw !== raw;
    registers[key] = { raw, time: isNew ? time : before ? before.time : null };
    const row = $(body).children[at] || node($(body), "tr");
    [name, value, raw, registers[key].time === null ? "" : registers[key].time.toFixed(2) + " s"].forEach((cell, column) =>
      write(row.children[column] || node(row, "td"), cell));
  });
  const latest = Math.max(...table.map(([name]) => registers[body + name].time ?? -1));
  table.forEach(([name], at) => $(body).children[at].classList.toggle("changed", latest >= 0 && registers[body + name].time === latest));
}
onState.push((state, time) => {
  const { output, input, status, buses, exchange, master, profibus_master, outputs_received, watchdog_expired, watchdog_ms } = state.fieldbus;
  if (!exchanged || time - exchanged.time >= 1) {
    const rate = exchanged ? (outputs_received - exchanged.count) / (time - exchanged.time) : 0;
    exchanged = { time, count: outputs_received, rate };
  }
  pairs($("exchange"), [["state", buses.length ? exchange : "no fieldbus is enabled: see the settings"],
    ["master", (master || "none") + (profibus_master === null ? "" : ", PROFIBUS address " + profibus_master)],
    ["outputs received", `${outputs_received}, ${exchanged.rate.toFixed(1)} a second`],
    ["watchdog", `${watchdog_ms ? watchdog_ms + " ms for Modbus" : "off for Modbus"}, expired ${watchdog_expired} times`],
    ["damaged frames", state.clients.filter(client => /^(modbus|profibus|profinet|ethernetip)/.test(client.name)).reduce((sum, client) => sum + client.bad_checksums, 0)]]);
  rows($("buses"), buses.map(bus => [bus.bus, bus.line, ...[bus.address, bus.rate, bus.name].map(text => text || "none")]));
  show(shown.system, input[2] + input[3] * 2 ** 8 + input[4] * 2 ** 16 + input[5] * 2 ** 24);
  show(shown.command, output[0]);
  show(shown.gripper, input[0]);
  write($("output"), hex(output));
  write($("input"), hex(input));
  const raw = (bytes, from, to) => hex(bytes.slice(from, to + 1));
  image("output_registers", [["CMDFLAGS (0)", hello.names.command.filter((name, bit) => output[0] >> bit & 1).join(" ") || "none", raw(output, 0, 0)],
    ["IF (1)", user("IF", output[1]), raw(output, 1, 1)], ["WIDTH (2..3)", (int(output, 2) / 100).toFixed(2) + " mm", raw(output, 2, 3)],
    ["SPEED (4..5)", (word(output, 4) / 100).toFixed(2) + " mm/s", raw(output, 4, 5)],
    ["FORCELIMIT (6..7)", (int(output, 6) / hello.force_steps_per_n).toFixed(2) + " N", raw(output, 6, 7)]], time);
  image("input_registers", [["GSTATE (0)", hello.names.gripper.filter((name, bit) => input[0] >> bit & 1).join(" ") || "none", raw(input, 0, 0)],
    ["OF (1)", user("OF", input[1]), raw(input, 1, 1)], ["SYSSTATE (2..5)", state.system_state.length + " set", raw(input, 2, 5)],
    ["WIDTH (6..7)", (int(input, 6) / 100).toFixed(2) + " mm", raw(input, 6, 7)],
    ["FORCE (8..9)", (int(input, 8) / hello.force_steps_per_n).toFixed(2) + " N", raw(input, 8, 9)],
    ["STATUS (10..11)", `${word(input, 10)} ${status}`, raw(input, 10, 11)]], time);
});
