"""A report as plain data, independent of the output format: sections of paragraphs, tables, figures, remarks."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from itertools import compress
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Kind = TypeVar("Kind")


class Place(Enum):
    """Where a column of a table is shown: to readers (PAGE), in the CSV file for programs (FILE), or both."""

    EVERYWHERE = "everywhere"
    PAGE = "page"
    FILE = "file"


class Tone(Enum):
    """The meaning of something for the reader, shown by a word or a sign, too, never by colour alone."""

    GOOD = "good"
    PLAIN = "plain"
    NOTE = "note"
    WARNING = "warning"
    BAD = "bad"


@dataclass(frozen=True, slots=True)
class Badge:
    """A label such as `simulated`."""

    text: str
    tone: Tone = Tone.PLAIN
    explanation: str = ""


@dataclass(frozen=True, slots=True)
class Paragraph:
    """Sentences after a bold lead with badges; NOTE is small print, GOOD a conclusion."""

    text: str
    tone: Tone = Tone.PLAIN
    lead: str = ""
    badges: tuple[Badge, ...] = ()


@dataclass(frozen=True, slots=True)
class Facts:
    """Names and their values, in two columns."""

    rows: tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True)
class Card:
    """A number that readers should see first, as short as possible, with its label."""

    value: str
    label: str
    note: str = ""
    tone: Tone = Tone.PLAIN


@dataclass(frozen=True, slots=True)
class Cards:
    """Several cards beside each other."""

    cards: tuple[Card, ...]


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a table; numbers are right-aligned."""

    name: str
    is_number: bool = False
    place: Place = Place.EVERYWHERE


@dataclass(frozen=True, slots=True)
class Cell:
    """A cell of a table: its value for programs (None if missing) and its text for readers."""

    value: Any
    text: str
    tone: Tone = Tone.PLAIN

    @classmethod
    def of_text(cls, text: str, tone: Tone = Tone.PLAIN) -> Cell:
        """Make a cell whose value is its text."""
        return cls(text, text, tone)


@dataclass(frozen=True, slots=True)
class Table:
    """A table, which also becomes a CSV and a LaTeX file; each row has as many cells as there are columns.

    Attributes:
        name: the name of its files, unique in a document.
        note: small print beneath it.
    """

    name: str
    caption: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    note: str = ""

    @property
    def for_readers(self) -> Table:
        """The table without columns that are only for the CSV file."""
        return self._only([column.place is not Place.FILE for column in self.columns])

    @property
    def for_programs(self) -> Table:
        """The table without columns that are only for readers."""
        return self._only([column.place is not Place.PAGE for column in self.columns])

    def without_blank(self, *names: str) -> Table:
        """Return the table without those of these columns whose cells are all blank or 0."""
        cells = zip(*self.rows, strict=True) if self.rows else ((),) * len(self.columns)
        is_blank = [all(cell.value in {None, "", 0} for cell in column) for column in cells]
        columns = zip(self.columns, is_blank, strict=True)
        return self._only([column.name not in names or not blank for column, blank in columns])

    def _only(self, kept: Sequence[bool]) -> Table:
        rows = tuple(tuple(compress(row, kept)) for row in self.rows)
        return replace(self, columns=tuple(compress(self.columns, kept)), rows=rows)


@dataclass(frozen=True, slots=True)
class FigureBlock:
    """A figure, which also becomes SVG, PDF and PNG files.

    Attributes:
        name: the name of its files, unique in a document.
        alternative: the text for readers who cannot see it.
        draw: draws it; called once.
        is_wide: whether it takes the whole width of a page.
        has_photographs: whether it has photographs, whose colours a dark page must not change.
    """

    name: str
    caption: str
    alternative: str
    draw: Callable[[], Figure]
    is_wide: bool = False
    has_photographs: bool = False


@dataclass(frozen=True, slots=True)
class Gallery:
    """Figures beside each other if there is room."""

    figures: tuple[FigureBlock, ...]


@dataclass(frozen=True, slots=True)
class Beside:
    """A figure and a related block, beside each other if there is room."""

    blocks: tuple[Block, ...]


@dataclass(frozen=True, slots=True)
class Chart:
    """An interactive chart; figures beside it show the same on paper.

    Attributes:
        kind: `course` or `points`, a kind of chart in `assets/charts.js`.
        data: plain data in the form that `assets/charts.js` expects.
    """

    name: str
    kind: str
    caption: str
    data: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Remark:
    """A remark for the reader, of a kind such as `Internal validity`."""

    title: str
    text: str
    tone: Tone = Tone.NOTE
    kind: str = ""


@dataclass(frozen=True, slots=True)
class Remarks:
    """Several remarks below each other."""

    remarks: tuple[Remark, ...]


@dataclass(frozen=True, slots=True)
class Code:
    """Lines to paste into a shell or a file."""

    text: str
    language: str = "sh"


@dataclass(frozen=True, slots=True)
class Part:
    """A part of a section with a heading; links lead to its name, which is unique in a document.

    Attributes:
        is_folded: whether a page shows it only on request.
        is_printed: whether it is printed although it is folded.
    """

    name: str
    title: str
    blocks: tuple[Block, ...]
    badges: tuple[Badge, ...] = ()
    is_folded: bool = False
    is_printed: bool = True


Block = Paragraph | Facts | Cards | Table | FigureBlock | Gallery | Beside | Chart | Remarks | Code | Part


@dataclass(frozen=True, slots=True)
class Section:
    """A section of a report; links lead to its `name`."""

    name: str
    title: str
    blocks: tuple[Block, ...]


def one_word(name: str) -> str:
    """Return a name as one word in the name of a table or a figure, so that the whole name stays unique.

    Example:
        >>> f"describe {one_word('Energy')} by Task", f"describe {one_word('Energy by Task')}"
        ('describe Energy by Task', 'describe “Energy by Task”')
    """
    return f"“{name}”" if " " in name else name


@dataclass(frozen=True, slots=True)
class Document:
    """A whole report.

    Attributes:
        kicker: the kind of document.
        subtitle: the most important circumstances, on one line.
        made: the date and the program that made it.
    """

    kicker: str
    title: str
    subtitle: str
    badges: tuple[Badge, ...]
    sections: tuple[Section, ...]
    made: str = ""

    def blocks(self) -> Iterator[Block]:
        """Yield all blocks, each before the blocks inside it."""
        for section in self.sections:
            yield from _flat(section.blocks)

    @property
    def tables(self) -> tuple[Table, ...]:
        """All tables, in order."""
        return self._all(Table)

    @property
    def figures(self) -> tuple[FigureBlock, ...]:
        """All figures, in order."""
        return self._all(FigureBlock)

    @property
    def charts(self) -> tuple[Chart, ...]:
        """All charts, in order."""
        return self._all(Chart)

    def _all(self, kind: type[Kind]) -> tuple[Kind, ...]:
        return tuple(block for block in self.blocks() if isinstance(block, kind))


def _flat(blocks: Sequence[Block]) -> Iterator[Block]:
    for block in blocks:
        yield block
        if isinstance(block, Part | Beside):
            yield from _flat(block.blocks)
        elif isinstance(block, Gallery):
            yield from block.figures
