"""Build tables from fields: each has the heading of a column and makes a cell from an item."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from operator import attrgetter
from typing import TYPE_CHECKING, Any

from robot_runner.analysis.report.blocks import Cell, Column, Place, Table, Tone
from robot_runner.analysis.wording import shown_coefficient, shown_interval, shown_number, shown_p

if TYPE_CHECKING:
    #: Reads a value of an item: a function, or the name of an attribute.
    Read = Callable[[Any], Any] | str
    #: How many significant digits numbers have: all of a column, or those of an item.
    Digits = int | Callable[[Any], int]


@dataclass(frozen=True, slots=True)
class Field:
    """A column of a table to build; `cell` makes the cell of an item."""

    column: Column
    cell: Callable[[Any], Cell]


def build_table(
    name: str, caption: str, items: Iterable[Any], fields: Iterable[Field | tuple[Field, ...]], note: str = ""
) -> Table:
    """Return a table with a row for each item, of any type that the fields can read; an interval has several fields.

    Example:
        >>> table = build_table("t", "Lengths.", ["a", "bcd"], [text("Word", str), number("Letters", len)])
        >>> [[cell.text for cell in row] for row in table.rows]
        [['a', '1'], ['bcd', '3']]
    """
    flat = [each for one in fields for each in (one if isinstance(one, tuple) else (one,))]
    rows = tuple(tuple(each.cell(item) for each in flat) for item in items)
    return Table(name, caption, tuple(each.column for each in flat), rows, note)


def field(name: str, cell: Callable[[Any], Cell], *, is_number: bool = False, place: Place = Place.EVERYWHERE) -> Field:
    """Return a column whose cells are made by a function."""
    return Field(Column(name, is_number=is_number, place=place), cell)


def text(name: str, read: Read, tone: Callable[[Any], Tone] = lambda _: Tone.PLAIN) -> Field:
    """Return a column of texts, highlighted by `tone`."""
    of = _reader(read)
    return Field(Column(name), lambda item: Cell.of_text(of(item), tone(item)))


def number(name: str, read: Read, digits: Digits = 4, *, place: Place = Place.EVERYWHERE, warns: bool = False) -> Field:
    """Return a column of numbers with so many significant digits; if it warns, numbers above 0 are highlighted."""
    of = _reader(read)

    def cell(item: Any) -> Cell:
        value = of(item)
        return number_cell(value, _digits_of(item, digits), Tone.WARNING if warns and value else Tone.PLAIN)

    return field(name, cell, is_number=True, place=place)


def coefficient(name: str, read: Read) -> Field:
    """Return a column of correlations, effect sizes or statistics."""
    of = _reader(read)
    return Field(Column(name, is_number=True), lambda item: Cell(of(item), shown_coefficient(of(item))))


def number_cell(value: float | None, digits: int = 4, tone: Tone = Tone.PLAIN) -> Cell:
    """Return a cell with a number."""
    return Cell(value, shown_number(value, digits), tone)


def p_value(name: str, read: Read, is_significant: Read = lambda _: False) -> Field:
    """Return a column of p-values; significant ones are highlighted."""
    of, stands_out = _reader(read), _reader(is_significant)
    return Field(
        Column(name, is_number=True),
        lambda item: Cell(of(item), shown_p(of(item)), Tone.GOOD if stands_out(item) else Tone.PLAIN),
    )


def interval(
    name: str, read: Read, shown: Callable[[float | None], str] | None = None, *, digits: Digits = 4
) -> tuple[Field, ...]:
    """Return the columns of a confidence interval: one for readers, and its ends for programs."""
    of = _reader(read)

    def end(which: str) -> Callable[[Any], float | None]:
        return lambda item: None if (found := of(item)) is None else getattr(found, which)

    ends = (number(f"{name}, {which}", end(which), place=Place.FILE) for which in ("low", "high"))

    def cell(item: Any) -> Cell:
        return Cell.of_text(shown_interval(of(item), shown or partial(shown_number, digits=_digits_of(item, digits))))

    return (field(name, cell, is_number=True, place=Place.PAGE), *ends)


def _digits_of(item: Any, digits: Digits) -> int:
    return digits(item) if callable(digits) else digits


def _reader(read: Read) -> Callable[[Any], Any]:
    return attrgetter(read) if isinstance(read, str) else read
