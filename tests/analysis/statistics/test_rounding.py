"""What rounding leaves behind is no chance that effects could be compared with, and does not hide what varies."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from tests.analysis.made_experiment import make_experiment
from tests.analysis.statistics.designed_data import designed

from robot_runner import AnalysisPlan, Estimand
from robot_runner.analysis import analyse, load_results
from robot_runner.analysis.statistics.effect_coding import coded_columns
from robot_runner.analysis.statistics.robust_covariance import fit_robustly
from robot_runner.analysis.wording import TIMES
from robot_runner.core.design.factor import Factor
from robot_runner.designs import OneFactorAtATime, SplitPlot

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from robot_runner.analysis.statistics.outcome import MeasureStatistics

TASKS = Factor("Task", ["Video", "Network", "Idle"])
MAPS = Factor("Map", ["lab", "hall", "street"])
ADDED = {"Video": 0.0, "Network": 0.3, "Idle": 0.7, "lab": 0.2, "hall": 0.5, "street": 0.0}
#: What a block adds to all of its values.
BLOCKS = (5.1, 8.6, 2.2, 8.6, 3.5, 4.4, 7.6, 4.3)


def energy(
    folder: Path, value: Callable[[Mapping[str, Any], int], float | None], factors: list[Factor], **made: Any
) -> MeasureStatistics:
    """Return the statistics of an experiment with these values; None is a run that is not done."""

    def values(treatments: Mapping[str, Any], repetition: int) -> dict[str, Any] | None:
        found = value(treatments, repetition)
        return None if found is None else {"Energy": float(found)}

    return analyse(load_results(make_experiment(folder / "made", factors, values, **made).root)).measure("Energy")


@pytest.mark.parametrize("treatments", [2, 3])
def test_blocks_that_respond_alike_tell_no_chance(tmp_path: Path, treatments: int) -> None:
    task = Factor("Task", TASKS.treatments[:treatments])
    plan = {"measures": ["Energy"], "blocks": "Repetition"}
    found = energy(
        tmp_path,
        lambda of, repetition: BLOCKS[repetition - 1] + ADDED[of["Task"]],
        [task],
        repetitions=8,
        analysis=plan,
    )
    assert found.test is None
    assert "all blocks respond to the treatments in the same way" in found.not_computed[0].why


def test_a_difference_that_is_the_same_in_all_blocks_has_no_p_value(tmp_path: Path) -> None:
    noise = np.random.default_rng(1).normal(size=8)

    def value(of: Mapping[str, Any], repetition: int) -> float:
        added: float = {"lab": 0.2, "hall": 0.5, "street": float(noise[repetition - 1])}[of["Map"]]
        return BLOCKS[repetition - 1] + added

    found = energy(tmp_path, value, [MAPS], repetitions=8, analysis={"measures": ["Energy"], "blocks": "Repetition"})
    pairs = {(pair.first, pair.second): pair for pair in found.post_hoc[0].comparisons}
    assert pairs["lab", "hall"].p_value is None
    assert pairs["lab", "street"].p_value is not None


def test_incomplete_blocks_that_respond_alike_tell_no_chance(tmp_path: Path) -> None:
    def value(of: Mapping[str, Any], repetition: int) -> float | None:
        is_lacking = (TASKS.treatments.index(of["Task"]) + MAPS.treatments.index(of["Map"]) + repetition) % 3 == 0
        return None if is_lacking else BLOCKS[repetition - 1] + ADDED[of["Task"]] + ADDED[of["Map"]]

    plan = {"measures": ["Energy"], "blocks": "Repetition"}
    found = energy(tmp_path, value, [TASKS, MAPS], repetitions=3, analysis=plan)
    assert found.test is None
    assert found.not_computed[0].why == "all blocks respond alike, so that there is no variation to test against."


def test_single_runs_that_add_up_exactly_tell_no_chance_however_far_from_0_they_are(tmp_path: Path) -> None:
    found = energy(tmp_path, lambda of, _: 1e6 + ADDED[of["Task"]] + ADDED[of["Map"]], [TASKS, MAPS], repetitions=1)
    assert found.test is None
    assert "there is no variation to test against" in found.not_computed[0].why


@pytest.mark.parametrize("blocks", [None, "Repetition"])
def test_what_the_means_of_equal_values_leave_of_them_is_nothing_that_is_checked_or_drawn(
    tmp_path: Path, blocks: str | None
) -> None:
    # Residuals of 1e-17 were said to be distributed normally (W = 0.972).
    plan = {"measures": ["Energy"]} | ({"blocks": blocks} if blocks else {})
    added = 0.1 if blocks else 0
    found = energy(
        tmp_path,
        lambda of, repetition: 0.11 + ADDED[of["Task"]] + added * repetition,
        [TASKS],
        repetitions=7,
        analysis=plan,
    )
    assert [each for each in found.assumptions if not each.treatments] == []
    assert (found.quantiles, found.drift) == (None, None)
    assert "all values are equal." in {each.why for each in found.not_computed}


@pytest.mark.parametrize("estimand", ["mean", "rank"])
def test_the_same_values_in_another_order_differ_by_nothing(estimand: str) -> None:
    rows = [("Video", value) for value in (0.1, 0.2, 0.7, 0.4)] + [("Idle", value) for value in (0.1, 0.2, 0.4, 0.7)]
    plan = AnalysisPlan("y", estimand=Estimand(estimand))
    found = analyse(designed(rows, ["Task"], {}, plan=plan)).measure("y")
    assert found.test is not None
    assert (found.test.effects[0].statistic, found.post_hoc[0].comparisons[0].difference) == (0.0, 0.0)  # not -4e-16


@pytest.mark.parametrize(("offset", "spread"), [(1e9, 0.05), (1.7e12, 100.0)])
def test_values_far_from_0_that_vary_are_compared(tmp_path: Path, offset: float, spread: float) -> None:
    noise = np.random.default_rng(2).normal(size=(2, 6))
    found = energy(
        tmp_path,
        lambda of, repetition: (
            offset + spread * (noise[int(of["Task"] == "Video"), repetition - 1] + 4 * (of["Task"] == "Video"))
        ),
        [Factor("Task", ["Video", "Network"])],
        repetitions=6,
    )
    assert found.test is not None
    assert found.test.effects[0].is_significant
    assert found.test.spread == pytest.approx(spread, rel=0.5)


@pytest.mark.parametrize(
    ("offset", "step", "told"),
    [(1.764e18, 256, "256"), (2.0**53, 2, "2.00"), (1e6, 2.0**-33 * 16, f"1.16{TIMES}10⁻¹⁰")],
)
def test_values_that_differ_by_too_little_beside_their_size_are_not_called_equal(
    tmp_path: Path, offset: float, step: float, told: str
) -> None:
    found = energy(
        tmp_path,
        lambda of, repetition: offset + step * (repetition**2 % 5 + (of["Task"] == "Video")),
        [Factor("Task", ["Video", "Network"])],
        repetitions=6,
    )
    assert found.test is None
    reasons = {each.what: each.why for each in found.not_computed}
    assert f"told apart by {told} only" in reasons["spreads in full"]
    assert "differ by too little" in reasons["the test"]
    assert not any("equal" in why for why in reasons.values())


def test_measures_that_hardly_vary_beside_their_size_are_not_called_equal_where_they_are_correlated(
    tmp_path: Path,
) -> None:
    made = make_experiment(
        tmp_path / "made",
        values=lambda _, repetition: {"Begun": 2.0**53 + 2 * repetition, "Energy": repetition**2.0},
        measures=("Begun", "Energy"),
        repetitions=5,
    )
    [correlation] = [each for each in analyse(load_results(made.root)).not_computed if "correlation" in each.what]
    assert correlation.why == "one of them hardly varies relative to its size."


@pytest.mark.parametrize("value", [lambda number: 0.1 * number / number, lambda _: 2.0**60])
def test_values_that_are_equal_but_for_rounding_are_called_equal(tmp_path: Path, value: Callable[[int], float]) -> None:
    found = energy(tmp_path, lambda _, repetition: value(repetition), [Factor("Task", ["Video", "Network"])])
    assert all("all values are equal" in each.why for each in found.not_computed if each.what == "the test")
    assert "spreads in full" not in {each.what for each in found.not_computed}


@pytest.mark.parametrize("size", [3e98, 3e-98])
def test_values_whose_squared_variances_cannot_be_computed_are_told(tmp_path: Path, size: float) -> None:
    noise = iter(np.random.default_rng(3).normal(size=10))
    found = energy(tmp_path, lambda *_: size * next(noise), [Factor("Task", ["Video", "Network"])], repetitions=5)
    assert found.test is None
    assert "to compute with" in found.not_computed[0].why


def test_a_fraction_of_which_most_effects_are_none_is_not_tested() -> None:
    rows = [
        (*of, "-+"[of.count("+") % 2 == 0], 12.1 + 0.7 * (of[0] == "+") + 0.2 * (of[1] == "+"))
        for of in product("-+", repeat=3)
    ]
    [found] = analyse(designed(rows, ["A", "B", "C", "D"], {"kind": "fractional_factorial"})).measures
    assert found.test is None
    assert found.not_computed[0].why == "most effects are none at all, so that there is no variation to test against."


@pytest.mark.parametrize("seed", range(3))
def test_treatments_that_do_not_vary_are_not_compared_by_what_least_squares_leave_of_those_that_do(
    tmp_path: Path, seed: int
) -> None:
    random = np.random.default_rng(seed)

    def value(of: Mapping[str, Any], repetition: int) -> float:
        return 5.0 if of["Cpu"] == "slow" else 5.0 + random.normal()

    factors = [Factor("Cpu", ["slow", "fast"]), Factor("Net", ["a", "b"]), Factor("Map", ["x", "y", "z"])]
    found = energy(tmp_path, value, factors, chosen=OneFactorAtATime())
    assert found.test is not None
    assert [each.p_value is None for each in found.test.effects] == [False, True, True]
    pairs = {each.factors[0]: [pair.p_value for pair in each.comparisons] for each in found.post_hoc}
    assert pairs["Net"] == [None]
    assert pairs["Map"] == [None, None]


def test_whole_plots_that_add_up_exactly_tell_no_chance_of_their_factors(tmp_path: Path) -> None:
    """The means of the whole plots are 16/3, 1281/3, 19/3 and 1284/3: those of two effects, but for rounding."""
    values = {1: (5, 6, 5), 2: (427, 428, 426), 3: (6, 5, 8), 4: (427, 429, 428)}

    def value(of: Mapping[str, Any], repetition: int) -> float:
        return float(values[of["Plot"]][TASKS.treatments.index(of["Task"])])

    floors, loads = Factor("Floor", ["wood", "tiles"]), Factor("Load", ["yes", "no"])
    factors = [floors, loads, Factor("Plot", [1, 2, 3, 4]), TASKS]
    found = energy(tmp_path, value, factors, chosen=SplitPlot(["Floor", "Load"], "Plot"), repetitions=1)
    assert found.test is not None
    p_values = {each.label: each.p_value for each in found.test.effects}
    assert (p_values["Floor"], p_values["Load"]) == (None, None)
    assert p_values["Task"] is not None


def test_repeated_runs_that_are_the_same_show_no_lack_of_fit() -> None:
    corners = [(float(x), float(y)) for x, y in product((-1, 0, 1), repeat=2) if (x, y) != (0, 0)]
    rows = [(x, y, round(3.1 + 0.3 * x + 0.2 * y + 0.11 * x * x + 0.1 * (x * y > 0), 1)) for x, y in corners]
    rows += [(0.0, 0.0, value) for value in (3.1, 3.1, 3.1, 3.1, 3.1 + 4e-16)]
    facts = {"kind": "response_surface", "model": "quadratic", "ranges": {"X": [-1, 1], "Y": [-1, 1]}}
    [found] = analyse(designed(rows, ["X", "Y"], facts)).measures
    assert found.surface is not None
    assert found.surface.lack_of_fit is None


def test_sums_that_are_singular_but_for_rounding_are_not_tested_together() -> None:
    """Slopes that differ between treatments, of fourteen runs and thirteen coefficients, in several orders."""
    a = np.array([1, 3, 2, 1, 3, 2, 2, 0, 0, 3, 1, 1, 0, 2])
    b = np.array([0, 0, 0, 1, 1, 1, 0, 1, 0, 0, 0, 1, 1, 1])
    x = np.array([5.5, -3.5, -0.5, 3.5, -2.5, -6.5, 0.5, 6.5, 4.5, 2.5, -1.5, -5.5, 1.5, -4.5]) / 4.18
    codes, sizes = {"A": a, "B": b}, {"A": 4, "B": 2}
    one, other, both = (coded_columns(codes, sizes, term) for term in (("A",), ("B",), ("A", "B")))
    exog = np.column_stack([np.ones(14), one, other, both, x, x[:, None] * one, x[:, None] * other])
    for seed in range(100):
        order = np.random.default_rng(seed).permutation(14)
        assert fit_robustly(exog[order], np.arange(14.0)[order]).hotelling(np.eye(13)[-4:]) is None


def test_treatments_of_the_same_sum_have_no_pattern_of_signs_that_is_nearer_to_0(tmp_path: Path) -> None:
    """Of the contrasts some 1e-16 is left, as of other patterns whose sums are 0."""
    counts = [3, 2, 2, 1, 0]  # each block has them, the next one a place further, and three have 2 of each
    found = energy(
        tmp_path,
        lambda of, block: counts[(of["Speed"] - block) % 5] if block <= 5 else 2,
        [Factor("Speed", range(5))],
        repetitions=8,
        blocks="Repetition",
    )
    assert found.test is not None
    assert "sign flips" in found.test.effects[0].test
    assert found.test.effects[0].p_value == 1


def test_a_statistic_that_is_0_but_for_rounding_is_told_as_0(tmp_path: Path) -> None:
    """Single runs, so that a linear model is fitted: of its F some 1e-31 is left."""
    values = {("lab", "Video"): 3, ("lab", "Network"): 1, ("lab", "Idle"): 3}
    values |= {("hall", "Video"): 1, ("hall", "Network"): 3, ("hall", "Idle"): 3}
    found = energy(
        tmp_path,
        lambda of, _: values[of["Map"], of["Task"]] / 3,
        [Factor("Map", ["lab", "hall"]), TASKS],
        repetitions=1,
    )
    assert found.test is not None
    assert found.test.effects[0].statistic == 0
    assert "F(1, 2) = 0, p = 1.000" in found.test.effects[0].conclusion
