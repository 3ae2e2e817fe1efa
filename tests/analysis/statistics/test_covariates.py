"""Means adjusted for covariates: the numbers of R, the level under unequal spreads, and what is told of covariates."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import pytest
import statsmodels.formula.api as smf
from benchmarks.null_designs import NullDesign
from scipy import stats
from tests.analysis.made_experiment import make_experiment
from tests.analysis.statistics import reference_data as data
from tests.analysis.statistics.designed_data import designed
from tests.long_cases import soak_but

from robot_runner.analysis import analyse, load_results
from robot_runner.analysis.statistics.adjusted_means import AdjustedMeans
from robot_runner.analysis.statistics.analysed_design import VALUE, MeasureData, covariate_column
from robot_runner.analysis.statistics.disclosed import Reason
from robot_runner.analysis.statistics.robust_covariance import fit_robustly
from robot_runner.analysis.statistics.tests import planned_model_of
from robot_runner.core.design.analysis_plan import AnalysisPlan, Estimand
from robot_runner.core.design.factor import Factor

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

RANDOM = np.random.default_rng(2)
_BEGUN = RANDOM.bit_generator.state


@pytest.fixture(autouse=True)
def drawn_alike() -> None:
    """Have each test draw the same values, whichever were executed before it."""
    RANDOM.bit_generator.state = _BEGUN


# Without covariates: Welch's t, the paired t, the corrections of Greenhouse and Geisser.


def test_of_two_groups_it_is_welchs_t() -> None:
    first, second = RANDOM.normal(0, 3, 5), RANDOM.normal(1, 1, 15)
    group = np.repeat([0, 1], [5, 15])
    fit = fit_robustly(np.eye(2)[group], np.concatenate([first, second]), cells=group)
    found, expected = fit.contrast(np.array([1.0, -1.0])), stats.ttest_ind(first, second, equal_var=False)
    assert float(found.freedom) == pytest.approx(expected.df)
    assert float(found.p_value) == pytest.approx(expected.pvalue)


def test_of_pairs_within_blocks_it_is_the_paired_t() -> None:
    values = RANDOM.normal(size=(8, 2))
    rest = (values - values.mean(axis=1, keepdims=True)).ravel()
    fit = fit_robustly(np.tile([-0.5, 0.5], 8)[:, None], rest, units=np.repeat(np.arange(8), 2))
    found, expected = fit.contrast(np.ones(1)), stats.ttest_rel(values[:, 1], values[:, 0])
    assert float(found.freedom) == pytest.approx(7)
    assert float(found.p_value) == pytest.approx(expected.pvalue)


# R 4.2, clubSandwich 0.5.8: vcovCR(type = "CR2"), coef_test(test = "Satterthwaite"), Wald_test(test = "HTZ").


def test_runs_of_their_own_are_tested_as_clubsandwich_does() -> None:
    # lm(breaks ~ wool + tension + x, warpbreaks), where x is the row's number modulo 7; one cluster a row
    rows = [(wool, tension, value) for (wool, tension), values in data.WARP_BREAKS.items() for value in values]
    exog = np.array(
        [[1, wool == "B", tension == "M", tension == "H", n % 7] for n, (wool, tension, _) in enumerate(rows, 1)]
    )
    fit = fit_robustly(exog.astype(float), np.array([value for *_, value in rows], dtype=float))
    expected = {
        1: (-5.46113602392, 3.073136142713, 48.3505327331, 8.18498965326e-02),
        3: (-15.98878923767, 3.964023214687, 30.5682476133, 3.39302173030e-04),
        4: (1.42488789238, 0.740166603712, 25.6323294802, 6.53829377766e-02),
    }
    for place, figures in expected.items():
        found = fit.contrast(np.eye(5)[place])
        assert [float(each) for each in (*found, found.p_value)] == pytest.approx(figures, rel=1e-8)
    joint = fit.hotelling(np.eye(5)[2:4])
    assert joint is not None
    assert [float(joint.f_value), float(joint.within)] == pytest.approx([8.1086182164, 35.1544844767], rel=1e-8)
    assert float(joint.p_value) == pytest.approx(0.00127135163925, rel=1e-8)


def ergo_stool() -> MeasureData:
    """Return R's `ergoStool` with a covariate that was made up."""
    covariate = [
        3,
        1,
        4,
        1,
        5,
        9,
        2,
        6,
        5,
        3,
        5,
        8,
        9,
        7,
        9,
        3,
        2,
        3,
        8,
        4,
        6,
        2,
        6,
        4,
        3,
        3,
        8,
        3,
        2,
        7,
        9,
        5,
        0,
        2,
        8,
        8,
    ]
    rows = [(kind, subject, data.ERGO_STOOL[kind][subject]) for subject in range(9) for kind in data.ERGO_STOOL]
    frame = pd.DataFrame(
        {
            "run_id": [f"r_{number}" for number in range(1, 37)],
            " place": range(1, 37),
            " block": [f"s{subject}" for _, subject, _ in rows],
            "Type": pd.Categorical([kind for kind, _, _ in rows], ordered=True),
            VALUE: [float(value) for *_, value in rows],
            covariate_column("x"): np.array(covariate, dtype=float),
        }
    )
    return MeasureData("effort", frame, frame, ("Type",), is_blocked=True, covariates=("x",))


