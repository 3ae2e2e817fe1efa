"""Find secrets by their form: keys, tokens of services, addresses, arguments of commands.

The forms of tokens are those in the documentation of the services. `named_secrets` finds secrets by their names.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

HOME_PATH = "home path"


class Found(NamedTuple):
    """A secret in a block of bytes.

    Attributes:
        start, end: its place in the block.
        what: its kind, in words.
        begin: the start of its context, such as the name before it.
        replacement: the bytes that replace it.
        is_sure: whether it certainly is a secret; otherwise a person has to decide.
    """

    start: int
    end: int
    what: str
    begin: int
    replacement: bytes = b"REDACTED"
    is_sure: bool = True


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of secret that is found by its form.

    Attributes:
        what: the kind in words.
        hints: texts in the form of `reduced`; a block with such a secret contains one of them. Searching for these is
            much faster than the expression.
        expression: matches the secret; group 1 is replaced, or the whole match if there is no group.
        replacement: the bytes that replace it.
        is_sure: whether a match certainly is a secret.
    """

    what: str
    hints: tuple[bytes, ...]
    expression: re.Pattern[bytes]
    replacement: bytes = b"REDACTED"
    is_sure: bool = True

    def find(self, block: bytes) -> Iterator[Found]:
        """Yield the secrets of this kind in a block."""
        group = 1 if self.expression.groups else 0
        for match in self.expression.finditer(block):
            start, end = match.span(group)
            if start < end and match[group] != self.replacement:
                yield Found(start, end, self.what, match.start(), self.replacement, self.is_sure)


_LOWER = bytes(range(256)).lower()
#: Characters that are in no hint: without them, tables of numbers are nearly empty.
_IN_NO_HINT = b"0123456789 .,;+\t\r\n"


def reduced(block: bytes) -> bytes:
    """Return a block in the form in which hints are searched: in lower case, without digits and blanks."""
    return block.translate(_LOWER, _IN_NO_HINT)


def literal(what: str, text: str, replacement: str = "REDACTED", *, is_whole: bool = False) -> Kind:
    """Return the kind for one literal secret.

    Args:
        what: the kind in words.
        text: the secret.
        replacement: the text that replaces it.
        is_whole: whether it must not have letters or digits beside it.
    """
    raw = text.encode("utf-8", "surrogateescape")
    edges = (rb"(?<![A-Za-z0-9])", rb"(?![A-Za-z0-9])") if is_whole else (b"", b"")
    return Kind(what, (reduced(raw),), re.compile(edges[0] + re.escape(raw) + edges[1]), replacement.encode())


def _kind(what: str, expression: bytes, *hints: bytes, is_sure: bool = True) -> Kind:
    return Kind(what, tuple(map(reduced, hints)), re.compile(expression, re.DOTALL), is_sure=is_sure)


_MARKS = rb"PRIVATE KEY|OpenVPN Static key"
#: Between two words of a command: blanks, or the separator of two texts in a list.
_GAP = rb"(?:[ \t]+|\\?[\"'][ \t]*,\s*\\?[\"'])"
_VALUE = rb"[\"']?([^\s\"',;\\<>|&]+)"
_CALLS = rb"username_pw_set|HTTP(?:Basic|Digest|Proxy)Auth|BasicAuth|DigestAuth|set_password|(?<=\.)login"


@cache
def kinds() -> tuple[Kind, ...]:
    """Return the kinds of secrets that are found by their form; of two matches at one place, the first kind counts."""
    return (*_keys(), *_addresses(), *_headers(), *_tokens(), *_commands(), *_homes())


