"""Find secrets by the names before them: settings, arguments, fields, elements, and sentences in notes."""

from __future__ import annotations

import re
from collections.abc import Iterator
from enum import Enum
from functools import lru_cache

from robot_runner.core.secret_names import is_placeholder, is_secret_name
from robot_runner.replication.secret_kinds import Found


class Grammar(Enum):
    """The grammar of a file's text; replacing secrets must keep the text valid."""

    TEXT = "text"
    DATA = "data"
    TABLE = "table"
    CODE = "code"
    MARKUP = "markup"


#: Parts of the names of secrets, in lower case.
NAME_HINTS = (
    *(b"pass", b"pwd", b"pw", b"psk", b"secret", b"token", b"key", b"credential", b"auth", b"kennwort", b"wachtwoord"),
    *(b"contrase", b"senha", b"mdp", b"pin"),
)
#: As a name; a Spanish password has a letter that is not in ASCII.
_HINT = re.compile(rb"(?:" + b"|".join(NAME_HINTS) + rb")(?:\xc3[\xb1\x91]|n\xcc\x83)?[\w.-]{0,64}", re.ASCII)
_LONGEST_NAME = 64
_LONGEST_LINE = 400
#: The part of a name before a hint, matched on the reversed text: forwards, each word would be tried.
_NAME_BEFORE = re.compile(rb"[\w.-]*", re.ASCII)

_QUOTE = rb"\\?[\"']"
#: In a text within a text, a quotation mark has a backslash, and one within that has three.
_TEXT = (
    rb"(?P<quote>[rbfuRBFU]{0,2}(?P<mark>\\?[\"']))"
    rb"(?P<quoted>(?:\\\\\\[\"']|(?!(?P=mark))(?:\\[^\n]|[^\\\n]))*)(?P=mark)"
)
_BARE = rb"(?P<bare>[^\s\"'`,;<>\\)}\]]+)"
_NUMBER = rb"(?P<number>\d{4,})(?![\w.])"


#: What may follow a name in any grammar, up to a value in quotes.
_QUOTED = (
    # password = "X", "password": "X", password: str = "X", ["DB_PASSWORD"] = "X"
    re.compile(
        rb"(?:" + _QUOTE + rb"\s*\]?)?[ \t]*(?::[ \t]*[\w\[\]. |]+=|:=|=>|<-|[:=])[ \t]*(?:\\\n\s*|\(\s*)?" + _TEXT
    ),
    # name="password" value="X", ("password", default_value="X"), {"name": "password", "value": "X"}
    re.compile(_QUOTE + rb"[\s,]+" + _QUOTE + rb"?(?:default_value|default|value)" + _QUOTE + rb"?\s*[:=]\s*" + _TEXT),
)
#: "--password", "X" and getenv("MQTT_PASS", "X"); in other lists the next text is not the value.
_NEXT = re.compile(_QUOTE + rb"\s*,\s*" + _TEXT)
_BEFORE_NEXT = re.compile(rb"(?:getenv|environ\.get|setdefault|environ\.setdefault|setenv|param)\(\s*[\"']\Z|--?\Z")
#: auth = ("ada", "X")
_PAIR = re.compile(_QUOTE + rb"?\s*[:=]\s*\(\s*[\"'][^\"'\n]*[\"']\s*,\s*" + _TEXT + rb"\s*\)")
#: value="X" name="password"
_VALUE_BEFORE = re.compile(rb"(?:value|default)\s*=\s*([\"'])(?P<quoted>[^\"'\n<>]+)\1\s+name\s*=\s*[\"']\Z")
_ELEMENT = re.compile(rb">(?P<bare>[^<>\n]+)</")
_NUMERIC = re.compile(rb"(?:" + _QUOTE + rb")?[ \t]*(?::[ \t]*int[ \t]*=|:=|[:=])[ \t]*" + _NUMBER)
#: In a URL: ?token=X&next=...
_PARAMETER = re.compile(rb"=(?P<bare>[^\s\"'&#\\<>{}\0-\x1f]+)")
#: In a line of a settings file or a log: password: X
_LOOSE = re.compile(rb"[ \t]*(?::=|[:=])[ \t]*(?:!!str[ \t]+)?" + _BARE)
_OF_SOMEBODY = re.compile(
    rb"[ \t]+(?:for|of|von|van|voor|f\xc3\xbcr)[ \t]+(?:[\w@.'-]+[ \t]+){0,3}[\w@.'-]+:[ \t]+" + _BARE
)
_BLOCK_SCALAR = re.compile(
    rb"[ \t]*:[ \t]*[|>][-+0-9]*[ \t]*\n(?P<indent>[ \t]+)(?P<bare>[^\n]+(?:\n(?P=indent)[^\n]+)*)"
)
_FLAG = re.compile(_QUOTE + rb"?(?:[ \t]+)(?!-)" + _BARE)
#: The robot's password is X; pw - X
_PROSE = re.compile(
    rb"[ \t]+(?:is|was|war|ist|lautet|=|->|\xe2\x80\x93|-)[ \t]+(?P<bare>[^\s\"',;<>\\)}\]]+)(?P<rest>[^\n]*)"
)
_GOES_ON = re.compile(rb"[ \t]+[a-z]{2,}[ \t]+[a-z]")
_SPACED = re.compile(rb"[ \t]+(?P<bare>[^\s\"',;<>\\)}\]:=]+)[ \t]*(?=\r?\n|\Z|\\n|[\"'])")

