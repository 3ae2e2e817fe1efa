"""What the guardian's own process does: it starts runs, tells how they ended, and ends what is left behind."""

from __future__ import annotations

import os
import select
import signal
import sys
import threading
import time
import warnings
from contextlib import suppress
from dataclasses import dataclass
from io import TextIOWrapper
from typing import TYPE_CHECKING, NoReturn, Protocol

from robot_runner.core.execution.interruption import InterruptGate
from robot_runner.core.execution.run import execute_run, failure_fields
from robot_runner.core.execution.task import FINISHED, RecordWriter
from robot_runner.core.storage.layout import open_log

if TYPE_CHECKING:
    import mmap
    from collections.abc import Callable

    from robot_runner.core.config.experiment import Experiment
    from robot_runner.core.execution.task import RunTask

__all__ = [
    "END",
    "KILL",
    "NO_RUN",
    "NUMBER_BYTES",
    "RUN",
    "Ends",
    "GuardianProcess",
    "Starter",
    "await_task",
    "end_group",
    "execute_in_child",
    "forked",
    "number_of",
    "settle_streams",
    "wait_until",
]


# What a run's own process does before and after the run: its task, its log, its group, the way it leaves.


def await_task(tasks: int) -> bytes:
    """Return the task that this process is for, once it is told; empty where there is none any more."""
    told = b""
    while more := os.read(tasks, 65536):
        told += more
    os.close(tasks)
    return told


def execute_in_child(experiment: Experiment, make_task: Callable[[], RunTask | None], records: int) -> NoReturn:
    """Be the process of a run, and leave: nothing of the orchestrator's may be cleaned up here.

    It leads a group of its own, so that all that it starts can be ended with it; it hears the word to end; what it
    prints goes to the run's log.

    Args:
        experiment: what the run is one of.
        make_task: waits for the task; None for none.
        records: where to report.
    """
    code = 1
    report = RecordWriter(records)
    try:
        gate = InterruptGate()
        gate.listen()
        task = make_task()
        if task is not None:
            _print_to(open_log(experiment.folder))
            execute_run(experiment, task, report, gate)
            report(FINISHED, {})
        code = 0
    except BaseException as error:  # noqa: BLE001 - the last resort: it must be known before the process ends
        report("failure", {"event": "", "owner": "", **failure_fields(error)})
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def settle_streams() -> None:
    """Print as a run does: line by line, in UTF-8, and not on the orchestrator's screen, which may stand in between."""
    sys.stdout, sys.stderr = sys.__stdout__, sys.__stderr__
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(encoding="utf-8", errors="backslashreplace", line_buffering=True)


def _print_to(log: int) -> None:
    os.dup2(log, 1)
    os.dup2(log, 2)
    os.close(log)


# What the orchestrator says; after RUN come the length of the task and the task.
RUN, END, KILL = b"r", b"e", b"k"
NUMBER_BYTES = 8
NO_RUN = 0

#: Where no descriptor tells of a death, it is looked for this often, in seconds.
_LOOK = 0.02


@dataclass(frozen=True, slots=True)
class Ends:
    """The descriptors of a run's process.

    Attributes:
        tasks: where it reads its task; at the end of it before there was any it leaves and has done nothing.
        records: where it reports.
        of_others: what a forked process inherits and must close: somebody waits for these to break.
    """

    tasks: int
    records: int
    of_others: tuple[int, ...]


class Starter(Protocol):
    """Starts the process of a run."""

    #: How many processes are started before their runs are wanted, whenever a run has ended.
    starts_ahead: int

    def prepare(self) -> None:
        """Do, in the guardian, what makes every start cheaper."""
        ...

    def start(self, ends: Ends) -> int:
        """Return the id of a new process, the leader of a group of its own."""
        ...


class _Child:
    """The process of a run; idle until it has its task."""

    def __init__(self, starter: Starter, records: int, others: tuple[int, ...]) -> None:
        tasks, self.tasks = os.pipe()
        self.pid = starter.start(Ends(tasks, records, (self.tasks, *others)))
        os.close(tasks)
        self.pidfd = os.pidfd_open(self.pid) if hasattr(os, "pidfd_open") else None
        self.has_task = False

    def give(self, task: bytes) -> None:
        self.has_task = True
        try:
            while task:
                task = task[os.write(self.tasks, task) :]
        except BrokenPipeError:  # it was killed: its death is seen next
            pass
        finally:
            self.forget_tasks()

    def forget_tasks(self) -> None:
        if self.tasks >= 0:
            os.close(self.tasks)
            self.tasks = -1

    def death(self) -> int | None:
        pid, status = os.waitpid(self.pid, os.WNOHANG)
        return status if pid else None

    def is_dead(self) -> bool:
        return self.death() is not None

    def close(self) -> None:
        self.forget_tasks()
        if self.pidfd is not None:
            os.close(self.pidfd)


