"""What carries runs: each in a process of its own, forked or spawned, or in the orchestrator itself."""

from __future__ import annotations

from contextlib import AbstractContextManager, redirect_stderr, redirect_stdout
from typing import TYPE_CHECKING, Protocol, Self

from robot_runner.core.config.parameters import RunProcess
from robot_runner.core.execution.guardian import Guardian
from robot_runner.core.execution.interruption import InterruptGate
from robot_runner.core.execution.run import execute_run
from robot_runner.core.execution.starters import ForkStarter, SpawnStarter
from robot_runner.core.execution.supervision import Limits, Watch, supervise
from robot_runner.core.execution.task import FINISHED, hand_over
from robot_runner.core.storage.layout import LazyLog

if TYPE_CHECKING:
    from robot_runner.core.config.experiment import Experiment
    from robot_runner.core.execution.guarding import Starter
    from robot_runner.core.execution.task import OutcomeBuilder, RunOutcome, RunTask

__all__ = ["Executor", "executor_for"]


class Executor(AbstractContextManager["Executor"], Protocol):
    """Executes one run and returns how it went, whatever becomes of the run. Entered once an experiment."""

    def execute(self, task: RunTask, builder: OutcomeBuilder, watch: Watch) -> RunOutcome:
        """Execute one attempt; `builder` holds what was known of it before."""
        ...

    def let_go(self) -> None:
        """Keep nothing of this process as it is now: callbacks are about to change it, which runs are to see."""
        ...


def executor_for(experiment: Experiment) -> Executor:
    """Return the executor that the config's `run_process` asks for."""
    match experiment.parameters.run_process:
        case RunProcess.FORK:
            return _ProcessExecutor(experiment, ForkStarter(experiment))
        case RunProcess.SPAWN:
            return _ProcessExecutor(experiment, SpawnStarter(experiment))
        case RunProcess.IN_PROCESS:
            return _InProcessExecutor(experiment)


class _ProcessExecutor:
    """A fresh process a run; how it is started is all that differs between forking and spawning."""

    def __init__(self, experiment: Experiment, starter: Starter) -> None:
        self._experiment = experiment
        self._starter = starter
        parameters = experiment.parameters
        self._limits = Limits(parameters.run_deadline_in_s, parameters.event_deadline_in_s, parameters.grace_in_s)
        self._guardian: Guardian | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *raised: object) -> None:
        self.let_go()

    def let_go(self) -> None:
        if self._guardian is not None:
            self._guardian.__exit__()
            self._guardian = None

    def execute(self, task: RunTask, builder: OutcomeBuilder, watch: Watch) -> RunOutcome:
        if self._guardian is not None and self._guardian.has_died():  # between two runs: it costs none
            self.let_go()
        if self._guardian is None:
            self._guardian = Guardian(self._starter, self._limits.grace).__enter__()
        run = self._guardian.start(hand_over(self._experiment, task))
        try:
            return supervise(run, builder, limits=self._limits, watch=watch)
        finally:
            run.end(self._limits.grace)  # still alive only if we cannot go on ourselves: the disk is full, say
            if run.guardian_was_killed:
                self.let_go()


class _InProcessExecutor:
    def __init__(self, experiment: Experiment) -> None:
        self._experiment = experiment

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *raised: object) -> None:
        return None

    def let_go(self) -> None:
        return None

    def execute(self, task: RunTask, builder: OutcomeBuilder, watch: Watch) -> RunOutcome:
        def report(kind: str, fields: dict[str, object]) -> None:
            builder.take(kind, fields)
            watch.report(kind, fields)
            if watch.refresh_interval is not None:
                watch.refresh()

        with LazyLog(self._experiment.folder) as log, redirect_stdout(log), redirect_stderr(log):
            gate = InterruptGate()
            with watch.interruption.passed_on(gate):
                execute_run(self._experiment, task, report, gate)
        report(FINISHED, {})
        return builder.outcome(interrupted=watch.interruption.is_requested)
