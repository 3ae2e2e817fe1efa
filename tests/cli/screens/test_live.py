from __future__ import annotations

import sys
import threading
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pyte
import pytest
from rich.cells import cell_len

from robot_runner.cli.screens import plain
from robot_runner.cli.screens.live import LiveScreen
from robot_runner.core.config.operator_steps import Question
from robot_runner.core.errors import Finding
from robot_runner.core.execution.durations import TimeLeft
from robot_runner.core.execution.notices import (
    AnswersRefused,
    GatePassed,
    GateWaiting,
    HostRestarts,
    NextDecided,
    Paused,
    QuestionAsked,
    RunRecord,
    UserHasContinued,
    WaitingForUser,
)

if TYPE_CHECKING:
    from robot_runner.core.config.experiment import Experiment

COLUMNS = 100


class Shown:
    """A live screen on a terminal of its own, and what a person would see there."""

    def __init__(self, screenful: Any, experiment: Experiment, clock: Any) -> None:
        self._screenful = screenful(COLUMNS)
        self.screen = LiveScreen(self._screenful.console, experiment, clock)
        self.clock = clock

    @property
    def lines(self) -> list[str]:
        terminal = pyte.Screen(COLUMNS, 60)
        pyte.Stream(terminal).feed(self._screenful.text.replace("\n", "\r\n"))
        return "\n".join(line.rstrip() for line in terminal.display).rstrip().splitlines()

    def take(self, *notices: Any) -> None:
        for notice in notices:
            self.screen.notice(notice)
            self.clock.now += 1
            self.screen.refresh()


@pytest.fixture
def shown(experiment: Experiment, clock: Any, screenful: Any, monkeypatch: pytest.MonkeyPatch) -> Shown:
    monkeypatch.setattr(plain, "terminal_input", lambda: None)
    return Shown(screenful, experiment, clock)


def test_the_run_that_is_executed_is_shown_with_its_event_and_phase(shown: Shown, notices: Any) -> None:
    with shown.screen:
        shown.take(notices.started(), notices.begun(1), notices.done(1, seconds=10))
        shown.take(notices.begun(2, left=TimeLeft(2.0, 4.0)))
        shown.take(RunRecord("r_2", "event", {"event": "launch_mission"}))
        phase = {"phase": "forward", "phase_number": 2, "phase_count": 12}
        shown.take(RunRecord("r_2", "shared", {"owner": "BasicTurtlebot3", "values": phase}))
        text = "\n".join(shown.lines)
    assert "1 of 4 done   6.0 s, about 4.0 s left" in text
    assert "▶ r_2 (run 2 of 4): Task=Video, Repetition=1" in text
    assert "launch_mission: forward (2 of 12)   3.0 s" in text


def test_finished_runs_are_rows_beneath_their_headings(shown: Shown, notices: Any) -> None:
    with shown.screen:
        shown.take(notices.started(), notices.begun(1), notices.done(1), notices.begun(2), notices.failed(2))
    assert shown.lines == [
        "trial: 4 runs, seed 1, results in results/trial",
        "  run  Task     Repetition  Energy (J)         took",
        "  r_1  Video             1       877.1         10 s",
        "  r_2  Video             1  ✗ start_run of BasicTurtlebot3: no [bold]odometry[/bold]\\nat all",
    ]


def test_a_failure_is_red_and_seen_while_the_run_is_closed(shown: Shown, notices: Any) -> None:
    with shown.screen:
        shown.take(notices.started(), notices.begun(1), RunRecord("r_1", "failure", {"problem": "the lamp is broken"}))
        assert "✗ the lamp is broken; closing what is open" in "\n".join(shown.lines)
        shown.take(notices.failed(1, is_last=False))
    assert "✗ attempt 1, tried again: start_run of" in shown.lines[-1]


def test_the_live_part_is_gone_at_the_end_and_the_cursor_is_back(shown: Shown, notices: Any, screenful: Any) -> None:
    with shown.screen:
        shown.take(notices.started(), notices.begun(1))
        assert len(shown.lines) > 2
    assert len(shown.lines) == 2
    assert shown._screenful.text.rindex("\x1b[?25h") > shown._screenful.text.rindex("\x1b[?25l")


def test_no_thread_is_started(shown: Shown, notices: Any) -> None:
    before = threading.active_count()
    with shown.screen:
        shown.take(notices.started(), notices.begun(1))
        assert threading.active_count() == before


