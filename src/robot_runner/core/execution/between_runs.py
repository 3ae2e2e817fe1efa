"""Between two runs: the robot rests, or the user swaps its battery and says to go on."""

from __future__ import annotations

import os
import select
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

from robot_runner.core.config.parameters import OperationType
from robot_runner.core.execution.notices import WaitingForUser
from robot_runner.core.execution.pausing import pause_where_requested
from robot_runner.core.execution.reboots import Reboots
from robot_runner.core.storage.lock import Command, forget_command, take_command

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from robot_runner.core.config.experiment import Experiment
    from robot_runner.core.execution.interruption import Interruption
    from robot_runner.core.execution.notices import Notice, Observer
    from robot_runner.core.execution.orchestrator_events import OrchestratorEvents
    from robot_runner.core.execution.progress_manager import PendingRun, ProgressManager

__all__ = ["BetweenRuns", "Patience", "rest", "wait_for_user"]

#: How often a second terminal is listened to, in seconds.
_LISTEN = 0.2


@dataclass(frozen=True, slots=True)
class Patience:
    """What goes on while the orchestrator waits.

    Attributes:
        refresh: called every `refresh_interval` seconds; never where that is None.
    """

    interruption: Interruption
    refresh: Callable[[], None]
    refresh_interval: float | None

    def wait(self, seconds: float, user_input: int | None = None) -> bytes | None:
        """Wait this long at most, for the user's interruption or input; return the latter, or None."""
        descriptors = [self.interruption.descriptor, *([] if user_input is None else [user_input])]
        readable, _, _ = select.select(descriptors, [], [], min(seconds, self.refresh_interval or seconds))
        if self.interruption.descriptor in readable:
            self.interruption.forget_wakeups()
        if self.refresh_interval is not None:
            self.refresh()
        return os.read(user_input, 4096) if user_input is not None and user_input in readable else None


def rest(seconds: float, patience: Patience) -> None:
    """Let this much real time go by, or less if the user interrupts."""
    end = time.monotonic() + seconds
    while not patience.interruption.is_requested and (left := end - time.monotonic()) > 0:
        patience.wait(left)


def wait_for_user(control: Path, user_input: int | None, patience: Patience) -> None:
    """Wait for a line on `user_input`, for `robot-runner continue` from elsewhere, or for an interruption."""
    forget_command(control)
    while not patience.interruption.is_requested:
        said = patience.wait(_LISTEN, user_input)
        if said == b"":  # the end of the input
            user_input = None
        elif said is not None or take_command(control) is Command.CONTINUE:
            return


@dataclass(frozen=True, slots=True)
class BetweenRuns:
    """What happens between the end of a run and the beginning of the next."""

    experiment: Experiment
    progress: ProgressManager
    events: OrchestratorEvents
    observer: Observer
    notify: Callable[[Notice], None]
    patience: Patience

    def prepare(self, run: PendingRun, finished: PendingRun | None) -> None:
        """Do what comes before a run, after the one that has finished, if any did.

        The user steps in where the config says SEMI, then the robot rests, and hosts are started anew that are to be.
        """
        self._pause_where_requested(run)
        if finished is not None:
            self._pause(finished, run)
            self._pause_where_requested(run)  # it may have been asked for meanwhile
        Reboots(self.experiment, self.progress, self.notify, self.patience).before(run, finished)

    def _pause_where_requested(self, run: PendingRun) -> None:
        folder, user_input = self.experiment.folder, self.observer.user_input
        pause_where_requested(folder, run, self.progress, self.notify, self.patience, user_input)

    def _pause(self, finished: PendingRun, following: PendingRun) -> None:
        parameters = self.experiment.parameters
        if parameters.operation_type is OperationType.SEMI and not self.events.user_has_continued(finished):
            folder = self.experiment.folder
            self.progress.note("waiting", next_run=following.run_id)
            self.notify(WaitingForUser(folder.root, following.number, self.progress.run_count))
            wait_for_user(folder.control, self.observer.user_input, self.patience)
            self.progress.note("continued")
        rest(parameters.time_between_runs_in_ms / 1000, self.patience)
