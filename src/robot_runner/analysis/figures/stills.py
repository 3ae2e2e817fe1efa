"""The figure of stills: what a camera saw of runs, a row each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from matplotlib.image import imread

from robot_runner.analysis.figures.style import GREY, HIGHEST, PAGE, new_figure, shortened

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from matplotlib.figure import Figure

__all__ = ["RunStills", "draw_stills"]

_LETTERS = 24


@dataclass(frozen=True, slots=True)
class RunStills:
    """The stills of one run.

    Attributes:
        name: the run and its treatments.
        stills: what each shows, and its file.
    """

    name: str
    stills: tuple[tuple[str, Path], ...]


def draw_stills(runs: Sequence[RunStills]) -> Figure:
    """Draw the stills of runs, a row for each run; a file that cannot be read leaves its place empty."""
    columns = max(len(run.stills) for run in runs)
    figure = new_figure(PAGE, min(HIGHEST, len(runs) * (0.68 * PAGE / columns + 0.2)))
    grid = figure.subplots(len(runs), columns, squeeze=False)
    for places, run in zip(grid, runs, strict=True):
        for number, axes in enumerate(places):
            axes.set_axis_off()
            if number >= len(run.stills):
                continue
            label, path = run.stills[number]
            before = f"{run.name}: " if number == 0 else ""
            axes.set_title(shortened(before + label, _LETTERS), fontsize="small", loc="left")
            try:
                axes.imshow(imread(path))
            except (OSError, ValueError, SyntaxError):  # Pillow raises the last for a damaged file
                axes.text(0.5, 0.5, "no picture", color=GREY, ha="center", va="center", transform=axes.transAxes)
    return figure
