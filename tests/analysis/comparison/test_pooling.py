"""Averages over experiments are those of the R package metafor, and hold where its assumptions do not."""

from __future__ import annotations

import json
import math
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy import stats
from statsmodels.stats.meta_analysis import combine_effects
from statsmodels.stats.oneway import anova_oneway

from robot_runner.analysis.comparison.combined import combine

#: What `metafor_reference.R` printed with metafor 3.8-1: five data sets of its package metadat, and parts of two.
REFERENCE = {
    each["name"]: each
    for each in map(json.loads, Path(__file__).with_name("metafor_reference.jsonl").read_text().splitlines())
}
KNOWN = math.inf


def combined(reference):
    effects, variances = reference["yi"], reference["vi"]
    return combine(effects, np.sqrt(variances), [KNOWN] * len(effects), alpha=0.05)


def of_pooled(pooled):
    return [pooled.estimate, pooled.error, pooled.interval.low, pooled.interval.high, pooled.p_value]


@pytest.mark.parametrize("name", REFERENCE)
def test_metafor_finds_the_same(name):
    reference = REFERENCE[name]
    found = combined(reference)
    told = found.heterogeneity
    close = {"rel": 1e-6, "abs": 1e-9}
    assert of_pooled(found.common) == pytest.approx(reference["common"], **close)
    assert of_pooled(found.random) == pytest.approx(reference["random"], **close)
    assert found.random_weights == pytest.approx(reference["weights"], **close)
    assert [told.q, told.p_value, told.tau_squared, told.i_squared] == pytest.approx(
        reference["heterogeneity"], **close
    )
    ends = [told.tau_squared_interval, told.i_squared_interval]
    assert [end for each in ends for end in (each.low, each.high)] == pytest.approx(
        reference["profile"], rel=1e-4, abs=1e-6
    )
    if "prediction" in reference:
        assert [found.prediction.low, found.prediction.high] == pytest.approx(reference["prediction"], **close)
    else:
        assert found.prediction is None


@pytest.mark.parametrize("name", REFERENCE)
def test_statsmodels_finds_the_same(name):
    reference = REFERENCE[name]
    found = combined(reference)
    other = combine_effects(np.array(reference["yi"]), np.array(reference["vi"]), method_re="pm", use_t=True)
    assert found.heterogeneity.tau_squared == pytest.approx(other.tau2, rel=1e-4, abs=1e-9)
    assert found.random.estimate == pytest.approx(other.mean_effect_re, rel=1e-4)
    _, _, _, (low, high) = other.conf_int()
    assert (found.random.interval.low, found.random.interval.high) == pytest.approx((low, high), rel=1e-4)


@pytest.mark.long
def test_the_reference_is_what_metafor_prints_here():
    program = shutil.which("Rscript")
    if program is None:
        pytest.skip("R is not installed (Debian: r-base-core, r-cran-metafor)")
    has_it = subprocess.run([program, "-e", "library(metafor)"], capture_output=True, check=False, timeout=120)
    if has_it.returncode:
        pytest.skip("R has no package metafor (Debian: r-cran-metafor)")
    script = Path(__file__).with_name("metafor_reference.R")
    answer = subprocess.run([program, script], capture_output=True, check=True, text=True, timeout=120)
    printed = {each["name"]: each for each in map(json.loads, answer.stdout.splitlines())}
    assert printed.keys() == REFERENCE.keys()
    for name, reference in REFERENCE.items():
        for key, values in reference.items():
            expected = values if key == "name" else pytest.approx(values, rel=1e-4, abs=1e-6)
            assert printed[name][key] == expected, (name, key)


def test_whether_means_differ_is_welchs_analysis_of_variance():
    # The mean of a group is an estimate with the variance s2/n and n - 1 degrees of freedom.
    random = np.random.default_rng(7)
    groups = [random.normal(mean, spread, size) for mean, spread, size in ((5, 1, 4), (6, 3, 7), (5, 2, 12), (7, 1, 5))]
    found = combine(
        [group.mean() for group in groups],
        [stats.sem(group) for group in groups],
        [len(group) - 1 for group in groups],
        alpha=0.05,
    )
    assert found.heterogeneity.p_value == pytest.approx(anova_oneway(groups, use_var="unequal").pvalue)


