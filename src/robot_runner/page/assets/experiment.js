// One experiment: its state, what is being executed, means, findings and the log. The table and the curves have files of their own.
import { $, ask, chips, drawing, duration, element, number, setText, treatments, withUnit } from "./parts.js";
import * as table from "./table.js";
import * as curves from "./curves.js";
import { share } from "./index.js";

const WORDS = {
  running: ["is running", "good"], waiting: ["waits for you", "call"], paused: ["is paused", "call"], done: ["all runs are done", "good"],
  failed: ["ended, some runs failed", "bad"], stopped: ["nobody executes it", "quiet"], reading: ["is being read", "quiet"],
  "not begun": ["has not begun", "quiet"], unreadable: ["cannot be read", "bad"], "of another tool": ["executed by another tool", "quiet"],
  imported: ["executed elsewhere, and imported", "quiet"],
};
const EVENTS = {
  before_run: "is being prepared", start_run: "starts", start_measurement: "measurement begins", launch_mission: "on its mission",
  stop_measurement: "measurement ends", stop_run: "stops", populate_run_data: "values are computed", continue: "over", null: "is about to start",
};
// How long what was done stays to be read: what holds then is told by the state.
const SAID_MS = 10000;
// A telephone that writes 0,5 has no point beside its digits, and decimals stand behind one here.
const DECIMAL = (0.5).toLocaleString().includes(".") ? "decimal" : "text";
const shown = { id: null, about: null, state: null, means: null, factor: 0, measure: 0, asked: "", arrived: 0, logs: {}, watched: null };

export function word(name) {
  const [text, kind] = WORDS[name] || [name, "quiet"];
  return element("span", { class: "word " + kind }, text);
}

export function begin(id, about) {
  Object.assign(shown, { id: id, about: about, state: null, means: null, factor: 0, measure: 0, asked: "", logs: {}, watched: null });
  for (const part of ["ask", "flights", "curves", "way", "means", "table", "findings", "log"]) { $(part).hidden = true; }
  setText($("title"), "…");
  setText($("said"), "");
  $("dialog").close();  // it would stop another experiment than it names
  table.begin("/api/experiments/" + id, (run) => curves.choose(run));
  curves.begin("/api/experiments/" + id);
}

export function take(name, data) {
  if (name === "state") { showState(data); }
  if (name === "table") { table.setColumns(data); $("table").hidden = data.total === 0 && !data.note; }
  if (name === "rows") { table.change(data); }
  if (name === "means") { shown.means = data; showMeans(); }
  if (name === "findings") { showFindings(data); }
  if (name === "log") { shown.logs = data.runs; showLog(); }
  if (name === "samples") { curves.changed(data); }
}

export function redraw() { curves.redraw(); if (shown.means) { showMeans(); } }

// ---- state

function showState(state) {
  shown.state = state;
  shown.arrived = performance.now();
  curves.setPictures(Boolean(state.has_pictures));
  const marks = { waiting: "● ", paused: "❚❚ ", failed: "✕ " };
  document.title = (marks[state.word] || "") + state.name + " – Robot Runner";
  setText($("title"), state.name);
  setText($("kicker"), state.host ? "Live on " + state.host : "Robot Runner");
  const [text, kind] = WORDS[state.word] || [state.word, "quiet"];
  setText($("word"), text);
  $("word").className = "word " + kind;
  setText($("told"), state.problem ? state.problem.problem + (state.problem.fix ? " " + state.problem.fix : "") : toldOf(state));
  const counts = state.counts;
  if (counts) {
    const bar = share(counts);
    $("bar").replaceChildren(...bar.children);
    const parts = [counts.done + " of " + counts.run_count + " runs done"];
    if (counts.failed) { parts.push(counts.failed + " failed"); }
    if (counts.todo) { parts.push(counts.todo + " to do"); }
    if (state.excluded) { parts.push(state.excluded + " left out"); }
    setText($("counts"), parts.join(" · "));
    $("bar").setAttribute("aria-label", parts.join(", "));
  }
  showActions(state);
  showAsk(state);
  showFlights(state);
  tick();
}

function toldOf(state) {
  const told = [];
  if (state.word === "reading" && state.read !== null) { told.push(Math.round(100 * state.read) + " % of its journal is read"); }
  if (state.pause_is_requested && ["running", "waiting"].includes(state.word)) { told.push("pauses before the next run"); }
  told.push(...(state.gates || []).map((gate) => gate.run + " waits until " + gate.condition + (gate.seen ? " (" + gate.seen + ")" : "")));
  told.push(...(state.precision || []));
  if (state.damaged) { told.push(state.damaged + " lines of the journal are damaged and passed over"); }
  return told.join(" · ");
}

