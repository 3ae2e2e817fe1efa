"""What was understood, as a TOML description: to be mended by hand, or to repeat an import."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from robot_runner.analysis.importing.understanding import Understanding

__all__ = ["description_text"]


def description_text(understanding: Understanding) -> str:
    """Return the description from which the same is understood, without any guess."""
    return "\n".join(_lines(understanding)) + "\n"


def _lines(understanding: Understanding) -> Iterator[str]:
    roles = understanding.roles
    yield "# How results made elsewhere are to be read: robot-runner import FOLDER --description THIS_FILE"
    yield f"name = {_quoted(understanding.name)}"
    yield f"table = {_quoted(understanding.table.path.name)}"
    yield "guess = false"
    if understanding.origin:
        yield f"origin = {_quoted(understanding.origin)}"
    yield ""
    yield "[columns]"
    for key, column in (("run_id", roles.run_id), ("status", roles.status), ("repetition", roles.repetition)):
        if column is not None:
            yield f"{key} = {_quoted(column)}"
    yield f"factors = {_listed(roles.factors)}"
    yield f"measures = {_listed(roles.measures)}"
    units = {name: unit.symbol for name, unit in understanding.units.items() if unit}
    yield from _section("units", units)
    for each in understanding.samples:
        yield ""
        yield "[[samples]]"
        yield f"file = {_quoted(each.file)}"
        yield f"name = {_quoted(each.name)}"
        yield f"time = {_quoted(each.time)}"
        if each.time_unit != "clock":
            yield f"time_unit = {_quoted(each.time_unit)}"
        named = {name: unit.symbol for name, unit in each.units.items() if unit}
        yield from _section("samples.units", named)
    yield from _section("recompute", {recipe.measure: recipe.words for recipe in understanding.recipes})


def _section(name: str, entries: Mapping[str, str]) -> Iterator[str]:
    if entries:
        yield ""
        yield f"[{name}]"
        for key, value in entries.items():
            yield f"{_quoted(key)} = {_quoted(value)}"


def _quoted(text: str) -> str:
    # A basic string of TOML is quoted as one of JSON is, for all that a heading can hold.
    return json.dumps(text, ensure_ascii=False)


def _listed(texts: Sequence[str]) -> str:
    return "[" + ", ".join(map(_quoted, texts)) + "]"
