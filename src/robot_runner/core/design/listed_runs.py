"""A design whose runs are listed one by one, with their ids, as no factorial with exclusions describes them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import repeat
from typing import Any, Final

from robot_runner.core.design.columns import RUN_IDS, NamedColumn, column_name
from robot_runner.core.design.factor import Combination, Factor, factor_places
from robot_runner.core.design.planned_runs import PlannedRun, RunOrder
from robot_runner.core.design.run_table_model import RunTable, RunTableModel
from robot_runner.core.errors import DesignError, Finding


@dataclass(frozen=True, slots=True)
class ListedRun:
    """One run of a listed design.

    Attributes:
        treatments: one of each factor's own treatments, by the factor's name.
        repetition: which repetition of the combination it is, from 1.

    Example:
        >>> ListedRun("run_0", {"Task": "Video"}).repetition
        1
    """

    run_id: str
    treatments: Mapping[str, Any]
    repetition: int = 1


class ListedRunTableModel(RunTableModel):
    """A design that was made elsewhere, with its runs in the listed order.

    Example:
        >>> from robot_runner.core.design.factor import Factor
        >>> runs = [ListedRun("run_0", {"Task": "Video"}), ListedRun("run_1", {"Task": "Network"})]
        >>> [run.run_id for run in ListedRunTableModel([Factor("Task", ["Video", "Network"])], runs).plan()]
        ['run_0', 'run_1']
    """

    def __init__(
        self,
        factors: Sequence[Factor],
        runs: Sequence[ListedRun],
        *,
        data_columns: Sequence[NamedColumn] = (),
        order: RunOrder | None = None,
    ) -> None:
        """Check the whole design.

        There are perhaps no factors, where the same thing is repeated; `order` is how the listed order was made.

        Raises:
            DesignError: it is invalid; `findings` lists all problems.
        """
        DesignError.refuse([*run_findings([run.run_id for run in runs]), *_column_findings(factors, data_columns)])
        # Without `RunTableModel.__init__`, which enumerates all combinations.
        vars(self).update(factors=tuple(factors), repetitions=1, data_columns=tuple(data_columns), warnings=())
        self.runs: Final = tuple(runs)
        self._order = order or RunOrder()
        self._listed = RunTable(self, _planned(self.factors, runs), self._order)

    def plan(self, seed: int | None = None) -> RunTable:
        """Return the run table as listed, whatever the seed."""
        del seed
        return self._listed


def _planned(factors: Sequence[Factor], runs: Sequence[ListedRun]) -> Iterator[PlannedRun]:
    places = factor_places(factor.name for factor in factors)
    columns = [[run.treatments[factor.name] for run in runs] for factor in factors]
    # Without factors, all runs have the same, empty combination.
    combinations = zip(*columns, strict=True) if columns else repeat(())
    for number, (run, treatments) in enumerate(zip(runs, combinations, strict=False), start=1):
        yield PlannedRun(run.run_id, number, Combination(places, treatments), run.repetition)


def run_findings(run_ids: Sequence[str]) -> Iterator[Finding]:
    """Yield an error for each invalid or repeated run id, or if there are none."""
    if not run_ids:
        yield Finding.error("run table", "the run table has no runs", "List at least one, or exclude fewer.")
    for run_id, count in Counter(run_id.casefold() for run_id in run_ids).items():
        if count > 1:
            yield Finding.error("run table", f"{count} runs have the id {run_id!r}", "Give each an id of its own.")
    for run_id in run_ids:
        if not RUN_IDS.fullmatch(run_id):
            fix = "Use letters, digits, '_', '-' and '.' (60 at most): it names the run's folder."
            yield Finding.error("run table", f"a run cannot have the id {run_id!r}", fix)


def _column_findings(factors: Sequence[Factor], data_columns: Sequence[NamedColumn]) -> Iterator[Finding]:
    for name, count in Counter([*(factor.name for factor in factors), *map(column_name, data_columns)]).items():
        if count > 1:
            yield Finding.error("run table", f"{count} columns are called {name!r}", "Rename all but one.")