def test_blocks_are_tested_as_clubsandwich_does() -> None:
    # lm(effort ~ Type + x + Subject, ergoStool), clusters by Subject
    model = planned_model_of(ergo_stool(), Estimand.MEAN)
    assert isinstance(model, AdjustedMeans)
    pairs = {
        "T2": (3.919809838127, 0.5123942727783, 7.93991988992, 6.26514511979e-05),
        "T4": (0.774889988999, 0.5656507974453, 7.65926489892, 2.09523809011e-01),
    }
    for name, figures in pairs.items():
        found = model.difference([({"Type": name}, 1.0), ({"Type": "T1"}, -1.0)])
        assert [float(each) for each in (*found, found.p_value)] == pytest.approx(figures, rel=1e-8)
    slope = model.slope(model.covariates[0])
    assert [float(each) for each in slope] == pytest.approx([-0.139144271570, 0.0801253766969, 4.69199614334], rel=1e-8)
    joint = model.fit.hotelling(np.eye(4)[:3])
    assert joint is not None
    assert [float(joint.f_value), float(joint.within)] == pytest.approx([17.8996511453, 5.29051876618], rel=1e-8)


def test_an_effect_of_two_treatments_within_blocks_is_the_test_of_their_difference() -> None:
    whole = ergo_stool()
    frame = whole.frame[whole.frame["Type"].isin(["T1", "T2"])].reset_index(drop=True)
    frame["Type"] = frame["Type"].cat.remove_unused_categories()
    model = planned_model_of(replace(whole, frame=frame, every=frame), Estimand.MEAN)
    assert isinstance(model, AdjustedMeans)
    [effect], difference = model.effects(), model.difference([({"Type": "T2"}, 1.0), ({"Type": "T1"}, -1.0)])
    assert abs(effect.statistic) == pytest.approx(abs(difference.estimate / difference.error))
    assert effect.p_value == pytest.approx(difference.p_value)


def test_adjusted_means_of_blocks_that_lack_a_run_are_those_of_a_model_of_blocks() -> None:
    whole = ergo_stool()
    frame = whole.frame.drop(index=whole.frame.index[[0, 5]]).reset_index(drop=True)
    model = planned_model_of(replace(whole, frame=frame, every=frame), Estimand.MEAN)
    assert isinstance(model, AdjustedMeans)
    table = frame.rename(columns={VALUE: "y", covariate_column("x"): "x", " block": "b"})
    expected = smf.ols("y ~ C(Type) + C(b) + x", table).fit()
    for name in ("T1", "T2", "T3", "T4"):
        found = model.difference([({"Type": name}, 1.0)]).estimate
        predicted = expected.predict(table.assign(Type=name, x=table["x"].mean()))
        assert float(found) == pytest.approx(float(predicted.mean()), rel=1e-9)


