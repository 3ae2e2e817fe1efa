"""Figures of the values of all runs: box plots by treatment, Q-Q plots of residuals, residuals in the order of runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from matplotlib.ticker import MaxNLocator

from robot_runner.analysis.arrays import Floats
from robot_runner.analysis.figures.style import (
    COLUMN,
    DASHED,
    GREY,
    HIGHEST,
    INK,
    UPRIGHT_LINE,
    Look,
    add_legend,
    draw_points,
    figure_style,
    label_axes,
    looks,
    looks_by,
    name_places,
    new_axes,
    shortened_apart,
    verbatim,
    wrapped,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from robot_runner.analysis.statistics.outcome import Proportion

#: A density of fewer values shows more of the method than of the values.
_ENOUGH_FOR_A_VIOLIN = 20
#: Of more values, an even share has the same density, which takes as long to compute as there are values.
_MOST_OF_A_VIOLIN = 2_000
_MOST_UPRIGHT = 8  # groups beside each other; more are drawn as rows
_MOST_NAMED_OUTLIERS = 6
#: The smallest distance of names that do not overlap, as a share of the range of all values.
_APART_UPRIGHT, _APART_ALONG = 0.05, 0.3
#: Size of these names, and the width of a letter and of a figure's axes, points.
_NAME_SIZE, _LETTER, _AXES = 5.5, 3.3, 210
_ROW = 0.17  # height of a group in a row, inches
_BESIDE_NAMES = 26  # letters of a line beneath the half of the figure beside the groups' names
_MANY_POINTS = 60
_MOST_NAMES = 60


@dataclass(frozen=True, slots=True)
class Group:
    """The values of the runs with one treatment.

    Attributes:
        label: the treatment, or several separated by ` / `.
        values: one for each run; none is missing.
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
        """The number of runs."""
        return len(self.values)

    @property
    def mean(self) -> float:
        """The mean; there must be a run."""
        return sum(self.values) / len(self.values)


@figure_style()
def draw_distribution(
    groups: Sequence[Group], *, value_label: str, group_label: str, outliers: frozenset[str] = frozenset()
) -> Figure:
    """Draw box plots (median, quartiles, Tukey's whiskers) with a point for each run and a diamond for the mean."""
    is_upright = len(groups) <= _MOST_UPRIGHT
    figure, axes = new_axes(COLUMN, 2.3 if is_upright else min(HIGHEST, 0.6 + _ROW * len(groups)))
    for place, (group, look) in enumerate(zip(groups, looks(len(groups)), strict=True)):
        if group.size:
            _draw_group(axes, place, group, look, is_upright=is_upright)
    _name_outliers(axes, groups, outliers, is_upright=is_upright)
    _name_groups(figure, axes, [group.label for group in groups], value_label, group_label)
    return figure


@figure_style()
def draw_proportions(
    groups: Sequence[Proportion], *, value_label: str, group_label: str, order: Sequence[str] = ()
) -> Figure:
    """Draw a point for the percentage of each group, with its confidence interval if it has one.

    `order` has all treatments, where some have no group, so that the others look as in figures of all.
    """
    is_upright = len(groups) <= _MOST_UPRIGHT
    figure, axes = new_axes(COLUMN, 2.3 if is_upright else min(HIGHEST, 0.6 + _ROW * len(groups)))
    by_name = looks_by(dict.fromkeys([*order, *(group.label for group in groups)]))
    for place, group in enumerate(groups):
        if group.percent is None:
            continue
        look = by_name[group.label]
        ends = group.interval
        reach = None if ends is None else [[group.percent - ends.low], [ends.high - group.percent]]
        drawn: dict[str, Any] = {"color": look.colour, "marker": "D", "markersize": 4.0, "capsize": 3.0}
        drawn["yerr" if is_upright else "xerr"] = reach
        axes.errorbar(*_turned([place], [group.percent], is_upright), **drawn)
    (axes.set_ylim if is_upright else axes.set_xlim)(-3, 103)  # so that points at 0 and 100 % are visible
    _name_groups(figure, axes, [group.label for group in groups], value_label, group_label)
    return figure


