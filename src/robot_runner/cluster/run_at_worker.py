"""A thread of a worker of a cluster as a place, and a run that it executes, on the orchestrator's side."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any, Protocol

from robot_runner.core.config.experiment import Experiment
from robot_runner.core.execution.clock_jumps import CLOCKS, ClockJumps
from robot_runner.core.execution.places import Watch
from robot_runner.core.execution.task import OutcomeBuilder, RunOutcome, RunTask
from robot_runner.core.execution.worker import described_task
from robot_runner.core.links.connect import is_simulated
from robot_runner.core.plugin import THIS_MACHINE
from robot_runner.core.storage.journal import seconds_of
from robot_runner.core.words import shown_duration

#: What is said of a run that is lost, and of which its worker has not told that it was stopped.
_NOT_KNOWN = "whether its robot stands still is not known: the worker has fallen silent, and only that could have told"
#: What is to be done about it.
LOOK_AT_ROBOT = (
    "Check where it stands: the worker's processes stop it, unless their machine has failed. A watchdog on the robot "
    "stops it in any case."
)


def may_be_left_moving(experiment: Experiment) -> bool:
    """Return whether a run's robot goes on where the worker's machine fails: it is a real one."""
    robot = experiment.parameters.robot
    return robot is not None and not is_simulated(robot)


#: By how much a worker's clock may differ from ours, s; runs of different workers are hardly told apart by less.
_CLOCKS_DIFFER = 1.0


class Orders(Protocol):
    """What all runs and places share: the process that speaks to the cluster, and who takes its replies."""

    @property
    def descriptors(self) -> Collection[int]:
        """Where it tells something."""

    @property
    def longest_end(self) -> float:
        """How long the end of a run may take that is to be ended, s."""

    def ask(self, kind: str, fields: Mapping[str, Any]) -> None:
        """Send it a request."""

    def begun(self, token: str, run: RunAtWorker) -> None:
        """Take down that a run is in flight."""

    def over(self, token: str) -> None:
        """Take down that it no longer is."""

    def take_replies(self) -> None:
        """Take what it tells."""

    def miss(self, claims: Collection[str]) -> None:
        """Take down that a worker does not offer all that a run claims."""


def resource_of(claim: str) -> str:
    """Return the resource of Dask's that stands for a claim: `--resources` can have no space, comma or second `=`.

    Example:
        >>> resource_of("robot:alice"), resource_of("robot:dds:domain=7")
        ('robot:alice', 'robot:dds:domain_7')
    """
    return re.sub(r"[\s,=]", "_", claim)


class ClusterPlace:
    """One thread of a worker: it executes one run at a time.

    Attributes:
        worker: what is known of it: `address`, `name`, `worker` (its id), `host` and `machine`, and the names of its
            `resources`.
        slot: 0: a run there has no files here while it is executed.
    """

    slot = 0

    def __init__(self, places: Orders, experiment: Experiment, worker: Mapping[str, Any], thread: int) -> None:
        self.experiment = experiment
        self.worker = worker
        self.is_unavailable = False
        self.is_busy = False
        self.name = worker["name"] if worker["threads"] == 1 else f"{worker['name']}/{thread}"
        self._places = places
        self._claims: tuple[str, ...] = ()
        self._is_machine_told = False

    def claimed(self, claims: Collection[str], combination: Mapping[str, object]) -> frozenset[str] | None:
        """Return what a run would hold here; None where this worker does not offer it as a resource of Dask's.

        The worker itself is offered by every worker.
        """
        del combination
        offered = self.worker["resources"]
        needed = [claim for claim in claims if claim != THIS_MACHINE]
        if not set(map(resource_of, needed)) <= {*offered}:
            self._places.miss(needed)
            return None
        self._claims = tuple(map(resource_of, claims))  # the last one asked for before `begin` is the run's
        return frozenset(f"host:{self.worker['host']}" if claim == THIS_MACHINE else claim for claim in claims)

    def begin(self, task: RunTask, builder: OutcomeBuilder, watch: Watch) -> RunAtWorker:
        """Order one attempt at a run from the worker."""
        run = RunAtWorker(self, self._places, builder, watch)
        self.is_busy = True
        if not self._is_machine_told:  # before its first run, and not before each: there may be a million of them
            self._is_machine_told = True
            watch.report("machine", {"place": self.name, "host": self.worker["machine"]})
        run.order(task, self._claims)
        return run


class RunAtWorker:
    """One attempt at a run that a worker executes."""

    def __init__(self, place: ClusterPlace, places: Orders, builder: OutcomeBuilder, watch: Watch) -> None:
        self._place = place
        self._places = places
        self._builder = builder
        self._watch = watch
        self._token = os.urandom(8).hex()
        self._ended: dict[str, Any] | None = None
        self._lost: tuple[str, float] | None = None
        self._began, self._jumps = time.time(), ClockJumps()
        self._is_clock_told = False
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
        if self._ended is None and self._lost is not None and time.monotonic() >= self._lost[1]:
            self.end({"lost": self._lost[0]})
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
            if kind == "event" and not self._is_clock_told:
                self._look_at_clock(seconds_of(fields["at"]))

    def _look_at_clock(self, stamp: float) -> None:
        """Tell that the worker's clock differs, where it stamps an event before the attempt, or later than now."""
        now = time.time()
        fits = self._began - _CLOCKS_DIFFER <= stamp <= now + _CLOCKS_DIFFER
        if fits or self._jumps.was_set:  # which is told by itself
            return
        self._is_clock_told = True
        differs = f"{shown_duration(stamp - now)} ahead of" if stamp > now else f"{shown_duration(now - stamp)} behind"
        problem = (
            f"the clock of worker {self._place.worker['name']} is {differs} this machine's: stamps of its runs and of "
            "others do not fit together"
        )
        fix = "Let a time server set the clocks of all workers (chrony, systemd-timesyncd)."
        self.take([["finding", {"owner": CLOCKS, "problem": problem, "fix": fix}]])

    def end(self, ended: dict[str, Any]) -> None:
        """Take how it ended."""
        if "lost" in ended and not ended.get("is_certain") and may_be_left_moving(self._place.experiment):
            self.take([["finding", {"owner": "cluster", "problem": _NOT_KNOWN, "fix": LOOK_AT_ROBOT}]])
        self._ended = ended

    def lose(self, because: str, until: float) -> None:
        """Take for lost what nobody tells of any more, at a moment at which it has ended in any case."""
        self._lost = because, until

    def _ask(self, kind: str, because: str) -> None:
        request = {"token": self._token, "because": because, "is_interruption": self._is_interrupted}
        self._places.ask(kind, request)
