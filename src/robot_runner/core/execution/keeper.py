"""One keeper per run: the process that starts the run, outlives a dead orchestrator, and ends what the run started.

    orchestrator ── forks ──> keeper ── forks ──> run ── starts ──> programs of callbacks, and their orphans

Whatever kills an orchestrator (SIGKILL, out of memory) must not leave a robot driving. The run cannot watch for that
itself: while a callback hangs in C, neither signal handlers nor threads of Python are executed. The keeper can: it does
nothing else. Three pipes connect the processes:

    requests   orchestrator -> keeper          STOP or KILL; the end of the pipe (the orchestrator is gone) means STOP
    told       run, then keeper -> orchestrator    two numbers: the run's process id, and how the run ended
    records    run -> orchestrator             what happens in the run, one JSON record a line

Asked to stop, the keeper sends SIGTERM to the run, twice (`ASK_AGAIN`), and kills it when it has not ended after the
grace. Once the run has ended in whatever way, the keeper kills the rest of its process group and its orphans. Where the
run had no time to make its systems safe, another process that the keeper forks, the *standby*, does it (`standby.py`).
The run begins only once that one is there; where no robot is known to be commanded, it is forked only after a run that
has commanded one has died. If the keeper itself dies, the system sends SIGTERM to the run (Linux), and the
orchestrator, if there is one, does the keeper's work.
"""

from __future__ import annotations

import fcntl
import os
import select
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Self

from robot_runner.core.execution import processes
from robot_runner.core.execution.interruption import ASK_AGAIN, STOP_SIGNALS
from robot_runner.core.execution.left_processes import RunMark, left_processes_ended
from robot_runner.core.execution.run_records import RecordWriter
from robot_runner.core.execution.standby import Standby
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.outliving import is_spared, is_stopped, outliving

_STOP, _KILL = b"s", b"k"
_NUMBER_BYTES = 8
#: The largest buffer that a user may give a pipe by default (/proc/sys/fs/pipe-max-size).
_PIPE_BYTES = 1 << 20
#: How long the keeper waits for processes that it has killed, s: one that waits for a broken disk cannot be reaped.
_REAPING = 5.0
#: How long after the grace a run may take that nobody waits for any more, and then its keeper to end the rest, s.
_MARGIN, KEEPING = 10.0, 60.0
#: How often it is checked whether a process has ended, where nothing can be polled, s.
_LOOK = 0.01
#: One poll waits no longer, s: its limit is 24 days.
_LONGEST = 86_400.0
#: Names of signals; most of the real-time ones, which drivers use, have none.
_SIGNALS = {each.value: each.name for each in signal.Signals}


#: The keepers whose runs are in flight, in the process that has forked them.
_in_flight: set[Keeper] = set()
#: Those that have reported how their run ended and are about to exit, which takes a large process a millisecond.
_leaving: list[Keeper] = []


def _let_go_in_child() -> None:
    """Close the pipes to the keepers of other runs in any forked process.

    A keeper takes the end of its requests for the death of the orchestrator: no other process may hold that pipe open.
    """
    for keeper in _in_flight:
        keeper.let_go()
    _in_flight.clear()
    _leaving.clear()


os.register_at_fork(after_in_child=_let_go_in_child)


def reap_keepers() -> None:
    """Reap the keepers that had done their work when they were left."""
    while _leaving:
        _leaving.pop().reap()