#: Adjusted means, the difference of the first and the last, and the slope, each with its standard error.
EMMEANS = {
    "L": (37.0221723966, 3.28301058542),
    "M": (26.3888888889, 2.19037058847),
    "H": (21.0333831589, 1.83093920753),
}
LOW_LESS_HIGH = (15.98878923767, 3.77167421304)
SLOPE = (1.42488789238, 0.640424186979)


def test_adjusted_means_of_factorials_are_those_of_emmeans() -> None:
    # emmeans(lm(breaks ~ wool * tension + x, warpbreaks), "tension", vcov. = vcovHC(m, "HC2")), with x as above
    rows = [(*cell, float(value)) for cell, values in data.WARP_BREAKS.items() for value in values]
    frame = pd.DataFrame(rows, columns=["wool", "tension", VALUE])
    frame["run_id"] = [f"r_{number}" for number in range(1, 55)]
    frame[covariate_column("x")] = np.arange(1.0, 55) % 7
    for name, levels in (("wool", ["A", "B"]), ("tension", ["L", "M", "H"])):
        frame[name] = pd.Categorical(frame[name], levels, ordered=True)
    measure = MeasureData("breaks", frame, frame, ("wool", "tension"), is_blocked=False, covariates=("x",))
    model = planned_model_of(measure, Estimand.MEAN)
    assert isinstance(model, AdjustedMeans)
    for level, figures in EMMEANS.items():
        found = model.difference([({"tension": level}, 1.0)])
        assert [float(found.estimate), float(found.error)] == pytest.approx(figures, rel=1e-8)
    found = model.difference([({"tension": "L"}, 1.0), ({"tension": "H"}, -1.0)])
    assert [float(found.estimate), float(found.error)] == pytest.approx(LOW_LESS_HIGH, rel=1e-8)
    slope = model.slope(model.covariates[0])
    assert [float(slope.estimate), float(slope.error)] == pytest.approx(SLOPE, rel=1e-8)


# The level and the power of the whole procedure; `python -m benchmarks covariates` has more designs.


def p_values(design: NullDesign, slope: float, effect: float = 0.0, count: int = 250) -> list[float]:
    random = np.random.default_rng(11)
    second = np.array([cell[0] == 1 for _, cell, _ in design.rows()])
    found = []
    for values in design.draw(random, count):
        drawn = random.normal(size=len(values))
        plain = design.data(values + effect * second + slope * drawn)
        frame = plain.frame.assign(**{covariate_column("x"): drawn})
        model = planned_model_of(replace(plain, frame=frame, every=frame, covariates=("x",)), Estimand.MEAN)
        assert isinstance(model, AdjustedMeans)
        found.append(float(next(model.effects()).p_value))
    return found


@pytest.mark.long
def test_the_level_holds_where_small_groups_vary_more() -> None:
    # The analysis of covariance with one variance finds a difference in 21 % here.
    rate = np.mean(np.array(p_values(NullDesign((2,), (5, 15), (3, 1)), 2.0)) < 0.05)
    assert 0.02 <= rate <= 0.09


@pytest.mark.long
def test_a_covariate_that_explains_much_adds_power() -> None:
    design = NullDesign((2,), 10)
    found = p_values(design, 3.0, effect=1.5, count=80)  # enough to tell these from each other
    assert np.mean(np.array(found) < 0.05) > 0.75  # without it: 0.17


# What is told.