#: In a line with one of these commands, the word after `password` is the password.
_COMMAND_LINE = re.compile(rb"(?i)\b(?:nmcli|machine|login|param set|rosparam|wpa_cli|ENV|set -x|setx|identified by)\b")
_NO_WORD = re.compile(
    rb"(?i)(?:not?|never|wrong|incorrect|invalid|valid|correct|empty|set|in|the|a|an|that|this|his|her|our|their|your|my"
    rb"|known|unknown|kept|read|given|sent|shown|still|there|here|too|only|also|always|now|then|nowhere|secret|private|by"
    rb"|for|from|to|of|on|as|at|if|it|one|what|same|different|needed|asked|ask|stored|used|optional|required|missing"
    rb"|ok|okay|public|short|long|weak|strong|\w+ed|\w+ing|\w+able|nicht|kein|das|der|die|ein|eine)[.!?:)]*"
)
_LONGEST_SECRET, _SHORTEST_TOKEN_NUMBER = 1 << 16, 16
_WHAT = "password"
_LOGIN_WORDS = re.compile(r"(?i)pass|pw|psk|pin|kennwort|wachtwoord|contrase|senha|mdp")


def named_secrets(block: bytes, grammar: Grammar) -> Iterator[Found]:
    """Yield the secrets with names in a block.

    Args:
        block: the text.
        grammar: its grammar.
    """
    for hint in _HINT.finditer(block.lower()):
        first, end = hint.span()
        before = _NAME_BEFORE.match(block[first - min(first, _LONGEST_NAME) : first][::-1])
        start = first - (before.end() if before else 0)
        written = block[start:end].rstrip(b".-")
        if name := _secret_name(written):
            begin, length = start + len(written) - len(name.encode()), len(name.encode())
            yield from _after(block, (begin, begin + length), name, grammar)


@lru_cache(maxsize=4096)
def _secret_name(written: bytes) -> str:
    """Return a name without its prefix, as in `--password`; empty if it is not the name of a secret."""
    name = written.lstrip(b".-").decode("utf-8", "replace")
    return name if len(name) <= _LONGEST_NAME and is_secret_name(name) else ""


#: Cells of a table, by separator. A quoted cell may have several lines; an unclosed quotation mark is a character.
_CELLS = {
    mark: re.compile(
        rb"(?P<cell>\"(?:[^\"]|\"\")*+\"(?=[MARK\r\n]|\Z)|(?P<open>(?=\"(?:[^\"]|\"\")*+\Z))?[^MARK\r\n]*)"
        rb"(?P<end>MARK|\r?\n|\r|\Z)".replace(b"MARK", mark)
    )
    for mark in (b",", b";", b"\t")
}

#: Quoted cells of a table, by separator, and all that is between them.
_QUOTED_CELLS = {
    mark: re.compile(
        rb"(?<![^MARK\r\n])\"(?P<quoted>(?:[^\"]|\"\")*+)\"(?=[MARK\r\n]|\Z)|[^\"]+|\"".replace(b"MARK", mark)
    )
    for mark in _CELLS
}


_IN_QUOTES = re.compile(rb"\"[^\"]*\"")


def _rows(block: bytes, separator: bytes) -> Iterator[list[re.Match[bytes]]]:
    row: list[re.Match[bytes]] = []
    for cell in _CELLS[separator].finditer(block):
        row.append(cell)
        if cell["end"] != separator:
            yield row
            row = []


