"""The planned study: its design and its analysis, for planning the number of repetitions."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
import pandas as pd

from robot_runner.analysis.results import Results
from robot_runner.analysis.run_frame import RunFrame
from robot_runner.analysis.statistics.execution_order import STAMP
from robot_runner.analysis.statistics.known_design import KnownDesign
from robot_runner.analysis.statistics.nested_factors import IDLE, NestedFactors, conditions_of
from robot_runner.core.design.analysis_plan import AnalysisPlan
from robot_runner.core.design.columns import BATCH, REPETITION, RUN_ID, STATUS
from robot_runner.core.design.design import CombinationDesign
from robot_runner.core.design.factor import Factor
from robot_runner.core.design.listed_runs import ListedRunTableModel
from robot_runner.core.design.run_table_model import RunTableModel
from robot_runner.core.errors import AnalysisError, did_you_mean
from robot_runner.core.storage.cells import RunStatus
from robot_runner.core.storage.table_columns import ColumnDescription, ColumnRole
from robot_runner.core.words import enumerated

#: A fixed seed, so that the order of the runs is reproducible.
_SEED = 20210525

#: The texts of one treatment of each factor, in the order of the factors.
Cell = tuple[str, ...]


class ArrangedRun(NamedTuple):
    """A run of a study: its combination, its repetition, and its blocks by column."""

    cell: Cell
    repetition: int
    blocks: Mapping[str, str]


@dataclass(frozen=True)
class Study:
    """A design with a variable number of repetitions, and its analysis.

    Attributes:
        factors: the treatments of each factor, as texts; without the blocks of a special design.
        cells: the executed combinations.
        blocks: the column within which the order is randomised: a factor or the repetition; None without blocks.
        repetitions: the number in the config.
        units: the measures of the run table, with their units.
        is_repeated: whether `repeat_until` adds repetitions until measures are precise.
        columns: the treatments of all factors of the config, including blocks, except of one that counts repetitions.
        facts: of a special design; empty for a full factorial.
        arranged: returns the runs of a special design for a number of repetitions; None for a full factorial.
    """

    name: str
    factors: Mapping[str, tuple[str, ...]]
    cells: tuple[Cell, ...]
    blocks: str | None
    shuffle: bool
    repetitions: int
    plan: AnalysisPlan | None
    units: Mapping[str, str]
    is_repeated: bool = False
    columns: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    facts: Mapping[str, Any] = field(default_factory=dict)
    arranged: Callable[[int], tuple[ArrangedRun, ...]] | None = None

    @classmethod
    def of_model(cls, name: str, model: RunTableModel, plan: AnalysisPlan | None, units: Mapping[str, str]) -> Self:
        """Return the study of a config.

        A factor that only counts repetitions (as in the paper's Listing 1) is not a factor here: its treatments are the
        repetitions.

        Raises:
            AnalysisError: the runs are listed one by one, so that there are no repetitions to choose; a special design
                has a factor that counts them; or the plan's blocks are not in the design, as which robot is free.
            DesignError: the design is too large to be planned.
        """
        if isinstance(model, ListedRunTableModel):
            fix = "Describe the design with factors and repetitions."
            raise AnalysisError("the runs are listed one by one", where=f"{name}.create_run_table", fix=fix)
        model.plan()
        facts = {} if model.is_full_factorial else dict(model.design_facts)
        counting = counting_factor(model)
        if counting is not None and not model.is_full_factorial:  # such a design cannot be repeated
            raise counts_repetitions(counting, name)
        counted_by = counting.name if counting is not None else REPETITION
        no_factors = {*_block_columns(model), counted_by}
        studied = [factor for factor in model.factors if factor.name not in no_factors]
        arranged = None if model.is_full_factorial else _arranged(model, [factor.name for factor in studied])
        found = [[each[factor.name] for factor in studied] for each in model.combinations_of(model.factors)]
        if plan is not None and plan.blocks == counted_by:
            plan = replace(plan, blocks=REPETITION)
        if plan is not None and plan.blocks not in {None, REPETITION, *(factor.name for factor in model.factors)}:
            raise _no_column(plan.blocks, name)
        listed = (tuple(map(str, each)) for each in found)
        if arranged is not None:
            listed = (run.cell for run in arranged(model.repetitions))
        cells = tuple(dict.fromkeys(listed))
        used = [{cell[place] for cell in cells} for place in range(len(studied))]  # some may be excluded everywhere
        return cls(
            name,
            {
                factor.name: tuple(text for text in factor.texts if text in texts)
                for factor, texts in zip(studied, used, strict=True)
            },
            cells,
            REPETITION if model.blocks == counted_by else model.blocks,
            model.shuffle,
            model.repetitions if counting is None else len(counting.treatments),
            plan,
            units,
            columns={factor.name: tuple(factor.texts) for factor in model.factors if factor is not counting},
            facts=facts,
            arranged=arranged,
        )

    @cached_property
    def nested(self) -> NestedFactors:
        """The factors with their treatments, some of which may be conditional."""
        conditions = conditions_of(pd.DataFrame(self.cells, columns=list(self.factors)))
        levels = {
            name: [text for text in texts if text != IDLE or name not in conditions]
            for name, texts in self.factors.items()
        }
        return NestedFactors(levels, conditions)

    def treatments(self, name: str) -> list[str]:
        """Return the treatments of a factor, without `inactive`."""
        return self.nested[name]

    def apart(self, factors: Sequence[str]) -> tuple[str, str] | None:
        """Return two of these factors of which the first is constant where the second applies; else None."""
        left = self.nested.scope(factors)
        alone = [name for name in factors if len(left[name]) <= 1 < len(self.nested[name])]
        return next(
            (
                (name, each)
                for name in alone
                for each in factors
                if each != name and len(self.nested.scope([each])[name]) <= 1
            ),
            None,
        )

    @property
    def has_units(self) -> bool:
        """Whether runs are of blocks, whole plots or subjects."""
        planned = self.plan.blocks if self.plan is not None else None
        known = KnownDesign.of_manifest({"design": {"facts": dict(self.facts)}}, self.columns)
        return bool(self.blocks or planned or known.unit_columns)

    @property
    def varied(self) -> tuple[str, ...]:
        """The factors whose effects are tested: those with two or more treatments, without blocks."""
        blocks = {self.blocks, self.plan.blocks if self.plan is not None else None}
        return tuple(name for name, texts in self.nested.items() if len(texts) > 1 and name not in blocks)

    def factor(self, name: str, where: str) -> tuple[str, ...]:
        """Return the treatments of a factor.

        Raises:
            AnalysisError: there is no such factor.
        """
        if name not in self.factors:
            raise AnalysisError(f"there is no factor {name!r}", where=where, fix=did_you_mean(name, self.factors))
        return self.factors[name]

    def measure(self, name: str, where: str, simulated: Sequence[str] | None = None) -> str:
        """Return the name of a measure after checking that the run table has it, and that it is among the simulated.

        Raises:
            AnalysisError: there is no such measure, or what is said of it would have no effect.
        """
        if name not in self.units:
            raise AnalysisError(f"there is no measure {name!r}", where=where, fix=did_you_mean(name, self.units))
        if simulated is not None and name not in simulated:
            options = " ".join(f"--measure {shlex.quote(each)}" for each in (*simulated, name))
            all_of_them = f"Name all of them ({options}), or leave it out."
            fix = f"{did_you_mean(name, simulated, '')} {all_of_them}".strip()
            raise AnalysisError(f"{name} is not simulated, only {enumerated(simulated)}", where=where, fix=fix)
        return name

    def runs(self, repetitions: int) -> int:
        """Return the number of runs for a number of repetitions."""
        return repetitions * len(self.cells) if self.arranged is None else len(self.arranged(repetitions))

    def results(self, repetitions: int, values: Mapping[str, Any], first_batch: int | None = None) -> PlannedResults:
        """Return the results that the study would have after a number of repetitions.

        The values of each measure are one for each run; runs are in the order of the repetitions, each with all
        combinations. `first_batch` is how many repetitions were executed before the experiment was extended; None if it
        was not.
        """
        rows = self._rows(repetitions)
        count = len(rows)
        frame = {
            RUN_ID: pd.array([f"r_{place}" for place in range(1, count + 1)], dtype="str"),
            STATUS: pd.Categorical([RunStatus.DONE.value] * count, [RunStatus.DONE.value]),
        }
        for place, (name, texts) in enumerate(self.factors.items()):
            frame[name] = pd.Categorical([run.cell[place] for run in rows], texts, ordered=True)
        block_columns = rows[0].blocks if rows else {}
        for name in block_columns:
            texts = tuple(dict.fromkeys(run.blocks[name] for run in rows))
            frame[name] = pd.Categorical([run.blocks[name] for run in rows], texts, ordered=True)
        frame[REPETITION] = pd.array([run.repetition for run in rows], dtype="Int64")
        roles = dict.fromkeys((RUN_ID, STATUS), ColumnRole.PROGRESS)
        roles |= dict.fromkeys((*self.factors, *block_columns), ColumnRole.FACTOR)
        roles[REPETITION] = ColumnRole.REPETITION
        if first_batch is not None:
            frame[BATCH] = pd.array([1 + (run.repetition > first_batch) for run in rows], dtype="Int64")
            roles[BATCH] = ColumnRole.BATCH
        if self.plan is not None and self.plan.covariates:
            frame[STAMP] = self._stamps(repetitions)
            roles[STAMP] = ColumnRole.TIMESTAMP
        roles |= dict.fromkeys(values, ColumnRole.MEASURE)
        columns = {
            name: ColumnDescription(name=name, role=role, unit=self.units.get(name, "")) for name, role in roles.items()
        }
        manifest = {
            "experiment_name": self.name,
            "design": {"blocks": self.blocks, "repetitions": repetitions}
            | ({"facts": self.facts} if self.facts else {}),
            "analysis": self.plan.as_mapping() if self.plan is not None else None,
        }
        return PlannedResults(Path(), manifest, columns, table=pd.DataFrame({**frame, **values}))

    def _stamps(self, repetitions: int) -> pd.DatetimeIndex:
        """Return the time stamp of each run, one minute apart, in an order randomised as in the config."""
        is_by_repetition = self.blocks == REPETITION and self.arranged is None
        sizes = [len(self.cells)] * repetitions if is_by_repetition else [self.runs(repetitions)]
        random = np.random.default_rng(_SEED)
        orders = [random.permutation(size) if self.shuffle else np.arange(size) for size in sizes]
        places = np.concatenate([number * len(order) + order for number, order in enumerate(orders)])
        return pd.Timestamp(0, tz="UTC") + pd.to_timedelta(places, unit="min")

    def cells_of(self, repetitions: int) -> Sequence[int]:
        """Return the index of each run's combination, in the order of `results`."""
        places = {cell: place for place, cell in enumerate(self.cells)}
        return [places[run.cell] for run in self._rows(repetitions)]

    def _rows(self, repetitions: int) -> Sequence[ArrangedRun]:
        if self.arranged is not None:
            return self.arranged(repetitions)
        return [ArrangedRun(cell, number, {}) for number in range(1, repetitions + 1) for cell in self.cells]


def counting_factor(model: RunTableModel) -> Factor | None:
    """Return the factor that only counts repetitions, which its name says, as in results; None if there is none."""
    return next((each for each in model.factors if each.name.casefold() == REPETITION.casefold()), None)


def counts_repetitions(factor: Factor, where: str) -> AnalysisError:
    """Return the error for a factor that counts repetitions in a design whose number of repetitions is to change."""
    fix = f"Give repetitions={len(factor.treatments)} in its place; where it is a block, call it otherwise."
    return AnalysisError(f"the factor {factor.name!r} counts the repetitions", where=where, fix=fix)


def _no_column(blocks: str | None, where: str) -> AnalysisError:
    """Return the error for blocks of a plan that runs get only when they are executed."""
    problem = f"the plan compares within {blocks}, which runs get only when they are executed, and not in the design"
    fix = f"To plan with so many that have all combinations each, make it a factor: Factor({blocks!r}, [...])."
    return AnalysisError(problem, where=where, fix=fix)


def _block_columns(model: RunTableModel) -> set[str]:
    if model.is_full_factorial:
        return set()
    names = [factor.name for factor in model.factors]
    return set(KnownDesign.of_manifest({"design": {"facts": dict(model.design_facts)}}, names).columns)


def _arranged(model: RunTableModel, studied: Sequence[str]) -> Callable[[int], tuple[ArrangedRun, ...]]:
    """Return a function that arranges the runs of a design for any number of repetitions; results are cached."""

    def listed(planned: RunTableModel) -> list[ArrangedRun]:
        return [
            ArrangedRun(
                tuple(str(run.combination[name]) for name in studied),
                run.repetition,
                {name: str(each) for name, each in run.combination.items() if name not in studied},
            )
            for run in planned.plan()
            if not run.is_warm_up
        ]

    @cache
    def arrange(repetitions: int) -> tuple[ArrangedRun, ...]:
        if repetitions == model.repetitions:
            return tuple(listed(model))
        if isinstance(model.design, CombinationDesign):  # its combinations do not depend on the repetitions
            once = [run for run in listed(model) if run.repetition == 1]
            return tuple(run._replace(repetition=number) for number in range(1, repetitions + 1) for run in once)
        return tuple(listed(model.repeated(repetitions)))

    return arrange


@dataclass(frozen=True)
class PlannedResults(Results):
    """Simulated results: a run table in memory, all of whose runs are done."""

    table: pd.DataFrame | None = None

    @property
    def _run_frame(self) -> RunFrame:
        return RunFrame(self.table if self.table is not None else pd.DataFrame(), ())

    @property
    def attempts(self) -> pd.DataFrame:
        """An empty table: nothing was executed."""
        return pd.DataFrame({RUN_ID: [], "status": []})
