"""Sizes of effects that are far larger than chance, as simulations have them, whose p-values are next to nothing."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from benchmarks.designed_nulls import DesignedNull, data_of
from benchmarks.null_designs import NullDesign
from tests.analysis.made_experiment import make_experiment
from tests.long_cases import long_but, soak_but

from robot_runner.analysis import analyse, load_results
from robot_runner.analysis.statistics.analysed_design import VALUE
from robot_runner.analysis.statistics.effect_sizes import (
    cohens_d,
    f_of_p_value,
    noncentralities_of_f,
    noncentralities_of_t,
    omega_squared,
)
from robot_runner.analysis.statistics.tested import NotComputed, TestMethod
from robot_runner.analysis.statistics.tests import planned_model_of
from robot_runner.core.design.analysis_plan import AnalysisPlan, Estimand
from robot_runner.core.design.factor import Factor
from robot_runner.designs import Crossover, SplitPlot

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from robot_runner.analysis.statistics.tests import AnyModel

#: `qf(p, df1, df2, lower.tail = FALSE)` of R 4.2.
QUANTILES = [
    (4.11429377292715e-14, (2, 33.31803265646995), 89.3055009102836),
    (1e-8, (3, 20), 40.9515860983881),
    (1e-30, (3, 40), 443.94640253374797),
    (0.05, (2, 20), 3.49282847673563),
]


@pytest.mark.parametrize(("p_value", "freedom", "f_value"), QUANTILES)
def test_the_f_of_a_p_value_is_that_of_r_however_small_the_p_value_is(
    p_value: float, freedom: tuple[float, float], f_value: float
) -> None:
    assert f_of_p_value(p_value, freedom) == pytest.approx(f_value, rel=1e-12)


@pytest.mark.parametrize(("step", "has_interval"), [(2, True), (10, True), (1e7, False)])
def test_an_effect_of_three_treatments_has_a_size_however_clear_it_is(
    tmp_path: Path, step: float, has_interval: bool
) -> None:
    random = np.random.default_rng(1)

    def values(treatments: dict[str, Any], repetition: int) -> dict[str, Any]:
        return {"Energy": 1000 + step * "abc".index(treatments["Task"]) + random.normal()}

    folder = make_experiment(tmp_path / "made", [Factor("Task", ["a", "b", "c"])], values, repetitions=20).root
    measure = analyse(load_results(folder)).measure("Energy")
    assert measure.test is not None
    (effect,) = measure.test.effects
    assert effect.p_value is not None
    assert effect.p_value < 1e-16
    (size,) = effect.effect_sizes
    # Three means a step from each other, of a spread of about 1: their variance is two thirds of the step's square.
    assert size.value == pytest.approx(1 - 1 / (1 + step**2 * 2 / 3), abs=0.07)
    assert "the effect is large, omega squared = " in effect.conclusion
    assert (size.interval is not None) is has_interval
    missing = [each.what for each in measure.not_computed]
    assert ("interval of omega squared of Task" in missing) is not has_interval


DAYS, TASKS = Factor("Day", [f"day {number}" for number in range(1, 9)]), Factor("Task", ["a", "b"])
#: Factors, and what tells how runs of one combination that share a day, or a person, are taken together.
SHARED: Mapping[str, tuple[list[Factor], dict[str, Any]]] = {
    "in blocks": ([DAYS, TASKS], {"blocks": "Day"}),
    "in blocks some of which lack a treatment": ([DAYS, TASKS], {"blocks": "Day"}),
    "between blocks": ([DAYS, TASKS], {"blocks": "Day"}),
    "in a crossover": ([TASKS, DAYS, Factor("Period", [1, 2])], {"chosen": Crossover("Day", "Period")}),
}


@pytest.mark.parametrize("repetitions", [*long_but([4], [1, 4]), pytest.param(64, marks=pytest.mark.soak)])
@pytest.mark.parametrize("design", SHARED)
def test_an_effect_is_told_in_standard_deviations_of_runs_however_many_share_a_block(
    tmp_path: Path, design: str, repetitions: int
) -> None:
    factors, more = SHARED[design]
    # Runs of a cell have a standard deviation of 1, and their means vary between blocks as means of such runs do.
    deviations = np.random.default_rng(3).normal(size=repetitions) if repetitions > 1 else np.ones(1)
    deviations = (deviations - deviations.mean()) / (deviations.std(ddof=1) if repetitions > 1 else 1)
    response = float(np.sqrt((3 / 4 if "between" in design else 7 / 16) / repetitions))

    def values(treatments: dict[str, Any], repetition: int) -> dict[str, Any] | None:
        day, is_b = DAYS.treatments.index(treatments["Day"]), treatments["Task"] == "b"
        is_left_out = is_b == (day < 4) if "between" in design else "lack" in design and day < 3 and is_b == day % 2
        if is_left_out:
            return None
        own = response * (1 if is_b else -1) * (1, 1, -1, -1)[day % 4]
        return {"Energy": 50.0 + day * ("between" not in design) + is_b + own + float(deviations[repetition - 1])}

    folder = make_experiment(tmp_path / "made", factors, values, repetitions=repetitions, **more).root
    measure = analyse(load_results(folder)).measure("Energy")
    assert measure.test is not None
    size = next(each for each in measure.test.effects if each.factors == ("Task",)).effect_sizes[0]
    assert size.name == "Cohen's d"
    is_exact = design in {"in blocks", "between blocks"}
    assert size.value == pytest.approx(-1.0, abs=1e-9 if is_exact else 0.4)


@pytest.mark.parametrize("f_value", [1e11, 1e17, 1e40])
def test_an_f_or_a_t_that_no_library_inverts_is_given_up_at_once(f_value: float) -> None:
    assert noncentralities_of_f(f_value, (2, 33.3), 0.9) is None
    assert noncentralities_of_t(-(f_value**0.5) - 1, 18, 0.95) is None


@pytest.mark.long
@pytest.mark.parametrize("is_between", [False, True])
def test_a_covariate_changes_nothing_about_the_standard_deviation_of_runs_that_share_a_block(
    tmp_path: Path, is_between: bool
) -> None:
    random, days = np.random.default_rng(8), Factor("Day", [f"day {number}" for number in range(1, 7)])

    def values(treatments: dict[str, Any], repetition: int) -> dict[str, Any] | None:
        day, is_b = days.treatments.index(treatments["Day"]), treatments["Task"] == "b"
        if is_between and is_b != day % 2:
            return None
        own = (3.0 if is_b else -3.0) * (1, 1, -1, -1, 2, -2)[day]
        return {"Energy": 50.0 + is_b + own + float(random.normal()), "Voltage": float(random.normal())}

    measures, plan = ["Energy", "Voltage"], {"measures": ["Energy"]}
    given: dict[str, Any] = {"repetitions": 6, "blocks": "Day", "measures": measures}
    folder = make_experiment(tmp_path / "made", [days, TASKS], values, analysis=plan, **given)
    results = load_results(folder.root)
    plain = analyse(results).measure("Energy").test
    adjusted = analyse(results, plan=AnalysisPlan(measures=["Energy"], covariates=["Voltage"])).measure("Energy").test
    assert plain is not None
    assert adjusted is not None
    assert adjusted.method is TestMethod.COVARIANCE
    assert adjusted.spread == pytest.approx(plain.spread)


def test_a_run_that_a_whole_plot_lost_hardly_changes_an_effect(tmp_path: Path) -> None:
    plots, floors = Factor("Plot", list(range(1, 9))), Factor("Floor", ["wood", "carpet"])
    found = []
    for lost in (False, True):
        random = np.random.default_rng(9)

        def values(treatments: dict[str, Any], _: int, lost: bool = lost, random: Any = random) -> Any:
            noise, plot = float(random.normal()), treatments["Plot"]
            if lost and plot == 3 and treatments["Task"] == "a":
                return None
            return {"Energy": 50.0 + 5 * (1, 1, -1, -1)[plot % 4] + 3 * (treatments["Floor"] == "wood") + noise}

        design = SplitPlot("Floor", "Plot")
        folder = make_experiment(tmp_path / f"{lost}", [plots, floors, TASKS], values, repetitions=1, chosen=design)
        test = analyse(load_results(folder.root)).measure("Energy").test
        assert test is not None
        found.append((test.method, test.spread))
    (method, spread), (method_of_lost, spread_of_lost) = found
    assert (method, method_of_lost) == (TestMethod.SPLIT_PLOT, TestMethod.MIXED_MODEL)
    assert spread_of_lost == pytest.approx(spread, rel=0.05)


def rank_biserial(folder: Path, covariates: tuple[str, ...] = ()) -> float:
    plan = AnalysisPlan(measures=["Energy"], covariates=covariates, blocks="Room")
    measure = analyse(load_results(folder), plan=plan).measure("Energy")
    pairs = next(each for each in measure.post_hoc if each.factors == ("Task",)).comparisons
    return next(each.value for each in pairs[0].effect_sizes if each.name == "rank-biserial correlation")


ROOMS, LOADS = Factor("Room", list("abcdefghij")), Factor("Load", ["low", "high"])


@pytest.mark.long
@pytest.mark.parametrize("is_lost", [False, True])
@pytest.mark.parametrize("covariates", [(), ("Voltage",)])
def test_a_block_that_lacks_a_combination_tells_nothing_of_the_sign_of_a_difference(
    tmp_path: Path, is_lost: bool, covariates: tuple[str, ...]
) -> None:
    random = np.random.default_rng(5)

    def values(treatments: dict[str, Any], repetition: int) -> dict[str, Any] | None:
        room, is_a, is_high = (treatments["Room"], treatments["Task"] == "a", treatments["Load"] == "high")
        # Of the others, one combination has more runs: each counts the same in the mean of a task.
        if (room in "ab" and is_lost and is_a and is_high) or (repetition > 1 and (is_a or not is_high)):
            return None
        return {"Energy": 100.0 * is_high + is_a + 0.1 * float(random.normal()), "Voltage": float(random.normal())}

    made = {"repetitions": 3, "measures": ["Energy", "Voltage"]}
    folder = make_experiment(tmp_path / "made", [ROOMS, TASKS, LOADS], values, **made).root
    assert rank_biserial(folder, covariates) == 1.0


def test_differences_within_blocks_that_are_equal_but_for_rounding_are_ties(tmp_path: Path) -> None:
    without = dict(zip("abcdefgh", (0.2, 0.1, 0.3, 0.6, 0.9, 1.2, 0.7, 1.0), strict=True))
    beside = dict(zip("abcdefgh", (0.3, 0.2, 0.4, 0.7, 0.8, 1.1, 0.6, 0.9), strict=True))  # 0.1 more, or less

    def values(treatments: dict[str, Any], _: int) -> dict[str, Any]:
        return {"Energy": (beside if treatments["Task"] == "a" else without)[treatments["Room"]]}

    rooms = Factor("Room", list(without))
    folder = make_experiment(tmp_path / "made", [rooms, TASKS], values, repetitions=1).root
    assert rank_biserial(folder) == 0.0  # 0.28 where 0.3 - 0.2 is less than 0.2 - 0.1


#: Designs in which the standard deviation of a run is known better, or worse, than the difference; the factor whose
#: first two treatments are compared, and the standard deviation. Taken to be known as the difference is, the interval
#: of a d of 3 covers it in 99 to 100 % of experiments, in 92 % (spreads that differ) and in 83 % (a split plot).
KNOWN_OTHERWISE: dict[str, tuple[NullDesign | DesignedNull, str, float]] = {
    "blocks of several runs": (NullDesign((2,), 4, blocks=6), "F0", 1.0),
    "blocks of several treatments": (NullDesign((4,), 1, blocks=6), "F0", 1.0),
    "blocks of several runs that respond differently": (NullDesign((2,), 4, 0.6, blocks=6, response=0.8), "F0", 1.0),
    "a factor within blocks beside one between them": (NullDesign((2, 2), 3, blocks=4, between=1), "F1", 10**0.5),
    "many treatments": (NullDesign((8,), 5), "F0", 1.0),
    "treatments with a spread of their own": (NullDesign((4,), 5, (1, 1, 1, 10)), "F0", (103 / 4) ** 0.5),
    "incomplete blocks": (NullDesign((3,), 2, blocks=12, lacking=1), "F0", 1.0),
    "a split plot": (
        DesignedNull(
            "split plot",
            {"kind": "split_plot", "whole_plot": "Plot"},
            ("Plot", "Hard", "Easy"),
            [(f"p{plot}", f"h{plot % 2}", f"e{easy}") for plot in range(6) for easy in range(4)],
            {"Plot": 2.0},
        ),
        "Easy",
        5**0.5,
    ),
}


#: Those that are looked at every time, for d and for omega squared, whose intervals are dear; all are in `make soak`.
EACH_D = soak_but({"treatments with a spread of their own"}, KNOWN_OTHERWISE)
EACH_OMEGA = soak_but({"blocks of several treatments"}, KNOWN_OTHERWISE)


def simulated(name: str, size: float) -> Iterator[AnyModel]:
    """Yield the models of experiments whose first treatment lies so many standard deviations above the others."""
    design, factor, spread = KNOWN_OTHERWISE[name]
    drawn = design.draw(np.random.default_rng(12), 400)
    data = design.data(drawn[0]) if isinstance(design, NullDesign) else data_of(design, drawn[0])
    shift = size * spread * (data.frame[factor].astype(str) == data.levels(factor)[0]).to_numpy()
    for values in drawn + shift:
        frame = data.frame.assign(**{VALUE: values})
        model = planned_model_of(replace(data, frame=frame, every=frame), Estimand.MEAN)
        assert not isinstance(model, NotComputed)
        yield model


@pytest.mark.long
@pytest.mark.parametrize("name", EACH_D)
def test_the_interval_of_d_holds_as_often_as_it_says(name: str) -> None:
    factor, covered = KNOWN_OTHERWISE[name][1], []
    for model in simulated(name, 3.0):
        first, second = model.factors[factor][:2]
        found = model.difference([({factor: first}, 1.0), ({factor: second}, -1.0)])
        estimate, error, freedom = map(float, found)
        size = cohens_d(estimate, error, freedom, float(model.spread), model.spread_parts)
        assert size is not None
        assert size.interval is not None
        assert (size.interval.low > 0 or size.interval.high < 0) == (found.p_value < 0.05)
        covered.append(size.interval.low <= 3 <= size.interval.high)
    assert 0.93 <= np.mean(covered) <= 0.99


@pytest.mark.long
@pytest.mark.parametrize("name", EACH_OMEGA)
def test_the_interval_of_omega_squared_holds_as_often_as_it_says(name: str) -> None:
    factor, covered = KNOWN_OTHERWISE[name][1], []
    for model in simulated(name, 2.0):
        effect = next(each for each in model.effects() if each.factors == (factor,))
        rest, count = float(effect.freedom[-1]), len(model.factors[factor])
        freedom = (1.0 if len(effect.freedom) == 1 else float(effect.freedom[0]), rest)
        f_value, p_value = f_of_p_value(float(effect.p_value), freedom), float(effect.p_value)
        of_runs = (float(effect.variance), float(model.spread), model.spread_parts)
        size = omega_squared(f_value, freedom, *of_runs, alpha=0.05, is_partial=False)
        assert size is not None
        assert size.interval is not None
        assert (size.interval.low > 0) == (p_value < 0.05)
        true = 4 * (count - 1) / count**2  # one of so many treatments lies two standard deviations above the others
        covered.append(size.interval.low <= true / (1 + true) <= size.interval.high)
    assert 0.87 <= np.mean(covered) <= 0.96
