// Small things that all parts of the page use. Whatever comes from an experiment becomes text, never markup.

export const $ = (id) => document.getElementById(id);

export function element(name, attributes, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes || {})) {
    if (value === true) { made.setAttribute(key, ""); } else if (value !== false && value !== null && value !== undefined) { made.setAttribute(key, value); }
  }
  made.append(...children.filter((child) => child !== null && child !== undefined));
  return made;
}

export function drawing(name, attributes, ...children) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes || {})) { made.setAttribute(key, value); }
  made.append(...children);
  return made;
}

export function setText(target, text) {
  if (target.textContent !== text) { target.textContent = text; }
}

// 1.5e-9 as reports and journals print it.
function powered(text) {
  return text.replace(/e([+-])(\d+)$/, (_, sign, power) => "×10" + (sign === "-" ? "⁻" : "") + power.replace(/\d/g, (digit) => "⁰¹²³⁴⁵⁶⁷⁸⁹"[digit]));
}

export function number(value) {
  if (value === null || value === undefined) { return "–"; }
  if (typeof value === "boolean") { return value ? "yes" : "no"; }
  if (typeof value !== "number") { return String(value); }
  const size = Math.abs(value);
  if (Number.isInteger(value) && size < 1e7) { return String(value).replace("-", "−"); }
  const digits = size >= 1e7 || (size > 0 && size < 1e-4) ? powered(value.toExponential(3)) : size >= 9999.5 ? value.toFixed(0) : value.toPrecision(4);
  return digits.replace(/^-/, "−");
}

export function withUnit(value, unit) {
  const text = number(value);
  return unit && unit !== "1" && text !== "–" ? text + " " + unit : text;
}

export function duration(seconds) {
  const whole = Math.max(0, Math.round(seconds));
  if (whole < 60) { return whole + " s"; }
  const minutes = Math.floor(whole / 60);
  if (minutes < 60) { return minutes + " min" + (whole % 60 ? " " + (whole % 60) + " s" : ""); }
  const hours = Math.floor(minutes / 60);
  if (hours < 48) { return hours + " h" + (minutes % 60 ? " " + (minutes % 60) + " min" : ""); }
  return Math.floor(hours / 24) + " days " + (hours % 24 ? (hours % 24) + " h" : "");
}

export function treatments(mapping) {
  return Object.entries(mapping || {}).map(([factor, value]) => factor + " " + value).join(" · ");
}

export async function ask(address, body) {
  const options = body === undefined ? {} : {
    method: "POST", body: JSON.stringify(body), headers: { "content-type": "application/json", "x-robot-runner": "1" },
  };
  // A connection that is dead without a word would be waited for a quarter of an hour.
  const signal = AbortSignal.timeout(60000);
  const answer = await fetch(address, Object.assign({ credentials: "same-origin", cache: "no-store", signal: signal }, options));
  let said = {};
  try { said = await answer.json(); } catch (error) { said = { problem: "The server's answer cannot be read." }; }
  return { status: answer.status, ok: answer.ok, said: said };
}

export function colours() {
  const style = getComputedStyle(document.documentElement);
  const probe = element("i", { hidden: true });
  document.body.append(probe);
  const read = (name) => { probe.style.color = "var(" + name + ")"; return getComputedStyle(probe).color; };
  const found = { ink: read("--ink"), soft: read("--soft"), line: read("--hair"), accent: read("--accent"), page: read("--page") };
  probe.remove();
  found.font = "12px " + style.getPropertyValue("--sans");
  return found;
}

// Buttons of which one is chosen; they are kept where the names stay the same, so that the focus stays where it is.
export function chips(target, names, chosen, choose, label) {
  const key = JSON.stringify(names);
  if (target.dataset.names !== key) {
    target.dataset.names = key;
    target.replaceChildren(...names.map((name, place) => {
      const button = element("button", { type: "button" }, name);
      button.addEventListener("click", () => choose(place));
      return button;
    }));
    if (label) { target.setAttribute("aria-label", label); }
  }
  const isChosen = Array.isArray(chosen) ? (place) => chosen.includes(place) : (place) => place === chosen;
  [...target.children].forEach((button, place) => button.setAttribute("aria-pressed", String(isChosen(place))));
}