def cells_apart(table: bytes, separator: bytes) -> bytes:
    r"""Return a table, as long as before, in which each cell is a line, and quotation marks within cells are escaped.

    So a secret ends where its cell ends.

    Example:
        >>> cells_apart(b'tcp://robot:7447,831.0,"a ""b"", c"', b",")
        b'tcp://robot:7447\n831.0\n"a \\"b\\", c"'
    """

    def apart(match: re.Match[bytes]) -> bytes:
        cell, between = match["quoted"], match[0]
        return between.replace(separator, b"\n") if cell is None else b'"' + cell.replace(b'""', b'\\"') + b'"'

    return _QUOTED_CELLS[separator].sub(apart, table)


def secret_columns(beginning: bytes) -> tuple[bytes, frozenset[int]]:
    """Return a table's separator, and the indices, from 0, of the columns whose headings are names of secrets."""
    separator = max(_CELLS, key=_IN_QUOTES.sub(b"", beginning).partition(b"\n")[0].count)
    heading = next(_rows(beginning, separator), [])
    if not (heading and heading[-1]["end"]):  # a line that goes on
        return separator, frozenset()
    names = [each["cell"].strip(b'"').decode("utf-8", "replace") for each in heading]
    return separator, frozenset(place for place, name in enumerate(names) if is_secret_name(name))


def secrets_in_columns(
    block: bytes, separator: bytes, columns: frozenset[int], *, has_heading: bool, goes_on: bool
) -> tuple[list[Found], list[int]]:
    """Return the cells of these columns that are neither empty nor numbers, as possible secrets.

    Args:
        block: the text, which begins with a row.
        separator: between its columns.
        columns: the indices of the columns whose headings are names of secrets.
        has_heading: whether the first row is the heading.
        goes_on: whether the text continues in another block, which may close a quotation mark: an incomplete row is
            left out then.

    Returns:
        The cells, and the end of each row.
    """
    found: list[Found] = []
    ends: list[int] = []
    for row in _rows(block, separator):
        if goes_on and not (row[-1]["end"] and all(cell["open"] is None for cell in row)):
            break
        ends.append(row[-1].end())
        if has_heading and len(ends) == 1:
            continue
        for place in columns.intersection(range(len(row))):
            cell = row[place]["cell"]
            if not is_placeholder(cell.decode("utf-8", "replace")) and not _is_number(cell):
                begin, end = row[place].span("cell")
                found.append(Found(begin, end, f"what may be a {_WHAT} in a column", begin, is_sure=False))
    return found, ends


def _is_number(cell: bytes) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _after(block: bytes, place: tuple[int, int], name: str, grammar: Grammar) -> Iterator[Found]:
    """Yield the secret of a name at a place in a block; at most one."""
    start, end = place
    before = block[max(0, start - _LONGEST_LINE) : start].rsplit(b"\n", 1)[-1]
    if match := _quoted(block, end, before):
        yield from _judged(match, "quoted", name, start)
    elif match := _VALUE_BEFORE.search(block, max(0, start - _LONGEST_LINE), start):
        yield from _judged(match, "quoted", name, match.start())
    elif (match := _bare(block, end, before)) and (grammar is not Grammar.MARKUP or _is_text(match["bare"])):
        yield from _judged(match, "bare", name, start)
    elif match := _NUMERIC.match(block, end):
        yield from _judged_number(match, name, start, grammar)
    elif grammar in {Grammar.TEXT, Grammar.DATA, Grammar.TABLE}:
        yield from _loosely(block, place, name, before)


def _quoted(block: bytes, end: int, before: bytes) -> re.Match[bytes] | None:
    """Return the value in quotes of a name that ends here, in any grammar."""
    for form in _QUOTED:
        if (match := form.match(block, end)) and not _is_closing(match, before):
            return match
    match = _NEXT.match(block, end)
    if match and _BEFORE_NEXT.search(before) and not match["quoted"].startswith(b"-"):
        return match
    return _PAIR.match(block, end)


def _bare(block: bytes, end: int, before: bytes) -> re.Match[bytes] | None:
    """Return the unambiguous value without quotes: in a URL, an XML element, an option."""
    if before.endswith((b"?", b"&")):
        return _PARAMETER.match(block, end)
    if before.endswith(b"<"):
        return _ELEMENT.match(block, end)
    return _FLAG.match(block, end) if before.endswith(b"-") else None


def _is_text(value: bytes) -> bool:
    """Whether a value is text, not bytes of an image, where short names occur by chance; four characters suffice."""
    try:
        value.decode()
    except UnicodeDecodeError:
        return re.match(rb"[!-~]{4}", value) is not None
    return True


