"""The way that a robot took, seen from above."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from robot_runner.analysis.figures.style import COLUMN, INK, figure_style, looks, new_figure, verbatim

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

__all__ = ["Way", "draw_trajectories"]

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
