"use strict";
// Scripts: the folder, the source, the run and its output.
let scriptLines = new Map(), isSaved = true;
const chosenScript = () => $("script-list").value;

function showScripts(answer) {
  const before = chosenScript();
  write($("script-folder"), answer.folder === null ? "Start wsg-sim with --scripts FOLDER to use scripts here." : answer.folder);
  $("script-list").replaceChildren();
  for (const { name, bytes } of answer.list) {
    const isStart = name === answer.start_up;
    node($("script-list"), "option", { value: name }, `${name}, ${bytes} bytes${isStart ? ", runs at the start" : ""}`);
  }
  $("script-list").value = before;
  $("script-start").checked = answer.start_up !== null && answer.start_up === before;
  for (const line of answer.output) scriptLines.set(line.number, line);
  $("script-output").replaceChildren();
  [...scriptLines.values()].sort((one, next) => one.number - next.number).forEach(showOutput);
  showLatest(answer.latest);
  startUp = answer.start_up;
}
let startUp = null;
function showOutput({ text }) { append($("script-output"), item => write(item, text || " ")); }
// An answer may arrive after an event that is newer.
let shownRevision = 0;
function showLatest({ revision, name, state, error, line }) {
  if (revision < shownRevision) return;
  shownRevision = revision;
  write($("script-state"), name ? `${name}: ${state}${error ? ", " + error : ""}` : "no script has run");
  $("script-state").classList.toggle("refused", state === "failed");
  // Selects the line of the error in the source that is shown.
  if (line && name === $("script-name").value && document.activeElement !== $("script-source")) {
    const source = $("script-source").value.split("\n"), from = source.slice(0, line - 1).join("\n").length + (line > 1 ? 1 : 0);
    $("script-source").setSelectionRange(from, from + (source[line - 1] || "").length);
  }
}
// An answer that an answer to a later request has overtaken is not shown.
let scriptRequests = 0;
async function askScripts(body) {
  const mine = ++scriptRequests, answer = await ask("script-message", "/scripts", body);
  if (answer && mine === scriptRequests) showScripts(answer);
  return answer;
}
async function act(action, more) {
  const answer = await askScripts({ action, ...more });
  if (answer) say("script-message", "");
  return answer;
}
async function openScript() {
  const name = chosenScript();
  if (!name || (!isSaved && !confirm("Discard the changes of the source?"))) return;
  const answer = await act("read", { name });
  if (!answer) return;
  $("script-name").value = name;
  $("script-source").value = answer.source;
  isSaved = true;
}
$("script-list").addEventListener("change", openScript);
$("script-source").addEventListener("input", () => { isSaved = false; });
$("script-save").addEventListener("click", async () => {
  const name = $("script-name").value.trim();
  if (!await act("save", { name, source: $("script-source").value })) return;
  isSaved = true;
  $("script-list").value = name;
  $("script-start").checked = startUp === name;
  say("script-message", name + " is saved.");
});
// Runs what is saved: the source shown is saved first.
$("script-run").addEventListener("click", async () => {
  if (!isSaved) { $("script-save").click(); return say("script-message", "The source is saved first. Press Run again."); }
  scriptLines = new Map();
  await act("run", { name: chosenScript() });
});
$("script-stop").addEventListener("click", () => act("stop"));
$("script-delete").addEventListener("click", () => { if (confirm(`Delete ${chosenScript()}?`)) act("delete", { name: chosenScript() }); });
$("script-start").addEventListener("change", () => act("start_up", $("script-start").checked ? { name: chosenScript() } : {}));
$("script-file").addEventListener("change", async () => {
  const file = $("script-file").files[0];
  if (!file) return;
  $("script-name").value = file.name;
  $("script-source").value = await file.text();
  isSaved = false;
  $("script-save").click();
});
onEvent.script.push(({ latest, lines: more }) => {
  for (const line of more) if (!scriptLines.has(line.number)) { scriptLines.set(line.number, line); showOutput(line); }
  showLatest(latest);
});
onHello.push(async () => {
  scriptLines = new Map(); shownRevision = 0;
  await askScripts();
});

