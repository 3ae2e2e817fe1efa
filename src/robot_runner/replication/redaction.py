"""Files on their way into a package: secrets replaced, in blocks, so that the size of a file does not matter."""

from __future__ import annotations

import ast
import re
from collections import Counter
from dataclasses import dataclass
from functools import cache, partial
from typing import TYPE_CHECKING, BinaryIO

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path

__all__ = ["REDACTED", "SECRET_NAME", "Redactor", "forbidden_name", "is_binary", "secrets_in_code"]

#: What stands in a secret's place.
REDACTED = "REDACTED"

_HOME_PATH = "home path"

#: A name under which a secret is kept, in a config, a command or a settings file.
SECRET_NAME = re.compile(
    r"(?i)(?:^|[^a-z])(?:password|passwd|passphrase|pwd|secret|token|api_?key|access_?key|private_?key|credentials?)"
    r"(?:$|[^a-rt-z])"
)

_WORD = rb"(?:password|passwd|passphrase|pwd|secret|token|api[_-]?key|access[_-]?key|private[_-]?key|credentials?)"
_WORD_HINTS = (b"passw", b"passphrase", b"pwd", b"secret", b"token", b"key", b"credential")
_MARK = REDACTED.encode()

_FORBIDDEN = re.compile(
    r"(?i)\.env(\..*)?|id_(rsa|dsa|ecdsa|ed25519)(_sk)?|known_hosts(\.old)?|authorized_keys|.*\.(pem|key|p12|pfx|kdbx)"
    r"|\.netrc|\.pypirc|\.git-credentials|ssh_host_.*_key(\.pub)?"
)


@dataclass(frozen=True, slots=True)
class _Pattern:
    """One kind of secret.

    Attributes:
        what: the secret in words.
        hints: texts in lower case of which the secret holds one. Looking for them is much quicker than the expression.
        expression: finds the secret.
        replacement: what stands in its place; groups may be kept.
        loose: whether it also takes what merely looks like a setting, as in a log; not for files with a grammar.
    """

    what: str
    hints: tuple[bytes, ...]
    expression: re.Pattern[bytes]
    replacement: bytes
    loose: bool = False


@cache
def _patterns() -> tuple[_Pattern, ...]:
    """Return the kinds of secrets, wherever they are; home paths come last, so that a secret in a path goes whole."""
    return (
        _pattern("private key", rb"(-----BEGIN [A-Z0-9 ]*PRIVATE KEY-----).*?(-----END [A-Z0-9 ]*PRIVATE KEY-----)",
                 rb"\1" + _MARK + rb"\2", b"private key-----"),
        _pattern("password in a URL", rb"(\b[A-Za-z][A-Za-z0-9+.-]*://[^\s/:@\"'\\]*:)[^\s/@\"'\\]+(@)",
                 rb"\1" + _MARK + rb"\2", b"://"),
        _pattern("authorisation", rb"(?i)(\b(?:bearer|authorization: basic)\s+)[A-Za-z0-9._~+/=-]{12,}",
                 rb"\1" + _MARK, b"bearer", b"authorization"),
        _pattern("token", rb"\b(?:gh[pousr]_[A-Za-z0-9]{20,}|github_pat_\w{20,}|glpat-[\w-]{20,}|AKIA[0-9A-Z]{16}"
                 rb"|xox[abprs]-[\w-]{10,}|sk-[A-Za-z0-9_-]{20,}|hf_[A-Za-z0-9]{20,}|AIza[\w-]{35}|pypi-[\w-]{30,}"
                 rb"|eyJ[\w-]{8,}\.eyJ[\w-]{8,}\.[\w-]*)",
                 _MARK, b"gh", b"glpat-", b"akia", b"xox", b"sk-", b"hf_", b"aiza", b"pypi-", b"eyj"),
        _pattern("SSH key", rb"\b((?:sk-)?(?:ssh-(?:rsa|dss|ed25519)|ecdsa-sha2-nistp\d+)(?:@openssh\.com)?\s+)"
                 rb"AAAA[A-Za-z0-9+/=]{20,}", rb"\1" + _MARK, b"ssh-", b"ecdsa-"),
        _pattern("SSH fingerprint", rb"\bSHA256:[A-Za-z0-9+/]{43}(?![A-Za-z0-9+/])", b"SHA256:" + _MARK, b"sha256:"),
        _pattern("password", rb"(?i)(\b[\w.-]*" + _WORD + rb"[\w-]*[\"']\s*:\s*)([\"'])(?:\\.|(?!\2)[^\\\n])+\2",
                 rb"\1\2" + _MARK + rb"\2", *_WORD_HINTS),
        _pattern("password", rb"(?i)(\b[\w.-]*" + _WORD + rb"[\w-]*\\\"\s*:\s*\\\")[^\"\n]+?(\\\")",
                 rb"\1" + _MARK + rb"\2", *_WORD_HINTS),
        _pattern("password", rb"(?i)(\b\w*" + _WORD + rb"\w*\s*=\s*)([\"'])(?:\\.|(?!\2)[^\\\n])+\2",
                 rb"\1\2" + _MARK + rb"\2", *_WORD_HINTS),
        _pattern("password", rb"(?i)(--?" + _WORD + rb"(?:=|\s+))(?!-)[^\s\"'\\,]+", rb"\1" + _MARK, *_WORD_HINTS),
        _Pattern("password", _WORD_HINTS, re.compile(
            rb"(?i)(\b[\w.-]*" + _WORD + rb"(?:[_-]\w+)?\s*[:=]\s*)(?:\"[^\"\n]+\"|'[^'\n]+'|[^\s\"',;]+)"),
            rb"\1" + _MARK, loose=True),
        _pattern(_HOME_PATH, rb"(?<![\w.~-])/(?:home|Users)/[A-Za-z0-9_][A-Za-z0-9._-]*(?=$|[^A-Za-z0-9._-])", b"~",
                 b"/home/", b"/users/"),
        _pattern(_HOME_PATH, rb"(?<![\w./~-])/root(?=$|[/\s\"'\\,:;)\]}<])", b"~", b"/root"),
    )  # fmt: skip