function tick() {
  const state = shown.state;
  if (!state || !state.counts) { setText($("left"), ""); return; }
  const passed = (performance.now() - shown.arrived) / 1000;
  // However long a run takes or a person is waited for, the other runs do not get shorter.
  const still = state.left === null ? null : state.host ? Math.max(state.left_of_others ?? state.left, state.left - passed) : state.left;
  const about = still === null || !state.counts.todo ? "" : (state.left_is_least ? "at least " : "about ") + duration(still) + " left";
  const when = state.host ? (state.started_at ? "began " + moment(state.started_at) : "") : state.finished_at ? "ended " + moment(state.finished_at) : "";
  setText($("left"), [about, when].filter(Boolean).join(" · "));
  document.querySelectorAll("[data-since]").forEach((each) => {
    const seconds = state.told_at - Date.parse(each.dataset.since) / 1000 + passed;  // a phone may have another time
    const expected = Number(each.dataset.expected);
    setText(each, "for " + duration(seconds) + (expected ? seconds <= expected ? ", about " + duration(expected - seconds) + " left" : ", longer than the " + duration(expected) + " expected" : ""));
  });
}
setInterval(tick, 1000);

function moment(stamp) {
  const at = new Date(stamp);
  const isToday = at.toDateString() === new Date().toDateString();
  return at.toLocaleString([], isToday ? { hour: "2-digit", minute: "2-digit" } : { dateStyle: "medium", timeStyle: "short" });
}

function showFlights(state) {
  const list = state.in_flight || [];
  $("flights").hidden = list.length === 0;
  if (!list.some((run) => run.run === shown.watched)) { watch(null); }
  const items = list.map((run) => {
    const phase = run.phase ? "phase " + run.phase + (run.phase_number ? " (" + run.phase_number + " of " + (run.phase_count || "?") + ")" : "") : "";
    const doing = run.event === "launch_mission" && phase ? phase : EVENTS[run.event] || run.event;
    return element("li", {},
      element("p", { class: "row" }, element("strong", {}, run.run), element("span", {}, doing), run.place ? element("span", { class: "soft" }, run.place) : null),
      element("p", { class: "soft" }, treatments(run.treatments) + (run.attempt > 1 ? " · attempt " + run.attempt : "")),
      run.since ? element("p", { class: "soft", "data-since": run.since, "data-expected": run.expected || "" }) : null,
      list.length > 1 ? watchButton(run.run, list[0].run) : null);
  });
  const focused = document.activeElement ? document.activeElement.dataset.watch : undefined;
  $("flight-list").replaceChildren(...items);
  if (focused) { document.querySelector("[data-watch=" + CSS.escape(focused) + "]")?.focus(); }
}

// Where several runs are in flight, the log and the samples are those of one: the first, or the one that was chosen.
function watchButton(run, first) {
  const button = element("button", { type: "button", "data-watch": run, "aria-pressed": String(run === (shown.watched || first)) }, "Log and samples");
  button.addEventListener("click", () => { watch(run); showFlights(shown.state); });
  return button;
}

function watch(run) {
  shown.watched = run;
  curves.watch(run);
  showLog();
}

// ---- what a person can do

function showActions(state) {
  const offered = [];
  const executed = ["running", "waiting", "paused"].includes(state.word);
  if (state.word === "paused" || (executed && state.pause_is_requested)) { offered.push(["end-pause", state.word === "paused" ? "Go on" : "Do not pause", "main"]); }
  if (["running", "waiting"].includes(state.word) && !state.pause_is_requested) { offered.push(["pause", state.word === "waiting" ? "Pause after " + state.waiting.run : "Pause after this run", ""]); }
  if (executed) { offered.push(["stop", "Stop…", "danger"]); }
  const may = shown.about.may_act ? offered : [];
  const key = JSON.stringify(may) + state.has_report;
  if ($("actions").dataset.key === key) { return; }
  $("actions").dataset.key = key;
  const buttons = may.map(([action, text, kind]) => {
    const button = element("button", { type: "button", class: kind, "data-action": action }, text);
    button.addEventListener("click", () => action === "stop" ? confirmStop() : act(action, {}));
    return button;
  });
  if (state.has_report) { buttons.push(element("a", { class: "button", href: "/api/experiments/" + shown.id + "/report", target: "_blank", rel: "noopener" }, "Report")); }
  $("actions").replaceChildren(...buttons);
}

