"""The quality of a profiler's samples: kept with the raw data, with warnings where it is poor."""

from __future__ import annotations

import io
import json
from array import array
from bisect import bisect_left, bisect_right
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import chain, pairwise
from pathlib import Path
from typing import Any

from robot_runner.core.events.context import RobotRunnerContext
from robot_runner.core.events.window import Window
from robot_runner.core.storage.guarded_files import open_to_fill
from robot_runner.measuring.series import Series, within


@dataclass(frozen=True, slots=True)
class Column:
    """One column of a file of samples.

    Attributes:
        name: its heading, with the unit, such as `power_W`.
        values: its numbers; None, a missing one, leaves its cell empty.
        form: how a number is written, in printf style.

    Example:
        >>> Column("power_W", [7.5], "%.3f").form % 7.5
        '7.500'
    """

    name: str
    values: Sequence[float] | Sequence[float | None]
    form: str = "%.6f"

    def cells(self) -> list[str]:
        """Return the cells below the heading."""
        return ["" if one is None else self.form % one for one in self.values]


def write_samples(path: Path, columns: Sequence[Column]) -> None:
    """Write columns of equal length as a CSV file with a heading; an existing file is replaced.

    Raises:
        ValueError: the columns are not equally long.
    """
    with io.TextIOWrapper(open_to_fill(path), encoding="utf-8", errors="backslashreplace", newline="") as file:
        file.write(",".join(column.name for column in columns) + "\n")
        file.writelines(_rows(columns))


def _rows(columns: Sequence[Column]) -> Iterator[str]:
    """Return the lines below the heading; a meter of 100 samples a second writes 10,000 of them for each run."""
    if any(not isinstance(column.values, array) and None in column.values for column in columns):  # arrays hold none
        return (f"{','.join(row)}\n" for row in zip(*(column.cells() for column in columns), strict=True))
    form = ",".join(column.form for column in columns) + "\n"  # a whole row at once takes half the time
    return (form % row for row in zip(*(column.values for column in columns), strict=True))


def write_quality(
    path: Path,
    quality: SampleQuality | None,
    window: Window | None,
    details: Mapping[str, Any],
    *,
    sampled: Window | None = None,
) -> None:
    """Write the quality of samples and facts about the sensor as a JSON object.

    Args:
        path: the file.
        quality: of the samples within the window.
        window: the one that the values are about; raw samples outside it only serve for its edges.
        details: plain facts about the sensor.
        sampled: from the profiler's start to its stop.
    """
    facts = {
        "window": None if window is None else asdict(window),
        "sampled": None if sampled is None else asdict(sampled),
        "samples": None if quality is None else asdict(quality),
        **details,
    }
    with open_to_fill(path) as file:
        file.write(f"{json.dumps(facts, indent=2, allow_nan=False)}\n".encode())


#: Percentage of the window that samples must cover for a value to be computed: power and utilisation that change
#: by a third between phases bend a mean over the rest by less than 2 %.
MINIMUM_COVERAGE = 95.0
#: A pause longer than this many sampling periods is a gap: what happened in it is unknown.
_GAP_PERIODS = 5.0
#: In an interval longer than this many periods a sample is missing.
_OVERDUE_PERIODS = 1.5
#: By how many percent the samples may be fewer than expected; one sample depends on where the window's edges are.
_FEWER = 2.0
#: Jitter (95th percentile), in periods, above which samples are too uneven for their rate.
_JITTER_PERIODS = 0.5
#: Percentage of the window by which the times of samples may be wrong; beyond it a value may be wrong by as much.
_CLOCK_SHARE = 1.0
#: Percentage of one core above which a profiler changes what it measures on its own machine.
_OWN_SHARE = 5.0


@dataclass(frozen=True, slots=True)
class Jitter:
    """How far the times between two samples are from their median, s: at least half of them are no further than `p50`.

    Example:
        >>> from robot_runner.plugins import Window, quality_of
        >>> quality_of([0.0, 1.0, 2.0, 3.5], Window(-0.5, 4.0), rate=1.0).jitter
        Jitter(p50=0.0, p95=0.5, p99=0.5)
    """

    p50: float
    p95: float
    p99: float


