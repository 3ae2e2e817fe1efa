"""Intervals that are looked at after each repetition hold at 95 %, all looks together; checked against simulation."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from robot_runner.core.design.repeated_intervals import (
    half_width_of,
    level_at_each_look,
    t_probability,
    t_quantile,
)


@pytest.mark.parametrize("freedom", [1, 2, 3, 4, 9, 10, 29, 199])
def test_quantiles_are_those_of_students_t(freedom: int) -> None:
    for probability in (0.5, 0.9, 0.975, 0.9999):
        assert t_quantile(probability, freedom) == pytest.approx(stats.t.ppf(probability, freedom), abs=1e-7, rel=1e-7)


@pytest.mark.parametrize("freedom", [1, 2, 5, 30])
def test_probabilities_are_those_of_students_t(freedom: int) -> None:
    for value in (-3.0, -0.2, 0.0, 1.5, 40.0):
        assert t_probability(value, freedom) == pytest.approx(stats.t.cdf(value, freedom), abs=1e-12)


@pytest.mark.parametrize("size", [1e-200, 1e-12, 1e12, 1e200])
def test_an_interval_of_very_large_and_very_small_values_is_as_wide_as_they_are_far_apart(size: float) -> None:
    values = [3.0, 4.5, 5.0, 9.0]
    wide = half_width_of([value * size for value in values], 0.95)
    assert wide == pytest.approx(half_width_of(values, 0.95) * size)


def test_an_interval_at_one_look_is_students() -> None:
    values = [3.0, 4.5, 5.0, 9.0]
    low, high = stats.t.interval(0.95, 3, loc=np.mean(values), scale=stats.sem(values))
    assert half_width_of(values, level_at_each_look(4, 4)) == pytest.approx((high - low) / 2)


@pytest.mark.long
@pytest.mark.parametrize(("first", "last"), [(5, 30), (3, 10), (10, 60)])
def test_all_looks_together_hold_at_95_percent(first: int, last: int) -> None:
    experiments = 40_000
    values = np.random.default_rng(7).standard_normal((experiments, last))
    n = np.arange(1, last + 1)
    mean = values.cumsum(axis=1) / n
    squares = (values**2).cumsum(axis=1) - n * mean**2
    mean, squares, n = mean[:, first - 1 :], squares[:, first - 1 :], n[first - 1 :]
    quantile = [t_quantile(0.5 + level_at_each_look(first, last) / 2, int(each) - 1) for each in n]
    holds = np.abs(mean) <= np.array(quantile) * np.sqrt(squares / (n - 1) / n)
    # Three standard errors of the simulation, and what the integration is right to.
    assert holds.all(axis=1).mean() == pytest.approx(0.95, abs=3 * (0.95 * 0.05 / experiments) ** 0.5 + 0.0005)


@pytest.mark.long
def test_more_looks_need_a_higher_level() -> None:
    levels = [level_at_each_look(5, last) for last in (5, 6, 10, 30, 200)]
    assert levels == sorted(levels)
    assert levels[0] == 0.95
    assert 1 - levels[-1] > 0.05 / 196, "it is cheaper than if looks knew nothing of each other"
