"""What a study plans: its design and its analysis, as the planning of its number of repetitions sees them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from robot_runner.analysis.results import Results
from robot_runner.analysis.run_frame import RunFrame
from robot_runner.core.design.columns import BATCH, REPETITION, RUN_ID, STATUS
from robot_runner.core.design.factor import treatment_text
from robot_runner.core.design.listed_runs import ListedRunTableModel
from robot_runner.core.errors import AnalysisError, did_you_mean
from robot_runner.core.storage.cells import RunStatus
from robot_runner.core.storage.table_columns import ColumnRole
from robot_runner.core.storage.table_schema import ColumnDescription

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from typing import Self

    from robot_runner.core.design.analysis_plan import AnalysisPlan
    from robot_runner.core.design.run_table_model import RunTableModel

__all__ = ["Cell", "PlannedResults", "Study"]

#: When a run was measured.
_STAMP = "start_measurement_at"
#: The order of the runs is the same each time.
_SEED = 20210525

#: The texts of one treatment of each factor, in the order of the factors.
Cell = tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Study:
    """A design that can be repeated more or less often, and how it will be analysed.

    Attributes:
        name: of the experiment.
        factors: the treatments of each factor, as texts.
        cells: the combinations that are executed.
        blocks: what the order is randomised within: a factor, the repetition, or nothing.
        shuffle: whether the order is randomised.
        repetitions: how many the config plans.
        plan: what is fixed for the analysis; None where nothing is.
        units: the measures of the run table, with their units.
        is_repeated: whether repetitions are added until measures are precise.
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

    @classmethod
    def of_model(cls, name: str, model: RunTableModel, plan: AnalysisPlan | None, units: Mapping[str, str]) -> Self:
        """Return the study that a config plans.

        Raises:
            AnalysisError: its runs are listed one by one, so that there are no repetitions to choose.
            DesignError: it is too large to be planned.
        """
        if isinstance(model, ListedRunTableModel):
            fix = "Describe the design with factors and repetitions."
            raise AnalysisError("the runs are listed one by one", where=f"{name}.create_run_table", fix=fix)
        model.plan()
        combinations = model.combinations_of(model.factors)
        return cls(
            name,
            {factor.name: tuple(factor.texts) for factor in model.factors},
            tuple(tuple(map(treatment_text, each.values())) for each in combinations),
            model.blocks,
            model.shuffle,
            model.repetitions,
            plan,
            units,
        )

    @property
    def varied(self) -> tuple[str, ...]:
        """The factors whose effects are tested: with two and more treatments, and no blocks."""
        blocks = {self.blocks, self.plan.blocks if self.plan is not None else None}
        return tuple(name for name, texts in self.factors.items() if len(texts) > 1 and name not in blocks)

    def factor(self, name: str, where: str) -> tuple[str, ...]:
        """Return the treatments of a factor.

        Raises:
            AnalysisError: there is no such factor.
        """
        if name not in self.factors:
            raise AnalysisError(f"there is no factor {name!r}", where=where, fix=did_you_mean(name, self.factors))
        return self.factors[name]

    def measure(self, name: str, where: str) -> str:
        """Return the name of a measure that the run table has.

        Raises:
            AnalysisError: there is no such measure.
        """
        if name not in self.units:
            raise AnalysisError(f"there is no measure {name!r}", where=where, fix=did_you_mean(name, self.units))
        return name

    def runs(self, repetitions: int) -> int:
        """Return how many runs so many repetitions make."""
        return repetitions * len(self.cells)

    def results(self, repetitions: int, values: Mapping[str, Any], first_batch: int | None = None) -> PlannedResults:
        """Return the results that the study would have after so many repetitions.

        Args:
            repetitions: of each combination.
            values: of each measure, one a run; runs come as written: all combinations, then all again.
            first_batch: how many repetitions were executed before the experiment was extended; None where it was not.
        """
        rows = [(cell, number) for number in range(1, repetitions + 1) for cell in self.cells]
        count = len(rows)
        frame = {
            RUN_ID: pd.array([f"r_{place}" for place in range(1, count + 1)], dtype="str"),
            STATUS: pd.Categorical([RunStatus.DONE.value] * count, [RunStatus.DONE.value]),
        }
        for place, (name, texts) in enumerate(self.factors.items()):
            frame[name] = pd.Categorical([cell[place] for cell, _ in rows], texts, ordered=True)
        frame[REPETITION] = pd.array([number for _, number in rows], dtype="Int64")
        roles = dict.fromkeys((RUN_ID, STATUS), ColumnRole.PROGRESS) | dict.fromkeys(self.factors, ColumnRole.FACTOR)
        roles[REPETITION] = ColumnRole.REPETITION
        if first_batch is not None:
            frame[BATCH] = pd.array([1 + (number > first_batch) for _, number in rows], dtype="Int64")
            roles[BATCH] = ColumnRole.BATCH
        if self.plan is not None and self.plan.covariates:
            frame[_STAMP] = self._stamps(repetitions)
            roles[_STAMP] = ColumnRole.TIMESTAMP
        roles |= dict.fromkeys(values, ColumnRole.MEASURE)
        columns = {
            name: ColumnDescription(name=name, role=role, unit=self.units.get(name, "")) for name, role in roles.items()
        }
        manifest = {
            "experiment_name": self.name,
            "design": {"blocks": self.blocks, "repetitions": repetitions},
            "analysis": self.plan.as_mapping() if self.plan is not None else None,
        }
        return PlannedResults(Path(), manifest, columns, table=pd.DataFrame({**frame, **values}))

    def _stamps(self, repetitions: int) -> pd.DatetimeIndex:
        """Return when each run is measured: a minute each, in an order that is randomised as the config says."""
        sizes = [len(self.cells)] * repetitions if self.blocks == REPETITION else [self.runs(repetitions)]
        random = np.random.default_rng(_SEED)
        orders = [random.permutation(size) if self.shuffle else np.arange(size) for size in sizes]
        places = np.concatenate([number * len(order) + order for number, order in enumerate(orders)])
        return pd.Timestamp(0, tz="UTC") + pd.to_timedelta(places, unit="min")

    def cells_of(self, repetitions: int) -> Sequence[int]:
        """Return the number of each run's combination, in the order of `results`."""
        return list(range(len(self.cells))) * repetitions


@dataclass(frozen=True)
class PlannedResults(Results):
    """Results that nobody measured: a run table in memory, all of whose runs are done.

    Attributes:
        table: the run table.
    """

    table: pd.DataFrame | None = None

    @property
    def _run_frame(self) -> RunFrame:
        return RunFrame(self.table if self.table is not None else pd.DataFrame(), ())
