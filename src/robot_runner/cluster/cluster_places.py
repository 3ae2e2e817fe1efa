"""The workers of a Dask cluster as places, on the orchestrator's side.

Dask's client has threads, which the orchestrator must not have: a process beside it speaks to the cluster
(`gateway.py`).
"""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Collection, Mapping, Sequence
from typing import Any

from robot_runner.cluster.cluster_checks import cluster_settings
from robot_runner.cluster.experiment_snapshot import snapshot_of
from robot_runner.cluster.piped_process import PipedProcess
from robot_runner.cluster.run_at_worker import LOOK_AT_ROBOT, ClusterPlace, RunAtWorker, may_be_left_moving, resource_of
from robot_runner.core.config.experiment import Experiment
from robot_runner.core.errors import ExecutionError, Finding
from robot_runner.core.execution.left_processes import MARK_OF_ELSEWHERE, RunsElsewhere, forget_runs_elsewhere
from robot_runner.core.execution.run_events import has_standby
from robot_runner.core.execution.standby_lock import LONGEST
from robot_runner.core.storage import guarded_files
from robot_runner.core.words import listed

#: How long after the grace a run may take to be killed with all that it has started (`keeper.py`), s.
_KILLING = 2.0
#: Until the gateway tells what is set: its defaults, s.
_LEASE, _PATIENCE = 30.0, 300.0
_NOT_OFFERED = "no worker offers it as a resource, and a run needs it for itself"
_NOT_TOGETHER = "no worker offers them together as resources, and a run needs them for itself"
#: How long the gateway may take to say goodbye to the workers, s.
_GOODBYE = 20.0
_NO_WORKER = "no worker is there"
#: How long no other worker is to have come until it is said that there is none, or none that offers a claim, s.
_JOINING = 10.0
#: How many reasons the error has why there is no worker.
_MOST_KNOWN = 8


