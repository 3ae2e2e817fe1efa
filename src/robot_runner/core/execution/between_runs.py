"""Between two runs: the robot rests, or the user swaps its battery and says to go on."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robot_runner.core.config.parameters import OperationType
from robot_runner.core.design.held_order import HeldOrder
from robot_runner.core.execution.patience import Pause
from robot_runner.core.execution.pausing import pause_where_requested
from robot_runner.core.execution.reboots import Reboots

if TYPE_CHECKING:
    from collections.abc import Callable

    from robot_runner.core.config.experiment import Experiment
    from robot_runner.core.execution.notices import Notice, Observer
    from robot_runner.core.execution.operator import Operator
    from robot_runner.core.execution.orchestrator_events import OrchestratorEvents
    from robot_runner.core.execution.patience import Patience, Steps
    from robot_runner.core.execution.places import Place
    from robot_runner.core.execution.progress_manager import ProgressManager
    from robot_runner.core.execution.task import PendingRun

__all__ = ["BetweenRuns"]

#: How often a run looks whether a pause is over that was told of before another one, s.
_LOOK = 0.2


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

    Attributes:
        held: what the design holds of the order of runs.
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
        self._is_paused = False
        self.held = HeldOrder.of_facts(experiment.model.design_facts)
        self._rests = self.held.rests(experiment.model.plan(progress.seed) if self.held.rest_in_s else ())
        self._reboots = Reboots(experiment, progress, notify, patience)

    def prepare(
        self, run: PendingRun, finished: PendingRun | None, place: Place, name: str, *, is_cleared: bool = False
    ) -> Steps[None]:
        """Do what comes before a run, after the one that has finished at its place, if any did in this session.

        The operator's steps are done, the user says that the run may start where the config says SEMI, then the robot
        rests, and hosts are started anew that are to be. Who has just done a step before the run has said so already.

        Args:
            run: what comes.
            finished: what is over, or None.
            place: where both are executed.
            name: of that place; empty where there is no other.
            is_cleared: whether a callback has asked the user already whether the first run may start.
        """
        yield from self._pause_where_requested(run)
        if finished is not None and self._is_semi:
            is_cleared = self._events.user_has_continued(
                finished,
                run,
                lambda factor, owner: self._operator.note_read(run.run_id, factor, owner),
                name,
                place.experiment,
            )
        has_asked = yield from self._operator.prepare(run)
        if self._is_semi and not (is_cleared or has_asked or self._patience.interruption.is_requested):
            yield from self._operator.ask_to_start(run)
        rest = self._parameters.time_between_runs_in_ms / 1000 if finished is not None else 0.0
        # What one treatment left is to be gone: it is not known when the unit's last run ended, of another session too.
        rest = max(rest, self._rests.get(run.run_id, 0.0))
        if rest and not self._patience.interruption.is_requested:
            yield Pause(rest)
        if rest or finished is not None:
            yield from self._pause_where_requested(run)  # it may have been asked for meanwhile
        yield from self._reboots.before(run, finished)

    def _pause_where_requested(self, run: PendingRun) -> Steps[None]:
        while self._is_paused and not self._patience.interruption.is_requested:  # told of before another run
            yield Pause(_LOOK)
        self._is_paused = True
        try:
            user_input = self._observer.user_input
            pause = pause_where_requested(self._folder, run, self._progress, self._notify, self._patience, user_input)
            yield from pause
        finally:
            self._is_paused = False

    def prepare_again(self, run: PendingRun) -> Steps[None]:
        """Do what comes before another attempt at a run that failed: the steps that each attempt needs."""
        yield from self._operator.prepare(run, is_retry=True)

    @property
    def _is_semi(self) -> bool:
        return self._parameters.operation_type is OperationType.SEMI
