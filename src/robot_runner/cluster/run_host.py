"""The process that executes runs on a worker: `python -m robot_runner.cluster.run_host`.

Dask executes tasks in threads, and the process that forks runs has none (docs/architecture.md). So a worker starts one
of these for each of its threads. It loads the experiment once, and executes one run after another as an orchestrator
does on its own machine: keeper, standby, deadlines, grace.

It ends its run on request, when its *lease* ends, or when the worker is gone, which shows in the end of the pipe. The
lease says until when the orchestrator was known to be there; a worker that is cut off from it stops its runs, as the
orchestrator executes them elsewhere some time later. What the process wrote on this machine is removed when it ends.
"""

from __future__ import annotations

import gc
import json
import os
import select
import shutil
import sys
import time
import traceback
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from robot_runner.cluster.experiment_snapshot import SOURCE, experiment_of, inputs_of, task_here, texts_here
from robot_runner.cluster.raw_data_transfer import listed_files, open_up
from robot_runner.core.config.claims import Claims
from robot_runner.core.config.experiment import Experiment
from robot_runner.core.errors import ExecutionError, RobotRunnerError
from robot_runner.core.execution.clock_jumps import now_counting_suspension
from robot_runner.core.execution.going_on import goes_on
from robot_runner.core.execution.interruption import Interruption
from robot_runner.core.execution.keeper import reap_keepers
from robot_runner.core.execution.local_places import begin_run, load_before_forks
from robot_runner.core.execution.places import RunInFlight, Watch
from robot_runner.core.execution.processes import use_no_streams
from robot_runner.core.execution.run_records import RecordReader, RecordWriter
from robot_runner.core.execution.task import OutcomeBuilder, RunOutcome, RunTask
from robot_runner.core.storage.claim_locks import HeldClaims
from robot_runner.core.storage.guarded_files import make_folder, open_descriptor
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.shared_claims import may_be_one
from robot_runner.core.treatments import bind
from robot_runner.core.words import listed

#: The reason for stopping a run whose orchestrator is out of reach.
GONE = "the orchestrator is gone, or out of reach"
#: The folder of what is to be transferred to the orchestrator: a folder and a list for each attempt.
OUTBOX = "outbox"
#: The folder, beside those of the processes, of the files that the experiment reads, where these were sent.
INPUTS = "inputs"
#: How much of the disk has to be free for a run to begin, and after a failed run, which else counts as lost; bytes.
_ROOM, _NO_ROOM = 64_000_000, 1_000_000
_READABLE = select.POLLIN | select.POLLHUP | select.POLLERR
_BLOCK = 1 << 20
#: How often to look whether another experiment has let go of what a run claims, s.
_LOOK = 0.25
#: How often to look whether the lease has ended, s: a poll does not count for how long the machine is suspended.
_LOOK_AT_LEASE = 1.0
_STAYED = "stayed on the worker, where it was removed"
_WAITS_FIX = "It begins once that is free; end the other with Ctrl-C in its terminal if it is not to wait."


