"use strict";
// Commands, part and faults.
const FAULT_FLAGS = ["FAST_STOP", "TEMP_FAULT", "POWER_FAULT", "CURR_FAULT", "FINGER_FAULT", "CMD_FAILURE", "SCRIPT_FAILURE"];
const MOVING = ["GRIPPING", "RELEASING", "POSITIONING"];
// The command whose result is awaited: its line in the list, and when it was sent.
let awaited = null;

function result(text) {
  const item = node($("results"), "li", {}, text);
  while ($("results").children.length > 3) $("results").firstChild.remove();
  return item;
}
async function command(name, numbers) {
  const text = name.replace("_", " ") + (numbers ? ` ${numbers.width_mm} mm` : "");
  const { status, body } = await send("/command", { command: name, ...numbers });
  if (status !== 200) {
    say("message", status ? body.error : silence(!isStop(name)), true);
    result(text + (status ? ": refused" : ": no answer")).className = "bad";
    return;
  }
  say("message", "");
  const isMotion = ["home", "move", "grip", "release"].includes(name);
  const item = result(text + (isMotion ? ": pending" : ": done"));
  if (isMotion) awaited = { item, text, since: now, seen: false };
}
for (const name of ["home", "stop", "acknowledge", "fast_stop"]) $(name).addEventListener("click", () => command(name));
// Sends the numbers of these fields, by their keys; nothing where a required field has none, which would be taken for 0.
function onClick(button, fields, send) {
  $(button).addEventListener("click", () => {
    const inputs = Object.entries(fields).map(([key, id]) => [key, $(id)]);
    if (inputs.every(([, input]) => input.reportValidity()))
      send(Object.fromEntries(inputs.map(([key, input]) => [key, input.valueAsNumber])));
  });
}
const travel = { width_mm: "width", speed_mm_per_s: "speed" };
for (const name of ["move", "release"]) onClick(name, travel, numbers => command(name, numbers));
onClick("grip", { ...travel, force_n: "force" }, numbers => command("grip", numbers));
document.addEventListener("keydown", event => { if (event.key === "Escape") command("fast_stop"); });

async function inject(place, path, body) {
  if (await ask(place, path, body)) say(place, "");
}
onClick("part_in", { width_mm: "part", stiffness_n_per_mm: "stiffness", inner_width_mm: "inner" }, part => inject("message", "/part", part));
$("part_out").addEventListener("click", () => inject("message", "/part", null));
const faults = [...document.querySelectorAll("#faults input")], rates = [...document.querySelectorAll("#rates input")];
for (const box of faults) box.addEventListener("change", () => inject("fault-message", "/fault", { fault: box.name, on: box.checked }));
onClick("line", Object.fromEntries(rates.map(input => [input.name, input.id])), numbers => inject("fault-message", "/line", numbers));
$("mend").addEventListener("click", () => inject("fault-message", "/line", {}));

// An input shows what the gripper has until someone edits it, and again once the gripper has something else.
const followed = {};
function follow(id, value) {
  if (followed[id] === value) return;
  followed[id] = value;
  if (document.activeElement !== $(id)) $(id).value = value === null ? "" : Number(value.toFixed(3));
}

let drawing = null, shown = null;
onHello.push(() => {
  const stroke = hello.limits.stroke_mm, svg = $("drawing"), middle = (stroke + 40) / 2;
  svg.setAttribute("viewBox", `0 -6 ${stroke + 40} 54`);
  while (svg.children.length > 1) svg.lastChild.remove();
  node(svg, "rect", { class: "rail", x: 2, y: 4, width: stroke + 36, height: 6, rx: 1 });
  drawing = { middle,
    part: node(svg, "path", { class: "part" }),
    fingers: [0, 1].map(() => node(svg, "rect", { class: "finger", y: 6, height: 34, rx: 1 })),
    width: node(svg, "text", { x: middle, y: 1, "text-anchor": "middle" }),
    force: node(svg, "text", { x: middle, y: 47, "text-anchor": "middle" }) };
  shown = { flags: bits($("flags"), hello.names.system, FAULT_FLAGS), command: bits($("command_flags"), hello.names.command, ["FASTSTOP"]),
    gripper: bits($("gripper_flags"), hello.names.gripper, ["ERROR"]), system: bits($("system_flags"), hello.names.system, FAULT_FLAGS) };
  $("width").max = stroke;
  $("speed").min = hello.limits.min_speed_mm_per_s;
  $("speed").max = hello.limits.max_speed_mm_per_s;
  $("force").min = hello.limits.min_force_n;
  for (const id of Object.keys(followed)) delete followed[id];
  if (awaited) write(awaited.item, awaited.text + ": unknown, the connection was lost");
  awaited = null;
});

