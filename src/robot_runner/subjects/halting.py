"""Stops the robot that software under test commanded, once the software has ended.

In a run, the run's link does so (`CommandedRobot`); for a program that goes on through all runs, a separate process.
That also works between two runs, after the last one, and when the orchestrator, which opens no link, was killed: the
process waits for the end of the program, whatever the cause. It joins the robot's graph only then, so that it is not
part of what is measured, or just before, when the program is about to be ended.

    in    a line, or the end of the input: the program is about to be ended, so join now
    out   a line once that is done

A second process, forked from it, goes on where it is killed or fails, together with the orchestrator, say.
"""

from __future__ import annotations

import fcntl
import json
import os
import select
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing, contextmanager, suppress
from pathlib import Path
from typing import Any

from robot_runner.core.errors import Finding, LinkError, PluginError, RobotRunnerError, StorageError
from robot_runner.core.events.context import SystemClock
from robot_runner.core.events.resources import Resources
from robot_runner.core.execution.interruption import STOP_SIGNALS
from robot_runner.core.execution.processes import FEWER_PROCESSES
from robot_runner.core.links.commanded_topics import (
    MAY_BE_MOVING,
    STOP_BY_HAND,
    VELOCITIES,
    keep_commanding_zero,
    zero_first,
)
from robot_runner.core.links.connect import resolved_robot
from robot_runner.core.links.robot import Advertiser, RobotLink
from robot_runner.core.storage.guarded_files import read_text
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.outliving import is_stopped
from robot_runner.core.storage.shared_claims import held_against_users
from robot_runner.subjects.orphans import signal_stopped, wake_supervisor
from robot_runner.subjects.supervised_program import Start, last_start

#: How often to look whether the program has ended, s.
_LOOK = 0.1
#: How long joining a graph may take, and how long everything from the program's end on, s: an unreachable robot is
#: tried twice.
_JOINING, _LONGEST = 10.0, 40.0
#: How often the second process looks whether the first one was stopped, s; of its death it is told at once.
_LOOK_AT_GUARDED = 1.0


class CommandedTopics:
    """A file beside one start of a program: which topics it commanded, and whether the robots were stopped since."""

    def __init__(self, start: Start) -> None:
        self._path = start.folder / "commanded.jsonl"

    def add(self, robot: str, topic: str, message_type: str) -> None:
        """Note that velocities are commanded on a topic; `robot` is how its graph is reached."""
        if (topic, message_type) in self.by_robot().get(robot, ()):  # by an earlier run
            return
        with suppress(OSError):  # a full disk; the run's link still stops the robot at the end of the run
            folder = str(self._path.parent.absolute())
            self._write({"robot": robot, "topic": topic, "type": message_type, "folder": folder})

    def end(self, problem: str) -> None:
        """Note that zero was commanded, or why it was not."""
        self._write({"problem": problem})

    def by_robot(self) -> dict[str, list[tuple[str, str]]]:
        """Return the topics of velocities and their types, by the robot that they command."""
        found: dict[str, list[tuple[str, str]]] = {}
        for line in self._lines():
            match line:
                case {"robot": str(robot), "topic": str(topic), "type": str(kind)} if kind in VELOCITIES:
                    topics = found.setdefault(robot, [])
                    if (topic, kind) not in topics:
                        topics.append((topic, kind))
        return found

    def problem(self) -> str | None:
        """Return why zero was not commanded; empty where it was, or was not needed, None where that is unknown yet."""
        ends = [str(line["problem"]) for line in self._lines() if "problem" in line]
        return ends[-1] if ends else None if self.by_robot() else ""

    def is_copied(self) -> bool:
        """Whether this is a copy, and the original, for the next execution of its experiment, is still there."""
        lines = self._lines()
        with suppress(OSError, ValueError):
            told = next((Path(line["folder"]) for line in lines if isinstance(line.get("folder"), str)), None)
            if told is not None and not told.samefile(self._path.parent):
                return CommandedTopics(Start(told))._lines()[:1] == lines[:1]  # noqa: SLF001 - of the same class
        return False

    def end_stopped(self) -> None:
        """Kill who was to command zero and is stopped: once continued, it would do so in the midst of a run."""
        signal_stopped(self._path, signal.SIGKILL)

    @contextmanager
    def locked(self) -> Iterator[tuple[int, ...]]:
        """Lock the file, and yield the descriptor that a process has to inherit to hold the lock until it ends.

        The lock shows to the next user of the robot that it is still to be halted.
        """
        with self._path.open("a", encoding="utf-8") as file:
            with suppress(OSError):  # its file system offers no locks of this kind
                fcntl.flock(file, fcntl.LOCK_SH)
            yield (file.fileno(),)

    def _write(self, line: dict[str, str]) -> None:
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")

    def _lines(self) -> list[dict[str, Any]]:
        lines: list[dict[str, Any]] = []
        with suppress(StorageError):
            for line in read_text(self._path, errors="replace").splitlines():
                with suppress(ValueError, RecursionError):  # incomplete: its writer was killed
                    if isinstance(said := json.loads(line), dict):
                        lines.append(said)
        return lines


