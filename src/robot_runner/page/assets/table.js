// The run table: only the rows that are seen are in the page, and only those near them are fetched.
import { $, ask, element, number, setText } from "./parts.js";

const HEIGHT = 34, PAGE = 100, MARGIN = 12, MOST_PAGES = 30;
const seen = { base: "", columns: null, total: 0, pages: new Map(), asked: new Set(), fetching: new Map(), chosen: null, choose: null, frame: 0, query: "", generation: 0 };

export function begin(base, choose) {
  Object.assign(seen, { base: base, columns: null, total: 0, choose: choose, chosen: null });
  forget();
}

export function setColumns(columns) {
  seen.columns = columns;
  setText($("table-note"), columns.note);
  $("table-note").hidden = !columns.note;
  seen.total = columns.total;
  const measures = columns.measures.map((each) => element("th", { scope: "col", class: "number" }, each.name, each.unit ? element("span", { class: "unit" }, " " + each.unit) : null));
  const factors = columns.factors.map((name) => element("th", { scope: "col" }, name));
  $("rows").tHead.replaceChildren(element("tr", { "aria-rowindex": 1 }, element("th", { scope: "col" }, "Run"), element("th", { scope: "col" }, "Status"), ...factors, ...measures));
  forget();
  draw();
}

// Rows that changed come with their cells; with a filter, or where many changed, what is seen is fetched again.
export function change(data) {
  if (seen.query || !data.is_all) { seen.stale = true; }
  for (const row of data.rows) {
    const number = Math.floor(row[0] / PAGE), page = seen.pages.get(number);
    if (page && !seen.query) { page[row[0] % PAGE] = row; }
    if (seen.fetching.has(number) && !seen.query) { seen.fetching.get(number).push(row); }
  }
  const last = data.rows[data.rows.length - 1];
  if ($("follow").checked && !seen.query && last) { bringIntoView(last[0]); }
  if (seen.stale) { seen.stale = false; clearTimeout(seen.later); seen.later = setTimeout(() => { forget(true); draw(); }, 400); } else { draw(); }
}

function forget(keep) {
  seen.generation += 1;
  seen.asked.clear();
  seen.fetching.clear();
  if (!keep) { seen.pages.clear(); } else { seen.isOld = new Set(seen.pages.keys()); return; }
  seen.isOld = new Set();
}

function bringIntoView(place) {
  const box = $("scroller"), top = place * HEIGHT;
  if (top < box.scrollTop || top > box.scrollTop + box.clientHeight - 3 * HEIGHT) { box.scrollTop = Math.max(0, top - box.clientHeight / 2); }
}

async function fetchPage(number) {
  if (seen.asked.has(number)) { return; }
  seen.asked.add(number);
  const generation = seen.generation, changed = [];
  seen.fetching.set(number, changed);
  const answer = await ask(seen.base + "/rows?start=" + number * PAGE + "&count=" + PAGE + seen.query).catch(() => null);
  if (generation !== seen.generation) { return; }
  seen.fetching.delete(number);
  if (!answer || !answer.ok) { setTimeout(() => { seen.asked.delete(number); draw(); }, 1500); return; }
  // What changed meanwhile may be newer than what was fetched; where it is older, its own change is still to come.
  for (const row of changed) { answer.said.rows[row[0] % PAGE] = row; }
  seen.pages.set(number, answer.said.rows);
  if (seen.isOld) { seen.isOld.delete(number); }
  if (seen.pages.size > MOST_PAGES) {
    const far = [...seen.pages.keys()].sort((one, other) => Math.abs(other - number) - Math.abs(one - number))[0];
    seen.pages.delete(far);
    seen.asked.delete(far);
  }
  seen.total = answer.said.total;
  draw();
}

function draw() {
  if (!seen.frame) { seen.frame = requestAnimationFrame(() => { seen.frame = 0; drawNow(); }); }
}

function drawNow() {
  if (!seen.columns) { return; }
  const box = $("scroller"), body = $("rows").tBodies[0];
  const first = Math.max(0, Math.floor(box.scrollTop / HEIGHT) - MARGIN);
  const last = Math.min(seen.total, Math.ceil((box.scrollTop + (box.clientHeight || 400)) / HEIGHT) + MARGIN);
  const width = 2 + seen.columns.factors.length + seen.columns.measures.length;
  const rows = [spacer(first, width)];
  const focused = document.activeElement && document.activeElement.dataset ? document.activeElement.dataset.run : null;
  for (let place = first; place < last; place += 1) {
    const number = Math.floor(place / PAGE), page = seen.pages.get(number);
    if (!page || (seen.isOld && seen.isOld.has(number))) { fetchPage(number); }
    rows.push(page && page[place % PAGE] ? line(page[place % PAGE], place) : element("tr", { class: "empty", "aria-hidden": "true" }, element("td", { colspan: width })));
  }
  rows.push(spacer(seen.total - last, width));
  body.replaceChildren(...rows);
  $("rows").setAttribute("aria-rowcount", seen.total + 1);
  setText($("found"), seen.query ? seen.total + (seen.total === 1 ? " run" : " runs") : "");
  if (focused) { const button = body.querySelector('button[data-run="' + CSS.escape(focused) + '"]'); if (button) { button.focus({ preventScroll: true }); } }
}

function spacer(count, width) {
  const row = element("tr", { class: "spacer", "aria-hidden": "true" }, element("td", { colspan: width }));
  row.firstChild.style.height = Math.max(0, count) * HEIGHT + "px";
  return row;
}

function line(row, place) {
  const [, run, status, factors, values, doubtful] = row;
  const button = element("button", { type: "button", class: "run", "data-run": run, "aria-pressed": String(seen.chosen === run) }, run);
  const measures = seen.columns.measures.map((each, number_) => {
    const isDoubtful = doubtful.includes(each.name);
    return element("td", { class: "number" + (isDoubtful ? " doubtful" : ""), title: isDoubtful ? "doubtful: see findings" : null }, number(values[number_]) + (isDoubtful ? " ?" : ""));
  });
  return element("tr", { "aria-rowindex": place + 2, class: status.replace(" ", "-") }, element("th", { scope: "row" }, button), element("td", { class: "status" }, status),
    ...factors.map((text) => element("td", {}, text)), ...measures);
}

$("scroller").addEventListener("scroll", draw, { passive: true });
new ResizeObserver(draw).observe($("scroller"));
$("scroller").addEventListener("wheel", () => { $("follow").checked = false; }, { passive: true });
$("scroller").addEventListener("touchmove", () => { $("follow").checked = false; }, { passive: true });
$("rows").addEventListener("click", (event) => {
  const button = event.target.closest("button.run");
  if (!button || !seen.choose) { return; }
  seen.chosen = seen.chosen === button.dataset.run ? null : button.dataset.run;
  seen.choose(seen.chosen);
  draw();
});

function filter() {
  const status = $("status").value, text = $("search").value.trim();
  seen.query = (status ? "&status=" + encodeURIComponent(status) : "") + (text ? "&text=" + encodeURIComponent(text) : "");
  if (!seen.query && seen.columns) { seen.total = seen.columns.total; } else { seen.total = Math.max(seen.total, 1); }
  forget();
  $("scroller").scrollTop = 0;
  draw();
}
$("status").addEventListener("change", filter);
$("search").addEventListener("input", () => { clearTimeout(seen.typing); seen.typing = setTimeout(filter, 200); });
