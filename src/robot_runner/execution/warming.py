"""What a guardian does before it forks its first run: it executes what every run executes."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from robot_runner.events.columns import CONFIG_OWNER
from robot_runner.events.event import RUN_EVENTS
from robot_runner.events.manager import EventManager
from robot_runner.events.measure import as_measure_value
from robot_runner.events.subscription import OwnerKind
from robot_runner.execution.handover import hand_over, take_over
from robot_runner.execution.records import RecordWriter
from robot_runner.execution.run import execute_run
from robot_runner.execution.task import RunTask

if TYPE_CHECKING:
    from robot_runner.config.experiment import Experiment

__all__ = ["warm_up"]

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
    parameters = replace(experiment.parameters, robot=None)
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
