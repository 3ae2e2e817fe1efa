"""What an experiment is, by its manifest and the columns of its run table: names, roles, units, plan."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from robot_runner.core.design.analysis_plan import AnalysisPlan
from robot_runner.core.design.batch import CONFIRMATION
from robot_runner.core.design.columns import REPETITION
from robot_runner.core.events.measure import QUALITY_SUFFIX
from robot_runner.core.storage.table_columns import ColumnRole

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from robot_runner.core.storage.table_schema import ColumnDescription

__all__ = ["ExperimentFacts"]


@dataclass(frozen=True)
class ExperimentFacts:
    """An experiment without its runs.

    Attributes:
        folder: the experiment's folder.
        manifest: the circumstances, as in `manifest.json`.
        columns: what each column of the run table is, by its heading: role, type, unit, owner, origin.
    """

    folder: Path
    manifest: Mapping[str, Any] = field(repr=False)
    columns: Mapping[str, ColumnDescription] = field(repr=False)

    @property
    def name(self) -> str:
        """The experiment's name."""
        return str(self.manifest.get("experiment_name", self.folder.name))

    @property
    def factors(self) -> tuple[str, ...]:
        """The factors, without the one that only counts repetitions (as in the paper's Listing 1)."""
        return tuple(name for name in self._named(ColumnRole.FACTOR) if name != self.repetition)

    @property
    def repetition(self) -> str | None:
        """The column that counts the repetitions of a combination (ours, or a factor of that name), if there is one."""
        counted = self._named(ColumnRole.REPETITION)
        named = [name for name in self._named(ColumnRole.FACTOR) if name.casefold() == REPETITION.casefold()]
        return next(iter((*counted, *named)), None)

    @property
    def block(self) -> str | None:
        """The column of the blocks within which the order was randomised (a factor, or the repetition), if any."""
        blocks = self.manifest.get("design", {}).get("blocks")
        return blocks if blocks in self.columns else None

    @property
    def batch(self) -> str | None:
        """The column that says in which batch a run was planned, where the experiment was extended: a stratum."""
        return next(iter(self._named(ColumnRole.BATCH)), None)

    @property
    def is_adaptive(self) -> bool:
        """Whether the design decided on runs from results: what it searched among is exploratory."""
        return bool((self.manifest.get("design") or {}).get("facts", {}).get("decides"))

    @property
    def confirming_batches(self) -> tuple[int, ...]:
        """The batches that confirm what a design has found that decides on its runs."""
        batches = (self.manifest.get("design") or {}).get("batches", ())
        return tuple(each["batch"] for each in batches if each.get("role") == CONFIRMATION)

    @property
    def measures(self) -> tuple[str, ...]:
        """The measures that have a column in the run table, in its order; columns of qualities are left out."""
        named = self._named(ColumnRole.MEASURE)
        telling = {name + QUALITY_SUFFIX for name in named}
        return tuple(name for name in named if name not in telling)

    @property
    def plan(self) -> AnalysisPlan | None:
        """What was fixed for the analysis before the experiment, or None."""
        return AnalysisPlan.of_mapping(plain) if (plain := self.manifest.get("analysis")) else None

    @property
    def seed(self) -> int | None:
        """What the order of the runs comes from; None where it is not known."""
        return None if (seed := self.manifest.get("seed")) is None else int(seed)

    def unit(self, name: str) -> str:
        """Return the unit of a column (SI symbol, `%`, `1`); empty where there is none or it is not known."""
        return self.columns[name].unit if name in self.columns else ""

    def label(self, name: str) -> str:
        """Return a heading for an axis or a table: the name with its unit in brackets, as in `Energy (J)`."""
        unit = self.unit(name)
        return f"{name} ({unit})" if unit not in {"", "1"} else name

    def _named(self, role: ColumnRole) -> tuple[str, ...]:
        return tuple(column.name for column in self.columns.values() if column.role is role)
