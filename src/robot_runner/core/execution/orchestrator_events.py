"""The events whose callbacks the orchestrating process executes itself: of the experiment, and around each run."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

from robot_runner.core.errors import ExecutionError
from robot_runner.core.events.context import ExperimentContext, Resources, SystemClock
from robot_runner.core.events.early_end import RunInterrupted
from robot_runner.core.events.manager import CallbackFailure, Emission, RobotRunnerEvents
from robot_runner.core.execution.interruption import InterruptGate
from robot_runner.core.execution.run_ending import failure_fields
from robot_runner.core.execution.run_events import run_contexts
from robot_runner.core.storage.journal import utc_now

if TYPE_CHECKING:
    from collections.abc import Callable

    from robot_runner.core.config.experiment import Experiment
    from robot_runner.core.execution.interruption import Interruption
    from robot_runner.core.execution.progress_manager import PendingRun, ProgressManager
    from robot_runner.core.execution.task import RunTask

__all__ = ["OrchestratorEvents"]


class OrchestratorEvents:
    """Emits `before_experiment`, `before_run`, `continue` and `after_experiment`.

    Args:
        experiment: whose callbacks are called.
        progress: takes down what happens.
        interruption: the user's; it ends the callback that is being executed.
    """

    def __init__(self, experiment: Experiment, progress: ProgressManager, interruption: Interruption) -> None:
        self._experiment = experiment
        self._progress = progress
        self._interruption = interruption

    def emit_to_run(self, event: RobotRunnerEvents, task: RunTask, report: Any) -> list[object]:
        """Emit an event of a run in this process; a callback that raises is reported as a failure of the run."""
        report("event", {"event": event.value, "at": utc_now(), "clock": time.monotonic()})
        if not self._experiment.events.subscribers(event):
            return []
        resources = Resources()
        context_for = run_contexts(self._experiment, task, clock=SystemClock(), resources=resources, report=report)
        try:
            emission = self._emit(event, context_for)
            for failure in emission.failures:
                report("failure", {"event": event.value, "owner": failure.owner, **failure_fields(failure.error)})
            return [returned for _, returned in emission.returned]
        finally:
            resources.close()

    def _emit(self, event: RobotRunnerEvents, context_for: Callable[[str], object]) -> Emission:
        """Emit an event in this process; Ctrl-C ends the callback that is being executed."""
        gate = InterruptGate()
        try:
            with self._interruption.passed_on(gate):
                if event is not RobotRunnerEvents.AFTER_EXPERIMENT:
                    gate.arm()
                return self._experiment.events.emit(event, context_for)
        except RunInterrupted as error:  # between two callbacks
            return Emission((), (), (CallbackFailure(event, "", error),))

    def emit_to_experiment(self, event: RobotRunnerEvents) -> None:
        """Emit an event of the whole experiment.

        Raises:
            ExecutionError: a callback raised.
        """
        context = ExperimentContext(
            experiment_name=self._experiment.parameters.experiment_name,
            experiment_folder=self._experiment.folder.root,
            robot=self._experiment.parameters.robot,
            seed=self._progress.seed,
        )
        self._progress.note("event", event=event.value)
        for failure in self._emit(event, lambda _: context).failures:
            if isinstance(failure.error, RunInterrupted):
                return
            fields = failure_fields(failure.error)
            self._progress.note("failure", event=event.value, owner=failure.owner, problem=fields["problem"])
            raise ExecutionError(
                fields["problem"],
                where=f"{event.value} of {failure.owner}",
                fix="Mend this callback and start the experiment again: it resumes.",
            ) from failure.error

    def user_has_continued(self, finished: PendingRun) -> bool:
        """Emit `continue`; a callback that returns True has asked the user itself."""
        task = self._progress.task_of(finished)
        returned: list[object] = []

        def report(kind: str, fields: dict[str, Any]) -> None:
            self._progress.record(task, kind, fields)
            if kind == "failure" and not self._interruption.is_requested:
                raise ExecutionError(
                    fields["problem"], where=f"continue of {fields['owner']}", fix="Mend this callback, and resume."
                )

        returned += self.emit_to_run(RobotRunnerEvents.CONTINUE, task, report)
        return any(value is True for value in returned)
