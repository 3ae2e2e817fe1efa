"""Pairs of treatments compared: differences with their intervals, adjusted p-values, effect sizes."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import stats

from robot_runner.analysis.statistics.descriptive import bootstrap_interval, quiet
from robot_runner.analysis.statistics.effect_sizes import paired_d, paired_rank_biserial, two_group_effects
from robot_runner.analysis.statistics.linear_model import aligned_ranks, fit_linear
from robot_runner.analysis.statistics.tested import Comparison, Interval, NotComputed, PostHoc, TestMethod
from robot_runner.analysis.statistics.tests import mixed_model
from robot_runner.core.design.analysis_plan import Correction

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from robot_runner.analysis.statistics.choice import Choice
    from robot_runner.analysis.statistics.design import Group, MeasureData
    from robot_runner.analysis.statistics.linear_model import LinearFit
    from robot_runner.analysis.statistics.tested import EffectSize, MeasureTest

__all__ = ["adjusted", "compare_pairs"]

#: More pairs can neither be read nor tested with any power left: 15 treatments make 105.
_MOST_PAIRS = 105

_LEVEL = 0.95
_BY_RANKS = frozenset({TestMethod.MANN_WHITNEY, TestMethod.KRUSKAL_WALLIS, TestMethod.WILCOXON, TestMethod.FRIEDMAN})
_IN_BLOCKS = frozenset({TestMethod.PAIRED_T, TestMethod.WILCOXON, TestMethod.FRIEDMAN})
_BY_MODEL = frozenset(
    {
        TestMethod.FACTORIAL_ANOVA,
        TestMethod.ROBUST_ANOVA,
        TestMethod.BLOCKED_ANOVA,
        TestMethod.ALIGNED_RANKS,
        TestMethod.ANOVA,
    }
)
_MIXED = frozenset({TestMethod.MIXED_MODEL, TestMethod.MIXED_ALIGNED_RANKS})
_BY_ALIGNED_RANKS = frozenset({TestMethod.ALIGNED_RANKS, TestMethod.MIXED_ALIGNED_RANKS})
#: What the test of each pair is called, where it is not called as the test of all groups.
_WORDS = {
    TestMethod.ANOVA: "t-tests with pooled standard deviation",
    TestMethod.WELCH_ANOVA: "Welch's t-tests",
    TestMethod.KRUSKAL_WALLIS: "Dunn's test",
    TestMethod.FACTORIAL_ANOVA: "t-tests of marginal means",
    TestMethod.ROBUST_ANOVA: "t-tests of marginal means, with standard errors that hold where variances differ (HC3)",
    TestMethod.BLOCKED_ANOVA: "t-tests of means within blocks",
    TestMethod.ALIGNED_RANKS: "t-tests of aligned ranks",
    TestMethod.FRIEDMAN: "Wilcoxon signed-rank tests within blocks",
    TestMethod.MIXED_MODEL: "t-tests of the mixed model's means",
    TestMethod.MIXED_ALIGNED_RANKS: "t-tests of the mixed model's aligned ranks",
}


@dataclass(frozen=True, slots=True)
class _Pair:
    """One comparison before adjustment."""

    first: str
    second: str
    statistic_name: str
    statistic: float
    p_value: float
    interval: Interval | None = None
    difference: float | None = None
    effect_sizes: tuple[EffectSize, ...] | None = None


def compare_pairs(
    data: MeasureData, choice: Choice, test: MeasureTest, alpha: float, correction: Correction
) -> tuple[tuple[PostHoc, ...], tuple[NotComputed, ...]]:
    """Compare the treatments of each factor pair by pair; the combinations too, where factors interact."""
    found: list[PostHoc] = []
    missing: list[NotComputed] = []
    for factors in _compared(test):
        groups = data.groups(factors)
        pairs = math.comb(len(groups), 2)
        if pairs > _MOST_PAIRS:
            what = f"pairwise comparisons of {' x '.join(factors)}"
            missing.append(NotComputed(what, f"{len(groups)} groups make {pairs:,} pairs: compare chosen ones."))
            continue
        with quiet():
            compared = list(_pairs(data, choice, factors, groups))
        found.append(_post_hoc(choice, factors, groups, compared, alpha, correction))
    return tuple(found), tuple(missing)


def adjusted(p_values: Sequence[float], correction: Correction) -> list[float]:
    """Return p-values adjusted for their number.

    Example:
        >>> [round(p, 3) for p in adjusted([0.01, 0.02, 0.03], Correction.HOLM)]
        [0.03, 0.04, 0.04]
    """
    values = np.asarray(p_values, dtype=np.float64)
    if not len(values):
        return []
    if correction is Correction.BENJAMINI_HOCHBERG:
        return [float(value) for value in stats.false_discovery_control(values, method="bh")]
    # Holm 1979. statsmodels' multipletests would do, but each of its calls collects the interpreter's garbage.
    order = np.argsort(values)
    stepped = np.maximum.accumulate(values[order] * np.arange(len(values), 0, -1))
    holm = np.empty(len(values))
    holm[order] = np.minimum(1.0, stepped)
    return [float(value) for value in holm]


def _compared(test: MeasureTest) -> Iterator[tuple[str, ...]]:
    """Yield each factor, and the largest significant interaction."""
    interactions = [effect for effect in test.effects if len(effect.factors) > 1 and effect.is_significant]
    yield from (effect.factors for effect in test.effects if len(effect.factors) == 1)
    if interactions:
        yield max((effect.factors for effect in interactions), key=len)


def _pairs(data: MeasureData, choice: Choice, factors: tuple[str, ...], groups: Sequence[Group]) -> Iterator[_Pair]:
    method = choice.method
    if method in _BY_MODEL:
        yield from _by_contrasts(data, choice, factors, groups)
    elif method in _MIXED:
        yield from _by_mixed_model(data, choice, factors, groups)
    elif method is TestMethod.KRUSKAL_WALLIS:
        yield from _by_dunn(groups)
    elif method in _IN_BLOCKS:
        yield from _in_blocks(data, method, groups)
    else:
        yield from _one_by_one(method, groups)


def _post_hoc(
    choice: Choice,
    factors: tuple[str, ...],
    groups: Sequence[Group],
    pairs: Sequence[_Pair],
    alpha: float,
    correction: Correction,
) -> PostHoc:
    by_label = {group.label: group for group in groups}
    is_of_means = choice.method not in _BY_RANKS | _BY_ALIGNED_RANKS
    computed = [pair.p_value for pair in pairs if math.isfinite(pair.p_value)]
    after = iter(adjusted(computed, correction))
    comparisons = []
    for pair in pairs:
        p_value = next(after) if math.isfinite(pair.p_value) else None
        comparisons.append(_comparison(pair, by_label, p_value, alpha, is_of_means=is_of_means))
    return PostHoc(factors, _WORDS.get(choice.method, choice.method.value), correction, is_of_means, tuple(comparisons))


def _comparison(
    pair: _Pair, by_label: dict[str, Group], adjusted_p: float | None, alpha: float, *, is_of_means: bool
) -> Comparison:
    first, second = by_label[pair.first].values, by_label[pair.second].values
    centre = np.mean if is_of_means else np.median
    difference, interval = pair.difference, pair.interval
    if difference is None:
        difference = float(centre(first) - centre(second))
    if interval is None:
        interval = bootstrap_interval((first, second), _difference_of(centre))
    sizes = pair.effect_sizes
    if sizes is None:
        sizes = two_group_effects(first, second, by_ranks=not is_of_means)
    is_known = math.isfinite(pair.p_value)
    return Comparison(
        first=pair.first,
        second=pair.second,
        difference=difference,
        interval=interval,
        statistic_name=pair.statistic_name,
        statistic=pair.statistic if is_known else None,
        p_value=pair.p_value if is_known else None,
        adjusted_p_value=adjusted_p,
        is_significant=None if adjusted_p is None else adjusted_p < alpha,
        effect_sizes=sizes,
    )


def _difference_of(centre: Any) -> Any:
    return lambda first, second, axis=-1: centre(first, axis=axis) - centre(second, axis=axis)


def _one_by_one(method: TestMethod, groups: Sequence[Group]) -> Iterator[_Pair]:
    for one, other in combinations(groups, 2):
        if method is TestMethod.MANN_WHITNEY:
            result = stats.mannwhitneyu(one.values, other.values, method="auto")
            yield _Pair(one.label, other.label, "U", float(result.statistic), float(result.pvalue))
        elif min(len(one.values), len(other.values)) < 2 or np.ptp(one.values) == np.ptp(other.values) == 0:  # noqa: PLR2004
            yield _Pair(one.label, other.label, "t", math.nan, math.nan)
        else:
            result = stats.ttest_ind(one.values, other.values, equal_var=method is TestMethod.STUDENT_T)
            ends = result.confidence_interval(_LEVEL)
            interval = Interval(float(ends.low), float(ends.high), _LEVEL, "t distribution")
            yield _Pair(one.label, other.label, "t", float(result.statistic), float(result.pvalue), interval)


def _by_dunn(groups: Sequence[Group]) -> Iterator[_Pair]:
    from scikit_posthocs import posthoc_dunn  # noqa: PLC0415 - takes two seconds to import

    p_values = posthoc_dunn([group.values for group in groups]).to_numpy()
    ranks = stats.rankdata(np.concatenate([group.values for group in groups]))
    means = [float(part.mean()) for part in np.split(ranks, np.cumsum([len(group.values) for group in groups])[:-1])]
    for one, other in combinations(range(len(groups)), 2):
        p_value = float(p_values[one, other])
        z = math.copysign(float(stats.norm.isf(p_value / 2)), means[one] - means[other])
        yield _Pair(groups[one].label, groups[other].label, "z", z, p_value)


def _in_blocks(data: MeasureData, method: TestMethod, groups: Sequence[Group]) -> Iterator[_Pair]:
    wide = data.by_block()
    for one, other in combinations(groups, 2):
        differences = np.asarray(wide[one.label] - wide[other.label], dtype=np.float64)
        if method is TestMethod.PAIRED_T:
            result = stats.ttest_1samp(differences, 0.0)
            ends = result.confidence_interval(_LEVEL)
            interval: Interval | None = Interval(float(ends.low), float(ends.high), _LEVEL, "t distribution")
            name, size, difference = "t", paired_d(differences), float(np.mean(differences))
        else:
            result = stats.wilcoxon(differences) if np.any(differences) else None
            interval = bootstrap_interval((differences,), np.median)
            name, size, difference = "W", paired_rank_biserial(differences), float(np.median(differences))
        value, p_value = (math.nan, math.nan) if result is None else (float(result.statistic), float(result.pvalue))
        sizes = () if size is None else (size,)
        yield _Pair(one.label, other.label, name, value, p_value, interval, difference, sizes)


def _by_contrasts(
    data: MeasureData, choice: Choice, factors: tuple[str, ...], groups: Sequence[Group]
) -> Iterator[_Pair]:
    is_ranked = choice.method in _BY_ALIGNED_RANKS
    fit = fit_linear(data, choice.fit.terms, _ranks(data, factors)) if is_ranked else choice.fit
    if choice.method is TestMethod.ROBUST_ANOVA:
        fit = fit.with_robust_covariance()
    rows = _rows(fit, data, factors)
    for one, other in combinations(groups, 2):
        contrast = fit.contrast(rows[one.label] - rows[other.label])
        pair = _Pair(one.label, other.label, "t", float(contrast.tvalue.item()), float(contrast.pvalue.item()))
        difference = float(contrast.effect.item())
        reach = float(contrast.conf_int(1 - _LEVEL)[0, 1]) - difference
        yield pair if is_ranked else _with_estimate(pair, difference, reach)


def _ranks(data: MeasureData, factors: tuple[str, ...]) -> NDArray[np.float64]:
    """Return the ranks that contrasts are made of.

    Those of one factor are of the ranks aligned for it. Those of all factors together are of the ranks of the values
    themselves, which need no aligning (ART-C: Elkin, Kay, Higgins and Wobbrock, UIST 2021).
    """
    if factors == data.factors:
        return np.asarray(stats.rankdata(data.values), dtype=np.float64)
    return aligned_ranks(data, factors)


def _rows(fit: LinearFit, data: MeasureData, factors: tuple[str, ...]) -> dict[str, NDArray[np.float64]]:
    if len(factors) == 1:
        return fit.treatment_rows(factors[0])
    places = [data.factors.index(factor) for factor in factors]
    cells: dict[str, list[NDArray[np.float64]]] = {}
    for combination, row in fit.combination_rows().items():
        cells.setdefault(" / ".join(combination[place] for place in places), []).append(row)
    return {label: np.mean(rows, axis=0) for label, rows in cells.items()}


def _by_mixed_model(
    data: MeasureData, choice: Choice, factors: tuple[str, ...], groups: Sequence[Group]
) -> Iterator[_Pair]:
    is_ranked = choice.method in _BY_ALIGNED_RANKS
    results = mixed_model(data, choice, _ranks(data, factors) if is_ranked else None)
    freedom = min(choice.fit.freedom_within(each) for each in choice.fit.terms.effects if set(each) <= set(factors))
    with_blocks = _rows(choice.fit, data, factors)
    shared = np.isin(choice.fit.results.model.exog_names, results.model.exog_names)
    for one, other in combinations(groups, 2):
        difference = (with_blocks[one.label] - with_blocks[other.label])[shared]
        contrast = results.t_test(difference[np.newaxis, :])
        t_value, error = float(contrast.tvalue.item()), float(contrast.sd.item())
        pair = _Pair(one.label, other.label, "t", t_value, 2 * float(stats.t.sf(abs(t_value), freedom)))
        reach = float(stats.t.ppf((1 + _LEVEL) / 2, freedom)) * error
        yield pair if is_ranked else _with_estimate(pair, float(contrast.effect.item()), reach)


def _with_estimate(pair: _Pair, difference: float, reach: float) -> _Pair:
    low, high = difference - reach, difference + reach
    interval = Interval(low, high, _LEVEL, "model") if math.isfinite(low) and math.isfinite(high) else None
    return replace(pair, interval=interval, difference=difference)
