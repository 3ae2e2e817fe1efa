"""What a program has started is found by the folder of its start, and ended."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest
from tests.waiting import PATIENCE

from robot_runner.core.storage.outliving import is_alive
from robot_runner.subjects.halting import end_left_subjects
from robot_runner.subjects.orphans import end_orphans, mark_of
from robot_runner.subjects.supervised_program import SupervisedProgram, Task

if TYPE_CHECKING:
    from pathlib import Path

SLEEPS = Task(command=("sleep", "1000"), environment={})


@pytest.mark.skipif(sys.platform != "linux", reason="found by /proc")
@pytest.mark.parametrize("name", [b"1", b"caf\xc3\xa9", b"of no encoding \xff"])
def test_what_is_left_is_killed_whatever_its_folder_is_called(tmp_path: Path, name: bytes) -> None:
    folder = tmp_path / os.fsdecode(name)
    with subprocess.Popen(["/bin/sleep", "60"], env=mark_of(folder)) as left:
        try:
            end_orphans(tmp_path / "another")
            assert left.poll() is None
            end_orphans(folder)
            assert left.wait(PATIENCE) == -signal.SIGKILL
        finally:
            left.kill()


@pytest.mark.skipif(sys.platform != "linux", reason="found by /proc")
def test_a_program_whose_supervisor_is_stopped_ends_when_it_is_told_to(tmp_path: Path) -> None:
    program = SupervisedProgram(tmp_path, SLEEPS, name="Planner")
    os.kill(program._supervisor.pid, signal.SIGSTOP)
    ended = program.stop()
    assert (ended.was_asked, ended.code) == (True, -signal.SIGTERM)


@pytest.mark.skipif(sys.platform != "linux", reason="found by /proc")
def test_a_program_of_a_killed_execution_whose_supervisor_is_stopped_is_ended_by_the_next(tmp_path: Path) -> None:
    program = SupervisedProgram(tmp_path / "subjects" / "Planner" / "1", SLEEPS, name="Planner")
    supervisor, pid = program._supervisor, program.pid
    assert pid is not None
    os.kill(supervisor.pid, signal.SIGSTOP)
    os.waitid(os.P_PID, supervisor.pid, os.WSTOPPED)  # it needs a processor for that
    assert supervisor.stdin is not None
    supervisor.stdin.close()  # as its starter is dead
    try:
        assert list(end_left_subjects(tmp_path, lambda _: True)) == []
        supervisor.wait(PATIENCE)
        assert not is_alive(pid)
    finally:
        supervisor.kill()
        supervisor.wait()
