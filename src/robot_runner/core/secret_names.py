"""Recognising secrets by their names, and masking them in all that is written: logs, journal, manifest."""

from __future__ import annotations

import hashlib
import json
import os
import re
import secrets
import time
import unicodedata
from collections.abc import Iterable, Mapping
from functools import lru_cache
from typing import Any

#: Replaces a secret.
REDACTED = "REDACTED"


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|[0-9]+|[^\W\d_]+")
#: Words that mean a secret anywhere in a name, in several languages.
_STRONG = _words(
    "password passwd passphrase passcode pwd pw psk secret credential apikey authtoken accesskey privatekey "
    "secretkey presharedkey passwort kennwort wachtwoord contrasena senha motdepasse mdp"
)
#: Words that mean one, unless they are about the tokens of a text, or a pass through something.
_COMMON = frozenset({"token", "pass"})
#: Words beside "key" that make it secret, unlike that of a keyboard or a dictionary.
_KEYS = _words(
    "api access private secret shared preshared signing encryption wep auth account master service deploy "
    "ssh gpg client license wpa app webhook consumer"
)
_NOT_A_LOGIN = _words(
    "eos bos pad unk cls sep mask stop special start end image max min num n total input output prompt "
    "completion new generated first second third low high band all single multi two one render forward "
    "backward by no per next last id test tests checks did does will prefill decode context count"
)
#: A name that ends in one of these is about a secret, but not one itself: where it is kept, how long it is.
_ABOUT = _words(
    "file path env var variable name names field column label prompt count len length type types hint policy "
    "regex pattern dir directory folder format min max limit rate size per expires expiry expiration ttl "
    "timeout manager store provider usage id ids index budget times frequency throughput latency speed cost "
    "price ms s seconds authentication required enabled check validator class parser generator loader source "
    "location url uri endpoint attempts retries ratio percent through pos position error errors rule rules "
    "kind mode level"
)


@lru_cache(maxsize=4096)
def is_secret_name(name: str) -> bool:
    """Return whether a name, in a config, a command, a settings file or the environment, is that of a secret.

    Example:
        >>> [is_secret_name(each) for each in ("wifi_password", "apiKey", "PLUG_PW", "max_tokens", "password_file")]
        [True, True, True, False, False]
    """
    plain = "".join(each for each in unicodedata.normalize("NFD", name) if not unicodedata.combining(each))
    words = [each.casefold() for each in _WORD.findall(plain)]  # without accents: contraseña is one word
    while words and words[-1].isdigit():
        words.pop()
    if not words or words[-1] in _ABOUT:
        return False
    singular = [each.removesuffix("s") if each != "pass" else each for each in words]
    if _STRONG & {*words, *singular}:
        return True
    for place, each in enumerate(singular):
        before = words[place - 1] if place else ""
        if each in _COMMON and place >= len(words) - 2 and before not in _NOT_A_LOGIN:
            return each != "token" or words[place] != "tokens" or before in _KEYS
        if each == "key" and (before in _KEYS or words[place - 2 : place] == ["pre", "shared"]):
            return True
    return words[-1] == "auth" or (words[-1] == "pin" and len(words) > 1 and words[0] in {"wifi", "sim", "door"})


_PLACEHOLDER = re.compile(
    r"(?is)none|null|nil|undefined|nan|true|false|yes|no|on|off|str|int|bytes|any|string|optional\b.*|required|missing"
    r"|basic|digest|bearer|ntlm|oauth2?|anonymous|guest|wpa-?psk|wpa-?eap|sae|open|unknown|empty|todo"
    r"|[*x•.?_-]+|<[^<>]*>|\$.*|%[\w(].*|\{\{.*|\{[\w.]*\}|@\w+@|your[\W_].*|/run/secrets/.*|!\w.*|REDACTED.*"
)


def is_placeholder(text: str) -> bool:
    """Return whether a value in place of a secret is none: empty, a reference to a variable, or a word for nothing.

    Example:
        >>> [is_placeholder(each) for each in ("", "${LAB_TOKEN}", "None", "swordfish")]
        [True, True, True, False]
    """
    return not text.strip() or _PLACEHOLDER.fullmatch(text.strip()) is not None or REDACTED in text


# The environment: the value of a variable with such a name must not reach a log or the manifest.

_SHORTEST = 6
#: In a secret of several lines, such as a key, each line with at least so many characters is masked, too.
_SHORTEST_LINE = 16
#: A folder or socket, and not a secret: SSH_AUTH_SOCK is kept under a name that sounds like one.
_PATH = re.compile(r"[/~.][\w/.~@+-]*")
_FOLDERS = frozenset({"PWD", "OLDPWD"})


def secrets_of_environment() -> tuple[str, ...]:
    """Return the values of variables with names such as `LAB_TOKEN`, the longest first.

    Texts of less than six characters, numbers of less than eight digits and paths are left out: replacing them
    everywhere would damage what is not a secret.
    """
    names = _names_in_process(len(os.environ), int(time.monotonic()))
    return _secrets_among(tuple(os.environ.get(name, "") for name in names))


@lru_cache(maxsize=1)
def _names_in_process(_count: int, _second: int) -> tuple[str, ...]:
    # Cached by the number of variables and the second, as it is asked for with each line of a log.
    return tuple(name for name in os.environ if name not in _FOLDERS and is_secret_name(name))


@lru_cache(maxsize=8)
def _secrets_among(texts: tuple[str, ...]) -> tuple[str, ...]:
    found: set[str] = set()
    for text in filter(_is_worth_hiding, texts):
        found |= {text, *(line for line in text.splitlines() if len(line) >= _SHORTEST_LINE)}
    return tuple(sorted(found, key=lambda text: (-len(text), text)))


