"""A report opens in a browser, offline and without complaints, on a screen, a phone and paper."""

from __future__ import annotations

import re

import pytest
from tests.long_cases import long_but

from robot_runner.analysis.comparison.comparing import compare
from robot_runner.analysis.comparison.comparison_document import write_comparison
from robot_runner.analysis.report.writing import write_report
from robot_runner.analysis.wording import TIMES

VISIBLE = "[...document.querySelectorAll('{}')].filter(each => each.getClientRects().length > 0)"


@pytest.fixture(scope="module")
def demo_page(executed_demo, tmp_path_factory):
    """Return the page of the demo."""
    folder = tmp_path_factory.mktemp("demo_page")
    return write_report(executed_demo / "robot-runner-demo" / "basic_experiment", output=folder, figures=()).document


@pytest.mark.long
def test_the_demo_s_report_shows_its_sections_and_asks_for_nothing(browser, demo_page):
    assert demo_page.stat().st_size < 3_000_000
    browser.open(demo_page)
    assert browser.complaints == []
    assert browser.requests == [demo_page.as_uri()]
    titles = browser.evaluate(f"{VISIBLE.format('h2')}.map(each => each.lastChild.textContent)")
    assert titles == [
        "In brief",
        "What was done",
        "Outcome of each run",
        "Descriptive statistics",
        "Figures",
        "Tests",
        "Threats to validity",
        "How to replicate",
    ]
    assert browser.evaluate("[...document.images].every(each => each.complete && each.naturalWidth > 0)")
    assert browser.evaluate(f"{VISIBLE.format('figure.chart canvas')}.length") >= 4
    assert "simulated" in browser.evaluate("document.querySelector('.masthead').textContent")


@pytest.mark.long
def test_tables_of_the_demo_fit_on_a_small_desktop(browser, demo_page):
    browser.open(demo_page, width=1280)
    browser.evaluate("document.querySelectorAll('details').forEach(each => { each.open = true; })")
    cut = "[...document.querySelectorAll('.scroller')].filter(each => each.scrollWidth > each.clientWidth + 1)"
    assert browser.evaluate(f"{cut}.map(each => each.getAttribute('aria-label'))") == []
    sizes = "[...document.querySelectorAll('th')].filter(each => /Cohen|Effect size/.test(each.textContent))"
    assert browser.evaluate(f"{sizes}.map(each => each.getBoundingClientRect().right)")
    assert max(browser.evaluate(f"{sizes}.map(each => each.getBoundingClientRect().right)")) <= 1280


@pytest.mark.long
def test_the_demo_is_printed_on_fewer_than_ten_pages_in_black_on_white(browser, demo_page):
    browser.open(demo_page)
    browser.evaluate("document.documentElement.dataset.scheme = 'dark'")
    pages = re.findall(rb"/Type\s*/Page\b", browser.pdf(paper=(8.27, 11.69)))
    assert 0 < len(pages) < 10
    browser.call("Emulation.setEmulatedMedia", media="print")
    style = "getComputedStyle(document.body).{}, getComputedStyle(document.querySelector('figure img')).filter"
    printed = browser.evaluate(f"[{style.format('backgroundColor')}]")
    browser.call("Emulation.setEmulatedMedia", media="")
    assert printed == ["rgb(255, 255, 255)", "none"]


#: The contrast of each text with what lies behind it, by the formula of WCAG 2.2.
CONTRASTS = """
(() => {
  const channel = value => (value /= 255) <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4;
  const light = ([r, g, b]) => 0.2126 * channel(r) + 0.7152 * channel(g) + 0.0722 * channel(b);
  const parts = colour => colour.match(/[\\d.]+/g).map(Number);
  const behind = element => {
    for (let each = element; each; each = each.parentElement) {
      const found = parts(getComputedStyle(each).backgroundColor);
      if (found.length < 4 || found[3] === 1) { return found; }
    }
    return [255, 255, 255];
  };
  const low = [];
  document.querySelectorAll("body *").forEach(each => {
    const text = [...each.childNodes].filter(node => node.nodeType === 3).map(node => node.textContent.trim()).join("");
    if (!text || !each.getClientRects().length || each.closest("script, style, .skip")) { return; }
    const pair = [light(parts(getComputedStyle(each).color)), light(behind(each))].sort((a, b) => b - a);
    const contrast = (pair[0] + 0.05) / (pair[1] + 0.05);
    if (contrast < 4.5) { low.push([text.slice(0, 30), each.className, Math.round(contrast * 100) / 100]); }
  });
  return low;
})()
"""


