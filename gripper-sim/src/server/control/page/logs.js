"use strict";
// The system log, and the frames of all clients.
let entries = new Map();
const LEVELS = ["info", "warning", "error"];
function showEntry(entry) {
  if (LEVELS.indexOf(entry.severity) < LEVELS.indexOf($("severity").value)) return;
  append($("system_log"), item => {
    item.className = entry.severity;
    node(item, "span", { class: "when" }, `${entry.date.replace("T", " ").replace("Z", "")} ${entry.severity} `);
    node(item, "span", { class: "who" }, entry.source + ": ");
    node(item, "span", { class: "what" }, entry.text);
  });
}
function takeEntries({ entries: more }) {
  for (const entry of more) if (!entries.has(entry.number)) { entries.set(entry.number, entry); showEntry(entry); }
  for (const number of entries.keys()) { if (entries.size <= MAX_LINES) break; entries.delete(number); }
}
function showEntries() {
  $("system_log").replaceChildren();
  [...entries.values()].sort((one, next) => one.number - next.number).forEach(showEntry);
}
$("severity").addEventListener("change", showEntries);
onEvent.system_log.push(takeEntries);
onHello.push(async () => {
  entries = new Map();
  const answer = await ask("frame-message", "/log");
  if (!answer) return;
  // An event may have been faster than the answer.
  for (const entry of answer.entries) entries.set(entry.number, entry);
  showEntries();
});

let lines = [];
function showLine(line) {
  if (!line.toLowerCase().includes($("filter").value.toLowerCase())) return;
  append($("log"), item => {
    // Time, line, direction, bytes, meaning: the meaning first, the bytes below.
    const found = /^([\d.]+ s) (.*?) (->|<-) ((?:[0-9A-F?]{2} )+) *(.*)$/.exec(line);
    if (!found || !found[5]) return write(item, line);
    const [, when, who, direction, bytes, what] = found;
    node(item, "span", { class: "when" }, when + " ");
    node(item, "span", { class: "what" }, `${direction} ${what} `);
    node(item, "span", { class: "who" }, who);
    node(item, "span", { class: "bytes" }, bytes.trim());
  });
}
function showLines() { $("log").replaceChildren(); lines.forEach(showLine); }
$("filter").addEventListener("input", showLines);
$("pause").addEventListener("change", () => { if (!$("pause").checked) showLines(); });
$("clear").addEventListener("click", () => { lines = []; showLines(); });
onEvent.log.push(({ lines: more, lost }) => {
  const fresh = lost > 0 ? [...more, `${lost} lines are left out here`] : more;
  lines = [...lines, ...fresh].slice(-MAX_LINES);
  if (!$("pause").checked) fresh.forEach(showLine);
});

showPage();
watch();