@lru_cache(maxsize=1024)
def _is_worth_hiding(text: str) -> bool:
    is_short = len(text) < (8 if text.isdigit() else _SHORTEST)
    return not is_short and not is_placeholder(text) and _PATH.fullmatch(text) is None


def without_environment_secrets(text: str) -> str:
    """Return a text with the values of secret variables masked, also in the form of JSON.

    Example:
        >>> import os
        >>> os.environ["LAB_TOKEN"] = "open-sesame"
        >>> without_environment_secrets("connected with open-sesame")
        'connected with REDACTED'
        >>> del os.environ["LAB_TOKEN"]
    """
    return _without(text, secrets_of_environment())


def _without(text: str, hidden: tuple[str, ...]) -> str:
    for secret in hidden:
        for form in forms_of(secret):
            if form in text:
                text = text.replace(form, REDACTED)
    return text


def without_secrets(value: Any) -> Any:
    """Return JSON data with the values of secret variables masked in all texts; other objects become their text."""
    return _masked(value, secrets_of_environment())


#: A setting in an address; in those of many cameras they follow a slash.
_SETTING = re.compile(r"(?<=[?&;/])([\w.-]+)=([^&;\s'\"]+)")


def without_secret_settings(text: str, instead: str = REDACTED) -> str:
    """Return a text without the secrets that are settings in its addresses.

    Example:
        >>> without_secret_settings("rtsp://camera/user=lab&password=swordfish&channel=1")
        'rtsp://camera/user=lab&password=REDACTED&channel=1'
    """
    return _SETTING.sub(lambda found: f"{found[1]}={instead}" if is_secret_name(found[1]) else found[0], text)


def _masked(value: Any, hidden: tuple[str, ...]) -> Any:
    match value:
        case None | bool() | int() | float():
            return value
        case dict():
            named = ((_masked(name, hidden) if isinstance(name, str) else name, each) for name, each in value.items())
            return {name: _masked(each, hidden) for name, each in named}
        case list() | tuple():
            return [_masked(each, hidden) for each in value]
    return _without(str(value), hidden)


#: Fields of a record that may contain output or arguments of programs.
_HIDING = frozenset(
    {"problem", "traceback", "fix", "failure", "reason", "text", "note", "seen", "said"}
    | {"values", "condition", "command", "environment", "setup"}
)


def sentences_without_secrets(fields: dict[str, Any]) -> dict[str, Any]:
    """Return a record's fields with secrets of the environment masked in sentences, commands and the like.

    Names, treatments and measures are not changed: they are data, and may be equal to a password by chance.
    """
    return fields | {
        name: without_secrets(each) for name in _HIDING & fields.keys() if (each := fields[name]) is not None
    }


def forms_of(secret: str) -> set[str]:
    """Return the forms of a secret: as it is, quoted as in CSV, and as in JSON, with and without escapes."""
    return {secret, json.dumps(secret)[1:-1], json.dumps(secret, ensure_ascii=False)[1:-1], secret.replace('"', '""')}


# Static parameters that are set from outside: `--set db_password=X` is neither shown nor kept, and can be compared.

_HIDDEN = re.compile(rf"{REDACTED} scrypt:([0-9a-f]{{32}}):([0-9a-f]{{64}})")
#: Parameters of scrypt (RFC 7914): 16 MiB of memory and some 50 ms for each guess of a password.
_SCRYPT = {"n": 1 << 14, "r": 8, "p": 1, "dklen": 32}


def hidden_settings(settings: Mapping[str, str]) -> dict[str, str]:
    """Return settings for the manifest: a secret as a salted digest, by which it can be compared."""
    hidden = dict(settings)
    for name, text in settings.items():
        if is_secret_name(name) and text and REDACTED not in text:
            hidden[name] = _digest(text, secrets.token_hex(16))
    return hidden


def is_same_setting(kept: str | None, given: str | None) -> bool:
    """Return whether a recorded setting, hidden or not, is equal to the present one."""
    match = _HIDDEN.fullmatch(kept or "")
    if match is None or given is None:
        return kept == given or (given is not None and kept == without_environment_secrets(given))
    return given == kept or secrets.compare_digest(_digest(given, match[1]), kept or "")


def shown_settings(settings: Mapping[str, object]) -> dict[str, str]:
    """Return settings for a screen, with secrets masked.

    Example:
        >>> shown_settings({"robot": "simulated", "db_password": "swordfish"})
        {'robot': 'simulated', 'db_password': 'REDACTED'}
    """
    return {
        name: REDACTED
        if is_secret_name(name) and str(text)
        else without_environment_secrets(_HIDDEN.sub(REDACTED, text))
        for name, text in ((name, str(value)) for name, value in settings.items())
    }


def shown_assignments(assignments: Iterable[str]) -> list[str]:
    """Return `name=value` assignments as words of a command to show, with secrets replaced by dots.

    Example:
        >>> shown_assignments(["robot=simulated", "db_password=swordfish"])
        ['robot=simulated', 'db_password=...']
    """
    named = (each.partition("=") for each in assignments)
    return [
        f"{name}{equals}{'...' if is_secret_name(name) and text else without_environment_secrets(text)}"
        for name, equals, text in named
    ]


@lru_cache(maxsize=64)
def _digest(text: str, salt: str) -> str:
    digest = hashlib.scrypt(text.encode("utf-8", "surrogateescape"), salt=bytes.fromhex(salt), **_SCRYPT)
    return f"{REDACTED} scrypt:{salt}:{digest.hex()}"
