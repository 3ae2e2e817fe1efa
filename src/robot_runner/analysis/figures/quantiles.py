"""Whether values are distributed normally: a Q-Q figure."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robot_runner.analysis.figures.style import COLUMN, GREY, figure_style, looks, new_figure, wrapped

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.figure import Figure

__all__ = ["draw_quantiles"]


@figure_style()
def draw_quantiles(
    theoretical: Sequence[float],
    observed: Sequence[float],
    *,
    slope: float,
    intercept: float,
    value_label: str,
    width: float = COLUMN * 0.75,
) -> Figure:
    """Draw residuals against the quantiles of the standard normal distribution; on the line they are normal.

    Args:
        theoretical: quantiles of the standard normal distribution.
        observed: the residuals, in ascending order.
        slope: of the line of reference.
        intercept: of the line of reference.
        value_label: the measure, with its unit.
        width: of the figure, inches.
    """
    figure = new_figure(width, width * 0.85)
    axes = figure.subplots()
    ends = [min(theoretical, default=-1.0), max(theoretical, default=1.0)]
    axes.plot(ends, [intercept + slope * end for end in ends], color=GREY, linestyle=(0, (5, 2)), linewidth=0.9)
    [look] = looks(1)
    axes.plot(
        theoretical,
        observed,
        linestyle="none",
        marker="o",
        color=look.colour,
        markeredgecolor="white",
        markeredgewidth=0.3,
    )
    axes.set_xlabel("Quantile of the normal distribution")
    axes.set_ylabel(wrapped(f"Residual of {value_label}"))
    axes.grid(visible=True)
    return figure
