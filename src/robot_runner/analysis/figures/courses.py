"""Courses of samples over a mission, binned to the resolution of a figure, with phases and events."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from robot_runner.analysis.arrays import Floats, Numbers
from robot_runner.analysis.figures.style import GREY, INK, verbatim

if TYPE_CHECKING:
    from matplotlib.axes import Axes


_MOST_BINS = 500
_NICE = (1.0, 2.0, 2.5, 5.0, 10.0)
_SHADE = "#f1f4f7"  # background of a phase
_SHADES = ("#eef1f4", "#c9d3dd", "#dde4ea", "#b7c4d1")  # boxes of phase names
_POINTS = 5.8
#: The mean width of a letter of DejaVu Sans, as a share of the font size.
_LETTER = 0.62
_INCH = 72.0  # points


@dataclass(frozen=True, slots=True)
class Course:
    """A measure over the time of a mission, in bins of equal width; NaN in a bin without samples.

    Attributes:
        label: a run's id or a treatment.
        width: of a bin, s.
        bins: their numbers, without gaps; bin 0 begins at the start of the mission.
        middle: the mean in each bin.
        low, high: for one run, the smallest and largest sample in the bin; for several runs, their mean minus and plus
            one standard deviation between runs, and NaN where there are fewer than two.
    """

    label: str
    width: float
    bins: Numbers
    middle: Floats
    low: Floats
    high: Floats
    runs: int

    @property
    def time(self) -> Floats:
        """The middle of each bin, s since the start of the mission."""
        return (self.bins.astype(np.float64) + 0.5) * self.width


@dataclass(frozen=True, slots=True)
class PhaseSpan:
    """One phase of a mission, from `start` to `end`, s since the start of the mission."""

    name: str
    start: float
    end: float


@dataclass(frozen=True)
class MissionCourses:
    """A sampled measure over the time of a mission, of all shown runs.

    Attributes:
        label: the name of the measure with its unit, as in `Power (W)`.
        order: the treatments in their order in all figures.
        runs: the courses of each treatment's runs; treatments without any are left out.
        phases: the phases of the mission, where all runs went through the same ones.
        events: the times of events, s since the start of the mission, by name.
    """

    label: str
    unit: str
    order: Sequence[str]
    runs: Mapping[str, Sequence[Course]]
    width: float
    phases: Sequence[PhaseSpan] = ()
    events: Mapping[str, float] = field(default_factory=dict)

    @cached_property
    def means(self) -> tuple[Course, ...]:
        """The mean course of each treatment."""
        return tuple(mean_course(treatment, courses, self.width) for treatment, courses in self.runs.items())

    @cached_property
    def firsts(self) -> dict[str, Course]:
        """The first run of each treatment."""
        return {treatment: courses[0] for treatment, courses in self.runs.items()}


def bin_width(duration: float, period: float) -> float:
    """Return a round width of bins, s, for a limited number of bins with at least one sample each.

    The duration of the mission and the period between samples are in s, too.

    Example:
        >>> bin_width(95.0, 0.005)
        0.2
    """
    least = max(duration / _MOST_BINS, period, 1e-9)
    power = 10.0 ** math.floor(math.log10(least))
    return next(power * nice for nice in _NICE if power * nice >= least * (1 - 1e-9))


def course_of_run(label: str, time: Floats, values: Floats, width: float) -> Course:
    """Return the course of one run from values at ascending times, s; NaN for a missing value."""
    there = np.isfinite(values) & np.isfinite(time)
    known, numbers = values[there], np.floor(time[there] / width).astype(np.intp)
    filled, starts, counts = np.unique(numbers, return_index=True, return_counts=True)
    bins = bins_between(filled)
    middle, low, high = np.full((3, len(bins)), np.nan)
    if len(bins):
        places = filled - bins[0]
        middle[places] = np.add.reduceat(known, starts) / counts
        low[places], high[places] = np.minimum.reduceat(known, starts), np.maximum.reduceat(known, starts)
    return Course(label, width, bins, middle, low, high, runs=1)


def mean_course(label: str, courses: Sequence[Course], width: float) -> Course:
    """Return the mean and spread of several runs from courses with bins of this width."""
    given = [course for course in courses if len(course.bins)]
    bins = bins_between(edge for course in given for edge in (course.bins[0], course.bins[-1]))
    table = np.full((len(given), len(bins)), np.nan)
    for row, course in zip(table, given, strict=True):
        row[course.bins - bins[0]] = course.middle
    frame = pd.DataFrame(table)
    middle, spread = (found.to_numpy(dtype=np.float64) for found in (frame.mean(), frame.std()))
    return Course(label, width, bins, middle, middle - spread, middle + spread, runs=len(given))


def bins_between(numbers: Iterable[int]) -> Numbers:
    """Return the numbers of all bins from the first to the last of these."""
    several = [*numbers]
    return np.arange(min(several), max(several) + 1) if several else np.empty(0, dtype=np.intp)


def shade_phases(axes: Axes, phases: Sequence[PhaseSpan]) -> None:
    """Shade every other phase, so that the borders are visible behind the course."""
    for place, phase in enumerate(phases):
        if place % 2:
            axes.axvspan(phase.start, phase.end, color=_SHADE, linewidth=0, zorder=0)


def strip_height(phases: Sequence[PhaseSpan], seconds: float, width: float) -> float:
    """Return the height that the strip of names needs, inches."""
    upright = [phase.name for phase in phases if not _fits(phase, seconds, width)]
    return 0.14 if not upright else 0.12 + max(map(_inches, upright))


def draw_phase_names(axes: Axes, phases: Sequence[PhaseSpan], seconds: float, width: float) -> None:
    """Fill an axes with a box and a name for each phase; names that do not fit are rotated."""
    axes.set_axis_off()
    axes.set_ylim(0, 1)
    names = list(dict.fromkeys(phase.name for phase in phases))
    for phase in phases:
        # By name, so that a phase that recurs has the same shade.
        shade = _SHADES[names.index(phase.name) % len(_SHADES)]
        axes.axvspan(phase.start, phase.end, facecolor=shade, edgecolor="white", linewidth=0.8)
        axes.text(
            (phase.start + phase.end) / 2,
            0.5,
            verbatim(phase.name),
            ha="center",
            va="center",
            fontsize=_POINTS,
            color=INK,
            rotation=0 if _fits(phase, seconds, width) else 90,
            clip_on=True,
        )


def draw_events(axes: Axes, events: Mapping[str, float], seconds: float) -> None:
    """Mark events with dashed lines, and name them beside the lines."""
    for name, moment in events.items():
        axes.axvline(moment, color=GREY, linewidth=0.7, linestyle=(0, (2, 2)), zorder=1)
        is_early, is_high = moment < seconds / 2, _is_high(axes, moment)
        axes.annotate(
            verbatim(name.replace("_", " ")),
            (moment, 0.02 if is_high else 0.98),
            xycoords=("data", "axes fraction"),
            xytext=(1.5 if is_early else -1.5, 0),
            textcoords="offset points",
            annotation_clip=True,  # an event after the last sample would shrink the axes
            rotation=90,
            ha="left" if is_early else "right",
            va="bottom" if is_high else "top",
            fontsize=5,
            color="#5d6873",
        )


def _is_high(axes: Axes, moment: float) -> bool:
    """Return whether the first course in an axes is in the upper half at this time, where a name would hide it."""
    times, values = (np.asarray(each, dtype=float) for each in axes.lines[0].get_data())
    near = values[np.abs(times - moment) <= 0.05 * max(float(np.ptp(times)), 1e-9)] if len(times) else values
    near = near[np.isfinite(near)]
    return bool(len(near)) and float(near.mean()) > sum(axes.get_ylim()) / 2


def _inches(text: str) -> float:
    return len(text) * _POINTS * _LETTER / _INCH


def _fits(phase: PhaseSpan, seconds: float, width: float) -> bool:
    return _inches(phase.name) <= (phase.end - phase.start) / max(seconds, 1e-9) * width