def _keys() -> Iterator[Kind]:
    begin = rb"-----BEGIN [A-Z0-9 ]*(?:" + _MARKS + rb")[ A-Za-z0-9]*-----"
    yield _kind("private key", begin + rb"(.{0,65536}?)-----END [A-Z0-9 ]*(?:" + _MARKS + rb")", b"-----begin")
    line = rb"(?:\\[nr]|[ \t>#*\"'+]|\r?\n)*[A-Za-z0-9+/=]{16,}"
    cut_off = begin + rb"((?:" + line + rb")+)"
    yield _kind("private key", cut_off, b"-----begin")
    yield _kind(
        "private key", rb"---- BEGIN SSH2 ENCRYPTED PRIVATE KEY ----((?:\s|\\n).{0,65536}?)---- END SSH2", b"----begin"
    )
    newline = rb"(?:[\r\n]|\\[rn])"
    putty = rb"Private-Lines: *\d+" + newline + rb"+((?:[A-Za-z0-9+/=]+" + newline + rb"*)+)"
    yield _kind("private key", putty, b"private-lines:")
    yield _kind("private key", rb"\bAGE-SECRET-KEY-1[A-Z0-9]{50,}", b"age-secret-key-")
    yield _kind("SSH key", rb"\b(?:sk-)?(?:ssh-(?:rsa|dss|ed25519)|ecdsa-sha2-nistp\d+)(?:@openssh\.com)?\s+"
                rb"(AAAA[A-Za-z0-9+/=]{20,})", b"ssh-", b"ecdsa-")  # fmt: skip
    yield _kind("SSH fingerprint", rb"\bSHA256:([A-Za-z0-9+/]{43})(?![A-Za-z0-9+/])", b"sha256:")
    # Parameters and salt, then the hash: MD5's has 22 characters of this alphabet. Images do not contain such a text.
    crypt = rb"\$(?:[1567y]|2[aby]?|apr1|argon2(?:id?|d))\$((?:[\w./+=,-]{0,64}\$){0,4}[A-Za-z0-9./+=]{20,})"
    yield _kind("password hash", crypt, b"$$", b"$a$", b"$b$", b"$y$", b"$apr1$", b"$argon2")


def _addresses() -> Iterator[Kind]:
    scheme = rb"\b[A-Za-z][A-Za-z0-9+.-]{1,20}://"
    yield _kind("password in a URL", scheme + rb"[^\s/:@\"'\\<>]*:(?!REDACTED@|\$|\{|<|%\()([^\s/@\"'\\<>]+)@", b"://")
    yield _kind(
        "token in a URL", rb"\bhttps?://(?!REDACTED@)(?=[^\s/:@\"'\\<>]*[0-9])([^\s/:@\"'\\<>{}$]{16,})@", b"://"
    )
    yield _kind("what may be a token in a URL", rb"\bhttps?://(?!REDACTED@|git@)([^\s/:@\"'\\<>{}$]{10,})@", b"://",
                is_sure=False)  # fmt: skip
    yield _kind("token in a URL", rb"[?&](?:sig|signature|key|code|auth|session|sid|hmac|pw|pass)="
                rb"(?=[^&\s]*[0-9])([A-Za-z0-9%+/=_.~-]{16,})", b"?", b"&")  # fmt: skip
    yield _kind("token in a URL", rb"\bhooks\.slack\.com/services/([\w/]{20,})", b"hooksslackcom/")
    yield _kind("token in a URL", rb"\bdiscord(?:app)?\.com/api/webhooks/\d+/([\w-]{20,})", b"discord")
    yield _kind("password", rb"(?m)^[\w.*-]*[A-Za-z*][\w.*-]*:(?:\d{4,5}|\*):[\w*-]+:[\w*.-]+:([^\s:\"',]+)$",
                b"::", b":*:")  # fmt: skip


def _headers() -> Iterator[Kind]:
    before = rb"(?i)\bauthorization(?:\\?[\"'])?\s*[:=]\s*(?:[rbf]?\\?[\"'])?"
    methods = rb"(?:basic|bearer|token|digest|apikey|negotiate|key)\s+"
    yield _kind("authorisation", before + methods + rb"(?!\$|\{|<|%)([^\s\"'\\,]{6,})", b"authorization")
    yield _kind("authorisation", rb"(?i)\bbearer\s+([A-Za-z0-9._~+/=-]{12,})", b"bearer")
    yield _kind(
        "authorisation", rb"[\"']op[\"']\s*:\s*[\"']auth[\"'][^{}]{0,400}?[\"']mac[\"']\s*:\s*[\"']([^\"'\n]+)", b"auth"
    )
    yield _kind("cookie", rb"(?i)\b(?:set-)?cookie:[ \t]*([\w.-]+=[^\r\n\"']{8,})", b"cookie:")


