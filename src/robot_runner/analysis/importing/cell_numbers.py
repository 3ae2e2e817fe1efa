"""Numbers as spreadsheets and people write them: decimal commas, grouped thousands, units behind them."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from robot_runner.analysis.importing.units import Unit, unit_of
from robot_runner.core.storage.cells import number_of

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

__all__ = ["MISSING", "PlainCells", "plain_cells"]

#: What stands for a missing value among numbers, in small letters.
MISSING = frozenset({"", "na", "n/a", "nan", "none", "null", "-", "–", "—"})  # noqa: RUF001 - spreadsheets write dashes

#: How numbers are written that are not plain: what groups thousands, the decimal sign, and both in words.
_STYLES = (
    ("", ",", "decimal commas"),
    (",", ".", "commas between thousands"),
    (".", ",", "points between thousands"),
    ("[ \u00a0\u202f]", "[.,]", "blanks between thousands"),
    ("['\u2019]", ".", "apostrophes between thousands"),
)
_WITH_UNIT = re.compile(r"([+-]?\d[\d.,]*(?:[eE][+-]?\d+)?)\s*([^\d\s.,].{0,11})")


@dataclass(frozen=True, slots=True)
class PlainCells:
    """The cells of a column with its numbers written plainly.

    Attributes:
        cells: the column.
        unit: the unit that stood behind each number, or None.
        words: how the numbers were written, in words; empty where nothing was changed.
        doubt: what they may mean otherwise, as in `1,234`; empty where that is clear.
    """

    cells: Sequence[str]
    unit: Unit | None = None
    words: str = ""
    doubt: str = ""


def plain_cells(cells: Sequence[str], *, decimal: str | None, has_decimal_commas: bool) -> PlainCells:
    """Return a column with its numbers written plainly; others stay as they are.

    Args:
        cells: the column.
        decimal: the decimal sign, if the user named it.
        has_decimal_commas: whether other numbers of the file have decimal commas.

    Example:
        >>> plain_cells(["1,5", "2,25", "nan"], decimal=None, has_decimal_commas=False).cells
        ['1.5', '2.25', 'nan']
    """
    filled = {cell for cell in set(cells) if cell.casefold() not in MISSING}
    numbers = {cell: cell for cell in filled}
    unit = None
    suffixed = {cell: found for cell in filled if (found := _WITH_UNIT.fullmatch(cell))} if _ends_alike(filled) else {}
    if filled and len(suffixed) == len(filled):
        suffixes = {found[2].strip() for found in suffixed.values()}
        unit = unit_of(suffixes.pop()) if len(suffixes) == 1 else None
        if unit is not None:
            numbers = {cell: found[1] for cell, found in suffixed.items()}
    readings = _readings(numbers.values(), has_decimal_commas or decimal == ",")
    if decimal is not None and len(readings) > 1:
        readings = [each for each in readings if (each[0] == "decimal commas") == (decimal == ",")] or readings
    if not readings or (unit is None and not readings[0][0]):
        return PlainCells(cells)
    words, plain = readings[0]
    doubt = f"{min(plain)} may be {' or '.join(str(each[1][min(plain)]) for each in readings)}" if readings[1:] else ""
    written = {cell: plain[number] for cell, number in numbers.items()}
    said = ", ".join(filter(None, (words, f"the unit {unit.symbol} behind each" if unit else "")))
    return PlainCells([written.get(cell, cell) for cell in cells], unit, said, doubt)


def _ends_alike(filled: Collection[str]) -> bool:
    """Return whether texts begin like numbers and go on like units, by a few of them: most columns do not."""
    return all(cell[0] in "+-0123456789" and not cell[-1].isdigit() for cell in list(filled)[:5])


def _readings(numbers: Collection[str], has_decimal_commas: bool) -> list[tuple[str, dict[str, str]]]:
    """Return the ways in which all numbers can be read, the likeliest first: in words, and written plainly."""
    if all(number_of(number) is not None for number in numbers):
        if not has_decimal_commas or not any("." in number for number in numbers):
            return [("", {number: number for number in numbers})] if numbers else []
        found = [_read(numbers, *_STYLES[2]), ("", {number: number for number in numbers})]
    else:
        found = [_read(numbers, *style) for style in _STYLES]
    different: list[tuple[str, dict[str, str]]] = []
    for each in found:
        if each is not None and all(_differ(each[1], other[1]) for other in different):
            different.append(each)
    return different


def _read(numbers: Collection[str], group: str, decimal: str, words: str) -> tuple[str, dict[str, str]] | None:
    whole = rf"\d{{1,3}}(?:{re.escape(group) if len(group) == 1 else group}\d{{3}})+|\d+" if group else r"\d+"
    sign = decimal if decimal.startswith("[") else re.escape(decimal)
    pattern = re.compile(rf"([+-]?(?:{whole}))(?:{sign}(\d+))?([eE][+-]?\d+)?")
    plain = {}
    for number in numbers:
        found = pattern.fullmatch(number)
        if found is None:
            return None
        digits = re.sub(r"[^\d+-]", "", found[1])
        plain[number] = f"{digits}{'.' if found[2] else ''}{found[2] or ''}{found[3] or ''}"
    return words, plain


def _differ(first: dict[str, str], second: dict[str, str]) -> bool:
    return any(number_of(first[number]) != number_of(second[number]) for number in first)