class GuardianProcess:
    """The life of the guardian's process."""

    def __init__(
        self, commands: int, ends: int, records: int, number: mmap.mmap, starter: Starter, grace: float
    ) -> None:
        self._commands = commands
        self._ends = ends
        self._records = records
        self._number = number
        self._starter = starter
        self._grace = grace
        self._run: _Child | None = None
        #: The run, if any, and before or after it those that wait for their task.
        self._children: list[_Child] = []
        self._poll = select.poll()
        self._poll.register(commands, select.POLLIN)

    def guard(self) -> NoReturn:
        """Serve the orchestrator until it leaves or dies; then end the run that it left behind, if any, and leave."""
        try:
            self._settle()
            self._starter.prepare()
            self._start_ahead()
            while self._serve():
                pass
            self._leave()
        finally:
            os._exit(0)

    def _settle(self) -> None:
        os.setsid()  # what happens to the orchestrator's terminal and group does not reach us
        signal.set_wakeup_fd(-1)
        InterruptGate().listen()  # and nobody ever arms it: a signal that was sent to us ends nothing
        # The orchestrator's terminal, or who reads what it prints, is not kept waiting by us.
        nothing = os.open(os.devnull, os.O_RDWR)
        for descriptor in (0, 1, 2):
            os.dup2(nothing, descriptor)
        os.close(nothing)
        settle_streams()

    def _serve(self) -> bool:
        looks = any(child.pidfd is None for child in self._children)
        for descriptor, _ in self._poll.poll(_LOOK * 1000 if looks else None):
            if descriptor == self._commands and not self._obey():
                return False
        self._bury_the_dead()
        return True

    def _obey(self) -> bool:
        command = os.read(self._commands, 1)
        run = self._run
        if command == RUN:
            self._start(_read(self._commands, number_of(_read(self._commands, NUMBER_BYTES))))
        elif command == END and run is not None:
            os.kill(run.pid, signal.SIGTERM)
        elif command == KILL and run is not None:
            kill_group(run.pid)
        return bool(command)

    def _start_ahead(self) -> None:
        while len(self._children) < self._starter.starts_ahead:
            self._start_child()

    def _start_child(self) -> None:
        waiting = tuple(child.tasks for child in self._children if not child.has_task)
        child = _Child(self._starter, self._records, (self._commands, self._ends, *waiting))
        self._children.append(child)
        if child.pidfd is not None:
            self._poll.register(child.pidfd, select.POLLIN)

    def _start(self, task: bytes) -> None:
        self._bury_the_dead()  # who died while it waited has no task to die with
        if not self._children:
            self._start_child()
        self._run = self._children[0]
        self._number[:] = self._run.pid.to_bytes(NUMBER_BYTES, "big")
        self._run.give(task)

    def _bury_the_dead(self) -> None:
        for child in tuple(self._children):
            if (status := child.death()) is not None:
                self._bury(child, status)

    def _bury(self, child: _Child, status: int) -> None:
        if child is self._run:
            kill_group(child.pid)  # the usual case: nobody is left
            self._number[:] = NO_RUN.to_bytes(NUMBER_BYTES, "big")
            self._run = None
            with suppress(BrokenPipeError):
                os.write(self._ends, status.to_bytes(NUMBER_BYTES, "big"))
        self._children.remove(child)
        if child.pidfd is not None:
            self._poll.unregister(child.pidfd)
        child.close()
        if child.has_task:  # else it died of nothing that we know of, and the next one might as well
            self._start_ahead()

    def _leave(self) -> None:
        for child in self._children:
            child.forget_tasks()
        for child in self._children:
            if child.has_task:
                end_group(child.pid, self._grace, has_ended=child.is_dead)
            else:
                os.waitpid(child.pid, 0)


def end_group(leader: int, grace: float, has_ended: Callable[[], bool] | None = None) -> None:
    """Tell a process to end, and kill it, and its group, when it has not ended after `grace` seconds."""

    def is_gone() -> bool:
        try:
            os.kill(leader, 0)
        except ProcessLookupError:
            return True
        return False

    with suppress(ProcessLookupError):
        os.kill(leader, signal.SIGTERM)
    wait_until(has_ended or is_gone, grace)
    kill_group(leader)


def kill_group(leader: int) -> None:
    """Kill what is left of a process group."""
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(leader, signal.SIGKILL)


def wait_until(condition: Callable[[], bool], seconds: float) -> None:
    """Wait until the condition holds, and no longer than this."""
    deadline = time.monotonic() + seconds
    while not condition() and time.monotonic() < deadline:
        time.sleep(_LOOK)


def forked() -> int:
    """Fork, as `os.fork`, without the warning of libraries that have threads of their own in C."""
    if sys.version_info < (3, 12) or threading.active_count() > 1:
        return os.fork()
    # Python counts the threads of C libraries (OpenBLAS) as well and warns; these know how to be forked.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        return os.fork()


def number_of(data: bytes) -> int:
    """Return the number that was written as `NUMBER_BYTES` bytes."""
    return int.from_bytes(data, "big")


def _read(descriptor: int, size: int) -> bytes:
    """Read exactly so many bytes, or fewer where the other end is gone."""
    data = b""
    while len(data) < size and (more := os.read(descriptor, size - len(data))):
        data += more
    return data
