"""The bias of two experiments is that of all their runs, whatever the order of these."""

from __future__ import annotations

import numpy as np
import pytest

from robot_runner.analysis.comparison.compared import Bound
from robot_runner.analysis.comparison.equivalence import agreement_of, equivalence_p_value


def test_the_bias_of_experiments_of_different_sizes_is_that_of_all_runs() -> None:
    first, second = np.array([10.0, 12.0, 20.0, 22.0]), np.array([15.0, 16.0])
    for order in ([0, 1, 2, 3], [3, 2, 1, 0]):
        found = agreement_of({"Video": (first[order], second)}, is_paired=False)
        assert found is not None
        assert found.bias == pytest.approx(-0.5)
        assert found.lower is not None
        assert found.upper is not None
        assert (found.lower + found.upper) / 2 == pytest.approx(-0.5)


def test_each_combination_counts_in_the_bias_by_its_pairs() -> None:
    video, network = (np.array([10.0, 12.0]), np.array([13.0, 15.0, 14.0])), (np.array([5.0]), np.array([5.0, 6.0]))
    found = agreement_of({"Video": video, "Network": network}, is_paired=False)
    assert found is not None
    assert found.bias == pytest.approx((2 * 3.0 + 1 * 0.5) / 3)


def test_the_bias_of_pairs_whose_differences_cancel_is_0() -> None:
    first = np.array([0.1, 0.2, 0.3, 0.4, 0.7])
    for second in (first[::-1], np.array([0.2, 0.1, 0.4, 0.3, 0.7]), first + np.array([0.1, -0.1, 0.2, -0.2, 0.0])):
        found = agreement_of({"Video": (first, second)}, is_paired=True)
        assert found is not None
        assert found.bias == 0
    small = agreement_of({"Video": (1e9 + first, 1e9 + first + 1e-6)}, is_paired=True)
    assert small is not None
    assert small.bias == pytest.approx(1e-6, rel=0.2), "what values can tell apart is no rounding"


def test_values_that_all_differ_by_just_the_bound_are_not_equivalent():
    first = np.arange(10.0, 16.0)
    p_value = equivalence_p_value(first, 1.5 * first, Bound(50.0, is_relative=True), is_paired=True)
    assert not p_value < 0.05
