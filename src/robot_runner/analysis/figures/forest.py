"""Forest plots: what each experiment says of one effect, what all say together, and what a further one may find."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from robot_runner.analysis.figures.style import (
    DASHED,
    GREY,
    HIGHEST,
    INK,
    PAGE,
    figure_style,
    label_axes,
    looks,
    new_figure,
    shortened,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from robot_runner.analysis.statistics.tested import Interval

__all__ = ["ForestLine", "draw_forest"]

_ROW = 0.26  # height of a line, inches
_HEAVIEST = 9.0  # the side of the square of an experiment that has all the weight, points
_LIGHTEST = 2.5
_HALF = 0.3  # half the height of a diamond, lines


@dataclass(frozen=True, slots=True)
class ForestLine:
    """A line of a forest plot.

    Attributes:
        label: the experiment, or which average it is.
        estimate: None for where the effect in a further experiment is expected, which is an interval alone.
        interval: None where there is none.
        weight: the share of an experiment, 0 to 1, as the area of a square; None for an average, which is a diamond.
        shown: the numbers in words, which stand on the right.
    """

    label: str
    estimate: float | None
    interval: Interval | None
    weight: float | None
    shown: str


@figure_style()
def draw_forest(lines: Sequence[ForestLine], *, value_label: str, average: float) -> Figure:
    """Draw a line for each experiment, then for the averages over them.

    Args:
        lines: in order.
        value_label: what the difference is of, with its unit.
        average: where a dashed line stands.
    """
    figure = new_figure(PAGE, min(HIGHEST, 0.6 + _ROW * len(lines)))
    axes = figure.subplots()
    axes.axvline(0.0, color=GREY, linewidth=0.7)
    axes.axvline(average, color=GREY, linewidth=0.7, linestyle=DASHED)
    experiments = sum(line.weight is not None for line in lines)
    axes.axhline(experiments - 0.5, color=GREY, linewidth=0.5)
    for row, line in enumerate(lines):
        _draw_line(axes, row, line)
    axes.set_yticks(range(len(lines)), [shortened(line.label) for line in lines])
    axes.set_ylim(len(lines) - 0.4, -0.6)
    numbers = axes.secondary_yaxis("right")
    numbers.set_yticks(range(len(lines)), [line.shown for line in lines])
    numbers.tick_params(length=0)
    numbers.spines["right"].set_visible(False)
    label_axes(axes, value_label, grid="x")
    return figure


def _draw_line(axes: Axes, row: int, line: ForestLine) -> None:
    experiment, average, prediction = looks(3)
    ends = None if line.interval is None else [line.interval.low, line.interval.high]
    if line.estimate is None:
        if ends is not None:
            axes.plot(ends, [row, row], color=prediction.colour, linewidth=3.0, solid_capstyle="butt")
    elif line.weight is not None:
        if ends is not None:
            axes.plot(ends, [row, row], color=INK, linewidth=1.1)
        size = max(_LIGHTEST, _HEAVIEST * line.weight**0.5)
        axes.plot(line.estimate, row, marker="s", color=experiment.colour, markersize=size)
    elif ends is not None:
        corners = ([ends[0], line.estimate, ends[1], line.estimate], [row, row - _HALF, row, row + _HALF])
        axes.fill(*corners, color=average.colour, linewidth=0)
    else:
        axes.plot(line.estimate, row, marker="d", color=average.colour, markersize=_HEAVIEST / 2)
