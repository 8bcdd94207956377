"use strict";
// The gripper of a server: requests by HTTP, and a WebSocket that carries events and commands. A static page has `over_worker.js` in
// place of this file.
const OTHER_WAY_MS = 100;
let socket = null, requests = 0;
// The commands on the WebSocket that wait for an answer.
const waiting = new Map();
const isOpen = () => socket !== null && socket.readyState === WebSocket.OPEN;

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
// Sends a request. Returns its status, 0 without an answer in time, and the body of the answer.
function request(path, body, signal) {
  if (path !== "/command" || !isOpen()) return overHttp(path, body, signal);
  const first = overSocket(body, signal), ways = [first];
  if (isStop(body.command)) {
    // A connection that has lost its network must not hold a stop. The server executes it once.
    ways.push(new Promise(done => {
      const other = setTimeout(() => overHttp(path, body, signal).then(done), OTHER_WAY_MS);
      first.then(() => { clearTimeout(other); done({ status: 0 }); });
    }));
  }
  const answered = ways.map(way => way.then(answer => answer.status ? answer : Promise.reject(answer)));
  return Promise.any(answered).catch(() => ({ status: 0 }));
}
// Opens the stream of events: calls take(kind, data) for each, and ended(hasOpened) when it ends by itself. Returns a function that
// closes it.
function stream(take, ended) {
  const mine = new WebSocket(location.origin.replace("http", "ws") + "/events");
  let hasOpened = false;
  socket = mine;
  mine.addEventListener("open", () => { hasOpened = true; });
  mine.addEventListener("message", event => {
    if (mine !== socket) return;
    const [, kind, json] = /^event: (.*)\ndata: (.*)/.exec(event.data), data = JSON.parse(json);
    if (kind !== "answer") return take(kind, data);
    const done = waiting.get(data.id);
    waiting.delete(data.id);
    if (done) done(data);
  });
  mine.addEventListener("close", () => {
    if (mine !== socket) return;
    socket = null;
    ended(hasOpened);
  });
  return () => { socket = null; mine.close(); };
}
