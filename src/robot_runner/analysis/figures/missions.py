"""Figures over time: sampled measures (the paper's Fig. 4), the robot's trajectory, the timeline of all runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.collections import PolyCollection

from robot_runner.analysis.arrays import Floats
from robot_runner.analysis.figures.courses import (
    Course,
    MissionCourses,
    PhaseSpan,
    draw_events,
    draw_phase_names,
    shade_phases,
    strip_height,
)
from robot_runner.analysis.figures.style import (
    COLUMN,
    INK,
    PAGE,
    add_legend,
    draw_points,
    figure_style,
    label_axes,
    looks_by,
    new_axes,
    new_figure,
    verbatim,
    wrapped,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_PANEL = 1.0  # height of one run's panel, inches
_HEIGHT = 2.3  # height of the panel of means, inches
_FOOT, _SIDE = 0.42, 0.55  # room for labels, inches
_TIME = "Time since the start of the mission (s)"
#: The smallest height of a trajectory's frame, as a share of its width: a straight trajectory is a line.
_FLATTEST = 0.22
_MOST_IN_LEGEND = 6  # more would hide the trajectories
_MOST_NAMED = 45  # runs with their names on the timeline
_BAR = 0.7  # height of a run's bar there, as a share of its row
_MINUTES, _HOURS, _DAYS = 300.0, 3 * 3600.0, 3 * 86400.0
_FAILED = "#BB5566"


@figure_style()
def draw_single_courses(mission: MissionCourses) -> Figure:
    """Draw the first run of each treatment in a panel: the mean of each bin, and a band from smallest to largest."""
    courses = list(mission.firsts.values())
    seconds = _seconds(courses)
    figure, panels = _panels([_PANEL] * len(courses), mission.phases, seconds, foot=_FOOT, hspace=0.02)
    limits = _limits(courses)
    by_name = looks_by(mission.order)
    for axes, (treatment, course) in zip(panels, mission.firsts.items(), strict=True):
        look, name = by_name[treatment], verbatim(course.label)
        axes.fill_between(course.time, course.low, course.high, color=look.colour, alpha=0.25, linewidth=0)
        axes.plot(course.time, course.middle, color=look.colour, linewidth=0.9)
        axes.set_ylim(*limits)
        axes.text(
            0.5,  # where no name of an event stands: they begin and end the measurement
            0.96,
            f"{verbatim(treatment)} ({name})" if treatment else name,
            transform=axes.transAxes,
            ha="center",
            va="top",
            fontsize=6.5,
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 1.0},
        )
        axes.grid(visible=True, axis="y")
    draw_events(panels[-1], mission.events, seconds)
    panels[-1].set_xlabel(_TIME)
    if len(panels) == 1:
        panels[0].set_ylabel(wrapped(mission.label))
    else:
        figure.supylabel(wrapped(mission.label), fontsize=7.5)
    return figure


@figure_style()
def draw_mean_courses(mission: MissionCourses) -> Figure:
    """Draw the mean of each treatment's runs, with a band of one standard deviation between runs."""
    seconds = _seconds(mission.means)
    figure, [axes] = _panels([_HEIGHT], mission.phases, seconds)
    by_name = looks_by(mission.order)
    for course in mission.means:
        look = by_name[course.label]
        axes.fill_between(course.time, course.low, course.high, color=look.colour, alpha=0.22, linewidth=0)
        axes.plot(course.time, course.middle, color=look.colour, linestyle=look.line, label=verbatim(course.label))
    draw_events(axes, mission.events, seconds)
    label_axes(axes, _TIME, mission.label, grid="y")
    add_legend(figure, len(mission.means))
    return figure


def _panels(
    heights: list[float], phases: Sequence[PhaseSpan], seconds: float, *, foot: float = 0.0, **spacing: float
) -> tuple[Figure, list[Any]]:
    """Return a figure with stacked axes of these heights, and the names of the phases on top."""
    strip = [strip_height(phases, seconds, COLUMN - _SIDE)] if phases else []
    figure = new_figure(COLUMN, sum(strip) + sum(heights) + foot)
    ratios = [*strip, *heights]
    settings = {"height_ratios": ratios, **spacing}
    grid = list(figure.subplots(len(ratios), 1, sharex=True, squeeze=False, gridspec_kw=settings)[:, 0])
    panels = grid[len(strip) :]
    if phases:
        draw_phase_names(grid[0], phases, seconds, COLUMN - _SIDE)
    for axes in panels:
        shade_phases(axes, phases)
        axes.set_xlim(0, seconds)
    return figure, panels


def _seconds(courses: Sequence[Course]) -> float:
    return max((float(course.bins[-1] + 1) * course.width for course in courses if len(course.bins) > 1), default=1.0)


def _limits(courses: Sequence[Course]) -> tuple[float, float]:
    everything = np.concatenate([each for course in courses for each in (course.low, course.high)] or [np.empty(0)])
    there = everything[np.isfinite(everything)]
    if not len(there):
        return 0.0, 1.0
    low, high = float(there.min()), float(there.max())
    margin = 0.06 * (high - low) or abs(high) * 0.05 or 1.0
    return low - margin, high + margin + 0.16 * (high - low)  # room for the run's name on top


@dataclass(frozen=True, slots=True)
class Trajectory:
    """The positions of a run with these treatments, m, in the frame of the odometry."""

    label: str
    x: Floats
    y: Floats


