"""Figures as files: SVG, PDF and PNG."""

from __future__ import annotations

import io
import re
import unicodedata
from enum import Enum
from typing import TYPE_CHECKING

from robot_runner.analysis.figures.style import figure_style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["FigureFormat", "figure_bytes", "file_name"]

_PNG_DPI = 300  # what journals ask of line art at least
_LONGEST = 80


class FigureFormat(Enum):
    """The kinds of files."""

    SVG = "svg"
    PDF = "pdf"
    PNG = "png"


#: Of a position on a figure, as a share of its size: a tenth of a pixel.
_DIGITS = 4
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
        figure.savefig(into, format=kind.value, dpi=_PNG_DPI, metadata=_METADATA[kind])
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


def file_name(text: str) -> str:
    """Return a name of letters, digits, hyphens and underscores that any file system, URL and LaTeX takes.

    Example:
        >>> file_name("Energy (J) of ../Größe")
        'Energy_J_of_Grosse'
    """
    plain = unicodedata.normalize("NFKD", text.replace("ß", "ss")).encode("ascii", "ignore").decode()
    return re.sub(r"[^A-Za-z0-9-]+", "_", plain).strip("_")[:_LONGEST] or "unnamed"
