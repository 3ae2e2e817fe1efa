"""The slope of Theil and Sen is that of scipy, and does not hold all pairs of values."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from scipy import stats

from robot_runner.analysis.statistics import theil_sen as module
from robot_runner.analysis.statistics.theil_sen import theil_sen

MANY = 2_401
#: Scipy goes through all pairs: of a sixth of the values, a thirty-sixth. The other way is taken for these as well.
SOME, MOST_AT_ONCE = 401, 300


def values_of(kind, count):
    random = np.random.default_rng(7)
    return {
        "drifting": random.normal(870.0, 3.0, count) + 0.002 * np.arange(count),
        "whole numbers": random.integers(0, 4, count).astype(float),
        "mostly alike": np.where(random.random(count) < 0.9, 0.0, random.normal(size=count)),
        "heavy tails": random.standard_cauchy(count),
        "far from 0": 50 + 1e-9 * random.normal(size=count),
        "a step": np.repeat([0.0, 1.0], [count // 2, count - count // 2]),
    }[kind]


@pytest.mark.parametrize("kind", ["drifting", "whole numbers", "mostly alike", "heavy tails", "far from 0", "a step"])
@pytest.mark.parametrize(("level", "least"), [(0.95, 1), (0.99, 1), (0.95, 0)])  # 0: some places are alike
def test_it_is_the_slope_of_scipy_to_the_last_digit(kind, level, least, monkeypatch):
    monkeypatch.setattr(module, "_MOST_AT_ONCE", MOST_AT_ONCE)
    values = values_of(kind, SOME)
    places = np.cumsum(np.random.default_rng(3).integers(least, 4, SOME)).astype(float)
    expected = stats.theilslopes(values, places, alpha=level)
    assert theil_sen(places, values, level) == (expected.slope, expected.low_slope, expected.high_slope)


@pytest.mark.long
def test_places_of_which_two_are_hardly_apart_are_no_obstacle():
    values, places = values_of("drifting", MANY), np.arange(float(MANY))
    places[7] = places[6] + 1e-9
    expected = stats.theilslopes(values, places, alpha=0.95)
    assert theil_sen(places, values, 0.95) == (expected.slope, expected.low_slope, expected.high_slope)


@pytest.mark.long
def test_of_twenty_thousand_values_it_does_not_go_through_two_hundred_million_pairs():
    values, places = values_of("drifting", 20_000), np.arange(1.0, 20_001.0)
    tracemalloc.start()
    found = theil_sen(places, values, 0.95)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 24e6
    assert found.low < 0.002 < found.high
    assert found.slope == pytest.approx(0.002, abs=1e-5)
