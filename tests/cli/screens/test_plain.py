from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from robot_runner.cli.console import UserConsole
from robot_runner.cli.screens import plain
from robot_runner.cli.screens.plain import PlainScreen, opening
from robot_runner.core.errors import Finding
from robot_runner.core.execution.durations import TimeLeft
from robot_runner.core.execution.notices import GatePassed, GateWaiting, WaitingForUser

if TYPE_CHECKING:
    from robot_runner.core.config.experiment import Experiment


@pytest.fixture
def said(experiment: Experiment, clock: Any, screenful: Any, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return what shows notices on a plain screen, and answers with its lines."""
    monkeypatch.setattr(plain, "terminal_input", lambda: None)

    def say(*notices: Any) -> list[str]:
        shown = screenful()
        with PlainScreen(shown.console, experiment, clock) as screen:
            for notice in notices:
                screen.notice(notice)
                screen.refresh()
        assert "\x1b" not in shown.text
        return shown.text.splitlines()

    return say


def test_a_run_is_a_line_when_it_starts_and_a_line_when_it_ends(said: Any, notices: Any) -> None:
    assert said(notices.started(), notices.begun(2), notices.done(2)) == [
        "trial: 4 runs, seed 1, results in results/trial",
        "run 2 of 4 (r_2) starts: Task=Video, Repetition=1",
        "run 2 of 4 (r_2) is done after 10 s: Energy 877.1 J",
    ]


def test_a_missing_value_is_no_nought(said: Any, notices: Any) -> None:
    assert said(notices.started(), notices.done(1, value=None))[-1].endswith(": Energy \N{EN DASH} J")


def test_failures_name_event_and_owner_and_stay_in_their_line(said: Any, notices: Any) -> None:
    reason = "start_run of BasicTurtlebot3: no [bold]odometry[/bold]\\nat all"
    lines = said(notices.started(), notices.failed(1, is_last=False), notices.failed(1, attempt=2))
    assert lines[1:] == [
        f"run 1 of 4 (r_1) failed after 2.0 s: {reason}; it is tried again",
        f"run 1 of 4 (r_1, attempt 2) failed after 2.0 s: {reason}",
    ]


def test_no_full_stop_comes_before_that_a_run_is_tried_again(said: Any, notices: Any) -> None:
    failed = notices.failed(is_last=False)
    outcome = replace(failed.outcome, failure=replace(failed.outcome.failure, problem="no odometry → Start it."))
    lines = said(notices.started(), replace(failed, outcome=outcome))
    assert lines[1].endswith("no odometry → Start it; it is tried again")


def test_an_interrupted_run_is_still_to_do(said: Any, notices: Any) -> None:
    assert said(notices.started(), notices.interrupted(3))[-1] == (
        "run 3 of 4 (r_3) was interrupted after 1.0 s; it is still to do"
    )


def test_what_was_done_before_and_set_by_hand_is_told(said: Any, notices: Any) -> None:
    lines = said(notices.started(done_count=3, overrides={"robot": "simulated"}))
    assert lines == [
        "trial: 4 runs, 3 of them done before, seed 1, results in results/trial",
        "set by hand, and recorded as a deviation from the config: robot=simulated",
    ]


def test_warnings_are_seen_before_the_experiment_goes_on(said: Any, notices: Any) -> None:
    lines = said(notices.started(findings=(Finding.warning("c.py", "it matches nothing", "Remove it."),)))
    assert lines[1:] == ["warning: c.py: it matches nothing", "  fix: Remove it."]


def test_nobody_at_the_keyboard_is_told_of_the_other_way_to_go_on(said: Any) -> None:
    lines = said(WaitingForUser(Path.cwd() / "my results" / "trial", 2, 4))
    assert lines == ["Waiting before run 2 of 4. To go on: robot-runner continue 'my results/trial'"]


def test_which_run_a_step_comes_after_is_said(said: Any) -> None:
    lines = said(WaitingForUser(Path.cwd() / "trial", 2, 4, "r_2", {"Task": "Video"}, step="lift it", is_after=True))
    assert lines == [
        "This is about r_2, run 2 of 4: Task=Video, Repetition=1",
        "To do: lift it",
        "Waiting after run 2 of 4. To go on: robot-runner continue trial",
    ]


def test_how_long_it_takes_is_told_at_the_beginning_where_somebody_would_wait_for_it(notices: Any) -> None:
    assert opening(notices.started(left=TimeLeft(0.0, 5940.0, is_least=True)))[1] == "at least 1 h 39 min left"
    assert len(opening(notices.started(left=TimeLeft(0.0, 12.0)))) == 1
    assert len(opening(notices.started())) == 1


def at_gate(seconds: float, seen: str) -> GateWaiting:
    return GateWaiting("r_2", 2, 4, "the load is below 10 %", seen, seconds, 600.0)


def test_a_gate_is_told_of_once_a_minute_and_when_it_opens(said: Any) -> None:
    waiting = [at_gate(second / 2, f"{second} %\n") for second in range(250)]
    lines = said(*waiting, GatePassed("r_2", "the load is below 10 %", "9 %", 125.0, "open"))
    assert lines == [
        "run 2 of 4 (r_2) waits until the load is below 10 %",
        "  2 %\\n   1.0 s of 10 min 00 s",
        "  122 %\\n   1 min 01 s of 10 min 00 s",
        "  242 %\\n   2 min 01 s of 10 min 00 s",
        "r_2 waited 2 min 05 s until the load is below 10 %: 9 %",
    ]


def test_of_two_gates_that_are_awaited_at_once_each_is_told_by_itself(said: Any) -> None:
    other = GateWaiting("r_3", 3, 4, "the room is dark", "lit", 2.0, None)
    lines = said(
        at_gate(2.0, "12 %"), other, at_gate(3.0, "11 %"), GatePassed("r_3", "the room is dark", "", 3.0, "open")
    )
    assert [line.split(" wait")[0] for line in lines if "wait" in line] == [
        "run 2 of 4 (r_2)",
        "run 3 of 4 (r_3)",
        "r_3",
    ]


def test_a_gate_that_is_open_is_not_worth_a_line_and_one_that_stays_shut_is(said: Any) -> None:
    assert said(GatePassed("r_2", "the load is below 10 %", "9 %", 0.0, "open")) == []
    (line,) = said(GatePassed("r_2", "the load is below 10 %", "", 0.0, "failed", "the sensor\nis gone"))
    assert line.endswith("until the load is below 10 %, in vain: the sensor\\nis gone")


def test_a_gate_that_opens_within_a_second_is_not_told_of(said: Any) -> None:
    assert said(at_gate(0.0, "12 %"), GatePassed("r_2", "the load is below 10 %", "9 %", 0.05, "open")) == []


def test_where_nobody_reads_on_the_experiment_goes_on_without_a_word(
    experiment: Experiment, clock: Any, notices: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    let_go: list[bool] = []
    monkeypatch.setattr(plain, "let_go_of", lambda _stream: let_go.append(True))
    reader, writer = os.pipe()
    os.close(reader)
    closed = os.fdopen(writer, "w", encoding="utf-8")
    screen = PlainScreen(UserConsole(closed), experiment, clock)
    screen.notice(notices.started())
    assert (let_go, screen.progress.run_count) == ([True], 4)
    with pytest.raises(BrokenPipeError):
        closed.close()
