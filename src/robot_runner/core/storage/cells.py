"""The text of one cell of the run table, and the value that a text stands for."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Sequence
from datetime import UTC, datetime
from enum import Enum
from typing import Any

from robot_runner.core.design.factor import Factor
from robot_runner.core.design.numeric_range import is_number
from robot_runner.core.errors import MeasureError

# How far a run has come, and the word for it in the run table (paper, Fig. 3).


class RunStatus(Enum):
    """How far a run has come; the value is the word in the run table.

    Example:
        >>> status_of_word("TODO")
        <RunStatus.TODO: '-'>
    """

    TODO = "-"
    RUNNING = "Running"
    DONE = "Done"
    FAILED = "Failed"

    #: By identity, which is faster: that of `Enum` hashes the name, in Python.
    __hash__ = object.__hash__


# Spreadsheets turn a hyphen into a dash, and people write what they see elsewhere.
_WORDS = {status.value.casefold(): status for status in RunStatus} | dict.fromkeys(
    ("", "–", "—", "todo", "to do", "to_do"),  # noqa: RUF001 - the dashes are meant
    RunStatus.TODO,
)


#: The status of a run by how its last attempt ended, in the journal's words; after an interruption it is to be done.
ENDS = {"done": RunStatus.DONE, "failed": RunStatus.FAILED}


def status_of_word(word: str) -> RunStatus | None:
    """Return the status that a word stands for, in any case of letters, or None."""
    return _WORDS.get(word.strip().casefold())


#: What a measure's cell can hold. None is a missing value: an empty cell.
CellValue = int | float | bool | str | None

_BOOLS = {"true": True, "false": False}
#: Excel writes them in its language: Dutch, French, German, Italian, Portuguese, Spanish.
_ABROAD = dict.fromkeys(("waar", "vrai", "wahr", "vero", "verdadeiro", "verdadero"), "true")
_ABROAD |= dict.fromkeys(("onwaar", "faux", "falsch", "falso"), "false")
_SPECIAL = re.compile(r'[",\r\n]')

# An integer exactly as Python writes it: anything else (`007`, `+5`) was written as text and stays text.
_NUMBER_CHARACTERS = "0123456789.e+-"
# One of more digits than a float has is text, too: nothing could compute with it.
_MOST_DIGITS = 308
_WRITTEN_INT = re.compile(rf"-?(?:0|[1-9][0-9]{{0,{_MOST_DIGITS - 1}}})")
_ANY_NUMBER = re.compile(r"[+-]?(?:[0-9]{1,308}(\.[0-9]*)?|(\.[0-9]+))([eE][+-]?[0-9]+)?")
_DECIMAL_COMMA = re.compile(r"[+-]?[0-9]+,[0-9]+(?:[eE][+-]?[0-9]+)?")

_STAMPS = re.compile(r"(?:\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z\n)*+", re.ASCII)

#: What fits into so many digits, and below the largest float: R and pandas cannot read a column with larger integers.
_MAX_BITS = 1023


def quoted(text: str) -> str:
    r"""Return a text as a cell of a CSV file.

    `csv.writer` before Python 3.13 leaves a lone `\r` unquoted where lines end in `\n`, which breaks the row.
    """
    return '"' + text.replace('"', '""') + '"' if _SPECIAL.search(text) else text


def csv_text(rows: Sequence[Sequence[Any]]) -> str:
    r"""Return rows of a CSV file, with lines that end in `\n`; None is an empty cell, all else its `str()`."""
    written = io.StringIO(newline="")
    csv.writer(written, lineterminator="\n").writerows(rows)
    text = written.getvalue()
    if "\r" not in text:
        return text
    return "".join(",".join(quoted(measure_text(cell)) for cell in row) + "\n" for row in rows)


def measure_text(value: CellValue) -> str:
    """Return the text of a measure's cell: a float so that it is read back exactly, a missing value as empty."""
    if value is None:
        return ""
    return repr(value) if isinstance(value, float) else str(value)


def plain_value(text: str) -> CellValue:
    """Return the value of a cell whose type is not known: missing, a number, a bool, else text."""
    if not text:
        return None
    if not text.strip(_NUMBER_CHARACTERS):
        if _WRITTEN_INT.fullmatch(text):
            return int(text)
        number = _written_float(text)
        return text if number is None else number
    return _BOOLS.get(text.lower(), text)


def number_of(text: str, *, decimal_comma: bool = False) -> int | float | None:
    """Return the number in a cell, in any notation that people use, or None."""
    trimmed = text.strip()
    if decimal_comma and _DECIMAL_COMMA.fullmatch(trimmed):
        trimmed = trimmed.replace(",", ".")
    number = _ANY_NUMBER.fullmatch(trimmed)
    if number is None:
        return None
    if not any(number.groups()):
        return int(trimmed)
    value = float(trimmed)
    return value if math.isfinite(value) else None


def typed_value(text: str, kind: str | None, *, decimal_comma: bool = False) -> CellValue:
    """Return the value that a cell of a column stands for.

    `kind` is the column's type in the run table's schema; None to guess it from the cell. With `any`, the type of a
    column with texts and other values, a number that Python would write in another way is a text. A cell that does not
    fit the type is read as `plain_value` does. With `decimal_comma`, `0,5` is read as 0.5.
    """
    if not text:
        return None
    if kind in {"string", "datetime"}:
        return text
    if kind == "boolean":
        word = text.strip().casefold()
        return _BOOLS.get(_ABROAD.get(word, word), text)
    value = plain_value(text)
    if kind in {"number", "integer"} and isinstance(value, str):
        number = number_of(text, decimal_comma=decimal_comma)
        return text if number is None else number
    return text if kind == "any" and measure_text(value) != text else value


