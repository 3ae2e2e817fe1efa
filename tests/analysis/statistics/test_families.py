"""What is said of an effect and of the check beside it, after correction."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from tests.analysis.made_experiment import make_experiment
from tests.analysis.statistics.designed_data import designed
from tests.long_cases import soak_but

from robot_runner.analysis import analyse, load_results
from robot_runner.analysis.report.blocks import Paragraph
from robot_runner.analysis.report.document import report_document
from robot_runner.analysis.report.material import Material
from robot_runner.core.design.factor import Factor

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from robot_runner.analysis.statistics.outcome import ExperimentStatistics, MeasureStatistics
    from robot_runner.analysis.statistics.tested import Effect

PLAN = {"measures": ["Energy", "Time"]}


def statistics(folder: Path, seed: int, **made: Any) -> ExperimentStatistics:
    """Return the statistics of two treatments that differ in energy, and not in time."""
    random, others = (np.random.default_rng(each) for each in (seed, seed + 1000))
    energies = {task: random.normal(size=6) + 1.2 * (task == "Network") for task in ("Video", "Network")}
    folder = make_experiment(
        folder / f"made_{seed}",
        values=lambda of, repetition: {
            "Energy": float(energies[of["Task"]][repetition - 1]),
            "Time": float(others.normal()),
        },
        repetitions=6,
        measures=("Energy", "Time"),
        analysis=PLAN,
        **made,
    ).root
    return analyse(load_results(folder))


def energy(measures: Sequence[MeasureStatistics]) -> Effect:
    """Return the effect on energy."""
    test = next(each.test for each in measures if each.name == "Energy")
    assert test is not None
    return test.effects[0]


def test_a_check_does_not_deny_what_is_not_shown(tmp_path: Path) -> None:
    effect = energy(statistics(tmp_path, 110).measures)
    assert effect.check is not None
    assert (effect.p_value or 0) < 0.05 < min(effect.adjusted_p_value or 0, effect.check.p_value or 0)
    assert effect.conclusion.endswith("that is not proof that there is none.")


def test_the_p_value_of_a_check_is_said_to_be_uncorrected_where_that_beside_it_is_corrected(tmp_path: Path) -> None:
    effect = energy(statistics(tmp_path, 0).measures)
    assert "The test of ranks does show one (p = 0.049 before correction)" in effect.conclusion


@pytest.mark.long
def test_a_conclusion_that_stands_or_falls_has_the_p_value_that_decides(tmp_path: Path) -> None:
    found = statistics(tmp_path, 1, doubts={"r_1": "hot"})
    effect = energy(found.without_doubtful)
    assert (effect.p_value or 0) < 0.05 < (effect.adjusted_p_value or 0)
    conclusion = next(each.conclusion for each in found.standings if each.measure == "Energy")
    assert re.search(r"the effect of Task on Energy is \D* \(p = 0\.0\d+, p = 0\.\d+ after correction\)", conclusion)


@pytest.mark.long
@pytest.mark.parametrize("factors", soak_but({20}, [20, 64]))
def test_factors_whose_combinations_are_too_many_to_be_looked_at_are_compared_one_by_one(factors: int) -> None:
    random = np.random.default_rng(factors)
    rows = [(*map(str, random.integers(0, 2, factors)), float(random.normal())) for _ in range(factors + 20)]
    results = replace(designed(rows, [f"F{place}" for place in range(factors)], {}), manifest={})
    [found] = analyse(results).measures
    assert found.test is not None
    assert len(found.test.effects) == len(found.post_hoc) == factors


def told(groups: dict[str, list[float]]) -> str:
    """Return what is said of the effect of a factor with these treatments."""
    rows = [(name, value) for name, values in groups.items() for value in values]
    test = analyse(designed(rows, ["Task"], {})).measure("y").test
    assert test is not None
    return test.effects[0].conclusion


def test_of_several_treatments_it_is_said_which_one_has_the_larger_mean() -> None:
    near = [0.0, 0.1, -0.1, 0.2, -0.2]
    said = told({"a": [9 + each for each in near], "b": near, "c": [4 + each for each in near]})
    assert "the mean of a is higher than that of b by 9.000, the largest difference (" in said


def test_the_largest_difference_that_is_not_shown_is_not_passed_over() -> None:
    near = [0.0, 0.1, -0.1, 0.2, -0.2]
    said = told({"a": near, "b": [1 + each for each in near], "wild": [12.0, -9.0, 20.0, -14.0, 6.0]})
    assert "the mean of a is lower than that of b by 1.000, the largest difference that is significant (" in said


def test_a_hypothesis_is_supported_in_the_direction_that_was_found_and_not_in_any_other(tmp_path: Path) -> None:
    said = {"statement": "Streaming costs energy.", "measure": "Energy", "factors": ["Task"]}
    among = {"statement": "The same within 9.", "measure": "Energy", "factors": ["Task"], "within": 9}
    made = make_experiment(
        tmp_path / "made",
        values=lambda of, repetition: {"Energy": 8.0 * (of["Task"] == "Network") + repetition / 10},
        analysis={"measures": ["Energy"], "hypotheses": [said, among]},
    )
    streaming, same = analyse(load_results(made.root)).hypotheses
    assert streaming.conclusion.startswith(
        "The data support it, unless it claims another direction (p < 0.001 after correction for 2 tests). Task has "
        "an effect on Energy: the mean of Video is lower than that of Network by 8.000"
    )
    assert same.conclusion.startswith("The data support it (p < 0.001 after correction for 2 tests). The contrast")


THREE = [Factor("Task", ["a", "b"]), Factor("Map", ["x", "y"]), Factor("Speed", [1, 2])]


def interacting(treatments: dict[str, Any], repetition: int) -> dict[str, Any]:
    is_b, is_y, is_fast = (treatments[each.name] == each.treatments[1] for each in THREE)
    return {"Energy": 3.0 * is_b * is_y + 4.0 * is_b * is_fast + (0.0, 0.4, 0.1, 0.3)[repetition - 1]}


@pytest.mark.long
def test_combinations_of_each_interaction_that_is_shown_are_compared(tmp_path: Path) -> None:
    made = make_experiment(tmp_path / "made", THREE, interacting, repetitions=4)
    measure = analyse(load_results(made.root)).measure("Energy")
    assert measure.test is not None
    shown = [each.factors for each in measure.test.effects if len(each.factors) > 1 and each.is_significant]
    assert shown == [("Task", "Map"), ("Task", "Speed")]
    assert [each.factors for each in measure.post_hoc if len(each.factors) > 1] == shown


@pytest.mark.long
def test_the_family_of_each_test_is_told_where_a_measure_has_several(tmp_path: Path) -> None:
    said = {"statement": "Tasks differ.", "measure": "Energy", "factors": ["Task"]}
    plan = {"measures": ["Energy"], "family": "hypotheses", "hypotheses": [said]}
    made = make_experiment(tmp_path / "made", THREE[:2], interacting_of_two, repetitions=4, analysis=plan)
    results = load_results(made.root)
    statistics = analyse(results)
    test = statistics.measure("Energy").test
    assert test is not None
    assert [(each.name, each.size, each.tests) for each in test.families] == [
        ("the hypotheses", 1, ("Task",)),
        ("the effects on Energy", 2, ("Map", "Task x Map")),
    ]
    blocks = report_document(Material(results, statistics), made="").blocks()
    (told,) = (each.text for each in blocks if isinstance(each, Paragraph) and each.lead == "Family.")
    assert told == (
        "p-values are adjusted within families: Task among 1 test (the hypotheses); Map and Task x Map among 2 tests "
        "(the effects on Energy)."
    )


def interacting_of_two(treatments: dict[str, Any], repetition: int) -> dict[str, Any]:
    return interacting({**treatments, "Speed": 1}, repetition)
