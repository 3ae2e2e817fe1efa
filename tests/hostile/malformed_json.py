"""Malformed JSON of many kinds, made from a document that is in order."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

#: What commands a terminal: C0, C1, a title, colours, a link, the clipboard, the direction of writing, lines above.
ESCAPES = "\x1b]0;owned\x07\x1b[2J\x1b[31m\x9b5A\x1b]8;;http://evil\x1b\\x\x1b]52;c;aGk=\x07\u202egnp.\u2066\u200f\r\x08\x00[b]x"
LONE = "\ud800"
DEEP = 100_000


class Verbatim(str):
    """JSON as it is to be written, whatever it says."""

    __slots__ = ()


def written(value: Any) -> str:
    """Return JSON in which `Verbatim` stands as it is."""
    marks: dict[str, str] = {}

    def plain(each: Any) -> Any:
        if isinstance(each, Verbatim):
            mark = f"@@{len(marks)}@@"
            marks[json.dumps(mark)] = str(each)
            return mark
        if isinstance(each, dict):
            return {name: plain(one) for name, one in each.items()}
        return list(map(plain, each)) if isinstance(each, list) else each

    text = json.dumps(plain(value), separators=(",", ":"))
    for mark, verbatim in marks.items():
        text = text.replace(mark, verbatim)
    return text


#: What may stand in the place of any value.
ODD_VALUES: dict[str, Any] = {
    "null": None,
    "true": True,
    "number": 7,
    "negative": -1,
    "fraction": 0.5,
    "huge": Verbatim("1" * 4000),
    "too-huge": Verbatim("1" * 5000),
    "infinite": Verbatim("1e400"),
    "nan": Verbatim("NaN"),
    "empty-text": "",
    "escapes": ESCAPES,
    "lone": Verbatim('"\\ud800"'),
    "path": "../../../outside/planted",
    "list": [],
    "mapping": {},
    "nested-list": [[["x"]]],
    "nested-mapping": {"a": {"b": {"c": 1}}},
    "deep": Verbatim("[" * 500 + "]" * 500),
}


def damaged(text: str) -> Iterator[tuple[str, bytes]]:
    """Yield what a whole document may have become, each with its name."""
    whole = text.encode()
    yield "empty", b""
    yield "blank", b" \n"
    yield "truncated", whole[: len(whole) // 2]
    yield "not-utf8", whole.replace(b'"', b'"\xff\xfe\x80', 5)
    yield "utf16", text.encode("utf-16")
    yield "nul", whole[:20] + b"\0" * 64 + whole[20:]
    yield "deep-lists", b"[" * DEEP
    yield "deep-mappings", b'{"a":' * DEEP
    yield "list", b"[1, 2, 3]"
    yield "text", b'"manifest"'
    yield "number", b"7"
    yield "null", b"null"
    yield "trailing", whole.rstrip() + b"}}"
    yield "huge-number", b'{"format": ' + b"1" * 5000 + b"}"
    yield "binary", bytes(range(256)) * 8
    yield "many", b"[" + b"{}," * 3_000_000 + b"{}]"


def keys_of(document: Any, depth: int = 3) -> Iterator[tuple[Any, ...]]:
    """Yield the way to each value of a document, down to a depth; of a list, to its first item only."""
    items = (
        document.items()
        if isinstance(document, dict)
        else enumerate(document[:1])
        if isinstance(document, list)
        else ()
    )
    for key, value in items:
        yield (key,)
        if depth > 1:
            yield from ((key, *more) for more in keys_of(value, depth - 1))


def with_value(document: Any, way: tuple[Any, ...], value: Any) -> Any:
    """Return the document with another value at a place."""
    key, *more = way
    inner = with_value(document[key], tuple(more), value) if more else value
    if isinstance(document, list):
        return [inner if place == key else each for place, each in enumerate(document)]
    return {**document, key: inner}


def without(document: Any, way: tuple[Any, ...]) -> Any:
    """Return the document without a key."""
    key, *more = way
    if more:
        return with_value(document, (key,), without(document[key], tuple(more)))
    if isinstance(document, list):
        return document[1:]
    return {name: each for name, each in document.items() if name != key}


def in_every_text(document: Any, change: Callable[[str], Any]) -> Any:
    """Return the document with each text that is a value changed."""
    if isinstance(document, dict):
        return {name: in_every_text(each, change) for name, each in document.items()}
    if isinstance(document, list):
        return [in_every_text(each, change) for each in document]
    return change(document) if isinstance(document, str) else document
