"""From raw samples to the measures of a run: over the mission, and over each phase that the config names."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache
from typing import NamedTuple

from robot_runner.core.errors import MeasureError
from robot_runner.core.events.context import PROBE, Clock, RobotRunnerContext
from robot_runner.core.events.measure import Measure, MeasureValue, Origin, Over
from robot_runner.core.events.window import Window
from robot_runner.core.words import enumerated

#: Returns the value of each measure over a window; one that it leaves out is missing.
Evaluate = Callable[[Window], Mapping[str, MeasureValue]]

#: The doubt about a run in which a profiler's measurement did not begin.
NEVER_STARTED = "nothing was measured: the measurement was never started"
#: The values of a profiler that measured longer than the mission, by more than this share of it, are doubtful.
_TOLERANCE = 0.01
_MORE = "Have the meter sample more often, or what is measured last longer."


def publish_measures(
    context: RobotRunnerContext,
    measures: Sequence[Measure],
    evaluate: Evaluate,
    *,
    origin: Origin = Origin.MEASURED,
    clock: Clock | None = None,
    times: Sequence[float] = (),
) -> None:
    """Publish each measure for the mission, and for each phase that the config asks for.

    Args:
        context: the run's, in `populate_run_data`.
        measures: of the profiler.
        evaluate: computes the measures' values over a window from the raw samples.
        origin: where the values come from.
        clock: the one that the samples are stamped by, where it is not the run's.
        times: of the samples, s on that clock: values are doubted where so much changes between the samples around
            an end of the mission or of a phase that they may be off. Empty for what is known of each moment.

    Raises:
        MeasureError: a value is refused, or `evaluate` does not return a mapping.
    """
    window = context.times.window(clock)
    is_over = window is not None and window.duration > 0
    values = evaluate(window) if window is not None and is_over else {}
    if not isinstance(values, Mapping):
        problem = f"what was computed is {values!r}, of type {type(values).__name__}"
        raise MeasureError(problem, where=context.owner, fix="Return a mapping from measure to value.")
    for measure in measures:
        context.publish(measure.name, values.get(measure.name), origin=origin)
    _doubt_slips(context, values, [measure.name for measure in measures])
    divided = [each for each in measures if each.over]
    ends = WindowEnds(times, evaluate, divided)
    if window is not None and is_over and context.run_id != PROBE:
        _doubt(context, ends.doubts_about_mission(window))
    for phase in context.times.requested:
        windows = [each.window for each in context.times.phases(clock) if each.name == phase]
        windows = [each for each in windows if each.duration > 0]
        parts = [evaluate(each) for each in windows]
        for measure in divided:
            told = [part.get(measure.name) for part in parts]
            value = _joined(told, windows, measure.over) if windows else None
            context.publish(f"{measure.name}.{phase}", value, origin=origin)
        if len(times) and windows:
            _doubt(context, ends.doubts_about_phase(phase, windows), f".{phase}")


def note_own_window(
    context: RobotRunnerContext, own: Window, *, measures: Sequence[str] = (), clock: Clock | None = None, fix: str = ""
) -> None:
    """Mark values over a profiler's time from start to stop as doubtful, where that exceeds the mission by 1 %.

    Args:
        context: the run's, in `populate_run_data`.
        own: the window of the values, from the profiler's start to its stop.
        measures: which measures; empty for all of the profiler's.
        clock: the one of `own`, where it is not the run's.
        fix: what can be done about it, in one sentence; empty for what helps with most profilers.
    """
    window = context.times.window(clock)
    if window is not None and own.duration > window.duration * (1 + _TOLERANCE):
        problem = (
            f"the values are about {own.duration:.3f} s, from the profiler's start to its stop; "
            f"the mission took {window.duration:.3f} s of that"
        )
        usual = "List the profiler last, so that it starts last and stops first, or use one that keeps samples."
        if context.times.is_narrowed:
            usual = "Let the whole mission be what is measured: begin_window() and PlayBag(by='program') narrow it."
        context.doubt(problem, fix=fix or usual, measures=measures)


def _doubt_slips(context: RobotRunnerContext, values: Mapping[str, MeasureValue], names: Sequence[str]) -> None:
    """Tell of values under other names, where a measure has none: a slip would leave it missing without a word."""
    others, lacking = [name for name in values if name not in names], [name for name in names if name not in values]
    if others and lacking:
        told, none = enumerated(map(repr, others)), enumerated(map(repr, lacking))
        problem = f"a value of {told} was computed, which is no measure, and none of {none}"
        context.doubt(problem, fix="Return the values by the names of the measures.", measures=lacking)


def _doubt(context: RobotRunnerContext, doubts: Iterable[tuple[str, Sequence[str]]], suffix: str = "") -> None:
    for problem, names in doubts:
        context.doubt(problem, fix=_MORE, measures=[name + suffix for name in names])


def _joined(values: Sequence[MeasureValue], windows: Sequence[Window], over: Over | None) -> MeasureValue:
    """Return one value for all windows of a phase; None where one of them is missing or no number."""
    numbers = [value for value in values if isinstance(value, int | float)]
    if len(numbers) < len(values):
        return None
    if over is Over.MINIMUM:
        return min(numbers)
    if over is Over.MAXIMUM:
        return max(numbers)
    if over is Over.SUM:
        return sum(numbers) if all(isinstance(number, int) for number in numbers) else math.fsum(numbers)
    seconds = [window.duration for window in windows]
    return math.fsum(map(float.__mul__, map(float, numbers), seconds)) / math.fsum(seconds)


#: Values are doubted where they may be off by more than this share of them; percentages also by more than a point.
_OFF_SHARE, _OFF_POINTS = 0.05, 1.0
#: Of a phase with fewer samples, values are those of what is beside it.
_FEWEST = 2
#: Over more samples than that, 5 % are off only where rates at an end differ by 60 times the mean: to look for that
#: would take a tenth of a simulated run.
_MANY = 1000
#: How much of the time between two samples is counted on the wrong side of an end: a sixth on average; at most a fourth
#: for means since the sample before, and half for values of a moment, or all where each counts for the time before it.
_WRONG = 0.4
#: A meter is read just before the mission and just after it: that sample is no further away than this share of the
#: time between two samples.
_READ = 0.1


class _End(NamedTuple):
    """An end of a window between two samples.

    Attributes:
        inside: two samples' time within the window, without what is so near that it may be of both sides.
        outside: as much on the other side, as far as there are samples.
        apart: the time between the two samples, s.
        away: the time to the sample outside, s.
    """

    inside: Window
    outside: Window
    apart: float
    away: float


class WindowEnds:
    """What is not known of values, as a sample across an end of a window is about both sides of it.

    Values are wrong where much changes at an end, as it does where a robot begins to move.

    Args:
        times: of the samples, s, never falling.
        evaluate: returns the values over a window.
        measures: those that have values for parts of a mission.
    """

    def __init__(self, times: Sequence[float], evaluate: Evaluate, measures: Sequence[Measure]) -> None:
        self._times = times
        self._evaluate = cache(evaluate)
        self._measures = measures

    def doubts_about_mission(self, window: Window) -> Iterator[tuple[str, list[str]]]:
        """Yield why values are doubtful, and of which measures; nothing where a meter was read at both ends."""
        if any(end.away > _READ * end.apart for end in self._ends(window)):
            yield from self._doubts("the mission", [window])

    def doubts_about_phase(self, name: str, windows: Sequence[Window]) -> Iterator[tuple[str, list[str]]]:
        """Yield why values of a phase are doubtful, and the names of their measures."""
        counts = [bisect_right(self._times, each.end) - bisect_left(self._times, each.start) for each in windows]
        seconds = math.fsum(window.duration for window in windows)
        brief = math.fsum(each.duration for each, count in zip(windows, counts, strict=True) if count < _FEWEST)
        if brief > _OFF_SHARE * seconds:
            problem = f"phase {name!r} took {seconds:.3g} s, with {sum(counts)} samples in it"
            yield f"{problem}: its values are also those of what is beside it", [each.name for each in self._measures]
        else:
            yield from self._doubts(f"phase {name!r}", windows)

    def _doubts(self, what: str, windows: Sequence[Window]) -> Iterator[tuple[str, list[str]]]:
        seconds = math.fsum(window.duration for window in windows)
        ends = [end for window in windows for end in self._ends(window)]
        shares: dict[str, float] = {}
        unknown: list[str] = []
        for measure in self._measures:
            rates = [self._rate(measure, each) for each in windows]
            size = math.fsum(abs(rate or 0.0) * each.duration for rate, each in zip(rates, windows, strict=True))
            off = math.fsum(self._off(measure, end) for end in ends)
            is_little = measure.unit == "%" and off <= _OFF_POINTS * seconds
            if off and None in rates:
                unknown.append(measure.name)
            elif off > _OFF_SHARE * size and not is_little:
                shares[measure.name] = min(1.0, off / size) if size else 1.0
        if unknown:
            yield f"samples leave out too much of {what} for a value", unknown
        if shares:
            apart, most = max(end.apart for end in ends), 100 * max(shares.values())
            between = f"{what} begins and ends between samples that are {apart:.3g} s apart, and much changes there"
            yield f"{between}: values may be off by {most:.0f} %", list(shares)

    def _ends(self, window: Window) -> Iterator[_End]:
        length, times = window.duration, self._times
        for at, inwards in ((window.start, 1), (window.end, -1)):
            after = bisect_left(times, at)
            if not 0 < after < len(times):
                continue
            apart = times[after] - times[after - 1]
            near, far = 0.5 * apart, 2.5 * apart
            inside = sorted((at + inwards * min(near, length / 2), at + inwards * min(far, length)))
            outside = sorted((at - inwards * near, at - inwards * far))
            outside = [max(outside[0], times[0]), min(outside[1], times[-1])]
            if length <= _MANY * apart and outside[0] < outside[1]:
                away = at - times[after - 1] if inwards > 0 else times[after] - at
                yield _End(Window(*inside), Window(*outside), apart, away)

    def _off(self, measure: Measure, end: _End) -> float:
        within, beyond = self._rate(measure, end.inside), self._rate(measure, end.outside)
        return 0.0 if within is None or beyond is None else abs(within - beyond) * _WRONG * end.apart

    def _rate(self, measure: Measure, window: Window) -> float | None:
        """Return the value of a window for each second of it; None for extremes, texts and missing values."""
        value = self._evaluate(window).get(measure.name)
        if isinstance(value, bool) or not isinstance(value, int | float):
            return None
        return {Over.SUM: value / window.duration, Over.MEAN: float(value)}.get(measure.over or Over.MINIMUM)
