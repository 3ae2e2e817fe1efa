"""What a Dask worker does for an experiment: it joins, executes runs, and sends what they wrote.

The functions of the first part are called through Dask: `execute` is a task, and occupies a thread of the worker as
long as the run lasts; the others are executed by the worker's event loop, and return at once. A worker that does not
know the session in a call has been restarted meanwhile.
"""

from __future__ import annotations

import asyncio
import hashlib
import json
import os
import shutil
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robot_runner.cluster.piped_process import HostProcess, Outgoing
from robot_runner.cluster.raw_data_transfer import open_up
from robot_runner.cluster.run_host import INPUTS, OUTBOX, ended_unbegun
from robot_runner.cluster.worker_versions import described_versions
from robot_runner.core.execution.clock_jumps import now_counting_suspension
from robot_runner.core.storage.manifest import describe_host

if TYPE_CHECKING:
    from distributed import Worker

#: The topic for messages about runs, from workers through the scheduler, which keeps the last thousand of them.
TOPIC = "robot-runner"
#: Dask's callbacks that sample a worker's threads, a hundred times a second. They would be part of what runs measure of
#: their machine, and would see nothing of the runs, which are other processes.
_PROFILING = {"profile", "profile-cycle"}
#: How often to look whether a process has loaded the experiment, s.
_LOOK = 0.05
#: A run begins only while at least this part of the lease is left. With regular renewals half of it is (`gateway.py`).
_ENOUGH = 0.25
#: How long a host may take, beside the grace, to close its run once its worker sends no more requests, s.
_CLOSING = 30.0
#: After this many leases without a renewal the orchestrator does not come back: it has given up the worker by then.
_ABANDONED = 10

_sessions: dict[str, _Session] = {}
#: The sampling callbacks that were stopped, each with the event loop in which to start it again.
_stopped: list[tuple[Any, Any]] = []


def be_there() -> None:
    """Do nothing, on the scheduler: it has to unpickle tasks, which works only where this module is installed."""


def describe() -> dict[str, Any]:
    """Return the name of this machine, what it is, and its versions."""
    return {"host": os.uname().nodename, "machine": describe_host(), "versions": described_versions()}


def join(facts: Mapping[str, Any], dask_worker: Worker) -> dict[str, Any]:
    """Begin to take part in an experiment; an earlier part in the same one is ended first.

    `facts` are `session`, the `id` of this worker's part in it, `snapshot`, `probe` with its `path` and `digest`,
    `root` of the experiment's folder, `runs` in it, and `lease` in s. Return name and digest of the `answer` to the
    probe, if that is there.
    """
    leave(facts["session"])
    for name in _PROFILING & dask_worker.periodic_callbacks.keys():
        sampling = dask_worker.periodic_callbacks[name]
        if sampling.is_running():
            sampling.stop()
            _stopped.append((dask_worker.loop, sampling))
    session = _sessions[facts["session"]] = _Session(facts, Path(dask_worker.local_directory))
    threading.Thread(target=_leave_once_abandoned, args=[session], daemon=True, name="robot-runner-session").start()
    return {"answer": session.answer, "digest": session.answer_digest}


def take_inputs(session: str, pieces: Sequence[tuple[str, bytes]]) -> None:
    """Keep pieces of files that the experiment reads; each is appended to its file."""
    _sessions[session].take_inputs(pieces)


def settle(session: str, *, is_shared: bool) -> None:
    """Take note of whether runs write into the orchestrator's folder, and begin to load the experiment."""
    _sessions[session].settle(is_shared=is_shared)


async def unfitness(session: str, seconds: float) -> str | None:
    """Return why no run can be executed here, empty where one can; None where that is unknown after `seconds`."""
    until = time.monotonic() + seconds
    while True:
        found = _sessions[session].unfitness()
        if found is not None or time.monotonic() >= until:
            return found
        await asyncio.sleep(_LOOK)


def renew(session: str) -> None:
    """Renew the lease of the session: by this call the orchestrator shows that it got the answer to the last one."""
    _sessions[session].renew()


def stop(session: str, token: str, request: Mapping[str, Any]) -> bool:
    """Have the run of an attempt end, soon or at once; return whether it had begun. If not, it never will."""
    return _sessions[session].stop(token, request)


