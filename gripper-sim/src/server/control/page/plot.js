"use strict";
// Three strips over the last 30 s: width, speed, force.
const WINDOW_S = 30;
let series = [], marks = [], heldAt = null, cursorAt = null;
onHello.push(() => { series = hello.history; marks = []; heldAt = null; $("hold").checked = false; });
onSample.push((state, time) => {
  const sample = [time, state.width_mm, state.speed_mm_per_s, state.force_n], last = series[series.length - 1];
  if (!last || [1, 2, 3].some(at => Math.abs(last[at] - sample[at]) > 0.004)) {
    series.push(sample);
    if (rests) keepPlotting(100);
  }
  // While it is paused, nothing that it shows is dropped.
  const oldest = (heldAt ?? time) - WINDOW_S;
  while (series.length > 1 && series[1][0] < oldest) series.shift();
  while (marks.length && marks[0].time < oldest) marks.shift();
});
onEvent.system_log.push(({ entries }) => {
  for (const { time_s, severity, text } of entries)
    if (severity !== "info") marks.push({ time: time_s, text, bad: severity === "error" || text.startsWith("FAST STOP") });
});
onEvent.log.push(({ lines }) => {
  for (const line of lines) {
    const found = /^([\d.]+) s (?:control (\w.*): E_|.* -> (?:[0-9A-F?]{2} )+)\s*(.*)/.exec(line);
    const text = found && (found[2] || found[3]).replace(/^\w+h /, "");
    if (text && /^(Homing|Pre-position|Grip Part|Release Part|Stop)/.test(text)) marks.push({ time: Number(found[1]), text, bad: false });
  }
});

function valuesAt(time) {
  let found = series[0];
  for (const sample of series) { if (sample[0] > time) break; found = sample; }
  return found;
}
function strip(svg, box, { kind, name, unit, index, low, high }, x, end) {
  const { left, right } = box, top = box.top + 16, bottom = box.bottom, y = value => bottom - (bottom - top) * (value - low) / (high - low);
  const group = node(svg, "g", { "data-strip": kind });
  node(group, "path", { class: "axis", d: `M${left} ${top}V${bottom}H${right}` });
  const middle = (low + high) / 2;
  for (const value of [low, middle, high]) {
    node(group, "path", { class: "tick", d: `M${left} ${y(value)}H${right}` });
    node(group, "text", { x: left - 4, y: y(value) + 4, "text-anchor": "end" }, Math.round(value));
  }
  node(group, "text", { x: left, y: top - 5 }, `${name}, ${unit}`);
  const points = [];
  series.forEach((sample, at) => {
    if (sample[0] > end) return;
    // A value that did not change was not sent: it stays until shortly before the next.
    if (at > 0 && sample[0] - series[at - 1][0] > 0.15) points.push(`${x(sample[0]).toFixed(1)},${y(series[at - 1][index]).toFixed(1)}`);
    points.push(`${x(sample[0]).toFixed(1)},${y(sample[index]).toFixed(1)}`);
  });
  const last = valuesAt(end);
  if (last) points.push(`${right},${y(last[index]).toFixed(1)}`);
  node(group, "polyline", { class: kind, points: points.join(" ") });
}
function plot() {
  const svg = $("plot");
  if (!hello || !svg.clientWidth) return;
  const { stroke_mm, max_speed_mm_per_s, overdrive_force_n } = hello.limits;
  while (svg.children.length > 1) svg.lastChild.remove();
  // In pixels, so that its text is as large as any.
  const right = svg.clientWidth - 2, left = 44, height = (svg.clientHeight - 20) / 3;
  const end = heldAt ?? (isFresh() ? now + (performance.now() - seenAt) / 1000 : now);
  const x = time => Math.min(right, Math.max(left, right - (end - time) * (right - left) / WINDOW_S));
  [{ kind: "w", name: "width", unit: "mm", index: 1, low: 0, high: stroke_mm },
    { kind: "s", name: "speed", unit: "mm/s", index: 2, low: -max_speed_mm_per_s, high: max_speed_mm_per_s },
    { kind: "f", name: "force", unit: "N", index: 3, low: 0, high: overdrive_force_n },
  ].forEach((kind, at) => strip(svg, { left, right, top: at * height, bottom: (at + 1) * height - 6 }, kind, x, end));
  const bottom = 3 * height - 6;
  for (const mark of marks) if (mark.time > end - WINDOW_S && mark.time <= end) {
    const line = node(svg, "path", { class: mark.bad ? "event bad" : "event", d: `M${x(mark.time)} 16V${bottom}` });
    node(line, "title", {}, mark.text);
  }
  for (let ago = WINDOW_S; ago >= 0; ago -= 10) {
    const anchor = ago === WINDOW_S ? "start" : ago ? "middle" : "end";
    node(svg, "text", { x: x(end - ago), y: bottom + 18, "text-anchor": anchor }, ago ? `−${ago} s` : heldAt !== null ? "pause" : isFresh() ? "now" : "last state");
  }
  if (cursorAt === null) return write($("cursor"), "");
  const time = end - cursorAt, values = valuesAt(time);
  node(svg, "path", { class: "at", d: `M${x(time)} 16V${bottom}` });
  const near = marks.filter(mark => Math.abs(mark.time - time) < 0.3).map(mark => mark.text);
  write($("cursor"), values ? [`−${cursorAt.toFixed(1)} s`, `${values[1].toFixed(1)} mm`, `${values[2].toFixed(1)} mm/s`,
    `${values[3].toFixed(1)} N`, ...near].join(" · ") : "");
}
$("hold").addEventListener("change", () => { heldAt = $("hold").checked ? now : null; plot(); });
$("plot").addEventListener("pointermove", event => {
  const box = $("plot").getBoundingClientRect(), share = (event.clientX - box.left - 44) / (box.width - 46);
  cursorAt = Math.min(WINDOW_S, Math.max(0, WINDOW_S * (1 - share)));
  plot();
});
for (const leave of ["pointerleave", "blur"]) $("plot").addEventListener(leave, () => { cursorAt = null; plot(); });
$("plot").addEventListener("keydown", event => {
  const step = { ArrowLeft: 0.5, ArrowRight: -0.5 }[event.key];
  if (!step) return;
  event.preventDefault();
  cursorAt = Math.min(WINDOW_S, Math.max(0, (cursorAt ?? 0) + step));
  plot();
});
onGone.push(plot);
// Every 100 ms, every second while nothing changes, and less often while the timer is late: many windows must leave time for clicks.
let timer = 0, rests = false;
function keepPlotting(pause, isAtRest = false) {
  clearTimeout(timer);
  rests = isAtRest;
  const due = performance.now() + pause;
  timer = setTimeout(() => {
    const late = performance.now() - due;
    if (isFresh() && !pages[0].hidden) plot();
    const isLate = late > 30, hasRested = series.length && now - series[series.length - 1][0] > 1;
    keepPlotting(isLate ? Math.min(1000, 2 * pause) : Math.max(hasRested ? 1000 : 100, 0.9 * pause), !isLate && hasRested);
  }, pause);
}
keepPlotting(100);
