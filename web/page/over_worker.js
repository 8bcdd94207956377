"use strict";
// The gripper in this browser: WebAssembly in a worker, in place of a server (`over_http.js`).
let worker = null, requests = 0, events = null;
const waiting = new Map();

function post(message) {
  if (worker === null) {
    worker = new Worker("gripper-worker.js");
    worker.postMessage({ isShown: !document.hidden });
    worker.addEventListener("error", () => end("the worker of the gripper does not load; reload the page"));
    worker.addEventListener("message", ({ data }) => {
      if (data.error !== undefined) return end(data.error);
      if (data.id === undefined) return events?.take(data.text);
      const done = waiting.get(data.id), at = data.text.indexOf("\n");
      waiting.delete(data.id);
      if (done) done({ status: Number(data.text.slice(0, at)), text: data.text.slice(at + 1) });
    });
  }
  worker.postMessage(message);
}
// Why there is no gripper, if there is none.
let failure = "";
function end(error) {
  failure = error;
  const ended = events;
  events = null;
  ended?.end(!error);
}
async function textOf(path, body, signal) {
  if (failure) return { status: 503, text: JSON.stringify({ error: failure }) };
  return new Promise(done => {
    const id = ++requests;
    waiting.set(id, done);
    signal.addEventListener("abort", () => { waiting.delete(id); done({ status: 0, text: "null" }); });
    post({ id, path, as_of: asOf, body: body === undefined ? null : JSON.stringify(body) });
  });
}
// Sends a request. Returns its status, 0 without an answer in time, and the body of the answer.
async function request(path, body, signal) {
  const { status, text } = await textOf(path, body, signal);
  return { status, body: JSON.parse(text) };
}
// Opens the stream of events: calls take(kind, data) for each, and ended(hasOpened) when it ends by itself. Returns a function that
// closes it.
function stream(take, ended) {
  events = { take: text => { for (const [kind, data] of JSON.parse(text)) take(kind, data); }, end: ended };
  post({ isOpen: true });
  return () => { events = null; post({ isOpen: false }); };
}
// The time of a hidden page stands still. When it is shown again, its stream begins anew.
document.addEventListener("visibilitychange", () => {
  post({ isShown: !document.hidden });
  if (!document.hidden) end("");
});
// The system log is no file of a server.
document.addEventListener("click", async event => {
  const link = event.target.closest("a[href='log.txt']");
  if (!link) return;
  event.preventDefault();
  const { text } = await textOf("/log.txt", undefined, AbortSignal.timeout(1000));
  const url = URL.createObjectURL(new Blob([text], { type: "text/plain" }));
  const file = document.createElement("a");
  file.href = url;
  file.download = link.download;
  file.click();
  URL.revokeObjectURL(url);
});
