"""Hypotheses on proportions that name a contrast or a bound: weighted sums, equivalence and non-inferiority."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from scipy import stats

from robot_runner.analysis.statistics.post_hoc import test_of, weights_of
from robot_runner.analysis.statistics.proportions import Strata, problem_of, runs_together
from robot_runner.analysis.statistics.score_intervals import Share, score_of, sum_ends, sum_of
from robot_runner.analysis.statistics.tested import ContrastTest, Interval, NotComputed

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from robot_runner.analysis.statistics.analysed_design import MeasureData
    from robot_runner.analysis.statistics.tests import Choices
    from robot_runner.core.design.hypothesis import Hypothesis

_PAIR = 2
_POINTS = 100.0


def carry_out_contrast_of_proportions(
    data: MeasureData, hypothesis: Hypothesis, choices: Choices
) -> ContrastTest | NotComputed:
    """Test the contrast of a hypothesis, or that it is within a bound or below one, in percentage points.

    Values are 1 for yes and 0 for no.
    """
    problem = problem_of(data, is_of_bound=hypothesis.has_bound)
    if problem:
        return NotComputed(test_of(hypothesis), problem)
    weights = compared_weights(data, hypothesis)
    if isinstance(weights, NotComputed):
        return weights
    (factor,) = hypothesis.factors
    table = Strata.of(data, factor, list(weights))
    of = list(weights.values())
    shares = shares_of(table, of, most_runs(data, weights, hypothesis))
    if shares is None:
        return NotComputed(test_of(hypothesis), f"no runs of all its treatments differ in nothing but {factor}.")
    return ContrastTest(
        hypothesis.statement,
        _POINTS * sum_of(shares, of),
        _interval(shares, of, 1 - (2 if hypothesis.has_bound else 1) * choices.alpha),
        None,
        None,
        p_value_of(table, shares, of, hypothesis),
    )


def _interval(shares: Sequence[Share], weights: Sequence[float], level: float) -> Interval:
    low, high = sum_ends(shares, weights, float(stats.norm.isf((1 - level) / 2)))
    return Interval(_POINTS * low, _POINTS * high, level, "Newcombe's score interval")


def with_larger_p_value(found: ContrastTest, data: MeasureData, hypothesis: Hypothesis) -> ContrastTest:
    """Return the test of a bound by t on shares, with the larger p-value of it and of independent runs.

    t does not know how a share near 100 % can vary, nor the other how blocks respond. By simulation (3 to 20 blocks of
    3 to 20 runs) t alone finds up to 13 % at 5 %, where one treatment always succeeds, and both together up to 6 %.
    """
    weights = compared_weights(data, hypothesis)
    if isinstance(weights, NotComputed):
        return found
    of = list(weights.values())
    independent, shares = independent_p_value(Strata.of(data, hypothesis.factors[0], list(weights)), of, hypothesis)
    beside = _interval(shares, of, found.interval.level)
    low, high = min(found.interval.low, beside.low), max(found.interval.high, beside.high)
    return replace(found, interval=replace(found.interval, low=low, high=high), p_value=max(found.p_value, independent))


def independent_p_value(
    table: Strata, weights: Sequence[float], hypothesis: Hypothesis
) -> tuple[float, tuple[Share, ...]]:
    """Return the p-value of a bound as if all runs were independent, and the share of each treatment."""
    shares = shares_of(table.pooled, weights, math.inf) or ()
    return p_value_of(table, shares, weights, hypothesis), shares


def compared_weights(data: MeasureData, hypothesis: Hypothesis) -> Mapping[str, float] | NotComputed:
    """Return the weights of the treatments that the contrast of a hypothesis compares."""
    weights = weights_of(hypothesis, {name: data.levels(name) for name in data.factors})
    if isinstance(weights, NotComputed):
        return weights
    return {level: weight for level, weight in weights.items() if weight}


def most_runs(data: MeasureData, weights: Mapping[str, float], hypothesis: Hypothesis) -> float:
    """Return as how many runs those of a treatment count at the most.

    Where a block has several, and nothing tells how blocks respond, these count as one: they may all respond alike. The
    exact test of two treatments has no such limit; a note tells what it assumes.
    """
    if is_exact(weights, hypothesis) or not data.is_blocked or runs_together(data) <= 1:
        return math.inf
    return float(len(set(data.blocks)))


def is_exact(weights: Mapping[str, float], hypothesis: Hypothesis) -> bool:
    """Return whether it claims that two treatments differ, as the exact test of their pair does."""
    return len(weights) == _PAIR and not hypothesis.has_bound


def shares_of(table: Strata, weights: Sequence[float], most: float) -> tuple[Share, ...] | None:
    """Return the share of yes of each treatment, each of so many runs at the most; None without comparable runs."""
    found = table.shares(weights)
    return None if found is None else tuple(Share(each.value, min(each.runs, most)) for each in found)


def p_value_of(table: Strata, shares: Sequence[Share], weights: Sequence[float], hypothesis: Hypothesis) -> float:
    """Return the p-value of a difference from zero; with a bound, that of the test of equivalence or of one side.

    The exact test decides whether two treatments differ, as on their pair. Other p-values are those at which an end of
    the interval is the bound, or zero.
    """
    if hypothesis.within is not None:
        bound = hypothesis.within / _POINTS
        score = min(score_of(shares, weights, -bound), -score_of(shares, weights, bound))
        return float(stats.norm.sf(score))
    if hypothesis.below is not None:
        return float(stats.norm.cdf(score_of(shares, weights, hypothesis.below / _POINTS)))
    if len(shares) == _PAIR:
        return table.p_value()
    return float(2 * stats.norm.sf(abs(score_of(shares, weights))))
