"""A report opens in a browser, offline and without complaints, on a screen, a phone and paper."""

from __future__ import annotations

import pytest

from robot_runner.analysis.comparison.comparing import compare
from robot_runner.analysis.comparison.comparison_document import write_comparison
from robot_runner.analysis.report.writing import write_report

VISIBLE = "[...document.querySelectorAll('{}')].filter(each => each.getClientRects().length > 0)"


def test_the_demo_s_report_shows_its_sections_and_asks_for_nothing(browser, executed_demo, tmp_path):
    page = write_report(executed_demo / "robot-runner-demo" / "basic_experiment", output=tmp_path, figures=()).document
    assert page.stat().st_size < 3_000_000
    browser.open(page)
    assert browser.complaints == []
    assert browser.requests == [page.as_uri()]
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


@pytest.mark.parametrize("width", [320, 390, 800])
def test_a_narrow_screen_is_not_wider_than_itself(browser, sampled_page, width):
    browser.open(sampled_page, width=width, height=800, is_phone=True)
    assert browser.evaluate("document.documentElement.scrollWidth") <= width
    assert browser.complaints == []


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
