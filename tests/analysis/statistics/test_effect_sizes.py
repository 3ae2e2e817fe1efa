"""Sizes of effects that are far larger than chance, as simulations have them, whose p-values are next to nothing."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from tests.analysis.made_experiment import make_experiment
from tests.long_cases import long_but

from robot_runner.analysis import analyse, load_results
from robot_runner.analysis.statistics.effect_sizes import f_of_p_value, noncentralities_of_f, noncentralities_of_t
from robot_runner.analysis.statistics.tested import TestMethod
from robot_runner.core.design.analysis_plan import AnalysisPlan
from robot_runner.core.design.factor import Factor
from robot_runner.designs import Crossover, SplitPlot

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

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


@pytest.mark.parametrize("repetitions", long_but([4], [1, 4, 64]))
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
