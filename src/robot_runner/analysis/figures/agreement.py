"""How far two ways of measuring agree: the figure of Bland and Altman (Lancet 327, 1986)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from robot_runner.analysis.figures.style import COLUMN, GREY, INK, figure_style, looks, new_figure, verbatim, wrapped

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.figure import Figure

__all__ = ["draw_agreement"]

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
