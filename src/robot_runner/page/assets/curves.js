// Curves of samples, the way of the robot, and its picture: of the run that is being executed, or of one that was chosen.
import { $, ask, chips, colours, drawing, element, number, setText } from "./parts.js";

const FIRST = [/^power/i, /^cpu_percent$|^cpu/i, /rate|_hz$/i, /^voltage/i];
const view = { base: "", flying: null, watched: null, versions: {}, chosen: null, run: null, version: -1, files: [], names: [], off: null, plots: [], isAsking: false, due: null };

export function begin(base) {
  Object.assign(view, { base: base, flying: null, watched: null, versions: {}, chosen: null, run: null, version: -1, files: [], names: [], off: null, due: null });
  clear();
}

export function changed(data) {
  const before = view.chosen ?? view.flying, hasEnded = before in view.versions && !(before in data.runs);
  view.versions = data.runs;
  view.flying = view.watched in data.runs ? view.watched : Object.keys(data.runs)[0];
  // A run that has ended is looked at once more: its samples are whole now, and no longer those shown, or asked for, on the way.
  if (hasEnded) { load(before); return; }
  const run = view.chosen ?? view.flying, version = data.runs[run];
  if (version !== undefined && (view.run !== run || view.version !== version)) { view.version = version; load(run); }
}

// Of several runs in flight, follow this one; null is the first.
export function watch(run) {
  if (run === view.watched) { return; }
  view.watched = run;
  if (run !== null) { view.chosen = null; changed({ runs: view.versions }); }
}

export function choose(run) {
  view.chosen = run;
  if (run !== null) { load(run, true); } else if (view.flying) { load(view.flying); }
}

async function load(run, isAsked) {
  if (view.isAsking) { view.due = { run: run, isAsked: isAsked }; return; }
  view.isAsking = true;
  const base = view.base;
  const answer = await ask(base + "/curves/" + encodeURIComponent(run)).catch(() => null);
  view.isAsking = false;
  if (view.due) { const { run: next, isAsked: isNextAsked } = view.due; view.due = null; load(next, isNextAsked); return; }
  if (!answer || !answer.ok || base !== view.base) { return; }
  const isOther = view.run !== run;
  // What was seen last stays until the next run has samples.
  if (isOther && !answer.said.length && !isAsked) { return; }
  view.run = run;
  view.files = answer.said;
  show(isOther && isAsked);
}

function show(isAsked) {
  const known = view.files.flatMap((file) => file.columns.map((column) => ({ file: file, column: column, name: file.plugin + " " + column.name })));
  $("curves").hidden = known.length === 0 && !isAsked;
  setText($("curves-title"), "Samples of " + view.run + (known.length ? "" : ": none"));
  const names = known.map((each) => each.name);
  if (JSON.stringify(names) !== JSON.stringify(view.names)) { view.names = names; view.on = firstOnes(known); }
  chips($("curve-choice"), names.map((name) => name.replaceAll("_", " ")), view.on, (place) => {
    view.on = view.on.includes(place) ? view.on.filter((each) => each !== place) : [...view.on, place].sort((one, other) => one - other);
    show();
  });
  draw(view.on.map((place) => known[place]).filter(Boolean));
  showWay(view.files.find((file) => file.way && file.way.length));
  if (isAsked) { $("curves").scrollIntoView({ block: "nearest" }); }
}

function firstOnes(known) {
  const found = FIRST.map((pattern) => known.findIndex((each) => pattern.test(each.column.name))).filter((place) => place >= 0);
  return [...new Set(found)].slice(0, 2).concat(found.length || !known.length ? [] : [0]);
}

function clear() { view.plots.forEach((plot) => plot.chart.destroy()); view.plots = []; $("plots").replaceChildren(); }

// A chart is kept and given new data while the same curves are shown.
function draw(chosen) {
  const key = chosen.map((each) => each.name).join("\n");
  if (view.key !== key || view.plots.length !== chosen.length) {
    clear();
    view.key = key;
    const paint = colours();
    chosen.forEach((each) => {
      const box = element("div", { class: "plot" });
      const readout = element("p", { class: "readout soft" });
      $("plots").append(element("figure", { class: "chart", role: "img", "aria-label": "Curve of " + each.name }, element("figcaption", {}, each.name.replaceAll("_", " "), readout), box));
      view.plots.push({ box: box, readout: readout, chart: chart(box, paint, each) });
    });
  }
  chosen.forEach((each, place) => {
    const plot = view.plots[place];
    plot.chart.setData([each.file.times, each.column.high, each.column.low]);
    setText(plot.readout, "last " + number(each.column.last) + " at " + number(each.column.last_at) + " s" + (each.file.is_cut ? ": later ones are not drawn, the file is too long" : each.file.is_live ? ", being taken" : ""));
  });
}

