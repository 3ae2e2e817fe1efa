"""The workers of a Dask cluster as places, and the runs that they execute, on the orchestrator's side.

Dask's client has threads, which the orchestrator must not have: a process beside it speaks to the cluster
(`gateway.py`).
"""

from __future__ import annotations

import hashlib
import os
import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from robot_runner.cluster.experiment_snapshot import snapshot_of
from robot_runner.cluster.piped_process import PipedProcess
from robot_runner.core.errors import ExecutionError, Finding
from robot_runner.core.execution.worker import described_task
from robot_runner.core.links.connect import is_simulated
from robot_runner.core.plugin import THIS_MACHINE, System
from robot_runner.core.storage import guarded_files

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from robot_runner.core.config.experiment import Experiment
    from robot_runner.core.execution.places import Watch
    from robot_runner.core.execution.task import OutcomeBuilder, RunOutcome, RunTask

#: How long after the grace a run may take to be killed with all that it has started (`keeper.py`), and its systems to
#: be made safe (`standby.py`), s.
_KILLING, _MAKING_SAFE = 2.0, 15.0
#: Until the gateway tells what is set: its defaults, s.
_LEASE, _PATIENCE = 30.0, 300.0
#: How long the gateway may take to say goodbye to the workers, s.
_GOODBYE = 20.0
#: How a file begins by which workers find out whether they see the experiment's folder; so do their answers.
_PROBE = ".probe-"


