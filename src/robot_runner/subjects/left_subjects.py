"""Tells which robots software may still drive after a kill: nobody was left to halt them, or it is out of reach."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from pathlib import Path

from robot_runner.core.errors import Finding, PluginError
from robot_runner.core.links.commanded_topics import MAY_BE_MOVING, STOP_BY_HAND
from robot_runner.core.links.ssh_command import execute, ssh_command
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.words import enumerated
from robot_runner.subjects.halting import CommandedTopics
from robot_runner.subjects.remote_supervision import LEASE
from robot_runner.subjects.supervised_program import Start, last_start
from robot_runner.subjects.surroundings import Surroundings

#: How long a program that is being ended on another computer is waited for, and that computer's answer, s.
_ENDING, _ANSWERING = 5.0, 5.0
#: The exit code of ssh itself.
_OF_SSH = 255


def tell_left_subjects(root: Path) -> Iterator[Finding]:
    """Yield a warning for each software for all runs that has commanded a robot which nobody has halted since.

    Nobody executes the experiment, and none of its processes goes on.
    """
    for folder in sorted(ExperimentFolder(root).subjects.glob("*")):
        start = last_start(folder)
        commanded = CommandedTopics(start) if start is not None else None
        if commanded is None or commanded.problem() is not None or commanded.is_copied():
            continue
        what = f"while {folder.name} commanded the robot ({enumerated(sorted(commanded.by_robot()))})"
        problem = f"{MAY_BE_MOVING}: an earlier execution was killed {what}, and no process was left to stop it"
        fix = "Start the experiment again, which stops it before anything else, or stop it by hand."
        yield Finding.warning(folder.name, problem, fix)


def check_within_reach(name: str, start: Start, around: Surroundings) -> None:
    """Check that the program of a killed run does not go on commanding the robot on a computer that is out of reach.

    Raises:
        PluginError: it may go on, and has commanded the robot.
    """
    host = around.host
    if host is None or start.refusal or not CommandedTopics(start).by_robot():
        return
    start.await_end(_ENDING)
    ended, pid = start.ended(), start.pid
    if ended is not None and ended.code is not None:
        return
    # The run may have been killed between the first command and the message of the start.
    is_alive = None if pid is None else _is_alive(pid, host, around.ssh_config)
    # Where it goes on under its supervisor, it takes longer to end, and the robot is stopped once more after that.
    if is_alive is None or (is_alive and not start.is_supervised()):
        what = f"it goes on on {host}, out of reach" if is_alive else f"its computer, {host}, is out of reach"
        if pid is None:
            what = f"whether it was started on {host} is not known"
        problem = f"{what}, and it commands the robot until it is ended there, {LEASE:g} s after the connection"
        raise PluginError(problem, where=name, fix=STOP_BY_HAND)


def _is_alive(pid: int, host: str, ssh_config: Path | None) -> bool | None:
    """Return whether a process of another computer is alive; None where that cannot be asked."""
    asking = f"kill -0 {pid} || ps -p {pid}"  # `kill` also fails for one that became another user by `sudo`
    try:
        done = execute(ssh_command(host, asking, config=ssh_config), timeout=_ANSWERING)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return None if done.returncode == _OF_SSH else done.returncode == 0
