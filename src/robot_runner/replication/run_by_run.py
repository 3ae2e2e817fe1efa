"""Compare the values of two experiments run by run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from robot_runner.core.design.factor import Combination
from robot_runner.core.storage.cells import RunStatus
from robot_runner.core.storage.executed_runs import recorded_rows
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.run_table_rows import RunTableRows
from robot_runner.core.storage.table_schema import read_schema


@dataclass(frozen=True, slots=True)
class Sameness:
    """The comparison of one measure in the runs that are done in both experiments.

    Attributes:
        runs: the number of these runs with a value in either experiment.
        identical: the number of these with the same treatments and the same value in both, to the last digit.
        lacking: the number of further runs with a value in the original that are not done in the replication, or
            excluded there.

    Example:
        >>> Sameness(15, 15).is_complete, Sameness(1, 1, lacking=14).is_complete
        (True, False)
    """

    runs: int
    identical: int
    lacking: int = 0

    @property
    def is_same(self) -> bool:
        """Whether there are values, and all comparable ones are the same."""
        return self.runs > 0 and self.identical == self.runs

    @property
    def is_complete(self) -> bool:
        """Whether the replication has all values of the original, and they are the same."""
        return self.is_same and not self.lacking


def identical_values(original: Path, replication: Path) -> dict[str, Sameness]:
    """Compare the run tables of two experiments by the ids of their runs; runs that the original excludes are skipped.

    Returns:
        The comparison of each measure that both have.

    Raises:
        StorageError: a run table cannot be read.
    """
    ours, theirs, config = _rows(original), _rows(replication), ExperimentFolder.found_at(original).config
    counted = {place for place in range(len(theirs)) if theirs.status(place) is RunStatus.DONE}
    counted -= {place for place in counted if theirs.excluded(place) is not None}
    pairs = [
        (place, other if (other := theirs.place_of(ours.run_id(place))) in counted else None)
        for place in range(len(ours))
        if ours.status(place) is RunStatus.DONE and ours.excluded(place) is None and not ours.is_warm_up(place)
    ]
    return {
        name: _sameness(ours, theirs, name, pairs, config)
        for name in ours.layout.measures
        if name in theirs.layout.measures
    }


def statuses_that_count(rows: RunTableRows) -> list[RunStatus]:
    """Return the status of each run that is not excluded."""
    return [rows.status(place) for place in range(len(rows)) if rows.excluded(place) is None]


def is_executed(folder: Path) -> bool:
    """Return whether all runs of an experiment are done or failed, and at least one is done.

    Raises:
        StorageError: the run table cannot be read.
    """
    statuses = statuses_that_count(_rows(folder))
    return RunStatus.DONE in statuses and set(statuses) <= {RunStatus.DONE, RunStatus.FAILED}


def is_same_treatment(there: Any, here: Any, config: Path) -> bool:
    """Return whether a treatment of the original is that of the replication, or is a path to the same file.

    Args:
        there: the original's.
        here: the replication's: a path below `config` may be one that the config computes from its own place.
        config: the original's folder of configs, which the replication executes.

    Example:
        >>> is_same_treatment("/home/ada/study/lab.csv", Path("/package/config/lab.csv"), Path("/package/config"))
        True
    """
    path, folder = str(here), f"{config.absolute()}/"
    return str(there) == path or (path.startswith(folder) and str(there).endswith(f"/{path.removeprefix(folder)}"))


def _have_same_treatments(there: Combination, here: Combination, config: Path) -> bool:
    # As nearly always, and faster, they are equal.
    return there == here or (
        there.keys() == here.keys() and all(is_same_treatment(there[name], here[name], config) for name in there)
    )


def _sameness(
    ours: RunTableRows, theirs: RunTableRows, name: str, pairs: list[tuple[int, int | None]], config: Path
) -> Sameness:
    first_values, second_values = list(ours.values(name)), list(theirs.values(name))
    both = [(place, other) for place, other in pairs if other is not None]
    with_value = [pair for pair in both if (first_values[pair[0]], second_values[pair[1]]) != (None, None)]
    # With other settings, a run of the same id may have other treatments.
    identical = sum(
        first_values[place] == second_values[other]
        and _have_same_treatments(ours.combination(place), theirs.combination(other), config)
        for place, other in with_value
    )
    lacking = sum(other is None and first_values[place] is not None for place, other in pairs)
    return Sameness(len(with_value), identical, lacking)


def _rows(folder: Path) -> RunTableRows:
    files = ExperimentFolder.found_at(folder)
    return recorded_rows(files, read_schema(files.schema))[0]
