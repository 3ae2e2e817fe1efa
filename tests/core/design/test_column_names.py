"""The names that the run table takes for itself."""

from __future__ import annotations

from robot_runner.core.design.columns import STAMP_COLUMNS
from robot_runner.core.events.manager import RobotRunnerEvents


def test_each_event_of_a_run_has_its_time_stamp_in_the_order_of_the_events() -> None:
    of_runs = [event for event in RobotRunnerEvents if event.belongs_to_run]
    assert [f"{event.value}_at" for event in of_runs] == list(STAMP_COLUMNS)
