"""Work beside the runs that may open links or start threads (probes, gates, reboots), in a process under a keeper.

The orchestrator forks runs, and must do neither itself. Such work is therefore executed as a run is, in a temporary
folder. That lies in the experiment folder while this process holds its lock: the next execution then finds the
processes that a kill has left alive.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory, gettempdir
from typing import Any

from robot_runner.core.config.experiment import Experiment
from robot_runner.core.config.parameters import RunProcess
from robot_runner.core.events.manager import EventManager, OwnerKind, RobotRunnerEvents, methods_of
from robot_runner.core.events.measure import CONFIG_OWNER
from robot_runner.core.execution.left_processes import ASIDE
from robot_runner.core.execution.local_places import begin_run
from robot_runner.core.execution.places import Watch
from robot_runner.core.execution.poll_loop import Steps
from robot_runner.core.execution.task import OutcomeBuilder, RunOutcome, RunTask
from robot_runner.core.plugin import Profiler
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.lock import holder_of
from robot_runner.core.storage.system_refusals import storage_errors


def executed_beside_runs(
    experiment: Experiment,
    task: RunTask,
    mission: Callable[..., object],
    watch: Watch,
    *,
    deadline_s: float | None,
    profilers: Sequence[Profiler] = (),
    events: Collection[RobotRunnerEvents] = (),
    **changed: Any,
) -> Steps[RunOutcome]:
    """Execute `mission` as the mission of a run without a row, step by step, and return how it went; no file is kept.

    The mission may take the context of a run, as any callback; it sees the experiment's robot and parameters, and the
    treatments of `task`. `watch` takes its records, and the user's interruption. `profilers` are the only plugins that
    take part, at these `events`. `changed` are static parameters that differ from the experiment's. `deadline_s` is how
    long it may take, s of real time; None for no limit.
    """
    parameters = experiment.parameters.but(
        phases=(),
        run_deadline_in_s=None,
        event_deadline_in_s=deadline_s,
        run_process=RunProcess.FORK,  # always: what is left open or broken must not stay in this process
        **changed,
    )
    manager = EventManager()
    for profiler in profilers:
        for event, callback in methods_of(profiler):
            if event in events:
                manager.subscribe(event, callback, owner=profiler.name, kind=OwnerKind.PROFILER)
    manager.subscribe(RobotRunnerEvents.LAUNCH_MISSION, mission, owner=CONFIG_OWNER, kind=OwnerKind.CONFIG)
    with _scratch_folder(experiment.folder) as folder:
        aside = replace(
            experiment,
            parameters=parameters,
            plugins=tuple(profilers),
            events=manager,
            folder=ExperimentFolder(Path(folder)),
        )
        builder = OutcomeBuilder(task.run_id, aside.columns)
        with closing(begin_run(aside, task, builder, watch, may_command=False)) as run:
            yield run
            return run.outcome()


def _scratch_folder(folder: ExperimentFolder) -> TemporaryDirectory[str]:
    """Make a temporary folder, which is removed on leaving; raise a `StorageError` if it cannot be made."""
    where, prefix = (folder.root, ASIDE) if holder_of(folder.lock) else (None, "robot-runner-")
    with storage_errors(where or Path(gettempdir()), "written"):
        return TemporaryDirectory(prefix=prefix, dir=where, ignore_cleanup_errors=True)
