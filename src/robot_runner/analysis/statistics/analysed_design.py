"""The design of an experiment for its statistics, derived from the runs that are done."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from robot_runner.analysis.arrays import Floats, Numbers
from robot_runner.analysis.run_frame import treatment_texts
from robot_runner.analysis.statistics.effect_coding import Conditions, Factors
from robot_runner.analysis.statistics.execution_order import STAMP, execution_order
from robot_runner.analysis.statistics.grouped_runs import Group, group_of, numbered
from robot_runner.analysis.statistics.known_design import (
    PLAIN,
    KnownDesign,
    are_complete,
    role_column,
    treatments_before,
    with_structure,
)
from robot_runner.analysis.statistics.nested_factors import IDLE, conditions_of, factors_of
from robot_runner.analysis.statistics.outcome import DesignSummary
from robot_runner.core.design.analysis_plan import ELAPSED, ORDER
from robot_runner.core.design.columns import RUN_ID
from robot_runner.core.words import counted, enumerated

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from robot_runner.analysis.results import Results

#: Columns of a measure's data besides the factors, whose names never begin with a space.
VALUE = " value"
PLACE = " place"
_BLOCK = " block"
#: The description, in the schema of a run table, of a factor that applies to all runs.
EVERYWHERE = "A factor."
BATCH = " batch"


def covariate_column(name: str) -> str:
    """Return the column of a covariate in the data of each measure."""
    return f" covariate {name}"


@dataclass(frozen=True, slots=True, eq=False)
class MeasureData:
    """The values of one measure, with the treatments of each run.

    Attributes:
        frame: one row for each run with a value: `run_id`, ` place` (in the order of execution, from 1), ` value`,
            ` block` and ` batch` (where the design has them), and each factor as an ordered categorical of texts.
        every: the same for all runs that are done; ` value` is NaN where it is missing.
        factors: those with two or more treatments among the runs with a value.
        is_extended: whether the runs with a value are from several batches.
        covariates: the covariates that values are adjusted for; `frame` has a column for each, and only the runs that
            have all of them.
        known: the design, beyond factors and blocks.
    """

    name: str
    frame: pd.DataFrame
    every: pd.DataFrame
    factors: tuple[str, ...]
    is_blocked: bool
    is_extended: bool = False
    covariates: tuple[str, ...] = ()
    known: KnownDesign = PLAIN
    block: str = ""
    conditions: Conditions = field(default_factory=dict)

    @property
    def values(self) -> Floats:
        """The values of all runs that have one."""
        return np.asarray(self.frame[VALUE], dtype=np.float64)

    @property
    def blocks(self) -> NDArray[np.str_]:
        """The block of each run that has a value."""
        return np.asarray(self.frame[_BLOCK], dtype=str)

    @property
    def batches(self) -> Numbers:
        """The number of the batch of each run that has a value."""
        return np.asarray(self.frame[BATCH].astype(int), dtype=np.intp)

    @property
    def plots(self) -> Numbers:
        """The number of the whole plot of each run with a value, in a split-plot design."""
        return numbered(self.frame, list(map(role_column, self.known.unit_columns)))

    @property
    def unit_names(self) -> list[str]:
        """The experimental unit of each run with a value: its block, whole plot or subject."""
        if self.is_blocked:
            return list(map(str, self.blocks))
        if self.known.whole_plot:
            return list(map(str, self.plots))
        names = self.known.unit_columns
        return list(self.frame[role_column(names[0])].astype(str)) if names else [""] * len(self.frame)

    def with_plots_as_blocks(self) -> MeasureData:
        """Return the same runs with the whole plots of a split-plot design as blocks."""
        return replace(self, frame=self.frame.assign(**{_BLOCK: self.plots.astype(str)}), is_blocked=True, known=PLAIN)

    def covariate(self, name: str) -> Floats:
        """Return the value of a covariate for each run with a value."""
        return np.asarray(self.frame[covariate_column(name)], dtype=np.float64)

    @property
    def lacking(self) -> dict[str, list[str]]:
        """The covariates that runs with a value lack, by run; runs that lack none are left out."""
        if not self.covariates:
            return {}
        every = self.every[self.every[VALUE].notna() & ~self.every[RUN_ID].isin(set(self.frame[RUN_ID]))]
        found = {
            run_id: [name for name in self.covariates if row[covariate_column(name)] != row[covariate_column(name)]]
            for run_id, row in every.set_index(RUN_ID).iterrows()
        }
        return {str(run_id): names for run_id, names in found.items() if names}

    @property
    def treatments(self) -> Factors:
        """The treatments of each factor among runs with a value; conditional factors are nested."""
        levels = {name: self.levels(name) for name in self.factors}
        conditions = {name: of for name in self.factors if (of := self._deciding(name, levels))}
        for name in set(self.factors) & self.conditions.keys() - conditions.keys():
            levels[name] += [IDLE] if IDLE in set(self.frame[name]) else []  # not tested, see `stranded`
        return factors_of(levels, conditions)

    def _deciding(self, name: str, levels: Mapping[str, Sequence[str]]) -> dict[str, tuple[str, ...]]:
        return {
            parent: wanted
            for parent, wanted in self.conditions.get(name, {}).items()
            if parent in levels and (parent in self.conditions or not set(levels[parent]) <= set(wanted))
        }

    @property
    def stranded(self) -> list[str]:
        """The conditional factors whose condition is not on a factor that is compared."""
        return [name for name, levels in self.treatments.items() if name in self.conditions and IDLE in levels]

    def within(self, factors: Sequence[str]) -> str:
        """Return the runs within which an effect is estimated, as in `Sensor=camera`; empty for all runs."""
        return self.treatments.within(factors)

    def others(self, factors: Sequence[str]) -> list[str]:
        """Return the other factors: neither these nor nested in them."""
        nested = self.treatments.nested_in(factors)
        return [name for name in self.factors if name not in {*factors, *nested}]

    def strata_columns(self, but: str) -> list[str]:
        """Return the columns of the strata within which only one factor differs, block and batch included."""
        return [*self.others([but]), *([_BLOCK] if self.is_blocked else []), *([BATCH] if self.is_extended else [])]

    def levels(self, factor: str) -> list[str]:
        """Return the treatments of a factor among runs with a value, in their order."""
        present = set(self.frame[factor]) - ({IDLE} if factor in self.conditions else set())
        return [str(level) for level in self.frame[factor].cat.categories if level in present]

    def groups(self, factors: Sequence[str]) -> list[Group]:
        """Return the runs of each combination of treatments of these factors with at least one value."""
        return [group for group in self.described_groups(factors) if len(group.values)]

    def applied_groups(self, factors: Sequence[str]) -> list[Group]:
        """Return the described groups, except those in which a factor does not apply."""
        conditional = [name for name in factors if name in self.conditions]
        return [
            group
            for group in self.described_groups(factors)
            if all(group.treatments[name] != IDLE for name in conditional)
        ]

    def described_groups(self, factors: Sequence[str]) -> list[Group]:
        """Return the runs of each combination of treatments of these factors with at least one run that is done."""
        values = np.asarray(self.every[VALUE], dtype=np.float64)
        run_ids = np.asarray(self.every[RUN_ID], dtype=object)
        columns = [_BLOCK] if self.is_blocked else list(map(role_column, self.known.unit_columns))
        units = numbered(self.every, columns) if columns else None
        unit = (self.block or "block") if self.is_blocked else next(iter(self.known.unit_columns), "")
        if not factors:
            return [group_of({}, values, run_ids, units, unit)]
        # Sorted by the codes of the treatments, so that groups are in the order of the treatments.
        codes = [np.asarray(self.every[factor].cat.codes) for factor in factors]
        categories = [self.every[factor].cat.categories.astype(str).tolist() for factor in factors]
        order = np.lexsort(codes[::-1])
        keys = np.column_stack(codes)[order]
        starts = np.flatnonzero(np.any(np.diff(keys, axis=0), axis=1)) + 1
        return [
            group_of(
                {name: names[code] for name, names, code in zip(factors, categories, keys[first], strict=True)},
                values[rows],
                run_ids[rows],
                None if units is None else units[rows],
                unit,
            )
            for first, rows in zip((0, *starts), np.split(order, starts), strict=True)
            if len(rows)
        ]


@dataclass(frozen=True, slots=True)
class Design:
    """The design: factors, blocks and covariates of the runs that are done.

    Attributes:
        frame: one row for each run that is done: `run_id`, ` place`, the factors as ordered categoricals of texts,
            ` block`.
        factors: those with two or more treatments.
        constant: those with one treatment.
        block: the column of the blocks, or None.
        left_out: how many runs of the table are not done.
        covariates: the covariates that measures are adjusted for; a covariate itself is not adjusted.
        known: the design, beyond factors and blocks.
    """

    results: Results
    frame: pd.DataFrame
    factors: tuple[str, ...]
    constant: tuple[str, ...]
    block: str | None
    left_out: int
    without: frozenset[str] = frozenset()
    covariates: tuple[str, ...] = ()
    known: KnownDesign = PLAIN
    conditions: Conditions = field(default_factory=dict)
    _known_data: dict[str, MeasureData | None] = field(default_factory=dict, init=False, repr=False, compare=False)

    def data(self, measure: str) -> MeasureData | None:
        """Return the data of a measure, or None if its values are not numbers."""
        if measure not in self._known_data:
            values = self._numbers(measure)
            covariates = () if measure in self.covariates else self.covariates
            self._known_data.clear()  # tables of all measures would fill the memory
            self._known_data[measure] = None if values is None else self._data(measure, values, covariates)
        return self._known_data[measure]

    def answers(self, measure: str) -> MeasureData | None:
        """Return the unadjusted data of a yes-or-no measure, with 1 for yes; None for other measures."""
        values = self.results.done[measure]
        if not isinstance(values.dtype, pd.BooleanDtype):
            return None
        return self._data(measure, values.to_numpy(dtype=np.float64, na_value=np.nan), ())

    def _data(self, measure: str, values: Floats, covariates: tuple[str, ...]) -> MeasureData:
        told = {covariate_column(name): self._covariate(name) for name in covariates}
        every = self.frame.assign(**{VALUE: values, **told})
        if self.without:
            every = every[~every[RUN_ID].isin(self.without)].reset_index(drop=True)
        known = [column for column in told if every[column].notna().any()]
        frame = every[every[[VALUE, *known]].notna().all(axis="columns")].reset_index(drop=True)
        factors = tuple(name for name in self.factors if _several(frame[name], self.conditions))
        is_extended = BATCH in frame and _distinct(frame[BATCH]) > 1
        is_blocked, block = self.block is not None, self.block or ""
        told_of = (is_blocked, is_extended, covariates, self.known, block, self.conditions)
        return MeasureData(measure, frame, every, factors, *told_of)

    def _numbers(self, measure: str) -> Floats | None:
        """Return the values of a measure, NaN where one is missing; None if they are not numbers."""
        values = self.results.done[measure]
        if isinstance(values.dtype, pd.StringDtype | pd.BooleanDtype) or values.dtype == object:
            return None
        return np.asarray(values.to_numpy(dtype=np.float64, na_value=np.nan))

    def _covariate(self, name: str) -> Floats:
        """Return the value of a covariate for each run; all NaN if it has no numbers."""
        done = self.results.done
        found = self._numbers(name) if name in self.results.measures else None
        if found is None and name == ORDER and name not in done:
            found = self.frame[PLACE].to_numpy(dtype=np.float64)
        is_told = STAMP in done and execution_order(self.results).has_times
        if found is None and name == ELAPSED and name not in done and is_told:
            found = (done[STAMP] - done[STAMP].min()).dt.total_seconds().to_numpy(dtype=np.float64, na_value=np.nan)
        return np.full(len(done), np.nan) if found is None else found

    def summary(self) -> DesignSummary:
        """Return the design in figures and in a sentence."""
        counts = self.frame.groupby(list(self.factors), observed=True).size() if self.factors else None
        found = [len(self.frame)] if counts is None else [int(count) for count in counts]
        return DesignSummary(
            factors=self.factors,
            constant_factors=self.constant,
            block=self.block,
            used=len(self.frame),
            left_out=self.left_out,
            combinations=len(found),
            empty_combinations=self.possible - len(found),
            smallest_group=min(found, default=0),
            largest_group=max(found, default=0),
            sentence=self._sentence(found),
            kind=self.known.kind,
            within=self._within,
        )

    @property
    def possible(self) -> int:
        """How many combinations the treatments that occur allow."""
        return self._treatments.count

    @property
    def _within(self) -> dict[str, str]:
        treatments = self._treatments
        return {name: treatments.within([name]) for name in treatments.conditions}

    @property
    def _treatments(self) -> Factors:
        """The factors with the treatments that occur."""
        levels = {
            name: [text for text in dict.fromkeys(self.frame[name]) if text != IDLE or name not in self.conditions]
            for name in self.factors
        }
        every = {
            name: {each: of for each, of in self.conditions.get(name, {}).items() if each in levels} for name in levels
        }
        return factors_of(levels, {name: of for name, of in every.items() if of})

    def _sentence(self, counts: Sequence[int]) -> str:
        if not len(self.frame):
            return "No run is done."
        runs = f"{counted(len(self.frame), 'run')} {'is' if len(self.frame) == 1 else 'are'} done"
        if not self.factors:
            return f"{runs}, all with the same treatments."
        levels, within = self._treatments, {name: f" within {which}" for name, which in self._within.items()}
        named = [f"{name} ({counted(len(of), 'treatment')}{within.get(name, '')})" for name, of in levels.items()]
        kind = "" if self.known.is_plain else f" ({self.known.in_words})"
        least, most = min(counts), max(counts)
        sizes = counted(least, "run") if least == most else f"{least} to {most} runs"
        blocks = f", in blocks of {self.block}" if self.block else ""
        return f"{runs}; varied: {enumerated(named)}; {sizes} a combination{blocks}{kind}."


def design_of(results: Results, *, blocks: str | None = None) -> Design:
    """Return the design of an experiment from its runs that are done.

    Blocks are those of this column, or with None those within which the order was randomised.
    """
    done = (results := results.confirming).done
    column = blocks if blocks in results.runs.columns else results.block
    known = KnownDesign.of_manifest(results.manifest, results.runs.columns)
    if are_complete(known, results):
        known, column = PLAIN, known.blocks[0]
    if column is not None and known != PLAIN:  # only a full factorial has complete blocks
        known, column = replace(known, blocks=tuple(dict.fromkeys([*known.blocks, column]))), None
    columns = {RUN_ID: done[RUN_ID], PLACE: execution_order(results).places}
    counted_only = {results.repetition, column, *known.columns}
    names = [name for name in results.factors if name not in counted_only]
    for name in names:
        columns[name] = treatment_texts(done[name]).cat.remove_unused_categories()
    columns |= {role_column(name): done[name].astype("str") for name in known.columns}
    if column is not None:
        columns[_BLOCK] = done[column].astype("str")
    batches = None if results.batch in {None, column} else done[results.batch].fillna(1).astype(int)
    if batches is not None and _distinct(batches) > 1:
        columns[BATCH] = pd.Categorical(batches, ordered=True)
        if column is not None and column == results.repetition:  # repetitions continue counting across batches
            columns[_BLOCK] = columns[_BLOCK] + " of batch " + batches.astype("str")
    if known.period:
        columns |= treatments_before(results, known, names)
    frame = pd.DataFrame(columns)
    conditions = _conditions(results, counted_only)
    varied = tuple(name for name in names if _several(frame[name], conditions))
    constant = tuple(name for name in names if name not in varied)
    has_blocks = column is not None and _distinct(frame[_BLOCK]) > 1
    block = column if has_blocks else None
    known = with_structure(known, results, frame, varied, conditions)
    left_out = len(results.runs) - len(done)
    return Design(results, frame, varied, constant, block, left_out, known=known, conditions=conditions)


def _conditions(results: Results, blocks: Collection[str | None]) -> Conditions:
    """Return the conditions of conditional factors, from the planned runs; blocks are the last choice as parents."""
    names = sorted(results.factors, key=lambda name: name not in blocks)
    planned = results.runs[names].astype("str").drop_duplicates()
    # A treatment may happen to be named `inactive`: the schema of our run tables says whether a factor is conditional.
    columns = {name: results.columns[name] for name in results.factors if name in results.columns}
    found = conditions_of(planned)
    return {name: of for name, of in found.items() if name not in columns or columns[name].description != EVERYWHERE}


def _several(treatments: pd.Series, conditions: Conditions) -> bool:
    """Return whether a factor has several treatments; `inactive` is not a treatment of a conditional factor."""
    return len(set(treatments) - ({IDLE} if treatments.name in conditions else set())) > 1


def _distinct(values: pd.Series) -> int:
    return len(set(values))
