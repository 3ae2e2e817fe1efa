"""A race drops what is clearly worse, and hardly ever the best."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from tests.long_cases import soak_but

from robot_runner import Factor, RunTableModel
from robot_runner.adaptive import Race
from robot_runner.core.design.asking import Decision, Told
from robot_runner.core.design.planned_runs import PlannedRun
from robot_runner.core.errors import DesignError

RACES = 250
#: With 5 % of errors, more than this share of so many races has one with a probability of 0.1 % (binomial).
MOST = 0.05 + 3.1 * (0.05 * 0.95 / RACES) ** 0.5


def raced(values: np.ndarray[Any, np.dtype[np.float64]], least: int = 5, **how: Any) -> tuple[list[Told], Decision]:
    """Race combinations whose values are given (one row each, one column a repetition); NaN is a run that failed."""
    factor = Factor("Gait", [f"gait {number}" for number in range(len(values))])
    design = Race("Energy", "minimise", at_most=values.shape[1], **how)
    model = RunTableModel([factor], repetitions=least, shuffle=True, seed=1, design=design, data_columns=["Energy"])
    asking = design.asking(model.factors, model.allowed, least)

    def told_of(run: PlannedRun) -> Told:
        value = values[factor.treatments.index(run.combination["Gait"]), run.repetition - 1]
        return Told(run, {} if np.isnan(value) else {"Energy": float(value)})

    told = [told_of(run) for run in model.plan()]
    while (decision := asking.ask(told)).runs and not decision.confirms:
        assert len(told) < 10_000, "this race never ends"
        for combination, repetition in decision.runs:
            told.append(told_of(PlannedRun(f"r_{len(told) + 1}", len(told) + 1, combination, repetition)))
    return told, decision


def left_in(decision: Decision) -> set[str]:
    return {each["Gait"] for each in decision.facts["known"]["left"]}


@pytest.mark.long
@pytest.mark.parametrize("kind", soak_but({"drifting"}, ["normal", "drifting", "uniform"]))
def test_the_best_is_dropped_in_at_most_five_percent_of_races(kind: str) -> None:
    draw = np.random.default_rng(7)
    dropped = 0
    for _ in range(RACES):
        noise = draw.uniform(-1, 1, (4, 12)) if kind == "uniform" else draw.standard_normal((4, 12))
        if kind == "drifting":  # what changes from one repetition to the next falls out of the comparison
            noise += np.linspace(0, 20, 12)
        # All are equally good, so that the first is a best one, and as hard to tell from the others as can be.
        dropped += "gait 0" not in left_in(raced(noise)[1])
    assert dropped / RACES <= MOST


@pytest.mark.long
def test_what_is_worse_goes_early_and_saves_runs() -> None:
    draw = np.random.default_rng(3)
    values = draw.standard_normal((6, 20)) + np.array([0, 0.2, 5, 5, 8, 8])[:, None]
    told, decision = raced(values, confirm=3)
    assert {"gait 0"} <= left_in(decision) <= {"gait 0", "gait 1"}
    assert len(told) < 6 * 20 * 0.6
    assert decision.confirms
    assert len(decision.runs) == 3 * len(left_in(decision))
    each = {run.run.combination["Gait"]: 0 for run in told}
    for run in told:
        each[run.run.combination["Gait"]] += 1
    assert each["gait 5"] <= 7
    first = [run.run for run in told[:30]]
    assert [{run.block for run in first[start : start + 6]} for start in range(0, 30, 6)] == [{n} for n in range(1, 6)]
    most, _ = raced(values, least=3)
    assert len(most) < len(told) + 20


def test_runs_that_failed_are_passed_over_and_who_has_no_value_goes() -> None:
    values = np.random.default_rng(5).standard_normal((3, 8))
    values[1, 2:4] = np.nan
    values[2] = np.nan
    told, decision = raced(values)
    assert left_in(decision) == {"gait 0", "gait 1"}
    assert sum(each.run.combination["Gait"] == "gait 2" for each in told) == 5
    assert left_in(raced(np.full((2, 6), np.nan))[1]) == {"gait 0", "gait 1"}


@pytest.mark.parametrize("is_doubtful", [True, False])
def test_who_has_no_value_as_all_were_left_out_stays_and_that_is_said(is_doubtful: bool) -> None:
    factor = Factor("Gait", ["trot", "crawl", "bound"])
    design = Race("Energy", at_most=8)
    model = RunTableModel([factor], repetitions=5, design=design, data_columns=["Energy"])
    left_out = Told(model.plan()[0], {}, is_excluded=True, is_doubtful=is_doubtful)
    told = [
        left_out._replace(run=run) if run.combination["Gait"] == "trot" else Told(run, {"Energy": 1.0 + run.repetition})
        for run in model.plan()
    ]
    decision = design.asking(model.factors, model.allowed, 5).ask(told)
    assert left_in(decision) == {"trot", "crawl", "bound"}
    assert "of Gait trot, no value counts" in decision.in_words
    assert len(decision.runs) == 3


@pytest.mark.parametrize(
    ("treatments", "how", "repetitions", "problem"),
    [
        ([1, 2], {"at_most": 2}, 5, "at_most is 2"),
        ([1, 2], {"at_most": 8}, 2, "2 repetitions cannot show the spread"),
        ([1, 2], {"at_most": 4}, 5, "at_most is 4, and 5 repetitions are planned"),
        ([1], {"at_most": 8}, 5, "no factor has two treatments"),
        (range(101), {"at_most": 8}, 5, "101 combinations are more than the 100"),
        ([1, 2], {"at_most": 8, "direction": "up"}, 5, "the direction of Energy is 'up'"),
    ],
)
def test_what_cannot_be_is_said(treatments: Any, how: dict[str, Any], repetitions: int, problem: str) -> None:
    with pytest.raises(DesignError) as raised:
        RunTableModel([Factor("Gait", treatments)], repetitions=repetitions, design=Race("Energy", **how))
    assert any(problem in each.problem and each.fix for each in raised.value.findings)


@pytest.mark.parametrize(
    ("repetitions", "confirm", "is_confirmed", "may_add"),
    [(5, 0, False, True), (6, 0, False, False), (6, 2, False, True), (6, 2, True, False)],
)
def test_runs_may_follow_until_the_last_repetition_and_until_the_outcome_is_confirmed(
    repetitions: int, confirm: int, is_confirmed: bool, may_add: bool
) -> None:
    factor = Factor("Gait", ["trot", "crawl"])
    design = Race("Energy", at_most=6, confirm=confirm)
    model = RunTableModel([factor], repetitions=repetitions, data_columns=["Energy"])
    runs = model.plan()
    confirming = [run._replace(batch=2) for run in runs[:4]] if is_confirmed else []
    assert design.asking([factor], model.allowed, 5).may_add([*runs, *confirming]) is may_add


def test_a_race_is_by_one_measure() -> None:
    with pytest.raises(DesignError, match="Name a measure"):
        Race({"Energy": "minimise"}, at_most=8)  # type: ignore[arg-type]


def test_a_race_that_has_no_value_at_its_first_look_ends_and_says_so() -> None:
    told, decision = raced(np.full((2, 9), np.nan), confirm=3)
    assert len(told) == 2 * 5
    assert decision.findings[0][0] == "no combination has a value of Energy"


def test_values_that_differ_by_rounding_alone_are_equally_good() -> None:
    values = np.tile([0.1 + 0.2, 0.3, 0.5], (6, 1)).T * np.array([1, 2, 1, 3, 1, 2])
    _, decision = raced(values, least=3)
    assert left_in(decision) == {"gait 0", "gait 1"}


def test_values_too_large_to_compute_with_are_no_values_and_are_told() -> None:
    values = np.ones((3, 5)) * np.array([[np.finfo(float).max], [2.0], [2.0]])
    _, decision = raced(values, least=3)
    assert left_in(decision) == {"gait 1", "gait 2"}
    assert "has 1.7976931348623157e+308 for Energy, too large to compute with" in decision.findings[0][0]