class ClusterPlaces:
    """All places of an experiment that the workers of a cluster are: one for each thread of a worker.

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
        self._asides: dict[tuple[str, str], str] = {}
        self._lease, self._patience = _LEASE, _PATIENCE
        self._closing = _closing_of(experiment)
        self._began = time.monotonic()
        self._alone_since: float | None = self._began
        self._is_connected = False
        self._joining: set[str] = set()
        self._lacking: set[tuple[str, ...]] = set()  # the claims of a run, where no worker offers all of them
        self._changed = self._began
        self._idle_since: float | None = None
        self._is_gone = False
        self._end_of_gateway = "the process that speaks to the cluster has ended"
        # By which workers find out whether they see the folder, too; so do their answers.
        self._probe = experiment.folder.root / f"{MARK_OF_ELSEWHERE}{self._session}"
        self._was_killed = any(experiment.folder.root.glob(f"{MARK_OF_ELSEWHERE}*"))  # who would have taken it down
        facts = self._facts()
        self._gateway = PipedProcess("robot_runner.cluster.gateway")
        self.ask("facts", facts)

    @property
    def all(self) -> Sequence[ClusterPlace]:
        """Those of all workers that have joined, with those that are aside; none while runs of before may go on."""
        return self._places if time.monotonic() >= self._free_at else ()

    @property
    def descriptors(self) -> Collection[int]:
        """Where the gateway tells something."""
        return () if self._is_gone else (self._gateway.descriptor,)

    @property
    def due(self) -> float | None:
        """When runs of before have ended in any case, or something is to be told of workers that are lacking."""
        if self._said or (self._is_gone and not self._runs):
            return 0.0
        if time.monotonic() < self._free_at:
            return self._free_at
        untold = self._changed + _JOINING if self._is_lack_untold else None
        ends = (self._patience_end, self._lack_end, self._told_alone_at, untold)
        return min((each for each in ends if each is not None), default=None)

    def advance(self, *, is_idle: bool = False) -> Sequence[str]:
        """Take note of workers that have joined, were refused, or are gone.

        Raises:
            ExecutionError: there has been none for too long, or none that offers what is claimed; or the gateway has
                died.
        """
        self.take_replies()
        now = time.monotonic()
        self._idle_since = (self._idle_since or now) if is_idle else None
        if self._is_lack_untold and now >= self._changed + _JOINING:
            for claims in sorted(self._lacking):
                has = "has it" if len(claims) == 1 else "has all of them"
                self._say(*_lack_of(claims), f"Start one that {has}: {self._started_with(claims)}")
        if self._told_alone_at is not None and now >= self._told_alone_at:
            fix = f"Start some: dask worker {self._address} --nthreads 1. They are awaited for {self._patience:g} s."
            self._say(f"cluster {self._address}", _NO_WORKER, fix)
        said, self._said = self._said, []
        if self._lack_end is not None and now >= self._lack_end:
            groups = sorted(self._lacking)
            commands = " and ".join(f"`{self._started_with(each)}`" for each in groups)
            fix = f"Start {commands}, and start the experiment again: it resumes."
            claimed = listed([" with ".join(each) for each in groups])
            raise self._refusal(f"no worker that offers {claimed} has been there for {self._patience:g} s", fix)
        if self._is_gone and not self._runs:
            raise self._refusal(self._end_of_gateway, "Start the experiment again: it resumes.")
        if self._patience_end is not None and time.monotonic() >= self._patience_end:
            fix = "Start workers with `dask worker`, and start the experiment again: it resumes."
            raise self._refusal(f"no worker has been there for {self._patience:g} s", fix)
        return said

    def close(self) -> None:
        """Have the workers forget the experiment, and end the gateway."""
        self.ask("end", {})
        self._gateway.let_go()
        self._gateway.wait(_GOODBYE)
        self._gateway.close()
        if time.monotonic() >= self._free_at:  # else the next one has to wait as well
            forget_runs_elsewhere(self._experiment.folder)

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
        """Take down that a worker does not offer all that a run claims; where no other one does, it is told in time."""
        needed = set(map(resource_of, claims))
        if not any(needed <= {*each.worker["resources"]} for each in self._places if not each.is_unavailable):
            self._lacking.add(tuple(sorted(claims)))

    def _started_with(self, claims: Collection[str]) -> str:
        resources = ",".join(f"{resource_of(each)}=1" for each in claims)
        return f"dask worker {self._address} --nthreads 1 --resources {resources}"

    @property
    def _is_lack_untold(self) -> bool:
        """Whether no worker offers what a run claims, and none is about to join, and that is to be told yet."""
        return not (self._joining or set(map(_lack_of, self._lacking)) <= self._asides.keys())

    @property
    def _lack_end(self) -> float | None:
        """When a worker has been lacking for too long that offers what is claimed, while nothing else could be done."""
        if self._idle_since is None or self._joining or not self._lacking:
            return None
        return max(self._idle_since, self._changed, self._free_at) + self._patience

    @property
    def longest_end(self) -> float:
        """How long the end of a run may take that is to be ended, s."""
        return self._lease + self._closing

    @property
    def _free_at(self) -> float:
        """The moment at which no run is executed any more that was begun by an orchestrator which was killed.

        Nobody knows of the workers that it had, nor when it was killed; but nobody has renewed a lease since.
        """
        return self._began + self.longest_end if self._was_killed else self._began

    @property
    def _patience_end(self) -> float | None:
        """When no worker has been there for too long; None as long as one is, or loads the experiment."""
        if self._alone_since is None or self._joining:
            return None
        return max(self._alone_since, self._free_at) + self._patience

    def take_replies(self) -> None:
        """Take what the gateway tells, for all runs: they share one pipe."""
        if self._is_gone:
            return
        replies, is_open = self._gateway.replies()
        for kind, fields in replies:
            if "token" in fields:
                self._take_of_run(kind, fields)
            else:
                self._take(kind, fields)
        if not is_open:
            self._is_gone = True
            self._end_of_gateway += f" with code {self._gateway.wait(_GOODBYE)}"
            for place in self._places:
                place.is_unavailable = True
            # It cannot renew leases any more, so the runs of all workers end.
            until = time.monotonic() + self.longest_end
            for run in self._runs.values():
                run.lose(self._end_of_gateway, until)

    def _take_of_run(self, kind: str, fields: dict[str, Any]) -> None:
        run = self._runs.get(fields["token"])
        if run is not None and kind == "records":
            run.take(fields["records"])
        elif run is not None:
            run.end(fields)

    def _take(self, kind: str, fields: dict[str, Any]) -> None:
        match kind:
            case "settings":
                self._set(**fields)
            case "connected":
                self._is_connected, self._changed = True, time.monotonic()
            case "unconnected":
                self._is_connected = False
                self._say(f"cluster {self._address}", fields["because"], fields["fix"])
            case "joining":
                self._joining.add(fields["address"])
            case "joined":
                self._add(fields)
            case "refused":
                self._joining.discard(fields["address"])
                for each in fields["findings"]:
                    self._say(each["where"], each["problem"], each["fix"])
            case "gone" | "aside":
                self._set_aside(kind, fields)

    @property
    def _told_alone_at(self) -> float | None:
        """When it is to be told that the scheduler has no worker; None where it has one, or it was told."""
        is_told = (f"cluster {self._address}", _NO_WORKER) in self._asides
        if self._patience_end is None or not self._is_connected or is_told:
            return None
        return max(self._changed, self._free_at) + _JOINING

    def _set(self, lease: float, patience: float) -> None:
        self._lease, self._patience = lease, patience
        self._alone_since = time.monotonic()  # only now is there somebody who looks for workers
        if self._was_killed:
            waits = f"its runs may go on for {self.longest_end:g} s, and none is begun before that"
            fix = LOOK_AT_ROBOT if may_be_left_moving(self._experiment) else ""
            self._say(f"cluster {self._address}", f"an earlier execution was killed; {waits}", fix)

    def _add(self, worker: dict[str, Any]) -> None:
        self._places = [place for place in self._places if not place.is_unavailable or place.is_busy]
        slots = range(1, worker["threads"] + 1)
        self._places += [ClusterPlace(self, self._experiment, worker, slot) for slot in slots]
        self._joining.discard(worker["address"])
        self._alone_since = None
        self._asides.pop((f"cluster {self._address}", _NO_WORKER), None)  # it is told again once all have left
        self._changed = time.monotonic()
        self._lacking.clear()  # it is tried with this one

    def _set_aside(self, kind: str, fields: dict[str, Any]) -> None:
        for place in self._places:
            if place.worker["worker"] == fields["worker"] and not place.is_unavailable:
                place.is_unavailable = True
                fix = "" if kind == "gone" else "Correct this there, and start the worker again."
                self._say(f"worker {place.worker['name']}", f"executes no more runs: {fields['because']}", fix)
                self._changed = time.monotonic()
        if all(place.is_unavailable for place in self._places) and self._alone_since is None:
            self._alone_since = time.monotonic()

    def _say(self, where: str, problem: str, fix: str = "") -> None:
        if (where, problem) not in self._asides:  # a scheduler that is out of reach is looked for again and again
            self._asides[where, problem] = fix
            self._said.append(str(Finding.warning(where, problem, fix)))

    def _refusal(self, problem: str, fix: str) -> ExecutionError:
        alike: dict[tuple[str, str], list[str]] = {}
        for (where, each), mend in self._asides.items():
            if each not in {_NO_WORKER, _NOT_OFFERED, _NOT_TOGETHER}:  # if that is why, it is the problem
                alike.setdefault((each, mend), []).append(where)
        latest = list(alike.items())[-_MOST_KNOWN:]
        known = "; ".join(str(Finding.warning(listed(wheres), *each)) for each, wheres in latest)
        return ExecutionError(f"{problem}{f' ({known})' if known else ''}", where=f"cluster {self._address}", fix=fix)

    def _facts(self) -> dict[str, Any]:
        experiment = self._experiment
        snapshot = snapshot_of(experiment)  # or a refusal, before anything is left in the folder
        longest = cluster_settings()["lease"] + self._closing
        content = RunsElsewhere(f"cluster {self._address}", longest).content()
        guarded_files.replace(self._probe, content, experiment.folder.root)
        # Only now: there is one at each moment, in case this is killed as well.
        forget_runs_elsewhere(experiment.folder, but=self._probe)
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
    # Until its standby has ended, another run at a worker would command the same robot.
    return experiment.parameters.grace_in_s + _KILLING + (LONGEST if has_standby(experiment) else 0.0)


def _lack_of(claims: Sequence[str]) -> tuple[str, str]:
    """Return place and problem of claims of a run that no worker offers."""
    if len(claims) == 1:
        return f"claim {claims[0]}", _NOT_OFFERED
    return f"claims {listed(claims)}", _NOT_TOGETHER
