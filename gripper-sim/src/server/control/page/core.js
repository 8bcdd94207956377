"use strict";
const $ = id => document.getElementById(id);
const SVG = "http://www.w3.org/2000/svg";
// The gripper reports its state at least every 200 ms. A state that is older than a second is not shown as current.
const SILENT_MS = 1000;
// A request without an answer is withdrawn. A FAST STOP is then sent on another way.
const ANSWER_MS = 1000, FILE_MS = 4000;
const RETRY_MS = 1000, RECONNECT_MS = 3000, LATE_MS = 10000;
const MAX_LINES = 500;
let hello = null, now = 0;
// What the parts of the page do with the first data, with each state, with each state that is drawn, and with each kind of event.
const onHello = [], onSample = [], onState = [], onEvent = { log: [], system_log: [], editor: [], script: [], settings: [] };

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

// Closes the stream of events; null without one.
let closeStream = null, streams = false, openedAt = -RECONNECT_MS;
// The state that the page shows, as the gripper names it: each request carries it, and an old one is refused.
let asOf = null;

const isStop = name => name === "stop" || name === "fast_stop";
async function send(path, body) {
  if (path === "/command") body.key = Math.floor(Math.random() * Number.MAX_SAFE_INTEGER);
  const abort = new AbortController();
  // The server reads or writes files for some requests. Nothing is executed late for a preview.
  const isLong = body === undefined || path === "/settings" || path === "/scripts" || body?.send === false;
  const end = setTimeout(() => abort.abort(), isLong ? FILE_MS : ANSWER_MS);
  const answer = await request(path, body, abort.signal);
  clearTimeout(end);
  abort.abort();
  // The next state is drawn: it shows what was executed, or that an input was refused.
  shownText = "";
  // The answer to a command is a newer state than the page shows.
  if (answer.body && answer.body.as_of) asOf = answer.body.as_of;
  return answer;
}
const silence = isRefusedLater => "the gripper does not answer" + (isRefusedLater ? ", and will not execute this later" : "");
// Sends a request. Returns the answer, or null after it has shown why there is none. A request that changes nothing is repeated
// until it is answered, while isWanted() holds: a request without a body while the page is connected to the same gripper.
async function ask(place, path, body, isWanted) {
  const known = hello;
  if (body === undefined) isWanted = () => hello === known;
  for (let isRepeated = false; ; isRepeated = true) {
    const { status, body: value } = await send(path, body);
    if (isWanted && !isWanted()) return null;
    if (status === 200) {
      if (isRepeated) say(place, "");
      return value;
    }
    say(place, status ? value.error : silence(!isWanted), true);
    if (status || !isWanted) return null;
    await new Promise(done => setTimeout(done, RETRY_MS));
    if (!isWanted()) return null;
  }
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

// When the shown state was true, by the clock of this page and by that of its computer, which continues during sleep.
let seenAt = null, seenDate = 0, isLost = true;
const age = () => seenAt === null ? Infinity : Math.max(performance.now() - seenAt, Date.now() - seenDate);
const isFresh = () => !isLost && age() <= SILENT_MS;
// The least difference seen between this clock and the gripper's, in ms. It may grow slowly, because clocks drift.
let least = Infinity, takenAt = 0;
const DRIFT = 0.0005;
// What the parts of the page do when the state is no longer current.
const onGone = [];

function isGone() {
  isLost = true;
  if (!document.body.classList.contains("stale")) {
    document.body.classList.add("stale");
    document.body.classList.remove("fast-stopped", "failed");
    write($("state"), "no connection");
    for (const act of onGone) act();
    showTitle();
  }
  shownText = "";
  if (seenAt !== null) write($("time"), `${now.toFixed(1)} s, ${Math.floor(age() / 1000)} s ago`);
}
// The title of a hidden page has no state: its browser would not let it stay current.
function showTitle() {
  const name = hello ? hello.model + (hello.tag ? " " + hello.tag : "") : "wsg-sim";
  const title = document.hidden ? name : `${name}: ${$("state").textContent}`;
  if (document.title !== title) document.title = title;
}
function take({ time_s, as_of, state }) {
  const at = performance.now(), offset = at - time_s * 1000;
  least = Math.min(least + DRIFT * (at - takenAt), offset);
  takenAt = at;
  // A state that was late is as old as its delay.
  seenAt = at - (offset - least);
  seenDate = Date.now() - (offset - least);
  now = time_s;
  asOf = as_of;
  isLost = false;
  if (!isFresh()) return isGone();
  for (const act of onSample) act(state, time_s);
  // A state without news is drawn once a second, for the time.
  const text = JSON.stringify(state);
  if (text === shownText && Math.abs(now - shownAt) < 0.9) return;
  shownText = text;
  shownAt = now;
  // Only the latest state of each frame is drawn, so that many windows leave time for clicks.
  if (latest === null) requestAnimationFrame(drawLatest);
  latest = state;
}
// The latest state, until it is drawn. It stays as text, with its time.
let latest = null, shownText = "", shownAt = 0;
function drawLatest() {
  const state = latest;
  latest = null;
  if (!isFresh()) return isGone();
  document.body.classList.remove("stale");
  const fastStopped = state.system_state.includes("FAST_STOP");
  document.body.classList.toggle("fast-stopped", fastStopped);
  document.body.classList.toggle("failed", state.gripper_state === "ERROR");
  write($("state"), (fastStopped ? "FAST STOP, " : "") + state.gripper_state);
  write($("time"), now.toFixed(1) + " s");
  showTitle();
  for (const act of onState) act(state, now);
}
function takeHello(data) {
  hello = data;
  shownText = "";
  least = Infinity;
  write($("model"), hello.model + (hello.tag ? " " + hello.tag : ""));
  write($("refusal"), "");
  for (const act of onHello) act();
}
const onMessage = { hello: takeHello, state: take };
for (const [kind, acts] of Object.entries(onEvent)) onMessage[kind] = data => { for (const act of acts) act(data); };

// Shows why the stream of events does not open.
async function explain() {
  const { status, body } = await send("/events", {});
  if (!status || streams) return;
  write($("refusal"), status === 200 ? "The server is there, but no WebSocket opens: a proxy must forward the headers Upgrade and Connection." : body.error);
}
function connect() {
  openedAt = performance.now();
  streams = false;
  closeStream = stream((kind, data) => { streams = true; onMessage[kind](data); }, hasOpened => {
    closeStream = null;
    streams = false;
    isGone();
    if (!hasOpened) explain();
  });
}
// A timer of a hidden page is late, so the same happens when it is shown again.
function check() {
  const since = performance.now() - openedAt;
  if (!isFresh()) isGone();
  const silent = Math.min(since, performance.now() - takenAt), late = Math.min(since, age());
  if (closeStream !== null && (silent > RECONNECT_MS || late > LATE_MS)) {
    // The other end may not be there any more, or its clock was stopped. A busy computer alone is no reason.
    closeStream();
    closeStream = null;
  }
  if (closeStream === null && since > RETRY_MS) connect();
}
function watch() {
  connect();
  setInterval(check, 100);
  // A hidden page is not drawn. It is shown again with old values, and draws new ones in the next frame.
  document.addEventListener("visibilitychange", () => { if (document.hidden) isGone(); showTitle(); check(); });
  addEventListener("pageshow", check);
  // A page that a browser keeps and shows again must not begin with old values.
  for (const sleep of ["pagehide", "freeze"]) (sleep === "freeze" ? document : window).addEventListener(sleep, isGone);
}
