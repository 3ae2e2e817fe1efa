"""The phases of a mission, drawn as a strip above a course, and as shades behind it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from robot_runner.analysis.figures.style import GREY, INK, verbatim

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.axes import Axes

__all__ = ["PhaseSpan", "draw_events", "draw_phase_names", "shade_phases", "strip_height"]

_SHADES = ("#f1f4f7", "#dfe5eb")
_POINTS = 5.8
#: The mean width of a letter of DejaVu Sans, as a share of the size of the font.
_LETTER = 0.62
_INCH = 72.0


@dataclass(frozen=True, slots=True)
class PhaseSpan:
    """One phase of a mission.

    Attributes:
        name: what the robot does in it.
        start, end: s since the start of measurement.
    """

    name: str
    start: float
    end: float


def shade_phases(axes: Axes, phases: Sequence[PhaseSpan]) -> None:
    """Shade every other phase, so that the borders are seen behind the course."""
    for place, phase in enumerate(phases):
        if place % 2:
            axes.axvspan(phase.start, phase.end, color=_SHADES[0], linewidth=0, zorder=0)


def strip_height(phases: Sequence[PhaseSpan], seconds: float, width: float) -> float:
    """Return how high the strip of names must be, inches.

    Args:
        phases: what is named in it.
        seconds: what the width of the figure stands for, s.
        width: of the figure, inches.
    """
    upright = [phase.name for phase in phases if not _fits(phase, seconds, width)]
    return 0.14 if not upright else 0.12 + max(map(_inches, upright))


def draw_phase_names(axes: Axes, phases: Sequence[PhaseSpan], seconds: float, width: float) -> None:
    """Fill an axes with a box and a name for each phase; names that do not fit stand upright."""
    axes.set_axis_off()
    axes.set_ylim(0, 1)
    shades = _shades(phases)
    for phase in phases:
        axes.axvspan(phase.start, phase.end, facecolor=shades[phase.name], edgecolor="white", linewidth=0.8)
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
    """Mark events with dashed lines, and name them beside the lines.

    Args:
        axes: of a course.
        events: when they were, s since the start of measurement, by name.
        seconds: what the width of the figure stands for, s.
    """
    for name, moment in events.items():
        axes.axvline(moment, color=GREY, linewidth=0.7, linestyle=(0, (2, 2)), zorder=1)
        is_early, is_high = moment < seconds / 2, _is_high(axes, moment)
        axes.annotate(
            verbatim(name.replace("_", " ")),
            (moment, 0.02 if is_high else 0.98),
            xycoords=("data", "axes fraction"),
            xytext=(1.5 if is_early else -1.5, 0),
            textcoords="offset points",
            rotation=90,
            ha="left" if is_early else "right",
            va="bottom" if is_high else "top",
            fontsize=5,
            color="#5d6873",
        )


def _is_high(axes: Axes, moment: float) -> bool:
    """Whether the first course in an axes is in its upper half at this moment, where a name would hide it."""
    if not axes.lines:
        return False
    times, values = (np.asarray(each, dtype=float) for each in axes.lines[0].get_data())
    near = values[np.abs(times - moment) <= 0.05 * max(float(np.ptp(times)), 1e-9)] if len(times) else values
    near = near[np.isfinite(near)]
    return bool(len(near)) and float(near.mean()) > sum(axes.get_ylim()) / 2


def _shades(phases: Sequence[PhaseSpan]) -> dict[str, str]:
    """Return a shade for each name, so that the same phase looks the same wherever it comes."""
    names = list(dict.fromkeys(phase.name for phase in phases))
    steps = ("#eef1f4", "#c9d3dd", "#dde4ea", "#b7c4d1")
    return {name: steps[place % len(steps)] for place, name in enumerate(names)}


def _inches(text: str) -> float:
    return len(text) * _POINTS * _LETTER / _INCH


def _fits(phase: PhaseSpan, seconds: float, width: float) -> bool:
    return _inches(phase.name) <= (phase.end - phase.start) / max(seconds, 1e-9) * width
