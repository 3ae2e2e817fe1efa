"""Figures for a page: SVG that is compressed to a third of its size."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import chain
from xml.etree import ElementTree as ET
from xml.sax.saxutils import escape

from markupsafe import Markup

#: Screen pixels per point of a figure: a column of a paper becomes 470 pixels wide.
_SCALE = 1.87
_REFERENCE = re.compile(r"#([\w.-]+)(?=\)|$)")
_TOKEN = re.compile(r"[A-Za-z]|[-+]?[\d.]+(?:[eE][-+]?\d+)?")
_LONG_DECIMALS = re.compile(r"(\d\.\d\d)\d+")
_ALONG = re.compile(r"translate\(([-\d.]+) 0\)")
#: The commands of paths that matplotlib writes, with the number of their arguments.
_COMMANDS = {"M": 2, "L": 2, "Q": 4, "C": 6, "Z": 0}
#: Matplotlib's scale of letters, and ours, where letters are drawn in steps that are ten times as wide.
_LETTER, _COARSE_LETTER = "scale(0.015625)", "scale(.15625)"
#: Steps per unit of a path, and the size of a step: a hundredth of a point, also in letters, which is invisible.
_FINE, _COARSE = (100.0, 0.01), (0.1, 1.0)
#: What would end an address or the attribute that holds it, or what browsers leave out.
_ESCAPED = str.maketrans({"%": "%25", "#": "%23", "&": "&amp;", '"': "&#34;", "\n": None, "\r": None, "\t": None})


@dataclass(frozen=True, slots=True)
class Drawing:
    """A figure on a page: its address, for an attribute in double quotes, and its size in pixels."""

    uri: Markup
    width: int
    height: int


def drawing_of(svg: bytes) -> Drawing:
    """Return a figure of matplotlib for a page.

    Invisible parts are left out: unused ids, comments, blanks, digits below a hundredth of a point.
    """
    root = ET.fromstring(svg)  # noqa: S314 - we have drawn it ourselves
    width, height = map(float, root.get("viewBox", "0 0 252 180").split()[2:])
    texts = chain.from_iterable(each.attrib.values() for each in root.iter())
    used = dict.fromkeys(chain.from_iterable(map(_REFERENCE.findall, texts)))
    names = {name: f"{place:x}" for place, name in enumerate(used)}
    body = "".join(_written(each, names) for each in root)
    text = f"<svg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 {width:g} {height:g}'>{body}</svg>"
    uri = Markup(f"data:image/svg+xml,{text.translate(_ESCAPED)}")  # noqa: S704 - escaped in this line
    return Drawing(uri, round(width * _SCALE), round(height * _SCALE))


def _written(element: ET.Element, names: Mapping[str, str]) -> str:
    """Return an element as XML; nothing for an invisible one."""
    tag = _plain(element.tag)
    if tag == "metadata":
        return ""
    common = _style_of_all(element)
    attributes = "".join(_attributes(element, names)) + (f" style='{common}'" if common else "")
    inside = escape((element.text or "").strip()) + "".join(_written(each, names) for each in element)
    if tag == "g" and not attributes:
        return inside
    return f"<{tag}{attributes}>{inside}</{tag}>" if inside else f"<{tag}{attributes}/>"


def _plain(name: str) -> str:
    """Return a name without its namespace: only elements of SVG are left."""
    return name.rpartition("}")[2]


def _style_of_all(group: ET.Element) -> str:
    """Return the common style of all points of a group, and remove it from them: they inherit it."""
    styles = {each.get("style", "") for each in group}
    if (
        len(group) == 1
        or len(styles) != 1
        or "style" in group.attrib
        or {_plain(each.tag) for each in group} != {"use"}
    ):
        return ""
    if (style := styles.pop()).startswith("opacity") or "; opacity" in style:
        return ""  # it has another meaning on a group
    for each in group:
        each.attrib.pop("style", None)
    return _small_style(style)


def _attributes(element: ET.Element, names: Mapping[str, str]) -> Iterator[str]:
    is_letter = element.get("transform") == _LETTER
    for key, value in element.attrib.items():
        name, text = _plain(key), _REFERENCE.sub(lambda found: f"#{names[found[1]]}", value)
        along = _ALONG.fullmatch(value)
        if name == "id":
            text = names.get(value, "")
        elif name == "d":
            text = _small_path(value, *(_COARSE if is_letter else _FINE))
        elif name == "style":
            text = _small_style(value)
        elif name == "transform" and is_letter:
            text = _COARSE_LETTER
        elif name == "transform" and along and _plain(element.tag) == "use":
            name, text = "x", _LONG_DECIMALS.sub(r"\1", along[1])
        elif name in {"x", "y"}:
            text = _LONG_DECIMALS.sub(r"\1", value)
        if text:
            yield f" {name}='{escape(text, {chr(39): '&#39;'})}'"


def _small_style(text: str) -> str:
    return text.replace(": ", ":").replace("; ", ";")


def _small_path(text: str, steps: float, step: float) -> str:
    """Return a path with relative coordinates; unchanged where it has other commands."""
    tokens = iter(_TOKEN.findall(text))
    at = start = (0, 0)
    written: list[str] = []
    last = ""
    for command in tokens:
        count = _COMMANDS.get(command.upper())
        if count is None or (command.islower() and count):
            return " ".join(text.split())
        numbers = [round(float(next(tokens)) * steps) for _ in range(count)]
        base = (0, 0) if command == "M" else at
        shown = [_shown((each - base[place % 2]) * step) for place, each in enumerate(numbers)]
        letter = "M" if command == "M" else command.lower() if command != last else " "
        written.append((letter + " ".join(shown)).replace(" -", "-"))  # no blank is needed before a minus sign
        at = (numbers[-2], numbers[-1]) if numbers else start
        start = at if command == "M" else start
        last = command
    return "".join(written)


def _shown(number: float) -> str:
    return f"{number:g}".replace("0.", ".", 1) if abs(number) < 1 else f"{number:g}"