def _is_closing(match: re.Match[bytes], before: bytes) -> bool:
    """Whether a quotation mark closes the text that contains the name, as in `ask("Password: ")`."""
    mark = match["mark"]
    is_in_quotes = before.endswith(mark) and match[0].startswith(mark)
    return before.count(mark) % 2 == 1 and not is_in_quotes


def _loosely(block: bytes, place: tuple[int, int], name: str, before: bytes) -> Iterator[Found]:
    """Yield the secret of a name in a text without a strict grammar."""
    start, end = place
    if match := _BLOCK_SCALAR.match(block, end):
        yield from _judged(match, "bare", name, start)
    elif (match := _LOOSE.match(block, end)) or (match := _OF_SOMEBODY.match(block, end)):
        if _GOES_ON.match(block, match.end()) and match["bare"].isalpha():
            yield from _of_sentence(match, name, start)
        elif not _is_code(match["bare"]) and not block.startswith(b"(", match.end()):
            yield from _judged(match, "bare", name, start)
    elif match := _PROSE.match(block, end):
        yield from _told(match, name, start)
    elif (match := _SPACED.match(block, end)) and (_COMMAND_LINE.search(before) or "_" in name):
        yield from _judged(match, "bare", name, start)


def _told(match: re.Match[bytes], name: str, start: int) -> Iterator[Found]:
    """Yield the secret that a sentence states; a plain word is only a possible secret."""
    value = match["bare"].rstrip(b".!?")
    if _NO_WORD.fullmatch(value) or is_placeholder(value.decode("utf-8", "replace")) or _is_code(value):
        return
    is_random = re.search(rb"\d", value) is not None or re.search(rb"[a-z][A-Z]", value) is not None
    is_last = not match["rest"].strip(b" \t\r.!-<>/*\"'}")
    is_sure = is_random or (is_last and _LOGIN_WORDS.search(name) is not None)
    what = _WHAT if is_sure else f"what may be a {_WHAT}"
    yield Found(match.start("bare"), match.start("bare") + len(value), what, start, is_sure=is_sure)


def _of_sentence(match: re.Match[bytes], name: str, start: int) -> Iterator[Found]:
    """Yield a plain word after a colon as a possible secret: a sentence may begin with it."""
    value = match["bare"]
    if name != "pass" and not _NO_WORD.fullmatch(value) and not is_placeholder(value.decode("ascii", "replace")):
        yield Found(*match.span("bare"), f"what may be a {_WHAT}", start, is_sure=False)


def _judged(match: re.Match[bytes], group: str, name: str, begin: int) -> Iterator[Found]:
    if is_secret_value(match[group], name):
        yield Found(*match.span(group), _WHAT, begin)


def _judged_number(match: re.Match[bytes], name: str, begin: int, grammar: Grammar) -> Iterator[Found]:
    """Yield a number that is a password; short numbers of tokens and keys are mostly counts or indices."""
    if _LOGIN_WORDS.search(name) or len(match["number"]) >= _SHORTEST_TOKEN_NUMBER:
        replacement = b'"REDACTED"' if grammar in {Grammar.DATA, Grammar.CODE} else b"REDACTED"
        yield Found(*match.span("number"), _WHAT, begin, replacement)


def is_secret_value(value: bytes, name: str) -> bool:
    """Return whether a value of a name that is a secret's is one, and not a placeholder, a path, or a version."""
    text = value.decode("utf-8", "replace")
    if is_placeholder(text) or len(text) > _LONGEST_SECRET or _VERSION.fullmatch(text):
        return False
    if text.replace(".", "").replace("-", "").isdigit():
        return bool(_LOGIN_WORDS.search(name)) and len(text) >= 4  # noqa: PLR2004 - a PIN's
    is_path = text.startswith(("/", "~/", "./", "../")) and "/" in text[1:]
    is_prose = " " in text.strip() and not _LOGIN_WORDS.search(name)
    return not is_path and not is_prose and not text.startswith(("http://", "https://")) and len(text) > 2  # noqa: PLR2004


#: A version, as in a list of packages: Debian has packages called passwd and base-passwd.
_VERSION = re.compile(r"(?:\d+:)?\d+(?:\.\d+)+[\w.+:~-]*")
_CALL = re.compile(rb"[A-Za-z_][\w.]*[(\[]|[A-Za-z_]\w*\.[A-Za-z_]\w*(?:\.\w+)*\Z|(?:self|os|args|cls)\b|\(|\[|\{|&|\*")


def _is_code(value: bytes) -> bool:
    """Whether a value without quotes is an expression, such as a call or an attribute."""
    return _CALL.match(value) is not None
