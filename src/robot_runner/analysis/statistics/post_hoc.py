"""Pairs of treatments compared: differences with their intervals, adjusted p-values, effect sizes."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING, Self

import numpy as np
from scipy import stats

from robot_runner.analysis.arrays import Floats
from robot_runner.analysis.statistics.adjusted_means import AdjustedMeans
from robot_runner.analysis.statistics.analysed_design import BATCH, VALUE, MeasureData
from robot_runner.analysis.statistics.cell_layout import layout_of
from robot_runner.analysis.statistics.descriptive import quiet
from robot_runner.analysis.statistics.effect_sizes import cliffs_delta, cohens_d, paired_rank_biserial, vargha_delaney
from robot_runner.analysis.statistics.tested import (
    Comparison,
    ContrastTest,
    EffectSize,
    MeasureTest,
    NotComputed,
    PostHoc,
    TestMethod,
)
from robot_runner.analysis.statistics.tests import AnyModel, Choices, check_estimand, planned_model_of
from robot_runner.analysis.wording import listed
from robot_runner.core.design.analysis_plan import Correction, Estimand
from robot_runner.core.words import combination_label

if TYPE_CHECKING:
    from robot_runner.analysis.statistics.contrasts import Contrast
    from robot_runner.core.design.hypothesis import Hypothesis

    #: The treatments of a group of runs, by factor.
    Group = Mapping[str, str]

#: Significant digits of values whose differences are ranked: floating-point numbers have two more.
_DIGITS = 13

#: The most pairs, those of 15 treatments: more can neither be read nor tested with any power.
MOST_PAIRS = 105

_QUANTITIES = {Estimand.MEAN: "means", Estimand.TRIMMED_MEAN: "trimmed means", Estimand.RANK: "relative ranks"}
_WHY_MISSING = {
    "Cliff's delta": "a group has a single run.",
    "Vargha-Delaney A12": "a group has a single run.",
    "rank-biserial correlation": "all differences have one sign, or they are fewer than five.",
}
_MARGINAL = " of unweighted marginal means"
_PAIRED = {
    TestMethod.WELCH_T: "Welch's t-test",
    TestMethod.WELCH_ANOVA: "Welch's t-tests",
    TestMethod.ANOVA_TYPE: f"Welch's t-tests{_MARGINAL}",
    TestMethod.WELCH_JAMES: f"Welch's t-tests{_MARGINAL}",
    TestMethod.COMBINED: f"Welch's t-tests{_MARGINAL}",
    TestMethod.PAIRED_T: "paired t-test",
    TestMethod.BLOCKS: "t-tests of differences within blocks, between them where factors do not differ within",
    TestMethod.LINEAR_MODEL: "t-tests of the model's marginal means",
    TestMethod.MIXED_MODEL: "t-tests of the model's marginal means",
    TestMethod.COVARIANCE: "t-tests of adjusted means",
    TestMethod.ADJUSTED_FOR_BLOCKS: "t-tests of means adjusted for blocks",
    TestMethod.CROSSOVER: "t-tests of means within subjects",
    TestMethod.SPLIT_PLOT: "t-tests of means, each of its stratum",
    TestMethod.LENTH: "Lenth's method",
}


def compare_pairs(
    data: MeasureData, model: AnyModel, test: MeasureTest, choices: Choices
) -> tuple[tuple[PostHoc, ...], tuple[NotComputed, ...]]:
    """Compare the treatments of each factor pair by pair, and the combinations of factors that may interact."""
    beside = planned_model_of(data, check_estimand(choices.estimand), choices.statistic)
    found: list[PostHoc] = []
    missing: list[NotComputed] = []
    for factors in _compared(data, test, choices.alpha):
        groups = [group.treatments for group in data.applied_groups(factors) if len(group.values)]
        chosen = list(_chosen_pairs(data, groups))
        if len(chosen) > MOST_PAIRS:
            what = f"pairwise comparisons of {' x '.join(factors)}"
            missing.append(NotComputed(what, f"{len(groups)} groups make {len(chosen):,} pairs: compare chosen ones."))
            continue
        ranked = _RankSizes.among(data, model, factors, choices)
        with quiet():
            compared = with_adjusted([_comparison(model, beside, pair, choices, ranked) for pair in chosen], choices)
        method = _PAIRED[model.method] if len(data.factors) > 1 else _PAIRED[model.method].removesuffix(_MARGINAL)
        quantity, within = _QUANTITIES[choices.estimand], data.within(factors)
        found.append(PostHoc(factors, method, choices.correction, quantity, compared, within))
    return tuple(found), tuple(missing)


#: Why rank-based effect sizes of adjusted values have no interval: its coverage would be 78 to 97 %, by simulation.
_OF_ADJUSTED = "it would know nothing of the slopes that values are adjusted with, which are estimated, too."


def missing_intervals(test: MeasureTest, post_hoc: Sequence[PostHoc]) -> Iterator[NotComputed]:
    """Yield, for each kind of effect size, which intervals are missing and why."""
    pairs = [
        (size, f"{pair.first} and {pair.second}")
        for each in post_hoc
        for pair in each.comparisons
        for size in pair.effect_sizes
    ]
    effects = [(size, effect.label) for effect in test.effects for size in effect.effect_sizes]
    missing: dict[str, list[str]] = {}
    for size, what in (*effects, *pairs):
        if size.interval is None:
            missing.setdefault(size.name, []).append(what)
    for name, several in missing.items():
        why = _WHY_MISSING.get(name, "the noncentral distribution cannot be inverted with floating-point numbers.")
        why = _OF_ADJUSTED if test.method is TestMethod.COVARIANCE and name in _WHY_MISSING else why
        yield NotComputed(f"interval of {name} of {listed(several)}", why)


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
    # Holm 1979. Each call of statsmodels' multipletests would run the garbage collector.
    order = np.argsort(values)
    stepped = np.maximum.accumulate(values[order] * np.arange(len(values), 0, -1))
    holm = np.empty(len(values))
    holm[order] = np.minimum(1.0, stepped)
    return [float(value) for value in holm]


def adjusted_known(p_values: Iterable[float | None], correction: Correction) -> list[float | None]:
    """Return p-values adjusted for the number of those that are known; the others stay None."""
    found = list(p_values)
    after = iter(adjusted([each for each in found if each is not None], correction))
    return [None if each is None else next(after) for each in found]


def with_adjusted(pairs: Sequence[Comparison], choices: Choices) -> tuple[Comparison, ...]:
    """Return pairs with p-values adjusted for their number."""
    after = adjusted_known((pair.p_value for pair in pairs), choices.correction)
    return tuple(
        replace(pair, adjusted_p_value=value, is_significant=None if value is None else value < choices.alpha)
        for pair, value in zip(pairs, after, strict=True)
    )


def carry_out_contrast(model: AnyModel, hypothesis: Hypothesis, choices: Choices) -> ContrastTest | NotComputed:
    """Test the contrast of a hypothesis, or that it is within a bound (two one-sided tests) or below one (one)."""
    found = contrast_of(model, hypothesis, choices.estimand)
    if isinstance(found, NotComputed):
        return found
    estimate, error, freedom = (float(each) for each in found)
    if not (error > 0 and math.isfinite(freedom)):
        return NotComputed(test_of(hypothesis), "the values of its treatments do not vary.")
    level = 1 - (2 if hypothesis.has_bound else 1) * choices.alpha
    interval, p_value = found.interval(1 - level), float(p_value_of_contrast(found, hypothesis))
    return ContrastTest(hypothesis.statement, estimate, interval, estimate / error, freedom, p_value)


def contrast_of(model: AnyModel, hypothesis: Hypothesis, estimand: Estimand) -> Contrast | NotComputed:
    """Estimate the contrast of a hypothesis; the model may be of many simulated experiments at once."""
    if (hypothesis.within or hypothesis.below) and estimand is Estimand.RANK:
        why = "a bound in the unit of the measure says nothing of ranks, which differ by 1 at most: compare means."
        return NotComputed(test_of(hypothesis), why)
    weights = weights_of(hypothesis, model.factors)
    if isinstance(weights, NotComputed):
        return weights
    (factor,) = hypothesis.factors
    with quiet():
        return model.difference([({factor: level}, weight) for level, weight in weights.items()])


def weights_of(hypothesis: Hypothesis, levels: Mapping[str, Sequence[str]]) -> Mapping[str, float] | NotComputed:
    """Return the weight of each treatment in the contrast of a hypothesis."""
    (factor,) = hypothesis.factors
    weights = hypothesis.contrast
    if factor in levels and weights is None and len(levels[factor]) == 2:  # noqa: PLR2004
        weights = dict(zip(levels[factor], (1.0, -1.0), strict=True))
    if factor in levels and weights is not None and set(weights) <= set(levels[factor]):
        return weights
    of = f"{factor}: {', '.join(levels.get(factor, ()))}"
    why = f"its treatments are not those of {of}."
    if factor in levels and weights is None:
        why = f"a bound is of two treatments, and it names none by a contrast of those of {of}."
    return NotComputed(test_of(hypothesis), why)


def p_value_of_contrast(found: Contrast, hypothesis: Hypothesis) -> Floats:
    """Return the p-value of a difference from zero; with a bound, that of the test of equivalence or of one side."""
    bound, size = hypothesis.below, found.estimate
    if hypothesis.within is not None:
        bound, size = hypothesis.within, np.abs(found.estimate)
    if bound is None:
        return found.p_value
    with quiet():
        return np.asarray(stats.t.sf((bound - size) / found.error, found.freedom))


def test_of(hypothesis: Hypothesis) -> str:
    """Return what is tested, in words."""
    return f"test of the hypothesis {hypothesis.statement!r}"


def _chosen_pairs(data: MeasureData, groups: Sequence[Group]) -> Iterator[tuple[Group, Group]]:
    """Yield the pairs of treatments that the design compares: all, or one factor at a time, those with the base."""
    base = data.known.base if data.known.is_one_at_a_time else {}
    for one, other in combinations(groups, 2):
        if all(base.get(name, text) in {text, other[name]} for name, text in one.items()):
            yield one, other


def _compared(data: MeasureData, test: MeasureTest, alpha: float) -> Iterator[tuple[str, ...]]:
    """Yield each factor, and the interactions that may be significant, unless effects are aliased.

    There are none for a response surface, whose treatments are arbitrary numbers of a range.
    """
    if data.known.is_surface:
        return
    yield from (effect.factors for effect in test.effects if len(effect.factors) == 1)
    for effect in test.effects if not data.known.aliases else ():
        if len(effect.factors) > 1 and effect.p_value is not None and effect.p_value < alpha:
            yield effect.factors


def _comparison(
    model: AnyModel, beside: AnyModel | NotComputed, pair: tuple[Group, Group], choices: Choices, ranked: _RankSizes
) -> Comparison:
    weights = [(pair[0], 1.0), (pair[1], -1.0)]
    found = model.difference(weights)
    estimate, error, freedom = (float(each) for each in found)
    is_known = error > 0 and math.isfinite(freedom) and freedom > 0
    return Comparison(
        first=combination_label(pair[0].values()),
        second=combination_label(pair[1].values()),
        difference=estimate,
        interval=found.interval(choices.alpha) if is_known else None,
        statistic_name="t",
        statistic=estimate / error if is_known else None,
        degrees_of_freedom=freedom if is_known else None,
        p_value=_p_value(found),
        adjusted_p_value=None,
        is_significant=None,
        check_p_value=None if isinstance(beside, NotComputed) else _p_value(beside.difference(weights)),
        effect_sizes=(*_standardised(model, (estimate, error, freedom), choices), *ranked.of_pair(pair))
        if is_known
        else (),
    )


def _p_value(found: Contrast) -> float | None:
    p_value = float(found.p_value)
    return p_value if math.isfinite(p_value) and float(found.error) > 0 else None


def _standardised(model: AnyModel, found: tuple[float, float, float], choices: Choices) -> Iterator[EffectSize]:
    """Yield a difference in standard deviations; nothing for ranks."""
    if choices.estimand is not Estimand.RANK:
        name = "robust d" if choices.estimand is Estimand.TRIMMED_MEAN else "Cohen's d"
        size = cohens_d(*found, float(model.spread), model.spread_parts, level=1 - choices.alpha, name=name)
        if size is not None:
            yield size


@dataclass(frozen=True, slots=True)
class _RankSizes:
    """The rank-based effect sizes of pairs of treatments of the same factors.

    Attributes:
        data: the runs, or the mean of each combination in each complete block; None if there are no such sizes: for
            special designs, and where too many blocks are incomplete.
        values: of the runs of each treatment (or combination), by the combination of the other factors and the batch;
            empty if comparisons are within blocks.
        level: of the intervals.
        is_adjusted: whether the values are adjusted for covariates.
    """

    data: MeasureData | None
    values: Mapping[tuple[str, ...], Mapping[tuple[str, ...], Floats]]
    level: float
    is_adjusted: bool

    @classmethod
    def among(cls, data: MeasureData, model: AnyModel, factors: Sequence[str], choices: Choices) -> Self:
        """Prepare the values for all pairs of treatments of these factors.

        Runs that differ only in nested factors are pooled.
        """
        found: defaultdict[tuple[str, ...], dict[tuple[str, ...], Floats]] = defaultdict(dict)
        is_adjusted = isinstance(model, AdjustedMeans)
        runs = model.adjusted_data(data) if isinstance(model, AdjustedMeans) else data
        ranked = runs if not data.is_blocked else _complete_blocks(runs)
        if ranked is None or not data.known.is_plain:
            return cls(None, found, 1 - choices.alpha, is_adjusted)
        if not data.is_blocked:
            compared = {*factors, *ranked.others(tuple(factors))}
            names = [name for name in ranked.factors if name in compared]
            # Only combinations with runs: many factors have too many combinations.
            for group in ranked.groups((*names, BATCH) if data.is_extended else names):
                others = tuple(text for name, text in group.treatments.items() if name not in factors)
                found[tuple(group.treatments[name] for name in factors)][others] = group.values
        return cls(ranked, found, 1 - choices.alpha, is_adjusted)

    def of_pair(self, pair: tuple[Group, Group]) -> Iterator[EffectSize]:
        """Yield the effect sizes of a pair: within blocks if there are any."""
        sizes = self._sizes(pair)
        yield from (replace(each, interval=None) for each in sizes) if self.is_adjusted else sizes

    def _sizes(self, pair: tuple[Group, Group]) -> Iterator[EffectSize]:
        if self.data is None:
            return
        if self.data.is_blocked:
            differences = _within_blocks(self.data, pair)
            size = None if differences is None else paired_rank_biserial(differences, self.level)
            yield from () if size is None else (size,)
            return
        first, second = (self.values.get(tuple(treatments.values()), {}) for treatments in pair)
        delta = cliffs_delta([(own, second[others]) for others, own in first.items() if others in second], self.level)
        if delta is not None:
            yield from (delta, vargha_delaney(delta))


def _complete_blocks(data: MeasureData) -> MeasureData | None:
    """Return the mean of each combination in each complete block as one run; None if too many blocks are incomplete.

    Means of all runs in a block would differ by another factor where these are unequal, or one combination lacks.
    """
    layout = layout_of(data)
    if layout is None:
        return None
    frame = data.frame.iloc[layout.rows[layout.starts]]
    return replace(data, frame=frame.assign(**{VALUE: layout.units(data.values).ravel()}))


def _within_blocks(data: MeasureData, pair: tuple[Group, Group]) -> Floats | None:
    """Return the difference in each block that has both treatments; None without such blocks."""
    means = []
    for treatments in pair:
        rows = np.all([data.frame[name].astype(str) == level for name, level in treatments.items()], axis=0)
        means.append(data.frame[VALUE][rows].groupby(data.blocks[rows]).mean())
    differences = (means[0] - means[1]).dropna().to_numpy(dtype=np.float64)
    # Equal differences of decimal fractions, as 0.3 - 0.2 and 0.2 - 0.1, differ in binary, and would be no ties.
    digits = _DIGITS - math.ceil(math.log10(np.max(np.abs(data.values))))
    return np.round(differences, digits) if len(differences) else None
