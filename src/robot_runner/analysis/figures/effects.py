"""When each run was executed, and what became of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.ticker import MaxNLocator

from robot_runner.analysis.figures.style import (
    COLUMN,
    GREY,
    INK,
    PAGE,
    figure_style,
    looks,
    new_figure,
    verbatim,
    wrapped,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["AttemptSpan", "Mean", "draw_interaction", "draw_run_order", "draw_timeline"]


# Whether the effect of one factor depends on another: lines that are not parallel.


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


# Whether a measure drifts while an experiment goes on.

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


_MOST_NAMED = 45
_MINUTES, _HOURS, _DAYS = 300.0, 3 * 3600.0, 3 * 86400.0
_FAILED = "#BB5566"


@dataclass(frozen=True, slots=True)
class AttemptSpan:
    """One attempt at a run.

    Attributes:
        run_id: which run.
        label: its treatments.
        start, end: s since the experiment began.
        measured: start and end of the measurement, where both are known.
        is_done: whether the run was done by it.
    """

    run_id: str
    label: str
    start: float
    end: float
    measured: tuple[float, float] | None
    is_done: bool


@figure_style()
def draw_timeline(spans: Sequence[AttemptSpan], *, order: Sequence[str], width: float = PAGE) -> Figure:
    """Draw a line for each run, with a bar for each attempt; what was measured is dark, what failed is hatched.

    Args:
        spans: in the order of execution.
        order: the treatments in the order in which all figures show them.
        width: of the figure, inches.
    """
    run_ids = list(dict.fromkeys(span.run_id for span in spans))
    rows = {run_id: place for place, run_id in enumerate(run_ids)}
    figure = new_figure(width, min(7.0, 0.75 + 0.13 * len(rows)))
    axes = figure.subplots()
    scale, unit = _scale(max((span.end for span in spans), default=1.0))
    for name, look in zip(order, looks(len(order)), strict=True):
        done = [span for span in spans if span.label == name and span.is_done]
        if done:
            _draw_done(axes, [rows[span.run_id] for span in done], done, look.colour, scale)
    failed = [span for span in spans if not span.is_done]
    _draw_failed(axes, [rows[span.run_id] for span in failed], failed, scale)
    step = max(1, -(-len(rows) // _MOST_NAMED))
    axes.set_yticks(range(0, len(rows), step), [verbatim(run_id) for run_id in run_ids[::step]], fontsize=6)
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.set_xlabel(f"Time since the experiment began ({unit})")
    axes.grid(visible=True, axis="x")
    if 1 < len(order) <= 6 and axes.get_legend_handles_labels()[0]:  # noqa: PLR2004 - more say nothing
        figure.legend(loc="outside lower center", ncols=6, handlelength=1.2)
    return figure


def _draw_done(axes: Axes, rows: list[int], spans: Sequence[AttemptSpan], colour: str, scale: float) -> None:
    whole = [(span.start / scale, span.end / scale) for span in spans]
    known = [span.measured or (span.start, span.end) for span in spans]
    measured = [(start / scale, end / scale) for start, end in known]
    for edges, alpha, label in ((whole, 0.3, None), (measured, 1.0, verbatim(spans[0].label))):
        starts = [start for start, _ in edges]
        widths = [end - start for start, end in edges]
        axes.barh(rows, widths, left=starts, height=0.7, facecolor=colour, alpha=alpha, label=label)


def _draw_failed(axes: Axes, rows: list[int], spans: Sequence[AttemptSpan], scale: float) -> None:
    ends = [span.end / scale for span in spans]
    widths = [(span.end - span.start) / scale for span in spans]
    starts = [span.start / scale for span in spans]
    axes.barh(rows, widths, left=starts, height=0.7, facecolor="white", edgecolor=_FAILED, hatch="/////", linewidth=0.8)
    axes.plot(ends, rows, linestyle="none", marker="x", markersize=4, color=INK)


def _scale(seconds: float) -> tuple[float, str]:
    if seconds < _MINUTES:
        return 1.0, "s"
    if seconds < _HOURS:
        return 60.0, "min"
    return (3600.0, "h") if seconds < _DAYS else (86400.0, "days")