def _literal(what: str, text: str, replacement: str) -> _Pattern:
    """Return what finds this very text."""
    raw = text.encode("utf-8", "surrogateescape")
    return _Pattern(what, (raw.lower(),), re.compile(re.escape(raw)), replacement.encode())


def forbidden_name(name: str) -> bool:
    """Whether files of this name hold secrets and nothing else."""
    return _FORBIDDEN.fullmatch(name) is not None


def _pattern(what: str, expression: bytes, replacement: bytes, *hints: bytes) -> _Pattern:
    return _Pattern(what, tuple(hint.lower() for hint in hints), re.compile(expression, re.DOTALL), replacement)


_BLOCK = 1 << 20
_LONGEST = 4 << 20  # a longer line is cut: what stands across the cut may be missed
_SHORTEST_SECRET = 5
_SNIFFED = 8192
_BINARY = frozenset(
    ".bag .bz2 .db3 .gz .mcap .npz .parquet .pdf .png .whl .woff2 .xz .zip .zst".split()  # noqa: SIM905 - sixteen lines otherwise
)
#: Files with a grammar, which a value without its quotes would break.
_STRICT = frozenset({".csv", ".html", ".json", ".jsonl", ".py", ".svg"})


def is_binary(path: Path) -> bool:
    """Whether nothing in a file can be replaced without breaking it.

    Raises:
        OSError: it cannot be read.
    """
    if path.suffix.casefold() in _BINARY:
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
    pairs: Iterable[tuple[ast.AST | None, ast.AST | None]] = ()
    match node:
        case ast.Assign(targets=targets, value=value):
            pairs = [(target, value) for target in targets]
        case ast.AnnAssign(target=target, value=value) | ast.NamedExpr(target=target, value=value):
            pairs = [(target, value)]
        case ast.keyword(arg=str(name), value=value):
            pairs = [(ast.Name(name), value)]
        case ast.Dict(keys=keys, values=values):
            pairs = zip(keys, values, strict=True)
        case ast.arguments():
            positional = [*node.posonlyargs, *node.args]
            with_default = [*positional[len(positional) - len(node.defaults) :], *node.kwonlyargs]
            names = [ast.Name(argument.arg) for argument in with_default]
            pairs = zip(names, [*node.defaults, *node.kw_defaults], strict=True)
    for named, secret in pairs:
        yield from _if_secret(named, secret)


def _if_secret(target: ast.AST | None, value: ast.AST | None) -> Iterator[str]:
    if SECRET_NAME.search(_name_of(target)) and isinstance(value, ast.Constant):
        if isinstance(value.value, str):
            yield value.value
        elif isinstance(value.value, bytes):
            yield value.value.decode("utf-8", "surrogateescape")


def _name_of(target: ast.AST | None) -> str:
    match target:
        case ast.Name(id=name) | ast.Attribute(attr=name) | ast.Constant(value=str(name)):
            return name
        case ast.Subscript(slice=key):
            return _name_of(key)
    return ""


@dataclass(frozen=True, slots=True)
class Redactor:
    """Replaces secrets in files.

    Attributes:
        patterns: the secrets that are replaced.

    Example:
        >>> redactor = Redactor.knowing({"swordfish"}, home=None)
        >>> redactor.redacted(b"GET /home/ada/map.pgm with swordfish", Counter(), loose=False)
        b'GET ~/map.pgm with REDACTED'
    """

    patterns: tuple[_Pattern, ...]

    @classmethod
    def knowing(cls, secrets: Iterable[str], *, home: Path | None) -> Redactor:
        """Return one that also replaces these very texts, and the home folder of the user who packs."""
        known = [_literal("password", text, REDACTED) for text in sorted(secrets, key=len, reverse=True)]
        own = [_literal(_HOME_PATH, str(home), "~")] if home and len(home.parts) > 2 else []  # noqa: PLR2004
        return cls((*known, *own, *_patterns()))

    @property
    def own(self) -> Redactor:
        """A redactor of this experiment's secrets, this home and private keys only: code is full of false alarms."""
        general = set(_patterns())
        return Redactor(tuple(each for each in self.patterns if each not in general or each.what == "private key"))

    def blocks(self, path: Path, found: Counter[str]) -> Iterator[bytes]:
        """Yield a text file in blocks, secrets replaced.

        Args:
            path: the file.
            found: counts the secrets of each kind that were replaced.

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
        found = Counter[str]()
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


def _replaced(pattern: _Pattern, found: Counter[str], match: re.Match[bytes]) -> bytes:
    """Return what takes a secret's place; a secret that an earlier pattern replaced is not counted again."""
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
