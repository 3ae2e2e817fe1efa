"""The style of figures (sizes, colours, markers, lines, fonts), and their output as SVG, PDF and PNG files."""

from __future__ import annotations

import io
import textwrap
import warnings
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from enum import Enum
from itertools import zip_longest
from typing import TYPE_CHECKING, Any, Literal

import matplotlib as mpl
import numpy as np
from matplotlib import colormaps, font_manager
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

#: Width of a column and of a page in IEEE's transactions and conferences, inches: a little below the 252 and 516 points
#: (of 1/72.27 inch) of their LaTeX class, which warns of a figure that is wider.
COLUMN = 3.48
PAGE = 7.13
#: Height of a page, inches.
HIGHEST = 8.5

#: Letters of an axis label that fit beneath a column's figure, and beside one of the usual height.
_LINE, UPRIGHT_LINE = 42, 34
#: Letters of all names along an axis that fit beside each other.
_LETTERS_BESIDE = 46
#: Letters of a name that fit beneath a column's figure.
_LETTERS_IN_LEGEND = 50
#: Letters that are kept before the part of a name that differs from another.
_BEFORE = 3
#: The smallest number of letters of a treatment in the name of a combination.
_FEWEST = 8
#: The height of a line in a legend, and of a letter in a slanted name, inches; the lines that each figure has room for.
_LEGEND_LINE, _SLANTED, _LINES_WITH_ROOM = 0.13, 0.02, 4
#: The smallest font size that can be read in print, points.
_SMALLEST = 5.0

#: From this number on, single points cannot be distinguished; the size of one, points.
_CROWD, _DOT = 600, 1.0

INK = "#1f2933"
GREY = "#8a94a0"
DASHED = (0, (5, 2))

#: Paul Tol's high-contrast scheme (https://sronpersonalpages.nl/~pault/): three colours that also differ in grey.
_HIGH_CONTRAST = ("#004488", "#BB5566", "#DDAA33")
#: Okabe and Ito's palette, "Color Universal Design" (2008), without black and yellow: six colours for the colour-blind;
#: in grey, markers and lines differ.
_UNIVERSAL = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
_MARKERS = ("o", "s", "^", "D", "v", "P", "X", "<", ">", "p")
_LINES: tuple[str | tuple[float, tuple[float, ...]], ...] = (
    "-",
    (0, (5, 1.4)),
    (0, (1.2, 1.2)),
    (0, (5, 1.2, 1.2, 1.2)),
    (0, (3, 1, 1, 1, 1, 1)),
    (0, (8, 2)),
)

#: This font comes with matplotlib, so that figures are the same on each machine.
_FONT = "DejaVu Sans"
#: Fonts for letters that it lacks, if one of these is installed.
_FONTS_OF_OTHER_SCRIPTS = (
    "Noto Sans CJK SC", "Noto Sans CJK JP", "Noto Sans CJK KR", "WenQuanYi Zen Hei", "IPAexGothic", "Hiragino Sans",
    "PingFang SC", "Microsoft YaHei", "Noto Sans Devanagari", "Noto Sans Thai", "Noto Emoji",
)  # fmt: skip

_STYLE: dict[Any, Any] = {
    "font.size": 7.5,
    "axes.labelsize": 7.5,
    "axes.titlesize": 7.5,
    "axes.titleweight": "bold",
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "axes.unicode_minus": True,
    "axes.formatter.useoffset": False,
    "text.color": INK,
    "text.parse_math": False,  # a name with two dollar signs is not a formula
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.labelsize": 6.5,
    "ytick.labelsize": 6.5,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.major.size": 2.5,
    "ytick.major.size": 2.5,
    "grid.color": "#dde2e7",
    "grid.linewidth": 0.5,
    "legend.fontsize": 6.5,
    "legend.frameon": False,
    "legend.handlelength": 2.2,
    "lines.linewidth": 1.1,
    "lines.markersize": 3.5,
    "figure.constrained_layout.h_pad": 0.03,
    "figure.constrained_layout.w_pad": 0.03,
    "savefig.facecolor": "white",
    "svg.fonttype": "path",  # the same in each browser and drawing program
    "svg.hashsalt": "robot-runner",  # the same figure makes the same file
    "pdf.fonttype": 42,  # TrueType, which publishers ask for
    "path.simplify_threshold": 0.2,
}


