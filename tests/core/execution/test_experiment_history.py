"""What an experiment does is read from its journal, record by record."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

from robot_runner.core.execution.experiment_history import ExperimentHistory
from robot_runner.core.storage.journal import seconds_of

if TYPE_CHECKING:
    import pytest


def ended(run: str) -> dict[str, Any]:
    at = "2026-01-31T12:00:01.000Z"
    return {"kind": "attempt_finished", "at": at, "run": run, "status": "done", "failure": None, "measures": {}}


def test_a_person_is_waited_for_however_many_runs_end_elsewhere_meanwhile() -> None:
    history = ExperimentHistory()
    history.take({"kind": "waiting", "next_run": "r_2", "step": "lay the floor", "questions": ()})
    history.take(ended("r_1"))
    asked = {"next_run": "r_2", "place": "", "step": "lay the floor", "is_after": False, "questions": ()}
    assert history.waiting_for == asked
    history.take(ended("r_2"))
    assert history.waiting_for is None


def test_who_waits_for_a_person_goes_on_waiting_whatever_goes_on_elsewhere() -> None:
    history = ExperimentHistory()
    asked = [{"kind": "asked", "run": run, "step": "the lift is empty"} for run in ("r_1", "r_2")]
    for record in (*asked, {"kind": "paused", "next_run": "r_3"}):
        history.take(record)
    assert history.is_paused
    history.take({"kind": "continued", "after": "pause", "seconds": 1.0})
    waits = []
    for record in ({**asked[0], "kind": "answered"}, {"kind": "waiting", "next_run": "r_3", "step": ""}, ended("r_2")):
        assert history.waiting_for is not None
        waits.append(history.waiting_for["next_run"])
        history.take(record)
    assert waits == ["r_1", "r_2", "r_2"]
    assert history.waiting_for == {"next_run": "r_3", "place": "", "step": "", "is_after": False, "questions": ()}
    history.take({"kind": "paused", "next_run": "r_4"})
    history.take({"kind": "continued"})
    assert (history.waiting_for, history.is_paused) == (None, True)


def test_a_robot_that_was_set_aside_is_told_until_the_next_session_in_which_it_takes_part_again() -> None:
    history = ExperimentHistory()
    history.take({"kind": "experiment_started", "at": "2026-01-31T12:00:00.000Z"})
    history.take({"kind": "set_aside", "place": "bob", "problem": "3 runs in a row failed on it"})
    assert [str(each) for each in history.findings] == ["robot bob: 3 runs in a row failed on it"]
    history.take({"kind": "experiment_started", "at": "2026-01-31T13:00:00.000Z"})
    assert history.findings == []


def test_what_ended_a_session_is_told_until_the_next_one() -> None:
    history = ExperimentHistory()
    failed = {"kind": "failure", "owner": "config", "problem": "OSError: the arm is not parked"}
    history.take({**failed, "event": "after_experiment"})
    history.take({**failed, "event": "continue", "run": "r_1", "attempt": 1})
    history.take({**failed, "event": "launch_mission", "run": "r_1", "attempt": 1})  # is told with the run
    told = [f"{event} of config: OSError: the arm is not parked" for event in ("after_experiment", "continue")]
    assert [str(each) for each in history.findings] == told
    history.take({"kind": "experiment_started", "at": "2026-01-31T12:00:00.000Z"})
    assert history.findings == []


def test_a_session_took_as_long_however_the_clock_was_set_meanwhile() -> None:
    history = ExperimentHistory()
    history.take({"kind": "experiment_started", "at": "2026-01-31T12:00:00.000Z"})
    history.take({"kind": "clock_set", "at": "2026-01-31T11:00:02.000Z", "seconds": -3600.0})
    history.take({"kind": "experiment_finished", "at": "2026-01-31T11:00:05.000Z"})
    assert [session.seconds for session in history.sessions] == [5.0]


def test_a_value_that_is_corrected_by_hand_after_a_killed_session_is_no_part_of_it() -> None:
    history = ExperimentHistory()
    history.take({"kind": "experiment_started", "at": "2026-01-31T12:00:00.000Z"})
    history.take({**ended("r_1"), "left": {"run": 90.0, "others": 0.0, "is_least": False}})
    history.take({**ended("r_1"), "at": "2026-02-07T09:00:00.000Z", "is_amended": True})
    assert [session.seconds for session in history.sessions] == [1.0]
    assert history.left is not None


def test_the_time_left_is_that_of_the_last_record_however_the_clock_was_set_since(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    history = ExperimentHistory()
    left = {"run": 90.0, "others": 0.0, "is_least": False}
    attempt = {"run": "r_1", "attempt": 1, "place": "", "left": left}
    history.take({"kind": "attempt_started", "at": "2026-01-31T12:00:00.000Z", **attempt})
    history.take({"kind": "clock_set", "at": "2026-01-31T13:00:01.000Z", "seconds": 3600.0})
    monkeypatch.setattr(time, "time", lambda: seconds_of("2026-01-31T13:00:30.000Z"))
    assert history.left is not None
    assert history.left.after(history.since_left) == 60.0


def test_each_gate_that_is_awaited_is_known_until_it_opens() -> None:
    gate = {"kind": "gate", "condition": "it is cool", "seen": "52", "seconds": 1.0, "at": "2026-01-31T12:00:01.000Z"}
    history = ExperimentHistory()
    for run, state in (("r_1", "waiting"), ("r_2", "waiting"), ("r_1", "open")):
        history.take({**gate, "run": run, "state": state})
    assert list(history.gates) == ["r_2"]


def test_a_finding_of_no_run_is_told_by_its_owner() -> None:
    history = ExperimentHistory()
    history.take({"kind": "finding", "owner": "clocks", "problem": "it was set", "fix": ""})
    history.take({"kind": "finding", "run": None, "owner": "clocks", "problem": "it was set again", "fix": ""})
    assert [each.where for each in history.findings] == ["clocks", "clocks"]
