"""Tests of equivalence and limits of agreement yield what others have published for the same data."""

from __future__ import annotations

import numpy as np
import pytest
from statsmodels.stats.weightstats import ttost_ind, ttost_paired

from robot_runner.analysis.comparison.compared import Bound
from robot_runner.analysis.comparison.equivalence import agreement_of, difference_test, equivalence_p_value

# NCSS Statistical Software, chapter "Two-Sample T-Tests for Equivalence", its example of corn yields; the R package
# TOSTER prints the same figures (its test "NCSS TOST 198-1 to 197-8").
YIELD_A = np.array([452, 874, 554, 447, 356, 754, 558, 574, 664, 682, 547, 435, 245], dtype=float)
YIELD_B = np.array([546, 547, 774, 465, 459, 665, 467, 365, 589, 534, 456, 651, 654, 665, 546, 537], dtype=float)

# Student's sleep data (Biometrika 6, 1908; `sleep` in R); TOSTER prints these figures for bounds of 1 h.
SLEEP_1 = np.array([0.7, -1.6, -0.2, -1.2, -0.1, 3.4, 3.7, 0.8, 0.0, 2.0])
SLEEP_2 = np.array([1.9, 0.8, 1.1, 0.1, -0.1, 4.4, 5.5, 1.6, 4.6, 3.4])

# Peak expiratory flow, first measurements, l/min: Bland and Altman (Lancet 327, 1986), table.
WRIGHT = np.array([494, 395, 516, 434, 476, 557, 413, 442, 650, 433, 417, 656, 267, 478, 178, 423, 427], dtype=float)
MINI = np.array([512, 430, 520, 428, 500, 600, 364, 380, 658, 445, 432, 626, 260, 477, 259, 350, 451], dtype=float)


def test_corn_yields_of_ncss():
    tested = difference_test(YIELD_B, YIELD_A, alpha=0.05, is_paired=False)
    assert tested.interval.low == pytest.approx(-120.27336, abs=5e-6)
    assert tested.interval.high == pytest.approx(104.04259, abs=5e-6)
    p_value = equivalence_p_value(YIELD_B, YIELD_A, Bound(110.0), is_paired=False)
    assert p_value == pytest.approx(0.03628, abs=5e-6)


def test_student_s_sleep_data_of_toster():
    assert difference_test(SLEEP_2, SLEEP_1, alpha=0.05, is_paired=False).p_value == pytest.approx(
        0.079394140, abs=5e-10
    )
    p_value = equivalence_p_value(SLEEP_2, SLEEP_1, Bound(1.0), is_paired=False)
    assert p_value == pytest.approx(0.748319811, abs=5e-10)


def test_student_s_sleep_data_in_pairs():
    # What the paired t-test of R prints for them: p-value = 0.002833, and the ends of the interval below.
    tested = difference_test(SLEEP_1, SLEEP_2, alpha=0.05, is_paired=True)
    assert tested.p_value == pytest.approx(0.002833, abs=5e-7)
    assert (tested.interval.low, tested.interval.high) == pytest.approx((0.7001142, 2.4598858), abs=5e-8)


@pytest.mark.parametrize("bound", [0.3, 1.0, 2.5, 4.0])
def test_statsmodels_finds_the_same_equivalence(bound):
    independent = ttost_ind(SLEEP_2, SLEEP_1, -bound, bound, usevar="unequal")[0]
    assert equivalence_p_value(SLEEP_1, SLEEP_2, Bound(bound), is_paired=False) == pytest.approx(float(independent))
    paired = ttost_paired(SLEEP_2, SLEEP_1, -bound, bound)[0]
    assert equivalence_p_value(SLEEP_1, SLEEP_2, Bound(bound), is_paired=True) == pytest.approx(float(paired))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_bound_in_percent_is_a_test_of_the_ratio_of_means(sign):
    # Sasabuchi's test is Welch's one of the second values against the first ones times 0.8 and times 1.2.
    lower = ttost_ind(YIELD_B, 0.8 * YIELD_A, 0.0, 1e9, usevar="unequal")[1][1]
    upper = ttost_ind(YIELD_B, 1.2 * YIELD_A, -1e9, 0.0, usevar="unequal")[2][1]
    p_value = equivalence_p_value(sign * YIELD_A, sign * YIELD_B, Bound(20.0, is_relative=True), is_paired=False)
    assert p_value == pytest.approx(float(max(lower, upper)))


def test_flow_meters_of_bland_and_altman():
    agreement = agreement_of({"": (WRIGHT, MINI)}, is_paired=True)
    # The article gives a mean difference of -2.1 l/min (large meter less small) and a standard deviation of 38.8.
    assert round(-agreement.bias, 1) == -2.1
    spread = (agreement.upper - agreement.bias) / 1.96
    assert round(spread, 1) == 38.8
    assert agreement.lower == pytest.approx(2 * agreement.bias - agreement.upper)


def test_a_single_pair_has_a_bias_and_no_limits():
    agreement = agreement_of({"a": (np.array([1.0]), np.array([1.5]))}, is_paired=True)
    assert (agreement.bias, agreement.lower, agreement.upper) == (0.5, None, None)
