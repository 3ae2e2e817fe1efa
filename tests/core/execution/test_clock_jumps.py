from __future__ import annotations

import json
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from tests.core.execution.conftest import Executed

from robot_runner.core.config.preparation import prepare_or_refuse
from robot_runner.core.execution.clock_jumps import ClockJumps
from robot_runner.core.execution.experiment_status import read_status
from robot_runner.core.execution.notices import AttemptStarted, Notice, SilentObserver
from robot_runner.core.execution.orchestrator import execute_experiment

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


#: The clock is set in the orchestrator, before the second run.
SET_BEFORE = """
def before_run(self, context):
    import time
    if context.run_number == 2:
        real = time.clock_gettime
        time.clock_gettime = lambda clock: real(clock) + 3600.0 * (clock == time.CLOCK_REALTIME)

def populate_run_data(self, context):
    return {"Energy": 7.5}
"""


def clock_settings(executed: Any) -> list[tuple[str, float]]:
    """Return by how much the clock was set, with the attempt's record that follows."""
    lines = (executed.folder / "journal.jsonl").read_text(encoding="utf-8").splitlines()
    kept = [each for each in map(json.loads, lines) if each["kind"] in {"clock_set", "attempt_finished"}]
    return [(after["run"], each["seconds"]) for each, after in pairwise(kept) if each["kind"] == "clock_set"]


def test_the_journal_tells_by_how_much_a_clock_was_set_and_a_setting_is_told_once(
    execute: Execute, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(time, "clock_gettime", time.clock_gettime)  # which the config replaces
    executed = execute(SET_BEFORE)
    ((run, seconds),) = clock_settings(executed)
    assert run == "r_2"
    assert abs(seconds - 3600.0) < 1.0
    problem = "this machine's clock was set by +3,600.0 s: stamps before and after do not fit together"
    assert told(executed) == [("r_2, clocks", problem)]
    status = read_status(executed.folder)
    assert [each.problem for each in status.findings] == [problem]


#: The clock is set in the orchestrator, once no run follows.
SET_AFTER = """
def populate_run_data(self, context):
    return {"Energy": 7.5}

def after_experiment(self):
    import time
    real = time.clock_gettime
    time.clock_gettime = lambda clock: real(clock) + 3600.0 * (clock == time.CLOCK_REALTIME)
"""


def test_a_clock_that_is_set_after_the_last_run_is_in_the_journal_and_told(
    execute: Execute, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else an interrupted session, in which a person was awaited meanwhile, seems to have taken as long."""
    monkeypatch.setattr(time, "clock_gettime", time.clock_gettime)  # which the config replaces
    executed = execute(SET_AFTER)
    records = executed.journal("attempt_finished", "clock_set", "experiment_finished")
    assert [each["kind"] for each in records[-2:]] == ["clock_set", "experiment_finished"]
    assert records[-2]["seconds"] == pytest.approx(3600.0, abs=1.0)
    problem = "this machine's clock was set by +3,600.0 s: stamps before and after do not fit together"
    assert told(executed) == [("clocks", problem)]


def test_a_clock_that_is_set_in_a_run_is_in_the_journal_at_once_and_told_once_the_run_is_over(
    write_config: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else its time left, and for how long it goes on, are wrong for whoever looks meanwhile."""
    real, set_by = time.clock_gettime, [0.0]
    monkeypatch.setattr(time, "clock_gettime", lambda clock: real(clock) + set_by[0] * (clock == time.CLOCK_REALTIME))

    class Setting(SilentObserver):
        def notice(self, notice: Notice) -> None:
            if isinstance(notice, AttemptStarted) and notice.task.run_id == "r_1":
                set_by[0] = 3600.0

    config = write_config('def populate_run_data(self, context):\n    return {"Energy": 7.5}')
    finished = execute_experiment(prepare_or_refuse(config), Setting())
    executed = Executed(config, finished, [])
    kinds = [(each["kind"], each.get("event", "")) for each in executed.journal()]
    assert kinds.count(("clock_set", "")) == 1
    assert kinds.index(("clock_set", "")) < kinds.index(("event", "launch_mission"))
    assert [where for where, _ in told(executed)] == ["r_1, clocks"]


def test_a_clock_that_is_steered_by_itself_was_not_set_however_long_an_experiment_takes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # As that of macOS: the steady clock does not go with it.
    real, steered = time.clock_gettime, 0.0
    monkeypatch.setattr(time, "clock_gettime", lambda clock: real(clock) + steered * (clock == time.CLOCK_REALTIME))
    jumps = ClockJumps()
    for _ in range(20):
        steered += 0.02  # in a run
        assert jumps.taken_setting() == 0.0
    steered += 60.0
    assert jumps.taken_setting() == pytest.approx(60.0, abs=0.1)
    assert jumps.taken_setting() == 0.0


@pytest.mark.long
def test_a_simulated_robot_s_values_are_as_good_where_the_machine_was_suspended(execute: Execute) -> None:
    executed = execute(SUSPENDED + JUMP, robot="simulated")
    assert told(executed) == []
    assert doubts(executed) == {}
