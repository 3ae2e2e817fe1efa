"""Figures of response surfaces: contours over two factors, or the curve over one."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from robot_runner.analysis.figures.style import COLUMN, DASHED, INK, figure_style, label_axes, new_figure

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

__all__ = ["Axis", "draw_contours", "draw_curve"]

_LEVELS = 9


class Axis(NamedTuple):
    """A factor that a surface is drawn over.

    Attributes:
        label: for the axis.
        numbers: where the surface is computed, in ascending order.
        runs: the treatment of each run.
        stationary: where the surface neither rises nor falls; None where it does not lie in the figure.
    """

    label: str
    numbers: Floats
    runs: Sequence[float]
    stationary: float | None


@figure_style()
def draw_contours(along: Axis, across: Axis, heights: Floats, value_label: str) -> Figure:
    """Draw lines of one height, the runs as points, and the stationary point as a cross.

    Args:
        along: the factor of the horizontal axis.
        across: that of the vertical one.
        heights: of the surface, (numbers across, numbers along).
        value_label: of the measure.
    """
    figure = new_figure(COLUMN, 3.0)
    axes = figure.subplots()
    filled = axes.contourf(along.numbers, across.numbers, heights, levels=_LEVELS, cmap="cividis", alpha=0.6)
    lines = axes.contour(along.numbers, across.numbers, heights, levels=filled.levels, colors=INK, linewidths=0.5)
    axes.clabel(lines, fontsize=6, fmt="%.4g")
    axes.scatter(along.runs, across.runs, s=12, facecolors="white", edgecolors=INK, linewidths=0.6, zorder=3)
    if along.stationary is not None and across.stationary is not None:
        axes.scatter([along.stationary], [across.stationary], s=40, marker="x", color=INK, zorder=4)
    figure.colorbar(filled, ax=axes, label=value_label)
    label_axes(axes, along.label, across.label, grid="both")
    return figure


@figure_style()
def draw_curve(along: Axis, heights: Floats, values: Sequence[float], value_label: str) -> Figure:
    """Draw the curve over a single factor, with the value of each run.

    Args:
        along: the factor.
        heights: of the curve.
        values: of the runs.
        value_label: of the measure.
    """
    figure = new_figure(COLUMN, 2.5)
    axes = figure.subplots()
    axes.plot(along.numbers, heights, color=INK)
    axes.scatter(along.runs, values, s=12, facecolors="white", edgecolors=INK, linewidths=0.6, zorder=3)
    if along.stationary is not None:
        axes.axvline(along.stationary, color=INK, linestyle=DASHED, linewidth=0.8)
    label_axes(axes, along.label, value_label, grid="both")
    return figure
