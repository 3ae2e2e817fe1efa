"""Exclusions leave out exactly the combinations that they name, and say so where they name what there is not."""

from __future__ import annotations

from typing import Any

import pytest

from robot_runner.core.design.factor import Factor
from robot_runner.core.design.numeric_range import Range
from robot_runner.core.design.run_table_model import RunTableModel
from robot_runner.core.errors import DesignError

TASK = Factor("Task", ["Video", "Network"])
SPEED = Factor("Speed", [0.1, 0.2])


def combinations(factors: list[Factor], exclusions: Any) -> list[tuple[Any, ...]]:
    return [tuple(run.combination.values()) for run in RunTableModel(factors, exclusions).plan()]


def findings_of(exclusions: Any, *factors: Factor) -> list[str]:
    with pytest.raises(DesignError) as caught:
        RunTableModel(factors or [TASK, SPEED], exclusions)
    return [str(finding) for finding in caught.value.findings]


@pytest.mark.parametrize(
    ("exclusion", "left"),
    [
        ({"Task": "Video", "Speed": 0.2}, [("Video", 0.1), ("Network", 0.1), ("Network", 0.2)]),
        ({"Task": "Video"}, [("Network", 0.1), ("Network", 0.2)]),
        ({TASK: "Video"}, [("Network", 0.1), ("Network", 0.2)]),
        ({"Speed": [0.2]}, [("Video", 0.1), ("Network", 0.1)]),
        ({"Task": ["Video", "Network"], "Speed": {0.2}}, [("Video", 0.1), ("Network", 0.1)]),
        (
            lambda run: run["Task"] == "Video" and run["Speed"] > 0.1,
            [("Video", 0.1), ("Network", 0.1), ("Network", 0.2)],
        ),
    ],
)
def test_what_matches_in_all_named_factors_is_left_out(exclusion: Any, left: list[tuple[Any, ...]]) -> None:
    assert combinations([TASK, SPEED], [exclusion]) == left


def test_an_exclusion_never_touches_the_equal_treatment_of_another_factor() -> None:
    factors = [Factor("Camera", ["on", "off"]), Factor("Lidar", ["on", "off"])]
    assert combinations(factors, [{"Camera": "on"}]) == [("off", "on"), ("off", "off")]


def test_true_is_not_one() -> None:
    factors = [Factor("A", [True, 1]), Factor("B", ["x"])]
    assert combinations(factors, [{"A": 1}]) == [(True, "x")]
    assert combinations(factors, [{"A": True}]) == [(1, "x")]


def test_a_treatment_that_is_a_tuple_counts_as_one() -> None:
    area = Factor("Area", [(0, 0), (1, 1), (2, 2)])
    assert combinations([area], [{"Area": (1, 1)}]) == [((0, 0),), ((2, 2),)]
    assert combinations([area], [{"Area": [(0, 0), (1, 1)]}]) == [((2, 2),)]


def test_a_predicate_cannot_change_a_combination() -> None:
    def greedy(combination: Any) -> bool:
        combination["Task"] = "Video"
        return False

    assert "does not support item assignment" in findings_of([greedy])[0]


@pytest.mark.parametrize(
    ("exclusion", "finding"),
    [
        ({"Tsk": "Video"}, "there is no factor 'Tsk' → Did you mean 'Task'?"),
        ({Factor("Load", [1]): 1}, "there is no factor 'Load' → Choose one of: 'Task', 'Speed'."),
        ({"Task": "Vidoe"}, "'Vidoe' is not a treatment of factor 'Task' → Did you mean 'Video'?"),
        ({"Speed": "0.1"}, "'0.1' is not a treatment of factor 'Speed' → Did you mean 0.1?"),
        ({}, "the exclusion names no factor → Name a factor and its treatments, or remove it."),
        (
            "Video",
            ("'Video' is of type str → Give a mapping from factors to treatments, or a function of a combination."),
        ),
        (
            lambda run: run["task"] == "Video",
            "the predicate raised KeyError: 'task' for the combination Task='Video', Speed=0.1 → Did you mean 'Task'?",
        ),
        (
            lambda run: int(run["Task"]),
            (
                "the predicate raised ValueError: invalid literal for int() with base 10: 'Video' for the combination "
                "Task='Video', Speed=0.1 → Correct it."
            ),
        ),
    ],
)
def test_an_exclusion_of_what_there_is_not_is_refused(exclusion: Any, finding: str) -> None:
    assert findings_of([exclusion]) == [f"exclude_combinations[0]: {finding}"]


def test_a_value_within_a_range_takes_a_function() -> None:
    (finding,) = findings_of([{"Speed": 0.15}], TASK, Factor("Speed", Range(0.1, 0.2, step=0.05)))
    assert "→ Of a range, a mapping names the ends, 0.1 and 0.2. For values between them, write a function" in finding


def test_what_a_predicate_raised_is_the_cause() -> None:
    with pytest.raises(DesignError) as caught:
        RunTableModel([TASK], [lambda run: run["Speed"]])
    assert isinstance(caught.value.__cause__, KeyError)


def test_what_several_predicates_raised_is_said_at_once() -> None:
    findings = findings_of([lambda run: run["Sped"], {"Tsk": 1}, lambda run: 1 / (run["Task"] == "none")])
    wrong = {finding.partition(":")[0] for finding in findings}
    assert wrong == {f"exclude_combinations[{number}]" for number in range(3)}


def test_all_exclusions_are_looked_at() -> None:
    findings = findings_of([{"Tsk": 1, "Task": ["x", "Video", "y"]}, {}, {"Speed": 9}])
    assert [finding.partition(":")[0] for finding in findings] == [
        *["exclude_combinations[0]"] * 3,
        "exclude_combinations[1]",
        "exclude_combinations[2]",
    ]


@pytest.mark.parametrize("exclusions", [{"Task": "Video"}, 5, "Video"])
def test_what_is_no_list_of_exclusions_is_refused(exclusions: Any) -> None:
    kind = type(exclusions).__name__
    assert findings_of(exclusions) == [
        f"exclude_combinations: {exclusions!r} is of type {kind} → Give a list of exclusions."
    ]


def test_excluding_everything_is_refused() -> None:
    assert findings_of([{"Task": "Video"}, lambda _: True]) == [
        "exclude_combinations: every combination is excluded → Exclude fewer."
    ]


def test_an_exclusion_that_removes_nothing_is_a_warning() -> None:
    model = RunTableModel([TASK, SPEED], [{"Task": []}, {"Task": "Video"}, {"Task": "Video", "Speed": 0.1}])
    assert [str(warning) for warning in model.warnings] == [
        "exclude_combinations[0]: the exclusion matches no combination → Remove it, or correct what it names.",
        "exclude_combinations[2]: the exclusion removes nothing: what it matches is excluded already → Remove it.",
    ]
    assert not any(warning.is_error for warning in model.warnings)
    assert len(model.plan()) == 2
