"""The way that a robot took, seen from above."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from robot_runner.analysis.figures.courses import draw_events, draw_phase_names, shade_phases, strip_height
from robot_runner.analysis.figures.style import COLUMN, INK, Look, figure_style, looks, new_figure, verbatim, wrapped

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from robot_runner.analysis.figures.courses import Course, PhaseSpan

__all__ = ["Way", "draw_mean_courses", "draw_single_courses", "draw_trajectories"]


# A sampled measure over the time of a mission: the paper's Fig. 4.

_PANEL = 1.0  # height of one run's panel, inches
_FOOT = 0.42
_SIDE = 0.55
_TIME = "Time since the start of measurement (s)"


@figure_style()
def draw_single_courses(
    courses: Mapping[str, Course],
    *,
    order: Sequence[str],
    value_label: str,
    phases: Sequence[PhaseSpan] = (),
    events: Mapping[str, float] | None = None,
    width: float = COLUMN,
) -> Figure:
    """Draw one run for each treatment, one above the other: the mean of each bin, and all samples as a band.

    Args:
        courses: one run for each treatment.
        order: the treatments in the order in which all figures show them.
        value_label: what is measured, with its unit.
        phases: of the mission; named above the topmost run.
        events: when they were, s since the start of measurement.
        width: of the figure, inches.
    """
    seconds = _seconds(list(courses.values()))
    strip = strip_height(phases, seconds, width - _SIDE) if phases else 0.0
    figure = new_figure(width, strip + _PANEL * len(courses) + _FOOT)
    ratios = ([strip] if phases else []) + [_PANEL] * len(courses)
    grid = figure.subplots(
        len(ratios), 1, sharex=True, squeeze=False, gridspec_kw={"height_ratios": ratios, "hspace": 0.02}
    )[:, 0]
    panels = grid[1:] if phases else grid
    if phases:
        draw_phase_names(grid[0], phases, seconds, width - _SIDE)
    low, high = _limits(list(courses.values()))
    by_name = dict(zip(order, looks(len(order)), strict=True))
    for axes, (treatment, course) in zip(panels, courses.items(), strict=True):
        shade_phases(axes, phases)
        _draw_run(axes, course, by_name[treatment])
        axes.set_ylim(low, high)
        axes.text(
            0.5,  # where no name of an event stands: they begin and end the measurement
            0.96,
            _title(treatment, course),
            transform=axes.transAxes,
            ha="center",
            va="top",
            fontsize=6.5,
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 1.0},
        )
        axes.grid(visible=True, axis="y")
        draw_events(axes, (events or {}) if axes is panels[-1] else {}, seconds)
    panels[-1].set_xlabel(_TIME)
    panels[-1].set_xlim(0, seconds)
    if len(panels) == 1:
        panels[0].set_ylabel(wrapped(value_label))
    else:
        figure.supylabel(wrapped(value_label), fontsize=7.5)
    return figure


@figure_style()
def draw_mean_courses(
    courses: Sequence[Course],
    *,
    order: Sequence[str],
    value_label: str,
    phases: Sequence[PhaseSpan] = (),
    events: Mapping[str, float] | None = None,
    width: float = COLUMN,
    height: float = 2.3,
) -> Figure:
    """Draw the mean of each treatment's runs, with a band of one standard deviation between runs.

    Args:
        courses: one for each treatment.
        order: the treatments in the order in which all figures show them.
        value_label: what is measured, with its unit.
        phases: of the mission, where all runs have the same.
        events: when they were, s since the start of measurement.
        width: of the figure, inches.
        height: of it without the strip of phases, inches.
    """
    seconds = _seconds(courses)
    strip = strip_height(phases, seconds, width - _SIDE) if phases else 0.0
    figure = new_figure(width, height + strip)
    ratios = [strip, height] if phases else [height]
    grid = figure.subplots(len(ratios), 1, sharex=True, squeeze=False, gridspec_kw={"height_ratios": ratios})[:, 0]
    axes = grid[-1]
    if phases:
        draw_phase_names(grid[0], phases, seconds, width - _SIDE)
    shade_phases(axes, phases)
    by_name = dict(zip(order, looks(len(order)), strict=True))
    for course in courses:
        look = by_name[course.label]
        axes.fill_between(course.time, course.low, course.high, color=look.colour, alpha=0.22, linewidth=0)
        axes.plot(course.time, course.middle, color=look.colour, linestyle=look.line, label=verbatim(course.label))
    draw_events(axes, events or {}, seconds)
    axes.set_xlim(0, seconds)
    axes.set_xlabel(_TIME)
    axes.set_ylabel(wrapped(value_label))
    axes.grid(visible=True, axis="y")
    if len(courses) > 1:
        figure.legend(loc="outside lower center", ncols=min(len(courses), 3))
    return figure


def _draw_run(axes: Axes, course: Course, look: Look) -> None:
    axes.fill_between(course.time, course.low, course.high, color=look.colour, alpha=0.25, linewidth=0)
    axes.plot(course.time, course.middle, color=look.colour, linewidth=0.9)


def _title(treatment: str, course: Course) -> str:
    name = verbatim(course.label)
    return f"{verbatim(treatment)} ({name})" if treatment else name


def _seconds(courses: Sequence[Course]) -> float:
    ends = [
        float(course.time[-1] + (course.time[-1] - course.time[-2]) / 2) for course in courses if len(course.time) > 1
    ]
    return max(ends, default=1.0)


def _limits(courses: Sequence[Course]) -> tuple[float, float]:
    everything = np.concatenate([each for course in courses for each in (course.low, course.high)] or [np.empty(0)])
    there = everything[np.isfinite(everything)]
    if not len(there):
        return 0.0, 1.0
    low, high = float(there.min()), float(there.max())
    margin = 0.06 * (high - low) or abs(high) * 0.05 or 1.0
    return low - margin, high + margin + 0.16 * (high - low)  # above: room for the name of the run


#: The least height of the figure's frame, as a share of its width: a way straight ahead is a line.
_FLATTEST = 0.22


@dataclass(frozen=True, slots=True)
class Way:
    """The way of one run.

    Attributes:
        label: the run's treatments.
        x, y: places in m, in the frame of the odometry.
    """

    label: str
    x: NDArray[np.float64]
    y: NDArray[np.float64]


@figure_style()
def draw_trajectories(ways: Sequence[Way], *, order: Sequence[str], width: float = COLUMN) -> Figure:
    """Draw ways at the same scale along both axes; a circle marks each beginning, a cross each end.

    Args:
        ways: one a run.
        order: the treatments in the order in which all figures show them.
        width: of the figure, inches.
    """
    left, right, low, high = _frame(ways)
    height = min(4.5, max(1.1, (width - 0.6) * (high - low) / (right - left) + 0.75))
    figure = new_figure(width, height)
    axes = figure.subplots()
    by_name = dict(zip(order, looks(len(order)), strict=True))
    named: set[str] = set()
    for way in ways:
        look = by_name[way.label]
        label = verbatim(way.label) if way.label not in named else None
        named.add(way.label)
        axes.plot(way.x, way.y, color=look.colour, linestyle=look.line, linewidth=0.7, alpha=0.8, label=label)
        _mark_ends(axes, way)
    axes.set_xlim(left, right)
    axes.set_ylim(low, high)
    axes.set_aspect("equal")
    axes.set_xlabel("x (m)")
    axes.set_ylabel("y (m)")
    axes.grid(visible=True)
    if 1 < len(order) <= 6:  # noqa: PLR2004 - more would hide the ways
        places = {verbatim(name): place for place, name in enumerate(order)}
        handles, shown = axes.get_legend_handles_labels()
        handles = [handle for _, handle in sorted(zip(shown, handles, strict=True), key=lambda each: places[each[0]])]
        figure.legend(handles=handles, loc="outside lower center", ncols=3)
    return figure


def _mark_ends(axes: Axes, way: Way) -> None:
    there = np.flatnonzero(np.isfinite(way.x) & np.isfinite(way.y))
    if not len(there):
        return
    first, last = there[0], there[-1]
    axes.plot(way.x[first], way.y[first], marker="o", markersize=4, markerfacecolor="white", color=INK, zorder=4)
    axes.plot(way.x[last], way.y[last], marker="x", markersize=3.5, color=INK, zorder=5)


def _frame(ways: Sequence[Way]) -> tuple[float, float, float, float]:
    """Return left, right, low and high of the frame: around all ways, never flatter than a strip."""
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
