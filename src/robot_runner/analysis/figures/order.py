"""Whether a measure drifts while an experiment goes on."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.ticker import MaxNLocator

from robot_runner.analysis.figures.style import COLUMN, GREY, INK, figure_style, looks, new_figure, verbatim, wrapped

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.figure import Figure

__all__ = ["draw_run_order"]

_MOST_IN_LEGEND = 6


@figure_style()
def draw_run_order(
    places: Sequence[int],
    residuals: Sequence[float],
    labels: Sequence[str],
    *,
    order: Sequence[str],
    value_label: str,
    slope: float | None = None,
) -> Figure:
    """Draw what is left of a measure once its group's mean is taken away, over the order of execution.

    Args:
        places: of each run in the order of execution, from 1.
        residuals: each run's value less the mean of its combination.
        labels: each run's treatments.
        order: the treatments in the order in which all figures show them.
        value_label: the measure, with its unit.
        slope: of the line through the medians, in the measure's unit a run.
    """
    figure = new_figure(COLUMN, 2.1)
    axes = figure.subplots()
    axes.axhline(0.0, color=GREY, linewidth=0.6)
    x, y = np.asarray(places, dtype=float), np.asarray(residuals, dtype=float)
    for name, look in zip(order, looks(len(order)), strict=True):
        mine = np.asarray([label == name for label in labels])
        if not mine.any():
            continue
        axes.plot(
            x[mine],
            y[mine],
            linestyle="none",
            marker=look.marker,
            color=look.colour,
            markeredgecolor="white",
            markeredgewidth=0.3,
            label=verbatim(name),
        )
    if slope is not None and len(x):
        middle = float(np.median(y)) - slope * float(np.median(x))
        ends = np.array([x.min(), x.max()])
        axes.plot(ends, middle + slope * ends, color=INK, linestyle=(0, (5, 2)), linewidth=1.0)
    axes.set_xlabel("Place in the order of execution")
    axes.set_ylabel(f"{wrapped(value_label)}\nless the mean of its group")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.grid(visible=True, axis="y")
    if 1 < len(order) <= _MOST_IN_LEGEND:
        figure.legend(loc="outside lower center", ncols=min(len(order), 3), handlelength=1.0)
    return figure
