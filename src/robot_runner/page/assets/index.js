// All experiments below a folder: what runs, what waits for whom, what failed.
import { $, duration, element, setText } from "./parts.js";
import { word } from "./experiment.js";

const ORDER = ["waiting", "paused", "running", "failed", "stopped", "unreadable", "reading", "not begun", "of another tool", "imported", "done"];

export function showIndex(experiments) {
  const sorted = [...experiments].sort((one, other) => ORDER.indexOf(one.word) - ORDER.indexOf(other.word) || (other.started_at || "").localeCompare(one.started_at || "") || one.folder.localeCompare(other.folder));
  const focused = document.activeElement && document.activeElement.dataset ? document.activeElement.dataset.id : null;
  $("experiments").replaceChildren(...sorted.map(item));
  $("nothing").hidden = experiments.length > 0;
  const wanted = experiments.filter((each) => each.word === "waiting").length;
  document.title = (wanted ? "(" + wanted + ") " : "") + "Experiments – Robot Runner";
  if (focused) { const found = document.querySelector('a[data-id="' + focused + '"]'); if (found) { found.focus({ preventScroll: true }); } }
}

function item(each) {
  const link = element("a", { href: "#/e/" + each.id, "data-id": each.id }, each.name || each.folder);
  const counts = each.counts;
  const facts = [];
  if (counts) {
    facts.push(counts.done + " of " + counts.run_count + " runs done");
    if (counts.failed) { facts.push(counts.failed + " failed"); }
    if (counts.todo) { facts.push(counts.todo + " to do"); }
  }
  if (each.left !== null && each.left !== undefined && each.host) { facts.push((each.left_is_least ? "at least " : "about ") + duration(each.left) + " left"); }
  const now = each.word === "waiting" && each.waiting ? "Waits for you: " + (each.waiting.step || "may " + each.waiting.run + " start?")
    : each.problem ? each.problem.problem
    : each.in_flight && each.in_flight.length ? each.in_flight.map((run) => run.run + (run.event ? ", " + run.event.replaceAll("_", " ") : "")).join("; ") : "";
  const bar = counts && counts.run_count ? share(counts) : null;
  return element("li", { class: "experiment-item " + each.word.replaceAll(" ", "-") },
    element("div", { class: "row" }, link, word(each.word)), bar,
    element("p", { class: "soft" }, facts.join(" · ")), now ? element("p", { class: "now-line" }, now) : null,
    element("p", { class: "path soft" }, each.folder + (each.host ? " on " + each.host : "")));
}

export function share(counts) {
  const bar = element("div", { class: "bar", "aria-hidden": "true" });
  for (const [name, count] of [["done", counts.done], ["failed", counts.failed]]) {
    const part = element("span", { class: name });
    part.style.width = (100 * count / Math.max(1, counts.run_count)) + "%";
    bar.append(part);
  }
  return bar;
}