@figure_style()
def draw_trajectories(ways: Sequence[Trajectory], *, order: Sequence[str]) -> Figure:
    """Draw trajectories with equal scales on both axes; a circle marks each beginning, a cross each end."""
    left, right, low, high = _frame(ways)
    figure, axes = new_axes(COLUMN, min(4.5, max(1.1, (COLUMN - 0.6) * (high - low) / (right - left) + 0.75)))
    named: dict[str, Any] = {}
    by_name = looks_by(order)
    for way in ways:
        look = by_name[way.label]
        [line] = axes.plot(way.x, way.y, color=look.colour, linestyle=look.line, linewidth=0.7, alpha=0.8)
        named.setdefault(way.label, line).set_label(verbatim(way.label))
        _mark_ends(axes, way)
    axes.set_xlim(left, right)
    axes.set_ylim(low, high)
    axes.set_aspect("equal")
    label_axes(axes, "x (m)", "y (m)", grid="both")
    if 1 < len(order) <= _MOST_IN_LEGEND:
        figure.legend(handles=[named[name] for name in order if name in named], loc="outside lower center", ncols=3)
    return figure


def _mark_ends(axes: Axes, way: Trajectory) -> None:
    there = np.flatnonzero(np.isfinite(way.x) & np.isfinite(way.y))
    if not len(there):
        return
    first, last = there[0], there[-1]
    axes.plot(way.x[first], way.y[first], marker="o", markersize=4, markerfacecolor="white", color=INK, zorder=4)
    axes.plot(way.x[last], way.y[last], marker="x", markersize=3.5, color=INK, zorder=5)


def _frame(ways: Sequence[Trajectory]) -> tuple[float, float, float, float]:
    """Return left, right, bottom and top of a frame around all trajectories, with a minimum height."""
    xs = np.concatenate([way.x for way in ways] or [np.empty(0)])
    ys = np.concatenate([way.y for way in ways] or [np.empty(0)])
    there = np.isfinite(xs) & np.isfinite(ys)
    if not there.any():
        return -1.0, 1.0, -1.0, 1.0
    xs, ys = xs[there], ys[there]
    wide = max(float(np.ptp(xs)), float(np.ptp(ys)) * 0.3, 0.1) * 1.1
    tall = max(float(np.ptp(ys)) * 1.1, wide * _FLATTEST)
    middle_x, middle_y = (float(xs.min() + xs.max()) / 2, float(ys.min() + ys.max()) / 2)
    return middle_x - wide / 2, middle_x + wide / 2, middle_y - tall / 2, middle_y + tall / 2


@dataclass(frozen=True, slots=True)
class AttemptSpan:
    """One attempt at a run with these treatments.

    Attributes:
        start, end: s since the experiment began.
        measured: start and end of the measurement, where both are known.
        is_done: whether the run was done in this attempt.
    """

    run_id: str
    label: str
    start: float
    end: float
    measured: tuple[float, float] | None
    is_done: bool


@figure_style()
def draw_timeline(spans: Sequence[AttemptSpan], *, order: Sequence[str]) -> Figure:
    """Draw a row for each run, with a bar for each attempt: measurements are dark, failed attempts are hatched.

    The markers at the ends show the treatments.
    """
    run_ids = list(dict.fromkeys(span.run_id for span in spans))
    rows = {run_id: place for place, run_id in enumerate(run_ids)}
    figure, axes = new_axes(PAGE, min(7.0, 0.75 + 0.13 * len(rows)))
    scale, unit = _scale(max((span.end for span in spans), default=1.0))

    def draw_bars(several: Sequence[AttemptSpan], edges: list[tuple[float, float]], **settings: Any) -> None:
        places = (rows[span.run_id] for span in several)
        bars = [_bar(start / scale, end / scale, place) for place, (start, end) in zip(places, edges, strict=True)]
        # A single artist: with one for each bar, thousands of runs take minutes and hundreds of megabytes.
        axes.add_collection(PolyCollection(bars, **settings))

    for name, look in looks_by(order).items():
        done = [span for span in spans if span.label == name and span.is_done]
        if done:
            draw_bars(done, [(span.start, span.end) for span in done], facecolor=look.colour, alpha=0.3)
            measured = [span.measured or (span.start, span.end) for span in done]
            draw_bars(done, measured, facecolor=look.colour, alpha=1.0)
            # In grey, at most three colours can be distinguished.
            places = [rows[span.run_id] for span in done]
            draw_points(axes, [span.end / scale for span in done], places, look, label=verbatim(name))
    failed = [span for span in spans if not span.is_done]
    hatched = {"facecolor": "white", "edgecolor": _FAILED, "hatch": "/////", "linewidth": 0.8}
    draw_bars(failed, [(span.start, span.end) for span in failed], **hatched)
    ends = [span.end / scale for span in failed]
    axes.plot(ends, [rows[span.run_id] for span in failed], linestyle="none", marker="x", markersize=4, color=INK)
    step = max(1, -(-len(rows) // _MOST_NAMED))
    axes.set_yticks(range(0, len(rows), step), [verbatim(run_id) for run_id in run_ids[::step]], fontsize=6)
    axes.set_xlim(0, 1.05 * (max((span.end for span in spans), default=0.0) or 1.0) / scale)
    axes.set_ylim(len(rows) - 0.4, -0.6)
    label_axes(axes, f"Time since the experiment began ({unit})", grid="x")
    if axes.get_legend_handles_labels()[0]:
        add_legend(figure, len(order), most=_MOST_IN_LEGEND, columns=_MOST_IN_LEGEND, handlelength=1.2)
    return figure


def _bar(start: float, end: float, place: int) -> list[tuple[float, float]]:
    low, high = place - _BAR / 2, place + _BAR / 2
    return [(start, low), (end, low), (end, high), (start, high)]


def _scale(seconds: float) -> tuple[float, str]:
    if seconds < _MINUTES:
        return 1.0, "s"
    if seconds < _HOURS:
        return 60.0, "min"
    return (3600.0, "h") if seconds < _DAYS else (86400.0, "days")
