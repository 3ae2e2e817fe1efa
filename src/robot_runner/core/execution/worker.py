"""A run in a process of its own: forked from its keeper, or a fresh interpreter that the forked process becomes.

The fresh interpreter executes `python -m robot_runner.core.execution.worker <descriptor>`, of a file that describes the
run: it loads the config again.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

from robot_runner.core.config.experiment import Experiment
from robot_runner.core.config.preparation import prepare_or_refuse
from robot_runner.core.design.factor import Factor
from robot_runner.core.design.revision import Revision
from robot_runner.core.errors import ConfigError, ExecutionError
from robot_runner.core.execution.inherited_state import freeze_inherited, write_open_files
from robot_runner.core.execution.interruption import STOP_SIGNALS, InterruptGate
from robot_runner.core.execution.left_processes import RunMark, end_left_processes
from robot_runner.core.execution.processes import leave_after, settle_streams
from robot_runner.core.execution.resumption import config_changes
from robot_runner.core.execution.run_events import execute_run, has_standby, systems_of_standby
from robot_runner.core.execution.run_facts import notice_programs
from robot_runner.core.execution.run_records import FINISHED, RecordWriter
from robot_runner.core.execution.systems_state import Care, SystemsFile, SystemsState
from robot_runner.core.execution.task import RunTask
from robot_runner.core.links.commanded_topics import Commanded, hear_commanded
from robot_runner.core.links.robot_claims import inherit_robots, robots_of_callbacks
from robot_runner.core.storage.layout import print_to_log
from robot_runner.core.storage.shared_claims import held_against_users, hold_inherited
from robot_runner.core.treatments import bind

_MODULE = "robot_runner.core.execution.worker"


def be_run(experiment: Experiment, task: RunTask, systems: SystemsState | None, report: RecordWriter) -> None:
    """Execute the run in this process, which was forked for it and shares what was set up in memory before."""
    print_to_log(experiment.folder)
    settle_streams()
    _execute(experiment, task, systems, report)


def become_interpreter(
    experiment: Experiment, task: RunTask, systems: SystemsState | None, report: RecordWriter
) -> NoReturn:
    """Replace this process, which was forked for the run, by a fresh interpreter that executes it."""
    print_to_log(experiment.folder)
    for number in STOP_SIGNALS:  # until the interpreter handles them, there is nothing to close
        signal.signal(number, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, STOP_SIGNALS)
    claims = held_against_users()
    inherited = [report.descriptor, *([] if systems is None else [systems.descriptor]), *claims]
    for descriptor in inherited:
        os.set_inheritable(descriptor, True)  # noqa: FBT003 - the system's own signature
    # In a replication, the config lies in the package, and the results go elsewhere; a name may have the time in it.
    results, name = experiment.folder.root.parent, experiment.parameters.experiment_name
    settings = {**experiment.overrides, "results_output_path": str(results), "experiment_name": name}
    if experiment.parameters.robots and experiment.parameters.robot is not None:
        settings["robot"] = experiment.parameters.robot  # that of the run's place, where several take turns
    description = {
        "config": str(experiment.config_path),
        "set": settings,
        "task": described_task(experiment, task),
        "revisions": describe_revisions(experiment.model.factors),
        "records": report.descriptor,
        "systems": None if systems is None else systems.descriptor,
        "claims": claims,
        "robots": robots_of_callbacks(),
    }
    # Not as an argument, which has a limited length and can be seen by others. In the experiment's folder, which is
    # known to be writable; the file has no name there.
    with tempfile.TemporaryFile("w+", encoding="utf-8", dir=experiment.folder.root) as file:
        json.dump(description, file, default=str)
        file.flush()
        os.lseek(file.fileno(), 0, os.SEEK_SET)
        os.set_inheritable(file.fileno(), True)  # noqa: FBT003 - as above
        options = subprocess._args_from_interpreter_flags()  # type: ignore[attr-defined] # noqa: SLF001 - as multiprocessing does
        words = [sys.executable, *options, "-P", "-m", _MODULE, str(file.fileno())]
        os.execv(sys.executable, words)  # noqa: S606 - our own program


def _execute(experiment: Experiment, task: RunTask, systems: SystemsState | None, report: RecordWriter) -> None:
    gate = InterruptGate()
    gate.listen()
    keeper = os.getppid()
    freeze_inherited()
    notice_programs(experiment, report)
    with nullcontext() if systems is None else _kept(systems, experiment, task):
        execute_run(experiment, task, report, gate, systems)
    for problem in write_open_files():
        report("failure", {"event": "", "owner": "", "problem": problem, "traceback": ""})
    report(FINISHED, {})
    if os.getppid() != keeper:  # the keeper was killed, and cannot end what the run leaves behind
        end_left_processes(experiment.folder)


@contextmanager
def _kept(systems: SystemsState, experiment: Experiment, task: RunTask) -> Iterator[None]:
    """Keep a `SystemsFile` until the systems are safe: keeper, standby and orchestrator may be killed, too."""
    file: SystemsFile | None = None
    adding = threading.Lock()  # several threads may command the first robots

    def begun(robot: str | None) -> SystemsFile:
        nonlocal file
        if file is None:
            file = SystemsFile(experiment.folder)
            file.begin(robot, described_task(experiment, task), [each.name for each in systems_of_standby(experiment)])
        return file

    def add(commanded: Commanded) -> None:
        with adding:  # begun only here where a callback has reached a robot that the config does not name
            begun(commanded.graph or None).add_commanded(commanded)

    if has_standby(experiment):
        begun(experiment.parameters.robot)
    hear_commanded(add)
    yield
    if file is not None and systems.care in {Care.NOBODY_YET, Care.SAFE}:
        file.remove()


def _execute_described(description: Mapping[str, Any], report: RecordWriter) -> None:
    hold_inherited(description["claims"])
    inherit_robots(description["robots"])
    experiment = prepare_or_refuse(Path(description["config"]), description["set"], looks_at_graph=False)
    # Somebody may have edited the file since: runs before and after would be of different experiments.
    ExecutionError.refuse(config_changes(experiment, of_settings=False))
    restore_revisions(experiment.model.factors, description["revisions"])
    task = task_of(experiment, description["task"])
    experiment = replace(experiment, folder=experiment.folder.at_slot(task.slot))
    RunMark(experiment.folder).sign()  # the lock was lost when the process was replaced
    for plugin in experiment.plugins:  # in a forked run, the orchestrator has done this
        bind(plugin, task.combination)
    shared = description["systems"]
    _execute(experiment, task, None if shared is None else SystemsState(shared), report)


def described_task(experiment: Experiment, task: RunTask) -> dict[str, Any]:
    """Return a task as plain data, for a process that has loaded the config itself."""
    # A treatment is described by its text, as it may be any object, and not by its position, as a set or a folder's
    # listing has another order in each process. A value of a hand-written table is plain.
    factors = {factor.name: factor for factor in experiment.model.factors}
    combination: dict[str, Any] = {}
    for name, value in task.combination.items():
        place = factors[name].position_of(value) if name in factors else None
        combination[name] = (place is not None, value if place is None else factors[name].texts[place])
    return {each.name: getattr(task, each.name) for each in fields(task)} | {"combination": combination}


def task_of(experiment: Experiment, described: Mapping[str, Any]) -> RunTask:
    """Return the task that `described_task` described.

    Raises:
        ConfigError: a treatment is missing in the config as loaded by this process.
    """
    factors = {factor.name: factor for factor in experiment.model.factors}
    combination = {
        name: _treatment(factors[name], value) if is_treatment else value
        for name, (is_treatment, value) in described["combination"].items()
    }
    return RunTask(**{**described, "combination": combination})


def _treatment(factor: Factor, text: str) -> Any:
    place = factor.position_of_text(text)
    if place is None:
        problem = f"treatment {text!r} is not there when the config is loaded again: they change each time"
        fix = "Make them the same each time: give random ones a seed, and read them from where all of them stand."
        raise ConfigError(problem, where=f"factor {factor.name!r}", fix=fix)
    return factor.treatments[place]


def describe_revisions(factors: Sequence[Factor]) -> list[list[str]]:
    """Return `[factor, text of the treatment, commit, path]` of each revision that was made, as plain data."""
    return [
        [factor.name, factor.texts[place], each.commit, each.path]
        for factor in factors
        for place, each in enumerate(factor.treatments)
        if isinstance(each, Revision) and each.is_prepared
    ]


def restore_revisions(factors: Sequence[Factor], described: Sequence[Sequence[str]]) -> None:
    """Set commit and path of revisions, as `describe_revisions` returned them.

    Raises:
        ConfigError: a revision is missing in the config as loaded by this process.
    """
    by_name = {factor.name: factor for factor in factors}
    for name, text, commit, path in described:
        _treatment(by_name[name], text).prepare(commit=commit, path=path)


if __name__ == "__main__":
    settle_streams()
    with os.fdopen(int(sys.argv[1]), encoding="utf-8") as _file:
        _description = json.load(_file)
    _report = RecordWriter(_description["records"])
    leave_after(partial(_execute_described, _description, _report), _report)
