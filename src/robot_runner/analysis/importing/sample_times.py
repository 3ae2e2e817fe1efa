"""Times in the formats of other tools (since some start, timestamps, dates, times of day), and anomalies of traces."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import pyarrow as pa

from robot_runner.analysis.importing.units import TIME_UNITS, Unit, split_heading
from robot_runner.core.errors import AnalysisError, did_you_mean
from robot_runner.core.storage.cells import number_of
from robot_runner.core.words import counted, enumerated

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from robot_runner.analysis.importing.foreign_runs import ForeignRun

_HEADINGS = ("timestamp", "time", "datetime", "date_time", "date", "t", "elapsed", "elapsed_time", "seconds", "clock")

#: From these sizes on, numbers are seconds (or fractions of a second) since 1970.
_EPOCHS = {"ns": 1e17, "us": 1e14, "ms": 1e11, "s": 1e8}
_NANOSECONDS = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1, "min": 60 * 10**9, "h": 3600 * 10**9}
_DAY = 24 * _NANOSECONDS["h"]
_LATEST = 2**63  # ns since 1970 that fit into 64 bits, until 2262: a heading with a later time is wrong
_CLOCK = re.compile(r"\d{1,2}:\d\d:\d\d(\.\d+)?")
#: The directives of a format that tell the time of day, and the ones of these that tell the hour.
_DIRECTIVE, _OF_DAY, _OF_HOUR = re.compile(r"%[-#]?(.)"), frozenset("HIpMSfzZTRXr%"), frozenset("HITRXr")
#: No meter of a run samples so rarely, s: such times are rather milli- or microseconds, as PX4's since it started.
_LONGEST_STEP = 1000
_LOOKED_AT = 20  # texts of a column that are examined to recognise its format


class TimeKind(Enum):
    """The zero of times: a start that the tool chose, 1970 (also for dates), or midnight."""

    COUNTED = "counted"
    MOMENT = "moment"
    CLOCK = "clock"


def time_column(table: pa.Table, headings: Sequence[str], given: str | None, where: str) -> str:
    """Return the heading of the times: the given one, otherwise by its name, otherwise the first if it has timestamps.

    Raises:
        AnalysisError: there is no such column.
    """
    if given:
        if given in headings:
            return given
        fix = did_you_mean(given, headings)
        raise AnalysisError(f"there is no column {given!r} for the time", where=where, fix=fix)
    plain = {re.sub(r"[\s-]", "_", split_heading(name)[0].casefold()).strip("_"): name for name in reversed(headings)}
    named = next((plain[name] for name in _HEADINGS if name in plain), None)
    if named is None and pa.types.is_timestamp(table.column(0).type):
        named = headings[0]
    if not named:
        fix = "Name the column: --samples FILE:COLUMN."
        raise AnalysisError("no column is recognised as the time", where=where, fix=fix)
    return named


def time_unit(heading: str, column: pa.ChunkedArray, where: str) -> str:
    """Guess the unit of times, `iso` or `clock`, from the heading and the values.

    Raises:
        AnalysisError: the values do not look like times, or not like those of any one unit.
    """
    if pa.types.is_timestamp(column.type):
        return "iso"
    values = column.drop_null()
    if pa.types.is_time(column.type) or _are_clocks(values):
        return "clock"
    if is_number(column.type) and len(values):
        first = values[0].as_py()
        named = split_heading(heading)[1]
        if named and named.symbol in TIME_UNITS and first * _NANOSECONDS[named.symbol] < _LATEST:
            return named.symbol
        unit = next((unit for unit, least in _EPOCHS.items() if first >= least), "s")
        step = float(np.median(np.diff(values[:_LOOKED_AT].to_numpy()))) if len(values) > 1 else 0.0
        if unit == "s" and step >= _LONGEST_STEP:
            option = f"--samples {shlex.quote(f'{where}:{heading}:us')}"
            problem = f"the times in {heading} are {step:,.0f} apart, so not in s: if in us, {option}"
            raise AnalysisError(problem, where=where, fix=f"Say their unit: {option}, or ms.")
        return unit
    parsed = pd.to_datetime(_texts(values), errors="coerce", format="ISO8601")
    if not len(parsed) or parsed.isna().any():
        raise AnalysisError(f"the times in {heading} cannot be read", where=where, fix="Give time_unit.")
    return "iso"


def _are_clocks(values: pa.ChunkedArray) -> bool:
    texts = _texts(values)
    return bool(len(texts)) and texts.str.strip().str.fullmatch(_CLOCK).all()


def _texts(values: pa.ChunkedArray) -> pd.Series:
    return pd.Series(values[:_LOOKED_AT].to_pylist(), dtype="str")


def unit_words(unit: str, column: pa.ChunkedArray) -> str:
    """Return a unit of times in words, with the assumption for timestamps without a time zone."""
    words = {"iso": "dates and times of day", "clock": "times of day"}.get(unit, unit)
    return f"{words}, taken as UTC" if pa.types.is_timestamp(column.type) and column.type.tz is None else words


def time_kind(unit: str, column: pa.ChunkedArray) -> TimeKind:
    """Return the zero of the times of a column."""
    if unit not in TIME_UNITS:
        return TimeKind.CLOCK if unit == "clock" or _is_of_day(unit) else TimeKind.MOMENT
    first = next(iter(column.drop_null()[:1].to_pylist()), 0) if is_number(column.type) else 0
    return TimeKind.MOMENT if first * _NANOSECONDS[unit] >= _EPOCHS["ns"] else TimeKind.COUNTED


def _is_of_day(unit: str) -> bool:
    """Return whether a format has no date: its times would be moments of the year 1900."""
    return "%" in unit and _OF_DAY.issuperset(_DIRECTIVE.findall(unit))


def nanoseconds_since_1970(number: float) -> int | None:
    """Return a timestamp since 1970 in s, ms, us or ns, told by its size, as ns; None where it is too small."""
    unit = next((unit for unit, least in _EPOCHS.items() if number >= least), None)
    return None if unit is None else round(number * _NANOSECONDS[unit])


def is_number(kind: pa.DataType) -> bool:
    """Return whether a column of this type holds numbers."""
    return bool(pa.types.is_integer(kind) or pa.types.is_floating(kind))


def nanoseconds_of(column: pa.ChunkedArray, unit: str, where: str) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return times as whole nanoseconds, to avoid rounding, and which of them are valid.

    Times of day continue past midnight.

    Raises:
        AnalysisError: the column does not hold times in this unit.
    """
    if unit in TIME_UNITS:
        if not is_number(column.type):
            raise AnalysisError(f"the times are not numbers of {unit}", where=where, fix="Give another time_unit.")
        values = column.to_numpy()
        valid = np.isfinite(values)
        return (np.where(valid, values, 0) * _NANOSECONDS[unit]).round().astype(np.int64), valid
    texts = pd.Series(column.to_pandas())
    if unit == "clock":
        spans = pd.to_timedelta(texts.astype("str"), errors="coerce").to_numpy("timedelta64[ns]")
        return _past_midnight(spans.astype(np.int64), ~np.isnat(spans), _DAY)
    try:
        moments = pd.to_datetime(texts, utc=True, format="ISO8601" if unit == "iso" else unit)
    except ValueError as error:
        fix = "Give another time_unit, or correct the file."
        problem = f"the times cannot be read: {str(error).partition(chr(10))[0]}"
        raise AnalysisError(problem, where=where, fix=fix) from error
    stamps = moments.dt.tz_localize(None).to_numpy("datetime64[ns]")
    times, valid = stamps.astype(np.int64), ~np.isnat(stamps)
    if not _is_of_day(unit):
        return times, valid
    return _past_midnight(times, valid, _NANOSECONDS["h"] if _OF_HOUR.isdisjoint(_DIRECTIVE.findall(unit)) else _DAY)