def read_piece(session: str, token: str, name: str, offset: int, size: int) -> tuple[bytes, str]:
    """Return a piece of a file that an attempt has left, and its SHA-256; the list of files has no name."""
    path = _sessions[session].outbox(token, name)
    with path.open("rb") as file:
        file.seek(offset)
        piece = file.read(size)
    return piece, hashlib.sha256(piece).hexdigest()


def discard(session: str, token: str) -> None:
    """Remove the files of an attempt, once the orchestrator has them."""
    _sessions[session].discard(token)


def _leave_once_abandoned(session: _Session) -> None:
    """Leave an experiment whose orchestrator was killed, or lost the scheduler, and so did not call `leave`."""
    session.await_abandonment()
    if _sessions.get(session.name) is session:
        leave(session.name)


def leave(session: str) -> None:
    """End this worker's part in an experiment, with its run if there is one, and remove all that it has left."""
    left = _sessions.pop(session, None)
    if left is not None:
        threading.Thread(target=_end, args=[left], daemon=True, name="robot-runner-leave").start()


def _end(session: _Session) -> None:
    session.end()
    for loop in {loop for loop, _ in _stopped}:
        loop.add_callback(_sample_again)


def _sample_again() -> None:
    """Have Dask sample this worker again, in its event loop, once it takes part in no experiment any more."""
    while _stopped and not _sessions:
        _stopped.pop()[1].start()


def execute(order: dict[str, Any]) -> None:
    """Execute one attempt at a run: a task of Dask. It sends messages under the topic, and returns nothing.

    `order` has `session`, `token` of the attempt, the id of the `worker` that is meant, and the `task`.

    Raises:
        RuntimeError: it is refused: another worker was meant, or this attempt was begun before.
    """
    from distributed import get_worker  # noqa: PLC0415 - heavy, and not there where only the core is installed

    worker = get_worker()
    session = _sessions.get(order["session"])
    if session is None or session.id != order["worker"]:
        # Dask gives the tasks of a lost worker to another one that listens at the same address.
        raise RuntimeError("the order was meant for a worker that was lost")
    session.execute(order, lambda message: worker.log_event(TOPIC, message))


