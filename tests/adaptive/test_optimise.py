"""A search is pure, respects what is excluded, and says what cannot be."""

from __future__ import annotations

import errno
import importlib.util
import json
import os
from collections.abc import Callable, Mapping, Sequence
from itertools import product
from typing import TYPE_CHECKING, Any
from unittest.mock import Mock

import pytest

from robot_runner import Factor, Range, RunTableModel
from robot_runner.adaptive import Optimise, optimise
from robot_runner.adaptive.explored import SearchedSpace, baseline_of
from robot_runner.adaptive.optimise import _Search
from robot_runner.adaptive.optuna_program import candidates
from robot_runner.core.design.asking import Decision, Told
from robot_runner.core.design.planned_runs import PlannedRun
from robot_runner.core.errors import DesignError, ExecutionError
from robot_runner.core.words import INACTIVE

if TYPE_CHECKING:
    from robot_runner.core.design.factor import Combination

Values = Callable[[Mapping[str, Any]], Mapping[str, float]]


def told_of(runs: Sequence[tuple[Combination, int]], values: Values, batch: int = 1, first: int = 1) -> list[Told]:
    return [
        Told(PlannedRun(f"r_{number}", number, combination, repetition, None, batch), values(combination))
        for number, (combination, repetition) in enumerate(runs, first)
    ]


def searched(model: RunTableModel, values: Values) -> tuple[list[Told], list[Decision]]:
    """Return what is told in the end, and each decision, of a search whose runs are executed at once."""
    design = model.design
    assert isinstance(design, Optimise)
    asking = design.asking(model.factors, model.allowed, model.repetitions)
    told = told_of([(run.combination, run.repetition) for run in model.plan()], values)
    decisions = [asking.ask(told)]
    while decisions[-1].runs:
        assert len(decisions) < 1000, "this search never ends"
        batch = 2 if decisions[-1].confirms else 1
        told += told_of(decisions[-1].runs, values, batch, len(told) + 1)
        decisions.append(asking.ask(told))
    return told, decisions


def energy(combination: Mapping[str, Any]) -> dict[str, float]:
    return {"Energy": (combination["Speed"] - 7) ** 2 + 3 * (combination["Mode"] != "eco")}


def model_of(design: Optimise, **more: Any) -> RunTableModel:
    factors = [Factor("Speed", range(1, 13)), Factor("Mode", ["fast", "eco", "plain"])]
    return RunTableModel(factors, design=design, data_columns=["Energy"], **more)


@pytest.mark.long
def test_a_search_finds_the_best_of_numbers_and_alternatives_and_leaves_out_what_is_excluded() -> None:
    excluded = [{"Speed": 7, "Mode": "eco"}, lambda combination: combination["Speed"] == 6]
    design = Optimise("Energy", runs=20, at_a_time=7, confirm=2, baseline={"Speed": 1, "Mode": "fast"})
    told, decisions = searched(model_of(design, exclude_combinations=excluded), energy)
    combinations = [tuple(each.run.combination.treatments) for each in told if each.run.batch == 1]
    assert len(set(combinations)) == len(combinations) == 20
    assert not {(7, "eco"), *product([6], ["fast", "eco", "plain"])} & set(combinations)
    assert decisions[-2].confirms
    assert {each.treatments for each, _ in decisions[-2].runs} == {(8, "eco"), (1, "fast")}


@pytest.mark.long
@pytest.mark.usefixtures("optuna_here")
def test_several_measures_have_a_front_of_which_nothing_is_beaten() -> None:
    def both(combination: Mapping[str, Any]) -> dict[str, float]:
        return {"Energy": combination["Speed"] ** 2.0, "Way": float(combination["Speed"])}

    design = Optimise({"Energy": "minimise", "Way": "maximise"}, runs=9, start=4, at_a_time=5, confirm=1)
    model = RunTableModel([Factor("Speed", range(12))], design=design, data_columns=["Energy", "Way"])
    _, decisions = searched(model, both)
    assert len(decisions[-1].facts["known"]["best"]) == len(decisions[-2].runs) == 9, "more way always takes more"
    worse = Optimise({"Energy": "minimise", "Way": "minimise"}, runs=9, start=4, at_a_time=5)
    model = RunTableModel([Factor("Speed", range(12))], design=worse, data_columns=["Energy", "Way"])
    (best,) = searched(model, both)[1][-1].facts["known"]["best"]
    assert best["combination"] == {"Speed": "0"}


