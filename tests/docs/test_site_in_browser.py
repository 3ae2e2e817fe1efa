"""The documentation as people see it: opened as files, without a network, on a desk and a phone, in light and dark."""

from __future__ import annotations

import json
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from tests.long_cases import soak_but

if TYPE_CHECKING:
    from collections.abc import Iterator

DESK, PHONE = 1280, 390  # px
SCHEMES = ("light", "dark")
#: One page of each kind, with tables, code of several languages, drawings, and what mkdocstrings makes.
KINDS = (
    "index.html",
    "extend.html",
    "cli.html",
    "reference-analysis.html",
    "what-a-value-means.html",
    "decisions/0012-one-keeper-per-run.html",
)
# The least contrast of text that the guidelines for accessible pages ask for: https://www.w3.org/TR/WCAG22/#contrast-minimum
LEAST_CONTRAST = 4.5

#: Tables with a part that is beyond their box or beyond the text, as their first words.
CUT_TABLES = """
    [...document.querySelectorAll(".md-content table")].filter(table => {
        const text = document.querySelector(".md-content__inner").getBoundingClientRect();
        return table.scrollWidth > table.clientWidth + 1 || table.getBoundingClientRect().right > text.right + 1;
    }).map(table => table.textContent.trim().slice(0, 60))
"""
#: Puts what is below the header of another page here, and waits for its pictures.
SHOW = """
    (async html => {
        const other = new DOMParser().parseFromString(html, "text/html");
        document.querySelector(".md-container").replaceWith(other.querySelector(".md-container"));
        const awaited = [...document.images].filter(image => image.loading !== "lazy" && !image.complete);
        await Promise.all(awaited.map(image => new Promise(done => image.onload = image.onerror = done)));
    })
"""
#: Text that is shown with less contrast than the least, as [contrast, colour, ground, words].
FAINT_TEXT = """
    (least => {
        const parts = colour => (colour.match(/[\\d.]+/g) || []).map(Number);
        const light = ([r, g, b]) => [r, g, b].map(v => v / 255)
            .map(v => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4)
            .reduce((sum, v, place) => sum + v * [0.2126, 0.7152, 0.0722][place], 0);
        const over = (top, ground) => [0, 1, 2].map(n => top[n] * (top[3] ?? 1) + ground[n] * (1 - (top[3] ?? 1)));
        const ground = element => {
            const colours = [];
            for (let e = element; e; e = e.parentElement) colours.push(parts(getComputedStyle(e).backgroundColor));
            return colours.reverse().reduce((below, top) => over(top, below), [255, 255, 255]);
        };
        const faint = new Map();
        for (const element of document.querySelectorAll("body *")) {
            const words = [...element.childNodes].filter(n => n.nodeType === 3).map(n => n.data.trim()).join("");
            const style = getComputedStyle(element);
            if (!words || !element.checkVisibility({opacityProperty: true, visibilityProperty: true})) continue;
            if (element.closest("svg, script, .headerlink, .md-skip, .md-search__suggest, label[hidden]")) continue;
            const below = ground(element), [a, b] = [light(over(parts(style.color), below)), light(below)];
            const contrast = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
            if (contrast < least) {
                const key = style.color + " on " + below.map(Math.round);
                faint.has(key) || faint.set(key, [contrast.toFixed(2), key, words.slice(0, 40), element.className]);
            }
        }
        return [...faint.values()];
    })
"""


@pytest.fixture
def tab(browser: Any) -> Iterator[Any]:
    """The browser, which afterwards prefers no colours and fetches everything again."""
    yield browser
    browser.call("Emulation.setEmulatedMedia", features=[])
    browser.call("Network.setBlockedURLs", urls=[])


@pytest.mark.long
def test_no_table_is_cut_on_a_desk_and_no_page_is_wider_than_a_phone(site: Path, tab: Any) -> None:
    # Without the theme's program, which puts each table into a box of its own, what is too wide is seen.
    tab.call("Network.setBlockedURLs", urls=["*bundle*.js"])
    pages = sorted(filter(_may_be_wide, site.rglob("*.html")))
    faults: dict[str, Any] = {}
    for _, alike in groupby(sorted(pages, key=_frame), key=_frame):
        together = list(alike)
        tab.open(together[0], width=DESK, height=300)
        for page in together:
            _show(page, tab)
            cut = tab.evaluate(CUT_TABLES)
            beyond = tab.evaluate("document.documentElement.scrollWidth > document.documentElement.clientWidth")
            if cut or beyond:
                faults[page.relative_to(site).as_posix()] = {"cut at 1280 px": cut, "beyond": beyond}
        tab.call("Emulation.setDeviceMetricsOverride", width=PHONE, height=844, deviceScaleFactor=1, mobile=True)
        # The theme's header, whose second title its program hides, is looked at with the pages of each kind.
        tab.evaluate("document.querySelector('.md-header').remove()")
        for page in together:
            _show(page, tab)
            if (wide := tab.evaluate("document.documentElement.scrollWidth")) > PHONE:
                faults.setdefault(page.relative_to(site).as_posix(), {})["on a phone"] = wide
    assert faults == {}