class Halting:
    """Has a process command zero once a start of a program has ended; the process outlives the one that started it.

    Raises:
        PluginError: the system has no process left for it.
    """

    def __init__(self, start: Start, name: str) -> None:
        self._start = start
        self._name = name
        self._commanded = CommandedTopics(start)
        try:
            self._begin()
        except OSError as error:
            moving = f"{MAY_BE_MOVING}: " if self._commanded.by_robot() else ""
            problem = f"{moving}no process can be started that halts the robot of {name}: {error.strerror}"
            raise PluginError(problem, where=name, fix=FEWER_PROCESSES) from error

    def _begin(self) -> None:
        with self._commanded.locked() as inherited:
            self._process = subprocess.Popen(  # noqa: S603 - our own module
                [sys.executable, "-P", "-m", __name__, str(self._start.folder)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                start_new_session=True,  # Ctrl-C in a terminal does not end it
                pass_fds=[*inherited, *held_against_users()],
            )

    def prepare(self) -> None:
        """Have the process join the robot's graph before the program is ended, so that the robot is stopped at once."""
        if self._commanded.by_robot():
            assert self._process.stdin is not None and self._process.stdout is not None  # noqa: S101, PT018 - pipes
            with suppress(OSError):  # the process was killed; `finish` starts another
                self._process.stdin.write(b"\n")
                self._process.stdin.flush()
                answered = select.poll()  # `select` refuses descriptors beyond 1,023
                answered.register(self._process.stdout, select.POLLIN)
                answered.poll(_JOINING * 1000)

    def finish(self) -> None:
        """After the end of the program, wait until zero was commanded; if the processes were killed, start others.

        Nobody commands the robot any more afterwards.

        Raises:
            PluginError: zero may not have reached it, or the program was out of reach and may command the robot again.
        """
        reason = ""
        for attempt in range(2):
            try:
                if attempt:
                    self._begin()
            except OSError as error:
                reason = f"no process can be started: {error.strerror}"
                break
            reason = (
                "the process that was to do it died twice" if self._ends() else f"it takes longer than {_LONGEST:g} s"
            )
            if (problem := self._commanded.problem()) is not None:
                reason = problem
                break
        told = f"{MAY_BE_MOVING}: {self._name} has ended, and whether zero has reached its robot is not known: {reason}"
        problems = [told] if reason else []
        remarks = self._start.remarks(may_drive=bool(self._commanded.by_robot()))
        problems += [f"{self._name} {each}" for each in remarks if MAY_BE_MOVING in each]  # it is on another computer
        if problems:
            raise PluginError(problems[0], where=self._name, fix=STOP_BY_HAND)

    def _ends(self) -> bool:
        """Wait until neither process is left; where that takes too long, kill them and return False."""
        try:
            self._process.communicate(timeout=_LONGEST)  # until the second one has closed the output, too
        except subprocess.TimeoutExpired:
            with suppress(ProcessLookupError):
                os.killpg(self._process.pid, signal.SIGKILL)
            with suppress(subprocess.TimeoutExpired):
                self._process.communicate(timeout=_JOINING)
            return False
        return True


def end_left_subjects(root: Path, may_command: Callable[[str], bool]) -> Iterator[Finding]:
    """End software for all runs that goes on because an execution was killed with all processes that would end it.

    Robots that it commanded are stopped, unless that was done since. `may_command` says whether a robot may be
    commanded now, by how it is reached: software that has commanded only other robots is left to the next experiment
    with these. Yield what was done, or cannot be done; the latter only once.
    """
    for folder in sorted(ExperimentFolder(root).subjects.glob("*")):
        start = last_start(folder)
        robots = CommandedTopics(start).by_robot() if start is not None else {}
        if start is None or (robots and not any(map(may_command, robots))) or CommandedTopics(start).is_copied():
            continue
        CommandedTopics(start).end_stopped()
        if wake_supervisor(start.events):
            start.await_end(_LONGEST)
        start.end_orphans()
        if CommandedTopics(start).problem() is not None:
            continue
        try:
            Halting(start, folder.name).finish()
        except PluginError as error:
            yield error.as_finding()
        else:
            what = f"while {folder.name} commanded the robot; it was commanded to stand still now"
            yield Finding.warning(str(root), f"an earlier execution was killed {what}", "Check where the robot stands.")


class _CommandedRobots:
    """The robots that the program commanded, as links of this process."""

    def __init__(self, commanded: CommandedTopics, resources: Resources) -> None:
        self._commanded = commanded
        self._resources = resources
        self._graphs: dict[str, str] = {}
        self._links: dict[str, RobotLink] = {}

    def _by_graph(self) -> dict[str, list[tuple[str, str]]]:
        """Return the topics by how their graph is reached, which is joined once."""
        found: dict[str, list[tuple[str, str]]] = {}
        for robot, topics in self._commanded.by_robot().items():
            if robot not in self._graphs:
                self._graphs[robot] = robot
                with suppress(LinkError):  # which opening it reports
                    self._graphs[robot] = resolved_robot(robot)[1].graph
            found.setdefault(self._graphs[robot], []).extend(topics)
        return found

    def join(self) -> None:
        """Become a publisher on the program's topics, as far as possible."""
        for robot, topics in self._by_graph().items():
            with suppress(RobotRunnerError):
                link = self._link(robot)
                for topic, message_type in topics:
                    if isinstance(link, Advertiser):
                        link.advertise(topic, message_type)

    def command_zero(self) -> None:
        """Command zero once, wherever that is possible."""
        for robot, topics in self._by_graph().items():
            for topic, message_type in topics:
                with suppress(Exception), zero_first(topics):  # `stop` reports what fails
                    self._link(robot).publish(topic, message_type, {})

    def stop(self) -> None:
        """Command zero until it has reached every robot, on all graphs at the same time, whatever fails at one.

        Raises:
            RobotRunnerError: it does not reach a robot whose graph is there.
        """
        graphs = self._by_graph()
        with ExitStack() as failures, ThreadPoolExecutor(max_workers=max(1, len(graphs))) as together:
            for robot, topics in graphs.items():
                failures.callback(together.submit(self._stop, robot, topics).result)

    def _stop(self, robot: str, topics: Sequence[tuple[str, str]]) -> None:
        had_joined = robot in self._links
        with zero_first(topics):
            link = self._link(robot)
        try:
            doubts = keep_commanding_zero(link, topics)
        except LinkError:
            # A graph that the program itself has started ends with it; topics connected before have got their zero.
            if not had_joined or _is_there(link):
                raise
        else:
            if doubts and not had_joined:
                raise LinkError(doubts[0], where=robot, fix="See that it stands still.")

    def _link(self, robot: str) -> RobotLink:
        if robot not in self._links:
            kind, name = resolved_robot(robot)
            self._links[robot] = kind.open_robot(
                name, resources=self._resources, clock=SystemClock(), seed=1, namespace=name.namespace
            )
            self._resources.open(f"robot {robot}", lambda: self._links[robot])
        return self._links[robot]


def _is_there(link: RobotLink) -> bool:
    try:
        return bool(link.topics())
    except LinkError:
        return False


def _halt_after(start: Start) -> None:
    """Wait for the end of a start, and command zero on its topics."""
    commanded = CommandedTopics(start)
    with closing(Resources()) as resources:
        robots = _CommandedRobots(commanded, resources)
        asked, read, has_ended = [0], 0, False
        while start.is_supervised():
            with suppress(OSError):  # the file was removed
                if (size := start.events.stat().st_size) > read:  # reading it each time would take ten times as long
                    read, has_ended = size, start.ended() is not None
            if has_ended:  # its child processes may go on for a moment
                robots.command_zero()
            is_asked = bool(select.select(asked, [], [], _LOOK)[0])
            if is_asked or not asked:
                wake_supervisor(start.events)
            if is_asked:
                asked = []
                robots.join()
                with suppress(OSError):  # nobody reads the output any more
                    sys.stdout.write("\n")
                    sys.stdout.flush()
        start.end_orphans()
        if commanded.by_robot():
            try:
                robots.stop()
                commanded.end("")
            except Exception as error:  # noqa: BLE001 - whatever it is, a person has to know that nobody stopped the robot
                commanded.end(error.problem if isinstance(error, RobotRunnerError) else repr(error))


def _halt_guarded(start: Start) -> None:
    """Do so with a second process, forked before there are threads or links, that goes on where this one cannot."""
    signal.pthread_sigmask(signal.SIG_BLOCK, STOP_SIGNALS)  # sent to all processes, they end the program, and not us
    guarded = os.getpid()
    try:
        waiting, working = os.pipe()
        guard = os.fork()
    except OSError:  # the system has no more of them: one process is better than none
        _halt_after(start)
        return
    if guard == 0:
        os.close(working)
        _guard(start, guarded, waiting)
        return
    os.close(waiting)
    _halt_after(start)  # whatever it raises, the second process takes its place
    os.kill(guard, signal.SIGKILL)
    os.waitpid(guard, 0)


def _guard(start: Start, guarded: int, its_end: int) -> None:
    """Have another process go on where somebody stops it (SIGSTOP), and take its place where somebody kills it."""
    while not select.select([its_end], [], [], _LOOK_AT_GUARDED)[0]:
        if is_stopped(guarded):
            with suppress(ProcessLookupError):
                os.kill(guarded, signal.SIGCONT)
    _halt_after(start)


if __name__ == "__main__":
    _halt_guarded(Start(Path(sys.argv[1])))
