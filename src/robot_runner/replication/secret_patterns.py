"""What must not leave the house: home paths, passwords, tokens, keys."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable

__all__ = ["HOME_PATH", "REDACTED", "SECRET_NAME", "SecretPattern", "forbidden_name", "literal_pattern", "patterns"]

#: What stands in a secret's place.
REDACTED = "REDACTED"

HOME_PATH = "home path"

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
class SecretPattern:
    """One kind of secret.

    Attributes:
        what: the secret in words.
        hints: it can only be where one of these is, in lower case; only there is it looked for, as that is quick.
        expression: finds it.
        replacement: what stands in its place; groups may be kept.
        loose: whether it also takes what merely looks like a setting, as in a log; not for files with a grammar.
    """

    what: str
    hints: tuple[bytes, ...]
    expression: re.Pattern[bytes]
    replacement: bytes
    loose: bool = False


@cache
def patterns() -> tuple[SecretPattern, ...]:
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
        SecretPattern("password", _WORD_HINTS, re.compile(
            rb"(?i)(\b[\w.-]*" + _WORD + rb"(?:[_-]\w+)?\s*[:=]\s*)(?:\"[^\"\n]+\"|'[^'\n]+'|[^\s\"',;]+)"),
            rb"\1" + _MARK, loose=True),
        _pattern(HOME_PATH, rb"(?<![\w.~-])/(?:home|Users)/[A-Za-z0-9_][A-Za-z0-9._-]*(?=$|[^A-Za-z0-9._-])", b"~",
                 b"/home/", b"/users/"),
        _pattern(HOME_PATH, rb"(?<![\w./~-])/root(?=$|[/\s\"'\\,:;)\]}<])", b"~", b"/root"),
    )  # fmt: skip


def literal_pattern(what: str, text: str, replacement: str) -> SecretPattern:
    """Return what finds this very text."""
    raw = text.encode("utf-8", "surrogateescape")
    return SecretPattern(what, (raw.lower(),), re.compile(re.escape(raw)), replacement.encode())


def forbidden_name(name: str) -> bool:
    """Whether files of this name hold secrets and nothing else."""
    return _FORBIDDEN.fullmatch(name) is not None


def _pattern(what: str, expression: bytes, replacement: bytes, *hints: bytes) -> SecretPattern:
    return SecretPattern(what, tuple(_distinct(hints)), re.compile(expression, re.DOTALL), replacement)


def _distinct(hints: Iterable[bytes]) -> Iterable[bytes]:
    return dict.fromkeys(hint.lower() for hint in hints)