class _Session:
    """The part that a worker takes in one experiment."""

    def __init__(self, facts: Mapping[str, Any], local: Path) -> None:
        self.id: str = facts["id"]
        self.name: str = facts["session"]
        self.folder = local / f"robot-runner-{self.id}"
        self.folder.mkdir(mode=0o700)
        self._facts = facts
        self._lock = threading.Lock()
        self._changed = threading.Condition(self._lock)
        self._begun: set[str] = set()
        self._stopped: dict[str, Mapping[str, Any]] = {}
        self._idle: list[HostProcess] = []
        self._hosts: list[HostProcess] = []
        self._of_attempt: dict[str, HostProcess] = {}
        self._has_left = False
        self._seen = self._until = now_counting_suspension()
        self.answer, self.answer_digest = self._answered_probe()

    def _answered_probe(self) -> tuple[str, str]:
        """Look for the orchestrator's probe; where it is there, answer by a file beside it: its name and digest."""
        probe = Path(self._facts["probe"]["path"])
        try:
            if hashlib.sha256(probe.read_bytes()).hexdigest() != self._facts["probe"]["digest"]:
                return "", ""
            content = os.urandom(32)
            answer = probe.with_name(f"{probe.name}-{os.urandom(8).hex()}")
            answer.write_bytes(content)
        except OSError:
            return "", ""
        return answer.name, hashlib.sha256(content).hexdigest()

    def take_inputs(self, pieces: Sequence[tuple[str, bytes]]) -> None:
        for name, piece in pieces:
            path = self.folder / INPUTS / name
            path.parent.mkdir(parents=True, exist_ok=True)
            with path.open("ab") as file:
                file.write(piece)

    def settle(self, *, is_shared: bool) -> None:
        """Leave the experiment where the processes that execute runs find it."""
        told = {name: self._facts[name] for name in ("snapshot", "runs", "root")} | {"is_shared": is_shared}
        (self.folder / "snapshot.json").write_text(json.dumps(told), encoding="utf-8")
        self._idle.append(self._started_host())

    def unfitness(self) -> str | None:
        """Return why the first of these processes cannot execute runs, as in `unfitness` above."""
        with self._lock:
            self._seen = now_counting_suspension()
            (first,) = self._idle
            unfitness = first.unfitness()
            if unfitness:
                self._idle.clear()
                self._hosts.clear()
        return unfitness

    def renew(self) -> None:
        """Postpone the end of the lease.

        The orchestrator calls again only once it has the answer to the last call. So it was there at the time of that
        answer, from which the lease is counted; and it knows that the lease ends at most its length after this call,
        even if this machine is suspended meanwhile.
        """
        with self._changed:
            self._until, self._seen = self._seen + self._facts["lease"], now_counting_suspension()
            self._changed.notify_all()
            for host in self._hosts:
                host.ask("lease", {"until": self._until})

    def await_abandonment(self) -> None:
        """Wait until the lease has not been renewed for long, or this session has ended."""
        with self._changed:
            while not self._has_left:
                left = self._seen + _ABANDONED * self._facts["lease"] - now_counting_suspension()
                if left <= 0:
                    return
                self._changed.wait(left)

    def stop(self, token: str, request: Mapping[str, Any]) -> bool:
        """Pass the request on to the process that executes the run; a run that has not begun will not begin.

        Returns:
            whether it was begun: Dask holds it back for as long as another experiment has the thread, or the resource.
        """
        with self._changed:
            is_begun = token in self._begun
            host = self._of_attempt.get(token)
            self._stopped[token] = request
            self._changed.notify_all()
        if host is not None:
            host.ask(request["kind"], {"token": token, **request})
        return is_begun

    def execute(self, order: Mapping[str, Any], tell: Any) -> None:
        """Have an attempt executed, and send messages about it until it has ended."""
        token = order["token"]
        with self._lock:
            if token in self._begun:
                raise RuntimeError("the attempt was begun before")
            self._begun.add(token)
            self._await_lease(token)
            stopped = self._stopped.pop(token, None)
        outgoing = Outgoing(self._facts["session"], token, tell)
        if stopped is not None:
            outgoing.end(ended_unbegun(stopped))
            return
        host = self._free_host()
        with self._lock:  # from here on a stop is a request to the host, which has to have its order before
            self._of_attempt[token] = host
            host.ask("execute", {"token": token, "until": self._until, "task": order["task"]})
            if (asked := self._stopped.get(token)) is not None:
                host.ask(asked["kind"], {"token": token, **asked})
        ended = host.followed(outgoing)
        with self._lock:
            self._stopped.pop(token, None)
            if ended.get("lost") or not ended.get("files"):
                self._of_attempt.pop(token)
            if host.is_alive:
                self._idle.append(host)
            else:
                self._hosts.remove(host)
        outgoing.end(ended)

    def _await_lease(self, token: str) -> None:
        """Wait until enough of the lease is left, or the attempt is stopped. The lock is held.

        After a network failure nearly as long as the lease, the first renewal leaves hardly anything of it: a run that
        began then would be lost at once, and so would its other attempts.

        Raises:
            RuntimeError: the lease is not renewed any more.
        """
        lease = self._facts["lease"]

        def is_enough() -> bool:
            return token in self._stopped or self._until - now_counting_suspension() >= lease * _ENOUGH

        if not self._changed.wait_for(is_enough, timeout=lease):
            raise RuntimeError("the orchestrator did not renew the lease of its worker")

    def outbox(self, token: str, name: str) -> Path:
        """Return the file of an attempt that is to be transferred, or, without a name, the list of them."""
        outbox = self._of_attempt[token].folder / OUTBOX
        return outbox / token / name if name else outbox / f"{token}.list"

    def discard(self, token: str) -> None:
        with self._lock:
            outbox = self._of_attempt.pop(token).folder / OUTBOX
        shutil.rmtree(outbox / token, ignore_errors=True)
        (outbox / f"{token}.list").unlink(missing_ok=True)

    def end(self) -> None:
        """Have all hosts end, wait for them, and remove what is left."""
        with self._changed:
            self._has_left = True
            self._changed.notify_all()
            hosts = list(self._hosts)
        for host in hosts:
            host.let_go()
        for host in hosts:
            host.wait(self._facts["grace"] + _CLOSING)
        for host in self._idle:  # a busy one is ended by the thread that follows it
            host.close()
        open_up(self.folder)
        shutil.rmtree(self.folder, ignore_errors=True)

    def _free_host(self) -> HostProcess:
        with self._lock:
            return self._idle.pop() if self._idle else self._started_host()

    def _started_host(self) -> HostProcess:
        host = HostProcess(self.folder / f"host-{len(self._hosts) + 1}-{os.urandom(4).hex()}")
        self._hosts.append(host)
        return host
