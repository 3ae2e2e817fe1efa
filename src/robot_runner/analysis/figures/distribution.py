"""How a measure is distributed in each group: a box, every run as a point, and a violin where there are enough."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from robot_runner.analysis.figures.style import (
    COLUMN,
    GREY,
    INK,
    Look,
    figure_style,
    looks,
    new_figure,
    verbatim,
    wrapped,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

__all__ = ["Group", "draw_distribution", "draw_quantiles"]


# Values of a measure, group by group.


@dataclass(frozen=True, slots=True)
class Group:
    """The values of the runs that had one treatment.

    Attributes:
        label: the treatment, or several with ` / ` between.
        values: one a run; none is missing.
        run_ids: the run of each value.
        mean_low, mean_high: confidence interval of the mean, where one was computed.

    Example:
        >>> Group("Video", (866.9, 877.5), ("r_3", "r_5")).label
        'Video'
    """

    label: str
    values: Sequence[float]
    run_ids: Sequence[str]
    mean_low: float | None = None
    mean_high: float | None = None

    @property
    def size(self) -> int:
        """How many runs there are."""
        return len(self.values)

    @property
    def mean(self) -> float:
        """The mean; there must be a run."""
        return sum(self.values) / len(self.values)


# Whether values are distributed normally: a Q-Q figure.


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


#: Fewer values than this make a density that says more about the method than about the values.
_ENOUGH_FOR_A_VIOLIN = 20
_MOST_UPRIGHT = 8  # groups beside each other; more lie beneath each other
_MOST_NAMED_OUTLIERS = 6
#: How far apart names must be so that none hides another, as a share of the range of all values.
_APART_UPRIGHT, _APART_ALONG = 0.05, 0.3
_ROW = 0.17
_HIGHEST = 8.5  # what a page holds, inches
_LONGEST_NAME = 28
_LETTERS_BESIDE = 46  # of names along the axis
_MANY_POINTS = 60
_MOST_NAMES = 60


@figure_style()
def draw_distribution(
    groups: Sequence[Group], *, value_label: str, group_label: str, outliers: frozenset[str] = frozenset()
) -> Figure:
    """Draw boxes (median, quartiles, Tukey's whiskers) with a point for each run and a diamond for the mean.

    Args:
        groups: in order; those without values keep their place.
        value_label: the measure, with its unit.
        group_label: the factor, or several.
        outliers: ids of the runs that are named.
    """
    is_upright = len(groups) <= _MOST_UPRIGHT
    height = 2.3 if is_upright else min(_HIGHEST, 0.6 + _ROW * len(groups))
    figure = new_figure(COLUMN, height)
    axes = figure.subplots()
    names = [_short(group.label) for group in groups]
    for place, (group, look) in enumerate(zip(groups, looks(len(groups)), strict=True)):
        if len(group.values):
            _draw_group(axes, place, group, look, is_upright=is_upright)
    _name_outliers(axes, groups, outliers, is_upright=is_upright)
    step = -(-max(1, len(groups)) // _MOST_NAMES)
    ticks = list(range(0, len(groups), step))
    if is_upright:
        is_crowded = sum(map(len, names)) > _LETTERS_BESIDE
        axes.set_xticks(ticks, names, rotation=30 if is_crowded else 0, ha="right" if is_crowded else "center")
        axes.set_xlim(-0.6, len(groups) - 0.4)
        axes.set_ylabel(wrapped(value_label))
        axes.set_xlabel(wrapped(group_label))
        axes.grid(visible=True, axis="y")
    else:
        axes.set_yticks(ticks, names[::step])
        axes.set_ylim(len(groups) - 0.4, -0.6)
        axes.set_xlabel(wrapped(value_label))
        axes.set_ylabel(wrapped(group_label))
        axes.grid(visible=True, axis="x")
    return figure


def _draw_group(axes: Axes, place: int, group: Group, look: Look, *, is_upright: bool) -> None:
    values = np.asarray(group.values, dtype=float)
    orientation: Literal["vertical", "horizontal"] = "vertical" if is_upright else "horizontal"
    if len(values) >= _ENOUGH_FOR_A_VIOLIN and np.ptp(values) > 0:
        parts = axes.violinplot(values, [place], widths=0.85, showextrema=False, orientation=orientation)
        bodies: Any = parts["bodies"]  # a list, whatever matplotlib declares
        for body in bodies:
            body.set(facecolor=look.colour, alpha=0.15, edgecolor="none")
    axes.boxplot(
        values,
        positions=[place],
        widths=0.5,
        orientation=orientation,
        manage_ticks=False,
        showfliers=False,
        patch_artist=True,
        boxprops={"facecolor": f"{look.colour}2e", "edgecolor": look.colour, "linewidth": 0.8},
        whiskerprops={"color": look.colour, "linewidth": 0.8},
        capprops={"color": look.colour, "linewidth": 0.8},
        medianprops={"color": look.colour, "linewidth": 1.6},
    )
    beside = place + _spread(values)
    xs, ys = (beside, values) if is_upright else (values, beside)
    axes.plot(
        xs,
        ys,
        linestyle="none",
        marker=look.marker,
        color=look.colour,
        markeredgecolor="white",
        markeredgewidth=0.35,
        markersize=3.4 if len(values) < _MANY_POINTS else 2.0,
        alpha=0.9,
        zorder=3,
    )
    _draw_mean(axes, place, group, is_upright=is_upright)


def _draw_mean(axes: Axes, place: int, group: Group, *, is_upright: bool) -> None:
    mean = float(np.mean(group.values))
    at = place + 0.36
    xs, ys = ([at], [mean]) if is_upright else ([mean], [at])
    axes.plot(xs, ys, marker="D", markersize=2.6, color="white", markeredgecolor=INK, markeredgewidth=0.8, zorder=4)
    if group.mean_low is not None and group.mean_high is not None:
        ends = [group.mean_low, group.mean_high]
        xs, ys = ([at, at], ends) if is_upright else (ends, [at, at])
        axes.plot(xs, ys, color=INK, linewidth=0.9, zorder=3.5)


def _spread(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how far each point steps aside, so that points of near values do not hide each other."""
    offsets = np.zeros(len(values))
    if len(values) < 2 or np.ptp(values) == 0:  # noqa: PLR2004 - one point hides no other
        return np.linspace(-0.15, 0.15, len(values)) if len(values) > 1 else offsets
    bins = np.digitize(values, np.linspace(values.min(), values.max(), 13))
    for each in np.unique(bins):
        members = np.flatnonzero(bins == each)
        if len(members) > 1:
            reach = min(0.2, 0.05 * len(members))
            offsets[members] = np.linspace(-reach, reach, len(members))
    return offsets


def _name_outliers(axes: Axes, groups: Sequence[Group], outliers: frozenset[str], *, is_upright: bool) -> None:
    if not outliers:
        return
    everything = [value for group in groups for value in group.values]
    apart = (_APART_UPRIGHT if is_upright else _APART_ALONG) * (max(everything) - min(everything))
    named = 0
    for place, group in enumerate(groups):
        last = -math.inf
        for value, run_id in sorted(zip(group.values, group.run_ids, strict=True)):
            if run_id in outliers and named < _MOST_NAMED_OUTLIERS and value - last >= apart:
                named, last = named + 1, value
                point = (place, value) if is_upright else (value, place)
                axes.annotate(
                    verbatim(run_id),
                    point,
                    xytext=(-4, 0) if is_upright else (0, 4),
                    textcoords="offset points",
                    fontsize=5.5,
                    ha="right" if is_upright else "center",
                    va="center" if is_upright else "bottom",
                )


def _short(label: str) -> str:
    return verbatim(label if len(label) <= _LONGEST_NAME else f"{label[: _LONGEST_NAME - 1]}…")