def test_what_callbacks_print_meanwhile_stands_above_the_live_part(shown: Shown, notices: Any) -> None:
    with shown.screen:
        shown.take(notices.started(), notices.begun(1))
        sys.stdout.write("put the robot into the [corridor]\n")
        shown.take(RunRecord("r_1", "event", {"event": "start_run"}))
        lines = shown.lines
        assert lines.index("put the robot into the [corridor]") == 2
        assert any("▶ r_1" in line for line in lines[3:])
    assert shown.lines[-1] == "put the robot into the [corridor]"


def test_the_live_part_gives_way_while_the_user_is_asked(shown: Shown, notices: Any) -> None:
    with shown.screen:
        shown.take(notices.started(), notices.begun(1), notices.done(1), WaitingForUser(Path.cwd() / "results", 2, 4))
        assert shown.lines[-1] == "Waiting before run 2 of 4. To go on: robot-runner continue results"
        shown.take(notices.begun(2))
        assert shown.lines[3] == "Waiting before run 2 of 4. To go on: robot-runner continue results"
        assert "▶ r_2" in shown.lines[-2]


def test_somebody_at_the_keyboard_is_asked_for_enter(shown: Shown, notices: Any) -> None:
    shown.screen.user_input = 0
    with shown.screen:
        shown.take(notices.started(), WaitingForUser(Path.cwd() / "results", 2, 4))
    assert "Press ENTER to start run 2 of 4, or in another terminal: robot-runner" in shown.lines[-1]


def test_questions_and_refused_answers_stand_where_the_live_part_was(shown: Shown, notices: Any) -> None:
    shown.screen.user_input = 0
    question = Question("voltage", float, unit="V")
    refused = AnswersRefused([Finding.error("voltage", "3 is below 9", "Measure again.")])
    with shown.screen:
        shown.take(notices.started(), WaitingForUser(Path.cwd() / "results", 2, 4, questions=[question]))
        assert "Answer when it is done, or in another terminal: robot-runner continue" in "\n".join(shown.lines)
        shown.take(QuestionAsked(question))
        assert shown.lines[-1].strip() == f"{question.asked}:"
        shown._screenful.stream.write("3\n")
        shown.take(refused)
        assert shown.lines[-1] == "  voltage: 3 is below 9. Measure again."
        shown.take(UserHasContinued(), notices.begun(2))
        assert "▶ r_2" in shown.lines[-2]


def test_a_pause_and_a_host_that_starts_anew_are_told(shown: Shown, notices: Any) -> None:
    with shown.screen:
        shown.take(notices.started(), HostRestarts("board", "r_2"))
        assert "Restarting board before r_2, and waiting until it is ready ..." in shown.lines
        shown.take(Paused(Path.cwd() / "results", 2, 4))
        assert "robot-runner continue results" in shown.lines[-1]


@pytest.mark.parametrize(("first", "second"), [("alice", "bob"), ("\u4e00\u53f7", "bob")], ids=["narrow", "wide"])
def test_what_happens_at_each_place_is_a_line(shown: Shown, notices: Any, first: str, second: str) -> None:
    begun = [notices.begun(number) for number in (1, 2)]
    with shown.screen:
        shown.take(notices.started())
        shown.take(
            *(
                replace(each, task=replace(each.task, place=place, slot=slot))
                for each, place, slot in zip(begun, (first, second), (1, 2), strict=True)
            )
        )
        shown.take(RunRecord("r_2", "event", {"event": "launch_mission"}))
        upper, lower = shown.lines[-2:]
    assert upper.startswith(f"  {first}  ▶ r_1: Task=Video")
    assert lower.startswith(f"  {second}{' ' * (cell_len(first) - cell_len(second))}  ▶ r_2: Task=Video")
    assert "launch_mission" in lower


def test_records_that_come_faster_than_anybody_reads_are_not_drawn(shown: Shown, notices: Any) -> None:
    with shown.screen:
        shown.take(notices.started(), notices.begun(1))
        drawn = len(shown._screenful.text)
        for _ in range(1000):
            shown.screen.notice(RunRecord("r_1", "event", {"event": "launch_mission"}))
            shown.screen.refresh()
        assert len(shown._screenful.text) < drawn + 2000