function confirmStop() {
  const runs = shown.state.in_flight.map((run) => run.run).join(", ");
  const text = "It ends as by Ctrl-C" + (runs ? ": " + runs + " is closed, the robot is made safe, and the run is to be done again." : ".") + " To go on later, execute the config again.";
  dialog("Stop " + shown.state.name + "?", [element("p", {}, text)], ["Stop", () => act("stop", {})]);
}

export function dialog(title, content, yes) {
  setText($("dialog-title"), title);
  $("dialog-text").replaceChildren(...content);
  $("dialog-yes").hidden = !yes;
  setText($("dialog-yes"), yes ? yes[0] : "");
  $("dialog-yes").onclick = () => { $("dialog").close(); if (yes) { yes[1](); } };
  $("dialog").showModal();
}
$("dialog-no").addEventListener("click", () => $("dialog").close());

async function act(action, body) {
  setText($("said"), "…");
  const answer = await ask("/api/experiments/" + shown.id + "/" + action, body).catch(() => ({ ok: false, said: { problem: "The server cannot be reached." } }));
  $("said").classList.toggle("bad", !answer.ok);
  const first = (answer.said.findings || [])[0];
  const why = () => answer.status === 422 ? "Not all answers are taken: see below." : sentence(answer.said.problem) + (first && first.fix ? " " + first.fix : "");
  setText($("said"), answer.ok ? answer.said.said : why());
  clearTimeout(shown.fading);
  if (answer.ok) { shown.fading = setTimeout(() => setText($("said"), ""), SAID_MS); }
  return answer;
}

function sentence(text) { return text.charAt(0).toUpperCase() + text.slice(1) + (/[.?!]$/.test(text) ? "" : "."); }

// ---- what the experiment asks

function showAsk(state) {
  const waiting = state.word === "waiting" ? state.waiting : null;
  $("ask").hidden = !waiting;
  const key = waiting ? JSON.stringify([waiting.run, waiting.step, waiting.questions]) : "";
  if (key === shown.asked) { return; }
  shown.asked = key;
  if (!waiting) { return; }
  setText($("ask-title"), waiting.step || "May " + waiting.run + " start?");
  setText($("ask-run"), (waiting.is_after ? "This is about " : "Next is ") + waiting.run + (waiting.place ? ", " + waiting.place : "") + (treatments(waiting.treatments) ? ": " + treatments(waiting.treatments) : ""));
  const fields = waiting.questions.map(field);
  const button = element("button", { type: "submit", class: "main" }, waiting.step ? "It is done, go on" : "Start " + waiting.run);
  $("ask-form").replaceChildren(...fields, ...(shown.about.may_act ? [button] : [element("p", { class: "soft" }, "Your link is for looking only.")]));
  $("ask-form").onsubmit = (event) => { event.preventDefault(); answer(waiting, button); };
}

function field(question, place) {
  const id = "answer-" + place;
  const described = "hint-" + place + " error-" + place;
  const options = question.type === "yes or no" && !question.choices.length ? ["yes", "no"] : question.choices.map((each) => each === true ? "yes" : each === false ? "no" : String(each));
  const hint = element("span", { class: "soft", id: "hint-" + place }, question.hint);
  const error = element("p", { class: "error", id: "error-" + place, role: "alert" });
  if (options.length && options.length <= 6) {
    const choices = options.map((option, number) => element("label", { class: "choice" }, element("input", { type: "radio", name: question.name, value: option, id: id + "-" + number }), option));
    return element("fieldset", { "data-question": question.name, "aria-describedby": described }, element("legend", {}, question.text || question.name), element("div", { class: "choices" }, ...choices), error);
  }
  const attributes = { id: id, name: question.name, "aria-describedby": described, autocomplete: "off" };
  const control = options.length ? element("select", attributes, element("option", { value: "" }, ""), ...options.map((option) => element("option", {}, option)))
    : element("input", Object.assign(attributes, { inputmode: question.type === "number" ? DECIMAL : question.type === "whole number" ? "numeric" : "text" }));
  return element("div", { class: "field", "data-question": question.name }, element("label", { for: id }, question.text || question.name), control, hint, error);
}

