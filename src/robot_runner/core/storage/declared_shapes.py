"""Checking JSON that was read against its declared shape, a TypedDict.

A file of an experiment may be damaged, of another tool, or prepared by an attacker. Readers rely on its shape, so any
other value is reported here: the file, the place in it, what is there and what should be. Keys that a shape does not
have are ignored, as a later version may write them.
"""

# Without `from __future__ import annotations`: a TypedDict would not see which of its keys are required.
import json
import math
import re
from collections.abc import Callable, Iterator, Mapping
from datetime import datetime
from functools import cache
from types import NoneType, UnionType
from typing import Any, NamedTuple, NewType, NotRequired, Union, get_args, get_origin, get_type_hints, is_typeddict

from robot_runner.core.errors import Finding

#: A moment in UTC or with its offset, as ISO 8601 has it.
Moment = NewType("Moment", str)
#: The value of a measure, a treatment, or an answer.
Scalar = bool | int | float | str | None
#: The seed of an order; NumPy's have 128 bits.
Seed = NewType("Seed", int)

#: Further faults are not listed.
_MOST_FAULTS = 20
_SHOWN = 60
_LONGEST_TEXT = 10_000
#: Deeper nesting is refused: ours has less than ten levels, and Python's functions fail at some hundred.
DEEPEST = 64
_LARGEST_COUNT = 2**63
#: The largest integer as a measure's value: that of a float.
_MOST_BITS_OF_VALUE = 1024
#: pandas knows moments between 1677 and 2262.
_MOMENT = re.compile(r"(?:19|20|21)\d\d-\d\d-\d\dT\d\d:\d\d:\d\d(?:\.\d{1,9})?(?:Z|[+-]\d\d:\d\d)")

_WORDS = {
    dict: "a mapping",
    list: "a list",
    str: "a text",
    int: "a whole number",
    float: "a number",
    bool: "true or false",
    NoneType: "null",
}

#: Checks a value of the right type at a place, and appends faults.
_Look = Callable[[Any, str, list[str]], None]


class _Shape(NamedTuple):
    """The shape in words, and the Python types that a value of it may have, each with a further check or None."""

    words: str
    looks: Mapping[type, _Look | None]


def parsed_json(text: str) -> Any:
    r"""Parse JSON. Half a surrogate pair, which UTF-8 cannot encode, becomes its escape as text: `\ud800`.

    Raises:
        ValueError: it is not JSON, or has a key twice, which readers resolve differently.
        RecursionError: it is nested too deeply.
    """
    value = _decode(text)
    return _encodable(value) if "\\ud" in text or "\\uD" in text else value


