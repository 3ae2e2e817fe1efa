"""Numbers, times and values in words, and `INACTIVE`, the treatment of a factor that does not apply."""

from __future__ import annotations

import math
from collections.abc import Mapping

TYPE_CHECKING = False  # `typing` takes long to import, and `--help` is to be quick
if TYPE_CHECKING:
    from collections.abc import Iterable


_MINUTE = 60
_HOUR = 3600
_SHOWN = 4
_MISSING = "\N{EN DASH}"  # not a hyphen, which is a run that is still to do
#: An empty treatment, where it stands among others.
EMPTY = "“”"
#: Units, in lower case, of scales with an arbitrary zero (interval scales).
_AGREED_ZEROS = frozenset(
    {"\N{DEGREE SIGN}c", "\N{DEGREE CELSIUS}".lower(), "degc", "celsius", "\N{DEGREE SIGN}f", "degf", "fahrenheit"}
)
#: Characters that only lay text out: line ends, tabs, and blanks of other scripts.
_LAYOUT = frozenset("\n\t\N{NO-BREAK SPACE}\N{NARROW NO-BREAK SPACE}\N{IDEOGRAPHIC SPACE}")


def one_line(text: str) -> str:
    r"""Return a text on one line, without control sequences for a terminal.

    Example:
        >>> one_line("two\nlines")
        'two\\nlines'
    """
    return text if text.isprintable() else "".join(_printable(character) for character in text)


def harmless(text: str) -> str:
    r"""Return a text without control sequences for a terminal; line ends and tabs stay.

    Control characters (C0, C1, and so every escape sequence), marks that change the direction of writing and whatever
    else has no glyph are shown as Python writes them.

    Example:
        >>> harmless("Task\x1b]0;owned\x07")
        'Task\\x1b]0;owned\\x07'
    """
    if text.isprintable() or text.replace("\n", "").isprintable():
        return text
    return "".join(each if each in _LAYOUT else _printable(each) for each in text)


def harmless_json(text: str) -> str:
    r"""Return the same JSON without control sequences for a terminal, which are escaped.

    Example:
        >>> harmless_json('{"Task": "\x9b2J"}')
        '{"Task": "\\u009b2J"}'
    """
    if harmless(text) == text:
        return text
    return "".join(each if each == "\n" or each.isprintable() else _json_escape(each) for each in text)


def _json_escape(character: str) -> str:
    units = character.encode("utf-16-be", "surrogatepass")  # two bytes each: JSON has no escape beyond U+FFFF
    return "".join(f"\\u{units[place : place + 2].hex()}" for place in range(0, len(units), 2))


def _printable(character: str) -> str:
    return character if character.isprintable() else repr(character)[1:-1]


def counted(number: int, noun: str) -> str:
    """Return a number with its noun.

    Example:
        >>> counted(1, "run"), counted(15, "run")
        ('1 run', '15 runs')
    """
    return f"{number:,} {noun}{'' if number == 1 else 's'}"


def listed(names: Iterable[str], shown: int = _SHOWN) -> str:
    """Return the first names of a list, and how many more there are; `enumerated` returns all of them.

    Example:
        >>> listed(["r_1", "r_2", "r_3"]), listed(map(str, range(9)))
        ('r_1, r_2, r_3', '0, 1, 2, 3 and 5 more')
    """
    everything = list(names)
    # "and 1 more" would be longer than the name itself.
    if len(everything) <= shown + 1:
        return ", ".join(everything)
    return f"{', '.join(everything[:shown])} and {len(everything) - shown:,} more"


def enumerated(words: Iterable[str]) -> str:
    """Return all words, separated by commas, the last one by "and".

    Example:
        >>> enumerated(["numpy"]), enumerated(["Task", "Speed", "Floor"])
        ('numpy', 'Task, Speed and Floor')
    """
    *most, last = list(words) or [""]
    return f"{', '.join(most)} and {last}" if most else last


def combination_label(treatments: Iterable[object]) -> str:
    """Return the treatments of a combination as one text; one with the separator in it, or an empty one, is quoted.

    Example:
        >>> [combination_label(each) for each in (["Video", "lab"], ["Video", "lab / hall"], ["lab / hall"], [""])]
        ['Video / lab', 'Video / “lab / hall”', 'lab / hall', '“”']
    """
    texts = [str(each) or EMPTY for each in treatments]
    if len(texts) > 1:
        texts = [f"“{text}”" if " / " in f" {text} " else text for text in texts]
    return " / ".join(texts)


