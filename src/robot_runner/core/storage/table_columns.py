"""The run table's columns in memory: each knows the value of a row and how its cells are written."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass, field, replace
from enum import Enum
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Protocol

from robot_runner.core.design.columns import REPETITION, RUN_ID, STAMP_COLUMNS, STATUS, numbered_run_id
from robot_runner.core.errors import DesignError, Finding
from robot_runner.core.storage.cells import RunStatus, measure_text, quoted, quoted_all

if TYPE_CHECKING:
    from array import array
    from collections.abc import Iterable, Mapping, Sequence

    from robot_runner.core.design.factor import Factor
    from robot_runner.core.design.run_table_model import RunTableModel
    from robot_runner.core.storage.cells import CellValue
    from robot_runner.core.storage.table_schema import ColumnDescription

__all__ = [
    "EARLIER_SPELLING",
    "OWN_SPELLING",
    "CodedColumn",
    "ColumnRole",
    "FactorColumn",
    "MeasureColumn",
    "RunIdColumn",
    "StatusColumn",
    "TableColumn",
    "TableLayout",
    "TableSpelling",
    "TextColumn",
    "spelling_of_headings",
]


# How the file of a run table spells what it holds: the headings, and the words for how far a run has come.

_OWN_WORDS = MappingProxyType({status: status.value for status in RunStatus})


@dataclass(frozen=True, slots=True)
class TableSpelling:
    """How the file of a run table spells what it holds; in memory, columns have the names of Robot Runner.

    Attributes:
        headings: the heading of a column, by its name; a column that is not here is headed by its name.
        status_words: the word for each status. Two statuses may share a word: the journal tells them apart.
        has_stamps: whether there are columns for the events' time stamps.
        blank_is_missing: whether a blank stands for a missing value, as nothing does.

    Example:
        >>> spelling = TableSpelling(headings={"run_id": "__run_id"})
        >>> spelling.heading("run_id"), spelling.name("__run_id"), spelling.heading("Task")
        ('__run_id', 'run_id', 'Task')
    """

    headings: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))
    status_words: Mapping[RunStatus, str] = field(default_factory=lambda: _OWN_WORDS)
    has_stamps: bool = True
    blank_is_missing: bool = False

    def heading(self, name: str) -> str:
        """Return what stands at the head of a column."""
        return self.headings.get(name, name)

    def name(self, heading: str) -> str:
        """Return the name of the column that has this heading; a heading that is not known is a name."""
        return next((name for name, known in self.headings.items() if known == heading), heading)

    def tells_apart(self, one: RunStatus, other: RunStatus) -> bool:
        """Return whether the file shows which of two statuses a run has."""
        return self.status_words[one] != self.status_words[other]


OWN_SPELLING = TableSpelling()

#: As the earlier tools wrote it: a run is done or to do, nothing else.
EARLIER_SPELLING = TableSpelling(
    headings=MappingProxyType({RUN_ID: "__run_id", STATUS: "__done"}),
    status_words=MappingProxyType(dict.fromkeys(RunStatus, "TODO") | {RunStatus.DONE: "DONE"}),
    has_stamps=False,
    blank_is_missing=True,
)


def spelling_of_headings(headings: Mapping[str, str]) -> TableSpelling:
    """Return the spelling of a file in which some columns are headed by something else than their names.

    Example:
        >>> spelling_of_headings({"run_id": "__run_id"}).status_words[RunStatus.FAILED]
        'TODO'
    """
    is_earlier = headings.get(RUN_ID) == EARLIER_SPELLING.heading(RUN_ID)
    return replace(EARLIER_SPELLING if is_earlier else OWN_SPELLING, headings=headings)


# Which columns a run table has, in which order, and what their cells are read as.


class ColumnRole(Enum):
    """What a column of the run table is for."""

    PROGRESS = "progress"
    TIMESTAMP = "timestamp"
    FACTOR = "factor"
    REPETITION = "repetition"
    MEASURE = "measure"
    EXTRA = "extra"


@dataclass(frozen=True, slots=True)
class FactorColumn:
    """The column of a factor.

    Attributes:
        name: the heading.
        factor: whose treatments the cells are matched with; None where they are not known (a folder read without its
            config), so that each cell goes by its looks.
    """

    name: str
    factor: Factor | None = None


@dataclass(frozen=True, slots=True)
class TableLayout:
    """The columns of a run table.

    They stand in the order of the paper's Fig. 3: progress, time stamps, factors, measures; a user's own columns come
    last. The first heading is `run_id` in lower case, not `ID`: spreadsheets take a file that begins with `ID` for a
    SYLK file and refuse it.

    Attributes:
        factors: the factors' columns.
        measures: the measures' columns.
        has_repetition: whether there is a column `Repetition` after the factors.
        stamps: the events' time-stamp columns.
        extras: columns that a user added; kept as text.
        types: the type of columns in the run table's schema, by name, for reading cells that could be several things.
        spelling: how the file spells headings and statuses.

    Raises:
        DesignError: two columns would have one heading.

    Example:
        >>> TableLayout((FactorColumn("Task"),), ("Energy",), stamps=()).columns
        ('run_id', 'status', 'Task', 'Energy')
    """

    factors: tuple[FactorColumn, ...]
    measures: tuple[str, ...] = ()
    has_repetition: bool = False
    stamps: tuple[str, ...] = STAMP_COLUMNS
    extras: tuple[str, ...] = ()
    types: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))
    spelling: TableSpelling = OWN_SPELLING

    def __post_init__(self) -> None:
        counts = Counter(self.columns)
        clashes = [name for name, count in counts.items() if count > 1]
        if clashes:
            fix = "Rename the factor, or choose other measures with data_columns."
            findings = [Finding.error("run table", f"two columns are called {name!r}", fix) for name in clashes]
            raise DesignError.of_findings(findings)

    @classmethod
    def of_model(
        cls,
        model: RunTableModel,
        measures: Iterable[str],
        types: Mapping[str, str] | None = None,
        spelling: TableSpelling = OWN_SPELLING,
    ) -> TableLayout:
        """Return the layout of a design's run table.

        Args:
            model: the design.
            measures: the names of the measures' columns, in order.
            types: the types in the run table's schema, where there is one already.
            spelling: how the file spells headings and statuses.

        Raises:
            DesignError: a measure is called like a factor.
        """
        return cls(
            tuple(FactorColumn(factor.name, factor) for factor in model.factors),
            tuple(measures),
            has_repetition=model.repetitions > 1,
            stamps=STAMP_COLUMNS if spelling.has_stamps else (),
            types=types or MappingProxyType({}),
            spelling=spelling,
        )

    @classmethod
    def of_schema(cls, schema: Sequence[ColumnDescription]) -> TableLayout:
        """Return the layout of a run table whose config is not at hand: treatments go by their looks and types."""
        named = {role: tuple(each.name for each in schema if each.role is role) for role in ColumnRole}
        return cls(
            tuple(map(FactorColumn, named[ColumnRole.FACTOR])),
            named[ColumnRole.MEASURE],
            has_repetition=bool(named[ColumnRole.REPETITION]),
            stamps=named[ColumnRole.TIMESTAMP],
            extras=named[ColumnRole.EXTRA],
            types={column.name: column.type for column in schema},
            spelling=spelling_of_headings({column.name: column.heading for column in schema if column.heading}),
        )

    @property
    def factor_names(self) -> tuple[str, ...]:
        """The headings of the factors, in order."""
        return tuple(column.name for column in self.factors)

    @property
    def repetition(self) -> tuple[str, ...]:
        """The heading of the repetitions, where the table has them."""
        return (REPETITION,) if self.has_repetition else ()

    @property
    def columns(self) -> tuple[str, ...]:
        """All headings, in order."""
        return (RUN_ID, STATUS, *self.stamps, *self.factor_names, *self.repetition, *self.measures, *self.extras)


_STATUSES = tuple(RunStatus)
_PLACES_OF_STATUSES = {status: place for place, status in enumerate(_STATUSES)}
_STATUS_CELLS = tuple(status.value for status in _STATUSES)
_NUMBERED = re.compile(r"r_[1-9][0-9]{0,17}")


class TableColumn(Protocol):
    """One column of the run table."""

    name: str

    def value(self, place: int) -> Any:
        """Return the value in the row at `place`, counted from 0."""
        ...

    def cells(self, start: int, stop: int) -> Iterable[str]:
        """Return the cells of some rows as they stand in the file, quotes included."""
        ...


class RunIdColumn:
    """The ids of the runs. Numbered ones (`r_1`, `r_2`, ...) take no memory.

    Example:
        >>> RunIdColumn.numbered(3).place_of("r_3")
        2
    """

    def __init__(self, run_ids: Sequence[str] | None, count: int) -> None:
        self.name = RUN_ID
        self._run_ids = run_ids
        self._count = count
        self._places = None if run_ids is None else {run_id: place for place, run_id in enumerate(run_ids)}

    @classmethod
    def numbered(cls, count: int) -> RunIdColumn:
        """Return the ids of a planned run table."""
        return cls(None, count)

    def __len__(self) -> int:
        return self._count

    def value(self, place: int) -> str:
        """Return the id of the run at `place`."""
        return numbered_run_id(place + 1) if self._run_ids is None else self._run_ids[place]

    def place_of(self, run_id: str) -> int | None:
        """Return the place of a run, or None where there is no such run."""
        if self._places is not None:
            return self._places.get(run_id)
        number = int(run_id[2:]) if _NUMBERED.fullmatch(run_id) else 0
        return number - 1 if 1 <= number <= self._count else None

    def cells(self, start: int, stop: int) -> Iterable[str]:
        """Return the ids of some rows."""
        if self._run_ids is None:
            return map(numbered_run_id, range(start + 1, stop + 1))
        return map(quoted, self._run_ids[start:stop])


class StatusColumn:
    """How far each run has come, and how many have come how far."""

    def __init__(self, count: int) -> None:
        self.name = STATUS
        self._cells: tuple[str, ...] = _STATUS_CELLS
        self._codes = bytearray(count)
        self._counts = [0] * len(_STATUSES)
        self._counts[_PLACES_OF_STATUSES[RunStatus.TODO]] = count

    def __len__(self) -> int:
        return len(self._codes)

    def extend(self, words: Iterable[str], meaning: Mapping[str, RunStatus]) -> None:
        """Add rows whose statuses are written so."""
        code_of = {word: _PLACES_OF_STATUSES[status] for word, status in meaning.items()}
        added = bytes(map(code_of.__getitem__, words))
        self._codes += added
        for code in range(len(_STATUSES)):
            self._counts[code] += added.count(code)

    def value(self, place: int) -> RunStatus:
        """Return the status of the run at `place`."""
        return _STATUSES[self._codes[place]]

    def change(self, place: int, status: RunStatus) -> None:
        """Change the status of the run at `place`."""
        code = _PLACES_OF_STATUSES[status]
        self._counts[self._codes[place]] -= 1
        self._counts[code] += 1
        self._codes[place] = code

    def count(self, status: RunStatus) -> int:
        """Return how many runs have this status, at no cost that grows with the table."""
        return self._counts[_PLACES_OF_STATUSES[status]]

    def spell(self, words: Mapping[RunStatus, str]) -> None:
        """Write each status with this word from now on."""
        self._cells = tuple(quoted(words[status]) for status in _STATUSES)

    def cells(self, start: int, stop: int) -> Iterable[str]:
        """Return the words for the statuses of some rows."""
        return map(self._cells.__getitem__, self._codes[start:stop])


class CodedColumn:
    """Values that repeat, as the treatments of a factor: each is kept once, and every row keeps its place."""

    def __init__(self, name: str, values: Sequence[Any], texts: Sequence[str], places: array[int]) -> None:
        self.name = name
        self.values = values
        self.places = places
        self._cells = tuple(map(quoted, texts))

    def value(self, place: int) -> Any:
        """Return the value in the row at `place`."""
        return self.values[self.places[place]]

    def cells(self, start: int, stop: int) -> Iterable[str]:
        """Return the cells of some rows."""
        return map(self._cells.__getitem__, self.places[start:stop])


class TextColumn:
    """Text that the run table carries as it is: time stamps, and the columns that a user added."""

    def __init__(self, name: str, texts: list[str | None]) -> None:
        self.name = name
        self.texts = texts

    def value(self, place: int) -> str | None:
        """Return the text in the row at `place`; None where the cell is empty."""
        return self.texts[place]

    def cells(self, start: int, stop: int) -> Iterable[str]:
        """Return the cells of some rows."""
        return quoted_all([text or "" for text in self.texts[start:stop]])


class MeasureColumn:
    """The values of one measure."""

    def __init__(self, name: str, values: list[CellValue]) -> None:
        self.name = name
        self.values = values

    def value(self, place: int) -> CellValue:
        """Return the value in the row at `place`; None where it is missing."""
        return self.values[place]

    def cells(self, start: int, stop: int) -> Iterable[str]:
        """Return the cells of some rows."""
        return quoted_all(list(map(measure_text, self.values[start:stop])))