@dataclass(frozen=True, slots=True)
class Look:
    """The style of one treatment in all figures: its colour as `#rrggbb`, matplotlib's marker and line style."""

    colour: str
    marker: str
    line: str | tuple[float, tuple[float, ...]]


def looks(count: int) -> tuple[Look, ...]:
    """Return a look for each treatment; they differ by colour, by marker and by line.

    Example:
        >>> [look.marker for look in looks(3)]
        ['o', 's', '^']
    """
    return tuple(
        Look(colour, _MARKERS[place % len(_MARKERS)], _LINES[place % len(_LINES)])
        for place, colour in enumerate(_colours(count))
    )


def _colours(count: int) -> tuple[str, ...]:
    if count <= len(_HIGH_CONTRAST):
        return _HIGH_CONTRAST[:count]
    if count <= len(_UNIVERSAL):
        return _UNIVERSAL[:count]
    # Cividis becomes lighter evenly, also for the colour-blind; its lightest part is invisible on white paper.
    cividis = colormaps["cividis"]
    return tuple(to_hex(cividis(0.9 * place / (count - 1))) for place in range(count))


def looks_by(order: Iterable[str]) -> dict[str, Look]:
    """Return the look of each treatment, by its name; the order is the same in all figures."""
    names = list(order)
    return dict(zip(names, looks(len(names)), strict=True))


def _families() -> list[str]:
    fonts = {font.name for font in font_manager.fontManager.ttflist}
    return [_FONT, *(name for name in _FONTS_OF_OTHER_SCRIPTS if name in fonts)]


def letters_without_font(texts: Iterable[str]) -> str:
    """Return the letters that no font of the figures has, each once: figures show them as boxes.

    Example:
        >>> letters_without_font(["Énergie (µJ·s⁻¹)"])
        ''
    """
    fonts = [font_manager.get_font(font_manager.findfont(family)) for family in _families()]
    letters = sorted({letter for text in texts for letter in verbatim(text)})
    return "".join(letter for letter in letters if not any(font.get_char_index(ord(letter)) for font in fonts))


