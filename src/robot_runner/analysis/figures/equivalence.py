"""Differences with their confidence intervals, beside what would not matter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from robot_runner.analysis.figures.style import COLUMN, GREY, INK, figure_style, looks, new_figure, verbatim, wrapped

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.figure import Figure

__all__ = ["Estimate", "draw_differences"]

_ROW = 0.24
_HIGHEST = 8.5
_LONGEST_NAME = 28


@dataclass(frozen=True, slots=True)
class Estimate:
    """The difference of one combination.

    Attributes:
        label: the combination.
        low, high: confidence interval of the difference.
        bound: what would not matter, in the same unit; None where nothing was stated.
    """

    label: str
    difference: float
    low: float
    high: float
    bound: float | None


@figure_style()
def draw_differences(estimates: Sequence[Estimate], *, value_label: str) -> Figure:
    """Draw a row for each combination: its difference, the confidence interval, and the bound as a shade.

    Args:
        estimates: in order.
        value_label: what the difference is of, with its unit.
    """
    figure = new_figure(COLUMN, min(_HIGHEST, 0.65 + _ROW * len(estimates)))
    axes = figure.subplots()
    axes.axvline(0.0, color=GREY, linewidth=0.7)
    for row, (estimate, look) in enumerate(zip(estimates, looks(len(estimates)), strict=True)):
        if estimate.bound is not None:
            axes.barh(row, 2 * estimate.bound, left=-estimate.bound, height=0.86, color="#e3e9ef", zorder=0.5)
        axes.plot([estimate.low, estimate.high], [row, row], color=INK, linewidth=1.1)
        axes.plot(estimate.difference, row, marker=look.marker, color=look.colour, markersize=4.5)
    names = [each.label if len(each.label) <= _LONGEST_NAME else f"{each.label[:27]}…" for each in estimates]
    axes.set_yticks(range(len(estimates)), [verbatim(name) for name in names])
    axes.set_ylim(len(estimates) - 0.4, -0.6)
    axes.set_xlabel(wrapped(value_label))
    axes.grid(visible=True, axis="x")
    return figure
