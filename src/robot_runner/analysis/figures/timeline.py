"""When each run was executed, and what became of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from robot_runner.analysis.figures.style import INK, PAGE, figure_style, looks, new_figure, verbatim

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["AttemptSpan", "draw_timeline"]

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
