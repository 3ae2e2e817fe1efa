// The live page: who looks, what is looked at, and what comes from the server as it happens.
import { $, ask, element, setText } from "./parts.js";
import { showIndex } from "./index.js";
import * as experiment from "./experiment.js";

const page = { about: null, source: null, shown: null, retry: 0, heard: 0 };
// How long a tab that nobody sees waits between its looks. Something comes every 15 s; a tab that receives nothing for longer has lost its connection.
const REST_MS = 10000, SILENT_MS = 40000;

// ---- light and dark

const preferred = window.matchMedia("(prefers-color-scheme: dark)");
const isDark = () => (document.documentElement.dataset.scheme || (preferred.matches ? "dark" : "light")) === "dark";
function nameScheme() {
  setText($("scheme"), isDark() ? "Light" : "Dark");
  $("scheme").setAttribute("aria-label", "Show the page " + (isDark() ? "light" : "dark"));
  experiment.redraw();
}
$("scheme").addEventListener("click", () => { document.documentElement.dataset.scheme = isDark() ? "light" : "dark"; nameScheme(); });
preferred.addEventListener("change", nameScheme);

// ---- the key of a link is exchanged for a cookie, and taken out of the address

async function login(key) {
  const answer = await ask("/api/login", { key: key });
  if (!answer.ok) { notice(answer.said.problem); }
  return answer.ok;
}

async function begin() {
  const key = /^#key=([0-9a-f]+)$/.exec(location.hash);
  if (key) {
    history.replaceState(null, "", location.pathname);
    if (!await login(key[1])) { return showLogin(); }
  }
  const answer = await ask("/api/about").catch(() => null);
  if (answer === null) { return setTimeout(begin, 1000); }
  if (answer.status === 401) { return showLogin(); }
  if (!answer.ok) { return notice(answer.said.problem); }
  page.about = answer.said;
  $("login").hidden = true;
  $("share").hidden = false;
  route();
}

function showLogin() {
  stop();
  for (const id of ["index", "experiment"]) { $(id).hidden = true; }
  $("login").hidden = false;
  setText($("link"), "");
  $("key").focus();
}

$("login-form").addEventListener("submit", async (event) => {
  event.preventDefault();
  const given = $("key").value.trim().replace(/^.*#key=/, "");
  if (await login(given)) { $("key").value = ""; begin(); }
});

export function notice(text) {
  setText($("notice"), text || "");
  $("notice").hidden = !text;
}

// ---- which experiment

function route() {
  const found = /^#\/e\/([0-9a-f]{16})$/.exec(location.hash);
  const id = page.about.only || (found && found[1]);
  notice("");
  $("home").hidden = !id || Boolean(page.about.only);
  $("index").hidden = Boolean(id);
  $("experiment").hidden = !id;
  page.shown = id;
  if (id) { experiment.begin(id, page.about); } else { setText($("title"), page.about.name); setText($("kicker"), "Robot Runner"); document.title = page.about.name + " – Robot Runner"; }
  follow();
}
window.addEventListener("hashchange", () => {
  if (location.hash.startsWith("#key=")) { begin(); } else if (page.about && (location.hash.startsWith("#/") || location.hash === "")) { route(); }
});

// ---- what comes

function stop() {
  if (page.source) { page.source.close(); page.source = null; }
  clearTimeout(page.retry);
}

function follow() {
  stop();
  page.heard = performance.now();
  const source = page.source = new EventSource(base() + "/events");
  const on = (name, take) => source.addEventListener(name, (event) => { page.heard = performance.now(); take(JSON.parse(event.data)); });
  source.addEventListener("open", () => connected(true));
  source.addEventListener("error", () => { stop(); connected(false); page.retry = setTimeout(again, 1000); });
  on("again", follow);
  on("here", () => {});
  if (page.shown) {
    for (const name of ["state", "table", "rows", "means", "findings", "log", "samples"]) { on(name, (data) => experiment.take(name, data)); }
  } else {
    on("experiments", showIndex);
  }
  on(page.shown ? "state" : "experiments", rest);
}

const base = () => page.shown ? "/api/experiments/" + page.shown : "/api";

// A browser has six connections to a server, for all tabs: one that nobody sees keeps none, and only its title up to date.
function rest() {
  if (document.hidden) { stop(); page.retry = setTimeout(again, REST_MS); }
}
document.addEventListener("visibilitychange", () => { if (page.about && $("login").hidden) { again(); } });

setInterval(() => { if (page.source && performance.now() - page.heard > SILENT_MS) { connected(false); again(); } }, 1000);

// Meanwhile another server may answer at this address, of another folder or with other rights, and an experiment may be gone.
async function again() {
  stop();
  const answer = await ask("/api/about").catch(() => null);
  if (answer && answer.status === 401) { return showLogin(); }
  const there = answer && page.shown ? await ask(base() + "/rows?count=0").catch(() => null) : answer;
  if (!answer || !answer.ok || !there) { connected(false); stop(); page.retry = setTimeout(again, 1500); return; }
  const isSame = JSON.stringify(answer.said) === JSON.stringify(page.about), isGone = there.status === 404;
  page.about = answer.said;
  if (isSame && !isGone) { return follow(); }
  if (isGone) { history.replaceState(null, "", location.pathname); }
  route();
  if (isSame) { notice(there.said.problem); }
}

function connected(is) {
  setText($("link"), is ? "live" : "connection lost, trying again");
  $("link").classList.toggle("lost", !is);
}

// ---- a link that others may look by

$("share").addEventListener("click", () => {
  const address = location.origin + "/#key=" + page.about.links.LOOKS;
  const field = element("input", { readonly: true, value: address, "aria-label": "Link for looking only" });
  const note = element("p", { class: "soft" }, "Who has this link can look, and do nothing. It lets them see all experiments of this page.");
  experiment.dialog("A link for looking only", [field, note], null);
  field.select();
});

nameScheme();
begin();
