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