class _Host:
    """Executes the runs that the worker orders, one at a time."""

    def __init__(
        self,
        experiment: Experiment,
        folder: Path,
        shared: tuple[Path, Path] | None,
        texts: Mapping[str, Mapping[str, str]],
        requests: int,
        replies: RecordWriter,
    ) -> None:
        self._experiment = experiment
        self._shared = shared
        self._texts = texts
        self._folder = folder
        load_before_forks(experiment)
        self._descriptor = requests
        self._requests = RecordReader(requests)
        self._tell = replies
        self._lease = 0.0
        self._token = ""
        self._order: Mapping[str, Any] | None = None
        self._stopped: Mapping[str, Any] | None = None
        self._claims = Claims(experiment.parameters, experiment.plugins, experiment.events)
        self._held = ExitStack()
        self._waits_for = ""
        self._run: RunInFlight | None = None
        self._builder: _Builder | None = None
        self._records: list[tuple[str, dict[str, Any]]] = []
        self._is_leaving = self._is_stopped = False

    def serve(self) -> None:
        """Execute runs until the worker, or a signal, ends this."""
        with Interruption() as self._interruption:
            while not self._is_leaving or self._run is not None:
                self._wait()
                self._take_requests()
                if self._interruption.is_requested:
                    self._leave()
                if self._order is not None:
                    self._begin_or_wait(self._order)
                if self._run is not None:
                    self._see_to_run(self._run)

    def _wait(self) -> None:
        poll = select.poll()
        poll.register(self._interruption.descriptor, _READABLE)
        if not self._is_leaving:
            poll.register(self._descriptor, _READABLE)
        due: list[float] = []
        if self._run is not None:
            for descriptor in self._run.descriptors:
                poll.register(descriptor, _READABLE)
            due = [each for each in (self._run.due, self._lease_due) if each is not None]
        if self._order is not None:
            due = [time.monotonic() + _LOOK]
        waited = min(due, default=float("inf")) - time.monotonic()
        # A millisecond more, as poll may return a little too early.
        poll.poll(None if waited == float("inf") else max(0.0, waited) * 1000 + 1)
        self._interruption.forget_wakeups()

    @property
    def _has_lease(self) -> bool:
        """Whether the lease goes on, during which the orchestrator has this run executed nowhere else."""
        return now_counting_suspension() < self._lease

    @property
    def _lease_due(self) -> float | None:
        """When to look at the lease next, on the monotonic clock, s; None once the run was stopped for its end."""
        if self._is_leaving or self._is_stopped:
            return None
        return time.monotonic() + min(_LOOK_AT_LEASE, self._lease - now_counting_suspension())

    def _take_requests(self) -> None:
        if self._is_leaving:
            return
        requests, is_open = self._requests.read()
        for kind, fields in requests:
            if kind == "lease":
                self._lease = fields["until"]
            elif kind == "execute":
                self._order, self._stopped = fields, None
                self._token, self._lease = fields["token"], fields["until"]
            elif fields["token"] == self._token:
                self._stopped = fields
                if self._run is not None:
                    self._run.stop(fields["because"], is_interruption=fields["is_interruption"])
                    if kind == "kill":
                        self._run.kill()
        if not is_open:
            self._leave()

    def _leave(self) -> None:
        self._is_leaving = True
        if self._run is not None:
            self._run.stop(GONE)

    def _begin_or_wait(self, order: Mapping[str, Any]) -> None:
        """Begin a run once no other experiment on this machine has what it claims, unless it is stopped before."""
        told: dict[str, Any] | None = None
        if self._is_leaving or not self._has_lease:
            told = {"lost": GONE, "is_certain": True}
        elif (asked := self._stopped) is not None:
            told = ended_unbegun(asked)
        elif not self._has_claims(task_here(self._experiment, order["task"], self._texts)):
            return
        self._order = None
        if told is None:
            self._begin(order)
        else:
            self._tell("ended", told)

    def _has_claims(self, task: RunTask) -> bool:
        """Claim what the run needs of this machine; report once, if another experiment has it, which one.

        Its robot is left out: the orchestrator, which may be on this machine, has claimed that for all runs.
        """
        claimed, robots = self._claims.against_others([task.combination]), [*self._claims.robots([task.combination])]
        claims = [each for each in claimed if not any(may_be_one(each, robot) for robot in robots)]
        name = self._experiment.parameters.experiment_name
        try:
            self._held.enter_context(HeldClaims(claims, name, self._experiment.folder.root, goes_on=goes_on))
        except ExecutionError as error:
            if self._waits_for != self._token:
                self._waits_for = self._token
                told = {"owner": "cluster", "problem": f"the run waits: {error.problem}", "fix": _WAITS_FIX}
                self._tell("records", {"records": [("finding", told)]})
            return False
        return True

    def _begin(self, order: Mapping[str, Any]) -> None:
        if lack := _lack_of_room(self._folder):
            self._held.close()
            self._tell("ended", {"lost": lack, "is_certain": True, "is_unfit": True})
            return
        self._task = task = replace(task_here(self._experiment, order["task"], self._texts), slot=1)  # of this machine
        for plugin in self._experiment.plugins:  # which the orchestrator has done as well
            bind(plugin, task.combination)
        self._is_stopped = False
        self._builder = _Builder(task.run_id, self._experiment.columns)
        watch = Watch(interruption=self._interruption, report=lambda kind, fields: self._records.append((kind, fields)))
        self._run = begin_run(self._experiment, task, self._builder, watch)

    def _see_to_run(self, run: RunInFlight) -> None:
        if not (self._is_leaving or self._is_stopped or self._has_lease):
            self._is_stopped = True
            run.stop(GONE)
        ended = None
        if run.advance():
            outcome = run.outcome()
            run.close()
            self._run = None
            reap_keepers()  # else the next run with these claims would take an unreaped keeper for a run that goes on
            self._held.close()
            ended = self._told(outcome)
        if self._records:  # all in one message, as each wakes the worker
            self._tell("records", {"records": self._records})
            self._records = []
        if ended is not None:
            self._tell("ended", ended)

    def _told(self, outcome: RunOutcome) -> dict[str, Any]:
        assert self._builder is not None  # noqa: S101 - a run was begun
        if self._builder.ended_because == GONE:
            self._discard(self._task)
            return {"lost": GONE, "is_certain": True}
        ended: dict[str, Any] = {
            "because": self._builder.ended_because,
            "is_interrupted": self._builder.is_interrupted,
            "seconds": outcome.seconds,
        }
        try:
            ended |= self._kept(self._task)
            for name in ended.pop("skipped"):
                self._find(f"{name!r} is not a regular file, and {_STAYED}", "Write files, and no links.")
            if unread := ended.pop("unread"):  # as where a container has written as root; another worker cannot either
                names = listed(repr(each) for each in unread)
                problem = f"{names} may not be read by the worker's user, and {_STAYED}"
                self._find(problem, "Have it written by the worker's user, such as with `user:` in a Compose file.")
                ended["because"] = ended["because"] or problem
        except (OSError, RobotRunnerError) as error:
            self._discard(self._task)
            problem = f"what the run left on the worker cannot be kept: {error}"
            if isinstance(error, PermissionError):  # of this run; others go on
                ended["because"] = ended["because"] or problem
            else:
                ended["lost"] = problem
        room = shutil.disk_usage(self._folder).free
        if outcome.failure is not None and room < _NO_ROOM:
            ended["lost"] = f"the worker's disk is full: {room} bytes are left"
        return ended | ({"is_certain": True, "is_unfit": True} if "lost" in ended else {})

    def _find(self, problem: str, fix: str) -> None:
        self._records.append(("finding", {"owner": "cluster", "problem": problem, "fix": fix}))

    def _discard(self, task: RunTask) -> None:
        """Remove the log and files of a lost attempt: else the next attempt here would append to them."""
        folder = self._experiment.folder
        folder.current_log.unlink(missing_ok=True)
        open_up(folder.run(task.run_id))
        shutil.rmtree(folder.run(task.run_id), ignore_errors=True)

    def _kept(self, task: RunTask) -> dict[str, Any]:
        """Keep the log of a run; put what it has written in place, or make it ready to be sent home."""
        folder = self._experiment.folder
        log = folder.current_log
        run = folder.run(task.run_id)
        open_up(run)
        if log.exists() and log.stat().st_size:
            run.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(log, folder.log(task.run_id))  # the runs may be on another file system
        log.unlink(missing_ok=True)
        if not run.exists():
            return {"files": 0, "bytes": 0, "skipped": [], "unread": []}
        outbox = self._folder / OUTBOX
        outbox.mkdir(exist_ok=True)
        kept = run.rename(outbox / self._token)
        files, skipped, unread = listed_files(kept)
        apart = {"skipped": skipped, "unread": unread}
        if self._shared is not None:
            root, runs = self._shared
            for name, _, _ in files:
                self._put_in_place(kept / name, runs / task.run_id / name, root)
            shutil.rmtree(kept, ignore_errors=True)
            return {"files": 0, "bytes": 0} | apart
        text = "".join(json.dumps(each) + "\n" for each in files)
        (outbox / f"{self._token}.list").write_text(text, encoding="utf-8")
        return {"files": len(files), "bytes": sum(each[1] for each in files), "list": len(text)} | apart

    def _put_in_place(self, source: Path, target: Path, root: Path) -> None:
        """Copy a file into the orchestrator's folder, as long as the lease lasts: then the run is another worker's.

        Raises:
            OSError: the lease has ended, or the file cannot be written.
            StorageError: the way to it leads over a link, or it is there.
        """
        make_folder(target.parent, root)
        descriptor = open_descriptor(target, root, os.O_WRONLY | os.O_CREAT | os.O_EXCL)
        with source.open("rb") as file, os.fdopen(descriptor, "wb") as copy:
            while block := file.read(_BLOCK):
                self._take_requests()
                if self._is_leaving or not self._has_lease:
                    raise OSError(GONE)
                copy.write(block)


