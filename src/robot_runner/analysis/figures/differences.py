"""Differences with their confidence intervals, beside what would not matter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from robot_runner.analysis.figures.style import COLUMN, GREY, INK, figure_style, looks, new_figure, verbatim, wrapped

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.figure import Figure

__all__ = ["Estimate", "draw_agreement", "draw_differences"]


# How far two ways of measuring agree: the figure of Bland and Altman (Lancet 327, 1986).

_MINUS = "\N{MINUS SIGN}"


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
    """Draw the difference of each pair over its mean, with bias and limits of agreement.

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
    for (name, values), look in zip(pairs.items(), looks(len(pairs)), strict=True):
        first, second = np.asarray(values, dtype=float).reshape(-1, 2).T
        axes.plot(
            (first + second) / 2,
            second - first,
            linestyle="none",
            marker=look.marker,
            color=look.colour,
            markeredgecolor="white",
            markeredgewidth=0.3,
            label=verbatim(name),
        )
    for level, word in ((bias, "bias"), (lower, "lower limit"), (upper, "upper limit")):
        if level is not None:
            axes.axhline(level, color=INK, linewidth=0.9, linestyle="-" if word == "bias" else (0, (5, 2)))
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
    axes.set_xlabel(wrapped(f"Mean of both: {value_label}"))
    tail = f" ({verbatim(unit)})" if unit else ""
    axes.set_ylabel(f"{verbatim(_short(names[1]))} less\n{verbatim(_short(names[0]))}{tail}")
    axes.grid(visible=True, axis="y")
    if len(pairs) > 1:
        figure.legend(loc="outside lower center", ncols=min(len(pairs), 3), handlelength=1.0)
    return figure


def _short(name: str) -> str:
    return name if len(name) <= 24 else f"{name[:23]}…"  # noqa: PLR2004 - what fits along the axis


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
