"use strict";
const $ = id => document.getElementById(id);
const SVG = "http://www.w3.org/2000/svg";
// The gripper reports its state at least every half a second.
const SILENT_MS = 3000;
const MAX_LINES = 500;
let hello = null, now = 0, seenAt = 0;
// What the parts of the page do with the first data, with each state, and with each kind of event.
const onHello = [], onState = [], onEvent = { log: [], system_log: [], editor: [], script: [] };

function node(parent, kind, attributes, text) {
  const made = parent instanceof SVGElement ? document.createElementNS(SVG, kind) : document.createElement(kind);
  for (const [name, value] of Object.entries(attributes || {})) made.setAttribute(name, value);
  if (text !== undefined) made.textContent = text;
  parent.append(made);
  return made;
}
// Sets a text only if it differs, so that a screen reader and a selection are not disturbed.
function write(element, text) {
  if (element.textContent !== String(text)) element.textContent = text;
}
function say(place, text, refused) {
  write($(place), text);
  $(place).classList.toggle("refused", Boolean(refused));
}

// Sends a request. Returns the answer, or null after it has shown why there is none.
async function ask(place, path, body) {
  try {
    const answer = await fetch(path, body === undefined ? {} : { method: "POST", body: JSON.stringify(body) });
    const value = await answer.json();
    if (answer.ok) return value;
    say(place, value.error, true);
  } catch {
    say(place, "the gripper does not answer", true);
  }
  return null;
}

// A list of bits by their names; those without one are reserved.
function bits(list, names, bad) {
  list.replaceChildren();
  return names.map((name, bit) => {
    if (!name) return null;
    const item = node(list, "li", { title: "bit " + bit }, name);
    if (bad && bad.includes(name)) item.classList.add("bad");
    return { item, value: node(item, "span", { class: "hidden" }, " 0") };
  });
}
function show(shown, value) {
  shown.forEach((bit, at) => {
    if (!bit) return;
    const on = Math.floor(value / 2 ** at) % 2 === 1;
    bit.item.classList.toggle("on", on);
    write(bit.value, on ? " 1" : " 0");
  });
}
function pairs(list, entries) {
  if (list.childElementCount !== 2 * entries.length) {
    list.replaceChildren();
    for (const [name] of entries) { node(list, "dt", {}, name); node(list, "dd"); }
  }
  entries.forEach(([, value], at) => write(list.children[2 * at + 1], value));
}
// Table rows of texts; a label in each cell serves narrow windows.
function rows(body, table, labels) {
  while (body.children.length > table.length) body.lastChild.remove();
  table.forEach((cells, at) => {
    const row = body.children[at] || node(body, "tr");
    cells.forEach((cell, column) => {
      const place = row.children[column] || node(row, "td", labels ? { "data-label": labels[column] } : {});
      write(place, cell);
    });
  });
}
const hex = bytes => bytes.map(byte => byte.toString(16).toUpperCase().padStart(2, "0")).join(" ");
// Appends an item to a list that is bounded, and keeps its end in view if it was.
function append(list, make) {
  const atEnd = list.scrollTop + list.clientHeight >= list.scrollHeight - 20;
  make(node(list, "li"));
  while (list.children.length > MAX_LINES) list.firstChild.remove();
  if (atEnd) list.scrollTop = list.scrollHeight;
}

// Shows the page that the address names, so that it can be linked and reloaded.
const pages = [...document.querySelectorAll("main")];
function showPage() {
  const wanted = pages.find(page => "#" + page.dataset.page === location.hash) || pages[0];
  for (const page of pages) page.hidden = page !== wanted;
  for (const link of document.querySelectorAll("nav a")) {
    if (link.hash === "#" + wanted.dataset.page) link.setAttribute("aria-current", "page");
    else link.removeAttribute("aria-current");
  }
  scrollTo(0, 0);
}
addEventListener("hashchange", showPage);

function isGone() {
  write($("state"), "no connection");
  document.body.classList.remove("fast-stopped", "failed");
}
function take({ time_s, state }) {
  now = time_s;
  seenAt = performance.now();
  const fastStopped = state.system_state.includes("FAST_STOP");
  document.body.classList.toggle("fast-stopped", fastStopped);
  document.body.classList.toggle("failed", state.gripper_state === "ERROR");
  write($("state"), (fastStopped ? "FAST STOP, " : "") + state.gripper_state);
  write($("time"), time_s.toFixed(1) + " s");
  const name = hello.model + (hello.tag ? " " + hello.tag : "");
  if (document.title !== `${name}: ${$("state").textContent}`) document.title = `${name}: ${$("state").textContent}`;
  for (const act of onState) act(state, time_s);
}
function watch() {
  const events = new EventSource("/events");
  events.addEventListener("hello", event => {
    hello = JSON.parse(event.data);
    write($("model"), hello.model + (hello.tag ? " " + hello.tag : ""));
    for (const act of onHello) act();
  });
  events.addEventListener("state", event => take(JSON.parse(event.data)));
  for (const [kind, acts] of Object.entries(onEvent))
    events.addEventListener(kind, event => { for (const act of acts) act(JSON.parse(event.data)); });
  events.addEventListener("error", () => {
    isGone();
    // The browser reconnects by itself unless it was rejected, for example because 64 other pages are open.
    if (events.readyState === EventSource.CLOSED) setTimeout(watch, SILENT_MS);
  });
}
setInterval(() => { if (seenAt && performance.now() - seenAt > SILENT_MS) isGone(); }, 100);