def shown_commit(facts: object) -> str:
    """Return the recorded state of a repository in words; empty where there is none.

    Example:
        >>> shown_commit({"commit": "1a2b3c4d5e6f7a8b", "branch": "main", "is_dirty": True})
        '1a2b3c4d5e6f (main), with changes that were not committed'
    """
    if not isinstance(facts, Mapping) or not isinstance(facts.get("commit"), str):
        return ""
    places = [str(facts[name]) for name in ("branch", "origin", "repository") if facts.get(name)]
    where = f" ({' of '.join(places)})" if places else ""
    return one_line(
        f"{facts['commit'][:12]}{where}{', with changes that were not committed' if facts.get('is_dirty') else ''}"
    )


def shown_duration(seconds: float) -> str:
    """Return a duration in words.

    Example:
        >>> [shown_duration(each) for each in (0.04, 3.44, 59.96, 125, 3725)]
        ['40 ms', '3.4 s', '1 min 00 s', '2 min 05 s', '1 h 02 min']
    """
    if seconds < 0.9995:  # noqa: PLR2004 - what would be 1000 ms is a second
        return f"{seconds * 1000:.0f} ms"
    if seconds < 9.95:  # noqa: PLR2004 - beyond it a tenth of a second says nothing
        return f"{seconds:.1f} s"
    whole = round(seconds)
    if whole < _MINUTE:
        return f"{whole} s"
    if whole < _HOUR:
        return f"{whole // _MINUTE} min {whole % _MINUTE:02} s"
    return f"{whole // _HOUR} h {whole % _HOUR // _MINUTE:02} min"


def shown_value(value: object) -> str:
    """Return a measure in four significant digits, and a missing one as a dash.

    Example:
        >>> [shown_value(each) for each in (877.1234, 0.000123456, 16, True, 1234567.8)]
        ['877.1', '0.0001235', '16', 'True', '1234568']
        >>> shown_value(835.0), shown_value(1234.0)
        ('835.0', '1234')
    """
    if value is None:
        return _MISSING
    if not isinstance(value, float) or not math.isfinite(value):
        return one_line(str(value))
    if 9_999.5 <= abs(value) < 1e12:  # noqa: PLR2004 - the exponent would hide what is a whole number to a reader
        return f"{value:.0f}"
    return f"{value:#.4g}".rstrip(".")


def exact(number: float) -> str:
    """Return a number with all of its digits, and without a point where it is whole.

    Example:
        >>> exact(31.0), exact(1234567.8)
        ('31', '1234567.8')
    """
    return str(number).removesuffix(".0")


def has_true_zero(unit: str) -> bool:
    """Return whether percentages of values in a unit make sense (a ratio scale), unlike of degrees Celsius or decibels.

    Such a scale has an arbitrary zero: 20 degrees Celsius are not twice 10, but 1.04 times as many kelvins.

    Example:
        >>> has_true_zero("K"), has_true_zero("degC"), has_true_zero("dB(A)")
        (True, False, False)
    """
    return unit.strip().lower() not in _AGREED_ZEROS and not unit.strip().startswith("dB")


def shown_treatment(treatment: object) -> str:
    """Return a treatment as the run table writes it, on one line; an empty one is quoted."""
    return one_line(str(treatment)) or EMPTY


def plain(value: object) -> bool | int | float | str | None:
    """Return a value as JSON can hold it; an object becomes its text."""
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float) and math.isfinite(value):
        return value
    return str(value)


class Inactive:
    """The treatment of a factor that does not apply to a run: `Factor("Resolution", [...], when={"Sensor": "camera"})`.

    Its only instance is `INACTIVE`. In the run table it is written `inactive`: an empty cell, `None` or `NA` would be
    read as a missing value. A parameter that is bound to the factor keeps its default in such a run.

    Example:
        >>> str(INACTIVE)
        'inactive'
    """

    __slots__ = ()

    def __reduce__(self) -> str:
        return "INACTIVE"  # the only instance in other processes, too: combinations are compared by identity

    def __str__(self) -> str:
        return "inactive"

    __repr__ = __str__


INACTIVE = Inactive()
