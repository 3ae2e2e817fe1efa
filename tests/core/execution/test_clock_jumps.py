from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import pytest

Execute = Callable[..., Any]

#: In its first run, what a clock tells changes by so many seconds during the mission, and that stays so.
JUMP = """
def launch_mission(self, context):
    import time
    real = time.clock_gettime
    if context.run_number == 1:
        time.clock_gettime = lambda clock: real(clock) + self.jumps.get(clock, 0.0)

def populate_run_data(self, context):
    return {"Energy": 7.5}
"""
SUSPENDED = """
import time
jumps = {time.CLOCK_BOOTTIME: 90.0, time.CLOCK_REALTIME: 90.0}
"""
SET = """
import time
jumps = {time.CLOCK_REALTIME: -3600.0}
"""


def told(executed: Any) -> list[tuple[str, str]]:
    return [(each.where, each.problem) for each in executed.finished.findings if "machine" in each.problem]


def doubts(executed: Any) -> dict[str, list[str]]:
    fields = json.loads((executed.folder / "run_table.schema.json").read_text(encoding="utf-8"))["fields"]
    found: dict[str, list[str]] = next(each for each in fields if each["name"] == "Energy").get(
        "robot_runner:doubts", {}
    )
    return found


def test_values_of_a_run_in_whose_mission_the_machine_was_suspended_are_doubtful(execute: Execute) -> None:
    executed = execute(SUSPENDED + JUMP)
    problem = "this machine was suspended for 90.0 s in the mission: window and samples lack that"
    assert told(executed) == [("r_1, clocks", problem)]
    assert doubts(executed) == {"r_1": [problem]}


def test_a_clock_that_was_set_during_a_run_is_told_and_makes_no_value_doubtful(execute: Execute) -> None:
    executed = execute(SET + JUMP)
    problem = "this machine's clock was set by -3,600.0 s: stamps before and after do not fit together"
    assert told(executed) == [("r_1, clocks", problem)]
    assert doubts(executed) == {}


@pytest.mark.long
def test_a_simulated_robot_s_values_are_as_good_where_the_machine_was_suspended(execute: Execute) -> None:
    executed = execute(SUSPENDED + JUMP, robot="simulated")
    assert told(executed) == []
    assert doubts(executed) == {}