@contextmanager
def figure_style() -> Iterator[None]:
    """Have matplotlib draw and save in the style of this module, within the context."""
    style = _STYLE | {"font.family": _families()}
    with mpl.rc_context(style), warnings.catch_warnings():
        # A letter that no font has becomes a box: `letters_without_font` tells which.
        warnings.filterwarnings("ignore", message="Glyph .* missing from font")
        yield


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure of this size, inches; it has no window and is in no global list."""
    return Figure(figsize=(width, height), layout="constrained")


def new_axes(width: float, height: float) -> tuple[Figure, Axes]:
    """Return such a figure with one pair of axes."""
    figure = new_figure(width, height)
    return figure, figure.subplots()


def draw_points(axes: Axes, x: Any, y: Any, look: Look, *, edge: float = 0.3, **settings: Any) -> None:
    """Draw values as points with a white edge, so that overlapping points can be distinguished; crowds as pale dots."""
    settings |= {"markeredgecolor": "white", "markeredgewidth": edge}
    if np.size(x) > _CROWD:  # the edges would hide all but the last points, and these whatever is drawn with them
        settings |= {"markeredgewidth": 0.0, "markersize": _DOT, "alpha": 0.4, "zorder": 1.5}
    axes.plot(x, y, linestyle="none", marker=look.marker, color=look.colour, **settings)


def name_places(figure: Figure, axes: Axes, names: Sequence[str]) -> None:
    """Name the positions 0, 1, 2, ... on the x axis; if names would touch, slant them and make the figure higher."""
    shown = shortened_apart(names)
    longest = max(map(len, shown), default=0)
    is_crowded = sum(map(len, shown)) > _LETTERS_BESIDE or longest * len(shown) > _LETTERS_BESIDE
    slant: dict[str, Any] = {"rotation": 30, "ha": "right"} if is_crowded else {}
    axes.set_xticks(range(len(shown)), shown, **slant)
    if is_crowded:
        figure.set_figheight(figure.get_figheight() + _SLANTED * longest)


def label_axes(axes: Axes, x: str = "", y: str = "", *, grid: Literal["both", "x", "y"]) -> None:
    """Label the axes for which a text is given, and draw a grid."""
    if x:
        axes.set_xlabel(wrapped(x))
    if y:
        axes.set_ylabel(wrapped(y, UPRIGHT_LINE))
    axes.grid(visible=True, axis=grid)


def add_legend(figure: Figure, count: int, *, most: int | None = None, columns: int = 3, **settings: Any) -> None:
    """Draw a legend of the treatments beneath a figure, unless there is only one, more than `most`, or no room.

    If names do not fit beside each other, the legend has fewer columns than `columns`, and the figure becomes higher.
    """
    if not 1 < count <= (most or count):
        return
    columns = min(count, columns)
    for beside in range(columns, 0, -1):
        legend = figure.legend(loc="outside lower center", ncols=beside, **settings)
        texts = legend.get_texts()
        names = shortened_apart([text.get_text() for text in texts], _LETTERS_IN_LEGEND)
        for text, name in zip(texts, names, strict=True):
            text.set_text(name)
        for handle in legend.legend_handles:
            if isinstance(handle, Line2D) and handle.get_markersize() == _DOT:
                handle.set(markersize=mpl.rcParams["lines.markersize"], alpha=1.0)
        if beside == 1 or legend.get_window_extent().width <= figure.bbox.width:
            further = -(-count // beside) - min(-(-count // columns), _LINES_WITH_ROOM)
            height = figure.get_figheight() + _LEGEND_LINE * further
            if height > HIGHEST:
                legend.remove()
            else:
                figure.set_figheight(height)
            return
        legend.remove()


def shortened(label: str, longest: int = 28) -> str:
    """Shorten a name to one line beside an axis, and keep its end, by which long names often differ.

    Example:
        >>> shortened("planner with recovery, cautious", 24)
        'planner with…y, cautious'
    """
    end = (longest - 1) // 2
    return verbatim(label if len(label) <= longest else f"{label[: longest - 1 - end]}…{label[-end:]}")


def shortened_apart(labels: Sequence[str], longest: int = 28) -> list[str]:
    """Shorten names to fit beside an axis; names that would become equal begin shortly before they differ.

    Example:
        >>> shortened_apart(["config/nav2_dwb_fast_params.yaml", "config/nav2_dwb_slow_params.yaml"], 24)
        ['…wb_fast_params.yaml', '…wb_slow_params.yaml']
    """
    alike: dict[str, set[str]] = {}
    for label in labels:
        alike.setdefault(shortened(label, longest), set()).add(label)

    def apart(label: str) -> str:
        others = alike[shortened(label, longest)] - {label}
        pairs = (enumerate(zip_longest(label, each)) for each in others)
        start = max((next(at for at, (one, other) in each if one != other) for each in pairs), default=0) - _BEFORE
        return shortened(f"…{label[start:]}" if start > 0 else label, longest)

    shown = list(map(apart, labels))
    if len(set(shown)) == len(set(labels)) or longest >= max(map(len, labels)):
        return shown
    parts = [label.split(" / ") for label in labels]
    if len({len(each) for each in parts}) > 1 or len(parts[0]) == 1:
        return shortened_apart(labels, 2 * longest)  # only longer names differ
    # In combinations, names are shortened factor by factor.
    of_factors = (shortened_apart(each, max(_FEWEST, longest // len(parts[0]))) for each in zip(*parts, strict=True))
    return list(map(" / ".join, zip(*of_factors, strict=True)))


def wrapped(text: str, line: int = _LINE) -> str:
    r"""Wrap the label of an axis into lines of at most so many letters.

    Example:
        >>> wrapped("Difference of Ina219.Energy and PowerModel.Energy (J)")
        'Difference of Ina219.Energy and\nPowerModel.Energy (J)'
    """
    return textwrap.fill(verbatim(text), line)


def verbatim(text: str, kept: str = "") -> str:
    r"""Return a text on one line, without invisible characters such as those that change the reading direction.

    Example:
        >>> verbatim("two\nlines")
        'two lines'
    """
    if text.isprintable():
        return text
    return "".join(character if character.isprintable() or character in kept else " " for character in text)


_NO_MARKERS = (None, "", " ", "none", "None")


class FigureFormat(Enum):
    """The file formats of figures."""

    SVG = "svg"
    PDF = "pdf"
    PNG = "png"


#: Decimals of a position on a figure, as a share of its size: a tenth of a pixel.
_DIGITS = 4
#: The minimum that journals ask for; lower in SVG, as a page has dozens of them, and only crowds become pixels there.
_DPI = {FigureFormat.SVG: 150, FigureFormat.PDF: 300, FigureFormat.PNG: 300}
#: No dates, so that the same figure is the same file.
_METADATA = {FigureFormat.SVG: {"Date": None}, FigureFormat.PDF: {"CreationDate": None}, FigureFormat.PNG: {}}


def figure_bytes(figure: Figure, kind: FigureFormat) -> bytes:
    """Return a figure as the content of a file."""
    into = io.BytesIO()
    with figure_style():
        _settle(figure)
        _rasterise_crowds(figure)
        figure.savefig(into, format=kind.value, dpi=_DPI[kind], metadata=_METADATA[kind])
    return into.getvalue()


def _settle(figure: Figure) -> None:
    """Lay out the figure once, and round positions: the last digits of the solver differ between processes."""
    engine = figure.get_layout_engine()
    if engine is None:
        return
    engine.execute(figure)
    changed = [_shrink_long_labels(figure), _clear_multipliers(figure)]
    if any(changed):
        engine.execute(figure)
    figure.set_layout_engine(None)  # "none" would keep a placeholder engine, for which everything is drawn once more
    for axes in figure.axes:
        left, bottom, width, height = (round(edge, _DIGITS) for edge in axes.get_position().bounds)
        axes.set_position((left, bottom, width, height))


def _shrink_long_labels(figure: Figure) -> bool:
    """Shrink labels that would reach beyond the figure's edges; return whether there are any."""
    found = False
    for label in (each.label for axes in figure.axes for each in (axes.xaxis, axes.yaxis)):
        extent, whole = label.get_window_extent(), figure.bbox
        is_flat = label.get_rotation() == 0.0
        (low, high), end = (extent.intervalx, whole.width) if is_flat else (extent.intervaly, whole.height)
        middle = (low + high) / 2
        room = 1.8 * min(middle, end - middle)  # letters are a little wider at other resolutions
        if label.get_text() and 0 < room < high - low:
            label.set_fontsize(max(_SMALLEST, label.get_fontsize() * room / (high - low)))
            found = True
    return found


def _clear_multipliers(figure: Figure) -> bool:
    """Move labels away from the multiplier (a power of ten) of an axis; return whether there is any."""
    found = False
    for axes in figure.axes:
        multiplier = axes.xaxis.get_offset_text()
        if multiplier.get_text() and axes.get_xlabel():
            axes.xaxis.labelpad += float(multiplier.get_fontsize())
            found = True
    return found


def _rasterise_crowds(figure: Figure) -> None:
    """Rasterise crowds of points and bars in SVG and PDF, too, where each would take about 200 bytes."""
    for axes in figure.axes:
        points = [line for line in axes.lines if line.get_marker() not in _NO_MARKERS]
        crowds: tuple[Sequence[Artist], ...] = (points, axes.collections)
        sizes = (
            sum(np.size(line.get_xdata(orig=False)) for line in points),
            sum(len(bars.get_paths()) for bars in axes.collections),
        )
        for artists, size in zip(crowds, sizes, strict=True):
            for artist in artists if size > _CROWD else ():
                artist.set_rasterized(True)