def test_of_runs_too_fast_to_be_read_only_failures_are_shown(shown: Shown, notices: Any) -> None:
    with shown.screen:
        shown.take(notices.started(run_count=500))
        shown.screen.notice(notices.done(499))  # the first of a burst is shown at once
        for number in range(100):
            shown.screen.notice(notices.failed(number) if number == 50 else notices.done(number))
    rows = [line.split()[0] for line in shown.lines[2:]]
    assert rows == ["r_499", "r_50", "…"]
    assert shown.lines[-1] == "  … 99 runs, too fast to be shown; run_table.csv has them …"


def test_runs_that_slow_down_are_shown_again_after_how_many_were_not(shown: Shown, notices: Any) -> None:
    with shown.screen:
        shown.take(notices.started(run_count=500), notices.begun(1), notices.done(1))
        for number in range(2, 30):
            shown.screen.notice(notices.done(number))
        shown.take(notices.begun(30))
        assert shown.lines[4].split()[0] == "r_29", "the last one is seen in the live part"
        shown.take(notices.done(30))
    rows = [line.split()[:3] for line in shown.lines[2:]]
    assert [row[0] for row in rows] == ["r_1", "r_2", "…", "r_30"]
    assert rows[2] == ["…", "27", "runs,"]


def test_a_terminal_that_is_gone_is_no_fault(shown: Shown, notices: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def gone(_: str) -> int:
        raise OSError(5, "Input/output error")

    with shown.screen:
        shown.take(notices.started(), notices.begun(1))
        monkeypatch.setattr(shown._screenful.stream, "write", gone)


def test_columns_that_do_not_fit_are_left_out_and_named(
    experiment: Experiment, clock: Any, screenful: Any, notices: Any
) -> None:
    narrow = screenful(40)
    with LiveScreen(narrow.console, experiment, clock) as screen:
        screen.notice(notices.started(columns={"Energy": "J", "CPU": "%", "Memory": "%"}))
    assert "  run  Task     Repetition  Energy (J)" in narrow.text
    heading, *_ = (line for line in narrow.text.splitlines() if "Repetition" in line)
    assert "CPU" not in heading
    assert "narrow for CPU (%), Memory (%) and" in narrow.text


def test_what_a_gate_waits_for_is_shown_until_it_opens(shown: Shown, notices: Any) -> None:
    with shown.screen:
        shown.take(notices.started(), GateWaiting("r_1", 1, 4, "the load is below 10 %", "38 %", 80.0, 600.0))
        assert "run 1 of 4 (r_1) waits until the load is below 10 %" in "\n".join(shown.lines)
        assert "38 %   1 min 20 s of 10 min 00 s" in "\n".join(shown.lines)
        shown.take(GatePassed("r_1", "the load is below 10 %", "9 %", 81.0, "open"))
        assert "waits until" not in "\n".join(shown.lines)
        shown.take(GatePassed("r_1", "the load is below 10 %", "", 81.0, "timed out", "it still did not hold"))
        assert "r_1 waited 1 min 21 s until the load is below 10 %, in vain" in "\n".join(shown.lines)
        assert shown.screen.progress.gate_seconds == 162.0


def test_each_place_that_waits_at_a_gate_is_shown(shown: Shown, notices: Any) -> None:
    waits = [GateWaiting(f"r_{run}", run, 4, f"robot {run} is cool", "38 °C", 80.0, 600.0) for run in (1, 2)]
    with shown.screen:
        shown.take(notices.started(), *waits)
        text = "\n".join(shown.lines)
        assert "(r_1) waits until robot 1 is cool   38 °C" in text
        assert "(r_2) waits until robot 2 is cool   38 °C" in text
        shown.take(GatePassed("r_1", "robot 1 is cool", "30 °C", 81.0, "open"))
        assert "(r_2) waits until robot 2 is cool" in "\n".join(shown.lines)
        assert "robot 1 is cool" not in shown.lines[-1]


def test_a_repetition_that_is_added_is_told_with_why_and_counted(shown: Shown, notices: Any) -> None:
    told = "after 5 repetitions, Energy: ± 3 % for Video, ± 2 % is wanted (0 of 1 mean precise): once more, 2 runs"
    with shown.screen:
        shown.take(notices.started(), notices.begun(1), notices.done(1, seconds=10))
        shown.take(NextDecided(told, 6, 2), notices.begun(2))
        text = "\n".join(shown.lines)
    assert "after 5 repetitions, Energy: ± 3 % for Video, ± 2 % is wanted (0 of 1 mean precise): once more, 2" in text
    assert "1 of 6 done" in text
