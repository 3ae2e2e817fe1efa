"""Tells which robots software for all runs may still drive after a kill, as nobody was left to halt them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from robot_runner.core.errors import Finding
from robot_runner.core.links.commanded_topics import MAY_BE_MOVING
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.words import enumerated
from robot_runner.subjects.halting import CommandedTopics
from robot_runner.subjects.supervised_program import last_start


def tell_left_subjects(root: Path) -> Iterator[Finding]:
    """Yield a warning for each software for all runs that has commanded a robot which nobody has halted since.

    Args:
        root: the folder of the experiment, which nobody executes, and of which no process goes on.
    """
    for folder in sorted(ExperimentFolder(root).subjects.glob("*")):
        start = last_start(folder)
        commanded = CommandedTopics(start) if start is not None else None
        if commanded is None or commanded.problem() is not None or commanded.is_copied():
            continue
        what = f"while {folder.name} commanded the robot ({enumerated(sorted(commanded.by_robot()))})"
        problem = f"{MAY_BE_MOVING}: an earlier execution was killed {what}, and nobody was left to stop it"
        fix = "Start the experiment again, which stops it before anything else, or stop it by hand."
        yield Finding.warning(folder.name, problem, fix)
