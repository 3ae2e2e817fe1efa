"""How the process of a run is started: forked from the guardian, or as a fresh interpreter."""

from __future__ import annotations

import json
import os
import sys
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from robot_runner.core.config.dialects import prepare_or_refuse
from robot_runner.core.config.parameters import Parameters
from robot_runner.core.events.manager import RUN_EVENTS, EventManager, OwnerKind
from robot_runner.core.events.measure import CONFIG_OWNER, as_measure_value
from robot_runner.core.execution.guarding import Ends, await_task, execute_in_child, forked, settle_streams
from robot_runner.core.execution.run import execute_run
from robot_runner.core.execution.task import RecordWriter, RunTask, hand_over, take_over

if TYPE_CHECKING:
    from robot_runner.core.config.experiment import Experiment

__all__ = ["ForkStarter", "SpawnStarter", "execute_spawned", "spawn_arguments", "warm_up"]


# A run in a fresh interpreter: what it is started with, and what it does with it.

_WORKER = "robot_runner.core.execution.worker"


def spawn_arguments(experiment: Experiment, tasks: int, records: int) -> list[str]:
    """Return the command line of the fresh interpreter: it loads the config again, and inherits two descriptors."""
    described = {
        "config": str(experiment.config_path),
        "set": dict(experiment.overrides),
        "tasks": tasks,
        "records": records,
    }
    return [sys.executable, "-m", _WORKER, json.dumps(described)]


def execute_spawned(description: str) -> None:
    """Load the config again, find the treatments again, and execute the run."""
    described = json.loads(description)
    settle_streams()
    experiment = prepare_or_refuse(Path(described["config"]), described["set"])
    execute_in_child(experiment, lambda: take_over(experiment, await_task(described["tasks"])), described["records"])


# What a guardian does before it forks its first run: it executes what every run executes.

#: The interpreter adapts code to the types that it sees after it was executed about so often (PEP 659).
_OFTEN = 10


def warm_up(experiment: Experiment) -> None:
    """Execute runs in which no callback of the experiment is called, nothing is measured and nothing is written.

    The interpreter writes into the code that it executes and fills its caches, and a forked process copies each page
    of memory that it writes to. What was done here is not done again in each run: it would delay the first events, and
    load the machine while it is measured.
    """
    events = EventManager()
    for event in RUN_EVENTS:
        events.subscribe(event, dict, owner=CONFIG_OWNER, kind=OwnerKind.CONFIG)
    parameters = Parameters(**vars(experiment.parameters) | {"robot": None})
    nobody = replace(experiment, parameters=parameters, events=events, plugins=())
    with Path(os.devnull).open("wb", buffering=0) as nowhere:
        report = RecordWriter(nowhere.fileno())
        for _ in range(_OFTEN):
            task = take_over(nobody, hand_over(nobody, RunTask("", 1, 1, 1, {}, 1, 0, 0)))
            if task is not None:
                execute_run(nobody, task, report)
    for number in (1, 1.0):
        as_measure_value("", number, where="")
    os.fspath(experiment.folder.current_log)  # a path keeps its text once somebody asked for it


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