function chart(box, paint, each) {
  const line = { stroke: paint.accent, width: 1.4, points: { show: false }, spanGaps: true };
  const axis = { stroke: paint.soft, font: paint.font, grid: { stroke: paint.line, width: 1 }, ticks: { show: false } };
  return new uPlot({
    width: Math.max(200, box.clientWidth || 320), height: 150, legend: { show: false }, cursor: { show: false },
    scales: { x: { time: false } }, series: [{}, line, line], bands: [{ series: [1, 2], fill: paint.accent.replace(")", " / 20%)").replace("rgb(", "rgb(").replaceAll(",", "") }],
    axes: [Object.assign({ size: 28, values: (u, marks) => marks.map((mark) => number(mark) + " s") }, axis, { grid: { show: false } }), Object.assign({ size: 52, values: (u, marks) => marks.map(number) }, axis)],
  }, [each.file.times, each.column.high, each.column.low], box);
}

new ResizeObserver(() => {
  view.plots.forEach((plot) => { const width = plot.box.clientWidth; if (width && Math.abs(width - plot.chart.width) > 1) { plot.chart.setSize({ width: width, height: 150 }); } });
}).observe($("plots"));

export function redraw() { if (view.files.length) { view.key = null; show(); } }

// ---- the way of the robot, to scale

function showWay(file) {
  $("way").hidden = !file;
  showPicture(file);
  if (!file) { $("map").replaceChildren(); return; }
  const xs = file.way.map((place) => place[0]), ys = file.way.map((place) => place[1]);
  const middle = (values) => (Math.min(...values) + Math.max(...values)) / 2;
  const span = Math.max(Math.max(...xs) - Math.min(...xs), Math.max(...ys) - Math.min(...ys), 0.5) * 1.15;
  const high = span, wide = span * 4 / 3;
  const left = middle(xs) - wide / 2, top = -middle(ys) - high / 2, hair = span / 320;
  const grid = [];
  const step = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 1000].find((each) => span / each <= 7) || span / 5;
  for (let at = Math.ceil(left / step) * step; at <= left + wide; at += step) { grid.push(drawing("line", { x1: at, x2: at, y1: top, y2: top + high })); }
  for (let at = Math.ceil(top / step) * step; at <= top + high; at += step) { grid.push(drawing("line", { x1: left, x2: left + wide, y1: at, y2: at })); }
  const last = file.pose;
  const svg = drawing("svg", { viewBox: [left, top, wide, high].join(" "), role: "img", "aria-label": "The way of the robot in " + view.run + "; it is at " + number(last[0]) + " m, " + number(last[1]) + " m" },
    drawing("g", { class: "grid", "stroke-width": hair }, ...grid),
    drawing("polyline", { class: "way", "stroke-width": 3 * hair, points: file.way.map((place) => place[0] + "," + -place[1]).join(" ") }),
    drawing("circle", { class: "start", cx: xs[0], cy: -ys[0], r: 4 * hair, "stroke-width": 2 * hair }),
    drawing("circle", { class: "robot-now", cx: last[0], cy: -last[1], r: 6 * hair }));
  const caption = element("figcaption", { class: "soft" }, "Way in " + view.run + ", by odometry; a square is " + step + " m");
  $("map").replaceChildren(svg, caption);
}

// ---- the simulated robot, as it is rendered where the page is served

export function setPictures(has) { view.hasPictures = has; }

async function showPicture(file) {
  const address = view.base + "/picture/" + encodeURIComponent(view.run);
  const key = file && view.hasPictures ? address + JSON.stringify(file.pose) : "";
  if (view.picture === key) { return; }
  view.picture = key;
  if (!key) { $("picture").hidden = true; return; }
  if (view.isRendering) { return; }
  view.isRendering = true;
  const answer = await fetch(address, { credentials: "same-origin", cache: "no-store" }).catch(() => null);
  view.isRendering = false;
  if (!answer) { return; }
  $("picture").hidden = false;
  $("picture-image").hidden = !answer.ok;
  if (answer.ok) {
    const earlier = $("picture-image").src;
    $("picture-image").src = URL.createObjectURL(await answer.blob());
    if (earlier.startsWith("blob:")) { URL.revokeObjectURL(earlier); }
    $("picture-image").alt = "The simulated robot where it was seen last in " + view.run;
    setText($("picture-note"), "Rendered where it was seen last");
  } else {
    setText($("picture-note"), (await answer.json()).problem);
  }
  if (view.picture !== key) { const latest = view.picture; view.picture = null; if (latest) { setTimeout(() => showPicture(view.files.find((each) => each.way && each.way.length)), 500); } }
}
