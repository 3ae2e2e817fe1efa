"""Ranks of few runs are tested where their test holds its level, and else not at all."""

from __future__ import annotations

from itertools import permutations
from typing import TYPE_CHECKING

import numpy as np
import pytest
from scipy import stats
from tests.analysis.statistics.reference_data import one_factor, two_factors

from robot_runner.analysis.statistics.cell_layout import layout_of
from robot_runner.analysis.statistics.cell_means import CellMeans
from robot_runner.analysis.statistics.linear_model import FittedModel
from robot_runner.analysis.statistics.post_hoc import compare_pairs
from robot_runner.analysis.statistics.tested import NotComputed, TestMethod
from robot_runner.analysis.statistics.tests import Choices, carry_out, model_of
from robot_runner.core.design.analysis_plan import Estimand, Statistic

if TYPE_CHECKING:
    from robot_runner.analysis.statistics.analysed_design import MeasureData

RANDOM = np.random.default_rng(11)


def sized(*sizes: int) -> MeasureData:
    """Return a measure of one factor whose treatments have so many runs."""
    return one_factor({f"t{place}": list(RANDOM.normal(size=size)) for place, size in enumerate(sizes)})


def false_positives(data: MeasureData, orders: np.ndarray) -> float:
    """Return in how many of some orders, which are equally probable without an effect, ranks differ at 5 %."""
    layout = layout_of(data)
    assert layout is not None
    with np.errstate(all="ignore"):
        (effect,) = CellMeans.of_values(layout, orders, Estimand.RANK, draws=99).effects()
        return float(np.mean(effect.p_value < 0.05))


@pytest.mark.parametrize("sizes", [(3, 3), (2, 3), (2, 8), (3, 10), (2, 5, 5)])
def test_ranks_of_too_few_runs_are_not_tested(sizes: tuple[int, ...]) -> None:
    found = model_of(sized(*sizes), Estimand.RANK)
    assert isinstance(found, NotComputed)
    assert "few runs" in found.why


def false_positives_of_least_squares(levels: tuple[int, int]) -> float:
    """Return how often the ranks of single runs of each combination differ at 5 % by either factor, for all orders."""
    a, b = (each.ravel() for each in np.indices(levels))
    dummies = [np.eye(count)[places][:, 1:] for count, places in zip(levels, (a, b), strict=True)]
    size, ones = len(a), np.ones((len(a), 1))
    few = size <= 6
    orders = np.array(list(permutations(range(size))) if few else [RANDOM.permutation(size) for _ in range(5000)]).T

    def left(*columns: np.ndarray) -> np.ndarray:
        design = np.hstack([ones, *columns])
        return np.sum((orders - design @ np.linalg.lstsq(design, orders)[0]) ** 2, axis=0)

    beyond = size - sum(levels) + 1
    error = np.maximum(left(*dummies), 1e-9) / beyond
    shares = []
    for tested, other in (dummies, dummies[::-1]):
        count = tested.shape[1]
        f_values = (left(other) - left(*dummies)) / count / error
        shares.append(float(np.mean(stats.f.sf(f_values, count, beyond) < 0.05)))
    return max(shares)


@pytest.mark.parametrize(("levels", "is_tested"), [((2, 2), False), ((2, 3), False), ((2, 4), True), ((3, 3), True)])
def test_ranks_in_a_linear_model_are_tested_where_least_squares_hold_their_level(
    levels: tuple[int, int], is_tested: bool
) -> None:
    data = two_factors({(f"a{a}", f"b{b}"): [float(RANDOM.normal())] for a, b in np.ndindex(levels)})
    found = model_of(data, Estimand.RANK)
    assert isinstance(found, FittedModel) is is_tested
    assert is_tested or "it takes 7 runs, and 2 more than the model has coefficients" in getattr(found, "why", "")
    assert isinstance(model_of(data, Estimand.MEAN), FittedModel)
    assert (false_positives_of_least_squares(levels) <= 0.08) is is_tested


def test_beside_means_of_too_few_runs_stands_no_check() -> None:
    data = one_factor({"a": [1.0, 2.0, 3.0], "b": [4.0, 5.5, 6.0]})
    model = model_of(data, Estimand.MEAN)
    assert not isinstance(model, NotComputed)
    test = carry_out(data, model, Choices())
    (pairs,), _ = compare_pairs(data, model, test, Choices())
    assert test.effects[0].p_value is not None
    assert test.effects[0].check is None
    assert pairs.comparisons[0].check_p_value is None
    assert any("ranks" in note for note in test.notes)


def test_the_ranks_of_four_and_four_runs_differ_in_6_of_70_orders_at_most() -> None:
    orders = np.array(list(permutations(range(8))))[::7].astype(float)  # 5,760 of them, from all over
    assert false_positives(sized(4, 4), orders) == pytest.approx(4 / 70, abs=0.005)


def test_ranks_of_many_small_groups_seldom_differ_by_chance() -> None:
    orders = np.random.default_rng(3).normal(size=(1000, 80))
    assert false_positives(sized(*[4] * 20), orders) < 0.06  # 13 % by Welch-James and ANOVA-type together


def test_ranks_are_compared_by_the_anova_type_statistic_as_its_authors_do() -> None:
    data = sized(5, 5, 5)
    model = model_of(data, Estimand.RANK)
    assert isinstance(model, CellMeans)
    assert model.method is TestMethod.ANOVA_TYPE
    assert [each.test for each in model.effects()] == ["ANOVA-type"]
    chosen = model_of(data, Estimand.RANK, Statistic.WELCH_JAMES)
    assert isinstance(chosen, CellMeans)
    assert chosen.method is TestMethod.WELCH_ANOVA


def test_the_tests_of_several_factors_are_called_what_they_are() -> None:
    data = two_factors({(a, b): list(RANDOM.normal(size=5)) for a in "xyz" for b in "pq"})
    methods = {}
    for statistic in Statistic:
        model = model_of(data, Estimand.MEAN, statistic)
        assert isinstance(model, CellMeans)
        methods[statistic] = model.method
    assert methods == {
        Statistic.COMBINED: TestMethod.COMBINED,
        Statistic.WELCH_JAMES: TestMethod.WELCH_JAMES,
        Statistic.ANOVA_TYPE: TestMethod.ANOVA_TYPE,
    }
