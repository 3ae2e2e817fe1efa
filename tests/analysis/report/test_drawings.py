"""A page holds its figures, and its tables as files, in little room."""

from __future__ import annotations

import base64
import csv
import html
import io
import json
import re
import tarfile
from urllib.parse import unquote
from xml.etree import ElementTree as ET

import pytest

from robot_runner.analysis.report.drawings import drawing_of

SVG = """<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" viewBox="0 0 252 180">
 <metadata>{beside}</metadata> <!-- 50% -->
 <g id="figure_1">{inside}</g>
</svg>"""


def drawn(inside: str, beside: str = "") -> str:
    """Return what stands within a drawing once a page holds it."""
    uri = drawing_of(SVG.format(inside=inside, beside=beside).encode()).uri
    assert '"' not in uri
    text = unquote(html.unescape(uri).partition(",")[2])
    ET.fromstring(text)  # noqa: S314 - of ours
    return text.partition(">")[2].removesuffix("</svg>")


@pytest.mark.parametrize(
    ("path", "written"),
    [
        ("M 39.1608 125.604 \nL 249.8328 125.604 \nL 249.8328 2.16 \nz\n", "M39.16 125.6l210.67 0 0-123.44z"),
        ("M 0 0 L 0.5 -0.25 M 10 10 L 10 11", "M0 0l.5-.25M10 10l0 1"),
        ("M 1 1 Q 2 2 3 1 Q 4 0 5 1 C 6 1 7 2 8 3", "M1 1q1 1 2 0 1-1 2 0c1 0 2 1 3 2"),
        ("M 1 1 L 3 1 z L 1 4", "M1 1l2 0zl0 3"),  # what is closed is where it began
        ("M 1 1 A 2 2 0 0 1 3 3", "M 1 1 A 2 2 0 0 1 3 3"),
    ],
)
def test_a_path_goes_to_the_same_points_to_a_hundredth_of_a_point(path, written):
    assert drawn(f'<path d="{path}"/>') == f"<path d='{written}'/>"


def test_small_steps_add_up_to_no_shift():
    steps = " ".join(f"L {0.004 * number:.3f} 0" for number in range(1, 1001))
    moved = re.findall(r"[\d.]+", drawn(f'<path d="M 0 0 {steps}"/>').replace("M0 0l", ""))
    assert sum(map(float, moved[::2])) == pytest.approx(4.0)


def test_only_names_that_something_refers_to_are_kept():
    inside = (
        '<defs><path id="far-2" d="M 0 0"/></defs><use xlink:href="#far-2" id="b" transform="translate(9.6094 0)"/>'
    )
    assert drawn(inside) == "<defs><path id='0' d='M0 0'/></defs><use href='#0' x='9.60'/>"
    assert drawn('<g clip-path="url(#p1)"/><clipPath id="p1"/>') == "<g clip-path='url(#0)'/><clipPath id='0'/>"


def test_points_inherit_the_style_that_all_have_unless_it_would_mean_another_thing():
    points = '<use xlink:href="#a" style="fill: #bb5566; stroke-width: 0.3"/>' * 2
    written = drawn(f'<g clip-path="url(#a)">{points}</g><path id="a"/>')
    assert written.startswith("<g clip-path='url(#0)' style='fill:#bb5566;stroke-width:0.3'><use href='#0'/><use ")
    faint = '<use xlink:href="#a" style="fill: #bb5566; opacity: 0.3"/>' * 2
    assert drawn(f"<g>{faint}</g><path id='a'/>").count("opacity") == 2


def test_signs_of_texts_end_neither_the_address_nor_its_attribute():
    assert drawn("<text>50% of \"a\" &amp; 'b' &lt; #1</text>") == "<text>50% of \"a\" &amp; 'b' &lt; #1</text>"


def test_a_page_holds_the_figures_of_its_report_in_less_room_than_their_files(plain_report):
    page = plain_report.document.read_text(encoding="utf-8")
    held = re.findall(r'src="(data:image/svg\+xml,[^"]*)"', page)
    files = [path.stat().st_size for path in plain_report.figures if path.suffix == ".svg"]
    assert len(held) == len(files)
    assert sum(map(len, held)) < 0.6 * sum(files)


def test_a_page_holds_all_tables_as_files(plain_report):
    page = plain_report.document.read_text(encoding="utf-8")
    [packed] = re.findall(r'href="data:application/gzip;base64,([^"]*)"', page)
    with tarfile.open(fileobj=io.BytesIO(base64.b64decode(packed))) as archive:
        held = {each.name: archive.extractfile(each).read() for each in archive.getmembers()}
    assert held == {path.name: path.read_bytes() for path in plain_report.tables}
    assert set(re.findall(r'data-file="([^"]*)"', page)) == held.keys()
    [anchor] = set(re.findall(r'<a href="#([^"]*)" data-file', page))
    assert f'<a id="{anchor}" download' in page  # without scripts, the links of tables lead there


#: Draws both on one canvas each, and returns how many of its pixels differ so that somebody may see it.
DIFFERENT = """
(async () => {
  const pixels = [];
  for (const address of [%s, %s]) {
    const image = new Image();
    image.src = address;
    await image.decode();
    const canvas = document.createElement("canvas");
    [canvas.width, canvas.height] = [940, 700];
    const context = canvas.getContext("2d");
    context.drawImage(image, 0, 0, canvas.width, canvas.height);
    pixels.push(context.getImageData(0, 0, canvas.width, canvas.height).data);
  }
  return pixels[0].filter((each, place) => Math.abs(each - pixels[1][place]) > 100).length;
})()
"""


@pytest.mark.long
def test_a_drawing_on_a_page_looks_like_its_file(browser, plain_report):
    drawings = sorted(path for path in plain_report.figures if path.suffix == ".svg")
    for path in drawings:
        address = f"data:image/svg+xml;base64,{base64.b64encode(path.read_bytes()).decode()}"
        small = html.unescape(drawing_of(path.read_bytes()).uri)
        assert browser.evaluate(DIFFERENT % (json.dumps(address), json.dumps(small))) < 20, path.name


@pytest.mark.long
def test_the_link_of_a_table_yields_its_file(browser, plain_report):
    browser.open(plain_report.document)
    browser.evaluate(
        "window.got = []; HTMLAnchorElement.prototype.click = function () { got.push([this.download, this.href]); }"
    )
    browser.evaluate(
        "document.querySelector('[data-file=\"runs.csv\"]').dispatchEvent(new Event('click', {cancelable: true}))"
    )
    browser.wait_for("window.got.length")
    [[name, address]] = browser.evaluate("window.got")
    assert name == "runs.csv"
    expected = next(path for path in plain_report.tables if path.name == name).read_bytes()
    assert unquote(address.partition(",")[2]).encode() == expected
    assert next(csv.reader(io.StringIO(expected.decode())))[0] == "Run"
    assert browser.complaints == []


@pytest.mark.long
def test_without_scripts_there_is_no_empty_chart(browser, lone_page):
    browser.call("Emulation.setScriptExecutionDisabled", value=True)
    try:
        browser.call("Page.navigate", url=lone_page.document.as_uri())
        browser.wait_for("document.readyState === 'complete' && document.querySelector('figure.chart')")
        shown = "[...document.querySelectorAll('figure.chart')].filter(each => each.getClientRects().length).length"
        assert browser.evaluate(shown) == 0
    finally:
        browser.call("Emulation.setScriptExecutionDisabled", value=False)