@pytest.mark.long
@pytest.mark.usefixtures("optuna_here")
def test_a_small_space_is_searched_to_its_end_and_nothing_is_asked_without_a_value() -> None:
    model = model_of(Optimise("Energy", runs=100, start=30, at_a_time=6))
    told, decisions = searched(model, energy)
    assert len(told) == 36
    assert "no further combination is allowed" in decisions[-1].in_words
    _, (only,) = searched(model, lambda _: {})
    assert only.runs == ()
    assert only.findings[0][0] == "no combination has a value of Energy"
    _, (odd,) = searched(model, lambda _: {"Energy": "high"})  # type: ignore[dict-item]
    assert odd.findings[0][0] == "r_1 has 'high' for Energy, which is not a number"


def test_a_factor_of_one_treatment_stands_beside_those_that_are_searched() -> None:
    factors = [Factor("Speed", range(1, 13)), Factor("Robot", ["waffle"])]
    assert list(Optimise("Energy", runs=9).findings(factors)) == []


@pytest.mark.long
def test_what_optuna_offers_for_several_runs_at_a_time_comes_once() -> None:
    tried = [[place, 0] for place in range(5)]
    points = [(places, [float(places[0])]) for places in tried]
    question = {"levels": [8, 3], "are_numbers": [True, False], "directions": ["minimize"], "points": points}
    offered = [
        tuple(places)
        for each in candidates({**question, "tried": tried, "start": 4, "count": 3, "seed": 1})
        for places in each
    ]
    assert len(offered) == len({*offered, *map(tuple, tried)}) - len(tried) > 0


def test_an_end_of_a_range_that_is_excluded_is_not_tried_though_its_steps_are_of_another_type() -> None:
    speed = Factor("Speed", Range(0, 1, step=0.1))
    design = Optimise("Energy", runs=30, start=11)
    model = RunTableModel([speed], exclude_combinations=[{"Speed": 0}], design=design, data_columns=["Energy"])
    assert sorted(run.combination["Speed"] for run in model.plan()) == [step / 10 for step in range(1, 11)]
    assert model.factors[0].texts == ("0", *(f"{step / 10}" for step in range(1, 10)), "1")


def test_start_points_reach_the_ends_and_are_spread() -> None:
    factors = [Factor("Speed", Range(0.0, 1.0, step=0.01)), Factor("Weight", Range(1, 9))]
    space = SearchedSpace(factors, lambda _: True)
    points = space.spread(9, "0")
    for place, levels in enumerate(space.levels):
        own = sorted(each[place] for each in points)
        assert own == [round(number * (len(levels) - 1) / 8) for number in range(9)]
    strict = SearchedSpace(factors, lambda each: each["Speed"] > 0.995)
    found = strict.spread(3, "0")
    assert len(set(found)) == 3
    assert {strict.levels[0][each[0]] for each in found} == {1.0}


def test_treatments_without_a_conditional_factor_are_as_likely_as_those_with_it() -> None:
    sensors = Factor("Sensor", ["camera", "lidar", "sonar"])
    exposure = Factor("Exposure", Range(0.0, 1.0), when={"Sensor": "camera"})
    gain = Factor("Gain", [1, 2, 4], when={"Exposure": 0})  # an end, and equal to it rather than the same text
    for seed in range(6):
        first = RunTableModel([gain, exposure, sensors], design=Optimise("Energy", runs=30, seed=seed)).plan()
        assert {run.combination["Sensor"] for run in first} == {"camera", "lidar", "sonar"}
        cameras = [run.combination for run in first if run.combination["Sensor"] == "camera"]
        assert len(cameras) > 2
        assert all((each["Gain"] is INACTIVE) is (each["Exposure"] != 0.0) for each in cameras)


