"""Files on their way into a package: secrets replaced, in blocks, so that the size of a file does not matter."""

from __future__ import annotations

import ast
from collections import Counter
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, BinaryIO

from robot_runner.replication.secret_patterns import (
    HOME_PATH,
    REDACTED,
    SECRET_NAME,
    SecretPattern,
    literal_pattern,
    patterns,
)

if TYPE_CHECKING:
    import re
    from collections.abc import Iterable, Iterator
    from pathlib import Path

__all__ = ["Redactor", "is_binary", "secrets_in_code"]

_BLOCK = 1 << 20
_LONGEST = 4 << 20  # a longer line is cut: what stands across the cut may be missed
_SHORTEST_SECRET = 5
_SNIFFED = 8192
_PACKED = frozenset(
    {
        ".bag",
        ".bz2",
        ".db3",
        ".gz",
        ".mcap",
        ".npz",
        ".parquet",
        ".pdf",
        ".png",
        ".whl",
        ".woff2",
        ".xz",
        ".zip",
        ".zst",
    }
)
#: Files with a grammar, which a value without its quotes would break.
_STRICT = frozenset({".csv", ".html", ".json", ".jsonl", ".py", ".svg"})


def is_binary(path: Path) -> bool:
    """Whether nothing in a file can be replaced without breaking it.

    Raises:
        OSError: it cannot be read.
    """
    if path.suffix.casefold() in _PACKED:
        return True
    with path.open("rb") as file:
        return b"\0" in file.read(_SNIFFED)


def secrets_in_code(text: str) -> set[str]:
    """Return the values that Python code gives to names such as `password`; nothing where it does not parse.

    Example:
        >>> sorted(secrets_in_code('wifi_password = "swordfish"; connect(token="open-sesame", user="ada")'))
        ['open-sesame', 'swordfish']
    """
    try:
        tree = ast.parse(text)
    except (SyntaxError, ValueError):
        return set()
    return {value for node in ast.walk(tree) for value in _secrets_of(node) if len(value) >= _SHORTEST_SECRET}


def _secrets_of(node: ast.AST) -> Iterator[str]:
    if isinstance(node, ast.Assign):
        for target in node.targets:
            yield from _if_secret(target, node.value)
    elif isinstance(node, ast.AnnAssign | ast.NamedExpr) and node.value is not None:
        yield from _if_secret(node.target, node.value)
    elif isinstance(node, ast.keyword) and node.arg:
        yield from _if_secret(ast.Name(node.arg), node.value)
    elif isinstance(node, ast.Dict):
        for key, value in zip(node.keys, node.values, strict=True):
            yield from _if_secret(key, value)
    elif isinstance(node, ast.arguments):
        named = [*node.posonlyargs, *node.args]
        pairs = zip(named[len(named) - len(node.defaults) :], node.defaults, strict=True)
        for argument, default in [*pairs, *zip(node.kwonlyargs, node.kw_defaults, strict=True)]:
            yield from _if_secret(ast.Name(argument.arg), default)


def _if_secret(target: ast.AST | None, value: ast.AST | None) -> Iterator[str]:
    if SECRET_NAME.search(_name_of(target)) and isinstance(value, ast.Constant):
        if isinstance(value.value, str):
            yield value.value
        elif isinstance(value.value, bytes):
            yield value.value.decode("utf-8", "surrogateescape")


def _name_of(target: ast.AST | None) -> str:
    if isinstance(target, ast.Name):
        return target.id
    if isinstance(target, ast.Attribute):
        return target.attr
    if isinstance(target, ast.Subscript):
        return _name_of(target.slice)
    if isinstance(target, ast.Constant) and isinstance(target.value, str):
        return target.value
    return ""


@dataclass(frozen=True, slots=True)
class Redactor:
    """Replaces secrets in files.

    Attributes:
        patterns: what it looks for.

    Example:
        >>> redactor = Redactor.knowing({"swordfish"}, home=None)
        >>> redactor.redacted(b"GET /home/ada/map.pgm with swordfish", Counter(), loose=False)
        b'GET ~/map.pgm with REDACTED'
    """

    patterns: tuple[SecretPattern, ...]

    @classmethod
    def knowing(cls, secrets: Iterable[str], *, home: Path | None) -> Redactor:
        """Return one that also replaces these very texts, and the home folder of whoever packs."""
        known = [literal_pattern("password", text, REDACTED) for text in sorted(secrets, key=len, reverse=True)]
        own = [literal_pattern(HOME_PATH, str(home), "~")] if home and len(home.parts) > 2 else []  # noqa: PLR2004
        return cls((*known, *own, *patterns()))

    @property
    def own(self) -> Redactor:
        """One that looks for what this experiment or machine gives away: code is full of what only looks secret."""
        general = set(patterns())
        return Redactor(tuple(each for each in self.patterns if each not in general or each.what == "private key"))

    def blocks(self, path: Path, found: Counter[str]) -> Iterator[bytes]:
        """Yield a text file in blocks, secrets replaced.

        Args:
            path: the file.
            found: is told how many secrets of each kind were replaced.

        Raises:
            OSError: it cannot be read.
        """
        loose = path.suffix.casefold() not in _STRICT
        with path.open("rb") as file:
            for block in _whole_lines(file):
                yield self.redacted(block, found, loose=loose)

    def secrets_in(self, path: Path) -> Counter[str]:
        """Return how many secrets of each kind are in a file, which stays as it is.

        Raises:
            OSError: it cannot be read.
        """
        found: Counter[str] = Counter()
        with path.open("rb") as file:
            for block in _whole_lines(file):
                self.redacted(block, found, loose=False)
        return found

    def redacted(self, block: bytes, found: Counter[str], *, loose: bool) -> bytes:
        """Return a block with its secrets replaced, and count them."""
        lowered = block.lower()
        for pattern in self.patterns:
            if (pattern.loose and not loose) or not any(hint in lowered for hint in pattern.hints):
                continue
            cleaned = pattern.expression.sub(partial(_replaced, pattern, found), block)
            if cleaned != block:
                block, lowered = cleaned, cleaned.lower()
        return block


def _replaced(pattern: SecretPattern, found: Counter[str], match: re.Match[bytes]) -> bytes:
    """Return what takes a secret's place; what was replaced before is no other secret."""
    replacement = match.expand(pattern.replacement)
    if replacement != match[0]:
        found[pattern.what] += 1
    return replacement


def _whole_lines(file: BinaryIO) -> Iterator[bytes]:
    """Yield blocks that end where a line does, and with no private key begun."""
    kept = b""
    while data := file.read(_BLOCK):
        block = kept + data
        cut = block.rfind(b"\n") + 1
        begun = block.rfind(b"-----BEGIN ", 0, cut)
        if begun >= 0 and block.find(b"-----END ", begun, cut) < 0:
            cut = begun
        if cut == 0 and len(block) >= _LONGEST:
            cut = len(block)
        kept = block[cut:]
        if cut:
            yield block[:cut]
    if kept:
        yield kept
