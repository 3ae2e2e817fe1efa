"""From what a run reported to how it went."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

from robot_runner.errors import Finding
from robot_runner.events.measure import Origin, PublishedMeasure
from robot_runner.execution.records import FINISHED
from robot_runner.execution.task import AttemptStatus, RunFailure, RunOutcome

if TYPE_CHECKING:
    from robot_runner.events.columns import MeasureColumns

__all__ = ["OutcomeBuilder"]


class OutcomeBuilder:
    """Gathers the records of one attempt; what it lacks when the run has ended tells how it ended."""

    def __init__(self, run_id: str, columns: MeasureColumns) -> None:
        self._run_id = run_id
        self._units = {column.name: column.measure.unit for column in columns.declared}
        self._stamps: dict[str, str] = {}
        self._measures: dict[str, PublishedMeasure] = {}
        self._findings: list[Finding] = []
        self._failures: list[RunFailure] = []
        self._started = time.monotonic()
        self.is_finished = False
        self.event = ""

    @property
    def has_failed(self) -> bool:
        """Whether a failure was recorded."""
        return bool(self._failures)

    def take(self, kind: str, fields: dict[str, Any]) -> None:
        """Take one record; kinds that say nothing about the outcome are passed over."""
        if kind == "event":
            self.event = fields["event"]
            self._stamps.setdefault(self.event, fields["at"])
        elif kind == "measure":
            name = fields["name"]
            origin = Origin(fields["origin"])
            self._measures[name] = PublishedMeasure(
                name, fields["value"], fields["owner"], self._units.get(name, ""), origin
            )
        elif kind == "finding":
            where = f"{self._run_id}, {fields['owner']}"
            self._findings.append(Finding.warning(where, fields["problem"], fields["fix"]))
        elif kind == "failure":
            self._failures.append(RunFailure(fields["problem"], fields["event"], fields["owner"], fields["traceback"]))
        elif kind == FINISHED:
            self.is_finished = True

    def outcome(self, *, ended_because: str = "", interrupted: bool = False) -> RunOutcome:
        """Return how the attempt went.

        Args:
            ended_because: why the run was ended or how its process died, where it did not end by itself.
            interrupted: whether the user asked for the end.
        """
        failures = list(self._failures)
        if ended_because:
            failures = (
                [self._ended(ended_because, failures), *failures[1:]] if failures else [self._ended(ended_because, [])]
            )
        status = AttemptStatus.INTERRUPTED if interrupted else AttemptStatus.FAILED if failures else AttemptStatus.DONE
        return RunOutcome(
            status=status,
            stamps=self._stamps,
            measures=self._measures,
            findings=tuple(self._findings),
            failure=failures[0] if failures else None,
            later_failures=tuple(failures[1:]),
            seconds=time.monotonic() - self._started,
        )

    def _ended(self, because: str, failures: list[RunFailure]) -> RunFailure:
        # The run's own record of being told to end knows the callback; the orchestrator knows why.
        first = failures[0] if failures else RunFailure("", self.event)
        return RunFailure(because, first.event or self.event, first.owner, first.traceback)