def test_of_two_means_it_is_nearly_welchs_t_test():
    # Welch's F of two means has the degrees of freedom of his t-test.
    random = np.random.default_rng(8)
    one, other = random.normal(0, 1, 6), random.normal(1, 4, 9)
    found = combine([one.mean(), other.mean()], [stats.sem(one), stats.sem(other)], [5, 8], alpha=0.05)
    assert found.heterogeneity.p_value == pytest.approx(stats.ttest_ind(one, other, equal_var=False).pvalue)


def test_of_equally_precise_experiments_the_average_is_a_t_test_of_their_effects():
    effects = [1.2, 0.4, 2.1, 1.0]
    found = combine(effects, [0.3] * 4, [8.0] * 4, alpha=0.1).random
    expected = stats.ttest_1samp(effects, 0.0)
    interval = expected.confidence_interval(0.9)
    assert found.p_value == pytest.approx(expected.pvalue)
    assert (found.interval.low, found.interval.high) == pytest.approx((interval.low, interval.high))


@pytest.mark.long
@example([0.0, 0.0, 157.0, 1.0], 0.5, 3.0)  # where an iteration ends at 0 that rounding carries beyond the root
@given(st.lists(st.floats(-1e3, 1e3), min_size=2, max_size=12), st.floats(1e-3, 1e3), st.floats(1e-6, 1e6))
def test_nothing_depends_on_the_unit(effects, error, scale):
    errors = [error * (1 + place % 3) for place in range(len(effects))]
    one = combine(effects, errors, [6.0] * len(effects), alpha=0.05)
    other = combine(
        [scale * each for each in effects], [scale * each for each in errors], [6.0] * len(effects), alpha=0.05
    )
    assert other.random.estimate == pytest.approx(scale * one.random.estimate, rel=1e-5, abs=1e-8 * scale)
    assert other.heterogeneity.tau_squared == pytest.approx(
        scale**2 * one.heterogeneity.tau_squared, rel=1e-5, abs=1e-9 * scale**2
    )
    assert other.heterogeneity.p_value == pytest.approx(one.heterogeneity.p_value, rel=1e-4, abs=1e-9)
    assert sum(one.common_weights) == pytest.approx(1.0)
    assert sum(one.random_weights) == pytest.approx(1.0)
    interval = one.heterogeneity.tau_squared_interval
    assert 0 <= interval.low <= interval.high


@pytest.mark.parametrize("far", [1e3, 1e8])
def test_experiments_that_differ_by_far_are_averaged_alike(far):
    found = combine([0.0, far, 2 * far], [1e-4, 1e-3, 1e-2], [4.0, 4.0, 4.0], alpha=0.05)
    assert found.heterogeneity.tau_squared == pytest.approx(far**2, rel=1e-6)
    assert found.random_weights == pytest.approx([1 / 3] * 3)


def test_experiments_that_find_exactly_the_same_have_no_interval_of_the_average():
    found = combine([2.0, 2.0, 2.0], [0.5, 0.5, 1.0], [8.0, 8.0, 8.0], alpha=0.05)
    assert found.random.interval is None
    assert found.random.p_value is None
    assert found.common.interval.low < 2 < found.common.interval.high
    assert (found.heterogeneity.q, found.heterogeneity.tau_squared, found.heterogeneity.i_squared) == (0, 0, 0)


@pytest.mark.parametrize("offset", [1.0, 1e6])
def test_estimates_that_are_the_same_but_for_rounding_tell_no_chance(offset):
    estimates = [(offset + 0.4) - offset, (7.7 * offset + 0.4) - 7.7 * offset]
    assert estimates[0] != estimates[1]
    found = combine(estimates, [0.1, 0.2], [6.0, 6.0], alpha=0.05)
    assert (found.random.p_value, found.random.interval) == (None, None)
