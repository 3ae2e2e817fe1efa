"""P-values adjusted for their family of tests, and the conclusions from them.

All sentences on a comparison are written here, from the same numbers: those on an effect, on pairs of its treatments
and on hypotheses about it cannot contradict each other.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from robot_runner.analysis.statistics.outcome import HypothesisOutcome, MeasureStatistics
from robot_runner.analysis.statistics.post_hoc import adjusted
from robot_runner.analysis.statistics.tested import (
    Comparison,
    ContrastTest,
    Effect,
    MeasureTest,
    PostHoc,
    TestFamily,
    TestMethod,
    named_within,
)
from robot_runner.analysis.wording import (
    difference_unit,
    listed,
    p_in_words,
    p_values_in_words,
    shown_coefficient,
    shown_level,
    shown_test,
    with_unit,
)
from robot_runner.core.design.analysis_plan import AnalysisPlan, Correction, Estimand, Family
from robot_runner.core.words import counted, enumerated, exact

if TYPE_CHECKING:
    from robot_runner.core.design.hypothesis import Hypothesis

#: The key of a test: an effect by its measure and factors, or the contrast of a hypothesis by its statement.
Key = tuple[str, frozenset[str]]

#: The end of the sentence on an effect that is not significant.
NO_PROOF = "that is not proof that there is none."
_PAIR = 2


@dataclass(frozen=True, slots=True)
class _Adjusted:
    """An adjusted p-value, with the name and size of its family."""

    p_value: float
    family: str
    size: int


def concluded(
    measures: Sequence[MeasureStatistics], plan: AnalysisPlan | None, alpha: float, correction: Correction
) -> tuple[tuple[MeasureStatistics, ...], tuple[HypothesisOutcome, ...]]:
    """Return measures with adjusted p-values and conclusions, and the outcome of each hypothesis.

    The plan is None if there is none, or if it is not followed.
    """
    found = dict(_adjusted(measures, plan, correction))
    done = tuple(_measure(measure, found, alpha) for measure in measures)
    hypotheses = plan.hypotheses if plan is not None else ()
    return done, tuple(judge(hypothesis, done, found, alpha) for hypothesis in hypotheses)


def _adjusted(
    measures: Sequence[MeasureStatistics], plan: AnalysisPlan | None, correction: Correction
) -> Iterator[tuple[Key, _Adjusted]]:
    found = dict(_p_values(measures))
    for name, keys in families_of({each.name: _of(each) for each in measures}, plan):
        tests = {key: found[key] for key in keys if key in found}
        for (key, _), value in zip(tests.items(), adjusted(list(tests.values()), correction), strict=True):
            yield key, _Adjusted(value, name, len(tests))


def families_of(
    tested: Mapping[str, Sequence[Key]], plan: AnalysisPlan | None
) -> Iterator[tuple[str, tuple[Key, ...]]]:
    """Yield the families of tests, over which the error rate is controlled, with their names."""
    left = dict.fromkeys(key for keys in tested.values() for key in keys)
    for name, keys in (*_planned(tested, plan), *((f"the effects on {each}", keys) for each, keys in tested.items())):
        family = tuple(key for key in dict.fromkeys(keys) if key in left)
        for key in family:
            del left[key]
        yield name, family


def effect_key(measure: str, factors: Iterable[str]) -> Key:
    """Return the key of an effect on a measure."""
    return measure, frozenset(factors)


def contrast_key(statement: str) -> Key:
    """Return the key of the contrast of a hypothesis."""
    return f"hypothesis {statement}", frozenset()


def _p_values(measures: Sequence[MeasureStatistics]) -> Iterator[tuple[Key, float]]:
    for measure in measures:
        for effect in measure.effects:
            if effect.p_value is not None:
                yield effect_key(measure.name, effect.factors), effect.p_value
        for each in measure.contrasts:
            yield contrast_key(each.statement), each.p_value


def _of(measure: MeasureStatistics) -> list[Key]:
    tested = [effect_key(measure.name, effect.factors) for effect in measure.effects]
    return [*tested, *(contrast_key(each.statement) for each in measure.contrasts)]


def _planned(tested: Mapping[str, Sequence[Key]], plan: AnalysisPlan | None) -> Iterator[tuple[str, Sequence[Key]]]:
    if plan is None or plan.family is Family.MEASURE:
        return
    if plan.family is Family.HYPOTHESES:
        yield "the hypotheses", [claim_of(each) for each in plan.hypotheses]
    else:
        keys = [key for name, several in tested.items() if name in plan.measures for key in several]
        yield "all effects on the primary measures", keys


def claim_of(hypothesis: Hypothesis) -> Key:
    """Return the key of the test of a hypothesis: of its contrast, or of an effect."""
    if hypothesis.is_contrast:
        return contrast_key(hypothesis.statement)
    return effect_key(hypothesis.measure, hypothesis.factors)


def contrasts_of(plan: AnalysisPlan | None, measure: str) -> list[Hypothesis]:
    """Return the hypotheses of a plan on a contrast or a bound of a measure; none without a plan."""
    return [] if plan is None else [each for each in plan.hypotheses if each.measure == measure and each.is_contrast]


def _measure(measure: MeasureStatistics, found: Mapping[Key, _Adjusted], alpha: float) -> MeasureStatistics:
    test = measure.test
    if test is None:
        return measure
    effects = [
        _effect(measure, effect, found.get(effect_key(measure.name, effect.factors)), alpha) for effect in test.effects
    ]
    interacting = [{*effect.factors} for effect in effects if len(effect.factors) > 1 and effect.is_significant]
    post_hoc = tuple(
        _pairs(each, effect, alpha)
        for each in measure.post_hoc
        for effect in effects
        if effect.factors == each.factors and (len(each.factors) == 1 or _is_largest({*each.factors}, interacting))
    )
    families = tuple(_families(measure, test, found))
    of = families[0] if families else TestFamily("", 0, ())
    test = replace(test, family=of.name, family_size=of.size, families=families)
    worded = tuple(_worded(measure, test, effect, _pairs_of(post_hoc, effect)) for effect in effects)
    return replace(measure, test=replace(test, effects=worded), post_hoc=post_hoc)


def _is_largest(factors: set[str], interacting: Sequence[set[str]]) -> bool:
    """Return whether an interaction is significant, and no larger one that has its factors is."""
    return factors in interacting and not any(factors < each for each in interacting)


def _families(measure: MeasureStatistics, test: MeasureTest, found: Mapping[Key, _Adjusted]) -> Iterator[TestFamily]:
    """Yield the families of the tests of a measure, each with its tests of this measure."""
    tests: dict[tuple[str, int], list[str]] = {}
    labels = [effect.label for effect in test.effects] + [each.statement for each in measure.contrasts]
    for key, label in zip(_of(measure), labels, strict=True):
        if key in found:
            tests.setdefault((found[key].family, found[key].size), []).append(label)
    for (name, size), several in tests.items():
        yield TestFamily(name, size, tuple(several))


def _effect(measure: MeasureStatistics, effect: Effect, found: _Adjusted | None, alpha: float) -> Effect:
    pairs = _pairs_of(measure.post_hoc, effect)
    if len(pairs) == 1 and len(effect.factors) == 1:
        effect = replace(effect, effect_sizes=pairs[0].effect_sizes)
    if found is None:
        return effect
    return replace(effect, adjusted_p_value=found.p_value, is_significant=found.p_value < alpha)


def _pairs(post_hoc: PostHoc, effect: Effect, alpha: float) -> PostHoc:
    """Return pairs with p-values no smaller than that of the effect: without it, no pair is significant."""
    least = effect.adjusted_p_value

    def adjust(pair: Comparison) -> Comparison:
        if pair.adjusted_p_value is None or least is None:
            return pair
        value = least if len(post_hoc.comparisons) == 1 else max(least, pair.adjusted_p_value)
        return replace(pair, adjusted_p_value=value, is_significant=value < alpha)

    return replace(post_hoc, comparisons=tuple(map(adjust, post_hoc.comparisons)))


def _pairs_of(post_hoc: Sequence[PostHoc], effect: Effect) -> tuple[Comparison, ...]:
    return next((each.comparisons for each in post_hoc if each.factors == effect.factors), ())


# Sentences on effects.


def _worded(measure: MeasureStatistics, test: MeasureTest, effect: Effect, pairs: Sequence[Comparison]) -> Effect:
    if effect.p_value is None:
        why = "too few runs vary apart from it, so that there is no variation to test against."
        if test.method is TestMethod.PROPORTIONS:
            why = "no runs with different answers differ in nothing else."
        what = named_within(enumerated(effect.factors), effect.within)
        return replace(effect, conclusion=f"The effect of {what} was not computed: {why}")
    words = _claim(measure, test, effect, pairs)
    is_corrected = any(effect.label in each.tests and each.size > 1 for each in test.families)
    return replace(effect, conclusion=f"{words}{_check_in_words(effect, is_corrected=is_corrected)}")


def _claim(measure: MeasureStatistics, test: MeasureTest, effect: Effect, pairs: Sequence[Comparison]) -> str:
    figures, within = _figures(effect), f" within {effect.within}" if effect.within else ""
    aliases = f", aliased with {listed([' x '.join(each) for each in effect.aliases])}," if effect.aliases else ""
    named = f"{effect.factors[0]}{aliases}" if len(effect.factors) == 1 else ""
    if not effect.is_significant:
        what = f"an effect of {named}" if named else f"an interaction of {enumerated(effect.factors)}{aliases}"
        return f"The data do not show {what} on {measure.name}{within} ({figures}); {NO_PROOF}"
    size = next(iter(effect.effect_sizes), None)
    sized = (
        "" if size is None else f"; the effect is {size.magnitude.value}, {size.name} = {shown_coefficient(size.value)}"
    )
    if not named and aliases:
        return f"{' x '.join(effect.factors)}{aliases} has an effect on {measure.name}{within} ({figures}{sized})."
    if not named:
        others = enumerated(effect.factors[1:])
        return f"The effect of {effect.factors[0]} on {measure.name}{within} depends on {others} ({figures}{sized})."
    return f"{named} has an effect on {measure.name}{within}{_difference(measure, test, pairs)} ({figures}{sized})."


def _figures(effect: Effect) -> str:
    if effect.parts:
        tests = (f"{each.name} {shown_test('F', each.degrees_of_freedom, each.statistic)}" for each in effect.parts)
        figures = f"{', '.join(tests)}, together "
    else:
        figures = f"{shown_test(effect.statistic_name, effect.degrees_of_freedom, effect.statistic)}, "
    return figures + p_values_in_words(effect.p_value or 0.0, effect.adjusted_p_value)


def _difference(measure: MeasureStatistics, test: MeasureTest, pairs: Sequence[Comparison]) -> str:
    """Return the largest significant difference of two treatments, in words.

    With unequal variances, a larger difference may not be significant.
    """
    distinct = [pair for pair in pairs if pair.is_significant]
    if not distinct:
        return ", though no two treatments differ by themselves after correction" if pairs else ""
    pair = max(distinct, key=lambda each: abs(each.difference))
    if test.estimand == Estimand.RANK.value:
        return f": values of {pair.first} rank {_more(pair)} than those of {pair.second}"
    amount = with_unit(abs(pair.difference), difference_unit(measure.unit))
    estimate = f"adjusted {test.estimand}" if test.method is TestMethod.COVARIANCE else test.estimand
    is_largest = all(abs(each.difference) <= abs(pair.difference) for each in pairs)
    rank = f", the largest difference{'' if is_largest else ' that is significant'}" if len(pairs) > 1 else ""
    return f": the {estimate} of {pair.first} is {_more(pair)} than that of {pair.second} by {amount}{rank}"


def _more(pair: Comparison) -> str:
    return "higher" if pair.difference > 0 else "lower"


def _check_in_words(effect: Effect, *, is_corrected: bool) -> str:
    """Return a sentence if the check of the test, which is not corrected, disagrees with it."""
    check = effect.check
    if check is None or check.agrees is not False or check.p_value is None:
        return ""
    p_value = p_in_words(check.p_value)
    if effect.p_value is not None and check.p_value > effect.p_value:
        if not effect.is_significant:  # after correction neither is significant
            return ""
        return f" The test of {check.of} does not show it ({p_value}): it may hang on how large some values are."
    before = " before correction" if is_corrected else ""
    return f" The test of {check.of} does show one ({p_value}{before}): the treatments may differ in other ways."


# Hypotheses.


def judge(
    hypothesis: Hypothesis, measures: Sequence[MeasureStatistics], found: Mapping[Key, _Adjusted], alpha: float
) -> HypothesisOutcome:
    """Return the outcome of a hypothesis, from the adjusted p-value of its test."""
    measure = next((each for each in measures if each.name == hypothesis.measure), None)
    adjusted_p = found.get(claim_of(hypothesis))
    tested = _tested(hypothesis, measure)
    if measure is None or adjusted_p is None or tested is None or tested.p_value is None:
        return HypothesisOutcome(
            hypothesis, None, None, None, f"It could not be tested: {_reason(hypothesis, measure)}"
        )
    is_supported = adjusted_p.p_value < alpha
    verdict = "The data do not support it, which is not proof of the contrary"
    if is_supported:  # in which direction a statement is meant is not known: tests are of either
        verdict = f"The data support it{', unless it claims another direction' * (not hypothesis.has_bound)}"
    figures = f"{p_in_words(adjusted_p.p_value)} after correction for {counted(adjusted_p.size, 'test')}"
    conclusion = f"{verdict} ({figures}). {_result_in_words(tested, measure, hypothesis)}"
    return HypothesisOutcome(hypothesis, tested.p_value, adjusted_p.p_value, is_supported, conclusion)


def _tested(hypothesis: Hypothesis, measure: MeasureStatistics | None) -> Effect | ContrastTest | None:
    if measure is None:
        return None
    if hypothesis.is_contrast:
        return next((each for each in measure.contrasts if each.statement == hypothesis.statement), None)
    return next((each for each in measure.effects if set(each.factors) == set(hypothesis.factors)), None)


def _result_in_words(tested: Effect | ContrastTest, measure: MeasureStatistics, hypothesis: Hypothesis) -> str:
    if hasattr(tested, "conclusion"):
        return tested.conclusion
    is_of_ranks = measure.test is not None and measure.test.estimand == Estimand.RANK.value
    unit = "" if is_of_ranks else difference_unit(measure.unit)
    estimate, low, high = (
        with_unit(each, unit) for each in (tested.estimate, tested.interval.low, tested.interval.high)
    )
    level, what = shown_level(tested.interval.level), "contrast of relative ranks" if is_of_ranks else "contrast"
    claim = ""
    if hypothesis.within is not None:
        claim = f"; the claim is within ±{exact(hypothesis.within)} {unit}".rstrip()
    elif hypothesis.below is not None:
        claim = f"; the claim is below {exact(hypothesis.below)} {unit}".rstrip()
    bound = hypothesis.within if hypothesis.below is None else hypothesis.below
    if bound is not None and 0 < bound < 1 and measure.proportions is not None:  # it may be meant as a fraction
        claim += f" ({shown_level(bound)} would be {exact(100 * bound)})"
    return f"The {what} is estimated as {estimate}, with {level} confidence between {low} and {high}{claim}."


def _reason(hypothesis: Hypothesis, measure: MeasureStatistics | None) -> str:
    if measure is None:
        return f"there is no measure {hypothesis.measure}."
    missed = [each.why for each in measure.not_computed if repr(hypothesis.statement) in each.what]
    if missed:
        return missed[0]
    if measure.test is None:
        return measure.not_computed[0].why if measure.not_computed else "there is no test."
    if measure.test.method is TestMethod.PROPORTIONS and len(hypothesis.factors) > 1:
        return "interactions of proportions are not tested: compare the proportions of the combinations."
    nested = [
        f": {name} is tested within {each.within}"
        for name in hypothesis.factors
        for each in measure.test.effects
        if each.within and each.factors == (name,)
    ]
    return f"the test has no effect of {' x '.join(hypothesis.factors)}{''.join(nested[:1])}."
