"""Runs chosen by ids and by treatments."""

from __future__ import annotations

import pytest

from robot_runner.core.design.factor import Factor
from robot_runner.core.design.run_table_model import RunTableModel
from robot_runner.core.design.selection import RunChooser
from robot_runner.core.errors import ExecutionError

FACTORS = [Factor("Task", ["Video", "Network"]), Factor("Speed", [0.1, 0.2]), Factor("Pose", [(1, 2), None])]


def chooser() -> RunChooser:
    return RunChooser(RunTableModel(FACTORS, repetitions=2).plan(), has_repetition=True)


@pytest.mark.parametrize(
    ("expressions", "chosen"),
    [
        (["r_7,r_2"], [6, 1]),
        (["Task=Video"], [0, 1, 2, 3, 8, 9, 10, 11]),
        (["Task=video,Speed=0.2,Repetition=1"], [2, 3]),
        (["Task=Video,Task=Network,Speed=0.1,Repetition=2,Pose=(1, 2)"], [8, 12]),
        (["Pose=None,Repetition=1", "r_1,Pose=None,Speed=0.1,Task=Network"], [1, 3, 5, 7, 0, 13]),
    ],
    ids=["ids in their order", "one factor", "several factors", "alternatives and a comma in a treatment", "together"],
)
def test_treatments_of_one_factor_are_alternatives_and_those_of_several_have_to_hold(
    expressions: list[str], chosen: list[int]
) -> None:
    runs = chooser()
    assert list(runs.choose("--only", expressions).places) == chosen
    runs.refuse()


def test_everything_that_is_wrong_is_said_at_once_with_the_nearest_name() -> None:
    runs = chooser()
    runs.choose("--only", ["r_99", "Tsak=Video", "Task=Vidoe"])
    runs.choose("--first", ["", "Speed=0.3"])
    with pytest.raises(ExecutionError) as refused:
        runs.refuse()
    assert [(each.where, each.fix) for each in refused.value.findings] == [
        ("--only r_99", "Did you mean 'r_9'?"),
        ("--only Tsak=Video", "Did you mean 'Task'?"),
        ("--only Task=Vidoe", "Did you mean 'Video'?"),
        ("--first", "Name ids or treatments, such as r_1,r_2 or Task=Video."),
        ("--first Speed=0.3", "Did you mean '0.2'?"),
    ]


def test_treatments_that_no_run_has_together_are_refused() -> None:
    model = RunTableModel(FACTORS[:2], exclude_combinations=[{"Task": "Video", "Speed": 0.2}])
    runs = RunChooser(model.plan())
    runs.choose("--only", ["Task=Video,Speed=0.2"])
    with pytest.raises(ExecutionError, match="no run has these treatments"):
        runs.refuse()
