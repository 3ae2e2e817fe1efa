"""From the output of a command-line meter to rows, their times, and one value for each measure."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from itertools import accumulate, groupby, pairwise
from numbers import Real

from robot_runner.core.errors import PluginError
from robot_runner.core.events.measure import Measure, Over
from robot_runner.core.events.window import Window
from robot_runner.core.words import shown_duration
from robot_runner.measuring.device_clock import fit_clock
from robot_runner.measuring.parameter_checks import check_kind, check_numbers
from robot_runner.measuring.series import Series, cut, growth, mean_of_intervals

#: The cells of one row by the name of their column, as text or as numbers.
Row = Mapping[str, str | float | None]
#: Converts the records of the output to a row each; None for a record that is not a row, such as a heading.
Parse = Callable[[Sequence[str]], Sequence[Row | None]]


#: Rows are of one moment if no more than this share of the mean time between rows is between them.
_AT_ONCE = 0.1
#: Stamps in whole units from this on, s, may be far from the time at which their rows were taken.
_COARSE = 0.1
#: By how much a stamp may be late for having been rounded, and for how long a program may keep a row back, s.
_ROUNDED, _LONGEST_DELAY = 0.1, 60.0
#: How often a repeated row usually comes.
_TWICE = 2


class Aggregate(Enum):
    """How the rows of a column become the value of a measure.

    For MEAN, INTEGRAL and SUM each row covers the time since the row before; if the window begins or ends between two
    rows, that row counts by its share. Before the first and after the last row the mean is assumed.
    """

    MEAN = "mean over the measured window"
    INTEGRAL = "integral over the measured window"
    SUM = "sum over the measured window"
    INCREASE = "increase of a counter over the measured window"
    RATE = "increase of a counter over the measured window, divided by its duration"
    MINIMUM = "smallest row in the measured window"
    MAXIMUM = "largest row in the measured window"
    LAST = "last row in the measured window"

    @property
    def over(self) -> Over | None:
        """How the values of several windows are combined into one."""
        return _OVER.get(self)


_OVER: Mapping[Aggregate, Over] = {
    Aggregate.MEAN: Over.MEAN,
    Aggregate.INTEGRAL: Over.SUM,
    Aggregate.SUM: Over.SUM,
    Aggregate.INCREASE: Over.SUM,
    Aggregate.RATE: Over.MEAN,
    Aggregate.MINIMUM: Over.MINIMUM,
    Aggregate.MAXIMUM: Over.MAXIMUM,
}


class TimeKind(Enum):
    """The content of a column of times."""

    UTC = "seconds since 1970"
    SPAN = "seconds since the row before"
    SINCE_START = "seconds since the program was started"


@dataclass(frozen=True, slots=True)
class TimeColumn:
    """The column with the time of a row.

    Attributes:
        source: its heading.
        kind: its content.
        unit: of its numbers, s; 0.001 for milliseconds.

    Raises:
        PluginError: the unit is not a number above 0, or another attribute is of another type.

    Example:
        >>> from robot_runner.plugins.profilers import TimeKind
        >>> TimeColumn("Time", TimeKind.UTC, unit=0.001).unit
        0.001
    """

    source: str
    kind: TimeKind = TimeKind.UTC
    unit: float = 1.0

    def __post_init__(self) -> None:
        where = f"the time column {self.source!r}"
        check_kind(where, str, source=self.source)
        check_kind(where, TimeKind, kind=self.kind)
        check_numbers(where, unit=self.unit)


@dataclass(frozen=True, slots=True)
class CommandColumn:
    """A column of the output, and the measure that is computed from it.

    Attributes:
        source: its heading.
        measure: that it yields.
        aggregate: how its rows are reduced to one value.
        factor: each cell is multiplied by it, to get the unit of the measure.

    Raises:
        PluginError: an attribute is of another type.

    Example:
        >>> from robot_runner.plugins.profilers import Aggregate
        >>> from robot_runner.plugins import Measure
        >>> energy = Measure("Energy", "J", "Integral of power over the measured window.")
        >>> CommandColumn("power_mW", energy, Aggregate.INTEGRAL, factor=0.001).source
        'power_mW'
    """

    source: str
    measure: Measure
    aggregate: Aggregate = Aggregate.MEAN
    factor: float = 1.0

    def __post_init__(self) -> None:
        where = f"the column {self.source!r}"
        check_kind(where, str, source=self.source)
        check_kind(where, Measure, measure=self.measure)
        check_kind(where, Aggregate, aggregate=self.aggregate)
        check_kind(where, Real, factor=self.factor)

    @property
    def yields(self) -> Measure:
        """The measure; its description says how it is computed from the rows."""
        times = "" if self.factor == 1.0 else f", times {self.factor:g}"
        how = f"Column {self.source!r}: {self.aggregate.value}{times}."
        over = self.measure.over or self.aggregate.over
        return replace(self.measure, over=over, description=f"{self.measure.description} {how}".lstrip())

    def values(self, rows: Sequence[Row]) -> list[float | None]:
        """Return the number of each row in the unit of the measure; None where the cell holds no number."""
        numbers = (_number(row.get(self.source)) for row in rows)
        return [None if number is None else number * self.factor for number in numbers]

    def value(self, times: Sequence[float], rows: Sequence[Row], window: Window) -> float | None:
        """Return the value of the measure; None where no rows cover the window.

        Args:
            times: when each row was taken, s on the run's clock.
            rows: the rows.
            window: the measured one.
        """
        told = [
            (time, math.nan if value is None else value)
            for time, row, value in zip(times, rows, self.values(rows), strict=True)
            if self.source in row
        ]
        known = [(time, value) for time, value in told if not math.isnan(value)]
        if self.aggregate in _PICK:
            within = [value for time, value in known if window.start <= time <= window.end]
            return _PICK[self.aggregate](within) if within else None
        # A count is the one since the row before, also if that row has no number: it never covers the time of both.
        pairs = told if self.aggregate is Aggregate.SUM else known
        value = _MEASURE[self.aggregate](Series([time for time, _ in pairs], [value for _, value in pairs]), window)
        if self.aggregate is Aggregate.RATE and value is not None:
            return value / window.duration if window.duration else None
        return value


_PICK: Mapping[Aggregate, Callable[[list[float]], float]] = {
    Aggregate.MINIMUM: min,
    Aggregate.MAXIMUM: max,
    Aggregate.LAST: lambda values: values[-1],
}


def _integral(series: Series, window: Window) -> float | None:
    mean = mean_of_intervals(series, window)
    return None if mean is None else mean * window.duration


def _sum(series: Series, window: Window) -> float | None:
    total = seen = 0.0
    for (sooner, later), value in zip(pairwise(series.times), series.values[1:], strict=False):
        if math.isnan(value):
            continue
        if later > sooner:
            inside = max(0.0, min(later, window.end) - max(sooner, window.start))
            total += value * inside / (later - sooner)
            seen += inside
        elif window.start < later <= window.end:  # a further row of the same moment
            total += value
    return total * window.duration / seen if seen else None


def _increase(series: Series, window: Window) -> float | None:
    """Return by how much a counter grew; None where it fell, since its increase in between is unknown."""
    counter = cut(series, window).values
    falls = any(later < sooner for sooner, later in pairwise(counter))
    return None if falls else growth(series, window)


_MEASURE: Mapping[Aggregate, Callable[[Series, Window], float | None]] = {
    Aggregate.MEAN: mean_of_intervals,
    Aggregate.INTEGRAL: _integral,
    Aggregate.SUM: _sum,
    Aggregate.INCREASE: _increase,
    Aggregate.RATE: _increase,
}


def _number(cell: str | float | None) -> float | None:
    try:
        number = float(cell) if cell is not None else math.nan
    except ValueError:
        return None
    return number if math.isfinite(number) else None


def repeated_rows(times: Sequence[float], rows: Sequence[Row]) -> int:
    """Return how many rows equal the row before, within a tenth of the mean time between rows.

    The count is 0 where stamps are coarser than the rows, as for events in whole seconds: there a varying number of
    rows, also more than two, shares a stamp.

    Example:
        >>> repeated_rows([0.0, 0.0, 1.0, 2.0], [{"count": "3"}] * 4)
        1
    """
    shared = [len(list(same)) for _, same in groupby(times)]
    if len(times) > _TWICE * len(shared) and len(set(shared[1:-1])) > 1:
        return 0
    apart = (times[-1] - times[0]) / len(times) if times else 0.0
    pairs = zip(pairwise(times), pairwise(rows), strict=True)
    return sum(left == right and later - sooner <= _AT_ONCE * apart for (sooner, later), (left, right) in pairs)


def misplaced_rows(times: Sequence[float], received: Sequence[float], tolerance: float) -> Iterator[str]:
    """Yield a doubt where a row was stamped after it arrived, or each one more than a minute before.

    Args:
        times: when the rows were taken by their stamps, s on the run's clock.
        received: when they arrived.
        tolerance: by how much a stamp may be late, s, beside its rounding.

    Example:
        >>> list(misplaced_rows([2.0, 3.0], [1.0, 1.5], tolerance=0.1))
        ['rows are stamped 1.5 s after they arrived: by another clock, time zone or unit']
    """
    most = max((time - arrival for time, arrival in zip(times, received, strict=True)), default=0.0)
    if most > max(tolerance, _ROUNDED) or most < -_LONGEST_DELAY:
        how = f"{shown_duration(abs(most))} {'after' if most > 0 else 'before'}"
        yield f"rows are stamped {how} they arrived: by another clock, time zone or unit"


def parse_csv(records: Sequence[str], *, delimiter: str = ",", comment: str = "#") -> list[Row | None]:
    """Return one row for each line of CSV; the first line that is not empty is the heading.

    A line with another number of cells than the heading (torn, or a message of the program) is not a row.

    Example:
        >>> parse_csv(["watts,volts", "7.5,12.1", "bye"])
        [None, {'watts': '7.5', 'volts': '12.1'}, None]
    """
    heading: list[str] | None = None
    rows: list[Row | None] = []
    for record in records:
        is_silent = not record.strip() or record.startswith(comment)
        cells = [] if is_silent else _cells(record, delimiter)
        is_row = heading is not None and len(cells) == len(heading) and cells != heading
        rows.append(dict(zip(heading, cells, strict=True)) if is_row and heading else None)
        if heading is None and cells:
            heading = cells
    return rows


def csv_cell(text: str) -> str:
    """Return a text in a form that is valid in a line of CSV."""
    return '"' + text.replace('"', '""') + '"' if set(text) & set(',"\n') else text


def _cells(record: str, delimiter: str) -> list[str]:
    try:
        return [cell.strip() for cell in next(csv.reader([record], delimiter=delimiter))]
    except csv.Error:  # a carriage return within the line, as a progress bar has them
        return []


def row_times(
    rows: Sequence[Row], received: Sequence[float], column: TimeColumn | None, *, utc_offset: float
) -> list[float]:
    """Return the time of each row, s on the run's clock, never decreasing.

    Times by the program's own clock are converted to the run's clock by the row that came with the least delay. Stamps
    of UTC in whole seconds are refined by the arrivals.

    Args:
        rows: the rows.
        received: when they arrived, s on the run's clock.
        column: with the times; None takes the times of arrival.
        utc_offset: the run's clock less UTC, s.

    Raises:
        PluginError: the column is missing, or holds no number.
    """
    if column is None:
        return list(received)
    stamps = list(_stamps(rows, column))
    if column.kind is TimeKind.UTC:
        unit = column.unit if all(stamp % column.unit == 0 for stamp in stamps) else 0.0
        pairs = zip(stamps, received, strict=True)
        times = [_refined(stamp + utc_offset, at, unit) for stamp, at in pairs]
    else:
        passed = list(accumulate(stamps)) if column.kind is TimeKind.SPAN else stamps
        times = list(map(fit_clock(passed, received).to_run, passed)) if passed else []
    return list(accumulate(times, max))


def _refined(stamp: float, arrival: float, unit: float) -> float:
    """Return when a row was taken: a stamp in whole units, such as seconds, is less precise than the row's arrival.

    A row that arrived too late, or with the stamp of another clock, was taken in the middle of the unit.
    """
    if unit < _COARSE:
        return stamp
    return arrival if stamp - unit < arrival < stamp + unit else stamp + unit / 2


def _stamps(rows: Sequence[Row], column: TimeColumn) -> Iterator[float]:
    for row in rows:
        stamp = _number(row.get(column.source))
        if stamp is None:
            problem = f"a row has no time in column {column.source!r}: {dict(row)}"
            raise PluginError(problem, where="output", fix="Name the column that says when a row was taken, or none.")
        yield stamp * column.unit
