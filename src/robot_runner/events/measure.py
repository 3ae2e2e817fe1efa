"""Measures: what a run yields, as declared by a plugin or a config and as published in a run."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from numbers import Integral, Real

from robot_runner.errors import MeasureError

__all__ = ["Measure", "MeasureValue", "Origin", "PublishedMeasure", "as_measure_value"]

#: What a cell of the run table can hold. None is a missing value: an empty cell.
MeasureValue = int | float | bool | str | None

#: A larger number is a slip, and no table reader could take it.
_MOST_BITS = 1024


class Origin(Enum):
    """Where a value comes from, so that no simulated or estimated value passes for a measured one."""

    MEASURED = "measured"
    SIMULATED = "simulated"
    ESTIMATED = "estimated"


@dataclass(frozen=True, slots=True)
class Measure:
    """One named value that each run yields (a dependent variable).

    Attributes:
        name: the column of the run table, such as `Energy`.
        unit: SI symbol, `%` for percentages (0..100), `1` for counts and ratios, empty where there is none.
        description: one sentence: what it is and how it is aggregated from the raw samples.

    Example:
        >>> Measure("Energy", "J", "Energy drawn from the battery over the measured window.")
        Measure(name='Energy', unit='J', description='Energy drawn from the battery over the measured window.')
    """

    name: str
    unit: str = ""
    description: str = ""


@dataclass(frozen=True, slots=True)
class PublishedMeasure:
    """A measure's value in one run, with who published it and where it comes from."""

    name: str
    value: MeasureValue
    owner: str
    unit: str = ""
    origin: Origin = Origin.MEASURED


def as_measure_value(name: str, value: object, *, where: str) -> MeasureValue:
    """Return `value` as one of the plain types that a run table holds.

    Numbers of other libraries (numpy's scalars among them) become int or float.

    Raises:
        MeasureError: it is not a number, a bool, a string or None, or it is not finite.
    """
    if value is None or isinstance(value, bool):
        return value
    if isinstance(value, str):
        return _writable(name, value, where)
    item = getattr(value, "item", None)  # a numpy scalar, without importing numpy
    plain = item() if callable(item) and getattr(value, "shape", None) == () else value
    if isinstance(plain, bool):
        return plain
    if isinstance(plain, str):
        return _writable(name, plain, where)
    if isinstance(plain, Integral):
        return _bounded(name, int(plain), where)
    if isinstance(plain, Real):
        return _finite(name, float(plain), where)
    raise MeasureError(
        f"measure {name!r} got {value!r}, which is of type {type(value).__name__}",
        where=where,
        fix="Give a number, a bool, a string, or None for a missing value.",
    )


def _finite(name: str, number: float, where: str) -> float:
    if math.isfinite(number):
        return number
    raise MeasureError(
        f"measure {name!r} got {number}, which is not a finite number",
        where=where,
        fix="Give None where there is no value.",
    )


def _writable(name: str, text: str, where: str) -> str:
    try:
        text.encode()
    except UnicodeEncodeError as error:
        odd = text[error.start : error.end]
        problem = f"measure {name!r} got text that holds {odd!r}, which UTF-8 cannot hold"
        raise MeasureError(problem, where=where, fix="Leave it out.") from error
    return text


def _bounded(name: str, number: int, where: str) -> int:
    if number.bit_length() <= _MOST_BITS:
        return number
    problem = f"measure {name!r} got a whole number of {number.bit_length()} bits"
    raise MeasureError(problem, where=where, fix=f"Give one of {_MOST_BITS} bits at most, or a float.")
