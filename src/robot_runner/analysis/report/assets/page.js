// Mark the link of the current section; unfold folded parts for printing; switch between light and dark; unpack a table
// from the archive of all tables.
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
  // Each table's link leads to the archive of all tables; if the browser can unpack it, the link yields only this file.
  let files = null;
  async function unpack(address) {
    const packed = Uint8Array.from(atob(address.slice(address.indexOf(",") + 1)), function (each) { return each.charCodeAt(0); });
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
    const archive = new Uint8Array(await new Response(stream).arrayBuffer());
    function text(from, to) { return new TextDecoder().decode(archive.subarray(from, to)); }
    const found = new Map();
    for (let at = 0; archive[at]; ) {
      const size = parseInt(text(at + 124, at + 135), 8);
      found.set(text(at, at + 100).split("\0")[0], text(at + 512, at + 512 + size));
      at += 512 * (1 + Math.ceil(size / 512));
    }
    return found;
  }
  document.querySelectorAll("[data-file]").forEach(function (link) {
    link.addEventListener("click", async function (event) {
      if (!window.DecompressionStream) { return; }
      event.preventDefault();
      files = files || await unpack(document.querySelector(link.getAttribute("href")).href);
      const file = document.createElement("a");
      file.download = link.dataset.file;
      file.href = "data:text/plain;charset=utf-8," + encodeURIComponent(files.get(link.dataset.file));
      file.click();
    });
  });
  window.addEventListener("beforeprint", function () {
    document.querySelectorAll("details").forEach(function (each) { each.dataset.was = String(each.open); each.open = true; });
  });
  window.addEventListener("afterprint", function () {
    document.querySelectorAll("details").forEach(function (each) { each.open = each.dataset.was === "true"; });
  });
})();
