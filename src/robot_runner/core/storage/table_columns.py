"""The columns of a run table, their descriptions, and how its file spells headings and statuses."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from itertools import count
from types import MappingProxyType
from typing import Any

from robot_runner.core.design.columns import BATCH, EXCLUDED, REPETITION, RUN_ID, STAMP_COLUMNS, STATUS, WARM_UP
from robot_runner.core.design.factor import Factor
from robot_runner.core.design.run_table_model import RunTableModel
from robot_runner.core.errors import DesignError, Finding
from robot_runner.core.storage.cells import RunStatus

# How the file of a run table spells headings and statuses.

_OWN_WORDS = MappingProxyType({status: status.value for status in RunStatus})


@dataclass(frozen=True, slots=True)
class TableSpelling:
    """How the file of a run table spells headings and statuses; in memory, columns have the names of Robot Runner.

    Attributes:
        headings: the heading of a column, by its name; other columns have their names as headings.
        status_words: the word for each status. Two statuses may share a word: the journal tells them apart.
        has_stamps: whether there are columns for the events' time stamps.
        blank_is_missing: whether a cell with a blank is a missing value, too, as an empty one.

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
        """Return the heading of a column."""
        return self.headings.get(name, name)

    def name(self, heading: str) -> str:
        """Return the name of the column with this heading; an unknown heading is a name."""
        return next((name for name, known in self.headings.items() if known == heading), heading)

    def tells_apart(self, one: RunStatus, other: RunStatus) -> bool:
        """Return whether the file shows which of two statuses a run has."""
        return self.status_words[one] != self.status_words[other]


OWN_SPELLING = TableSpelling()

#: The spelling of the earlier tools, in which a run is either done or to do.
EARLIER_SPELLING = TableSpelling(
    headings=MappingProxyType({RUN_ID: "__run_id", STATUS: "__done"}),
    status_words=MappingProxyType(dict.fromkeys(RunStatus, "TODO") | {RunStatus.DONE: "DONE"}),
    has_stamps=False,
    blank_is_missing=True,
)


def spelling_of_headings(headings: Mapping[str, str]) -> TableSpelling:
    """Return the spelling of a file in which some columns have other headings than their names.

    Example:
        >>> spelling_of_headings({"run_id": "__run_id"}).status_words[RunStatus.FAILED]
        'TODO'
    """
    is_earlier = headings.get(RUN_ID) == EARLIER_SPELLING.heading(RUN_ID)
    return replace(EARLIER_SPELLING if is_earlier else OWN_SPELLING, headings=headings)


#: Words of R's language, which are no names there.
_WORDS_OF_R = frozenset(
    {"if", "else", "repeat", "while", "function", "for", "next", "break", "in"}
    | {"TRUE", "FALSE", "NULL", "Inf", "NaN", "NA"}
)


def headings_in_r(headings: Sequence[str]) -> list[str]:
    """Return the headings of a file as R's `read.csv` spells them, unless `check.names = FALSE` is said.

    Example:
        >>> headings_in_r(["Energy (J)", "Energy [J]", "2nd run"])
        ['Energy..J.', 'Energy..J..1', 'X2nd.run']
    """
    spelt = list(map(_name_in_r, headings))
    given, taken = set(), {*spelt}
    # As `make.names(unique = TRUE)`: those that stay as they are come first, others with the same name get a number.
    for place in sorted(range(len(spelt)), key=lambda place: spelt[place] != headings[place]):
        name = spelt[place]
        if name in given:
            spelt[place] = next(each for number in count(1) if (each := f"{name}.{number}") not in taken)
        given.add(spelt[place])
        taken.add(spelt[place])
    return spelt


def _name_in_r(heading: str) -> str:
    dotted = "".join(each if each.isalpha() or each.isdecimal() or each == "_" else "." for each in heading)
    if not (heading[:1].isalpha() or re.match(r"\.(?!\d)", heading)):
        return f"X{dotted}"
    return f"{dotted}." if dotted in _WORDS_OF_R else dotted


# The columns of a run table, their order and types.


class ColumnRole(Enum):
    """The role of a column of the run table."""

    PROGRESS = "progress"
    TIMESTAMP = "timestamp"
    FACTOR = "factor"
    REPETITION = "repetition"
    BATCH = "batch"
    WARM_UP = "warm_up"
    MEASURE = "measure"
    EXTRA = "extra"


@dataclass(frozen=True, slots=True, kw_only=True)
class ColumnDescription:
    """The description of one column of the run table.

    Attributes:
        name: the heading.
        role: what the column is for.
        type: `string`, `integer`, `number`, `boolean`, `datetime`, or `any` where it holds several or none yet.
        title: what it is, in a few words.
        description: what it is, in a sentence.
        unit: SI symbol, `%` for percentages, `1` for counts and ratios, empty where there is none.
        owner: the plugin that yields it, or `config`; empty for columns that Robot Runner fills.
        origin: `measured`, `simulated`, `estimated`, several of them with `, ` between, or None.
        findings: what is odd about its values.
        heading: its heading in the file, where that is not its name.
        doubts: why values are doubtful, or missing: the reasons, by run.

    Example:
        >>> ColumnDescription(name="Energy", role=ColumnRole.MEASURE, type="number", unit="J").unit
        'J'
    """

    name: str
    role: ColumnRole
    type: str = "any"
    title: str = ""
    description: str = ""
    unit: str = ""
    owner: str = ""
    origin: str | None = None
    findings: tuple[str, ...] = ()
    heading: str = ""
    doubts: Mapping[str, tuple[str, ...]] = field(default_factory=lambda: MappingProxyType({}))