@pytest.mark.long
@pytest.mark.usefixtures("optuna_here")
def test_what_optuna_offers_has_a_treatment_of_each_factor_that_applies_and_of_no_other() -> None:
    question = {
        "levels": [50, 2, 2],
        "are_numbers": [True, False, False],
        "conditions": [(2, [(1, [0])]), (0, [(2, [1])])],
    }
    points = [([7, 0, 1], [3.0]), ([9, 0, 1], [2.0]), ([50, 1, 2], [4.0]), ([50, 0, 0], None)]
    tried = [places for places, _ in points]
    more = {"directions": ["minimize"], "points": points, "tried": tried, "start": 4, "count": 2, "seed": 1}
    offered = [places for each in candidates({**question, **more}) for places in each]
    assert offered
    assert all((turn < 2) is (sensor == 0) for _, sensor, turn in offered)
    assert all((exposure < 50) is (turn == 1) for exposure, _, turn in offered)


@pytest.mark.parametrize(
    ("make", "problem", "fix"),
    [
        (lambda: Optimise("Energy", "down", runs=9), "the direction of Energy is 'down'", "minimise"),
        (lambda: Optimise("", runs=9), "the measure is ''", "Name a measure"),
        (lambda: Optimise(["Energy", "Way"], runs=9), "the measure is ['Energy', 'Way']", "Name a measure"),
        (lambda: Optimise("Energy", runs=0), "runs is 0", "from 1"),
        (lambda: Optimise("Energy", runs=9, confirm="5"), "confirm is '5', of type str", "whole number"),  # type: ignore[arg-type]
        (lambda: Optimise("Energy", runs=9, baseline={"Speed": 1}), "confirm is 0", "Give confirm=10"),
        (lambda: model_of(Optimise("Energy", runs=6)), "none is left to search with", "runs=12"),
        (
            lambda: model_of(Optimise("Energy", runs=20, confirm=1, baseline={"Sped": 1, "Mode": "eco"})),
            "the baseline names the factor 'Sped'",
            "Did you mean 'Speed'?",
        ),
        (
            lambda: model_of(Optimise("Energy", runs=20, confirm=1, baseline={"Speed": 99, "Mode": "eco"})),
            "the baseline has 99, which is not a treatment of Speed",
            "Did you mean 9?",
        ),
        (
            lambda: RunTableModel([Factor("Speed", [1])], design=Optimise("Energy", runs=9)),
            "no factor has two treatments",
            "its range",
        ),
        (
            lambda: RunTableModel(
                [Factor("Bytes", Range(1, 10_000_000))],
                design=Optimise("Energy", runs=20, confirm=1, baseline={"Bytes": 1}),
            ),
            "Bytes has 9,999,999 steps",
            "a wider step",
        ),
        (
            lambda: model_of(Optimise("Energy", runs=20), exclude_combinations=[lambda _: True]),
            "the exclusions leave no combination",
            "Exclude fewer.",
        ),
    ],
)
def test_what_cannot_be_is_said_with_a_remedy(make: Callable[[], object], problem: str, fix: str) -> None:
    with pytest.raises(DesignError) as raised:
        make()
    assert any(problem in each.problem and fix in each.fix for each in raised.value.findings), raised.value.findings


def conditional(**baseline: object) -> RunTableModel:
    factors = [
        Factor("Sensor", ["camera", "lidar"]),
        Factor("Width", [640, 320], when={"Sensor": "camera"}),
        Factor("Rate", Range(1, 9, step=1), when={"Width": 640}),
    ]
    design = Optimise("Energy", runs=20, confirm=1, baseline=baseline)
    return RunTableModel(factors, design=design, data_columns=["Energy"])


@pytest.mark.parametrize(
    ("baseline", "treatments"),
    [
        ({"Sensor": "lidar"}, ("lidar", INACTIVE, INACTIVE)),
        ({"Sensor": "lidar", "Width": 640, "Rate": 3}, ("lidar", INACTIVE, INACTIVE)),
        ({"Sensor": "camera", "Width": 320}, ("camera", 320, INACTIVE)),
        ({"Sensor": "camera", "Width": 640, "Rate": 3}, ("camera", 640, 3)),
    ],
)
def test_a_baseline_has_no_treatment_of_a_factor_that_does_not_apply(
    baseline: dict[str, object], treatments: tuple[object, ...]
) -> None:
    assert baseline_of(conditional(**baseline).factors, baseline).treatments == treatments


def test_a_baseline_has_a_treatment_of_each_conditional_factor_that_applies() -> None:
    with pytest.raises(DesignError) as raised:
        conditional(Sensor="camera", Width=640)
    (finding,) = raised.value.findings
    assert finding.problem == "the baseline has no treatment of Rate"
    assert finding.fix == "Add it, such as 'Rate': 1."