def experiment(folder: Path, values: Any, covariates: Sequence[str], **more: Any) -> Any:
    plan = {"measures": ["Energy"], "covariates": list(covariates), **more.pop("plan", {})}
    measures, units = ["Energy", "Voltage"], {"Energy": "J", "Voltage": "V"}
    more = {"repetitions": 12, "shuffle": True, **more}
    made = make_experiment(folder / "made", values=values, measures=measures, units=units, analysis=plan, **more)
    return analyse(load_results(made.root))


def drained(treatments: dict[str, Any], _repetition: int) -> dict[str, Any]:
    voltage = 11 + 0.5 * RANDOM.normal()
    return {
        "Energy": 50 + 4 * (voltage - 11) + 2 * (treatments["Task"] == "Video") + RANDOM.normal() / 2,
        "Voltage": voltage,
    }


def test_slopes_adjusted_means_and_what_stands_without_are_told(tmp_path: Path) -> None:
    statistics = experiment(tmp_path, drained, ["Voltage"])
    measure = statistics.measure("Energy")
    found = measure.adjustment
    (slope,) = found.slopes
    assert slope.unit == "J per V"
    assert slope.interval.low < 4 < slope.interval.high
    assert found.residual_spread < 0.5 * found.spread
    first, second = (each.adjusted for each in found.means)
    (pair,) = measure.post_hoc[0].comparisons
    assert first - second == pytest.approx(pair.difference)
    assert measure.test.effects[0].statistic == pytest.approx(pair.statistic)
    assert "the adjusted mean of Video is higher" in measure.test.effects[0].conclusion
    (plain,) = statistics.without_covariates
    assert plain.test.method.value == "Welch's t-test"
    assert [each.mean for each in found.means] == pytest.approx([each.mean for each in plain.by_treatment])
    conclusion = statistics.standings[0].conclusion
    assert conclusion.startswith("Not adjusted for Voltage, the effect of Task on Energy is no longer significant")
    assert conclusion.endswith(": the conclusion does not stand without the adjustment.")
    assert statistics.measure("Voltage").adjustment is None


@pytest.mark.long
def test_order_and_time_are_covariates_as_well(tmp_path: Path) -> None:
    places = iter(range(1, 100))

    def value(treatments: dict[str, Any], _repetition: int) -> dict[str, Any]:
        return {"Energy": 50 - 0.5 * next(places) + RANDOM.normal() / 5, "Voltage": 1.0}

    statistics = experiment(tmp_path, value, ["order"])
    (slope,) = statistics.measure("Energy").adjustment.slopes
    assert slope.unit == "J per run"
    assert slope.value == pytest.approx(-0.5, abs=0.05)
    assert not any("Energy falls" in each for each in statistics.warnings)  # what is adjusted for is no drift
    statistics = experiment(tmp_path / "time", value, ["elapsed", "Voltage"])
    elapsed, voltage = statistics.measure("Energy").adjustment.slopes
    assert (elapsed.unit, voltage.value) == ("J per s", None)
    assert any("not adjusted for Voltage, which is the same in all runs" in each for each in statistics.warnings)


def test_runs_without_a_covariate_are_named(tmp_path: Path) -> None:
    def value(treatments: dict[str, Any], repetition: int) -> dict[str, Any]:
        return drained(treatments, repetition) | ({"Voltage": None} if repetition == 4 else {})

    statistics = experiment(tmp_path, value, ["Voltage"], shuffle=False)
    measure = statistics.measure("Energy")
    left_out = measure.left_out
    assert [(each.run_id, each.reason) for each in left_out] == [("r_7", Reason.COVARIATE), ("r_8", Reason.COVARIATE)]
    why = "Energy is compared without 2 runs of which a covariate is missing (r_7, r_8); descriptions have them."
    assert why in statistics.warnings
    assert (measure.overall.n, sum(each.n for each in measure.by_treatment)) == (24, 24)
    assert len(measure.quantiles.run_ids) == 22
    assert statistics.without_covariates[0].overall.n == 24


