"use strict";
// The page, and its worker: the same file runs as both.
if (typeof document === "undefined") work(); else start();

// Passes requests to the WebAssembly module, one after the other.
async function work() {
  const loaded = fetch("wsg.wasm").then(answer => answer.arrayBuffer()).then(bytes => WebAssembly.instantiate(bytes, {}));
  onmessage = async ({ data }) => {
    try {
      const { wsg_reserve, wsg_station, wsg_answer, memory } = (await loaded).instance.exports, bytes = new TextEncoder().encode(data);
      // A call may move the memory: its address comes first.
      const to = wsg_reserve(bytes.length);
      new Uint8Array(memory.buffer, to, bytes.length).set(bytes);
      const length = wsg_station(), from = wsg_answer();
      postMessage(new TextDecoder().decode(new Uint8Array(memory.buffer, from, length)));
    } catch (error) {
      postMessage(JSON.stringify({ error: `WebAssembly: ${error}` }));
    }
  };
}

function start() {
  const $ = id => document.getElementById(id);
  const worker = new Worker("station.js");
  const answers = [];
  worker.onmessage = ({ data }) => answers.shift()(JSON.parse(data));
  worker.onerror = () => say("The page does not start. Open it from a web server, not as a file.", true);
  const ask = body => new Promise(done => { answers.push(done); worker.postMessage(JSON.stringify({ station: body })); });

  const MAX_KEPT = 400, MAX_ROWS = 100, REST_MS = 150, LIVELY_MS = 1000, LONGEST_MS = 250, PULSE_US = 100000, ERROR_CAUSE = 133, CONTROL_SOURCE = 108, FIRST_EVENT = 139, FIRST_REPORT = 100;
  const EDGES = ["GRIP", "RELEASE", "MOVE", "HOME", "STOP_ACK"];
  let hello, view, kept = [], running = false, actions = [], nextFrame = 0, before = null, pulses = [], waiting = 0, turns = Promise.resolve(), wires = 0, image = [0, 2000, 5000, 4000];

  function node(parent, kind, attributes, text) {
    const made = document.createElement(kind);
    for (const [name, value] of Object.entries(attributes || {})) made.setAttribute(name, value);
    if (text !== undefined) made.textContent = text;
    parent.append(made);
    return made;
  }
  function write(element, text) { if (element.textContent !== String(text)) element.textContent = text; }
  function mark(element, name, value) { if (element.getAttribute(name) !== String(value)) element.setAttribute(name, value); }
  function say(text, refused) { write($("message"), text); $("message").classList.toggle("refused", Boolean(refused)); }
  const has = (names, bits, name) => (bits >> names.indexOf(name)) & 1;
  const input = name => has(hello.inputs, view.inputs, name), output = name => has(hello.outputs, view.outputs, name);
  const report = register => view.reports[register - FIRST_REPORT];
  const hex = words => words.map(word => word.toString(16)).join(".");

  // Time: a step per frame of the browser while the fingers move, fewer while they rest, none in a hidden tab.
  function act(action) {
    actions.push(action);
    actedAt = performance.now();
    if (running) schedule(0); else advance(0);
  }
  let timer = 0, frame = 0, actedAt = 0;
  function schedule(wait_ms) {
    clearTimeout(timer);
    cancelAnimationFrame(frame);
    const next = () => { frame = requestAnimationFrame(beat); };
    if (wait_ms) timer = setTimeout(next, wait_ms); else next();
  }
  function advance(step_us, more) {
    waiting += 1;
    return turns = turns.then(() => take(step_us, more)).catch(error => say(error, true)).finally(() => { waiting -= 1; });
  }
  async function take(step_us, more) {
    const answer = await ask({ actions: actions.splice(0), step_us, first_frame: nextFrame, ...more });
    if (answer.error) { say(answer.error, true); return false; }
    view = answer;
    for (const pulse of pulses.filter(pulse => (pulse.end ??= view.now_us + PULSE_US) <= view.now_us)) { pulses = pulses.filter(other => other !== pulse); setWire(pulse.bit, 0); }
    show();
    return true;
  }
  function beat(now) {
    const rests = now - actedAt > LIVELY_MS && !view.flags.includes("MOVING");
    if (running && !waiting) {
      advance(Math.round(Math.min(now - (before ?? now), LONGEST_MS) * 1000 * Number($("speed").value)));
      before = now;
    }
    if (running) schedule(rests ? REST_MS : 0);
  }
  function setRunning(value) {
    running = value;
    before = null;
    if (running) schedule(0);
    // A step that is under way still ends.
    turns.then(() => { write($("run"), running ? "Pause" : "Run"); $("single").disabled = running; });
  }
  async function load(link) {
    if (link) say("Replaying the session of the link.");
    setRunning(false);
    await turns;
    [pulses, actions, kept, nextFrame] = [[], [], [], 0];
    $("frames").replaceChildren();
    const isKnown = await advance(0, { link });
    if (!isKnown) return;
    wires = view.inputs;
    image = link ? view.image : image;
    if (!link) act("i" + hex([0, ...image.slice(1)]));
    $("parameters").querySelectorAll("input").forEach((field, at) => { field.value = image[at + 1] / 100; });
    setRunning(!link);
    if (link) say("This is the session of the link, paused at its end.");
  }

  // Inputs of the station.
  function setWire(bit, level) { wires = level ? wires | 1 << bit : wires & ~(1 << bit); act("w" + wires.toString(16)); }
  function fastStop() { setWire(hello.inputs.indexOf("FAST_STOP_OK"), 0); }
  function sendImage() {
    const fields = [...$("parameters").querySelectorAll("input")];
    if (fields.every(field => field.reportValidity())) image = [image[0], ...fields.map(field => Math.round(field.valueAsNumber * 100))];
    act("i" + hex(image));
  }
  function make() {
    hello.inputs.forEach((name, bit) => {
      const button = node($("inputs"), "button", { type: "button", role: "switch", id: name }, name);
      button.addEventListener("click", () => setWire(bit, !(wires >> bit & 1)));
      if (!EDGES.includes(name)) return button.classList.add("level");
      node($("inputs"), "button", { type: "button", id: "pulse_" + name, "aria-label": "Pulse " + name }, "Pulse")
        .addEventListener("click", () => { setWire(bit, 1); pulses.push({ bit }); });
    });
    hello.command_flags.forEach((name, bit) => node($("command_flags"), "button", { type: "button", id: "flag_" + name, "aria-pressed": false }, name)
      .addEventListener("click", () => { image[0] ^= 256 << bit; sendImage(); }));
    for (const [list, names] of [["outputs", hello.outputs], ["gripper_flags", hello.gripper_flags]]) names.forEach(name => {
      const item = node($(list), "li", ["ERROR", "PART_FAULT", "PART_LOST"].includes(name) ? { class: "bad" } : {}, name);
      node(item, "span", { class: "hidden" }, " 0");
    });
    for (const [register, name, unit, least, most, meaning] of hello.settings) {
      const place = node($("settings"), "div", { class: "setting" });
      node(place, "label", { for: "s" + register }, name + (unit ? ", " + unit : ""));
      const field = node(node(place, "div", { class: "value" }), "input", { type: "number", id: "s" + register, min: least, max: most, required: "", "aria-describedby": "d" + register });
      node(place, "p", { class: "name", id: "d" + register }, meaning);
      field.addEventListener("change", () => { if (field.reportValidity()) act("s" + hex([register, field.valueAsNumber])); });
      field.addEventListener("blur", () => { shownTables = ""; });
    }
    $("parameters").addEventListener("change", sendImage);
    $("fast_stop").addEventListener("click", fastStop);
    document.addEventListener("keydown", event => { if (event.key === "Escape") fastStop(); });
    $("cut").addEventListener("click", () => act("x" + Number(!view.is_cut)));
    $("silent").addEventListener("click", () => act("m" + Number(!view.is_master_on)));
    for (const button of document.querySelectorAll("[data-action]")) button.addEventListener("click", () => act(button.dataset.action));
    $("part_in").addEventListener("click", () => { if ($("part").reportValidity()) act("p" + Math.round($("part").valueAsNumber * 10).toString(16)); });
    $("part_out").addEventListener("click", () => act("p0"));
    $("run").addEventListener("click", () => setRunning(!running));
    $("single").addEventListener("click", () => advance(1000));
    $("restart").addEventListener("click", () => { history.replaceState(null, "", location.pathname); say(""); tourAt = tourAt === null ? null : 0; load(""); });
    $("queries").addEventListener("change", filter);
    $("share").addEventListener("click", share);
    $("leave").addEventListener("click", () => { tourAt = null; tour(); });
    $("skip").addEventListener("click", () => { tourAt += 1; tour(); });
    addEventListener("hashchange", () => load(location.hash.slice(1)));
    document.addEventListener("visibilitychange", () => { before = null; });
  }
  async function share() {
    const { link } = await ask({ share: true, first_frame: nextFrame });
    if (!link) return say("This session is too long for a link: at most 400 inputs and 20 minutes. Start over to record another one.", true);
    history.replaceState(null, "", "#" + link);
    try {
      await navigator.clipboard.writeText(location.href);
      say("The link is copied.");
    } catch {
      say("The address of this page is the link.");
    }
  }

  // The state.
  function lamps(list, bits) {
    [...$(list).children].forEach((item, bit) => {
      item.classList.toggle("on", bits >> bit & 1);
      write(item.lastChild, bits >> bit & 1 ? " 1" : " 0");
    });
  }
  function draw() {
    const [, part, left, right, width, force] = $("drawing").querySelectorAll("rect, text"), half = view.width / 2;
    mark(left, "x", 75 - half - 8);
    mark(right, "x", 75 + half);
    const seen = view.has_part ? Math.min(view.part / 10, view.width) : view.part / 10;
    mark(part, "x", 75 - seen / 2);
    mark(part, "width", seen);
    mark(part, "opacity", view.has_part ? 1 : 0.35);
    write(width, view.width.toFixed(1) + " mm");
    write(force, view.force > 0 ? view.force.toFixed(1) + " N" : "");
    write($("drawing-title"), `width ${view.width.toFixed(0)} mm, ${view.part ? `a part of ${view.part / 10} mm` : "no part"}, force ${view.force.toFixed(0)} N`);
  }
  function showFrames() {
    nextFrame = view.frame_count;
    kept = [...kept, ...view.frames].slice(-MAX_KEPT);
    addRows(view.frames);
  }
  // Ids 40h to 5Fh are queries and automatic updates.
  const isShown = frame => $("queries").checked || !/^[45]/.test(frame.text);
  const LABELS = ["time", "direction", "frame", "bytes", "duration"];
  function addRows(frames) {
    const list = $("lines"), atEnd = list.scrollTop + list.clientHeight >= list.scrollHeight - 20, shown = frames.filter(isShown);
    if (!shown.length) return;
    for (const frame of shown) {
      const fate = frame.is_lost ? "lost" : frame.is_damaged ? "damaged" : "", row = node($("frames"), "tr", { class: fate });
      [`${(frame.at_us / 1e6).toFixed(4)} s`, frame.to_gripper ? "to gripper" : "to bridge", frame.text + (fate && `: ${fate}`), frame.bytes, `${(frame.takes_us / 1000).toFixed(2)} ms`]
        .forEach((cell, at) => node(row, "td", { "data-label": LABELS[at] }, cell));
    }
    while ($("frames").children.length > MAX_ROWS) $("frames").firstChild.remove();
    if (atEnd) list.scrollTop = list.scrollHeight;
  }
  function filter() { $("frames").replaceChildren(); addRows(kept.filter(isShown).slice(-MAX_ROWS)); $("lines").scrollTop = $("lines").scrollHeight; }
  // Tables that seldom change.
  let shownTables = "", shownRefusal = "null";
  function showSettings() {
    for (const [register] of hello.settings) {
      const field = $("s" + register), value = String(view.settings[register - FIRST_REPORT]);
      if (document.activeElement !== field && field.value !== value) field.value = value;
    }
  }
  function showEvents() {
    const found = [];
    for (let at = FIRST_EVENT; report(at); at += 4) {
      const [, name, meaning, remedy] = hello.events.find(event => event[0] === report(at));
      found.push([`${name}${report(at + 2) ? " " + report(at + 2) : ""}, ${report(at + 3)} s ago: `, `${meaning}. Remedy: ${remedy}.`]);
    }
    while ($("events").children.length > found.length) $("events").lastChild.remove();
    found.forEach(([name, text], at) => {
      const item = $("events").children[at] || node($("events"), "li");
      if (!item.firstChild) { node(item, "b"); node(item, "span"); }
      write(item.firstChild, name);
      write(item.lastChild, text);
    });
  }
  function show() {
    const isFastStopped = view.flags.includes("FAST_STOP");
    document.body.classList.toggle("fast-stopped", isFastStopped);
    document.body.classList.toggle("failed", view.state === "ERROR");
    write($("state"), "Gripper: " + (isFastStopped ? "FAST STOP, " : "") + view.state);
    write($("time"), (view.now_us / 1e6).toFixed(3) + " s");
    draw();
    hello.inputs.forEach((name, bit) => mark($(name), "aria-checked", Boolean(view.inputs >> bit & 1)));
    hello.command_flags.forEach((name, bit) => mark($("flag_" + name), "aria-pressed", Boolean(view.image[0] >> 8 + bit & 1)));
    mark($("cut"), "aria-checked", view.is_cut);
    mark($("silent"), "aria-checked", !view.is_master_on);
    lamps("outputs", view.outputs);
    lamps("gripper_flags", view.input ? view.input[0] : 0);
    const [, system, width, force, status] = view.input || [];
    const none = view.exception ? `exception ${view.exception.toString(16).toUpperCase().padStart(2, "0")}h` : "no answer";
    const entries = view.input ? [["SYSSTATE", system.join(", ") || "none"], ["WIDTH", (width / 100).toFixed(2) + " mm"], ["Gripping Force", (force / 100).toFixed(2) + " N"], ["Status Code", status]]
      : ["SYSSTATE", "WIDTH", "Gripping Force", "Status Code"].map(name => [name, none]);
    entries.forEach(([name, value], at) => {
      const list = $("input");
      if (list.children.length <= 2 * at) { node(list, "dt"); node(list, "dd"); }
      write(list.children[2 * at], name);
      write(list.children[2 * at + 1], value);
    });
    const number = input("RECIPE0") + 2 * input("RECIPE1"), [w, s, f, r] = view.settings.slice(9 + 4 * number, 13 + 4 * number).map(value => value / 100);
    const cause = hello.events.find(event => event[0] === report(ERROR_CAUSE));
    write($("cause"), output("ERROR") && cause ? `ERROR: ${cause[2]}` : "");
    write($("recipe"), `Recipe ${number}: ${w} mm, ${s} mm/s, ${f} N; RELEASE to ${r} mm`);
    if (String(view.refused) !== shownRefusal) say(view.refused ? `The bridge refused setting ${view.refused[0]} with exception ${view.refused[1]}.` : "", true);
    shownRefusal = String(view.refused);
    showFrames();
    const tables = String([view.settings, view.reports.slice(FIRST_EVENT - FIRST_REPORT)]);
    if (tables !== shownTables) { showSettings(); showEvents(); }
    shownTables = tables;
    tour();
  }

  // The tour: a title, a task, and whether it is done.
  const TOUR = [
    ["Get ready", "Switch FAST_STOP_OK on, then pulse STOP_ACK: the bridge acknowledges the FAST STOP of power-up, and READY goes high.", () => output("READY")],
    ["Home the fingers", "Pulse HOME: the fingers move to their end stop, and REFERENCED goes high.", () => output("REFERENCED") && output("READY")],
    ["Grip a part", "Pulse GRIP: the fingers close on the part of 20 mm, and HOLDING goes high.", () => output("HOLDING")],
    ["Lose it", "Take the part away: PART_FAULT goes high, and the bus master reads PART_LOST.", () => output("PART_FAULT")],
    ["Press FAST STOP while the line is cut", "Cut the line, press FAST STOP, and restore the line: the bridge repeats FAST STOP until the gripper confirms it.", () => {
      wasCut ||= view.is_cut && !input("FAST_STOP_OK");
      return wasCut && !view.is_cut && view.flags.includes("FAST_STOP") && output("LINK_OK");
    }],
    ["Recover, and command over the bus", "Switch FAST_STOP_OK on, pulse STOP_ACK, set WIDTH to 60 and switch RELEASE on in CMDFLAGS: the fingers open to 60 mm.",
      () => report(CONTROL_SOURCE) === 2 && view.state === "IDLE" && Math.abs(view.width - 60) < 0.5],
  ];
  let tourAt = 0, wasCut = false;
  function tour() {
    while (tourAt !== null && tourAt < TOUR.length && view && TOUR[tourAt][2]()) tourAt += 1;
    $("tour").hidden = tourAt === null;
    if (tourAt === null) return;
    const isDone = tourAt >= TOUR.length;
    write($("h-tour"), isDone ? "Tour: complete" : `Tour, step ${tourAt + 1} of ${TOUR.length}: ${TOUR[tourAt][0]}`);
    write($("task"), isDone ? "Now try faults of your own, and copy a link to share the session." : TOUR[tourAt][1]);
    $("skip").hidden = isDone;
  }

  ask({ hello: true }).then(answer => {
    if (answer.error) return say(answer.error, true);
    hello = answer;
    make();
    load(location.hash.slice(1));
  });
}
