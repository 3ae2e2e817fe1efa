"""What the outcomes of runs show: values that are missing, and factors that nothing reads."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robot_runner.core.design.columns import REPETITION
from robot_runner.core.design.watched_combination import unread
from robot_runner.core.errors import Finding
from robot_runner.core.events.manager import RUN_EVENTS, RobotRunnerEvents
from robot_runner.core.events.measure import OPERATOR_OWNER
from robot_runner.core.execution.task import AttemptStatus

if TYPE_CHECKING:
    from robot_runner.core.config.experiment import Experiment
    from robot_runner.core.execution.task import RunOutcome, RunTask

__all__ = ["UnreadFactors", "missing_measures"]


class UnreadFactors:
    """The factors that vary and that no run has read so far."""

    def __init__(self, experiment: Experiment) -> None:
        self._experiment = experiment
        self._unread: dict[str, Finding] | None = None

    @property
    def findings(self) -> tuple[Finding, ...]:
        """A warning for each of them, once a run is done."""
        return tuple((self._unread or {}).values())

    def take(self, task: RunTask, outcome: RunOutcome) -> tuple[Finding, ...]:
        """Return what nobody read in the first run that is done; what a later run reads is not told at the end."""
        if outcome.status is not AttemptStatus.DONE or not self._has_callbacks():
            return ()
        if self._unread is None:
            model = self._experiment.model
            blocks = model.design_facts.get("block_columns", ())  # a day, a period: said of a run, and not applied
            varied = [each.name for each in model.factors if len(each.treatments) > 1 and each.name not in blocks]
            # A factor of that name counts repetitions, as in the paper's Listing 1.
            self._unread = {
                name: unread(task.run_id, name)
                for name in varied
                if name not in outcome.readers and name.casefold() != REPETITION.casefold()
            }
            return tuple(self._unread.values())
        for name in outcome.readers:
            self._unread.pop(name, None)
        return ()

    def _has_callbacks(self) -> bool:
        """Return whether anything happens in a run: a plan that is still to be filled cannot be misread."""
        return any(map(self._experiment.events.subscribers, (RobotRunnerEvents.BEFORE_RUN, *RUN_EVENTS)))


def missing_measures(experiment: Experiment, task: RunTask, outcome: RunOutcome) -> list[Finding]:
    """Return a warning for each measure of a run that is done and has no value of it."""
    if outcome.status is not AttemptStatus.DONE:
        return []
    return [
        Finding.warning(f"{task.run_id}, {column.owner}", f"{column.name} has no value", _fix(column.owner))
        for column in experiment.columns.in_table
        if column.owner != OPERATOR_OWNER  # a person is asked before some runs only
        if outcome.measures.get(column.name) is None or outcome.measures[column.name].value is None
    ]


def _fix(owner: str) -> str:
    return "Return it from populate_run_data." if owner == "config" else "Look at the log of the run."