class Keeper:
    """The orchestrator's side of a keeper. A context manager: entering starts the run, leaving ends it.

    Attributes:
        start, grace, standby: as given.
        records: a descriptor from which the run's records can be read.
        told: a descriptor that is readable when the keeper has reported, or was killed; then call `look`.
        was_killed: whether the keeper died before it reported how the run ended.
    """

    def __init__(
        self, start: Callable[[RecordWriter], None], grace: float, folder: ExperimentFolder, standby: Standby | None
    ) -> None:
        """Prepare a keeper.

        Args:
            start: executes the run; called in the run's own process.
            grace: how long a run that is asked to stop may take to close what it opened, s.
            folder: the experiment's; it gets the marks by which the run is found should its keeper be killed.
            standby: makes the systems safe where the run died before it did; None where nothing commands a robot.
        """
        self.start = start
        self.grace = grace
        self.standby = standby
        self._folder = folder
        self._outliving = folder.outliving
        self._numbers = b""
        self._status: int | None = None
        self.was_killed = False

    def __enter__(self) -> Self:
        processes.flush_streams()  # or the run would print it once more
        mark = RunMark(self._folder)
        opened = [mark.descriptor]
        try:
            requests, self._requests = _pipe(opened)
            self.told, tell = _pipe(opened)
            self.records, records = _pipe(opened)
            _widen(records)
            # Made here and not in the keeper: each page that a forked process is the first to touch is copied.
            report = RecordWriter(records)
            process = _KeeperProcess(self, requests, tell, report, mark)
            self._pid = processes.forked()
        except BaseException:  # the system has no descriptor or process left: nothing stays open
            for descriptor in opened:
                os.close(descriptor)
            raise
        if self._pid == 0:
            self.let_go()
            processes.leave_after(process.keep, report)
        for descriptor in (requests, tell, records):
            os.close(descriptor)
        mark.close()
        os.set_blocking(self.told, False)
        _in_flight.add(self)
        reap_keepers()  # now, while this one begins
        self._memory_kills = processes.memory_kills()
        return self

    def __exit__(self, *raised: object) -> None:
        _in_flight.discard(self)
        self.look()
        # A run that is still alive (the disk is full, say) must not wait for a reader: this ends it.
        self.let_go()
        if self._has_told:  # all that the run started has ended: nobody has to wait until the keeper is gone, too
            _leaving.append(self)
        else:
            await_end = processes.await_end
            if not (await_end(self.run or self._pid, self.grace + _MARGIN) and await_end(self._pid, KEEPING)):
                self.give_up()  # stopped, say: the system asks its run to stop then
            self.reap()

    def let_go(self) -> None:
        """Close the pipes between this process and the keeper."""
        for descriptor in (self.records, self._requests, self.told):
            os.close(descriptor)

    def look(self) -> bool:
        """Look, without waiting, whether the run has ended; all that it started has ended then, too."""
        with suppress(BlockingIOError):
            numbers = os.read(self.told, 2 * _NUMBER_BYTES)
            self._numbers += numbers
            self.was_killed = not (numbers or self._has_told)
        return self.was_killed or self._has_told

    def stop(self) -> None:
        """Ask the run to close what it opened and to end; it is killed when the grace is over."""
        self._request(_STOP)

    def kill(self) -> None:
        """Kill the run and everything that it started."""
        self._request(_KILL)

    def give_up(self) -> None:
        """Kill the keeper itself: it does not answer."""
        processes.try_kill(self._pid)

    def wake(self) -> None:
        """Let a keeper go on that was stopped by a signal."""
        if is_stopped(self._pid):
            os.kill(self._pid, signal.SIGCONT)

    def abandoned_run_ended(self, grace: float) -> Iterator[float]:
        """Do the work of a keeper that was killed: end the run, its process group, and what else it left alive.

        Yields how long to wait each time, s; meanwhile the run's records are to be read, or it would wait for that.
        """
        if self.run is not None:  # else the run had not begun, and does not begin without a keeper
            yield from processes.group_ended(self.run, grace, self.spared)
        yield from left_processes_ended(self._folder, [])

    def spared(self) -> frozenset[int]:
        """Return which processes may outlive the run that started them."""
        return outliving(self._outliving)

    @property
    def run(self) -> int | None:
        """The id of the run's process; None where it had not begun."""
        return _number(self._numbers[:_NUMBER_BYTES]) if self._numbers else None

    @property
    def has_failed(self) -> bool:
        """Whether the keeper ended by a fault, which it has reported like a failure of the run."""
        return self.was_killed and os.waitstatus_to_exitcode(self.reap()) > 0

    def death(self) -> str:
        """Return how the run's process died, or the keeper if that was killed; empty if it exited with 0."""
        whose = "the run's keeper" if self.was_killed else "the run's process"
        status = self.reap() if self.was_killed else _number(self._numbers[_NUMBER_BYTES:])
        code = os.waitstatus_to_exitcode(status)
        if code < 0:
            lacked = code == -signal.SIGKILL and processes.memory_kills() > self._memory_kills
            cause = " (meanwhile the system killed a process for lack of memory)" if lacked else ""
            return f"{whose} was killed by {_SIGNALS.get(-code, f'signal {-code}')}{cause}"
        return f"{whose} exited with code {code}" if code else ""

    @property
    def _has_told(self) -> bool:
        """Whether the keeper has reported both numbers, and so has done its work."""
        return len(self._numbers) == 2 * _NUMBER_BYTES

    def reap(self) -> int:
        """Wait until the keeper has exited; return how it did, as `os.waitpid` does."""
        if self._status is None:
            try:
                self._status = os.waitpid(self._pid, 0)[1]
            except ChildProcessError:  # a callback waited for all children while the run was in flight
                self._status = 0
        return self._status

    def _request(self, request: bytes) -> None:
        with suppress(BrokenPipeError):  # the keeper was killed: `look` tells
            os.write(self._requests, request)