def with_short_texts(value: Any) -> Any:
    """Return JSON data with long texts shortened, so that the file stays within the limits of its readers.

    Example:
        >>> with_short_texts({"problem": "x" * 20_000})["problem"][-30:]
        'xxxx… (10,000 more characters)'
    """
    if isinstance(value, dict):
        return {name: with_short_texts(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return list(map(with_short_texts, value))
    if isinstance(value, str) and len(value) > _LONGEST_TEXT:
        return f"{value[:_LONGEST_TEXT]}… ({len(value) - _LONGEST_TEXT:,} more characters)"
    return value


def finite(value: Any) -> Any:
    """Return plain data with numbers that JSON does not have, such as infinity, replaced by their names.

    Example:
        >>> finite({"limits": (0.5, float("inf"))})
        {'limits': [0.5, 'inf']}
    """
    if isinstance(value, dict):
        return {name: finite(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return list(map(finite, value))
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


def _encodable(value: Any) -> Any:
    if isinstance(value, dict):
        return {_encodable(name): _encodable(each) for name, each in value.items()}
    if isinstance(value, list):
        return list(map(_encodable, value))
    return value.encode("utf-8", "backslashreplace").decode() if isinstance(value, str) else value


def _unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for place, name in enumerate(names) if name in names[:place])
        raise ValueError(f"the key {twice!r} is there twice")
    return found


_decode = json.JSONDecoder(object_pairs_hook=_unique_keys).decode


def faults_of(value: Any, shape: Any) -> list[str]:
    """Return the faults of a value, a line each, `_MOST_FAULTS` at most.

    `shape` is a TypedDict, or a type in one: `str`, `list[...]`, `dict[str, ...]`, `... | None`, `Moment`, `Any`.

    Example:
        >>> faults_of({"runs": [{"run": 7}]}, dict[str, list[dict[str, str]]])
        ['runs[0].run is 7, not a text']
    """
    faults: list[str] = []
    _look(_compiled(shape), value, "", faults)
    return faults


def shape_findings(where: str, what: str, value: Any, shape: Any, fix: str) -> list[Finding]:
    """Return an error finding for each fault of a value that was read; `what` names the file, with its article."""
    return [Finding.error(where, f"the file is not {what}: {fault}", fix) for fault in faults_of(value, shape)]


def _look(shape: _Shape, value: Any, place: str, faults: list[str]) -> None:
    try:
        look = shape.looks[type(value)]
    except KeyError:
        if len(faults) < _MOST_FAULTS:
            faults.append(f"{place or 'it'} is {_shown(value)}, not {shape.words}")
        return
    if look is not None:
        look(value, place, faults)


def _shown(value: Any) -> str:
    if isinstance(value, dict | list):
        return f"{_WORDS[type(value)]}"
    text = str(value) if value is None or isinstance(value, bool) else repr(value)
    return f"{text[:_SHOWN]}…" if len(text) > _SHOWN else text


@cache
def _compiled(shape: Any) -> _Shape:
    """Return the check of a declared shape; cached."""
    if shape in _NAMED:
        return _NAMED[shape]
    if is_typeddict(shape):
        return _Shape(_WORDS[dict], {dict: _fields_of(shape)})
    origin, arguments = get_origin(shape), get_args(shape)
    if origin in {Union, UnionType}:
        several = [_compiled(each) for each in arguments]
        looks = {kind: look for each in several for kind, look in each.looks.items()}
        return _Shape(" or ".join(each.words for each in several), looks)
    if origin is dict:
        return _Shape(_WORDS[dict], {dict: _values_of(_compiled(arguments[1]))})
    return _Shape(_WORDS[list], {list: _items_of(_compiled(arguments[0]))})


def _fields_of(shape: Any) -> _Look:
    hints = get_type_hints(shape, include_extras=True)
    unmarked = {name: get_args(hint)[0] if get_origin(hint) is NotRequired else hint for name, hint in hints.items()}
    fields = {name: _compiled(hint) for name, hint in unmarked.items()}
    required = shape.__required_keys__

    def look(value: dict[str, Any], place: str, faults: list[str]) -> None:
        head = f"{place}." if place else ""
        for name, field in fields.items():
            if name in value:
                _look(field, value[name], f"{head}{name}", faults)
            elif name in required and len(faults) < _MOST_FAULTS:
                faults.append(f"{head}{name} is missing")

    return look


def _values_of(inner: _Shape) -> _Look:
    def look(value: dict[str, Any], place: str, faults: list[str]) -> None:
        head = f"{place}." if place else ""
        for name, each in value.items():
            _look(inner, each, f"{head}{name}", faults)

    return look


def _items_of(inner: _Shape) -> _Look:
    def look(value: list[Any], place: str, faults: list[str]) -> None:
        for number, each in enumerate(value):
            _look(inner, each, f"{place}[{number}]", faults)

    return look


def _moment(value: str, place: str, faults: list[str]) -> None:
    try:
        is_moment = _MOMENT.fullmatch(value) is not None and bool(datetime.fromisoformat(value))
    except ValueError:
        is_moment = False
    if not is_moment and len(faults) < _MOST_FAULTS:
        faults.append(f"{place} is {_shown(value)}, not a moment such as 2026-01-31T12:00:00Z")


def _finite(value: float, place: str, faults: list[str]) -> None:
    if not math.isfinite(value) and len(faults) < _MOST_FAULTS:
        faults.append(f"{place} is {value}, not a finite number")


def _count_in_reach(value: int, place: str, faults: list[str]) -> None:
    if not -_LARGEST_COUNT <= value < _LARGEST_COUNT and len(faults) < _MOST_FAULTS:
        faults.append(f"{place} is a number of {len(str(value)):,} digits")


def _value_in_reach(value: int, place: str, faults: list[str]) -> None:
    if value.bit_length() > _MOST_BITS_OF_VALUE and len(faults) < _MOST_FAULTS:
        faults.append(f"{place} is a number of {value.bit_length():,} bits")


def levels_of(value: Any) -> Iterator[list[Any]]:
    """Yield the contents of the mappings and lists of each level, the outermost first, without recursion."""
    level = [value]
    while held := [each for each in level if isinstance(each, dict | list)]:
        level = [each for one in held for each in (one.values() if isinstance(one, dict) else one)]
        yield level


def _not_too_deep(value: Any, place: str, faults: list[str]) -> None:
    """Check that a value without a declared shape is not nested too deeply."""
    for depth, level in enumerate(levels_of(value)):
        if depth == DEEPEST:
            if len(faults) < _MOST_FAULTS:
                faults.append(f"{place or 'it'} is nested deeper than {DEEPEST} levels")
            return
        for each in level:
            if type(each) is int:
                _value_in_reach(each, place, faults)


_NESTED: dict[type, _Look | None] = {dict: _not_too_deep, list: _not_too_deep}
_NAMED: dict[Any, _Shape] = {
    Any: _Shape("anything", {bool: None, int: _value_in_reach, float: None, str: None, NoneType: None, **_NESTED}),
    Scalar: _Shape(
        " or ".join(_WORDS[each] for each in get_args(Scalar)),
        {bool: None, int: _value_in_reach, float: _finite, str: None, NoneType: None},
    ),
    Moment: _Shape("a moment such as 2026-01-31T12:00:00Z", {str: _moment}),
    str: _Shape(_WORDS[str], {str: None}),
    bool: _Shape(_WORDS[bool], {bool: None}),
    NoneType: _Shape(_WORDS[NoneType], {NoneType: None}),
    int: _Shape(_WORDS[int], {int: _count_in_reach}),
    Seed: _Shape(_WORDS[int], {int: _value_in_reach}),
    float: _Shape(_WORDS[float], {float: _finite, int: _count_in_reach}),
}
