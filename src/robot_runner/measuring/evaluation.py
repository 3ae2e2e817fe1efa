"""From raw samples to the measures of a run: over the mission, and over each phase that the config names."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from robot_runner.core.events.context import PROBE, Clock, RobotRunnerContext
from robot_runner.core.events.measure import Measure, MeasureValue, Origin, Over
from robot_runner.core.events.window import Window
from robot_runner.measuring.window_ends import Evaluate, WindowEnds

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
        MeasureError: a value is refused.
    """
    window = context.times.window(clock)
    is_over = window is not None and window.duration > 0
    values = evaluate(window) if window is not None and is_over else {}
    for measure in measures:
        context.publish(measure.name, values.get(measure.name), origin=origin)
    divided = [each for each in measures if each.over]
    ends = WindowEnds(times, evaluate, divided)
    if window is not None and is_over and context.run_id != PROBE:
        _doubt(context, ends.doubts_about_mission(window))
    for phase in context.times.requested:
        windows = [each.window for each in context.times.phases(clock) if each.name == phase]
        windows = [each for each in windows if each.duration > 0]
        _publish_phase(context, phase, windows, divided, evaluate, origin)
        if len(times) and windows:
            _doubt(context, ends.doubts_about_phase(phase, windows), f".{phase}")


def note_own_window(
    context: RobotRunnerContext,
    own: Window,
    *,
    measures: Sequence[str] = (),
    clock: Clock | None = None,
    fix: str = "",
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
        context.doubt(problem, fix=fix or usual, measures=measures)


def _publish_phase(
    context: RobotRunnerContext,
    phase: str,
    windows: Sequence[Window],
    measures: Sequence[Measure],
    evaluate: Evaluate,
    origin: Origin,
) -> None:
    values = [evaluate(window) for window in windows]
    for measure in measures:
        value = _joined([one.get(measure.name) for one in values], windows, measure.over) if windows else None
        context.publish(f"{measure.name}.{phase}", value, origin=origin)


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
