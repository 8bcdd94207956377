"use strict";
// Settings: the table of the server, one field for each row.
let settings = [], settingsRevision = 0, isApplying = false;
const plain = text => text.replaceAll("\x60", "").replace(/ ?\(\[[^\]]*\]\([^)]*\)\)|; \[[^\]]*\]\([^)]*\) has the figures/g, "");
const ACRONYMS = { tcp: "TCP", udp: "UDP", gcl: "GCL", can: "CAN", slcan: "SLCAN", profibus: "PROFIBUS", profinet: "PROFINET", ethernetip: "EtherNet/IP", ip: "IP", im: "I&M" };
const title = name => {
  const words = name.split("-").map(word => ACRONYMS[word] || word).join(" ");
  return words.charAt(0).toUpperCase() + words.slice(1);
};

function field(row, place) {
  const id = "set-" + row.name, box = node(place, "div", { class: "setting" });
  node(box, "label", { for: id }, title(row.name));
  const line = node(box, "div", { class: "value" });
  let input;
  if (row.kind === "choice") {
    input = node(line, "select", { id });
    node(input, "option", { value: "" }, row.default ? "default: " + row.default : "default");
    for (const choice of row.choices) node(input, "option", { value: choice }, choice);
    input.value = row.value ?? "";
  } else if (row.kind === "switch") {
    input = node(line, "input", { id, type: "checkbox" });
    input.checked = row.value;
  } else {
    input = node(line, "input", { id, type: "text", placeholder: plain(row.default) || "none", spellcheck: "false" });
    input.value = row.kind === "list" ? (row.value || []).join(", ") : row.value ?? "";
    if (row.unit) node(line, "span", { class: "name" }, row.unit);
  }
  input.setAttribute("aria-describedby", id + "-about");
  const about = node(box, "p", { class: "name", id: id + "-about" }, `${plain(row.meaning)}${row.expected ? "; " + row.expected : ""}. Takes effect ${row.effect}.`);
  if (row.pending) node(about, "span", { class: "pending" }, " Waits for a restart.");
  const first = valueOf(row, input);
  input.addEventListener("input", () => input.classList.toggle("dirty", JSON.stringify(valueOf(row, input)) !== JSON.stringify(first)));
  return input;
}
function valueOf(row, input) {
  if (row.kind === "switch") return input.checked;
  const text = input.value.trim();
  if (!text) return null;
  return row.kind === "list" ? text.split(",").map(part => part.trim()).filter(part => part) : text;
}
function showSettings(answer) {
  const form = $("settings-form"), open = [...form.querySelectorAll("details[open]")].map(group => group.dataset.group);
  settings = answer.settings;
  settingsRevision = answer.revision;
  form.replaceChildren();
  answer.groups.forEach((name, at) => {
    const group = node(form, "details", { "data-group": name });
    group.open = open.length ? open.includes(name) : at === 0;
    node(group, "summary", {}, name);
    const place = node(group, "div", { class: "settings" });
    for (const row of settings) if (row.group === name) row.input = field(row, place);
  });
  write($("saved"), (answer.file ? "Changes are saved in " + answer.file + "." : "Changes are not saved: start with --config FILE to keep them.")
    + (answer.restart_pending ? " Some settings wait for a restart." : ""));
}
async function loadSettings() {
  const answer = await ask("settings-message", "/settings");
  if (answer) showSettings(answer);
}
$("settings-form").addEventListener("submit", async event => {
  event.preventDefault();
  const changed = settings.filter(row => row.input.classList.contains("dirty"));
  if (!changed.length) return say("settings-message", "Nothing has changed.");
  isApplying = true;
  const answer = await ask("settings-message", "/settings", Object.fromEntries(changed.map(row => [row.name, valueOf(row, row.input)])));
  isApplying = false;
  if (!answer) return;
  showSettings(answer);
  say("settings-message", `${changed.map(row => title(row.name)).join(", ")}: changed.`);
});
$("undo").addEventListener("click", () => { say("settings-message", ""); loadSettings(); });
$("restart").addEventListener("click", async () => { if (await ask("settings-message", "/restart", {})) say("settings-message", "The gripper restarts."); });
onHello.push(loadSettings);
// Another page or a program has changed them.
onEvent.settings.push(({ revision }) => {
  if (isApplying || revision <= settingsRevision) return;
  if (!$("settings-form").querySelector(".dirty")) return loadSettings();
  say("settings-message", "The settings have changed elsewhere. Undo shows them.", true);
});
