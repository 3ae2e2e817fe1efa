"""Figures of effects: interactions of two factors, differences between experiments, agreement of two measures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from robot_runner.analysis.figures.style import (
    COLUMN,
    DASHED,
    GREY,
    HIGHEST,
    INK,
    add_legend,
    draw_points,
    figure_style,
    label_axes,
    looks,
    looks_by,
    new_figure,
    shortened,
    verbatim,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.figure import Figure

    from robot_runner.analysis.figures.distribution import Group

__all__ = ["Estimate", "draw_agreement", "draw_differences", "draw_interaction"]

_MINUS = "\N{MINUS SIGN}"
_ROW = 0.24  # height of a combination, inches


@figure_style()
def draw_interaction(
    groups: Mapping[str, Mapping[str, Group]],
    *,
    treatments: Sequence[str],
    value_label: str,
    along: str,
    across: str,
) -> Figure:
    """Draw the mean of each combination of two factors; lines that are not parallel hint at an interaction.

    Args:
        groups: by treatment of the second factor, then of the first; those without a run are left out.
        treatments: of the first factor, in order.
        value_label: the measure, with its unit.
        along: the first factor, along the horizontal axis.
        across: the second factor, one line for each of its treatments.
    """
    figure = new_figure(COLUMN, 2.5)
    axes = figure.subplots()
    shift = min(0.06, 0.3 / max(1, len(groups)))  # so that intervals stand beside each other
    for number, (treatment, look) in enumerate(looks_by(groups).items()):
        offset = (number - (len(groups) - 1) / 2) * shift
        members = groups[treatment]
        points = [(place + offset, members[name]) for place, name in enumerate(treatments) if name in members]
        means = [group.mean for _, group in points]
        axes.plot(
            [at for at, _ in points],
            means,
            color=look.colour,
            linestyle=look.line,
            marker=look.marker,
            label=verbatim(treatment),
        )
        for at, group in points:
            if group.mean_low is not None and group.mean_high is not None:
                axes.plot([at, at], [group.mean_low, group.mean_high], color=look.colour, linewidth=0.8)
    axes.set_xticks(range(len(treatments)), [verbatim(name) for name in treatments])
    axes.set_xlim(-0.4, len(treatments) - 0.6)
    label_axes(axes, along, value_label, grid="y")
    add_legend(figure, len(groups), title=verbatim(across), title_fontsize=6.5)
    return figure


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
    figure = new_figure(COLUMN, min(HIGHEST, 0.65 + _ROW * len(estimates)))
    axes = figure.subplots()
    axes.axvline(0.0, color=GREY, linewidth=0.7)
    for row, (estimate, look) in enumerate(zip(estimates, looks(len(estimates)), strict=True)):
        if estimate.bound is not None:
            axes.barh(row, 2 * estimate.bound, left=-estimate.bound, height=0.86, color="#e3e9ef", zorder=0.5)
        axes.plot([estimate.low, estimate.high], [row, row], color=INK, linewidth=1.1)
        axes.plot(estimate.difference, row, marker=look.marker, color=look.colour, markersize=4.5)
    axes.set_yticks(range(len(estimates)), [shortened(each.label) for each in estimates])
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
    """Draw the difference of each pair over its mean, with bias and limits: Bland and Altman (Lancet 327, 1986).

    Args:
        pairs: by treatment: value of the first and of the second.
        bias: mean difference, second less first.
        lower: lower limit of agreement, where there is one.
        upper: upper limit of agreement.
        value_label: the measure, with its unit.
        names: of the first and the second.
        unit: of the measure.
    """
    figure = new_figure(COLUMN, 2.6)
    axes = figure.subplots()
    axes.axhline(0.0, color=GREY, linewidth=0.6)
    for name, look in looks_by(pairs).items():
        first, second = np.asarray(pairs[name], dtype=float).reshape(-1, 2).T
        draw_points(axes, (first + second) / 2, second - first, look, label=verbatim(name))
    for level, word in ((bias, "bias"), (lower, "lower limit"), (upper, "upper limit")):
        if level is not None:
            axes.axhline(level, color=INK, linewidth=0.9, linestyle="-" if word == "bias" else DASHED)
            axes.annotate(
                f"{word} {level:+.4g} {verbatim(unit)}".rstrip().replace("-", _MINUS),
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
    one, other = (shortened(name, 24) for name in names)  # what fits along the axis
    axes.set_ylabel(f"{other} less\n{one}{f' ({verbatim(unit)})' if unit else ''}")
    add_legend(figure, len(pairs), handlelength=1.0)
    return figure
