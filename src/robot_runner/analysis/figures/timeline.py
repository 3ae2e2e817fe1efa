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
    by_name = dict(zip(order, looks(len(order)), strict=True))
    scale, unit = _scale(max((span.end for span in spans), default=1.0))
    places = {verbatim(name): place for place, name in enumerate(order)}
    named: set[str] = set()
    for span in spans:
        look = by_name[span.label]
        label = verbatim(span.label) if span.label and span.label not in named else None
        named.add(span.label)
        _draw_span(axes, rows[span.run_id], span, look.colour, scale, label)
    step = max(1, -(-len(rows) // _MOST_NAMED))
    axes.set_yticks(range(0, len(rows), step), [verbatim(run_id) for run_id in run_ids[::step]], fontsize=6)
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.set_xlabel(f"Time since the experiment began ({unit})")
    axes.grid(visible=True, axis="x")
    if 1 < len(order) <= 6:  # noqa: PLR2004 - more say nothing
        handles, shown = axes.get_legend_handles_labels()
        handles = [handle for _, handle in sorted(zip(shown, handles, strict=True), key=lambda each: places[each[0]])]
        figure.legend(handles=handles, loc="outside lower center", ncols=6, handlelength=1.2)
    return figure


def _draw_span(axes: Axes, row: int, span: AttemptSpan, colour: str, scale: float, label: str | None) -> None:
    start, end = span.start / scale, span.end / scale
    if not span.is_done:
        axes.barh(
            row, end - start, left=start, height=0.7, facecolor="white", edgecolor=_FAILED, hatch="/////", linewidth=0.8
        )
        axes.plot(end, row, marker="x", markersize=4, color=INK)
        return
    axes.barh(row, end - start, left=start, height=0.7, facecolor=colour, alpha=0.3)
    first, last = (span.start, span.end) if span.measured is None else span.measured
    axes.barh(row, (last - first) / scale, left=first / scale, height=0.7, facecolor=colour, label=label)


def _scale(seconds: float) -> tuple[float, str]:
    if seconds < _MINUTES:
        return 1.0, "s"
    if seconds < _HOURS:
        return 60.0, "min"
    return (3600.0, "h") if seconds < _DAYS else (86400.0, "days")
