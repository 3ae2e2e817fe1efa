"""Files as they may have become: bits that flipped, pieces that are missing or doubled; and how readers are called."""

from __future__ import annotations

import csv
import io
import json
from typing import TYPE_CHECKING, Any

from hypothesis import settings
from tests.hostile.malformed_json import ODD_VALUES, keys_of, with_value, without, written

from robot_runner.core.errors import RobotRunnerError

if TYPE_CHECKING:
    import random
    from collections.abc import Callable

#: In the fixed search, some seconds for all readers together; `make soak` searches for long.
EXAMPLES = 40 if settings.default is not None and settings.default.max_examples < 1000 else 2000


def read_or_refused(read: Callable[[], Any]) -> None:
    """Call a reader; one of our errors has a problem, a place and a remedy."""
    try:
        read()
    except RobotRunnerError as error:
        for finding in error.findings:
            assert finding.problem
            assert finding.where


def damaged(content: bytes, chance: random.Random) -> bytes:
    """Return a file as it may have become: one of many kinds of damage, or several."""
    for _ in range(chance.choice((1, 1, 1, 2, 5))):
        content = chance.choice((_bits, _cut, _doubled, _planted, _other_value))(content, chance)
    return content


def _bits(content: bytes, chance: random.Random) -> bytes:
    changed = bytearray(content or b"\0")
    for _ in range(chance.choice((1, 4, 30))):
        changed[chance.randrange(len(changed))] = chance.randrange(256)
    return bytes(changed)


def _cut(content: bytes, chance: random.Random) -> bytes:
    start, end = sorted(chance.randrange(len(content) + 1) for _ in range(2))
    return content[:start] + content[end:]


def _doubled(content: bytes, chance: random.Random) -> bytes:
    start, end = sorted(chance.randrange(len(content) + 1) for _ in range(2))
    return content[:end] + content[start:]


def _planted(content: bytes, chance: random.Random) -> bytes:
    place = chance.randrange(len(content) + 1)
    return content[:place] + chance.choice(_TOKENS) + content[place:]


_TOKENS = (
    b"\0", b"\xff", b"\n", b"\r", b'"', b",", b"{", b"[", b"}", b"]", b"null", b"NaN", b"1e999", b"-", b"9" * 400,
    b"9" * 5000,    b"\\ud800", b"\x1b[2J", b"../", b"true", b'{"kind":"', b"[" * 3000, b"\xef\xbb\xbf", b"^9^9",
)  # fmt: skip


def _other_value(content: bytes, chance: random.Random) -> bytes:
    """Change one value of JSON, of a record or of a cell, so that the file stays well formed."""
    lines = content.splitlines()
    with_json = [place for place, line in enumerate(lines) if line[:1] == b"{" and line[-1:] == b"}"]
    try:
        if content[:1] == b"{" and len(with_json) != len(lines):
            return _of_document(json.loads(content), chance)
        if with_json:
            place = chance.choice(with_json)
            lines[place] = _of_document(json.loads(lines[place]), chance)
            return b"\n".join(lines) + b"\n"
        rows = list(csv.reader(io.StringIO(content.decode())))
        row = chance.choice(rows)
        row[chance.randrange(len(row))] = chance.choice(
            ("", "nan", "-1", "x" * 999, "\x1b", "1e999", "Done", "true", "9" * 5000)
        )
        text = io.StringIO()
        csv.writer(text).writerows(rows)
        return text.getvalue().encode()
    except (ValueError, IndexError, csv.Error, RecursionError):
        return content


def _of_document(document: Any, chance: random.Random) -> bytes:
    way = chance.choice(list(keys_of(document, 4)))
    if chance.random() < 0.3:
        return written(without(document, way)).encode("utf-8", "surrogatepass")
    return written(with_value(document, way, chance.choice(list(ODD_VALUES.values())))).encode("utf-8", "surrogatepass")
