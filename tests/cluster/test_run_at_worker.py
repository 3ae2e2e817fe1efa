"""What the orchestrator makes of what the worker of a run tells."""

from __future__ import annotations

import time
from datetime import UTC, datetime, timedelta
from types import SimpleNamespace
from typing import Any

import pytest

from robot_runner.cluster.run_at_worker import RunAtWorker
from robot_runner.core.events.measure import MeasureColumns
from robot_runner.core.execution.interruption import Interruption
from robot_runner.core.execution.places import Watch
from robot_runner.core.execution.task import OutcomeBuilder


class _Told:
    """A run at the worker `two`, and the findings that it has."""

    def __init__(self) -> None:
        self.findings: list[dict[str, Any]] = []
        seat = SimpleNamespace(worker={"name": "two"}, experiment=None, is_busy=True)
        builder = OutcomeBuilder("r_1", MeasureColumns((), ()))
        self.run = RunAtWorker(seat, SimpleNamespace(), builder, Watch(Interruption(), self._report))

    def _report(self, kind: str, fields: dict[str, Any]) -> None:
        self.findings += [fields] if kind == "finding" else []

    def event(self, name: str, at: datetime) -> None:
        stamp = at.isoformat(timespec="milliseconds").replace("+00:00", "Z")
        self.run.take([["event", {"event": name, "at": stamp, "clock": 1.0}]])


@pytest.mark.parametrize(("hours", "which"), [(1, "ahead of"), (-1, "behind")])
def test_a_worker_whose_clock_differs_is_told_once_for_each_attempt(hours: int, which: str) -> None:
    told, now = _Told(), datetime.now(UTC) + timedelta(hours=hours)
    for second, event in enumerate(("start_run", "start_measurement")):
        told.event(event, now + timedelta(seconds=second))
    (finding,) = told.findings
    assert finding["owner"] == "clocks"
    assert f"the clock of worker two is 1 h 00 min {which} this machine's" in finding["problem"]
    assert finding["fix"]


def test_of_a_worker_whose_clock_fits_nothing_is_told() -> None:
    told = _Told()
    told.event("start_run", datetime.now(UTC))
    told.event("stop_run", datetime.now(UTC))
    assert told.findings == []


def test_where_the_clock_of_this_machine_was_set_meanwhile_nothing_is_told_of_the_worker(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    told, stamped, real, read = _Told(), datetime.now(UTC), time.time, time.clock_gettime
    monkeypatch.setattr(time, "time", lambda: real() - 3600.0)
    monkeypatch.setattr(time, "clock_gettime", lambda clock: read(clock) - 3600.0 * (clock == time.CLOCK_REALTIME))
    told.event("start_run", stamped)
    assert told.findings == []
