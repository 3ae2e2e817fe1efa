from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from robot_runner.cli.screens.progress import Progress
from robot_runner.core.events.measure import Origin, PublishedMeasure
from robot_runner.core.execution.durations import TimeLeft
from robot_runner.core.execution.notices import AttemptFinished, OutcomeAmended, RunRecord, WaitingForUser
from robot_runner.core.execution.task import AttemptStatus, RunOutcome

if TYPE_CHECKING:
    from collections.abc import Callable


@pytest.fixture
def progress(clock: Callable[[], float], notices: Any) -> Progress:
    watched = Progress(clock)
    watched.take(notices.started())
    return watched


def test_runs_are_counted(progress: Progress, notices: Any) -> None:
    for notice in (notices.begun(1), notices.done(1), notices.begun(2), notices.failed(2)):
        progress.take(notice)
    assert (progress.run_count, progress.done, progress.failed) == (4, 1, 1)
    assert list(progress.run_ids) == ["r_1", "r_2"]
    assert progress.current is None


def test_runs_that_were_done_before_count(clock: Any, notices: Any) -> None:
    progress = Progress(clock)
    progress.take(notices.started(done_count=3))
    progress.take(notices.begun(4))
    progress.take(notices.done(4))
    assert progress.done == 4


def test_a_run_that_is_tried_again_counts_once(progress: Progress, notices: Any) -> None:
    for notice in (notices.begun(1), notices.failed(1, is_last=False), notices.begun(1, attempt=2), notices.done(1)):
        progress.take(notice)
    assert (progress.done, progress.failed, list(progress.run_ids)) == (1, 0, ["r_1"])


def test_an_interrupted_run_is_still_to_do(progress: Progress, notices: Any) -> None:
    progress.take(notices.begun(1))
    progress.take(notices.interrupted(1))
    assert (progress.done, progress.failed, list(progress.run_ids)) == (0, 0, [])


def test_the_time_left_is_unknown_where_the_orchestrator_does_not_know_it(progress: Progress, notices: Any) -> None:
    assert progress.seconds_left is None
    progress.take(notices.begun(1))
    assert progress.seconds_left is None
    assert progress.left_in_words == ""


def test_the_time_left_goes_by(progress: Progress, clock: Any, notices: Any) -> None:
    progress.take(notices.begun(3, left=TimeLeft(15.0, 15.0)))
    assert progress.seconds_left == pytest.approx(2 * 15.0)
    clock.now += 5
    assert progress.seconds_left == pytest.approx(2 * 15.0 - 5)
    clock.now += 1000  # a run that takes longer than the others does not make the rest shorter
    assert progress.seconds_left == pytest.approx(15.0)
    assert progress.left_in_words == "about 15 s left"
    progress.take(notices.done(3, left=TimeLeft(0.0, 12.0, is_least=True)))
    assert progress.left_in_words == "at least 12 s left"


def test_what_happens_in_a_run_is_known(progress: Progress, clock: Any, notices: Any) -> None:
    progress.take(notices.begun(1))
    assert progress.current is not None
    progress.take(RunRecord("r_1", "event", {"event": "launch_mission"}))
    shared = {"phase": "forward", "phase_number": 2, "phase_count": 12}
    progress.take(RunRecord("r_1", "shared", {"owner": "BasicTurtlebot3", "values": shared}))
    clock.now += 3
    assert (progress.current.event, progress.current.shared) == ("launch_mission", "forward (2 of 12)")
    assert progress.elapsed_in(progress.current) == 3
    progress.take(RunRecord("r_1", "event", {"event": "stop_measurement"}))
    assert progress.current.shared == "", "the phase is over with its event"
    progress.take(RunRecord("r_1", "failure", {"problem": "first"}))
    progress.take(RunRecord("r_1", "failure", {"problem": "second"}))
    assert progress.current.failure == "first"


@pytest.mark.parametrize(
    ("values", "said"),
    [({"phase": "sleep"}, "sleep"), ({"lamp": "on", "level": 2}, "lamp on, level 2"), ({}, ""), (None, "")],
)
def test_whatever_plugins_share_is_put_into_words(progress: Progress, notices: Any, values: Any, said: str) -> None:
    progress.take(notices.begun(1))
    progress.take(RunRecord("r_1", "shared", {"owner": "Lamp", "values": values}))
    assert progress.current is not None
    assert progress.current.shared == said


def test_records_between_two_runs_are_passed_over(progress: Progress) -> None:
    progress.take(RunRecord("r_1", "event", {"event": "continue"}))
    assert progress.current is None


def test_it_is_known_where_values_come_from(progress: Progress, notices: Any) -> None:
    for number, origin in ((1, Origin.SIMULATED), (2, Origin.SIMULATED), (3, Origin.MEASURED)):
        progress.take(notices.begun(number))
        progress.take(notices.done(number, origin=origin))
    progress.take(notices.begun(4))
    progress.take(notices.done(4, value=None, origin=Origin.ESTIMATED))
    assert {origin: list(names) for origin, names in progress.origins.items()} == {
        "simulated": ["Energy"],
        "measured": ["Energy"],
    }


def test_a_value_that_a_person_is_asked_for_is_missing_only_where_it_was_answered_so(
    progress: Progress, notices: Any
) -> None:
    progress.take(notices.started(columns={"Energy": "J", "Mood": ""}, asked_for=["Energy"]))
    progress.take(notices.done(1, value=None))
    progress.take(AttemptFinished(notices.task(2), RunOutcome(AttemptStatus.DONE, measures={}), is_last=True))
    assert progress.bad_values == {"Energy": {"missing": ["r_1"]}, "Mood": {"missing": ["r_1", "r_2"]}}


def test_a_value_that_comes_after_the_run_counts_with_its_quality_and_its_origin(
    progress: Progress, notices: Any
) -> None:
    progress.take(notices.started(columns={"Energy": "J"}))
    for number in (1, 2, 3):
        progress.take(notices.done(number, value=None))
    good, doubtful = notices.done(1, value=4.5), notices.done(2, value=4.5, doubts=("read from a sticker",))
    for after in (good, doubtful):
        progress.take(OutcomeAmended(after.task.run_id, after.outcome))
    assert progress.bad_values == {"Energy": {"doubtful": ["r_2"], "missing": ["r_3"]}}
    assert list(progress.origins) == ["measured"]


def test_what_a_person_entered_is_listed_in_the_order_of_the_table(progress: Progress, notices: Any) -> None:
    names = [f"item{number}" for number in range(1, 11)]
    progress.take(notices.started(columns={}, asked_for=names))
    entered = {name: PublishedMeasure(name, 3, "operator", origin=Origin.ENTERED) for name in names}
    progress.take(OutcomeAmended("r_1", RunOutcome(AttemptStatus.DONE, measures=entered)))
    assert list(progress.origins["entered by hand"]) == names


def test_waiting_ends_with_the_next_run(progress: Progress, notices: Any) -> None:
    progress.take(WaitingForUser(Path("x"), 2, 4))
    assert progress.is_waiting
    progress.take(notices.begun(2))
    assert not progress.is_waiting


def test_the_end_has_the_last_word(progress: Progress, notices: Any) -> None:
    progress.take(notices.finished(done_count=2, failed_count=1, todo_count=1))
    assert (progress.done, progress.failed) == (2, 1)