@pytest.mark.long
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_all_text_stands_out_from_what_is_behind_it(browser, demo_page, scheme):
    browser.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
    browser.open(demo_page)
    browser.evaluate("document.querySelectorAll('details').forEach(each => { each.open = true; })")
    low, page = browser.evaluate(CONTRASTS), browser.evaluate("getComputedStyle(document.body).backgroundColor")
    browser.call("Emulation.setEmulatedMedia", features=[])
    assert low == []
    assert (page == "rgb(255, 255, 255)") is (scheme == "light")


@pytest.mark.long
def test_light_and_dark_can_be_chosen_by_a_button_that_keys_reach(browser, demo_page):
    browser.open(demo_page)
    shown = "getComputedStyle(document.body).backgroundColor"
    before = browser.evaluate(shown)
    browser.evaluate("document.querySelector('.scheme').focus()")
    for kind in ("keyDown", "keyUp"):
        browser.call("Input.dispatchKeyEvent", type=kind, key=" ", code="Space", windowsVirtualKeyCode=32, text=" ")
    assert browser.evaluate(shown) != before
    assert browser.evaluate("document.querySelector('.scheme').textContent") == "Light"
    browser.evaluate("document.querySelector('.scheme').click()")
    assert browser.evaluate(shown) == before
    assert browser.complaints == []


@pytest.mark.long
def test_every_picture_says_what_it_shows_and_stands_beside_numbers(browser, demo_page):
    browser.open(demo_page)
    assert browser.evaluate("[...document.images].filter(each => each.alt.length < 10).length") == 0
    assert browser.evaluate("[...document.querySelectorAll('.plot')].every(each => each.ariaLabel.length > 10)")
    [picture, table] = browser.evaluate(
        "[...document.querySelectorAll('#trajectory .beside > *')].map(each => each.getBoundingClientRect().toJSON())"
    )
    assert picture["right"] <= table["left"]
    assert abs(picture["top"] - table["top"]) < 20


def test_links_lead_to_sections(browser, sampled_page):
    browser.open(sampled_page)
    links = "[...document.querySelectorAll('a[href^=\"#\"]')].map(each => decodeURIComponent(each.hash.slice(1)))"
    names = browser.evaluate("[...document.querySelectorAll('[id]')].map(each => each.id)")
    assert set(browser.evaluate(links)) <= set(names)
    assert len(set(names)) == len(names)


def test_a_chart_answers_to_the_pointer(browser, sampled_page):
    browser.open(sampled_page)
    chart = "figure[data-chart=course]"
    browser.point_at(f"{chart} .u-over", 0.7, 0.5)
    told = browser.evaluate(f"document.querySelector('{chart} .readout').textContent")
    assert "task" in told
    assert "Video 8.000 W" in told
    browser.point_at("figure[data-chart=points] .u-over", 0.052, 0.5)
    assert browser.complaints == []


def test_a_chart_shows_single_runs_and_hides_treatments(browser, sampled_page):
    browser.open(sampled_page)
    chart = "document.querySelector('figure[data-chart=course]')"
    browser.evaluate(f"{chart}.querySelectorAll('.controls button')[1].click()")
    browser.evaluate(f"{chart}.querySelector('.legend button').click()")
    pressed = browser.evaluate(
        f"[...{chart}.querySelectorAll('button')].map(each => each.getAttribute('aria-pressed'))"
    )
    assert pressed == ["false", "true", "false", "true"]
    assert browser.evaluate(f"{chart}.querySelectorAll('canvas').length") == 1
    assert browser.complaints == []


