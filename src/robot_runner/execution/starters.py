"""How the process of a run is started: forked from the guardian, or as a fresh interpreter."""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from typing import TYPE_CHECKING

from robot_runner.execution.child import await_task, execute_in_child
from robot_runner.execution.guarding import Ends, forked
from robot_runner.execution.handover import take_over
from robot_runner.execution.spawning import spawn_arguments
from robot_runner.execution.warming import warm_up

if TYPE_CHECKING:
    from robot_runner.config.experiment import Experiment

__all__ = ["ForkStarter", "SpawnStarter"]


class ForkStarter:
    """Forks: the run sees what was set up in memory before."""

    #: One for the run that is next, and one that has time to get ready while that run is executed.
    starts_ahead = 2

    def __init__(self, experiment: Experiment) -> None:
        self._experiment = experiment

    def prepare(self) -> None:
        """Execute what every run executes, so that a run finds it done."""
        warm_up(self._experiment)

    def start(self, ends: Ends) -> int:
        """Fork a process that waits for its task."""
        pid = forked()
        if pid:
            with suppress(ProcessLookupError):
                os.setpgid(pid, pid)
            return pid
        try:
            for descriptor in ends.of_others:
                os.close(descriptor)
            execute_in_child(
                self._experiment, lambda: take_over(self._experiment, await_task(ends.tasks)), ends.records
            )
        finally:
            os._exit(70)  # never back into the guardian's code


class SpawnStarter:
    """Starts a fresh interpreter, which loads the config again; not before it is wanted, as loading takes its time."""

    starts_ahead = 0

    def __init__(self, experiment: Experiment) -> None:
        self._experiment = experiment

    def prepare(self) -> None:
        """Do nothing: an interpreter starts from nothing."""

    def start(self, ends: Ends) -> int:
        """Start an interpreter."""
        # It inherits copies; ours are not inherited by anybody else.
        copies = [os.dup(descriptor) for descriptor in (ends.tasks, ends.records)]
        try:
            for descriptor in copies:
                os.set_inheritable(descriptor, True)  # noqa: FBT003 - the system's own signature
            arguments = spawn_arguments(self._experiment, *copies)
            return os.posix_spawn(sys.executable, arguments, os.environ, setpgroup=0)
        finally:
            for descriptor in copies:
                os.close(descriptor)
