// The link of the section that is read is marked; what is folded is unfolded for paper; light and dark can be chosen.
(function () {
  "use strict";
  const scheme = document.querySelector(".scheme");
  const preferred = window.matchMedia("(prefers-color-scheme: dark)");
  function isDark() { return (document.documentElement.dataset.scheme || (preferred.matches ? "dark" : "light")) === "dark"; }
  function name() { scheme.textContent = isDark() ? "Light" : "Dark"; scheme.setAttribute("aria-label", "Show the page " + (isDark() ? "light" : "dark")); }
  scheme.addEventListener("click", function () { document.documentElement.dataset.scheme = isDark() ? "light" : "dark"; name(); });
  preferred.addEventListener("change", name);
  name();
  scheme.hidden = false;
  const links = new Map();
  document.querySelectorAll(".contents a").forEach(function (link) {
    links.set(link.getAttribute("href").slice(1), link);
  });
  const sections = Array.from(document.querySelectorAll(".section"));
  let marked = null;
  function mark() {
    const atEnd = window.innerHeight + window.scrollY >= document.documentElement.scrollHeight - 2;
    const read = atEnd
      ? sections[sections.length - 1]
      : sections.filter(function (each) { return each.getBoundingClientRect().top < 120; }).pop() || sections[0];
    const link = read && links.get(read.id);
    if (!link || link === marked) { return; }
    if (marked) { marked.removeAttribute("aria-current"); }
    link.setAttribute("aria-current", "true");
    marked = link;
    const nav = link.closest(".contents");
    if (nav.scrollWidth > nav.clientWidth) {
      nav.scrollTo({ left: link.offsetLeft - nav.clientWidth / 2 + link.offsetWidth / 2 });
    }
  }
  document.addEventListener("scroll", mark, { passive: true });
  mark();
  window.addEventListener("beforeprint", function () {
    document.querySelectorAll("details").forEach(function (each) { each.dataset.was = String(each.open); each.open = true; });
  });
  window.addEventListener("afterprint", function () {
    document.querySelectorAll("details").forEach(function (each) { each.open = each.dataset.was === "true"; });
  });
})();