async function answer(waiting, button) {
  const answers = {};
  for (const [name, value] of new FormData($("ask-form"))) { if (value !== "") { answers[name] = value; } }
  button.disabled = true;
  const answered = await act("continue", { run: waiting.run, step: waiting.step, answers: answers });
  button.disabled = false;
  const refused = answered.status === 422 ? answered.said.findings : [];
  let first = null;
  for (const box of $("ask-form").querySelectorAll("[data-question]")) {
    const found = refused.find((each) => each.where === box.dataset.question);
    setText(box.querySelector(".error"), found ? sentence(found.problem) + " " + found.fix : "");
    const control = box.querySelector("input, select");
    control.setAttribute("aria-invalid", String(Boolean(found)));
    first = first || (found ? control : null);
  }
  if (first) { first.focus(); }
}

// ---- means

function showMeans() {
  const means = shown.means.filter((each) => each.rows.some((row) => row.cells.some((cell) => cell[0])));
  $("means").hidden = means.length === 0;
  if (!means.length) { return; }
  const factor = means[Math.min(shown.factor, means.length - 1)];
  const measure = Math.min(shown.measure, factor.measures.length - 1);
  const names = [...means.map((each) => each.factor), ...factor.measures.map((each) => each.name)];
  const split = means.length;
  chips($("means-choice"), names, [Math.min(shown.factor, means.length - 1), split + measure], (place) => {
    if (place < split) { shown.factor = place; } else { shown.measure = place - split; }
    showMeans();
  });
  [...$("means-choice").children].forEach((each, place) => each.classList.toggle("apart", place === split));
  $("means-table").replaceChildren(meansTable(factor, measure));
}

function meansTable(factor, measure) {
  const unit = factor.measures[measure].unit;
  const cells = factor.rows.map((row) => row.cells[measure]);
  const ends = cells.filter((cell) => cell[1] !== null).flatMap((cell) => [cell[1] - (cell[2] || 0), cell[1] + (cell[2] || 0)]);
  const low = Math.min(...ends), high = Math.max(...ends), span = high - low || Math.abs(high) || 1;
  const x = (value) => 3 + 94 * (value - low + (high === low ? span / 2 : 0)) / span;
  const rows = factor.rows.map((row, place) => {
    const [count, mean, half] = cells[place];
    const graph = drawing("svg", { viewBox: "0 0 100 14", preserveAspectRatio: "none", class: "interval", "aria-hidden": "true" });
    if (mean !== null) {
      if (half) { graph.append(drawing("line", { x1: x(mean - half), x2: x(mean + half), y1: 7, y2: 7 })); }
      graph.append(drawing("line", { x1: x(mean), x2: x(mean), y1: 2, y2: 12, class: "mean" }));
    }
    return element("tr", {}, element("th", { scope: "row" }, row.treatment), element("td", { class: "number" }, String(count)),
      element("td", { class: "number" }, mean === null ? "–" : withUnit(mean, unit)), element("td", { class: "number" }, half === null ? "" : "± " + number(half)),
      element("td", { class: "graph" }, graph));
  });
  const head = ["Treatment", "Runs", "Mean", "95 %"].map((name, place) => element("th", { scope: "col", class: place ? "number" : "" }, name));
  const caption = element("caption", { class: "visually-hidden" }, factor.measures[measure].name + " by " + factor.factor);
  return element("table", {}, caption, element("thead", {}, element("tr", {}, ...head, element("td", { class: "graph" }))), element("tbody", {}, ...rows));
}

// ---- findings and log

function showFindings(data) {
  const failures = data.failures.map((text) => element("li", { class: "remark bad" }, element("p", {}, text)));
  const findings = [...data.last].reverse().map((each) => element("li", { class: "remark warning" },
    element("p", {}, each.problem), element("p", { class: "soft" }, [each.where, each.fix].filter(Boolean).join(" · "))));
  $("findings").hidden = failures.length + findings.length === 0;
  setText($("findings-title"), "Findings" + (data.total > data.last.length ? " (the last " + data.last.length + " of " + data.total + ")" : ""));
  $("finding-list").replaceChildren(...failures, ...findings);
}

function showLog() {
  const run = shown.watched || Object.keys(shown.logs || {})[0];
  const text = (shown.logs || {})[run];
  if (text === undefined) { return; }
  $("log").hidden = !text;
  setText($("log-title"), "Log of " + run);
  const box = $("log-text");
  const isAtEnd = box.scrollTop + box.clientHeight >= box.scrollHeight - 8;
  setText(box, text);
  if (isAtEnd) { box.scrollTop = box.scrollHeight; }
}