def test_a_missing_library_is_named_with_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    found = importlib.util.find_spec
    monkeypatch.setattr(
        "robot_runner.adaptive.optimise.find_spec", lambda name: None if name == "optuna" else found(name)
    )
    with pytest.raises(DesignError) as raised:
        model_of(Optimise("Energy", runs=20))
    assert raised.value.findings[0].fix == "Install the extra: pip install 'robot-runner[adaptive]'"


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("_PROGRAM", "robot_runner.adaptive.no_such_program", ".*no_such_program"),
        ("_PATIENCE", 0.001, "no answer came within 0.001 s"),
    ],
)
def test_an_optuna_that_fails_is_told(monkeypatch: pytest.MonkeyPatch, name: str, value: Any, reason: str) -> None:
    monkeypatch.setattr(optimise, name, value)
    model = model_of(Optimise("Energy", runs=20))
    asking = _Search(model.design, model.factors, model.allowed, 1)  # type: ignore[arg-type]
    told = told_of([(run.combination, 1) for run in model.plan()], energy)
    with pytest.raises(DesignError, match=f"Optuna could not be asked where to search next: {reason}"):
        asking.ask(told)


def test_where_there_is_no_process_for_optuna_that_is_told_with_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    refusal = BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))
    monkeypatch.setattr(optimise.subprocess, "run", Mock(side_effect=refusal))
    model = model_of(Optimise("Energy", runs=20))
    asking = _Search(model.design, model.factors, model.allowed, 1)  # type: ignore[arg-type]
    with pytest.raises(ExecutionError, match="no process can be started for the search: ") as raised:
        asking.ask(told_of([(run.combination, 1) for run in model.plan()], energy))
    assert "ulimit -u" in raised.value.fix


@pytest.mark.long
@pytest.mark.usefixtures("optuna_here")
def test_treatments_whose_runs_fail_are_avoided_and_not_only_their_combinations() -> None:
    tried = failed = 0
    for seed in range(2):

        def values(combination: Mapping[str, Any]) -> dict[str, float]:
            return {} if combination["Mode"] == "plain" else energy(combination)

        told, _ = searched(model_of(Optimise("Energy", runs=16, start=6, seed=seed)), values)
        after_start = [each.run.combination["Mode"] for each in told[6:]]
        tried, failed = tried + len(after_start), failed + after_start.count("plain")
    assert failed / tried < 1 / 3, f"{failed} of {tried}: by chance it would be a third"


@pytest.mark.usefixtures("optuna_here")
def test_what_was_excluded_is_passed_over_and_does_not_count_as_failed(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[dict[str, Any]] = []
    answered = optimise.subprocess.run

    def recorded(command: list[str], **given: Any) -> Any:
        asked.append(json.loads(given["input"]))
        return answered(command, **given)

    monkeypatch.setattr(optimise.subprocess, "run", recorded)
    model = model_of(Optimise("Energy", runs=20, start=6, at_a_time=3))
    asking = _Search(model.design, model.factors, model.allowed, 1)  # type: ignore[arg-type]
    told = told_of([(run.combination, 1) for run in model.plan()], energy)
    told[2] = told[2]._replace(values={}, is_excluded=True)
    told[4] = told[4]._replace(values={})
    decision = asking.ask(told)
    (question,) = asked
    assert [values is None for _, values in question["points"]] == [False, False, False, True, False]
    assert len(question["tried"]) == 6
    assert not {each.treatments for each, _ in decision.runs} & {each.run.combination.treatments for each in told}


@pytest.mark.usefixtures("optuna_here")
def test_a_search_goes_on_among_the_treatments_that_the_config_has_now() -> None:
    design = Optimise("Energy", runs=9, start=5, confirm=1)
    begun = RunTableModel([Factor("Speed", range(1, 13))], design=design, data_columns=["Energy"])
    told = told_of([(run.combination, 1) for run in begun.plan()], lambda each: {"Energy": float(each["Speed"])})
    now = RunTableModel([Factor("Speed", range(5, 20))], design=design, data_columns=["Energy"])
    (next_one, _), *others = _Search(design, now.factors, now.allowed, 1).ask(told).runs
    assert next_one["Speed"] in range(5, 20)
    assert not others