@pytest.mark.parametrize(
    ("voltage", "covariates", "why"),
    [
        (lambda _: None, ["Voltage"], "the covariate Voltage has no number in any run"),
        (lambda _: None, ["Volts"], "the covariate Volts has no number in any run"),
        (lambda task: float(task == "Video"), ["Voltage"], "told by treatments or other covariates completely"),
    ],
)
def test_what_cannot_be_adjusted_for_is_said(tmp_path: Path, voltage: Any, covariates: list[str], why: str) -> None:
    statistics = experiment(
        tmp_path, lambda treatments, _: {"Energy": RANDOM.normal(), "Voltage": voltage(treatments["Task"])}, covariates
    )
    measure = statistics.measure("Energy")
    assert measure.test is None
    assert why in measure.not_computed[0].why
    assert statistics.without_covariates[0].test is not None


def test_a_covariate_that_treatments_change_is_no_covariate(tmp_path: Path) -> None:
    def value(treatments: dict[str, Any], _repetition: int) -> dict[str, Any]:
        voltage = 11 + (treatments["Task"] == "Video") + 0.1 * RANDOM.normal()
        return {"Energy": 4 * voltage + RANDOM.normal(), "Voltage": voltage}

    warnings = experiment(tmp_path, value, ["Voltage"]).measure("Energy").adjustment.warnings
    assert any("Voltage differs between treatments (p < 0.001)" in each for each in warnings)
    assert any("hardly be told apart" in each for each in warnings)


def test_slopes_that_differ_are_told(tmp_path: Path) -> None:
    def value(treatments: dict[str, Any], _repetition: int) -> dict[str, Any]:
        voltage = RANDOM.normal()
        return {
            "Energy": (5 if treatments["Task"] == "Video" else -5) * voltage + RANDOM.normal() / 9,
            "Voltage": voltage,
        }

    found = experiment(tmp_path, value, ["Voltage"]).measure("Energy").adjustment
    assert found.slopes_p_value < 0.001
    assert any("Slopes of Energy over Voltage differ between treatments" in each for each in found.warnings)


@pytest.mark.long
@pytest.mark.parametrize(
    "more",
    soak_but(
        [{"blocks": "Repetition"}, {"plan": {"estimand": "rank"}}],
        [{}, {"blocks": "Repetition"}, {"plan": {"estimand": "rank"}}, {"plan": {"statistic": "anova-type"}}],
    ),
)
def test_factorials_blocks_and_ranks_are_adjusted(tmp_path: Path, more: dict[str, Any]) -> None:
    factors = [Factor("Task", ["Video", "Network", "Idle"]), Factor("Floor", ["wood", "tiles"])]
    measure = experiment(tmp_path, drained, ["Voltage", "order"], factors=factors, **more).measure("Energy")
    assert [effect.label for effect in measure.test.effects] == ["Task", "Floor", "Task x Floor"]
    assert measure.test.effects[0].is_significant
    assert all(effect.p_value is not None and effect.check.p_value is not None for effect in measure.test.effects)
    assert len(measure.adjustment.means) == 5
    assert all((each.interval is None) is ("blocks" in more) for each in measure.adjustment.means)


def test_sizes_by_rank_of_adjusted_values_have_no_interval() -> None:
    # It would know nothing of the slope: it holds in 78 to 97 %, by simulation.
    random = np.random.default_rng(5)
    rows = [(task, float(random.normal()), float(random.normal())) for task in "ab" for _ in range(6)]
    plan = AnalysisPlan(measures=["y"], covariates=["x"])
    found = analyse(designed(rows, ["Task"], {}, ["y", "x"], plan=plan)).measure("y")
    delta = next(each for each in found.test.effects[0].effect_sizes if each.name == "Cliff's delta")
    assert delta.interval is None
    why = next(each.why for each in found.not_computed if each.what.startswith("interval of Cliff's delta"))
    assert "slopes" in why