def test_a_point_tells_its_run_and_its_value(browser, sampled_page):
    browser.open(sampled_page)
    chart = "figure[data-chart=points]"
    said = set()
    for share in (0.06, 0.16, 0.25, 0.35, 0.45):
        for height in (0.1, 0.15, 0.2):
            browser.point_at(f"{chart} .u-over", share, height)
            said.add(browser.evaluate(f"(e => e.hidden ? '' : e.textContent)(document.querySelector('{chart} .tip'))"))
    assert any(text.startswith("r_") and "Video" in text and text.endswith(" J") for text in said)
    assert {text.rpartition(" · ")[2] for text in said if text} <= {
        "870.1 J",
        "872.4 J",
        "869.0 J",
        "874.2 J",
        "871.3 J",
    }


@pytest.mark.parametrize("width", [320, 390, 800])
def test_a_narrow_screen_is_not_wider_than_itself(browser, sampled_page, width):
    browser.open(sampled_page, width=width, height=800, is_phone=True)
    assert browser.evaluate("document.documentElement.scrollWidth") <= width
    assert browser.complaints == []


#: Has a page keep what it draws on canvases as text, in a browser of a reader who writes 1.200,5.
DRAWN = """
Object.defineProperty(navigator, 'language', {value: 'de-DE'});
window.drawn = [];
const draw = CanvasRenderingContext2D.prototype.fillText;
CanvasRenderingContext2D.prototype.fillText = function (text, ...more) {
  window.drawn.push(text);
  return draw.call(this, text, ...more);
};
"""


@pytest.mark.long
@pytest.mark.parametrize(
    ("values", "marks"),
    [
        ((0.00021, 0.00034, 0.00047), {"0.00020", "0.00025", "0.00030"}),
        ((1.0e-9, 1.4e-9, 2.6e-9), {f"1.0{TIMES}10⁻⁹", f"1.5{TIMES}10⁻⁹", f"2.0{TIMES}10⁻⁹", f"2.5{TIMES}10⁻⁹"}),
        ((-1200.0, -1250.5, -1400.0), {f"\N{MINUS SIGN}1,{part}" for part in (400, 350, 300, 250, 200)}),
        ((1e9, 1e9 + 20, 1e9 + 30), {"1,000,000,000", "1,000,000,010", "1,000,000,020"}),
        ((0.0, 0.5, 1.25), {"0.00", "0.25", "0.50"}),
    ],
)
def test_axes_have_marks_that_differ_and_read_as_the_numbers_of_the_report(browser, make_folder, values, marks):
    rows = [("A", each) for each in values]
    folder = make_folder(factors={"T": ["A"]}, rows=rows, measures={"Latency": "s"})
    script = browser.call("Page.addScriptToEvaluateOnNewDocument", source=DRAWN)
    try:
        browser.open(write_report(folder.root, figures=()).document)
        drawn = browser.evaluate("window.drawn")
    finally:
        browser.call("Page.removeScriptToEvaluateOnNewDocument", identifier=script["identifier"])
    assert marks <= {*drawn}, drawn


def test_names_without_a_blank_and_great_numbers_fit_on_a_phone(browser, make_folder):
    name = "Acceleration_of_the_mobile_platform_along_its_longitudinal_axis"
    rows = [(kind, 1_200_000.0 + 10_000 * place) for place, kind in enumerate("aaabbb")]
    folder = make_folder(factors={f"Planner_{name}": ["a", "b"]}, rows=rows, measures={name: "m·s⁻²"})
    browser.open(write_report(folder.root, figures=()).document, width=390, height=800, is_phone=True)
    browser.evaluate("document.querySelectorAll('details').forEach(each => { each.open = true; })")
    assert browser.evaluate("document.documentElement.scrollWidth") <= 390
    left = "(chart => chart.querySelector('.u-over').getBoundingClientRect().x - chart.getBoundingClientRect().x)"
    assert browser.evaluate(f"{left}(document.querySelector('figure[data-chart=points] .plot'))") >= 90
    reached = (
        "[...document.querySelectorAll('main *')].filter(e => e.scrollWidth > e.clientWidth + 1 && e.tabIndex < 0)"
    )
    scrolled = f"{reached}.filter(e => ['auto', 'scroll'].includes(getComputedStyle(e).overflowX))"
    assert browser.evaluate(f"{scrolled}.map(e => e.className)") == []  # keys scroll what has the focus
    assert browser.complaints == []