def _tokens() -> Iterator[Kind]:
    some = (
        (rb"gh[pousr]_[A-Za-z0-9]{20,}|github_pat_\w{20,}", b"ghp_", b"gho_", b"ghu_", b"ghs_", b"ghr_", b"github_pat"),
        (rb"gl(?:pat|rt|dt|ptt|cbt|agent|soat|ft)-[\w-]{20,}", b"glpat-", b"glrt-", b"gldt-", b"glptt", b"glcbt",
         b"glagent", b"glsoat", b"glft"),
        (rb"(?:AKIA|ASIA)[0-9A-Z]{16}", b"akia", b"asia"),
        (rb"xox[abeprs]-[\w-]{10,}|xapp-[\w-]{20,}", b"xox", b"xapp-"),
        (rb"sk-[A-Za-z0-9_-]{20,}", b"sk-"),
        (rb"hf_[A-Za-z0-9]{20,}", b"hf_"),
        (rb"AIza[\w-]{35}|ya29\.[\w.-]{20,}|GOCSPX-[\w-]{20,}", b"aiza", b"ya", b"gocspx"),
        (rb"pypi-[\w-]{30,}|npm_[A-Za-z0-9]{12,}", b"pypi-", b"npm_"),
        (rb"SG\.[\w-]{16,}\.[\w-]{16,}|(?:sk|rk)_(?:live|test)_[A-Za-z0-9]{16,}", b"sg", b"sk_", b"rk_"),
        (rb"\d{8,10}:AA[\w-]{33}", b":aa"),
        (rb"(?:dop|doo|dor)_v1_[a-f0-9]{40,}|dapi[a-f0-9]{32}|hvs\.[\w-]{20,}", b"_v_", b"dapi", b"hvs"),
        (rb"eyJ[\w-]{8,}\.eyJ[\w-]{8,}\.[\w-]*", b"eyj"),
    )  # fmt: skip
    for expression, *hints in some:
        yield _kind("token", rb"(?<![A-Za-z0-9_-])(?:" + expression + rb")", *hints)


def _commands() -> Iterator[Kind]:
    near = rb"[^\n|;]{0,200}?"
    option = near + _GAP + rb"-"
    logins = (
        rb"(?:-[a-zA-Z]*u|--user|-U|--proxy-user)(?:" + _GAP + rb"|=)?[\"']?[^\s:\"'/-][^\s:\"'/]*:([^\s\"',\\/$]+)"
    )
    echoed = rb"\b(?:echo|printf)\s+(?:-\w+\s+)?\\?[\"']?"
    piped = rb"([^\s\"'\\|]+)[^|\n]{0,6}\|\s*"
    given = rb"\([^()\n]{0,80}?,\s*(?:password\s*=\s*)?[rbf]?[\"']([^\"'\n]+)[\"']\s*\)"
    asked = rb"(?i)expect(?:_exact)?\([^\n]{0,60}?ass(?:word|phrase|wd)[^\n]{0,40}\)\s*;?\s*(?:\w+\s*=\s*)?[\w.]+"
    written = (
        (rb"\bsshpass" + option + rb"p" + _GAP + rb"?" + _VALUE, b"sshpass"),
        (rb"\b(?:curl|wget)\b" + near + logins, b"curl", b"wget"),
        (
            rb"\b(?:mosquitto_(?:pub|sub|rr)|zip|unzip)\b" + option + rb"P" + _GAP + rb"?" + _VALUE,
            b"mosquitto_",
            b"zip",
        ),
        (rb"\b(?:mysql(?:dump|admin)?|mariadb)\b" + option + rb"p" + _VALUE, b"mysql", b"mariadb"),
        (rb"\b(?:docker|podman|buildah|skopeo)" + _GAP + rb"login\b" + option + rb"p" + _GAP + _VALUE, b"login"),
        (rb"\bredis-cli\b" + option + rb"a" + _GAP + _VALUE, b"redis-cli"),
        (rb"\bssh-keygen\b" + option + rb"[NP]" + _GAP + _VALUE, b"ssh-keygen"),
        (echoed + rb"(?!\$)" + piped + rb"sudo\s+(?:-\w+\s+)*-S", b"|sudo"),
        (echoed + rb"[\w-]+:" + piped + rb"(?:sudo\s+)?chpasswd", b"chpasswd"),
        (rb"\biw(?:config|list)?\b" + near + rb"\bkey\s+(?:s:)?([^\s\"']{5,})", b"iwconfig"),
        (rb"\bwpa_passphrase" + _GAP + rb"[^\s\"',]+" + _GAP + _VALUE, b"wpa_passphrase"),
        (rb"\b(?:" + _CALLS + rb")" + given, b"username_pw_set", b"auth(", b"set_password", b".login("),
        (asked + rb"\.sendline\(\s*[rbf]?[\"']([^\"'\n]+)[\"']", b"sendline("),
    )
    for expression, *hints in written:
        yield _kind("password", expression, *hints)


def _homes() -> Iterator[Kind]:
    # Last, so that a secret in a path is replaced as a whole.
    home = re.compile(rb"(?<![\w.~-])(?:/mnt/[a-z])?/(?:home|Users)/[A-Za-z0-9_][A-Za-z0-9._-]*(?=$|[^A-Za-z0-9._-])")
    yield Kind(HOME_PATH, (b"/home/", b"/users/"), home, b"~")
    yield Kind(HOME_PATH, (b"/root",), re.compile(rb"(?<![\w./~-])/root(?=$|[/\s\"'\\,:;)\]}<])"), b"~")
