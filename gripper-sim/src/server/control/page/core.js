"use strict";
const $ = id => document.getElementById(id);
const SVG = "http://www.w3.org/2000/svg";
// The gripper reports its state at least every 200 ms. A state that is older than a second is not shown as current.
const SILENT_MS = 1000;
// A request without an answer is withdrawn. A FAST STOP is then sent on another way.
const ANSWER_MS = 1000, FILE_MS = 4000, OTHER_WAY_MS = 100;
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

// The connection, and the requests on it that wait for an answer.
let socket = null, openedAt = -RECONNECT_MS, requests = 0;
const waiting = new Map();
// The state that the page shows, as the server names it: each request carries it, and the server refuses an old one.
let asOf = null;

// Sends a request by HTTP. Returns its status, 0 without an answer in time, and the body of the answer.
async function overHttp(path, body, signal) {
  const post = { method: "POST", body: JSON.stringify(body), priority: "high" };
  const query = body !== undefined && asOf !== null ? "?as_of=" + asOf : "";
  try {
    const answer = await fetch(path + query, { ...(body === undefined ? {} : post), signal });
    return { status: answer.status, body: await answer.json() };
  } catch {
    return { status: 0 };
  }
}
// Sends a command on the connection of the page, where it waits for no other request of the browser.
function overSocket(body, signal) {
  return new Promise(done => {
    const id = ++requests;
    waiting.set(id, done);
    signal.addEventListener("abort", () => { waiting.delete(id); done({ status: 0 }); });
    socket.send(JSON.stringify({ id, as_of: asOf, body }));
  });
}
const isStop = name => name === "stop" || name === "fast_stop";
const isOpen = () => socket !== null && socket.readyState === WebSocket.OPEN;
async function send(path, body) {
  if (path === "/command") body.key = Math.floor(Math.random() * Number.MAX_SAFE_INTEGER);
  const abort = new AbortController();
  // The server reads or writes files for some requests. Nothing is executed late for a preview.
  const isLong = body === undefined || path === "/settings" || path === "/scripts" || body?.send === false;
  const end = setTimeout(() => abort.abort(), isLong ? FILE_MS : ANSWER_MS);
  const first = path === "/command" && isOpen() ? overSocket(body, abort.signal) : overHttp(path, body, abort.signal);
  const ways = [first];
  if (path === "/command" && isOpen() && isStop(body.command)) {
    // A connection that has lost its network must not hold a stop. The server executes it once.
    ways.push(new Promise(done => {
      const other = setTimeout(() => overHttp(path, body, abort.signal).then(done), OTHER_WAY_MS);
      first.then(() => { clearTimeout(other); done({ status: 0 }); });
    }));
  }
  const answered = ways.map(way => way.then(answer => answer.status ? answer : Promise.reject(answer)));
  const answer = await Promise.any(answered).catch(() => ({ status: 0 }));
  clearTimeout(end);
  abort.abort();
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
  // Only the latest state of each frame is drawn, so that many windows leave time for clicks.
  if (latest === null) requestAnimationFrame(drawLatest);
  latest = state;
}
let latest = null;
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
  least = Infinity;
  write($("model"), hello.model + (hello.tag ? " " + hello.tag : ""));
  write($("refusal"), "");
  for (const act of onHello) act();
}
function takeAnswer({ id, status, body }) {
  const done = waiting.get(id);
  waiting.delete(id);
  if (done) done({ status, body });
}
const onMessage = { hello: takeHello, state: take, answer: takeAnswer };
for (const [kind, acts] of Object.entries(onEvent)) onMessage[kind] = data => { for (const act of acts) act(data); };

// Shows why the server does not open the connection of this page.
async function explain() {
  const { status, body } = await send("/events", {});
  if (!status || isOpen()) return;
  write($("refusal"), status === 200 ? "The server is there, but no WebSocket opens: a proxy must forward the headers Upgrade and Connection." : body.error);
}
function connect() {
  const mine = new WebSocket(location.origin.replace("http", "ws") + "/events");
  let hasOpened = false;
  socket = mine;
  openedAt = performance.now();
  mine.addEventListener("open", () => { hasOpened = true; });
  mine.addEventListener("message", event => {
    const [, kind, data] = /^event: (.*)\ndata: (.*)/.exec(event.data);
    if (mine === socket) onMessage[kind](JSON.parse(data));
  });
  mine.addEventListener("close", () => {
    if (mine !== socket) return;
    socket = null;
    isGone();
    if (!hasOpened) explain();
  });
}
// A timer of a hidden page is late, so the same happens when it is shown again.
function check() {
  const since = performance.now() - openedAt;
  if (!isFresh()) isGone();
  const silent = Math.min(since, performance.now() - takenAt), late = Math.min(since, age());
  if (socket !== null && (silent > RECONNECT_MS || late > LATE_MS)) {
    // The other end may not be there any more, or its clock was stopped. A busy computer alone is no reason.
    socket.close();
    socket = null;
  }
  if (socket === null && since > RETRY_MS) connect();
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