#: Columns on how a run was planned, beside its combination and repetition. A table has those that its design needs.
MARKS: Mapping[str, ColumnDescription] = MappingProxyType(
    {
        BATCH: ColumnDescription(
            name=BATCH,
            role=ColumnRole.BATCH,
            type="integer",
            title="Batch",
            description="In which batch the run was planned: 1 is the first plan, each extension has the next number.",
        ),
        WARM_UP: ColumnDescription(
            name=WARM_UP,
            role=ColumnRole.WARM_UP,
            type="boolean",
            title="Warm-up",
            description="Whether the run only warms up: it was executed and kept, and is not analysed.",
        ),
    }
)


@dataclass(frozen=True, slots=True)
class FactorColumn:
    """The column of a factor.

    Attributes:
        factor: with whose treatments the cells are matched; None where they are not known (a folder read without its
            config), so that each cell is read by `plain_value`.
        default: the treatment of all runs of a file without the column, which is older than the factor.
        has_default: whether there is a default; otherwise a file must have the column.
    """

    name: str
    factor: Factor | None = None
    default: Any = None
    has_default: bool = False


@dataclass(frozen=True, slots=True)
class TableLayout:
    """The columns of a run table.

    They are in the order of the paper's Fig. 3: progress, time stamps, factors, measures; a user's own columns come
    last. The first heading is `run_id`, not `ID`: spreadsheets take a file that begins with `ID` for a SYLK file and
    refuse it.

    Attributes:
        has_repetition: whether there is a column `Repetition` after the factors.
        has_exclusions: whether there is a column `excluded` after the status, as some run was once excluded.
        marks: the columns of `MARKS` that it has, after that.
        extras: columns that a user added; kept as text.
        former_measures: those of `extras` that were measures in earlier executions; a new attempt clears them.
        types: the type of columns in the run table's schema, by name, for cells that could be read in several ways.
        spelling: how the file spells headings and statuses.
        owners: who yields each column by the run table's schema, by name.

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
    has_exclusions: bool = False
    marks: tuple[str, ...] = ()
    former_measures: tuple[str, ...] = ()
    owners: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}), compare=False)

    def __post_init__(self) -> None:
        counts = Counter(self.columns)
        clashes = [name for name, count in counts.items() if count > 1]
        fix = "Rename the factor, or choose other measures with data_columns."
        DesignError.refuse(Finding.error("run table", f"two columns are called {name!r}", fix) for name in clashes)

    @classmethod
    def of_model(
        cls,
        model: RunTableModel,
        measures: Iterable[str],
        types: Mapping[str, str] | None = None,
        spelling: TableSpelling = OWN_SPELLING,
    ) -> TableLayout:
        """Return the layout of a design's run table; raise a `DesignError` if a measure is called like a factor."""
        defaults = model.defaults
        return cls(
            tuple(
                FactorColumn(each.name, each, defaults.get(each.name), each.name in defaults) for each in model.factors
            ),
            tuple(measures),
            has_repetition=model.repetitions > 1,
            stamps=STAMP_COLUMNS if spelling.has_stamps else (),
            types=types or MappingProxyType({}),
            spelling=spelling,
            marks=_marks_of(model),
        )

    @classmethod
    def of_schema(cls, schema: Sequence[ColumnDescription]) -> TableLayout:
        """Return the layout of a run table without its config: treatments are read by the types of the schema."""
        named = {role: tuple(each.name for each in schema if each.role is role) for role in ColumnRole}
        return cls(
            tuple(map(FactorColumn, named[ColumnRole.FACTOR])),
            named[ColumnRole.MEASURE],
            has_repetition=bool(named[ColumnRole.REPETITION]),
            stamps=named[ColumnRole.TIMESTAMP],
            extras=named[ColumnRole.EXTRA],
            types={column.name: column.type for column in schema},
            spelling=spelling_of_headings({column.name: column.heading for column in schema if column.heading}),
            has_exclusions=EXCLUDED in named[ColumnRole.PROGRESS],
            marks=tuple(name for name, mark in MARKS.items() if name in named[mark.role]),
            owners={column.name: column.owner for column in schema},
        )

    @property
    def headings(self) -> list[str]:
        """The headings in the file, in order."""
        return list(map(self.spelling.heading, self.columns))

    @property
    def factor_names(self) -> tuple[str, ...]:
        """The headings of the factors, in order."""
        return tuple(column.name for column in self.factors)

    @property
    def repetition(self) -> tuple[str, ...]:
        """The heading of the repetitions, where the table has them."""
        return (REPETITION,) if self.has_repetition else ()

    @property
    def exclusion(self) -> tuple[str, ...]:
        """The heading of exclusions, where the table has it."""
        return (EXCLUDED,) if self.has_exclusions else ()

    @property
    def columns(self) -> tuple[str, ...]:
        """All headings, in order."""
        planned = (*self.factor_names, *self.repetition, *self.marks)
        return (RUN_ID, STATUS, *self.exclusion, *self.stamps, *planned, *self.measures, *self.extras)


def former_measures(schema: Iterable[ColumnDescription], layout: TableLayout) -> tuple[ColumnDescription, ...]:
    """Return the columns of a schema that are, or once were, measures and that the layout does not have any more."""
    there = set(layout.columns)
    return tuple(
        replace(column, role=ColumnRole.EXTRA)
        for column in schema
        if column.name not in there
        and (column.role is ColumnRole.MEASURE or (column.role is ColumnRole.EXTRA and column.owner))
    )


def _marks_of(model: RunTableModel) -> tuple[str, ...]:
    has_warm_ups = model.warm_up is not None or any(run.is_warm_up for batch in model.batches for run in batch.runs)
    needed = {BATCH: model.is_extended, WARM_UP: has_warm_ups}
    return tuple(name for name in MARKS if needed[name])