class _Builder(OutcomeBuilder):
    """Gathers what happens in a run, and remembers what the orchestrator is to be told of its end."""

    ended_because = ""
    is_interrupted = False

    def outcome(self, *, ended_because: str = "", interrupted: bool = False) -> RunOutcome:
        self.ended_because, self.is_interrupted = ended_because, interrupted
        return super().outcome(ended_because=ended_because, interrupted=interrupted)


def ended_unbegun(asked: Mapping[str, Any]) -> dict[str, Any]:
    """Return how an attempt ended that was asked to stop before it had begun."""
    return {"because": asked["because"], "is_interrupted": asked["is_interruption"], "seconds": 0.0}


def _lack_of_room(folder: Path) -> str:
    """Return that there is no room for what a run writes; empty where there is."""
    room = shutil.disk_usage(folder).free
    return f"the worker's disk is full: {room / 1e6:.0f} MB are left" if room < _ROOM else ""


def _clear(folder: Path) -> None:
    """Remove what this process wrote, and the session's folder with the last of its processes."""
    open_up(folder)
    shutil.rmtree(folder, ignore_errors=True)
    with suppress(OSError):
        if not any(each.is_dir() and each.name != INPUTS for each in folder.parent.iterdir()):
            shutil.rmtree(folder.parent, ignore_errors=True)