def typed_values(cells: Sequence[str], kind: str | None, *, decimal_comma: bool = False) -> list[CellValue]:
    """Return the values of many cells of one column: the same as `typed_value`, many times faster for plain numbers."""
    everything = "".join(cells)
    if not everything:
        return [None] * len(cells)
    if kind in {None, "any", "number", "integer"} and not everything.strip(_NUMBER_CHARACTERS):
        numbers = _all_ints(cells) or (_all_floats(cells, everything) if kind != "any" else None)
        if numbers is not None:
            return numbers
    return [typed_value(cell, kind, decimal_comma=decimal_comma) for cell in cells]


#: To how many digits programs round the numbers of a table that they save: R and LibreOffice to 15, Excel to what it
#: shows, which is 9 and more, but 6 where it shows a power of ten.
_DIGITS, _DIGITS_OF_POWERS = range(9, 18), 6
_SHOWN_AS_POWER = 1e-3, 1e10


def is_same_number(value: object, found: object) -> bool:
    """Return whether `found` is the number `value`, perhaps rounded as another program does that saves the table.

    Example:
        >>> is_same_number(20.833333333333332, 20.83333333), is_same_number(20.833333333333332, 20.83)
        (True, False)
    """
    if not (is_number(value) and is_number(found)):
        return False
    low, high = _SHOWN_AS_POWER
    digits = _DIGITS if low <= abs(value) < high else (_DIGITS_OF_POWERS, *_DIGITS)
    return value == found or any(float(f"{value:.{count}g}") == found for count in digits)


def treatment_position(factor: Factor, text: str, *, decimal_comma: bool = False) -> int | None:
    """Return the index of the treatment that a cell stands for, or None.

    The exact text comes first. Then, where exactly one treatment fits: the text without surrounding blanks, the same
    number (`1.0` for 1), the same letters in another case (`TRUE` for True), and the number that a text treatment reads
    as (`7` for "007", `1.1` for "1.10"), as people, spreadsheets and R write.
    """
    for candidate in (text, text.strip()):
        place = factor.position_of_text(candidate)
        if place is not None:
            return place
    number = number_of(text, decimal_comma=decimal_comma)
    same_number = [number is not None and is_number(each) and each == number for each in factor.treatments]
    if any(same_number):
        return _only(same_number)
    folded = text.strip().casefold()
    same_letters = [known.casefold() == folded for known in factor.texts]
    if not any(same_letters) and folded in _ABROAD:
        same_letters = [each is _BOOLS[_ABROAD[folded]] for each in factor.treatments]
    if any(same_letters) or number is None:
        return _only(same_letters)
    return _only([isinstance(each, str) and number_of(each) == number for each in factor.treatments])


def are_stamps(texts: Sequence[str]) -> bool:
    """Return whether all these texts are time stamps as the journal writes them (UTC, ISO 8601, milliseconds)."""
    lines = "\n".join((*texts, ""))
    return lines.count("\n") == len(texts) and _STAMPS.fullmatch(lines) is not None


def as_stamp(text: str) -> str | None:
    """Return a time stamp in another format, such as pandas', in the journal's format; None if it is not a time stamp.

    Example:
        >>> as_stamp("2026-01-31 13:00:00.250+01:00")
        '2026-01-31T12:00:00.250Z'
    """
    try:
        moment = datetime.fromisoformat(text.strip())
        is_whole = moment.tzinfo is not None and moment.microsecond % 1000 == 0
        return f"{moment.astimezone(UTC):%Y-%m-%dT%H:%M:%S}.{moment.microsecond // 1000:03d}Z" if is_whole else None
    except (ValueError, OverflowError):
        return None


def checked_measure(name: str, value: Any) -> CellValue:
    """Return a measure's value if the run table can hold it; an empty text is a missing value.

    Raises:
        MeasureError: it is of another type, not finite, too large, or a text that UTF-8 cannot encode.
    """
    problem = _measure_problem(value)
    if problem:
        fix = "Give a finite number, a bool, a string, or None for a missing value."
        raise MeasureError(problem, where=f"measure {name!r}", fix=fix)
    return None if value == "" else value


def _written_float(text: str) -> float | None:
    """Return the float that a cell of digits, signs, points and `e` stands for as Python writes it, or None."""
    if "." not in text and "e" not in text:
        return None
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def _all_ints(cells: Sequence[str]) -> list[CellValue] | None:
    """Return the whole numbers where each cell is one, written as Python writes it."""
    if max(map(len, cells)) > _MOST_DIGITS:
        return None
    try:
        values = list(map(int, cells))
    except ValueError:
        return None
    return list(values) if list(map(str, values)) == list(cells) else None


def _all_floats(cells: Sequence[str], everything: str) -> list[CellValue] | None:
    """Return the floats where each cell is one: each has a point, as none can have two."""
    if everything.count(".") != len(cells):
        return None
    try:
        values = list(map(float, cells))
    except ValueError:
        return None
    return None if math.inf in values or -math.inf in values else list(values)


def _measure_problem(value: object) -> str:
    if type(value) not in {int, float, bool, str, type(None)}:
        return f"{value!r} is of type {type(value).__name__}"
    if isinstance(value, float) and not math.isfinite(value):
        return f"{value!r} is not a finite number"
    if isinstance(value, int) and value.bit_length() > _MAX_BITS:
        return f"a number of {value.bit_length()} bits is too large"  # Python refuses to write out the longest
    if isinstance(value, str) and not value.isascii():
        try:
            value.encode()
        except UnicodeEncodeError:
            return f"{value!r} holds what UTF-8 cannot hold"
    return ""


def _only(fits: Sequence[bool]) -> int | None:
    return fits.index(True) if fits.count(True) == 1 else None
