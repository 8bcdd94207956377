"use strict";
// The command editor: the server converts the input, so that the page and `wsg` accept the same language.
let frames = new Map(), chosen = null, asked = 0;
const frameOf = send => ({ command: $("frame-command").value, payload: $("frame-payload").value, send });
async function preview() {
  const mine = ++asked, isWanted = () => mine === asked;
  const answer = await ask("frame-message", "/frame", frameOf(false), isWanted);
  // An answer to an earlier input is not shown.
  if (!isWanted()) return;
  write($("packet"), answer ? hex(answer.bytes) : "");
  if (answer) say("frame-message", answer.meaning);
}
let typed = 0;
for (const id of ["frame-command", "frame-payload"])
  $(id).addEventListener("input", () => { clearTimeout(typed); typed = setTimeout(preview, 150); });
$("frame-form").addEventListener("submit", async event => {
  event.preventDefault();
  // A preview must not replace the answer.
  clearTimeout(typed); asked++;
  const answer = await ask("frame-message", "/frame", frameOf(true));
  if (answer) { write($("packet"), hex(answer.bytes)); say("frame-message", answer.meaning + ": sent"); }
});
function takeFrame(frame) {
  if (frames.has(frame.number)) return;
  frames.set(frame.number, frame);
  showFrame(frame);
}
function showFrame(frame) {
  append($("frames"), item => {
    const button = node(item, "button", { type: "button", "aria-pressed": "false" });
    node(button, "span", { class: "when" }, `${frame.time_s.toFixed(3)} s `);
    node(button, "span", { class: "what" }, `${frame.direction} ${frame.meaning}`);
    node(button, "span", { class: "bytes" }, hex(frame.bytes));
    button.addEventListener("click", () => {
      for (const other of document.querySelectorAll("#frames button")) other.setAttribute("aria-pressed", String(other === button));
      chosen = frame;
      // The payload, without its checksum; of an answer without the status.
      const end = frame.bytes.length - 3, first = frame.direction === "->" ? 6 : 8;
      for (const id of ["from", "to"]) $(id).max = frame.bytes.length - 1;
      $("from").value = first <= end ? first : 0;
      $("to").value = first <= end ? end : 0;
      readAs();
    });
  });
}
function readAs() {
  if (!chosen) return;
  const from = $("from").valueAsNumber || 0, to = Math.max(from, $("to").valueAsNumber || 0), bytes = chosen.bytes.slice(from, to + 1);
  write($("chosen"), hex(bytes) || "none");
  const whole = bytes.slice(0, 6).reduce((sum, byte, at) => sum + byte * 256 ** at, 0), size = 256 ** bytes.length;
  const integer = bytes.length < 1 || bytes.length > 6 ? "up to 6 bytes" : `${whole}, signed ${whole >= size / 2 ? whole - size : whole}`;
  const float = bytes.length === 4 ? String(Number(new DataView(Uint8Array.from(bytes).buffer).getFloat32(0, true).toPrecision(7))) : "4 bytes";
  const text = bytes.map(byte => byte >= 32 && byte < 127 ? String.fromCharCode(byte) : ".").join("");
  pairs($("read-as"), [["integer", integer], ["float", float], ["text", text]]);
}
for (const id of ["from", "to"]) $(id).addEventListener("input", readAs);
onEvent.editor.push(({ frames: more }) => more.forEach(takeFrame));
onHello.push(async () => {
  frames = new Map(); chosen = null;
  $("frames").replaceChildren();
  $("commands").replaceChildren();
  for (const [id, name] of hello.commands) node($("commands"), "option", { value: name }, "0x" + id.toString(16).toUpperCase().padStart(2, "0"));
  preview();
  const answer = await ask("frame-message", "/frames");
  if (!answer) return;
  // An event may have been faster than the answer.
  for (const frame of answer.frames) frames.set(frame.number, frame);
  $("frames").replaceChildren();
  [...frames.values()].sort((one, next) => one.number - next.number).forEach(showFrame);
});