#: The tables that reach beyond the paper: what they would have there is printed nowhere.
CUT_OFF = """
[...document.querySelectorAll("table")]
  .filter(each => each.getBoundingClientRect().right > document.documentElement.clientWidth + 1)
  .map(each => each.parentElement.getAttribute("aria-label"))
"""


@pytest.mark.long
def test_no_column_of_a_table_is_cut_off_on_paper_where_treatments_are_long_words(browser, make_folder):
    treatments = [f"{'0123456789abcdef' * 4}/params_{number}.yaml" for number in range(3)]
    rows = [(each, 900.0 + 40 * place + 7 * run**2) for place, each in enumerate(treatments) for run in range(4)]
    folder = make_folder(factors={"Revision": treatments}, rows=rows, measures={"Energy": "J"})
    browser.open(write_report(folder.root, figures=()).document, width=680)  # A4 without its margins
    browser.evaluate("document.querySelectorAll('details').forEach(each => { each.open = true; })")
    browser.call("Emulation.setEmulatedMedia", media="print")
    cut_off = browser.evaluate(CUT_OFF)
    browser.call("Emulation.setEmulatedMedia", media="")
    assert cut_off == []


def test_paper_shows_figures_that_a_screen_folds_away(browser, sampled_page):
    browser.open(sampled_page)
    assert browser.evaluate("document.querySelectorAll('details[open]').length") == 0
    folded = "document.querySelectorAll('details:not([open])').length"
    browser.evaluate(f"addEventListener('beforeprint', () => {{ window.folded = {folded}; }})")
    assert browser.pdf().startswith(b"%PDF")
    assert browser.evaluate("window.folded") == 0
    assert browser.evaluate("document.querySelectorAll('details[open]').length") == 0


def test_names_are_no_markup_and_no_script(browser, make_folder):
    attack = "<img src=x onerror=alert(1)><script>alert(2)</script>"
    rows = [(f"{attack}{kind}", 1.0 + place) for place, kind in enumerate("aaabbb")]
    folder = make_folder(
        factors={attack: [f"{attack}a", f"{attack}b"]}, rows=rows, measures={f"{attack}m": attack}, name=attack
    )
    folder.write_samples("Meter", "samples.csv", f"time_s,{attack}_W", lambda place: [f"{t},{t}" for t in range(9)])
    browser.open(write_report(folder.root, figures=()).document)
    assert browser.complaints == []
    assert len(browser.requests) == 1
    assert browser.evaluate("document.querySelector('h1').textContent") == attack
    assert browser.evaluate("document.querySelectorAll('img[src=x]').length") == 0


def test_a_comparison_opens_as_well(browser, two_tasks, tmp_path):
    page = tmp_path / "comparison.html"
    write_comparison(compare(two_tasks(name="one").root, two_tasks(name="other").root, bound="1%"), page)
    browser.open(page)
    assert browser.complaints == []
    assert browser.requests == [page.as_uri()]
    titles = browser.evaluate(f"{VISIBLE.format('h2')}.map(each => each.lastChild.textContent)")
    assert titles == ["In brief", "What is compared", "Differences", "Agreement"]


@pytest.mark.parametrize("which", long_but(["sampled_page"], ["demo_page", "sampled_page"]))
def test_axe_finds_nothing_against_a_report(browser, which, request):
    browser.open(request.getfixturevalue(which))
    browser.evaluate("document.querySelectorAll('details').forEach(each => { each.open = true; })")
    assert browser.inaccessible() == []
