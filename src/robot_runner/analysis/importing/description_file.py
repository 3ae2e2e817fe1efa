"""Reading a description of results made elsewhere from a TOML file."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from robot_runner.analysis.importing.description import (
    ImportDescription,
    SamplesDescription,
    check_time_unit,
    check_unit,
    parse_recipe,
)
from robot_runner.core.errors import AnalysisError, did_you_mean
from robot_runner.core.storage.safe_write import storage_error

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path

    from robot_runner.analysis.importing.understanding import Understanding

__all__ = ["description_text", "read_description"]


# What was understood, as a TOML description: to be mended by hand, or to repeat an import.


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


_TEXTS = ("name", "table", "run_folder", "origin")
_COLUMNS = ("run_id", "status", "repetition", "factors", "measures", "ignore")
_SAMPLES = ("file", "name", "time", "time_unit", "units")
_SECTIONS = (*_TEXTS, "guess", "columns", "units", "samples", "recompute")
_ORIGINS = ("measured", "simulated", "estimated")


def read_description(path: Path) -> ImportDescription:
    """Read a description from a TOML file.

    Raises:
        AnalysisError: it is no description.
        StorageError: it cannot be read.
    """
    try:
        plain = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise storage_error(path, "read", error) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise AnalysisError(f"it is no TOML: {error}", where=str(path), fix="Mend this line.") from error
    return _Reader(str(path)).description(plain)


class _Reader:
    """Reads a description from plain data, and says where something is wrong with it."""

    def __init__(self, where: str) -> None:
        self._where = where

    def description(self, plain: Mapping[str, Any]) -> ImportDescription:
        self._only(plain, _SECTIONS, "")
        columns = self._table(plain, "columns")
        self._only(columns, _COLUMNS, "columns.")
        origin = self._text(plain, "origin")
        if origin not in {None, *_ORIGINS}:
            self._refuse(f"origin is {origin!r}", did_you_mean(str(origin), _ORIGINS))
        recipes = self._table(plain, "recompute")
        return ImportDescription(
            name=self._text(plain, "name"),
            table=self._text(plain, "table"),
            run_folder=self._text(plain, "run_folder"),
            run_id=self._text(columns, "run_id"),
            status=self._text(columns, "status"),
            repetition=self._text(columns, "repetition"),
            factors=self._texts(columns, "factors"),
            measures=self._texts(columns, "measures"),
            ignore=self._texts(columns, "ignore") or (),
            units=self._units(plain),
            samples=tuple(self._samples(each) for each in self._list(plain, "samples")),
            recipes=tuple(parse_recipe(f"{measure}={how}") for measure, how in recipes.items()),
            origin=origin,
            guess=bool(plain.get("guess", True)),
        )

    def _samples(self, plain: Any) -> SamplesDescription:
        if not isinstance(plain, Mapping):
            self._refuse("samples holds something that is no table", "Write [[samples]] before each file.")
        self._only(plain, _SAMPLES, "samples.")
        file = self._text(plain, "file")
        if file is None:
            self._refuse("samples names no file", 'Write file = "power.csv".')
        described = SamplesDescription(
            str(file),
            name=self._text(plain, "name"),
            time=self._text(plain, "time"),
            time_unit=self._text(plain, "time_unit"),
            units=self._units(plain),
        )
        check_time_unit(described.time_unit, self._where)
        return described

    def _units(self, plain: Mapping[str, Any]) -> dict[str, str]:
        units = {str(name): str(unit) for name, unit in self._table(plain, "units").items()}
        for name, unit in units.items():
            check_unit(unit, f"{self._where}, unit of {name!r}")
        return units

    def _text(self, plain: Mapping[str, Any], key: str) -> str | None:
        value = plain.get(key)
        if value is not None and not isinstance(value, str):
            self._refuse(f"{key} is {value!r}", "Give a text.")
        return value

    def _texts(self, plain: Mapping[str, Any], key: str) -> tuple[str, ...] | None:
        value = plain.get(key)
        if value is None:
            return None
        if isinstance(value, str):
            return (value,)
        if not isinstance(value, Sequence) or not all(isinstance(each, str) for each in value):
            self._refuse(f"{key} is {value!r}", "Give a list of names.")
        return tuple(value)

    def _table(self, plain: Mapping[str, Any], key: str) -> Mapping[str, Any]:
        value = plain.get(key, {})
        if not isinstance(value, Mapping):
            self._refuse(f"{key} is {value!r}", f"Write [{key}] and its entries below it.")
        return value  # type: ignore[no-any-return]

    def _list(self, plain: Mapping[str, Any], key: str) -> Iterable[Any]:
        value = plain.get(key, [])
        if not isinstance(value, list):
            self._refuse(f"{key} is {value!r}", f"Write [[{key}]] before each.")
        return value  # type: ignore[no-any-return]

    def _only(self, plain: Mapping[str, Any], known: Sequence[str], prefix: str) -> None:
        for key in plain:
            if key not in known:
                self._refuse(f"there is no entry {prefix}{key}", did_you_mean(key, known))

    def _refuse(self, problem: str, fix: str) -> None:
        raise AnalysisError(problem, where=self._where, fix=fix)
