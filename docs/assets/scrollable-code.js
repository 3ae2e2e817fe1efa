// Code that is wider than its box is scrolled by keys, too: it can have the focus.
document.addEventListener("DOMContentLoaded", () => {
  for (const code of document.querySelectorAll("pre > code")) {
    if (code.scrollWidth > code.clientWidth) { code.tabIndex = 0; }
  }
});
