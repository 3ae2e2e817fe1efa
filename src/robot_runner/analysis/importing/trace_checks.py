"""What looks wrong with raw traces: they outlast their run or end before it, are empty, or lack rows."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

import pandas as pd

from robot_runner.analysis.importing.sample_times import nanoseconds_since_1970
from robot_runner.core.storage.cells import number_of
from robot_runner.core.words import counted, enumerated

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from robot_runner.analysis.importing.foreign_runs import ForeignRun
    from robot_runner.analysis.importing.units import Unit

__all__ = ["TraceSpan", "trace_warnings"]

_DURATION = re.compile(r"duration|mission|run_?time|exec(ution)?_?time|elapsed|wall", re.IGNORECASE)
_OF_PARTS = re.compile(r"avg|mean|median|max|min|std|sd|delay|latency|cpu", re.IGNORECASE)
_BEGIN = re.compile(r"(^|[_ ])(start|started|begin|begun)($|[_ ])", re.IGNORECASE)
_END = re.compile(r"(^|[_ ])(stop|stopped|end|ended|finish|finished)($|[_ ])", re.IGNORECASE)

#: A meter is started a little before the mission and stopped a little after it: 5 % and a second are no more than that.
_TOLERATED_SHARE, _TOLERATED_S = 0.05, 1.0


@dataclass(frozen=True, slots=True)
class TraceSpan:
    """The samples of one file of one run.

    Attributes:
        file: the kind of file.
        first, last: the times of the first and last sample in ns, since 1970 for moments; 0 without samples.
        is_moment: whether they are counted since 1970.
        count: the number of samples.
        left_out: rows that have another number of cells than the heading, as where a file was cut off.
    """

    file: str
    first: int
    last: int
    is_moment: bool
    count: int
    left_out: int

    @property
    def seconds(self) -> float:
        """The time from the first sample to the last."""
        return (self.last - self.first) / 1e9


def trace_warnings(
    runs: Sequence[ForeignRun], spans: Mapping[str, Sequence[TraceSpan]], units: Mapping[str, Unit | None]
) -> list[str]:
    """Return what looks wrong with the traces, in words.

    Args:
        runs: the runs of the table.
        spans: of each run id, its traces.
        units: the units of the table's measures.
    """
    of_file: dict[str, list[tuple[ForeignRun, TraceSpan]]] = {}
    for run in runs:
        for span in spans.get(run.run_id, ()):
            of_file.setdefault(span.file, []).append((run, span))
    return [warning for file, found in of_file.items() for warning in _of_file(file, found, units)]


def _of_file(
    file: str, found: Sequence[tuple[ForeignRun, TraceSpan]], units: Mapping[str, Unit | None]
) -> Iterator[str]:
    if empty := [run.run_id for run, span in found if not span.count]:
        yield f"{file} has no samples in {_of(empty, found)}"
    if cut := [run.run_id for run, span in found if span.left_out]:
        rows = sum(span.left_out for _, span in found)
        words = f"{counted(rows, 'row')} left out of {file}, cut off or with other cells than its heading"
        yield f"{words}, in {_of(cut, found)}"
    late: list[tuple[float, str]] = []
    early: list[tuple[float, str]] = []
    short: list[tuple[float, str]] = []
    for run, span in found:
        if span.count > 1:
            before, after, lacking = _excess(run, span, units)
            early += [(before, run.run_id)] if before > _TOLERATED_S else []
            late += [(after, run.run_id)] if after > _TOLERATED_S else []
            short += [(lacking, run.run_id)] if lacking > _TOLERATED_S else []
    for runs_found, words in (
        (early, "begins before the run"),
        (late, "outlasts the run"),
        # A log of events ends with the last event: in most runs, then.
        (short if 2 * len(short) < len(found) else [], "ends before the run does: cut off?"),
    ):
        if runs_found:
            most, which = max(runs_found)
            yield f"{file} {words} in {_of([name for _, name in runs_found], found)}, by up to {most:.3g} s ({which})"


def _of(names: Sequence[str], found: Sequence[object]) -> str:
    shown = enumerated([*names[:3], *([f"{len(names) - 3} more"] if len(names) > 3 else [])])  # noqa: PLR2004 - as shown
    return f"{len(names)} of {counted(len(found), 'run')} ({shown})"


def _excess(run: ForeignRun, span: TraceSpan, units: Mapping[str, Unit | None]) -> tuple[float, float, float]:
    """Return for how many seconds a trace is there before the run begins, after it ends, and how many are lacking."""
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
    """Return the moment that a text column of this name has, ns since 1970."""
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
    """Return how long the run took by the table, s."""
    for name, unit in units.items():
        value = run.measures.get(name)
        is_duration = unit is not None and unit.si == "s" and _DURATION.search(name) and not _OF_PARTS.search(name)
        if is_duration and unit is not None and isinstance(value, int | float) and not isinstance(value, bool):
            return float(unit.to_si(value))
    return None
