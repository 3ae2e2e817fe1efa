"""The test fits the design and the data, and says why."""

from __future__ import annotations

import numpy as np
import pytest
from tests.analysis.statistics.reference_data import one_factor, split_plot, two_factors

from robot_runner.analysis.statistics.choice import Choice, choose_test
from robot_runner.analysis.statistics.post_hoc import compare_pairs
from robot_runner.analysis.statistics.tested import NotComputed, TestMethod
from robot_runner.analysis.statistics.tests import carry_out
from robot_runner.core.design.analysis_plan import Correction

NORMAL = np.random.default_rng(5).normal(0, 1, 200)
SKEWED = np.exp(2 * NORMAL)


def groups(count, values, *, spread=(1.0, 1.0, 1.0), size=20):
    return {f"t{k}": list(10 + k + spread[k] * values[k * size : (k + 1) * size]) for k in range(count)}


def cells(values, size=10):
    names = [(a, b) for a in "xy" for b in "pq"]
    return {name: list(5 + values[place * size : (place + 1) * size]) for place, name in enumerate(names)}


@pytest.mark.parametrize(
    ("data", "method"),
    [
        (one_factor(groups(2, NORMAL)), TestMethod.STUDENT_T),
        (one_factor(groups(2, NORMAL, spread=(1, 5))), TestMethod.WELCH_T),
        (one_factor(groups(2, SKEWED)), TestMethod.MANN_WHITNEY),
        (one_factor(groups(3, NORMAL)), TestMethod.ANOVA),
        (one_factor(groups(3, NORMAL, spread=(1, 1.5, 5))), TestMethod.WELCH_ANOVA),
        (one_factor(groups(3, SKEWED)), TestMethod.KRUSKAL_WALLIS),
        (two_factors(cells(NORMAL)), TestMethod.FACTORIAL_ANOVA),
        (two_factors(cells(SKEWED)), TestMethod.ALIGNED_RANKS),
        (one_factor(groups(2, NORMAL), in_blocks=True), TestMethod.PAIRED_T),
        (one_factor(groups(2, SKEWED), in_blocks=True), TestMethod.WILCOXON),
        (one_factor(groups(3, NORMAL), in_blocks=True), TestMethod.BLOCKED_ANOVA),
        (one_factor(groups(3, SKEWED), in_blocks=True), TestMethod.FRIEDMAN),
    ],
    ids=lambda value: value.value if isinstance(value, TestMethod) else "",
)
def test_the_test_fits_the_design_and_the_data(data, method):
    choice = choose_test(data, 0.05)
    assert choice.method is method
    assert choice.reason.endswith(".")
    assert "p = " in choice.reason or "p < " in choice.reason


def test_a_block_that_lacks_a_treatment_asks_for_a_mixed_model():
    lacking = groups(3, NORMAL)
    lacking["t2"] = lacking["t2"][:-1]
    assert choose_test(one_factor(lacking, in_blocks=True), 0.05).method is TestMethod.MIXED_MODEL


def test_incomplete_blocks_of_values_that_are_not_normal_are_ranked():
    lacking = groups(3, SKEWED)
    lacking["t2"] = lacking["t2"][:-1]
    assert choose_test(one_factor(lacking, in_blocks=True), 0.05).method is TestMethod.MIXED_ALIGNED_RANKS


def test_combinations_of_different_variances_are_compared_by_errors_that_allow_it():
    spread = {
        name: [5 + (value - 5) * factor for value in values]
        for (name, values), factor in zip(cells(NORMAL, 30).items(), (1, 1, 1, 6), strict=True)
    }
    choice = choose_test(two_factors(spread), 0.05)
    assert choice.method is TestMethod.ROBUST_ANOVA
    assert "in standard deviations of their groups" in choice.reason


def test_many_small_groups_of_different_variances_are_doubted():
    spread = {f"t{k}": list(10 + (1 + 9 * (k > 2)) * NORMAL[5 * k : 5 * k + 5]) for k in range(6)}
    measure = one_factor(spread)
    choice = choose_test(measure, 0.05)
    assert choice.method is TestMethod.WELCH_ANOVA
    assert any("Welch's test errs more often" in note for note in carry_out(measure, choice, 0.05).notes)


def test_ranks_of_different_variances_are_doubted():
    spread = {
        name: [value * factor for value in values]
        for (name, values), factor in zip(cells(SKEWED, 30).items(), (1, 1, 1, 60), strict=True)
    }
    measure = two_factors(spread)
    choice = choose_test(measure, 0.05)
    assert choice.method is TestMethod.ALIGNED_RANKS
    assert any("read p near alpha with care" in note for note in carry_out(measure, choice, 0.05).notes)