def _frame(page: Path) -> tuple[Path, bool]:
    """Return what pages with the same style sheets share; a server gives 404.html for any address."""
    return page.parent, page.name == "404.html"


def _show(page: Path, tab: Any) -> None:
    """Show all but the header of a page in another one of its folder: a fifth of the work of opening it."""
    tab.evaluate(f"{SHOW}({json.dumps(page.read_text(encoding='utf-8'))})")


def _may_be_wide(page: Path) -> bool:
    """Whether a page is a guide or has a table or a picture; most decisions are text alone."""
    return page.parent.name != "decisions" or any(tag in page.read_text("utf-8") for tag in ("<table", "<img alt"))


@pytest.mark.long
def test_a_table_that_is_too_wide_is_noticed(site: Path, tab: Any) -> None:
    tab.open(site / "cli.html", width=DESK)
    assert tab.evaluate(CUT_TABLES) == []
    tab.evaluate("document.querySelector('.md-content td').textContent = 'wide'.repeat(200)")
    assert len(tab.evaluate(CUT_TABLES)) == 1


@pytest.mark.long
@pytest.mark.parametrize("scheme", soak_but({"dark"}, SCHEMES))
def test_everything_is_legible(scheme: str, site: Path, tab: Any) -> None:
    tab.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
    faint = {}
    for page in KINDS:
        tab.open(site / page, width=DESK)
        told = tab.evaluate("document.body.dataset.mdColorScheme")
        assert told == {"light": "default", "dark": "slate"}[scheme]
        if found := tab.evaluate(f"{FAINT_TEXT}({LEAST_CONTRAST})"):
            faint[page] = found
    assert faint == {}
    assert tab.evaluate(f"{FAINT_TEXT}(99)"), "nothing was looked at"


@pytest.mark.long
def test_axe_finds_nothing_against_pages_of_each_kind(site: Path, tab: Any) -> None:
    faults = {}
    for page in KINDS:
        tab.open(site / page, width=DESK)
        if found := tab.inaccessible():
            faults[page] = found
    assert faults == {}


@pytest.mark.long
def test_no_word_in_angle_brackets_is_taken_for_an_element(site: Path, tab: Any) -> None:
    unknown = "[...document.querySelectorAll('.md-content *')].filter(each => each instanceof HTMLUnknownElement)"
    faults = {}
    for page in sorted(site.glob("reference*.html")):  # made from docstrings, where nobody sees the page
        tab.open(page)
        if found := tab.evaluate(f"{unknown}.map(each => each.localName)"):
            faults[page.name] = found
    assert faults == {}


@pytest.mark.long
@pytest.mark.parametrize("page", KINDS)
def test_nothing_is_fetched_from_elsewhere_and_nothing_complains(page: str, site: Path, tab: Any) -> None:
    tab.open(site / page)
    assert [url for url in tab.requests if not url.startswith(site.as_uri())] == []
    assert tab.complaints == []
    tab.open(site / page, width=PHONE, height=844, is_phone=True)
    assert tab.evaluate("document.documentElement.scrollWidth") <= PHONE


@pytest.mark.long
def test_links_of_the_start_page_lead_to_pages(site: Path, tab: Any) -> None:
    tab.open(site / "index.html")
    links = tab.evaluate(
        "[...document.querySelectorAll('a[href]')].map(a => a.href).filter(u => u.startsWith('file:'))"
    )
    files = {url.partition("#")[0].removeprefix("file://") for url in links}
    assert len(files) > 50
    assert [name for name in files if not name.endswith((".html", ".svg", ".png"))] == []
    assert [name for name in files if not Path(name).is_file()] == []


@pytest.mark.long
@pytest.mark.parametrize(("words", "leads_to"), [("warm up", "warm-up.html"), ("get notified", "notifications.html")])
def test_search_finds_a_page_that_is_opened_as_a_file(words: str, leads_to: str, site: Path, tab: Any) -> None:
    tab.open(site / "extend.html")
    assert tab.evaluate("location.protocol") == "file:"
    found = tab.evaluate(f"""new Promise((done, fail) => {{
        const field = document.querySelector("[data-md-component=search-query]");
        field.focus();
        field.value = {json.dumps(words)};
        field.dispatchEvent(new KeyboardEvent("keyup"));
        field.dispatchEvent(new Event("input", {{bubbles: true}}));
        const began = Date.now();
        (function look() {{
            const links = [...document.querySelectorAll(".md-search-result__link")].map(a => a.getAttribute("href"));
            if (links.length) done(links);
            else if (Date.now() - began > 100000) done([]);
            else setTimeout(look, 50);
        }})();
    }})""")
    assert any(leads_to in link for link in found[:5]), found


@pytest.mark.long
def test_code_has_colours(site: Path, tab: Any) -> None:
    tab.open(site / "extend.html")
    colours = tab.evaluate(
        "[...document.querySelectorAll('.highlight code span')].map(span => getComputedStyle(span).color)"
    )
    assert len(set(colours)) >= 4