@dataclass(frozen=True, slots=True, kw_only=True)
class SampleQuality:
    """The quality of the samples of one window.

    Attributes:
        expected: how many samples the window should hold at the nominal rate.
        got: how many it holds.
        period: the nominal time between two samples, s.
        largest_gap: the longest time without a sample, the window's edges included, s.
        coverage: percentage of the window outside gaps; a gap is a pause of more than five periods.
        overdue: for how long within the window a sample was overdue, s: the time beyond one period in intervals of more
            than one and a half periods, including intervals across the window's edges.
        unreached: for how long the window lasts before the first of all samples and after the last, s.
        jitter: of the times between the window's samples, without those taken for its edges; None for fewer than two
            samples.
        duplicates: samples that came twice and were left out.
        lost: samples that were taken or due and never arrived.
        corrupt: messages that arrived damaged and were left out.
        failed: readings that raised an error instead; `first_failure` is the text of the first one.
        saturated: samples at the end of the sensor's range: the true value lies beyond.
        is_bracketed: whether there are samples on both sides of the window, each at most a period away from its edge.
        clock_offset: how far the clock of the samples was ahead of the run's, s; None where they share one.
        clock_uncertainty: how far that may be wrong, s.
        cpu_seconds: CPU time that the profiler itself used on the machine that it measures, s; None if not known.
        duration: of the window, s.
    """

    expected: int
    got: int
    period: float
    largest_gap: float
    coverage: float
    overdue: float = 0.0
    unreached: float = 0.0
    jitter: Jitter | None = None
    duplicates: int = 0
    lost: int = 0
    corrupt: int = 0
    failed: int = 0
    first_failure: str = ""
    saturated: int = 0
    is_bracketed: bool = False
    clock_offset: float | None = None
    clock_uncertainty: float | None = None
    cpu_seconds: float | None = None
    duration: float = 0.0

    @property
    def is_sufficient(self) -> bool:
        """Whether the samples cover enough of the window for a value to be computed from them."""
        return (self.got > 0 or self.is_bracketed) and self.coverage >= MINIMUM_COVERAGE

    def warnings(self) -> tuple[str, ...]:
        """Return one sentence, with figures, for each doubt; nothing where there is none."""
        return tuple(self._doubts())

    def _doubts(self) -> Iterator[str]:
        yield from self._doubts_about_times()
        for count, what in (
            (self.lost, "lost"),
            (self.corrupt, "damaged and left out"),
            (self.duplicates, "received twice"),
            (self.saturated, "at the end of the sensor's range: the true value lies beyond"),
        ):
            if count:
                yield f"{count} {'sample was' if count == 1 else 'samples were'} {what}"
        if self.failed:
            readings = "1 reading" if self.failed == 1 else f"{self.failed} readings"
            yield f"{readings} failed, the first with: {self.first_failure}"
        if self.clock_uncertainty is not None and self.clock_uncertainty > self.duration * _CLOCK_SHARE / 100:
            yield f"the clock of the samples is known to {self.clock_uncertainty:.3f} s only"
        if self.cpu_seconds is not None and self.cpu_seconds > self.duration * _OWN_SHARE / 100:
            share = 100 * self.cpu_seconds / self.duration if self.duration else 100.0
            yield f"the profiler itself kept {share:.1f} % of one core busy"

    def _doubts_about_times(self) -> Iterator[str]:
        if not self.got and not self.is_bracketed:
            yield f"no sample arrived in the measured window, where {self.expected} were expected"
            return
        if self.expected - self.got > max(1.0, self.expected * _FEWER / 100):
            yield f"{self.got} samples arrived of {self.expected} expected"
        if self.largest_gap > _GAP_PERIODS * self.period:
            gap = f"the largest gap between samples is {self.largest_gap:.3f} s at a period of {self.period:.3f} s"
            yield f"{gap}; samples cover {self.coverage:.1f} % of the measured window"
        elif self.jitter is not None and self.jitter.p95 > _JITTER_PERIODS * self.period:
            off = self.jitter.p95
            yield f"the samples are uneven: 1 in 20 came {off:.3f} s or more off a period of {self.period:.3f} s"
        elif self.overdue > (1 - MINIMUM_COVERAGE / 100) * self.duration:
            missing = f"samples are missing for {self.overdue:.3f} s of the measured window of {self.duration:.3f} s"
            yield f"{missing}, or at its edges, at a period of {self.period:.3f} s"
        elif self.unreached > (1 - MINIMUM_COVERAGE / 100) * self.duration:
            ends = f"at the ends of the measured window of {self.duration:.3f} s"
            yield f"samples leave out {self.unreached:.3f} s {ends}"


