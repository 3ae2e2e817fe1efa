"""Whether the effect of one factor depends on another: lines that are not parallel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from robot_runner.analysis.figures.style import COLUMN, figure_style, looks, new_figure, verbatim, wrapped

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.figure import Figure

__all__ = ["Mean", "draw_interaction"]


@dataclass(frozen=True, slots=True)
class Mean:
    """The mean of one combination.

    Attributes:
        value: the mean.
        low, high: confidence interval of it, where one was computed.
    """

    value: float
    low: float | None = None
    high: float | None = None


@figure_style()
def draw_interaction(
    means: Mapping[str, Mapping[str, Mean]],
    *,
    treatments: Sequence[str],
    value_label: str,
    along: str,
    across: str,
) -> Figure:
    """Draw the mean of each combination of two factors, with its confidence interval.

    Args:
        means: by treatment of the second factor, then of the first.
        treatments: of the first factor, in order.
        value_label: the measure, with its unit.
        along: the first factor, along the horizontal axis.
        across: the second factor, one line for each of its treatments.
    """
    figure = new_figure(COLUMN, 2.5)
    axes = figure.subplots()
    shift = min(0.06, 0.3 / max(1, len(means)))
    for number, ((treatment, cells), look) in enumerate(zip(means.items(), looks(len(means)), strict=True)):
        offset = (number - (len(means) - 1) / 2) * shift
        places = [place for place, name in enumerate(treatments) if name in cells]
        points = [cells[treatments[place]] for place in places]
        at = [place + offset for place in places]
        axes.plot(
            at,
            [point.value for point in points],
            color=look.colour,
            linestyle=look.line,
            marker=look.marker,
            label=verbatim(treatment),
        )
        for x, point in zip(at, points, strict=True):
            if point.low is not None and point.high is not None:
                axes.plot([x, x], [point.low, point.high], color=look.colour, linewidth=0.8)
    axes.set_xticks(range(len(treatments)), [verbatim(name) for name in treatments])
    axes.set_xlim(-0.4, len(treatments) - 0.6)
    axes.set_xlabel(wrapped(along))
    axes.set_ylabel(wrapped(value_label))
    axes.grid(visible=True, axis="y")
    figure.legend(loc="outside lower center", ncols=min(len(means), 3), title=verbatim(across), title_fontsize=6.5)
    return figure
