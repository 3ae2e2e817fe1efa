"""Figures as files: SVG, PDF and PNG."""

from __future__ import annotations

import io
import re
import unicodedata
from enum import Enum
from typing import TYPE_CHECKING

import numpy as np

from robot_runner.analysis.figures.style import figure_style

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.artist import Artist
    from matplotlib.figure import Figure

__all__ = ["FigureFormat", "figure_bytes", "file_name"]

_LONGEST = 80

#: Of so many points nobody tells one from the other.
_CROWD = 600
_NO_MARKERS = (None, "", " ", "none", "None")


class FigureFormat(Enum):
    """The kinds of files."""

    SVG = "svg"
    PDF = "pdf"
    PNG = "png"


#: Of a position on a figure, as a share of its size: a tenth of a pixel.
_DIGITS = 4
#: What journals ask of line art at least; in SVG, which a page holds dozens of, only crowds are pixels.
_DPI = {FigureFormat.SVG: 150, FigureFormat.PDF: 300, FigureFormat.PNG: 300}
#: No dates, so that the same figure is the same file.
_METADATA = {
    FigureFormat.SVG: {"Date": None},
    FigureFormat.PDF: {"CreationDate": None},
    FigureFormat.PNG: {},
}


def figure_bytes(figure: Figure, kind: FigureFormat) -> bytes:
    """Return a figure as the content of a file."""
    into = io.BytesIO()
    with figure_style():
        _settle(figure)
        _flatten_crowds(figure)
        figure.savefig(into, format=kind.value, dpi=_DPI[kind], metadata=_METADATA[kind])
    return into.getvalue()


def _settle(figure: Figure) -> None:
    """Lay the figure out once, and round: the last digits of the solver differ from process to process."""
    if figure.get_layout_engine() is None:
        return
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    for axes in figure.axes:
        left, bottom, width, height = (round(edge, _DIGITS) for edge in axes.get_position().bounds)
        axes.set_position((left, bottom, width, height))


def _flatten_crowds(figure: Figure) -> None:
    """Have crowds of points and bars kept as pixels in SVG and PDF too, which would hold some 200 bytes for each."""
    for axes in figure.axes:
        points = [line for line in axes.lines if line.get_marker() not in _NO_MARKERS]
        crowds: tuple[Sequence[Artist], ...] = (points, axes.patches)
        sizes = (sum(np.size(line.get_xdata(orig=False)) for line in points), len(axes.patches))
        for artists, size in zip(crowds, sizes, strict=True):
            for artist in artists if size > _CROWD else ():
                artist.set_rasterized(True)


def file_name(text: str) -> str:
    """Return a name of letters, digits, hyphens and underscores that any file system, URL and LaTeX takes.

    Example:
        >>> file_name("Energy (J) of ../Größe")
        'Energy_J_of_Grosse'
    """
    plain = unicodedata.normalize("NFKD", text.replace("ß", "ss")).encode("ascii", "ignore").decode()
    return re.sub(r"[^A-Za-z0-9-]+", "_", plain).strip("_")[:_LONGEST] or "unnamed"
