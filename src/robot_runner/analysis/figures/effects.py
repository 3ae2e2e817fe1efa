"""Figures of effects: interactions, differences between experiments, agreement, forest plots, curves of power."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.ticker import MaxNLocator

from robot_runner.analysis.figures.style import (
    COLUMN,
    DASHED,
    GREY,
    HIGHEST,
    INK,
    PAGE,
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
)
from robot_runner.analysis.wording import shown_interval, shown_number

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from robot_runner.analysis.figures.distribution import Group
    from robot_runner.analysis.statistics.tested import Interval

_ROW = 0.24  # height of a combination, inches


@figure_style()
def draw_interaction(
    groups: Mapping[str, Mapping[str, Group]], *, treatments: Sequence[str], value_label: str, along: str, across: str
) -> Figure:
    """Draw the mean of each combination of two factors; lines that are not parallel hint at an interaction.

    A line is broken where a combination has no runs.
    """
    figure, axes = new_axes(COLUMN, 2.5)
    shift = min(0.06, 0.3 / max(1, len(groups)))  # so that intervals do not overlap
    for number, (treatment, look) in enumerate(looks_by(groups).items()):
        offset = (number - (len(groups) - 1) / 2) * shift
        members = groups[treatment]
        points = [(place + offset, members.get(name)) for place, name in enumerate(treatments)]
        axes.plot(
            [at for at, _ in points],
            [math.nan if group is None else group.mean for _, group in points],
            color=look.colour,
            linestyle=look.line,
            marker=look.marker,
            label=verbatim(treatment),
        )
        for at, group in points:
            if group is not None and group.mean_low is not None and group.mean_high is not None:
                axes.plot([at, at], [group.mean_low, group.mean_high], color=look.colour, linewidth=0.8)
    name_places(figure, axes, treatments)
    axes.set_xlim(-0.4, len(treatments) - 0.6)
    label_axes(axes, along, value_label, grid="y")
    add_legend(figure, len(groups), title=verbatim(across), title_fontsize=6.5)
    return figure


@dataclass(frozen=True, slots=True)
class Estimate:
    """The difference of one combination, its confidence interval, and the largest one that does not matter, if any."""

    label: str
    difference: float
    low: float
    high: float
    bound: float | None


@figure_style()
def draw_differences(estimates: Sequence[Estimate], *, value_label: str) -> Figure:
    """Draw a row for each combination: its difference, the confidence interval, and the bound as a shade."""
    figure, axes = new_axes(COLUMN, min(HIGHEST, 0.65 + _ROW * len(estimates)))
    axes.axvline(0.0, color=GREY, linewidth=0.7)
    for row, (estimate, look) in enumerate(zip(estimates, looks(len(estimates)), strict=True)):
        if estimate.bound is not None:
            axes.barh(row, 2 * estimate.bound, left=-estimate.bound, height=0.86, color="#e3e9ef", zorder=0.5)
        axes.plot([estimate.low, estimate.high], [row, row], color=INK, linewidth=1.1)
        axes.plot(estimate.difference, row, marker=look.marker, color=look.colour, markersize=4.5)
    axes.set_yticks(range(len(estimates)), shortened_apart([each.label for each in estimates]))
    axes.set_ylim(len(estimates) - 0.4, -0.6)
    label_axes(axes, value_label, grid="x")
    return figure


@figure_style()
def draw_agreement(
    pairs: Mapping[str, Sequence[tuple[float, float]]],
    *,
    bias: float,
    lower: float | None,
    upper: float | None,
    value_label: str,
    names: tuple[str, str],
    unit: str,
) -> Figure:
    """Draw the difference of each pair over its mean, with bias and limits: Bland and Altman (Lancet 327, 1986)."""
    figure, axes = new_axes(COLUMN, 2.6)
    axes.axhline(0.0, color=GREY, linewidth=0.6)
    for name, look in looks_by(pairs).items():
        first, second = np.asarray(pairs[name], dtype=float).reshape(-1, 2).T
        draw_points(axes, (first + second) / 2, second - first, look, label=verbatim(name))
    for level, word in ((bias, "bias"), (lower, "lower limit"), (upper, "upper limit")):
        if level is not None and (word == "bias" or lower != upper):  # overlapping labels cannot be read
            axes.axhline(level, color=INK, linewidth=0.9, linestyle="-" if word == "bias" else DASHED)
            axes.annotate(
                f"{word} {'+' * (level > 0)}{shown_number(level)} {verbatim(unit)}".rstrip(),
                (1.0, level),
                xycoords=("axes fraction", "data"),
                xytext=(0, 1.5),
                textcoords="offset points",
                ha="right",
                va="bottom",
                fontsize=5.8,
            )
    axes.margins(y=0.14)
    label_axes(axes, f"Mean of both: {value_label}", grid="y")
    one, other = shortened_apart(names, 24)  # letters that fit along the axis
    axes.set_ylabel(f"{other} less\n{one}{f' ({verbatim(unit)})' if unit else ''}")
    add_legend(figure, len(pairs), handlelength=1.0)
    return figure


_LINE = 0.26  # height of a line, inches
_HEAVIEST = 9.0  # the side of the square for the whole weight, points
_LIGHTEST = 2.5
_HALF = 0.3  # half the height of a diamond, lines


@dataclass(frozen=True, slots=True)
class ForestLine:
    """A line of a forest plot.

    Attributes:
        label: the experiment, or the kind of average.
        estimate: None for a prediction, which has only an interval.
        interval: None where there is none.
        weight: the weight of an experiment, 0 to 1, drawn as the area of a square; None for an average, a diamond.
        runs, p_value, g: only for tables; `g` is Hedges' g.
    """

    label: str
    estimate: float | None = None
    interval: Interval | None = None
    weight: float | None = None
    runs: int | None = None
    p_value: float | None = None
    g: float | None = None

    @property
    def shown(self) -> str:
        """The estimate and its interval as text, for the right margin."""
        return f"{'' if self.estimate is None else shown_number(self.estimate)} {shown_interval(self.interval)}".strip()


@figure_style()
def draw_forest(lines: Sequence[ForestLine], *, value_label: str, average: float) -> Figure:
    """Draw a line for each experiment, then for the averages over them."""
    figure, axes = new_axes(PAGE, min(HIGHEST, 0.6 + _LINE * len(lines)))
    axes.axvline(0.0, color=GREY, linewidth=0.7)
    axes.axvline(average, color=GREY, linewidth=0.7, linestyle=DASHED)
    experiments = sum(line.weight is not None for line in lines)
    axes.axhline(experiments - 0.5, color=GREY, linewidth=0.5)
    for row, line in enumerate(lines):
        _draw_line(axes, row, line)
    axes.set_yticks(range(len(lines)), shortened_apart([line.label for line in lines]))
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


@figure_style()
def draw_power(curves: Mapping[str, Sequence[tuple[int, float, float, float]]], target: float) -> Figure:
    """Draw a curve for each set of assumptions, with the Monte Carlo error of each point."""
    figure, axes = new_axes(COLUMN, 2.5)
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
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    label_axes(axes, "Repetitions", "Power (%)", grid="both")
    add_legend(figure, len(curves), columns=2)
    return figure
