"""Samples over the time of a mission, thinned out to what a figure can show, one run or the mean of several."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

__all__ = ["Course", "bin_width", "course_of_run", "mean_course"]

_NICE = (1.0, 2.0, 2.5, 5.0, 10.0)
_FEWEST_FOR_A_BAND = 2


@dataclass(frozen=True, slots=True)
class Course:
    """A measure over the time of a mission, in bins of equal width; NaN where there is no sample.

    Attributes:
        label: whose it is: a run's id or a treatment.
        time: the middle of each bin, s since the start of measurement.
        middle: the mean in each bin.
        low, high: of one run the least and the greatest sample in the bin; of several runs their mean less and
            plus one standard deviation between runs, and NaN where there are fewer than two.
        runs: how many runs it comes from.
    """

    label: str
    time: NDArray[np.float64]
    middle: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    runs: int


def bin_width(duration: float, period: float, *, most: int = 500) -> float:
    """Return a round width of bins in s, so that there are at most so many, each with a sample.

    Args:
        duration: s that are to be covered.
        period: s from one sample to the next.
        most: how many bins there may be.

    Example:
        >>> bin_width(95.0, 0.005)
        0.2
    """
    least = max(duration / most, period, 1e-9)
    power = 10.0 ** math.floor(math.log10(least))
    return next(power * nice for nice in _NICE if power * nice >= least * (1 - 1e-9))


def course_of_run(label: str, time: NDArray[np.float64], values: NDArray[np.float64], width: float) -> Course:
    """Return the course of one run.

    Args:
        label: the run's id.
        time: s since the start of measurement, ascending.
        values: as many as times; NaN where there is no value.
        width: of a bin, s.
    """
    there = np.isfinite(values) & np.isfinite(time)
    time, values = time[there], values[there]
    if not len(time):
        empty = np.empty(0)
        return Course(label, empty, empty, empty, empty, runs=1)
    places = np.floor(time / width).astype(np.int64)
    first = int(places[0])
    grid = (np.arange(first, int(places[-1]) + 1, dtype=np.float64) + 0.5) * width
    starts = np.flatnonzero(np.diff(places, prepend=first - 1))
    filled = places[starts] - first
    counts = np.diff(starts, append=len(values))
    middle, low, high = (np.full(len(grid), np.nan) for _ in range(3))
    middle[filled] = np.add.reduceat(values, starts) / counts
    low[filled] = np.minimum.reduceat(values, starts)
    high[filled] = np.maximum.reduceat(values, starts)
    return Course(label, grid, middle, low, high, runs=1)


def mean_course(label: str, courses: Sequence[Course], width: float) -> Course:
    """Return the mean of several runs with their spread, from courses with bins of this width."""
    given = [course for course in courses if len(course.time)]
    if not given:
        empty = np.empty(0)
        return Course(label, empty, empty, empty, empty, runs=0)
    firsts = [round(course.time[0] / width - 0.5) for course in given]
    first = min(firsts)
    last = max(place + len(course.time) for place, course in zip(firsts, given, strict=True))
    table = np.full((len(given), last - first), np.nan)
    for row, place, course in zip(table, firsts, given, strict=True):
        row[place - first : place - first + len(course.time)] = course.middle
    counts = np.count_nonzero(np.isfinite(table), axis=0)
    middle: NDArray[np.float64] = np.where(counts > 0, np.nansum(table, axis=0) / np.maximum(counts, 1), np.nan)
    squares = np.nansum((table - middle) ** 2, axis=0)
    spread: NDArray[np.float64] = np.sqrt(squares / np.maximum(counts - 1, 1))
    spread[counts < _FEWEST_FOR_A_BAND] = np.nan
    grid = (np.arange(first, last, dtype=np.float64) + 0.5) * width
    return Course(label, grid, middle, middle - spread, middle + spread, runs=len(given))