class ClusterPlaces:
    """All places of an experiment that the workers of a cluster are: one for each thread of a worker.

    Args:
        experiment: what is executed.
        address: of the scheduler, as in `tcp://scheduler:8786`.

    Raises:
        ExecutionError: the experiment cannot travel to other machines.
    """

    def __init__(self, experiment: Experiment, address: str) -> None:
        self._experiment = experiment
        self._address = address
        self._session = os.urandom(8).hex()
        self._places: list[ClusterPlace] = []
        self._runs: dict[str, RunAtWorker] = {}
        self._said: list[str] = []
        self._asides: dict[str, str] = {}
        self._lease, self._patience = _LEASE, _PATIENCE
        self._closing = _closing_of(experiment)
        self._alone_since: float | None = time.monotonic()
        self._is_gone = False
        self._probe = experiment.folder.root / f"{_PROBE}{self._session}"
        facts = self._facts()
        self._gateway = PipedProcess("robot_runner.cluster.gateway")
        self.ask("facts", facts)

    @property
    def all(self) -> Sequence[ClusterPlace]:
        """Those of all workers that have joined, with those that are aside."""
        return self._places

    @property
    def descriptors(self) -> Collection[int]:
        """Where the gateway tells something."""
        return () if self._is_gone else (self._gateway.descriptor,)

    @property
    def due(self) -> float | None:
        """The end of the patience, where there is no worker."""
        if self._said:
            return 0.0
        return None if self._alone_since is None else self._alone_since + self._patience

    def advance(self) -> Sequence[str]:
        """Take note of workers that have joined, were refused, or are gone.

        Raises:
            ExecutionError: there has been none for too long, or the gateway has died.
        """
        self.take_replies()
        said, self._said = self._said, []
        if self._is_gone and not self._runs:
            raise self._refusal("the process that speaks to the cluster has ended")
        if self._alone_since is not None and time.monotonic() >= self._alone_since + self._patience:
            raise self._refusal(f"no worker has been there for {self._patience:g} s")
        return said

    def close(self) -> None:
        """Have the workers forget the experiment, and end the gateway."""
        self.ask("end", {})
        self._gateway.let_go()
        self._gateway.wait(_GOODBYE)
        self._gateway.close()
        self._remove_probes()

    def ask(self, kind: str, fields: Mapping[str, Any]) -> None:
        """Send a request to the gateway; where it is gone, its end tells."""
        self._gateway.ask(kind, fields)

    def begun(self, token: str, run: RunAtWorker) -> None:
        """Take down that a run is in flight."""
        self._runs[token] = run

    def over(self, token: str) -> None:
        """Take down that it no longer is."""
        self._runs.pop(token, None)

    def miss(self, claims: Collection[str]) -> None:
        """Take down that a worker does not offer what a run claims; that is said where no other one does."""
        offered = {each for place in self._places if not place.is_aside for each in place.worker["resources"]}
        for claim in sorted(set(claims) - offered):
            fix = f"Start one that has it: dask worker {self._address} --nthreads 1 --resources {claim}=1"
            self._say(f"claim {claim}", "no worker offers it as a resource, and a run needs it for itself", fix)

    @property
    def longest_end(self) -> float:
        """How long the end of a run may take that is to be ended, s."""
        return self._lease + self._closing

    def take_replies(self) -> None:
        """Take what the gateway tells, for all runs: they share one pipe."""
        if self._is_gone:
            return
        replies, is_open = self._gateway.replies()
        for kind, fields in replies:
            self._take(kind, fields)
        if not is_open:
            self._is_gone = True
            for place in self._places:
                place.is_aside = True
            # It cannot renew leases any more, so the runs of all workers end.
            until = time.monotonic() + self._lease + self._closing
            for run in self._runs.values():
                run.lose("the process that speaks to the cluster has ended", until)

    def _take(self, kind: str, fields: dict[str, Any]) -> None:
        if kind == "records":
            if (run := self._runs.get(fields["token"])) is not None:
                run.take(fields["records"])
        elif kind == "over":
            if (run := self._runs.get(fields["token"])) is not None:
                run.end(fields)
        elif kind == "joined":
            self._add(fields)
        elif kind == "settings":
            self._lease, self._patience = fields["lease"], fields["patience"]
        elif kind == "unconnected":
            self._say(f"cluster {self._address}", f"the scheduler cannot be reached: {fields['because']}")
        elif kind == "refused":
            for each in fields["findings"]:
                self._say(each["where"], each["problem"], each["fix"])
        else:
            self._set_aside(kind, fields)

    def _add(self, worker: dict[str, Any]) -> None:
        self._places = [place for place in self._places if not place.is_aside or place.is_busy]
        slots = range(1, worker["threads"] + 1)
        self._places += [ClusterPlace(self, self._experiment, worker, slot) for slot in slots]
        self._alone_since = None

    def _set_aside(self, kind: str, fields: dict[str, Any]) -> None:
        for place in self._places:
            if place.worker["worker"] == fields["worker"] and not place.is_aside:
                place.is_aside = True
                fix = "" if kind == "gone" else "Mend this there, and start the worker again."
                self._say(f"worker {place.worker['name']}", f"executes no more runs: {fields['because']}", fix)
        if all(place.is_aside for place in self._places) and self._alone_since is None:
            self._alone_since = time.monotonic()

    def _say(self, where: str, problem: str, fix: str = "") -> None:
        text = str(Finding.warning(where, problem, fix))
        if self._asides.get(where) != text:  # a scheduler that is out of reach is looked for again and again
            self._asides[where] = text
            self._said.append(text)

    def _refusal(self, problem: str) -> ExecutionError:
        known = "; ".join(self._asides.values())
        return ExecutionError(
            f"{problem}{f' ({known})' if known else ''}",
            where=f"cluster {self._address}",
            fix="Start workers with `dask worker`, and start the experiment again: it resumes.",
        )

    def _remove_probes(self) -> None:
        """Remove the probe, what workers answered to it, and what an orchestrator left that was killed."""
        root = self._experiment.folder.root
        for path in root.glob(f"{_PROBE}*"):
            guarded_files.remove(path, root)

    def _facts(self) -> dict[str, Any]:
        experiment, content = self._experiment, os.urandom(64)
        snapshot = snapshot_of(experiment)  # or a refusal, before anything is left in the folder
        self._remove_probes()
        guarded_files.replace(self._probe, content, experiment.folder.root)
        runs = str(experiment.folder.runs.resolve())
        return {
            "address": self._address,
            "session": self._session,
            "root": str(experiment.folder.root.resolve()),
            "runs": runs,
            "closing": self._closing,
            "worker_facts": {
                "session": self._session,
                "snapshot": snapshot,
                "probe": {"path": str(self._probe.resolve()), "digest": hashlib.sha256(content).hexdigest()},
                "root": str(experiment.folder.root.resolve()),
                "runs": runs,
                "grace": experiment.parameters.grace_in_s,
            },
        }


def _closing_of(experiment: Experiment) -> float:
    """Return how long a run that is asked to stop may take until nothing of it is left, s."""
    may_stand_by = any(type(each).make_safe is not System.make_safe for each in experiment.systems)
    making_safe = _MAKING_SAFE if may_stand_by and not is_simulated(experiment.parameters.robot) else 0.0
    return experiment.parameters.grace_in_s + _KILLING + making_safe


