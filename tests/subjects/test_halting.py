"""Who commands zero once software for all runs has ended: a process, and one that goes on where it is killed."""

from __future__ import annotations

import errno
import fcntl
import json
import os
import resource
import shutil
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import pytest
from tests.waiting import PATIENCE, wait_until

from robot_runner.core.errors import LinkError, PluginError
from robot_runner.core.events.resources import Resources
from robot_runner.core.execution.interruption import STOP_SIGNALS
from robot_runner.core.execution.left_processes import is_subject_left
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.subjects import halting
from robot_runner.subjects.halting import CommandedTopics, Halting, end_left_subjects
from robot_runner.subjects.supervised_program import Start

TWIST = "geometry_msgs/Twist"


@pytest.mark.parametrize("fault", [LinkError("it is not reached", where="/alice"), RuntimeError("no context")])
@pytest.mark.parametrize("what", ["stop", "command_zero"])
def test_a_robot_that_is_not_reached_keeps_no_other_from_being_stopped(
    monkeypatch: pytest.MonkeyPatch, what: str, fault: Exception
) -> None:
    told: list[str] = []

    def publish(topic: str, *_: object) -> None:
        if "alice" in topic:
            raise fault
        told.append(topic)

    def keep_commanding(link: Any, topics: Any) -> list[str]:
        link.publish(topics[0][0])
        return []

    monkeypatch.setattr(halting, "keep_commanding_zero", keep_commanding)
    topics = {name: [(f"/{name}/cmd_vel", TWIST), (f"/{name}/arm", TWIST)] for name in ("alice", "bob")}
    robots = halting._CommandedRobots(SimpleNamespace(by_robot=lambda: topics), Resources())  # type: ignore[arg-type]
    robots._links = {
        name: SimpleNamespace(publish=publish, topics=lambda: {"/alice/cmd_vel": TWIST}) for name in topics
    }
    if what == "stop":
        with pytest.raises(type(fault), match=str(fault.args[0])):
            robots.stop()
    else:
        robots.command_zero()
    assert "/bob/cmd_vel" in told


@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not tell who holds a lock")
def test_until_the_process_that_halts_the_robot_has_ended_others_see_that_it_is_there(tmp_path: Path) -> None:
    start = Start(tmp_path / "subjects" / "Planner" / "1")
    start.folder.mkdir(parents=True)
    supervisor, folder = start.events.open("w"), ExperimentFolder(tmp_path)
    with supervisor:
        fcntl.flock(supervisor, fcntl.LOCK_EX)
        halts = Halting(start, "Planner")
        assert is_subject_left(folder), "from its beginning on"
    halts.finish()
    assert not is_subject_left(folder)


@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not tell who is stopped, or holds a lock")
@pytest.mark.parametrize("number", [signal.SIGSTOP, signal.SIGKILL])
def test_a_second_process_sees_to_it_that_a_robot_is_halted_where_the_first_one_is_stopped_or_killed(
    tmp_path: Path, number: signal.Signals
) -> None:
    start = begun(tmp_path)
    with guarded(start) as halts:
        first = halts._process.pid
        os.kill(first, number)
        os.waitid(os.P_PID, first, os.WSTOPPED | os.WEXITED | os.WNOWAIT)
    wait_until(CommandedTopics(start).problem, "somebody tried to halt the robot")
    with pytest.raises(PluginError, match="whether zero has reached its robot is not known: "):
        halts.finish()
    assert halts._process.returncode == (0 if number == signal.SIGSTOP else -signal.SIGKILL)
    wait_until(lambda: not is_subject_left(ExperimentFolder(tmp_path)), "neither is left")


@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not tell which processes there are")
@pytest.mark.parametrize("number", STOP_SIGNALS)
def test_a_stop_signal_to_all_processes_ends_the_program_and_not_those_that_halt_its_robot(
    tmp_path: Path, number: signal.Signals
) -> None:
    start = begun(tmp_path)
    with guarded(start) as halts:
        first = halts._process.pid
        os.killpg(first, number)
    wait_until(CommandedTopics(start).problem, "somebody tried to halt the robot")
    with pytest.raises(PluginError, match="whether zero has reached its robot is not known: "):
        halts.finish()
    assert halts._process.returncode == 0


def test_where_a_process_fails_that_halts_the_robot_the_second_one_does_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def halt(_start: Start) -> None:
        if os.getpid() == first:
            raise RuntimeError("a broken client library")
        done.touch()

    first, done = os.getpid(), tmp_path / "done"
    monkeypatch.setattr(halting, "_halt_after", halt)
    if (process := os.fork()) == 0:
        first = os.getpid()
        try:
            halting._halt_guarded(begun(tmp_path))
        finally:
            os._exit(0)
    os.waitpid(process, 0)
    wait_until(done.exists, "the second one has done it")