def quality_of(times: Sequence[float], window: Window, rate: float, **known: Any) -> SampleQuality:
    """Return the quality of samples taken at `times` (s, never falling) at a nominal `rate` (Hz).

    Args:
        times: when they were taken.
        window: the one that the quality is about.
        rate: how many a second there should be.
        known: what else is known of them: `SampleQuality`'s duplicates, lost, corrupt, failed, first_failure,
            saturated, clock_offset, clock_uncertainty and cpu_seconds.

    Example:
        >>> from robot_runner.plugins import Window
        >>> quality_of([0.5, 1.5, 2.5, 9.5], Window(0.0, 10.0), rate=1.0).warnings()[0]
        '4 samples arrived of 10 expected'
    """
    seen = times[within(times, window)]
    edged = pairwise(chain((window.start,), seen, (window.end,)))
    gaps = array("d", (later - sooner for sooner, later in edged))  # a mission of hours has millions
    period = 1.0 / rate
    unseen = sum(gap for gap in gaps if gap > _GAP_PERIODS * period)
    first, behind = bisect_right(times, window.start), bisect_left(times, window.end)
    is_enclosed = first > 0 and behind < len(times)
    return SampleQuality(
        expected=round(window.duration * rate),
        got=len(seen),
        period=period,
        largest_gap=max(gaps),
        coverage=100.0 * (1.0 - unseen / window.duration) if window.duration else 0.0,
        overdue=_overdue(times, window, period),
        unreached=max(0.0, times[0] - window.start) + max(0.0, window.end - times[-1]) if len(times) else 0.0,
        jitter=jitter_of(times[first:behind]),
        is_bracketed=is_enclosed and times[first - 1] >= window.start - period and times[behind] <= window.end + period,
        duration=window.duration,
        **known,
    )


def _overdue(times: Sequence[float], window: Window, period: float) -> float:
    """Return for how long within a window a sample was overdue, s.

    Intervals across an edge count, too: what is interpolated between their samples is as uncertain in the window as if
    the whole interval were in it.
    """
    near = times[max(bisect_right(times, window.start) - 1, 0) : bisect_left(times, window.end) + 1]
    first = () if len(near) and near[0] <= window.start else (window.start,)
    last = () if len(near) and near[-1] >= window.end else (window.end,)
    return sum(
        min(later - sooner - period, min(later, window.end) - max(sooner, window.start))
        for sooner, later in pairwise(chain(first, near, last))
        if later - sooner > _OVERDUE_PERIODS * period
    )


def sufficient(series: Series, window: Window, rate: float) -> Series:
    """Return the samples where they cover enough of the window for a value to be computed from them, else none."""
    return series if quality_of(series.times, window, rate).is_sufficient else Series([], [])


def jitter_of(times: Sequence[float]) -> Jitter | None:
    """Return how far the times between samples (s) are from their median; None for fewer than two samples."""
    intervals = array("d", sorted(later - sooner for sooner, later in pairwise(times)))
    if not intervals:
        return None
    count = len(intervals)
    median = intervals[round((count - 1) / 2)]
    deviations = sorted(abs(interval - median) for interval in intervals)
    return Jitter(*(deviations[-(-count * percent // 100) - 1] for percent in (50, 95, 99)))  # the nearest rank


_FILE = "quality.json"
_FIX = "Look at the plugin's raw samples before you use this run."


def report_quality(
    context: RobotRunnerContext,
    quality: SampleQuality,
    window: Window,
    *,
    fix: str = _FIX,
    details: Mapping[str, Any] | None = None,
    sampled: Window | None = None,
    measures: Sequence[str] = (),
) -> bool:
    """Write the quality to the raw-data folder as `quality.json`, report doubts, and return whether it suffices.

    The doubts appear at the end of the run, in the journal, and in the schema of the run table.

    Args:
        context: the run's.
        quality: of the samples.
        window: the one that the quality is about.
        fix: what the reader of a warning can do, in one sentence.
        details: plain facts to keep with it, such as the sensor's settings.
        sampled: from the profiler's start to its stop.
        measures: those that are computed from the samples; empty for all of the profiler's.

    Returns:
        Whether a value may be computed from the samples (`SampleQuality.is_sufficient`).
    """
    write_quality(context.raw_data_folder / _FILE, quality, window, details or {}, sampled=sampled)
    for problem in quality.warnings():
        context.doubt(problem, fix=fix, measures=measures)
    return quality.is_sufficient