class ClusterPlace:
    """One thread of a worker: it executes one run at a time.

    Attributes:
        worker: what is known of it: `address`, `name`, `worker` (its id), `host`, and the names of its `resources`.
        slot: 0: a run there has no files here while it is executed.
    """

    slot = 0

    def __init__(self, places: ClusterPlaces, experiment: Experiment, worker: Mapping[str, Any], thread: int) -> None:
        self.experiment = experiment
        self.worker = worker
        self.is_aside = False
        self.is_busy = False
        self.name = worker["name"] if worker["threads"] == 1 else f"{worker['name']}/{thread}"
        self._places = places
        self._claims: tuple[str, ...] = ()

    def claimed(self, claims: Collection[str], combination: Mapping[str, object]) -> frozenset[str] | None:
        """Return what a run would hold here; None where this worker does not offer it as a resource of Dask's.

        The worker itself is offered by every worker.
        """
        del combination
        lacking = [claim for claim in claims if claim not in {THIS_MACHINE, *self.worker["resources"]}]
        if lacking:
            self._places.miss(lacking)
            return None
        self._claims = tuple(claims)  # the last one asked for before `begin` is the run's
        return frozenset(f"host:{self.worker['host']}" if claim == THIS_MACHINE else claim for claim in claims)

    def begin(self, task: RunTask, builder: OutcomeBuilder, watch: Watch) -> RunAtWorker:
        """Order one attempt at a run from the worker."""
        run = RunAtWorker(self, self._places, builder, watch)
        self.is_busy = True
        run.order(task, self._claims)
        return run


class RunAtWorker:
    """One attempt at a run that a worker executes."""

    def __init__(self, place: ClusterPlace, places: ClusterPlaces, builder: OutcomeBuilder, watch: Watch) -> None:
        self._place = place
        self._places = places
        self._builder = builder
        self._watch = watch
        self._token = os.urandom(8).hex()
        self._ended: dict[str, Any] | None = None
        self._lost: tuple[str, float] | None = None
        self._is_asked = self._is_interrupted = False

    def order(self, task: RunTask, claims: Collection[str]) -> None:
        """Order the attempt."""
        self._places.begun(self._token, self)
        worker = self._place.worker
        order = {
            "token": self._token,
            "address": worker["address"],
            "worker": worker["worker"],
            "name": worker["name"],
            "run": task.run_id,
            "claims": list(claims),
            "task": described_task(self._place.experiment, task),
        }
        self._places.ask("begin", order)

    @property
    def descriptors(self) -> Collection[int]:
        """Where the gateway tells something, of this run or another."""
        return self._places.descriptors

    @property
    def due(self) -> float | None:
        """At once where another run's `advance` has taken the end of this one; or the end of a lost one."""
        if self._ended is not None:
            return 0.0
        return None if self._lost is None else self._lost[1]

    def advance(self) -> bool:
        """Take what the gateway tells; return whether the attempt is over."""
        self._places.take_replies()
        if self._lost is not None and time.monotonic() >= self._lost[1]:
            self._ended = self._ended or {"lost": self._lost[0]}
        return self._ended is not None

    def stop(self, because: str, *, is_interruption: bool = False) -> None:
        """Have the worker stop the run."""
        if not self._is_asked:
            self._is_asked = True
            self._is_interrupted = is_interruption
            if is_interruption:
                self._watch.noticed_interruption()
            self._ask("stop", because)

    def kill(self) -> None:
        """Have the worker kill the run."""
        self._is_interrupted = True
        self._ask("kill", "")
        if self._lost is not None:  # nobody is there who would tell
            self._lost = self._lost[0], 0.0

    def outcome(self) -> RunOutcome:
        """Return how the attempt went."""
        ended = self._ended or {}
        if (lost := ended.get("lost")) is not None:
            because = f"the attempt was lost: {lost}"
            outcome = self._builder.outcome(ended_because=because, interrupted=self._is_interrupted)
            return replace(outcome, is_lost=not self._is_interrupted)
        outcome = self._builder.outcome(ended_because=ended["because"], interrupted=ended["is_interrupted"])
        return replace(outcome, seconds=ended["seconds"])

    def close(self) -> None:
        """Let go of it; a run that is still being executed is ended first."""
        if self._ended is None:
            self._ask("kill", "")
            until = time.monotonic() + self._places.longest_end
            while not self.advance() and time.monotonic() < until:
                time.sleep(0.01)
        self._places.over(self._token)
        self._place.is_busy = False

    def take(self, records: Sequence[Sequence[Any]]) -> None:
        """Take records of the run."""
        for kind, fields in records:
            self._builder.take(kind, fields)
            self._watch.report(kind, fields)

    def end(self, ended: dict[str, Any]) -> None:
        """Take how it ended."""
        for name in ended.get("skipped", ()):
            problem = f"{name!r} is no regular file, and stayed on the worker, where it was removed"
            self.take([["finding", {"owner": "cluster", "problem": problem, "fix": "Write files, and no links."}]])
        self._ended = ended

    def lose(self, because: str, until: float) -> None:
        """Take for lost what nobody tells of any more, at a moment at which it has ended in any case."""
        self._lost = because, until

    def _ask(self, kind: str, because: str) -> None:
        request = {"token": self._token, "because": because, "is_interruption": self._is_interrupted}
        self._places.ask(kind, request)