class _KeeperProcess:
    def __init__(self, keeper: Keeper, requests: int, tell: int, report: RecordWriter, mark: RunMark) -> None:
        self._spared = keeper.spared
        self._standby = keeper.standby
        self._beforehand = keeper.standby if keeper.standby and keeper.standby.is_there_beforehand else None
        self._start = keeper.start
        self._grace = keeper.grace
        self._requests = requests
        self._tell = tell
        self._report = report
        self._mark = mark
        self._kill_at: float | None = None
        self._ask_again_at: float | None = None
        self._may_begin, self._let_begin = -1, -1

    def keep(self) -> None:
        """Start the run, watch over it until it has ended, end what it left behind, and report how it ended."""
        os.setsid()  # what happens to the orchestrator's terminal does not reach us
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)  # where it is ignored, the system says of no child how it ended
        processes.use_no_streams()
        processes.adopt_orphans()
        if self._beforehand is not None:
            self._may_begin, self._let_begin = os.pipe()
        self._fork_run()
        if self._beforehand is not None:
            ours = [self._requests, self._tell, self._report.descriptor, self._may_begin, self._let_begin]
            # It may outlive us, and is not of the run: the mark is not its own.
            self._beforehand.begin(self._run, let_go=[*ours, self._mark.descriptor])
            os.close(self._may_begin)
            with suppress(BrokenPipeError):  # somebody has killed the run
                os.write(self._let_begin, b".")
            os.close(self._let_begin)
        self._report.close()  # the run's alone from here on
        status = self._watch()
        processes.kill_group(self._run, self._spared)
        if self._beforehand is not None:
            self._beforehand.wait()
        if self._standby is not None:
            self._standby.look_after(self._run)  # it may have been killed, and the orchestrator as well
        are_left = processes.has_children()
        self._end_orphans()
        if are_left and self._standby is not None:
            self._standby.stop_again(self._run)
        with suppress(BrokenPipeError):  # the orchestrator is gone
            os.write(self._tell, _bytes(status))

    def _fork_run(self) -> None:
        keeper = os.getpid()
        # The run unblocks them once it has handlers: a signal that comes before would be lost. The keeper leaves them
        # blocked: stop signals are for the run.
        signal.pthread_sigmask(signal.SIG_BLOCK, STOP_SIGNALS)
        self._run = processes.forked()
        if self._run == 0:
            processes.leave_after(lambda: self._become_run(keeper), self._report)
        with suppress(PermissionError, ProcessLookupError):  # whichever of the two comes first
            os.setpgid(self._run, self._run)

    def _become_run(self, keeper: int) -> None:
        os.setpgid(0, 0)
        signal.set_wakeup_fd(-1)  # inherited: it would wake the orchestrator
        processes.stop_with_parent()
        os.write(self._tell, _bytes(os.getpid()))
        # Only now: as long as the run has this end open, the orchestrator cannot notice the death of the keeper.
        os.close(self._tell)
        os.close(self._requests)
        self._mark.sign()
        # Otherwise the keeper died before `stop_with_parent`, or before the standby was there.
        if os.getppid() == keeper and self._is_stood_by():
            self._start(self._report)

    def _is_stood_by(self) -> bool:
        """Wait, in the run, until its standby is there, if it has one; return False where the keeper died before."""
        if self._beforehand is None:
            return True
        os.close(self._let_begin)
        with os.fdopen(self._may_begin, "rb", buffering=0) as may_begin:
            return bool(may_begin.read(1))

    def _watch(self) -> int:
        """Return how the run ended, as `os.waitpid` does; obey requests, and kill it when the grace is over."""
        poll = select.poll()
        poll.register(self._requests, select.POLLIN)
        self._end = processes.end_descriptor(self._run)
        if self._end is not None:
            poll.register(self._end, select.POLLIN)
        while (status := self._reap()) is None:
            for descriptor, _ in poll.poll(self._milliseconds()):
                if descriptor == self._requests and not self._obey():
                    poll.unregister(self._requests)
            if self._ask_again_at is not None and time.monotonic() >= self._ask_again_at:
                self._ask_again_at = None
                os.kill(self._run, signal.SIGTERM)
            if self._kill_at is not None and time.monotonic() >= self._kill_at:
                os.kill(self._run, signal.SIGKILL)  # a callback may have moved it to another group
                processes.kill_group(self._run, self._spared)
                self._kill_at = time.monotonic() + self._grace
        return status

    def _milliseconds(self) -> float | None:
        if self._end is None:
            return _LOOK * 1000
        moments = [moment for moment in (self._ask_again_at, self._kill_at) if moment is not None]
        return max(0.0, min(min(moments) - time.monotonic(), _LONGEST)) * 1000 if moments else None

    def _reap(self) -> int | None:
        """Reap every child that has ended; return how the run ended if it is among them."""
        while True:
            pid, status = os.waitpid(-1, os.WNOHANG)  # there is a child for as long as the run was not reaped
            if pid == self._run:
                return status
            if pid == 0:
                return None

    def _obey(self) -> bool:
        """Take a request; return whether the orchestrator is still there."""
        request = os.read(self._requests, 1)
        if request == _KILL:
            self._kill_at = time.monotonic()
        elif self._kill_at is None:
            now = time.monotonic()
            self._ask_again_at, self._kill_at = now + ASK_AGAIN, now + self._grace
            os.kill(self._run, signal.SIGTERM)
        return bool(request)

    def _end_orphans(self) -> None:
        """Kill what the run left behind, also what has a session or a process group of its own, and reap it."""
        deadline = time.monotonic() + _REAPING
        while processes.has_children() and time.monotonic() < deadline:
            spared = self._spared()
            killed = [pid for pid in processes.children() if not is_spared(pid, spared) and processes.try_kill(pid)]
            if not killed:
                return
            time.sleep(_LOOK)


def _widen(descriptor: int) -> None:
    """Enlarge the buffer of a pipe (Linux): its content can be read after the run has died."""
    if hasattr(fcntl, "F_SETPIPE_SZ"):
        with suppress(OSError):  # the user has reached the limit of memory for pipes: it stays as it is
            fcntl.fcntl(descriptor, fcntl.F_SETPIPE_SZ, _PIPE_BYTES)


def _pipe(opened: list[int]) -> tuple[int, int]:
    """Make a pipe, and add its ends to what is open."""
    try:
        ends = os.pipe()
    except OSError as error:
        raise processes.no_process(error) from error
    opened += ends
    return ends


def _bytes(number: int) -> bytes:
    return number.to_bytes(_NUMBER_BYTES, "big")


def _number(data: bytes) -> int:
    return int.from_bytes(data, "big")
