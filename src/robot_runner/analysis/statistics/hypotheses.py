"""What came of the hypotheses that were fixed before the experiment."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robot_runner.analysis.statistics.outcome import HypothesisOutcome
from robot_runner.analysis.statistics.post_hoc import adjusted
from robot_runner.analysis.wording import p_in_words

if TYPE_CHECKING:
    from collections.abc import Sequence

    from robot_runner.analysis.statistics.outcome import MeasureStatistics
    from robot_runner.analysis.statistics.tested import Effect
    from robot_runner.design.analysis_plan import Correction, Hypothesis

__all__ = ["judge"]


def judge(
    hypotheses: Sequence[Hypothesis], measures: Sequence[MeasureStatistics], alpha: float, correction: Correction
) -> tuple[HypothesisOutcome, ...]:
    """Return the outcome of each hypothesis; p-values are adjusted for the number of hypotheses that were tested."""
    by_name = {measure.name: measure for measure in measures}
    effects = [_effect(hypothesis, by_name.get(hypothesis.measure)) for hypothesis in hypotheses]
    tested = [effect.p_value for effect in effects if effect is not None and effect.p_value is not None]
    after = iter(adjusted(tested, correction))
    outcomes = []
    for hypothesis, effect in zip(hypotheses, effects, strict=True):
        if effect is None or effect.p_value is None:
            why = _reason(hypothesis, by_name.get(hypothesis.measure))
            outcomes.append(HypothesisOutcome(hypothesis, None, None, None, f"It could not be tested: {why}"))
        else:
            outcomes.append(_outcome(hypothesis, effect, effect.p_value, next(after), alpha))
    return tuple(outcomes)


def _effect(hypothesis: Hypothesis, measure: MeasureStatistics | None) -> Effect | None:
    if measure is None or measure.test is None:
        return None
    return next((each for each in measure.test.effects if set(each.factors) == set(hypothesis.factors)), None)


def _outcome(
    hypothesis: Hypothesis, effect: Effect, p_value: float, adjusted_p_value: float, alpha: float
) -> HypothesisOutcome:
    is_supported = adjusted_p_value < alpha
    verdict = "The data support it" if is_supported else "The data do not support it, which is no proof of the contrary"
    conclusion = f"{verdict} ({p_in_words(adjusted_p_value)} after correction). {effect.conclusion}"
    return HypothesisOutcome(hypothesis, p_value, adjusted_p_value, is_supported, conclusion)


def _reason(hypothesis: Hypothesis, measure: MeasureStatistics | None) -> str:
    if measure is None:
        return f"there is no measure {hypothesis.measure}."
    if measure.test is None:
        return measure.not_computed[0].why if measure.not_computed else "there is no test."
    return f"the test has no effect of {' x '.join(hypothesis.factors)}."