def main(requests: int, writer: int, folder: Path) -> None:
    """Load the experiment of a session, and execute runs of it until the worker ends this.

    It reads orders from the descriptor `requests`, and tells the worker what it has to by `writer`. `folder` is its
    own; that above it has the session's `snapshot.json`.
    """
    os.setsid()
    use_no_streams()
    tell = RecordWriter(writer, waits=True)
    try:
        session = json.loads((folder.parent / "snapshot.json").read_text(encoding="utf-8"))
        shared = (Path(session["root"]), Path(session["runs"])) if session["is_shared"] else None
        kept = ExperimentFolder(Path(session["root"])).config if shared else folder.with_name(INPUTS)
        with inputs_of(kept, folder):
            experiment = experiment_of(session["snapshot"], folder)
            gc.collect()
            gc.freeze()  # what a forked run does not collect it does not have to copy
            if lack := _lack_of_room(folder):
                tell("refused", {"problems": [lack]})
                return
            texts = texts_here(session["snapshot"], experiment)
            host = _Host(experiment, folder, shared, texts, requests, tell)
            tell("ready", {})
            host.serve()
    except RobotRunnerError as error:
        # The config's own path, and not that of the copy on the worker.
        problems = [str(finding) for finding in error.findings if finding.is_error]
        tell("refused", {"problems": [each.replace(f"{folder / SOURCE}{os.sep}", "") for each in problems]})
    except Exception as error:  # noqa: BLE001 - whatever it is, the worker has to know why no run is executed
        line = traceback.extract_tb(error.__traceback__)[-1]
        tell("refused", {"problems": [f"{type(error).__name__}: {error} ({Path(line.filename).name}:{line.lineno})"]})
    finally:
        _clear(folder)


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3]))