def _past_midnight(
    times: NDArray[np.int64], valid: NDArray[np.bool_], period: int
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return times that begin anew after a period, such as those of a day, as times that go on."""
    known = times[valid]  # a missing value is smaller than all times: the next one would count as another day
    times[valid] = known + period * np.cumsum(np.diff(known, prepend=known[:1]) < -period // 2)
    return times, valid


_DURATION = re.compile(r"duration|mission|run_?time|exec(ution)?_?time|elapsed|wall", re.IGNORECASE)
_OF_PARTS = re.compile(r"avg|mean|median|max|min|std|sd|delay|latency|cpu", re.IGNORECASE)
_BEGIN = re.compile(r"(^|[_ ])(start|started|begin|begun)($|[_ ])", re.IGNORECASE)
_END = re.compile(r"(^|[_ ])(stop|stopped|end|ended|finish|finished)($|[_ ])", re.IGNORECASE)

#: A meter starts a little before the mission and stops a little after it: 5 % and a second are normal.
_TOLERATED_SHARE, _TOLERATED_S = 0.05, 1.0
_CUT_OFF = "ends before the run does: cut off?"
_BRIDGED = "its change bridges that step, and is missing where the step is long"
#: As few samples to a time may be chance; where so many times are known, one more or less is half a percent.
_SAMPLES_TO_A_TIME, _MOST_MOMENTS = 3, 200


@dataclass(frozen=True, slots=True)
class TraceSpan:
    """The extent of the samples in one file of one run.

    Attributes:
        file: the kind of file.
        first, last: the times of the first and last sample in ns, since 1970 for timestamps; 0 without samples.
        is_moment: whether they count from 1970.
        count: the number of samples.
        was_sorted: whether the file was in the order of its times, and lacked none.
        left_out: the number of rows with more or fewer cells than the heading, such as in a file that was cut off.
        without_number: the number of cells that are not numbers, in columns that are numeric in the first run.
        moments: the number of different times.
        restarted: the counters, in joules, that wrapped around or were reset between two samples.
        impossible: the number of powers that are missing here, as they come of a counter that wrapped around.
    """

    file: str
    first: int
    last: int
    is_moment: bool
    count: int
    was_sorted: bool
    left_out: int
    without_number: int
    moments: int
    restarted: tuple[str, ...]
    impossible: int

    @property
    def seconds(self) -> float:
        """The time from the first sample to the last."""
        return (self.last - self.first) / 1e9

    @property
    def is_coarse(self) -> bool:
        """Whether several samples have the same time each, and times are far apart, such as whole seconds."""
        return 1 < self.moments <= min(self.count / _SAMPLES_TO_A_TIME, _MOST_MOMENTS)


def trace_warnings(
    runs: Sequence[ForeignRun], spans: Mapping[str, Sequence[TraceSpan]], units: Mapping[str, Unit | None]
) -> list[str]:
    """Return the anomalies of the traces in words."""
    of_file: dict[str, list[tuple[ForeignRun, TraceSpan]]] = {}
    for run in runs:
        for span in spans.get(run.run_id, ()):
            of_file.setdefault(span.file, []).append((run, span))
    return [
        warning
        for file, found in of_file.items()
        for warning in (*_odd_samples(file, found), *_odd_extents(file, found, units))
    ]


def _odd_samples(file: str, found: Sequence[tuple[ForeignRun, TraceSpan]]) -> Iterator[str]:
    if empty := [run.run_id for run, span in found if not span.count]:
        yield f"{file} has no samples in {_of(empty, found)}"
    if cut := [run.run_id for run, span in found if span.left_out]:
        rows = sum(span.left_out for _, span in found)
        words = f"{counted(rows, 'row')} left out of {file}, cut off or with other cells than its heading"
        yield f"{words}, in {_of(cut, found)}"
    if odd := [run.run_id for run, span in found if span.without_number]:
        cells = sum(span.without_number for _, span in found)
        verbs = "holds no number and is" if cells == 1 else "hold no number and are"
        yield f"{counted(cells, 'cell')} of {file} {verbs} missing here, in {_of(odd, found)}"
    if wrapped := [run.run_id for run, span in found if span.impossible]:
        powers = counted(sum(span.impossible for _, span in found), "power")
        verb = "is" if powers.startswith("1 ") else "are"
        words = f"{powers} of {file} {verb} far below 0, as where a counter wraps around"
        yield f"{words}, and {verb} missing here, in {_of(wrapped, found)}"
    for counter in dict.fromkeys(name for _, span in found for name in span.restarted):
        runs = _of([run.run_id for run, span in found if counter in span.restarted], found)
        yield f"{counter} of {file} starts again from a low count in {runs}: {_BRIDGED}"
    if coarse := [(run.run_id, span) for run, span in found if span.is_coarse]:
        (_, span), runs = coarse[0], _of([name for name, _ in coarse], found)
        words = f"{file} has {span.count / span.moments:.0f} samples to each time"
        apart = f"times {span.seconds / (span.moments - 1):.3g} s apart"
        yield f"{words}, and {apart}, in {runs}: durations and integrals are not known better than that"


def _odd_extents(
    file: str, found: Sequence[tuple[ForeignRun, TraceSpan]], units: Mapping[str, Unit | None]
) -> Iterator[str]:
    excesses = [(run.run_id, _excess(run, span, units)) for run, span in found if span.count > 1]
    for place, words in enumerate(("begins before the run", "outlasts the run", _CUT_OFF)):
        odd = {run_id: excess[place] for run_id, excess in excesses if excess[place] > _TOLERATED_S}
        # A log of events ends with the last event, and so before the end of most runs.
        if odd and (words != _CUT_OFF or 2 * len(odd) < len(found)):
            most, which = max((seconds, run_id) for run_id, seconds in odd.items())
            yield f"{file} {words} in {_of([*odd], found)}, by up to {most:.3g} s ({which})"


def _of(names: Sequence[str], found: Sequence[object]) -> str:
    shown = enumerated([*names[:3], *([f"{len(names) - 3} more"] if len(names) > 3 else [])])  # noqa: PLR2004 - as shown
    return f"{len(names)} of {counted(len(found), 'run')} ({shown})"


def _excess(run: ForeignRun, span: TraceSpan, units: Mapping[str, Unit | None]) -> tuple[float, float, float]:
    """Return the seconds of a trace before the run begins and after it ends, and the missing ones at its end."""
    begin, end = _moment(run, _BEGIN), _moment(run, _END)
    if span.is_moment and (begin is not None or end is not None):
        before = (begin - span.first) / 1e9 if begin is not None else 0.0
        after = (span.last - end) / 1e9 if end is not None else 0.0
        return before, after, -after
    duration = _duration(run, units)
    if duration is None:
        return 0.0, 0.0, 0.0
    tolerated = duration * _TOLERATED_SHARE
    return 0.0, span.seconds - duration - tolerated, duration - span.seconds - tolerated


def _moment(run: ForeignRun, name: re.Pattern[str]) -> int | None:
    """Return the timestamp in a text column of this name, ns since 1970."""
    for heading, text in run.extras.items():
        if name.search(heading) and text:
            number = number_of(text)
            if number is not None:
                return nanoseconds_since_1970(number)
            moment = pd.to_datetime(text, utc=True, errors="coerce", format="ISO8601")
            if not pd.isna(moment):
                return int(moment.value)
    return None


def _duration(run: ForeignRun, units: Mapping[str, Unit | None]) -> float | None:
    """Return the duration of the run according to the table, s."""
    for name, unit in units.items():
        value = run.measures.get(name)
        is_duration = unit is not None and unit.si == "s" and _DURATION.search(name) and not _OF_PARTS.search(name)
        if is_duration and unit is not None and isinstance(value, int | float) and not isinstance(value, bool):
            return float(unit.to_si(value))
    return None
