"""Outliers and doubtful values are treated as the plan says, and both results are told."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from scipy import stats
from tests.analysis.made_experiment import make_experiment

from robot_runner.analysis import analyse, load_results
from robot_runner.analysis.statistics.analysed_design import design_of
from robot_runner.analysis.statistics.disclosed import Beside, Reason
from robot_runner.analysis.statistics.left_out import doubtful_values, false_positives, outside
from robot_runner.core.design.outliers import Outliers

if TYPE_CHECKING:
    from pathlib import Path


HOT = "the sensor was hot"
#: Watts of runs of two tasks that differ; the last run of Video is far out, and hides it.
WATTS = {
    "Video": [9.9, 10.0, 10.1, 10.05, 9.95, 10.1, 30.0],
    "Network": [12.0, 11.9, 12.1, 11.95, 12.05, 12.0, 12.1],
}
SAME = {"Video": [9.9, 10.0, 10.1, 10.05, 9.95, 10.1, 10.0], "Network": [10.0, 9.9, 10.1, 9.95, 10.05, 10.0, 10.1]}
HYPOTHESIS = {"statement": "Tasks differ.", "measure": "Energy", "factors": ["Task"]}


def made(folder: Path, plan: dict[str, Any], watts: dict[str, list[float]] | None = None, **more: Any) -> Any:
    """Return an experiment whose odd runs are of Video, and whose even ones are of Network."""
    chosen = watts or WATTS
    experiment = make_experiment(
        folder / "made",
        values=lambda treatments, repetition: {"Energy": chosen[treatments["Task"]][repetition - 1]},
        repetitions=7,
        units={"Energy": "J"},
        analysis={"measures": ["Energy"], **plan},
        **more,
    )
    return load_results(experiment.root)


def statistics(folder: Path, plan: dict[str, Any], **more: Any) -> Any:
    return analyse(made(folder, plan, **more))


def test_a_value_that_is_left_out_of_its_measure_goes_together_with_nothing(tmp_path: Path) -> None:
    implausible = -999.0
    random = np.random.default_rng(5)
    energy, seconds = random.normal(10, 1, 14), random.normal(5, 1, 14)
    energy[3] = seconds[3] = implausible  # the logger broke off
    runs = iter(zip(energy, seconds, strict=True))
    experiment = make_experiment(
        tmp_path / "made",
        values=lambda *_: dict(zip(("Energy", "Time"), map(float, next(runs)), strict=True)),
        repetitions=7,
        measures=("Energy", "Time"),
        analysis={"measures": ["Energy", "Time"], "outliers": {"bounds": {"Energy": [0, None], "Time": [0, None]}}},
    )
    (found,) = analyse(load_results(experiment.root)).correlations
    kept = np.arange(14) != 3
    assert found.n == 13
    assert found.pearson == pytest.approx(stats.pearsonr(energy[kept], seconds[kept]).statistic)
    assert found.p_value == pytest.approx(stats.spearmanr(energy[kept], seconds[kept]).pvalue)


def test_a_run_without_a_value_leaves_none_out(tmp_path: Path) -> None:
    watts = {**WATTS, "Video": [*WATTS["Video"][:6], None]}
    design = design_of(made(tmp_path, {}, watts))
    assert [each.run_id for each in doubtful_values(design, "Energy", ["r_11", "r_13"])] == ["r_11"]


@pytest.mark.parametrize(
    "rule", [{"interquartile_ranges": 3}, {"median_deviations": 3}, {"bounds": {"Energy": [0, 20]}}], ids=str
)
def test_outliers_are_left_out_and_both_results_told(tmp_path: Path, rule: dict[str, Any]) -> None:
    found = statistics(tmp_path, {"outliers": rule, "hypotheses": [HYPOTHESIS]})
    measure, (every,) = found.measure("Energy"), found.with_all_runs
    (one,) = measure.left_out
    assert (one.run_id, one.value, one.reason) == ("r_13", 30.0, Reason.OUTLIER)
    assert (measure.overall.n, every.overall.n) == (13, 14)
    assert [of.test.effects[0].is_significant for of in (measure, every)] == [True, False]
    assert every.left_out == ()
    effect, hypothesis = found.standings
    assert effect.beside is Beside.ALL_RUNS
    assert effect.stands is hypothesis.stands is False
    assert effect.conclusion.startswith("With the 1 run that is left out of Energy (r_13), the effect of Task")
    assert effect.conclusion.endswith("is no longer significant (p = 0.774): the conclusion does not stand.")
    assert found.hypotheses[0].is_supported


def test_the_reason_names_rule_and_combination(tmp_path: Path) -> None:
    rule = {"median_deviations": 3, "bounds": {"Energy": [None, 20]}}
    (one,) = statistics(tmp_path, {"outliers": rule}).measure("Energy").left_out
    assert one.why == "more than 3 median absolute deviations from the median of Video, above 20 J"


def test_the_run_table_keeps_what_is_left_out(tmp_path: Path) -> None:
    results = made(tmp_path, {"outliers": {"median_deviations": 3}})
    before = (results.folder / "run_table.csv").read_bytes()
    analyse(results)
    assert (results.folder / "run_table.csv").read_bytes() == before
    assert len(results.done) == 14


def test_without_a_rule_nothing_is_left_out(tmp_path: Path) -> None:
    found = statistics(tmp_path, {})
    assert (found.measure("Energy").left_out, found.with_all_runs, found.standings) == ((), (), ())


def test_an_analysis_with_another_alpha_is_not_the_planned_one(tmp_path: Path) -> None:
    found = analyse(made(tmp_path, {"outliers": {"median_deviations": 3}}), alpha=0.01)
    assert found.measure("Energy").left_out == ()


def test_rules_of_spread_say_nothing_of_few_or_equal_values() -> None:
    rule = Outliers(median_deviations=3)
    assert not outside(np.array([1.0, 2.0, 3.0, 99.0]), rule).any()
    assert not outside(np.array([1.0, 1.0, 1.0, 1.0, 9.0]), rule).any()
    assert outside(np.array([1.0, 1.1, 0.9, 1.05, 9.0]), rule).tolist() == [False] * 4 + [True]
    assert outside(np.array([1.0, 1.1, 0.9, 1.05, 9.0]), Outliers(interquartile_ranges=3)).tolist() == [False] * 4 + [
        True
    ]


@pytest.mark.long
def test_rules_that_leave_out_much_are_told_to_err(tmp_path: Path) -> None:
    careful, careless = Outliers(interquartile_ranges=3), Outliers(median_deviations=2.5)
    assert false_positives(careful, (30, 30)) == pytest.approx(5.0, abs=0.6)
    assert false_positives(careless, (10, 10)) == pytest.approx(11.1, abs=1.0)
    assert false_positives(Outliers(bounds={"Energy": (0, 1)}), (10, 10)) is None
    found = statistics(tmp_path, {"outliers": {"median_deviations": 2.5}})
    assert found.measure("Energy").rule_false_positives > 6.5
    assert any("finds a difference where there is none in" in each for each in found.warnings)


def test_doubtful_values_are_left_out_where_the_plan_says_so(tmp_path: Path) -> None:
    found = statistics(tmp_path, {"doubtful": "leave out"}, doubts={"r_13": HOT})
    (one,) = found.measure("Energy").left_out
    assert (one.run_id, one.reason) == ("r_13", Reason.DOUBTFUL)
    assert found.measure("Energy").test.effects[0].is_significant
    assert [each.name for each in found.with_all_runs] == ["Energy"]
    assert found.without_doubtful == ()
    assert found.standings[0].stands is False


@pytest.mark.long
def test_the_plan_may_refuse_a_conclusion_while_values_are_doubtful(tmp_path: Path) -> None:
    plan = {"doubtful": "refuse", "hypotheses": [HYPOTHESIS]}
    found = statistics(tmp_path / "a", plan, doubts={"r_13": HOT})
    measure = found.measure("Energy")
    assert measure.test is None
    assert measure.overall.n == 14
    why = "the plan draws no conclusion on a measure with doubtful values (r_13)."
    assert measure.not_computed[0].why == why
    assert found.hypotheses[0].is_supported is None
    assert why in found.hypotheses[0].conclusion
    both = [
        found.beside(which)[0].test.effects[0].is_significant for which in (Beside.ALL_RUNS, Beside.WITHOUT_DOUBTFUL)
    ]
    assert both == [False, True]
    assert statistics(tmp_path / "b", plan).measure("Energy").test is not None


@pytest.mark.long
def test_outliers_and_doubtful_values_are_left_out_together(tmp_path: Path) -> None:
    plan = {"doubtful": "leave out", "outliers": {"median_deviations": 3}}
    found = statistics(tmp_path, plan, doubts={"r_2": HOT})
    assert {each.run_id: each.reason for each in found.measure("Energy").left_out} == {
        "r_2": Reason.DOUBTFUL,
        "r_13": Reason.OUTLIER,
    }
    kept = statistics(tmp_path / "kept", {"outliers": {"median_deviations": 3}}, doubts={"r_2": HOT, "r_13": HOT})
    assert [each.beside for each in kept.standings] == [Beside.WITHOUT_DOUBTFUL, Beside.ALL_RUNS]
    assert kept.standings[0].left_out == ("r_2",)  # r_13 is left out anyway
    assert {each.run_id for each in kept.without_doubtful[0].left_out} == {"r_2", "r_13"}


def test_what_stands_either_way_is_said_to_stand(tmp_path: Path) -> None:
    watts = {**SAME, "Video": [*SAME["Video"][:6], 11.0]}
    (one,) = statistics(tmp_path, {"outliers": {"interquartile_ranges": 3}}, watts=watts).standings
    assert one.stands is True
    assert "is still not significant" in one.conclusion
