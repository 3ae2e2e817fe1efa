"""Between two runs: the robot rests, or the user swaps its battery and says to go on."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robot_runner.core.config.parameters import OperationType
from robot_runner.core.execution.pausing import pause_where_requested
from robot_runner.core.execution.reboots import Reboots

if TYPE_CHECKING:
    from collections.abc import Callable

    from robot_runner.core.config.experiment import Experiment
    from robot_runner.core.execution.notices import Notice, Observer
    from robot_runner.core.execution.operator import Operator
    from robot_runner.core.execution.orchestrator_events import OrchestratorEvents
    from robot_runner.core.execution.patience import Patience
    from robot_runner.core.execution.progress_manager import ProgressManager
    from robot_runner.core.execution.task import PendingRun

__all__ = ["BetweenRuns"]


class BetweenRuns:
    """What happens between the end of a run and the beginning of the next.

    Args:
        experiment: what is executed.
        progress: takes down what happens.
        events: emits `continue`.
        operator: the person who takes part.
        observer: whose user may end a pause.
        notify: tells the screens.
        patience: what goes on meanwhile.
    """

    def __init__(
        self,
        experiment: Experiment,
        progress: ProgressManager,
        events: OrchestratorEvents,
        operator: Operator,
        observer: Observer,
        notify: Callable[[Notice], None],
        patience: Patience,
    ) -> None:
        self._parameters = experiment.parameters
        self._folder = experiment.folder
        self._observer = observer
        self._notify = notify
        self._progress = progress
        self._events = events
        self._operator = operator
        self._patience = patience
        self._reboots = Reboots(experiment, progress, notify, patience)

    def prepare(self, run: PendingRun, finished: PendingRun | None, *, is_cleared: bool = False) -> None:
        """Do what comes before a run, after the one that has finished, if any did in this session.

        The operator's steps are done, the user says that the run may start where the config says SEMI, then the robot
        rests, and hosts are started anew that are to be. Who has just done a step before the run has said so already.

        Args:
            run: what comes.
            finished: what is over, or None.
            is_cleared: whether a callback has asked the user already whether the first run may start.
        """
        self._pause_where_requested(run)
        if finished is not None and self._is_semi:
            is_cleared = self._events.user_has_continued(
                finished, run, lambda factor, owner: self._operator.note_read(run.run_id, factor, owner)
            )
        has_asked = self._operator.prepare(run)
        if self._is_semi and not (is_cleared or has_asked or self._patience.interruption.is_requested):
            self._operator.ask_to_start(run)
        if finished is not None:
            self._patience.rest(self._parameters.time_between_runs_in_ms / 1000)
            self._pause_where_requested(run)  # it may have been asked for meanwhile
        self._reboots.before(run, finished)

    def _pause_where_requested(self, run: PendingRun) -> None:
        user_input = self._observer.user_input
        pause_where_requested(self._folder, run, self._progress, self._notify, self._patience, user_input)

    def prepare_again(self, run: PendingRun) -> None:
        """Do what comes before another attempt at a run that failed: the steps that each attempt needs."""
        self._operator.prepare(run, is_retry=True)

    @property
    def _is_semi(self) -> bool:
        return self._parameters.operation_type is OperationType.SEMI