def test_names_of_treatments_and_blocks_may_hold_what_formulas_are_made_of():
    def compared(names, blocks):
        rows = [
            (blocks[block], a, b, 5 + NORMAL[place] + 3 * block + (a == names[1]))
            for place, (block, a, b) in enumerate((block, a, b) for block in range(4) for a in names for b in "pq")
        ]
        measure = split_plot(rows[:-1])
        choice = choose_test(measure, 0.05)
        test = carry_out(measure, choice, 0.05)
        found, _ = compare_pairs(measure, choice, test, 0.05, Correction.HOLM)
        return [effect.p_value for effect in test.effects], [
            (each.difference, each.p_value) for each in found[0].comparisons
        ]

    plain = compared(("x", "y"), ("b0", "b1", "b2", "b3"))
    odd = compared(("C(b)[T.0]:", "]:y ~ x"), ("08:00", "09:00", "10:00", "C(b)"))
    assert odd == plain


def test_a_factor_that_blocks_do_not_vary_asks_for_a_mixed_model():
    rows = [
        (f"b{block}", "x" if block < 6 else "y", b, 5 + NORMAL[place] + block)
        for place, (block, b) in enumerate((block, b) for block in range(12) for b in "pq")
    ]
    assert choose_test(split_plot(rows), 0.05).method is TestMethod.MIXED_MODEL


def test_several_factors_in_complete_blocks():
    def rows(values):
        order = [(block, a, b) for block in range(8) for a in "xy" for b in "pq"]
        return [(f"b{block}", a, b, float(values[place])) for place, (block, a, b) in enumerate(order)]

    assert choose_test(split_plot(rows(NORMAL)), 0.05).method is TestMethod.BLOCKED_ANOVA
    assert choose_test(split_plot(rows(SKEWED)), 0.05).method is TestMethod.ALIGNED_RANKS


def test_a_single_run_a_combination_leaves_no_interactions():
    data = two_factors(
        {(a, b): [place + NORMAL[place]] for place, (a, b) in enumerate((a, b) for a in "wxyz" for b in "pqr")}
    )
    choice = choose_test(data, 0.05)
    assert isinstance(choice, Choice)
    assert [effect for effect in choice.fit.terms.effects if len(effect) > 1] == []
    assert choice.fit.terms.note == "Interactions cannot be estimated: there are too few runs a combination."


def test_an_empty_combination_leaves_no_interactions():
    filled = cells(NORMAL)
    filled["y", "q"] = []
    assert choose_test(two_factors(filled), 0.05).fit.terms.note == (
        "Interactions cannot be estimated: some combinations have no run."
    )


def test_ranks_that_cannot_be_aligned_yield_no_test():
    filled = cells(SKEWED)
    filled["y", "q"] = []
    choice = choose_test(two_factors(filled), 0.05)
    assert isinstance(choice, NotComputed)
    assert "ranks cannot be aligned" in choice.why


def test_too_few_values_for_normality_are_compared_by_rank():
    choice = choose_test(one_factor({"a": [1.0, 2.0], "b": [5.0]}), 0.05)
    assert choice.method is TestMethod.MANN_WHITNEY


def test_two_runs_a_treatment_tell_nothing_of_variances():
    # Two values are equally far from their median, but for rounding, of which Levene's test would make F = 1e31.
    data = one_factor({"a": [3.873, 7.133], "b": [4.63, 7.034], "c": [5.647, 5.663]})
    choice = choose_test(data, 0.05)
    assert choice.method is TestMethod.KRUSKAL_WALLIS
    assert "equally far from the median" in choice.checks[1].why


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (one_factor({"a": [1.0, 2.0, 3.0]}), "nothing to compare"),
        (one_factor({"a": [1.0], "b": [2.0], "c": [3.0]}), "each treatment has a single run"),
        (one_factor({"a": [1.0] * 4, "b": [1.0] * 4}), "all values are equal"),
        (one_factor({"a": [1.0] * 4, "b": [2.0] * 4}), "within each combination all values are equal"),
        (two_factors({("x", "p"): [1.0], ("y", "q"): [2.0]}), "too few runs"),
    ],
    ids=["one treatment", "one repetition", "all equal", "no variation", "too few runs"],
)
def test_what_cannot_be_tested_says_why(data, why):
    if len(data.levels("A")) == 1:
        data = type(data)(data.name, data.frame, data.every, (), is_blocked=False)
    choice = choose_test(data, 0.05)
    assert isinstance(choice, NotComputed)
    assert why in choice.why