const partText = ({ width_mm, inner_width_mm }) => `a part of ${width_mm} mm${inner_width_mm ? `, inner width ${inner_width_mm} mm` : ""}`;
function draw(state) {
  const { middle, fingers, part, width, force } = drawing, half = state.width_mm / 2;
  const isAround = state.part_is_around, thick = isAround ? Math.max(1, Math.min(8, half)) : 8;
  // Fingers in a hole touch it with their outer sides.
  const reach = isAround ? half : half + thick;
  for (const finger of fingers) finger.setAttribute("width", thick);
  fingers[0].setAttribute("x", middle - reach);
  fingers[1].setAttribute("x", middle + reach - thick);
  part.setAttribute("visibility", state.part ? "visible" : "hidden");
  if (state.part) {
    const { width_mm, inner_width_mm } = state.part, push = state.width_mm - (isAround ? inner_width_mm : width_mm);
    const change = isAround ? Math.max(0, push) : state.part_is_between ? Math.min(0, push) : 0;
    const outer = width_mm + change, inner = Math.max(0, (inner_width_mm ?? -Infinity) + change);
    part.setAttribute("d", `M${middle - outer / 2} 20v16h${outer}v-16H${middle + inner / 2}v13h${-inner}v-13Z`);
    part.setAttribute("opacity", state.part_is_between ? 1 : 0.35);
  }
  write(width, state.width_mm.toFixed(1) + " mm");
  write(force, state.force_n > 0 ? state.force_n.toFixed(1) + " N" : "");
  write($("drawing-title"), `width ${state.width_mm.toFixed(0)} mm, ${state.part ? partText(state.part) : "no part"}, force ${state.force_n.toFixed(0)} N`);
}

function showResult(state, time) {
  if (!awaited) return;
  const moves = MOVING.includes(state.gripper_state) || state.system_state.includes("MOVING");
  awaited.seen ||= moves;
  // A motion may be over before a state shows it.
  if (moves || (!awaited.seen && time - awaited.since < 0.2)) { shownText = ""; return; }
  write(awaited.item, `${awaited.text}: ${state.gripper_state} at ${state.width_mm.toFixed(1)} mm, ${state.force_n.toFixed(1)} N`);
  const failed = ["ERROR", "NO PART", "PART LOST"].includes(state.gripper_state) || state.system_state.includes("FAST_STOP");
  awaited.item.className = failed ? "bad" : "";
  awaited = null;
}

onGone.push(() => { if (awaited) write(awaited.item, awaited.text + ": no connection"); });
onState.push((state, time) => {
  draw(state);
  $("force").max = state.system_state.includes("OVERDRIVE_MODE") ? hello.limits.overdrive_force_n : hello.limits.nominal_force_n;
  showResult(state, time);
  if (state.part) {
    follow("part", state.part.width_mm);
    follow("stiffness", state.part.stiffness_n_per_mm);
    follow("inner", state.part.inner_width_mm ?? null);
  }
  follow("force", state.force_limit_n);
  const { total, no_part, part_lost } = state.gripping_statistics, { limits } = hello;
  pairs($("values"), [["width", state.width_mm.toFixed(2) + " mm"], ["reported width", state.reported_width_mm.toFixed(2) + " mm"],
    ["speed", state.speed_mm_per_s.toFixed(1) + " mm/s"], ["force", state.force_n.toFixed(1) + " N"],
    ["force limit", state.force_limit_n.toFixed(1) + " N"], ["temperature", state.temperature_c.toFixed(1) + " °C"],
    ["grips", `${total}, no part ${no_part}, lost ${part_lost}`], ["fingers", hello.fingers.join(", ")],
    ["stroke", limits.stroke_mm + " mm"], ["speeds", `${limits.min_speed_mm_per_s} to ${limits.max_speed_mm_per_s} mm/s`],
    ["forces", `${limits.min_force_n} to ${limits.nominal_force_n} N`]]);
  const { input } = state.fieldbus;
  show(shown.flags, input[2] + input[3] * 2 ** 8 + input[4] * 2 ** 16 + input[5] * 2 ** 24);
  for (const box of faults) box.checked = state.faults.some(fault => fault.fault === box.name);
  for (const input of rates) if (document.activeElement !== input) follow(input.id, state.line[input.name] ?? 0);
  const labels = ["client", "bytes dropped", "bad checksums", "too long", "updates lost", "replies lost"];
  rows($("clients"), state.clients.map(client => [client.name, client.bytes_dropped, client.bad_checksums, client.too_long,
    client.updates_lost, client.replies_lost]), labels);
});
