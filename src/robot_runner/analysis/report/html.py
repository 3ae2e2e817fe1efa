"""A document as one HTML file that fetches nothing: style, scripts, figures and data stand in it."""

from __future__ import annotations

import base64
import json
import re
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from robot_runner.analysis.report.blocks import Place
from robot_runner.analysis.report.markdown import csv_of, latex_of
from robot_runner.analysis.report.names import SafeNames

if TYPE_CHECKING:
    from collections.abc import Mapping

    from robot_runner.analysis.report.blocks import Document

__all__ = ["html_of"]

#: Rows of a table that a page shows; files have them all.
_MOST_ROWS = 400
#: Screen pixels for a point of a figure: a column of a paper becomes 470 pixels wide.
_SCALE = 1.87
_SIZE = re.compile(rb'<svg[^>]*? viewBox="0 0 ([\d.]+) ([\d.]+)"', re.DOTALL)
_PATH = re.compile(rb' d="[^"]*"')
_LONG_DECIMALS = re.compile(rb"(\d\.\d\d)\d+")


@dataclass(frozen=True, slots=True)
class _Drawing:
    """A figure as a page shows it."""

    uri: str
    width: int
    height: int


def html_of(document: Document, drawings: Mapping[str, bytes]) -> str:
    """Return a document as HTML.

    Args:
        document: what is written.
        drawings: its figures as SVG, by their names.
    """
    names = SafeNames()
    for section in document.sections:
        names(section.name)
    template = _environment().get_template("report.html.j2")
    return template.render(
        document=document,
        drawings={name: _drawing(svg) for name, svg in drawings.items()},
        anchor=names,
        safe_name=SafeNames(),
        most_rows=_MOST_ROWS,
    )


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("robot_runner.analysis.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.globals.update(
        kind_of=lambda block: type(block).__name__,
        asset=_asset,
        json_of=_json_of,
        data_uri=_data_uri,
        shown_part=lambda table: table.without(Place.FILE),
        csv_of=csv_of,
        latex_of=latex_of,
    )
    return environment


def _asset(name: str) -> Markup:
    # Ours, not a user's: it may hold markup.
    return Markup(files("robot_runner.analysis.report").joinpath("assets", name).read_text(encoding="utf-8"))  # noqa: S704


def _json_of(data: Mapping[str, Any]) -> Markup:
    r"""Return JSON that cannot end the element that it stands in."""
    text = json.dumps(data, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
    for character in "<>&\u2028\u2029":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return Markup(text)  # noqa: S704 - every character that HTML knows was escaped


def _data_uri(text: str, kind: str) -> str:
    return f"data:{kind};charset=utf-8,{quote(text)}"


def _drawing(svg: bytes) -> _Drawing:
    found = _SIZE.search(svg)
    width, height = map(float, found.groups()) if found else (252.0, 180.0)
    # A hundredth of a point is less than anybody sees.
    small = _PATH.sub(lambda path: _LONG_DECIMALS.sub(rb"\1", path[0]), svg[svg.index(b"<svg") :])
    uri = f"data:image/svg+xml;base64,{base64.b64encode(small).decode('ascii')}"
    return _Drawing(uri, round(width * _SCALE), round(height * _SCALE))
