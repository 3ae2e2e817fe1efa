"""A run that is executed in a process of its own is supervised: its deadlines."""

from __future__ import annotations

import os
from contextlib import ExitStack
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from robot_runner.core.execution import local_places
from robot_runner.core.execution.interruption import Interruption
from robot_runner.core.execution.places import Watch
from robot_runner.core.execution.run_records import RecordWriter
from robot_runner.core.execution.task import OutcomeBuilder

if TYPE_CHECKING:
    import pytest


def test_the_start_of_a_run_s_process_does_not_count_for_the_deadline_of_the_run(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now, stops = 0.0, list[float]()
    monkeypatch.setattr(local_places, "time", SimpleNamespace(monotonic=lambda: now))
    parameters: Any = SimpleNamespace(run_deadline_in_s=10.0, event_deadline_in_s=None, grace_in_s=1.0)
    columns: Any = SimpleNamespace(declared=(), in_table=())
    records, writer = os.pipe()
    with os.fdopen(records, "rb"), os.fdopen(writer, "wb"):
        keeper: Any = SimpleNamespace(records=records, told=-1, look=lambda: False, stop=lambda: stops.append(now))
        builder, watch = OutcomeBuilder("r_1", columns), Watch(Interruption())
        run = local_places._Supervision(keeper, builder, parameters, watch, None, ExitStack())
        report = RecordWriter(writer)
        for moment, event in ((8.0, "start_run"), (11.0, "launch_mission"), (17.9, ""), (18.0, "")):
            now = moment
            if event:
                report("event", {"event": event, "at": "", "clock": 0.0})
            run.advance()
    assert stops == [18.0]