def test_a_robot_is_halted_also_where_the_system_has_no_second_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fork() -> int:
        raise BlockingIOError(11, "Resource temporarily unavailable")

    halted: list[Start] = []
    monkeypatch.setattr(halting.os, "fork", fork)
    monkeypatch.setattr(halting, "_halt_after", halted.append)
    monkeypatch.setattr(halting.signal, "pthread_sigmask", lambda *_: None)  # of this process
    start = begun(tmp_path)
    halting._halt_guarded(start)
    assert halted == [start]


@pytest.mark.skipif(resource.getrlimit(resource.RLIMIT_NOFILE)[0] <= 1100, reason="fewer files may be open")
def test_the_process_that_halts_a_robot_is_told_to_join_its_graph_however_many_files_are_open(tmp_path: Path) -> None:
    start = begun(tmp_path)
    CommandedTopics(start).add("rosbridge://127.0.0.1:1", "/cmd_vel", TWIST)
    (told, telling), (answered, answering) = os.pipe(), os.pipe()
    far = fcntl.fcntl(answered, fcntl.F_DUPFD_CLOEXEC, 1100)  # select() takes none beyond 1023
    os.write(answering, b"\n")
    preparing = object.__new__(Halting)
    preparing._commanded = CommandedTopics(start)
    with os.fdopen(telling, "wb") as stdin, os.fdopen(far, "rb") as stdout, os.fdopen(told, "rb") as read:
        preparing._process = SimpleNamespace(stdin=stdin, stdout=stdout)  # type: ignore[assignment]
        preparing.prepare()
        assert read.readline() == b"\n"
    for each in (answered, answering):
        os.close(each)


@pytest.mark.parametrize("has_commanded", [True, False])
def test_where_the_system_has_no_process_that_halts_a_robot_it_is_said_with_what_to_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, has_commanded: bool
) -> None:
    start = Start(tmp_path / "subjects" / "Planner" / "1")
    start.folder.mkdir(parents=True)
    if has_commanded:
        CommandedTopics(start).add("rosbridge://127.0.0.1:1", "/cmd_vel", TWIST)
    refusal = BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))
    monkeypatch.setattr(subprocess, "Popen", Mock(side_effect=refusal))
    with pytest.raises(PluginError, match="no process can be started that halts the robot") as caught:
        Halting(start, "Planner")
    assert "ulimit -u" in caught.value.fix
    (finding,) = list(end_left_subjects(tmp_path, lambda _: True)) or [caught.value.as_finding()]
    assert ("THE ROBOT MAY BE MOVING" in finding.problem) == has_commanded


@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not tell who holds a lock")
@pytest.mark.long
def test_where_halting_robots_takes_too_long_nobody_goes_on_with_it_once_that_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(halting, "_LONGEST", 1.0)  # less than it takes to find that nothing answers
    start = begun(tmp_path)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        CommandedTopics(start).add(f"rosbridge://127.0.0.1:{silent.getsockname()[1]}", "/cmd_vel", TWIST)
        with pytest.raises(PluginError, match=r"ROBOT MAY BE MOVING.*longer than 1 s"):
            Halting(start, "Planner").finish()
        assert not is_subject_left(ExperimentFolder(tmp_path))