def _name_groups(figure: Figure, axes: Axes, labels: Sequence[str], value_label: str, group_label: str) -> None:
    """Name the groups of a figure, along the x axis if they are few."""
    names = shortened_apart(labels)
    if len(names) <= _MOST_UPRIGHT:
        name_places(figure, axes, labels)
        axes.set_xlim(-0.6, len(names) - 0.4)
        label_axes(axes, group_label, value_label, grid="y")
    else:
        step = -(-len(names) // _MOST_NAMES)
        axes.set_yticks(range(0, len(names), step), names[::step])
        axes.set_ylim(len(names) - 0.4, -0.6)
        label_axes(axes, "", group_label, grid="x")
        axes.set_xlabel(wrapped(value_label, _BESIDE_NAMES))


def _draw_group(axes: Axes, place: int, group: Group, look: Look, *, is_upright: bool) -> None:
    values = np.asarray(group.values, dtype=float)
    orientation: Literal["vertical", "horizontal"] = "vertical" if is_upright else "horizontal"
    if len(values) >= _ENOUGH_FOR_A_VIOLIN and np.ptp(values) > 0:
        share = -(-len(values) // _MOST_OF_A_VIOLIN)
        parts = axes.violinplot(
            np.sort(values)[::share],
            [place],
            widths=0.85,
            showextrema=False,
            orientation=orientation,
            bw_method=len(values) ** -0.2 if share > 1 else None,  # Scott's, as for all values
        )
        bodies: Any = parts["bodies"]  # a list, whatever matplotlib declares
        for body in bodies:
            body.set(facecolor=look.colour, alpha=0.15, edgecolor="none")
    thin = {"color": look.colour, "linewidth": 0.8}
    axes.boxplot(
        values,
        positions=[place],
        widths=0.5,
        orientation=orientation,
        manage_ticks=False,
        showfliers=False,
        patch_artist=True,
        boxprops={"facecolor": f"{look.colour}2e", "edgecolor": look.colour, "linewidth": 0.8},
        whiskerprops=thin,
        capprops=thin,
        medianprops={"color": look.colour, "linewidth": 1.6},
    )
    size = 3.4 if len(values) < _MANY_POINTS else 2.0
    spread = place + _spread(values)
    draw_points(axes, *_turned(spread, values, is_upright), look, edge=0.35, markersize=size, alpha=0.9, zorder=3)
    at = place + 0.36
    diamond: dict[str, Any] = {"color": "white", "markeredgecolor": INK, "markeredgewidth": 0.8, "zorder": 4}
    axes.plot(*_turned([at], [float(values.mean())], is_upright), marker="D", markersize=2.6, **diamond)
    if group.mean_low is not None and group.mean_high is not None:
        ends = [group.mean_low, group.mean_high]
        axes.plot(*_turned([at, at], ends, is_upright), color=INK, linewidth=0.9, zorder=3.5)


def _turned(places: Any, values: Any, is_upright: bool) -> tuple[Any, Any]:
    return (places, values) if is_upright else (values, places)


def _spread(values: Floats) -> Floats:
    """Return a sideways offset for each point, so that points of similar values do not hide each other."""
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
    # Left of the first group are the numbers of the axis.
    is_left = 4 + _LETTER * max(map(len, outliers)) < _AXES * 0.6 / len(groups)
    found = []
    for place, group in enumerate(groups):
        middle = np.median(group.values) if group.size else 0.0
        each_run = zip(group.values, group.run_ids, strict=True)
        found += [(-abs(value - middle), place, value, run_id) for value, run_id in each_run if run_id in outliers]
    named: list[tuple[int, float]] = []
    for _, place, value, run_id in sorted(found):  # the farthest from their medians first
        is_free = all(place != other or abs(value - at) >= apart for other, at in named)
        if is_free and len(named) < _MOST_NAMED_OUTLIERS:
            named.append((place, value))
            axes.annotate(
                verbatim(run_id),
                _turned(place, value, is_upright),
                xytext=(-4 if is_left else 4, 0) if is_upright else (0, 4),
                textcoords="offset points",
                fontsize=_NAME_SIZE,
                ha=("right" if is_left else "left") if is_upright else "center",
                va="center" if is_upright else "bottom",
            )


@figure_style()
def draw_quantiles(
    theoretical: Sequence[float], observed: Sequence[float], *, slope: float, intercept: float, value_label: str
) -> Figure:
    """Draw a Q-Q plot: residuals against quantiles of the standard normal distribution; normal ones lie on the line."""
    width = COLUMN * 0.75
    figure, axes = new_axes(width, width * 0.85)
    ends = [min(theoretical, default=-1.0), max(theoretical, default=1.0)]
    axes.plot(ends, [intercept + slope * end for end in ends], color=GREY, linestyle=DASHED, linewidth=0.9)
    draw_points(axes, theoretical, observed, looks(1)[0])
    label_axes(axes, "Quantile of the normal distribution", f"Residual of {value_label}", grid="both")
    return figure


@figure_style()
def draw_run_order(
    places: Sequence[int],
    residuals: Sequence[float],
    labels: Sequence[str],
    *,
    order: Sequence[str],
    value_label: str,
    place_label: str = "Place in the order of execution",
    slope: float | None = None,
) -> Figure:
    """Draw the residuals of a measure's model over the order of execution."""
    figure, axes = new_axes(COLUMN, 2.1)
    axes.axhline(0.0, color=GREY, linewidth=0.6)
    x, y = np.asarray(places, dtype=float), np.asarray(residuals, dtype=float)
    for name, look in looks_by(order).items():
        mine = np.asarray([label == name for label in labels])
        if mine.any():
            draw_points(axes, x[mine], y[mine], look, label=verbatim(name))
    if slope is not None and len(x):
        middle = float(np.median(y)) - slope * float(np.median(x))
        ends = np.array([x.min(), x.max()])
        axes.plot(ends, middle + slope * ends, color=INK, linestyle=DASHED, linewidth=1.0)
    label_axes(axes, place_label, grid="y")
    axes.set_ylabel(f"{wrapped(value_label, UPRIGHT_LINE)}\nresidual")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    add_legend(figure, len(order), most=6, handlelength=1.0)
    return figure
