"""The figure of a study's power: how often its effects are found, by the number of repetitions."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robot_runner.analysis.figures.style import (
    COLUMN,
    DASHED,
    GREY,
    add_legend,
    figure_style,
    label_axes,
    looks,
    new_figure,
    verbatim,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.figure import Figure

__all__ = ["draw_power"]


@figure_style()
def draw_power(curves: Mapping[str, Sequence[tuple[int, float, float, float]]], target: float) -> Figure:
    """Draw a curve for each set of assumptions, with the Monte Carlo error of each point.

    Args:
        curves: by their names: repetitions, power and the ends of its interval (0..1), by repetitions.
        target: the power that is asked for.
    """
    figure = new_figure(COLUMN, 2.5)
    axes = figure.subplots()
    axes.axhline(100 * target, color=GREY, linestyle=DASHED, linewidth=0.8)
    for (name, points), look in zip(curves.items(), looks(len(curves)), strict=True):
        places = [point[0] for point in points]
        shares = [100 * point[1] for point in points]
        errors = [[100 * max(0.0, point[1] - point[2]) for point in points]]
        errors.append([100 * max(0.0, point[3] - point[1]) for point in points])
        axes.errorbar(
            places,
            shares,
            yerr=errors,
            color=look.colour,
            marker=look.marker,
            linestyle=look.line,
            elinewidth=0.6,
            label=verbatim(name),
        )
    axes.set_ylim(0, 102)
    label_axes(axes, "Repetitions", "Power (%)", grid="both")
    add_legend(figure, len(curves), columns=2)
    return figure
