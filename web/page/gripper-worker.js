"use strict";
// The worker of the gripper's page: it drives the time of the gripper, and answers the page.
const MOVING_MS = 16, IDLE_MS = 100;
// A longer gap is one in which the computer slept: the gripper did, too.
const MAX_GAP_MS = 1000;
const run = Math.floor(Math.random() * 2 ** 50);
let gripper = null, isShown = true, isOpen = false;
// The time of the gripper in ms, and when it was read.
let time = 0, readAt = performance.now();
const kept = [];

function call(request) {
  const at = performance.now(), gap = at - readAt;
  readAt = at;
  if (isShown) time += Math.min(gap, MAX_GAP_MS);
  if (isShown && isOpen && gap > MAX_GAP_MS) postMessage({ error: "" });
  const date = new Date().toISOString().slice(0, 19) + "Z";
  const bytes = new TextEncoder().encode(JSON.stringify({ run, date, now: Math.round(time * 1000), ...request }));
  // May move the memory.
  const place = gripper.wsg_reserve(bytes.length);
  new Uint8Array(gripper.memory.buffer, place, bytes.length).set(bytes);
  const length = gripper.wsg_gripper();
  return new TextDecoder().decode(new Uint8Array(gripper.memory.buffer, gripper.wsg_answer(), length));
}
function take({ id, path, as_of, body, ...change }) {
  if (id !== undefined) return postMessage({ id, text: call({ path, as_of, body }) });
  // The time until now passed in the earlier state.
  call({});
  if (change.isShown !== undefined) isShown = change.isShown;
  if (change.isOpen !== undefined) isOpen = change.isOpen;
  if (change.isOpen) postMessage({ text: call({ opens: true }) });
}
let hadState = false;
function turn() {
  const text = isShown && isOpen ? call({ streams: true }) : "[]", hasState = text.includes('["state",');
  if (text !== "[]") postMessage({ text });
  // A state that follows the last one at once is of moving fingers.
  setTimeout(turn, hasState && hadState ? MOVING_MS : IDLE_MS);
  hadState = hasState;
}
addEventListener("message", ({ data }) => { if (gripper === null) kept.push(data); else take(data); });
(async () => {
  const file = await fetch("wsg.wasm");
  if (!file.ok) throw new Error(`${file.status} ${file.statusText}`);
  gripper = (await WebAssembly.instantiate(await file.arrayBuffer())).instance.exports;
  kept.forEach(take);
  turn();
})().catch(error => postMessage({ error: "the gripper does not load: " + error.message }));