def test_robots_of_one_graph_are_halted_together(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[Any] = []
    monkeypatch.setattr(halting, "keep_commanding_zero", lambda _link, topics: told.append(topics) or [])
    topics = {f"dds:domain=7,namespace={name}": [(f"/{name}/cmd_vel", TWIST)] for name in ("alice", "bob")}
    robots = halting._CommandedRobots(SimpleNamespace(by_robot=lambda: topics), Resources())  # type: ignore[arg-type]
    robots._links = {"dds:domain=7": SimpleNamespace()}  # type: ignore[dict-item]
    robots.stop()
    assert told == [[("/alice/cmd_vel", TWIST), ("/bob/cmd_vel", TWIST)]]


def test_robots_of_different_graphs_are_halted_at_the_same_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each takes four seconds: the last of ten would drive on for more than half a minute."""
    both = threading.Barrier(2, timeout=PATIENCE)
    monkeypatch.setattr(halting, "keep_commanding_zero", lambda *_: both.wait() and [])
    topics = {f"dds:domain={number}": [("/cmd_vel", TWIST)] for number in (7, 8)}
    robots = halting._CommandedRobots(SimpleNamespace(by_robot=lambda: topics), Resources())  # type: ignore[arg-type]
    robots._links = {robot: SimpleNamespace() for robot in topics}  # type: ignore[misc]
    robots.stop()
    assert not both.broken


@pytest.mark.parametrize("has_commanded", [True, False])
def test_a_robot_may_be_moving_where_what_commands_it_was_out_of_reach_as_it_was_to_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, has_commanded: bool
) -> None:
    start = begun(tmp_path)
    start.events.write_text('{"lost": "Connection reset by peer", "at": 1.0}\n')
    if has_commanded:
        CommandedTopics(start).add("dds:domain=7", "/cmd_vel", TWIST)
    monkeypatch.setattr(Halting, "_begin", lambda each: each._commanded.end(""))  # zero was commanded
    monkeypatch.setattr(Halting, "_ends", lambda _: True)
    halts = Halting(start, "Planner")
    if has_commanded:
        with pytest.raises(PluginError, match=r"Planner was out of reach .* until then: THE ROBOT MAY BE MOVING"):
            halts.finish()
    else:
        halts.finish()


@contextmanager
def guarded(start: Start) -> Iterator[Halting]:
    """Have two processes wait for the end of a program, which ends on leaving, and which has commanded a robot."""
    with start.events.open("w") as supervisor:
        fcntl.flock(supervisor, fcntl.LOCK_EX)
        halts = Halting(start, "Planner")
        first = halts._process.pid
        wait_until(Path(f"/proc/{first}/task/{first}/children").read_text, "there is a second one")
        yield halts
        # Nobody reaches this robot: that is what has to be told, by whoever tries.
        CommandedTopics(start).add("rosbridge://127.0.0.1:1", "/cmd_vel", TWIST)


def begun(root: Path) -> Start:
    """Return a start of an experiment in this folder."""
    start = Start(root / "subjects" / "Planner" / "1")
    start.folder.mkdir(parents=True)
    return start


@pytest.fixture
def halted(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """Take the place of the process that halts robots; return the starts after which it was to do so."""
    starts: list[Path] = []

    def halt(start: Start, _name: str) -> Any:
        starts.append(start.folder)
        return SimpleNamespace(finish=lambda: CommandedTopics(start).end(""))

    monkeypatch.setattr(halting, "Halting", halt)
    return starts


def test_nothing_but_a_velocity_is_commanded_whatever_somebody_has_written_into_the_file_of_a_start(
    tmp_path: Path, halted: list[Path]
) -> None:
    start = begun(tmp_path)
    told = [
        5,
        [],
        "robot",
        {"robot": 5},
        {"robot": "ros2"},
        {"robot": "ros2", "topic": "/takeoff", "type": "std_msgs/Empty"},
    ]
    told += [
        {"problem": 5},
        {"robot": "ros2", "topic": [], "type": TWIST},
        {"robot": "ros2", "topic": "/arm", "type": []},
    ]
    (start.folder / "commanded.jsonl").write_text("".join(f"{json.dumps(each)}\n" for each in told))
    assert CommandedTopics(start).by_robot() == {}
    assert list(end_left_subjects(tmp_path, lambda _: True)) == []
    assert halted == []


def test_a_pipe_in_the_place_of_a_file_of_a_start_is_not_waited_for(tmp_path: Path) -> None:
    start = begun(tmp_path)
    start.events.unlink(missing_ok=True)
    for path in (start.folder / "commanded.jsonl", start.events):
        os.mkfifo(path)
    assert CommandedTopics(start).by_robot() == {}
    assert not start.is_supervised()
    assert start.pid is None


def test_a_folder_of_starts_may_hold_anything_else(tmp_path: Path, halted: list[Path]) -> None:
    begun(tmp_path).folder.with_name("²").mkdir()  # a digit for Python, and no number
    assert list(end_left_subjects(tmp_path, lambda _: True)) == []
    assert halted == []


@pytest.mark.parametrize("is_moved", [False, True], ids=["copied", "moved"])
def test_a_copy_that_was_made_while_a_program_commanded_a_robot_leaves_that_to_the_original(
    tmp_path: Path, halted: list[Path], is_moved: bool
) -> None:
    root, other = tmp_path / "trial", tmp_path / "backup"
    start = begun(root)
    CommandedTopics(start).add("ros2:domain=7", "/cmd_vel", TWIST)
    shutil.copytree(root, other)
    if is_moved:
        shutil.rmtree(root)
    assert len(list(end_left_subjects(other, lambda _: True))) == is_moved
    assert len(halted) == is_moved
    assert len(list(end_left_subjects(root, lambda _: True))) == (not is_moved)


@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not tell who holds a lock")
def test_who_was_to_halt_the_robot_and_is_stopped_holds_nobody_up_and_is_ended_by_the_next_execution(
    tmp_path: Path, halted: list[Path]
) -> None:
    start = begun(tmp_path)
    commanded = CommandedTopics(start)
    commanded.add("ros2", "/cmd_vel", TWIST)
    with commanded.locked() as inherited:
        stopped = subprocess.Popen(["/bin/sleep", "60"], pass_fds=inherited)
    with stopped:
        try:
            assert is_subject_left(ExperimentFolder(tmp_path))
            os.kill(stopped.pid, signal.SIGSTOP)
            os.waitid(os.P_PID, stopped.pid, os.WSTOPPED)
            assert not is_subject_left(ExperimentFolder(tmp_path)), "it stops no robot"
            (told,) = end_left_subjects(tmp_path, lambda _: True)
            assert "it was commanded to stand still now" in told.problem
            # Once continued, it would stop the robot in the midst of a run.
            assert stopped.wait(PATIENCE) == -signal.SIGKILL
            assert halted == [start.folder]
        finally:
            stopped.kill()
