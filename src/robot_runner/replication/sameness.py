"""Whether the runs of a replication yielded the very same values: what a deterministic simulation has to do."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from robot_runner.storage.layout import ExperimentFolder
from robot_runner.storage.run_status import RunStatus
from robot_runner.storage.run_table_reading import read_run_table
from robot_runner.storage.table_layout import TableLayout
from robot_runner.storage.table_schema import read_schema

if TYPE_CHECKING:
    from pathlib import Path

    from robot_runner.storage.run_table_rows import RunTableRows

__all__ = ["Sameness", "identical_values"]


@dataclass(frozen=True, slots=True)
class Sameness:
    """One measure in the runs that are done in both experiments.

    Attributes:
        runs: how many of them have a value in either.
        identical: in how many of these the two values are the same, to the last digit.

    Example:
        >>> Sameness(15, 15).is_complete
        True
    """

    runs: int
    identical: int

    @property
    def is_complete(self) -> bool:
        """Whether there are values, and all are the same."""
        return self.runs > 0 and self.identical == self.runs


def identical_values(original: Path, replication: Path) -> dict[str, Sameness]:
    """Compare the run tables of two experiments run by run, by the runs' ids.

    Returns:
        Each measure that both have.

    Raises:
        StorageError: a run table cannot be read.
    """
    ours, theirs = _rows(original), _rows(replication)
    pairs = [
        (place, other)
        for place in range(len(ours))
        if (other := theirs.run_ids.place_of(ours.run_id(place))) is not None
        and ours.status(place) is theirs.status(other) is RunStatus.DONE
    ]
    return {name: _sameness(ours, theirs, name, pairs) for name in ours.measures if name in theirs.measures}


def _sameness(ours: RunTableRows, theirs: RunTableRows, name: str, pairs: list[tuple[int, int]]) -> Sameness:
    values = [(ours.measures[name].values[place], theirs.measures[name].values[other]) for place, other in pairs]
    with_value = [pair for pair in values if pair != (None, None)]
    return Sameness(len(with_value), sum(first == second for first, second in with_value))


def _rows(folder: Path) -> RunTableRows:
    files = ExperimentFolder.found_at(folder)
    return read_run_table(files.run_table, TableLayout.of_schema(read_schema(files.schema)))
