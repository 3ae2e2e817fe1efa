"""Simulated experiments are analysed as the report analyses real ones, and power is what exact formulas say."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from statsmodels.stats.power import FTestAnovaPower, TTestIndPower, TTestPower
from statsmodels.stats.proportion import confint_proportions_2indep
from tests.analysis.made_experiment import make_experiment
from tests.long_cases import long_but, soak_but

from robot_runner.analysis import analyse, load_results
from robot_runner.analysis.planning.assumed_values import (
    AssumedMeasure,
    assumed_scenario,
    differences_of,
    numbers_of,
    responses_of,
    with_blocks,
)
from robot_runner.analysis.planning.planned_study import Study
from robot_runner.analysis.planning.power_analysis import Assumptions, power_analysis, scenarios_of
from robot_runner.analysis.planning.power_search import Search, search_repetitions
from robot_runner.analysis.planning.power_simulation import Simulation
from robot_runner.analysis.statistics.families import claim_of, effect_key
from robot_runner.analysis.statistics.tested import TestMethod
from robot_runner.core.design.analysis_plan import AnalysisPlan, Correction, Estimand, Family, Statistic
from robot_runner.core.design.factor import Factor
from robot_runner.core.design.hypothesis import Hypothesis
from robot_runner.core.design.outliers import Outliers
from robot_runner.core.design.run_table_model import RunTableModel
from robot_runner.core.errors import AnalysisError
from robot_runner.designs import Blocks, FractionalFactorial, SplitPlot

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from robot_runner.analysis.planning.assumed_values import Scenario

TASK = Factor("Task", ["Video", "Network"])
SPEED = Factor("Speed", [0.1, 0.2, 0.3])
ROBOT = Factor("Robot", ["waffle", "burger", "pi", "four"])
MAY_DIFFER = Hypothesis("Tasks differ.", measure="Energy", factors="Task")
IS_WITHIN = Hypothesis("Tasks hardly differ in time.", measure="Time", factors="Task", within=3.0)
FASTEST = Hypothesis(
    "The fastest is dearer.", measure="Energy", factors="Speed", contrast={"0.1": -1, "0.2": 0, "0.3": 1}
)


def study_of(
    factors: list[Factor], plan: AnalysisPlan | None = None, blocks: str | None = None, **design: Any
) -> Study:
    model = RunTableModel(factors, repetitions=3, blocks=blocks, **design)
    return Study.of_model("study", model, plan, {"Energy": "J", "Time": "s"})


def scenario_of(study: Study, *differences: str, sd: str = "1", measures: tuple[str, ...] = ("Energy",)) -> Scenario:
    spreads = numbers_of(study, "--sd", [sd], measures)
    return assumed_scenario(study, measures, differences_of(study, differences, measures), spreads, {}, "assumed")


#: Designs and plans of every kind that the tests tell apart.
STUDIES: dict[str, tuple[Study, int, int | None]] = {
    "two treatments, no plan": (study_of([TASK]), 6, None),
    "factorial": (study_of([TASK, SPEED], AnalysisPlan("Energy")), 12, None),
    "two primary measures and hypotheses": (
        study_of([TASK, SPEED], AnalysisPlan(["Energy", "Time"], hypotheses=[MAY_DIFFER, IS_WITHIN, FASTEST])),
        12,
        None,
    ),
    "the family of the hypotheses": (
        study_of(
            [TASK, SPEED],
            AnalysisPlan(
                hypotheses=[MAY_DIFFER, IS_WITHIN, FASTEST],
                family=Family.HYPOTHESES,
                correction=Correction.BENJAMINI_HOCHBERG,
            ),
        ),
        12,
        None,
    ),
    "ranks": (study_of([TASK, SPEED], AnalysisPlan("Energy", estimand=Estimand.RANK)), 12, None),
    "trimmed means": (study_of([SPEED], AnalysisPlan("Energy", estimand=Estimand.TRIMMED_MEAN)), 12, None),
    "Welch-James": (study_of([SPEED], AnalysisPlan("Energy", statistic=Statistic.WELCH_JAMES)), 12, None),
    "ANOVA-type": (study_of([SPEED], AnalysisPlan("Energy", statistic=Statistic.ANOVA_TYPE)), 12, None),
    "blocks of repetitions": (study_of([TASK, SPEED], AnalysisPlan("Energy"), blocks="Repetition"), 8, None),
    "robots as blocks": (study_of([ROBOT, TASK], AnalysisPlan("Energy", blocks="Robot")), 3, None),
    "two batches": (study_of([TASK], AnalysisPlan("Energy")), 8, 5),
    "outliers that are left out": (
        study_of([TASK], AnalysisPlan("Energy", outliers=Outliers(interquartile_ranges=1.0))),
        8,
        None,
    ),
    "covariates": (study_of([TASK], AnalysisPlan("Energy", covariates=["order"])), 8, None),
    "an exclusion": (
        study_of([TASK, SPEED], AnalysisPlan("Energy"), exclude_combinations=[{"Task": "Network", "Speed": 0.3}]),
        4,
        None,
    ),
}
SHORT = ["two treatments, no plan", "ANOVA-type", "two batches", "an exclusion"]
#: What becomes of these is what becomes of others of them.
LIKE_OTHERS = ["factorial", "two primary measures and hypotheses", "Welch-James", "robots as blocks"]


@pytest.mark.parametrize(
    "name",
    [*long_but(SHORT, [name for name in STUDIES if name not in LIKE_OTHERS]), *soak_but([], LIKE_OTHERS)],
)
def test_simulated_experiments_get_the_verdicts_of_the_report(tmp_path: Path, name: str) -> None:
    study, repetitions, first_batch = STUDIES[name]
    measures = study.plan.measures if study.plan is not None else ("Energy",)
    scenario = scenario_of(study, "Task=1.2" if "Task" in study.factors else "Speed=1.2", measures=measures)
    scenario = with_blocks(scenario, dict.fromkeys(measures, 2.0), {name: {("Task",): 0.5} for name in measures})
    simulation = Simulation(study, scenario, repetitions, seed=(3,), first_batch=first_batch)
    drawn, found, p_values = simulation.values(0, 2), simulation.found(0, 2), simulation.p_values(0, 2)
    experiment = len(name) % 2  # of some studies the first and of others the second: both are simulated at once
    told = analyse(_as_a_folder(tmp_path / "made", study, repetitions, first_batch, drawn, experiment))
    effects = {
        effect_key(each.name, effect.factors): effect
        for each in told.measures
        if each.name in measures and each.test is not None
        for effect in each.test.effects
    }
    assert effects.keys() == {claim.key for claim in simulation.claims if not claim.is_hypothesis}
    for key, effect in effects.items():
        assert p_values[key][experiment] == pytest.approx(effect.p_value, rel=1e-6)
        assert found[key][experiment] == effect.is_significant
    for outcome in told.hypotheses:
        key = claim_of(outcome.hypothesis)
        assert p_values[key][experiment] == pytest.approx(outcome.p_value, rel=1e-6)
        assert found[key][experiment] == outcome.is_supported


def _as_a_folder(
    root: Path, study: Study, repetitions: int, first_batch: int | None, drawn: dict[str, Any], experiment: int
) -> Any:
    """Return the results of a folder that holds one simulated experiment."""
    if first_batch is not None:  # a batch takes a journal of extensions: the table in memory has its column
        return study.results(repetitions, {name: values[experiment] for name, values in drawn.items()}, first_batch)

    def values(treatments: dict[str, Any], repetition: int) -> dict[str, Any] | None:
        cell = tuple(map(str, treatments.values()))
        if cell not in study.cells:
            return None
        place = (repetition - 1) * len(study.cells) + study.cells.index(cell)
        return {name: float(several[experiment, place]) for name, several in drawn.items()}

    texts = {"Speed": [0.1, 0.2, 0.3]}
    factors = [Factor(name, texts.get(name, list(of))) for name, of in study.factors.items()]
    plan = study.plan.as_mapping() if study.plan is not None else None
    made = make_experiment(
        root, factors, values, repetitions=repetitions, measures=list(drawn), blocks=study.blocks, analysis=plan
    )
    return load_results(made.root)


@pytest.mark.long
def test_power_for_two_treatments_is_that_of_the_noncentral_t() -> None:
    # R: power.t.test(delta = 1, sd = 1, power = 0.8) says n = 16.71477.
    study = study_of([TASK], AnalysisPlan("Energy"))
    answer = search_repetitions(study, scenario_of(study, "Task=1"), Search(last=40))
    assert answer.needed is not None
    assert answer.needed.low <= 17 <= (answer.needed.high or 0)
    for point in answer.points:
        if point.repetitions >= 5:  # Welch's t loses a point of fewer
            exact = TTestIndPower().power(1.0, point.repetitions, 0.05)
            assert abs(point.least.share - exact) < 4 * max(point.least.error, 0.002)


def test_power_for_equivalent_spreads_of_three_treatments_is_that_of_the_noncentral_f() -> None:
    # R: power.anova.test(groups = 3, between.var = 0.25, within.var = 1, n = 30) says 0.8 and more. The means are -0.5,
    # 0 and 0.5 of a standard deviation; Welch's weights cost a point at 30 runs.
    study = study_of([SPEED], AnalysisPlan("Energy", statistic=Statistic.ANOVA_TYPE))
    simulation = Simulation(study, scenario_of(study, "Speed=1"), 30, seed=(1,))
    found = np.concatenate([simulation.found(part)[effect_key("Energy", ["Speed"])] for part in range(8)])
    exact = FTestAnovaPower().power(np.sqrt(0.5 / 3), 90, 0.05, k_groups=3)
    assert abs(found.mean() - exact) < 4 * np.sqrt(exact * (1 - exact) / len(found)) + 0.01


def test_power_within_blocks_is_that_of_the_paired_t() -> None:
    study = study_of([TASK], AnalysisPlan("Energy"), blocks="Repetition")
    scenario = with_blocks(scenario_of(study, "Task=1"), {"Energy": 5.0}, {})
    simulation = Simulation(study, scenario, 15, seed=(1,))
    found = np.concatenate([simulation.found(part)[effect_key("Energy", ["Task"])] for part in range(8)])
    exact = TTestPower().power(1 / np.sqrt(2), 15, 0.05)
    assert abs(found.mean() - exact) < 4 * np.sqrt(exact * (1 - exact) / len(found))


def test_equivalence_is_found_where_both_of_scipys_one_sided_tests_find_it() -> None:
    hypothesis = Hypothesis("Tasks are alike.", measure="Energy", factors="Task", within=1.0)
    study = study_of([TASK], AnalysisPlan(hypotheses=[hypothesis], family=Family.HYPOTHESES))
    simulation = Simulation(study, scenario_of(study, "Task=0.2"), 20, seed=(1,))
    found, values = simulation.found(0)[claim_of(hypothesis)], simulation.values(0)["Energy"]
    one, other = values[:, 0::2], values[:, 1::2]
    above = stats.ttest_ind(one, other - 1.0, axis=1, equal_var=False, alternative="greater").pvalue
    below = stats.ttest_ind(one, other + 1.0, axis=1, equal_var=False, alternative="less").pvalue
    assert np.array_equal(found, np.maximum(above, below) < 0.05)
    assert 0.6 < found.mean() < 0.9


def test_that_a_difference_is_below_a_bound_is_found_where_scipys_one_sided_test_finds_it() -> None:
    weights = {"Video": 1, "Network": -1}
    hypothesis = Hypothesis("No more.", measure="Energy", factors="Task", contrast=weights, below=0.8)
    study = study_of([TASK], AnalysisPlan(hypotheses=[hypothesis], family=Family.HYPOTHESES))
    simulation = Simulation(study, scenario_of(study, "Task=0.2"), 20, seed=(1,))
    found, values = simulation.found(0)[claim_of(hypothesis)], simulation.values(0)["Energy"]
    video, other = (values[:, list(TASK.treatments).index(name) :: 2] for name in weights)
    below = stats.ttest_ind(video, other + 0.8, axis=1, equal_var=False, alternative="less").pvalue
    assert np.array_equal(found, below < 0.05)
    assert 0.5 < found.mean() < 0.97


def test_nothing_that_is_not_there_is_found_more_often_than_alpha() -> None:
    study = study_of([TASK, SPEED], AnalysisPlan("Energy"))
    simulation = Simulation(study, scenario_of(study, "Task=2"), 12, seed=(1,))
    found = [simulation.found(part) for part in range(6)]
    share = np.mean([each[effect_key("Energy", ["Speed"])] for each in found])
    assert 0.005 < share < 0.05  # after Holm's correction for three tests, one of which is always significant


@pytest.mark.long
def test_robots_that_respond_differently_are_not_made_up_for_by_repetitions() -> None:
    study = study_of([ROBOT, TASK], AnalysisPlan("Energy"), blocks="Robot")
    scenario = with_blocks(scenario_of(study, "Task=1"), {}, {"Energy": {("Task",): 1.0}})
    answer = search_repetitions(study, scenario, Search(last=40, simulations=2000))
    assert answer.needed is None
    assert answer.point(40).least.share < 0.3


def test_a_primary_measure_that_is_not_simulated_shares_the_level_and_is_never_found() -> None:
    study, both = (
        study_of([TASK], AnalysisPlan("Energy" if name == "one" else ["Energy", "Time"])) for name in ("one", "both")
    )
    scenario = scenario_of(study, "Task=1")
    alone, shared = (Simulation(of, scenario, 10, seed=(1,)) for of in (study, both))
    (key,) = (claim.key for claim in shared.claims)
    p_values = shared.p_values(0)[key]
    assert np.array_equal(shared.found(0)[key], 2 * p_values < 0.05)
    assert np.array_equal(alone.found(0)[key], p_values < 0.05)


def test_robots_respond_to_each_factor_and_not_to_each_combination() -> None:
    study = study_of([ROBOT, TASK, SPEED], AnalysisPlan("Energy"), blocks="Robot")
    (measure,) = with_blocks(scenario_of(study), {}, responses_of(study, ["2", "Task=3"], ["Energy"])).measures
    assert measure.responses == {("Task",): 3.0, ("Speed",): 2.0}
    cells = study.cells
    drawn = replace(measure, spreads=dict.fromkeys(cells, 0.0)).draw(
        np.random.default_rng(1), 4000, list(study.factors), cells, [cell[0] for cell in cells]
    )
    of = dict(zip(cells, drawn.T, strict=True))
    video, network = ([of["burger", task, speed] for speed in study.factors["Speed"]] for task in study.factors["Task"])
    assert np.std(np.mean(video, axis=0) - np.mean(network, axis=0)) == pytest.approx(3 * 2**0.5, rel=0.05)
    assert np.std(video[0] - video[1]) == pytest.approx(2 * 2**0.5, rel=0.05)
    assert np.std(video[0] - network[0] - video[1] + network[1]) == pytest.approx(0, abs=1e-9)


@pytest.mark.long
def test_the_same_seed_gives_the_same_figures_whatever_is_asked_for() -> None:
    study = study_of([TASK])
    scenario = scenario_of(study, "Task=1")
    wide = search_repetitions(study, scenario, Search(first=5, last=30, simulations=200))
    narrow = search_repetitions(study, scenario, Search(first=10, last=30, simulations=200))
    shared = {each.repetitions for each in wide.points} & {each.repetitions for each in narrow.points}
    assert len(shared) >= 3
    assert all(wide.point(each) == narrow.point(each) for each in shared)
    other = search_repetitions(study, scenario, Search(first=5, last=30, simulations=200, seed=2))
    assert other.points != wide.points


def test_values_that_do_not_vary_find_nothing() -> None:
    study, repetitions, _ = STUDIES["outliers that are left out"]
    simulation = Simulation(study, scenario_of(study, "Task=1.2", sd="0"), repetitions, seed=(1,))
    [found] = simulation.found(0, 2).values()
    assert not found.any()


def test_the_search_begins_with_the_fewest_repetitions_of_which_there_is_a_test() -> None:
    study = study_of([TASK], AnalysisPlan("Energy", estimand=Estimand.RANK))
    answer = search_repetitions(study, scenario_of(study, "Task=9"), Search(last=6, simulations=20))
    assert answer.points[0].repetitions == 4
    assert answer.needed is not None
    assert answer.needed.low >= 4
    assert "it takes 4 runs of each treatment" in answer.too_few
    with pytest.raises(AnalysisError, match="with 3 repetitions nothing can be tested"):
        search_repetitions(study, scenario_of(study, "Task=9"), Search(last=3))


@pytest.mark.parametrize("design", [None, Blocks("Day")], ids=["blocks", "design"])
def test_where_few_blocks_keep_a_study_from_its_power_that_is_told(design: Blocks | None) -> None:
    model = RunTableModel(
        [TASK, Factor("Day", ["Mon", "Tue", "Wed"])], design=design, blocks=None if design else "Day", repetitions=3
    )
    study = Study.of_model("study", model, None, {"Energy": "J"})
    search = Search(power=0.999, first=3, last=4, simulations=50)
    assumptions = Assumptions(spreads=["10"], differences=["Task=1"])
    notes = " ".join(power_analysis(study, assumptions, search).notes)
    assert "Day makes 3 blocks" in notes


PLANNER, ROOM = Factor("Planner", ["DWB", "TEB"]), Factor("Room", list("abcdef"))
NOT_WORSE = Hypothesis("TEB is not worse.", measure="Ok", factors="Planner", contrast={"DWB": 1, "TEB": -1}, below=20)
ALIKE = Hypothesis("They are alike.", measure="Ok", factors="Planner", within=20)
DIFFER = Hypothesis("They differ.", measure="Ok", factors="Planner", contrast={"DWB": 1, "TEB": -1})


def bounds(*hypotheses: Hypothesis, **more: Any) -> AnalysisPlan:
    return AnalysisPlan("Ok", hypotheses=hypotheses or (NOT_WORSE, ALIKE, DIFFER), **more)


def answered(factors: list[Factor], plan: AnalysisPlan | None = None, **design: Any) -> Study:
    return Study.of_model("study", RunTableModel(factors, repetitions=3, **design), plan, {"Ok": ""})


def shares(study: Study, share: float, *differences: str) -> Scenario:
    base = {"Ok": AssumedMeasure.of_shares("Ok", dict.fromkeys(study.cells, share))}
    return assumed_scenario(study, ["Ok"], differences_of(study, differences, ["Ok"]), {}, base, "assumed")


def tables(share: float, other: float, n: int) -> Iterator[tuple[int, int, float]]:
    """Yield each number of yes of two treatments of n runs, with its probability."""
    for one, two in product(range(n + 1), repeat=2):
        yield one, two, float(stats.binom.pmf(one, n, share) * stats.binom.pmf(two, n, other))


@pytest.mark.long
def test_power_of_two_shares_is_that_of_all_tables_of_fishers_test() -> None:
    study = answered([PLANNER])
    simulation, key = Simulation(study, shares(study, 65, "Planner=50"), 14, seed=(5,)), effect_key("Ok", ["Planner"])
    exact = sum(
        chance
        for one, two, chance in tables(0.4, 0.9, 14)
        if stats.fisher_exact([[one, 14 - one], [two, 14 - two]]).pvalue < 0.05
    )
    found = np.concatenate([simulation.found(part)[key] for part in range(16)])
    assert found.mean() == pytest.approx(exact, abs=4 * np.sqrt(exact * (1 - exact) / found.size))


def p_value_of_three(yes: tuple[int, ...], n: int) -> float:
    """Return the probability of all tables of three treatments of n runs that are as uneven, given the sum of yes."""
    alike = [each for each in product(range(n + 1), repeat=3) if sum(each) == sum(yes)]
    chances = [math.prod(math.comb(n, one) for one in each) for each in alike]
    spread = sum(one**2 for one in yes)
    as_uneven = (chance for each, chance in zip(alike, chances, strict=True) if sum(one**2 for one in each) >= spread)
    return sum(as_uneven) / sum(chances)


@pytest.mark.long
@pytest.mark.parametrize("alpha", [0.01, 0.002])
def test_power_of_three_shares_under_a_strict_level_is_that_of_all_tables(alpha: float) -> None:
    study, n, of_three = answered([Factor("Planner", ["A", "B", "C"])], AnalysisPlan("Ok", alpha=alpha)), 6, (5, 50, 95)
    simulation, key = Simulation(study, shares(study, 50, "Planner=90"), n, seed=(5,)), effect_key("Ok", ["Planner"])
    exact = sum(
        math.prod(float(stats.binom.pmf(one, n, share / 100)) for one, share in zip(yes, of_three, strict=True))
        for yes in product(range(n + 1), repeat=3)
        if p_value_of_three(yes, n) < alpha
    )
    found = np.concatenate([simulation.found(part)[key] for part in range(4)])
    assert found.mean() == pytest.approx(exact, abs=4 * np.sqrt(exact * (1 - exact) / found.size))


@pytest.mark.long
def test_power_of_a_bound_of_shares_is_that_of_all_tables_within_newcombes_interval() -> None:
    study = answered([PLANNER], bounds(NOT_WORSE, family=Family.HYPOTHESES))
    simulation = Simulation(study, shares(study, 90, "Planner=0"), 25, seed=(5,))
    exact = sum(
        chance
        for one, two, chance in tables(0.9, 0.9, 25)
        if chance > 1e-9 and confint_proportions_2indep(one, 25, two, 25, method="newcomb", alpha=0.1)[1] < 0.2
    )
    found = np.concatenate([simulation.found(part)[claim_of(NOT_WORSE)] for part in range(16)])
    assert found.mean() == pytest.approx(exact, abs=4 * np.sqrt(exact * (1 - exact) / found.size))


#: Studies of a measure that is yes or no: as the report has it by exact tests, by shares of blocks, and of plots.
ANSWERED: dict[str, tuple[Study, int, float]] = {
    "runs by themselves": (answered([PLANNER, TASK], bounds()), 8, 70),
    "batches": (answered([PLANNER], bounds()), 12, 70),
    "a run of each in a block": (answered([PLANNER], bounds(), blocks="Repetition", shuffle=True), 14, 70),
    "several runs in a block": (answered([ROOM, PLANNER], bounds(blocks="Room")), 4, 70),
    "blocks that are nearly all alike": (answered([ROOM, PLANNER], bounds(blocks="Room")), 2, 97),
    "two of three that hardly fail": (
        answered([ROOM, Factor("Planner", ["DWB", "TEB", "MPPI"])], bounds(blocks="Room")),
        2,
        94,
    ),
    "a split plot": (
        answered([PLANNER, Factor("Seed", range(12)), TASK], bounds(), design=SplitPlot("Planner", "Seed")),
        3,
        70,
    ),
}


@pytest.mark.long
@pytest.mark.parametrize("name", ANSWERED)
def test_simulated_answers_get_the_verdicts_of_the_report(name: str) -> None:
    study, repetitions, share = ANSWERED[name]
    batch = 5 if name == "batches" else None
    simulation = Simulation(study, shares(study, share, "Planner=6"), repetitions, seed=(3,), first_batch=batch)
    drawn, found, p_values = simulation.values(0, 12), simulation.found(0, 12), simulation.p_values(0, 12)
    alike = 0
    for experiment in range(12):
        answers = pd.array(drawn["Ok"][experiment] > 50, dtype="boolean")
        told = analyse(study.results(repetitions, {"Ok": answers}, batch))
        test = told.measure("Ok").test
        effects = {} if test is None else {effect_key("Ok", each.factors): each for each in test.effects}
        for key in found:
            if key in effects:
                expected, is_found = effects[key].p_value, effects[key].is_significant
            else:
                outcome = [each for each in told.hypotheses if claim_of(each.hypothesis) == key]
                expected, is_found = (outcome[0].p_value, outcome[0].is_supported) if outcome else (None, None)
            assert p_values[key][experiment] == pytest.approx(np.nan if expected is None else expected, nan_ok=True)
            assert found[key][experiment] == bool(is_found)
        alike += test is None or test.method is TestMethod.PROPORTIONS
    if "alike" in name:
        assert 0 < alike < 12, "both tests serve"


def test_shares_are_told_by_options_a_file_and_a_pilot(tmp_path: Path) -> None:
    study = answered([PLANNER])
    (told,) = scenarios_of(study, Assumptions(shares=["85%"], differences=["Planner=10"]))
    assert told.measures[0].means == {("DWB",): 80, ("TEB",): 90}
    (tmp_path / "means.csv").write_text("Planner,Ok\nDWB,80%\nTEB,90 %\n", encoding="utf-8")
    (of_file,) = scenarios_of(study, Assumptions(means=tmp_path / "means.csv", measures=["Ok"]))
    assert of_file.measures == told.measures
    answers = {"DWB": [True] * 8 + [False] * 2, "TEB": [True] * 9 + [False]}
    pilot = make_experiment(
        tmp_path / "pilot",
        [PLANNER],
        lambda treatments, repetition: {"Ok": answers[treatments["Planner"]][repetition - 1]},
        repetitions=10,
        measures=("Ok",),
    )
    (of_pilot,) = scenarios_of(study, Assumptions(pilot=load_results(pilot.root)))
    assert of_pilot.measures[0].means == pytest.approx(told.measures[0].means)
    assert of_pilot.measures[0].is_share
    with pytest.raises(AnalysisError, match="105 % of the runs of TEB would say yes to Ok"):
        scenarios_of(study, Assumptions(shares=["Ok=95"], differences=["Planner=20"]))


@pytest.mark.long
def test_a_share_beside_a_pilot_keeps_its_differences_and_its_blocks(tmp_path: Path) -> None:
    study, random = answered([ROOM, PLANNER], AnalysisPlan("Ok", blocks="Room")), np.random.default_rng(1)
    chances = dict(zip("abcdef", (0.1, 0.3, 0.5, 0.7, 0.9, 0.95), strict=True))
    made = make_experiment(
        tmp_path / "pilot",
        [ROOM, PLANNER],
        lambda treatments, _: {"Ok": bool(random.random() < chances[treatments["Room"]])},
        repetitions=6,
        measures=("Ok",),
    )
    pilot = Assumptions(pilot=load_results(made.root))
    (alone,) = scenarios_of(study, pilot)
    moved, of_interest = scenarios_of(study, replace(pilot, shares=["60"], differences=["Planner=10"]))
    ok, own = moved.measures[0], alone.measures[0]
    assert np.mean(list(ok.means.values())) == pytest.approx(60)
    assert np.ptp([ok.means[cell] - own.means[cell] for cell in study.cells]) == pytest.approx(0)
    assert of_interest.measures[0].means["a", "TEB"] == pytest.approx(65)
    assert of_interest.measures[0].block_sd == ok.block_sd == own.block_sd > 20
    with pytest.raises(AnalysisError, match="Ok is yes or no"):
        scenarios_of(study, replace(pilot, spreads=["Ok=3"]))


def test_rooms_that_suit_planners_differently_take_more_of_them() -> None:
    study = answered([ROOM, PLANNER], AnalysisPlan("Ok", blocks="Room"))
    alike = shares(study, 60, "Planner=30")
    differing = with_blocks(alike, {"Ok": 10.0}, {"Ok": {("Planner",): 20.0}})
    key = effect_key("Ok", ["Planner"])
    found = [Simulation(study, each, 10, seed=(1,)).found(0)[key].mean() for each in (alike, differing)]
    assert found[0] > found[1] + 0.2


def test_a_factor_whose_treatments_are_alike_in_the_pilot_is_not_sought() -> None:
    """Shares of few runs are often equal; a difference that is stated beside a pilot does not change these."""
    study = answered([PLANNER, TASK])
    found = search_repetitions(study, shares(study, 60, "Planner=60"), Search(first=6, last=6, simulations=50))
    assert [found.claims[place].label for place in found.sought] == ["effect of Planner on Ok"]
    known = replace(shares(study, 60, "Planner=60"), given=frozenset())
    found = search_repetitions(study, known, Search(first=6, last=6, simulations=50))
    assert [found.claims[place].label for place in found.sought] == ["effect of Planner on Ok"]
    with pytest.raises(AnalysisError, match="no difference of Task is assumed"):
        search_repetitions(study, known, Search(first=6, last=6, simulations=50, effects=("Task",)))
    with pytest.raises(AnalysisError, match="no difference of Planner is assumed"):
        search_repetitions(study, replace(shares(study, 60), given=frozenset()), Search(first=6, last=6))


def test_a_fraction_has_no_test_of_a_success_rate() -> None:
    design = FractionalFactorial(resolution=4)
    study = answered([Factor(name, [0, 1]) for name in "WXYZ"], design=design)
    with pytest.raises(AnalysisError, match="Choose a factorial, blocks or a split plot"):
        Simulation(study, shares(study, 50, "X=40"), 6, seed=(1,))
