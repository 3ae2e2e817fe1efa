"""The process that executes runs on a worker, without a cluster and without a run."""

from __future__ import annotations

import os
import select
import time
from typing import TYPE_CHECKING, Any

import pytest

pytest.importorskip("distributed")

from robot_runner.cluster import run_host
from robot_runner.core.config.preparation import prepare_or_refuse
from robot_runner.core.execution.run_records import RecordReader, RecordWriter
from robot_runner.core.execution.task import OutcomeBuilder, RunOutcome, RunTask
from robot_runner.core.execution.worker import described_task

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from robot_runner.core.config.experiment import Experiment

LEASE = 3600.0
#: As long as nothing ends a poll, s: whoever waits for longer goes on with a run of which nobody knows any more.
SOON = 2.0


class DrivingRun:
    """A run that says nothing: `drive` happens each time that somebody looks at it, and it ends once it is stopped."""

    descriptors = ()
    due = None

    def __init__(self, builder: OutcomeBuilder, drive: Callable[[], object], ends: Callable[[], object]) -> None:
        self._builder, self._drive, self._ends = builder, drive, ends
        self._stopped_because = ""
        self._looks = 0

    def advance(self) -> bool:
        self._drive()
        self._looks += 1
        return bool(self._stopped_because) or self._looks > 1

    def stop(self, because: str, *, is_interruption: bool = False) -> None:
        del is_interruption
        self._stopped_because = because

    def outcome(self) -> RunOutcome:
        return self._builder.outcome(ended_because=self._stopped_because)

    def close(self) -> None:
        self._ends()


class Polls:
    """Stands in for a poll at which nothing arrives: it takes no time, and keeps for how long it was to wait, ms."""

    def __init__(self) -> None:
        self.timeouts: list[float | None] = []

    def register(self, descriptor: int, events: int) -> None:
        """Take a descriptor."""

    def poll(self, timeout: float | None) -> list[tuple[int, int]]:
        self.timeouts.append(timeout)
        return []


def test_a_run_ends_as_soon_as_its_worker_wakes_up_after_its_lease(
    write_config: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The steady clock stood still meanwhile: by it most of the lease is left, while others execute the run again."""
    real, slept, polls = time.clock_gettime, [0.0], Polls()
    monkeypatch.setattr(time, "clock_gettime", lambda clock: real(clock) + slept[0] * (clock == time.CLOCK_BOOTTIME))
    monkeypatch.setattr(select, "poll", lambda: polls)
    monkeypatch.setattr(run_host, "_lack_of_room", lambda _: "")
    (requests, requested), (told, tells) = os.pipe(), os.pipe()

    def begun(_experiment: Experiment, _task: RunTask, builder: OutcomeBuilder, _watch: object) -> DrivingRun:
        return DrivingRun(builder, lambda: slept.append(slept.pop() + LEASE), lambda: os.close(requested))

    monkeypatch.setattr(run_host, "begin_run", begun)
    experiment = prepare_or_refuse(write_config(), {})
    task = described_task(experiment, RunTask("r_1", 1, 1, 1, {"Task": "Video"}, 1, 1, 1))
    order = {"token": "89ab", "until": time.clock_gettime(time.CLOCK_BOOTTIME) + LEASE, "task": task}
    RecordWriter(requested)("execute", order)
    run_host._Host(experiment, tmp_path, None, requests, RecordWriter(tells, waits=True)).serve()
    replies: list[Any] = RecordReader(told).read()[0]
    for each in (requests, told, tells):
        os.close(each)
    assert ("ended", {"lost": run_host.GONE, "is_certain": True}) in replies
    assert all(each is not None and each < SOON * 1000 for each in polls.timeouts[1:2]), "a poll counts no suspension"
