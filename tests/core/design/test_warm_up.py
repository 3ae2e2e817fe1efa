"""Runs that only warm up: at the start, for each treatment of a factor, or for each combination."""

from __future__ import annotations

import pytest

from robot_runner.core.design.factor import Factor
from robot_runner.core.design.run_table_model import RunTableModel
from robot_runner.core.design.warm_up import WarmUp, warm_up_of, with_warm_ups_again
from robot_runner.core.errors import DesignError

TASK, SPEED = Factor("Task", ["Video", "Network"]), Factor("Speed", [0.1, 0.2])


def planned(model: RunTableModel) -> list[tuple[str, str, int]]:
    return [(run.run_id, str(run.combination), run.repetition) for run in model.plan()]


def test_two_runs_at_the_start_have_the_treatments_of_the_first_runs() -> None:
    plan = RunTableModel([TASK], repetitions=2, shuffle=True, seed=3, warm_up=2).plan()
    assert [run.run_id for run in plan] == ["w_1", "w_2", "r_1", "r_2", "r_3", "r_4"]
    assert [run.number for run in plan] == [1, 2, 3, 4, 5, 6]
    assert [run.is_warm_up for run in plan] == [True, True, False, False, False, False]
    assert [run.combination for run in plan[:2]] == [run.combination for run in plan[2:4]]
    assert [run.repetition for run in plan[:2]] == [0, 0]


def test_more_warm_up_runs_than_runs_begin_again() -> None:
    tasks = [run.combination["Task"] for run in RunTableModel([TASK], warm_up=5).plan()]
    assert tasks == ["Video", "Network", "Video", "Network", "Video", "Video", "Network"]


def test_the_runs_are_the_same_with_warm_up_runs_and_without() -> None:
    plain = planned(RunTableModel([TASK, SPEED], repetitions=3, shuffle=True, seed=7))
    warmed = planned(RunTableModel([TASK, SPEED], repetitions=3, shuffle=True, seed=7, warm_up=WarmUp(2, per="Speed")))
    assert [run for run in warmed if run[2]] == plain


@pytest.mark.parametrize("per", ["Task", TASK], ids=["name", "factor"])
def test_each_treatment_is_warmed_up_for_directly_before_its_first_run(per: str | Factor) -> None:
    plan = RunTableModel([TASK, SPEED], repetitions=2, warm_up=WarmUp(1, per=per)).plan()
    assert [run.run_id for run in plan] == ["w_1", "r_1", "r_2", "w_2", *(f"r_{number}" for number in range(3, 9))]
    assert [str(run.combination) for run in plan if run.is_warm_up] == [
        "Task='Video', Speed=0.1",
        "Task='Network', Speed=0.1",
    ]


def test_each_combination_is_warmed_up_for_once() -> None:
    plan = RunTableModel([TASK, SPEED], repetitions=2, warm_up=WarmUp(2, per="combination")).plan()
    warm_ups = [run for run in plan if run.is_warm_up]
    assert len(warm_ups) == 8
    assert len({str(run.combination) for run in warm_ups}) == 4
    for run in warm_ups[::2]:
        assert [str(each.combination) for each in plan[run.number - 1 : run.number + 2]] == [str(run.combination)] * 3


def test_a_session_warms_up_again_for_what_is_left_alone() -> None:
    warm_up = WarmUp(1, per="Task", each_session=True)
    plan = RunTableModel([TASK], repetitions=2, blocks="Task", warm_up=warm_up).plan()
    assert [run.run_id for run in plan] == ["w_1", "r_1", "r_2", "w_2", "r_3", "r_4"]
    assert with_warm_ups_again(plan, selected=[5], done=[0, 1, 2, 3, 4], warm_up=warm_up) == [3, 5]
    assert with_warm_ups_again(plan, selected=[], done=range(6), warm_up=warm_up) == []
    assert with_warm_ups_again(plan, selected=[5, 2], done=[0, 1, 3, 4], warm_up=warm_up) == [3, 5, 0, 2]
    at_start = WarmUp(2, each_session=True)
    plan = RunTableModel([TASK], repetitions=2, warm_up=at_start).plan()
    assert with_warm_ups_again(plan, selected=[5], done=[0, 1, 2, 3, 4], warm_up=at_start) == [0, 1, 5]


def test_a_number_of_runs_is_enough() -> None:
    assert warm_up_of(2) == WarmUp(2)
    assert warm_up_of(0) is warm_up_of(None) is None
    assert str(WarmUp(1)) == "1 warm-up run at the start"
    assert str(WarmUp(2, per="Task")) == "2 warm-up runs for each treatment of Task"


@pytest.mark.parametrize(
    ("given", "problem", "fix"),
    [
        (True, "True is of type bool", "Give a number of runs"),
        ("2", "'2' is of type str", "WarmUp(2, per="),
        (-1, "the number of runs is -1", "from 1"),
        (10**9, "the number of runs is 1,000,000,000", "from 1 to 10,000"),
        (WarmUp(per="Tusk"), "no factor 'Tusk'", "Did you mean 'Task'?"),
    ],
)
def test_what_cannot_be_is_refused_with_everything_else(given: object, problem: str, fix: str) -> None:
    with pytest.raises(DesignError) as refused:
        RunTableModel([TASK], repetitions=0, warm_up=given)  # type: ignore[arg-type]
    repetitions, warm_up = refused.value.findings
    assert repetitions.where == "repetitions"
    assert warm_up.where == "warm_up"
    assert problem in warm_up.problem
    assert fix in warm_up.fix


def test_all_that_is_wrong_with_a_warm_up_is_said() -> None:
    with pytest.raises(DesignError) as refused:
        WarmUp(0, per=3, each_session="yes")  # type: ignore[arg-type]
    assert len(refused.value.findings) == 3
    with pytest.raises(DesignError, match="the number of runs is '2', of type str"):
        WarmUp("2")  # type: ignore[arg-type]


def test_the_column_of_warm_up_runs_is_taken_only_where_there_are_some() -> None:
    factor = Factor("Warm_Up", ["short", "long"])
    assert len(RunTableModel([factor]).plan()) == 2
    with pytest.raises(DesignError, match="the run table has a column of that name already"):
        RunTableModel([factor], warm_up=1)
