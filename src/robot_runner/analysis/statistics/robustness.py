"""Sensitivity: whether conclusions stand if one choice of the analysis changes, such as without doubtful values."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

from robot_runner.analysis.statistics.disclosed import Beside
from robot_runner.analysis.statistics.outcome import HypothesisOutcome, MeasureStatistics, Standing
from robot_runner.analysis.wording import listed, p_in_words, p_values_in_words
from robot_runner.core.events.measure import Quality
from robot_runner.core.words import counted, enumerated

if TYPE_CHECKING:
    from robot_runner.analysis.results import Results
    from robot_runner.analysis.statistics.tested import Effect
    from robot_runner.core.design.hypothesis import Hypothesis


class Otherwise(NamedTuple):
    """The difference of a sensitivity analysis from the planned one.

    Attributes:
        left_out: the runs that it, or the planned one, leaves out, by measure.
        covariates: those of the plan.
    """

    beside: Beside
    left_out: Mapping[str, Sequence[str]]
    covariates: Sequence[str] = ()

    def in_words(self, measure: str) -> str:
        """Return the beginning of the sentence on a measure."""
        runs = self.left_out.get(measure, ())
        if self.beside is Beside.WITHOUT_DOUBTFUL:
            return f"Without the {counted(len(runs), 'run')} whose {measure} is doubtful ({listed(runs)}),"
        if self.beside is Beside.ALL_RUNS:
            verb = "is" if len(runs) == 1 else "are"
            return f"With the {counted(len(runs), 'run')} that {verb} left out of {measure} ({listed(runs)}),"
        return f"Not adjusted for {enumerated(self.covariates)},"


def doubtful_runs(results: Results) -> dict[str, tuple[str, ...]]:
    """Return the runs with a doubtful value, by measure; measures without doubtful values are left out."""
    quality = results.quality
    doubtful = quality[quality["quality"] == Quality.DOUBTFUL.value]
    return {str(name): tuple(rows["run_id"]) for name, rows in doubtful.groupby("measure", sort=False)}


def standing_effects(
    measures: Sequence[MeasureStatistics], without: Sequence[MeasureStatistics], otherwise: Otherwise
) -> Iterator[Standing]:
    """Yield, for each effect on a measure of a sensitivity analysis, whether its conclusion stands."""
    by_name = {measure.name: measure for measure in without}
    for measure in measures:
        for effect in measure.effects if measure.name in by_name else ():
            yield _standing_effect(measure, effect, by_name[measure.name], otherwise)


def standing_hypotheses(
    outcomes: Sequence[HypothesisOutcome],
    without: Sequence[HypothesisOutcome],
    otherwise: Otherwise,
    measures: Sequence[tuple[MeasureStatistics, MeasureStatistics]],
) -> Iterator[Standing]:
    """Yield, for each hypothesis on one of these measures, whether its outcome stands.

    The measures are pairs of the planned statistics and those of the sensitivity analysis.
    """
    by_name = {planned.name: (planned, changed) for planned, changed in measures}
    for now, then in zip(outcomes, without, strict=True):
        measure = now.hypothesis.measure
        if measure not in by_name or now.is_supported is None:
            continue
        p_value = then.adjusted_p_value
        if p_value is None:
            text, stands = "it could not be tested", None
        else:
            turned = bool(then.is_supported) and _has_turned(now.hypothesis, *by_name[measure])
            stands = now.is_supported == then.is_supported and not turned
            supported = "support" if then.is_supported else "do not support"
            other = " in the other direction" if turned else ""
            text = (
                f"the data {'still ' if stands else ''}{supported} it{other} ({p_in_words(p_value)} after correction)"
            )
        yield Standing(
            measure,
            tuple(now.hypothesis.factors),
            now.hypothesis.statement,
            tuple(otherwise.left_out.get(measure, ())),
            now.adjusted_p_value,
            p_value,
            stands,
            f"{otherwise.in_words(measure)} {text}{_verdict(stands, otherwise.beside)}",
            otherwise.beside,
        )


def _has_turned(hypothesis: Hypothesis, planned: MeasureStatistics, changed: MeasureStatistics) -> bool:
    """Return whether the contrast of a hypothesis, or the difference of its two treatments, has changed its sign."""
    if hypothesis.has_bound:
        return False
    if not hypothesis.is_contrast:
        return _turned(planned, changed, hypothesis.factors)
    now, then = (
        [each.estimate for each in of.contrasts if each.statement == hypothesis.statement] for of in (planned, changed)
    )
    return len(now) == len(then) == 1 and now[0] * then[0] < 0


def gathered(standings: Sequence[Standing], most: int) -> Iterator[str]:
    """Yield sentences on whether conclusions stand; more than `most` with the same verdict are only counted.

    Those that do not stand are listed one by one, and so are all those without covariates.
    """
    for beside in Beside:
        of_kind = [each for each in standings if each.beside is beside]
        yield from (each.conclusion for each in of_kind if each.stands is False)
        for verdict, what in ((True, "conclusions"), (None, "effects")):
            alike = [each for each in of_kind if each.stands is verdict]
            if len(alike) <= most or beside is Beside.WITHOUT_COVARIATES:
                yield from (each.conclusion for each in alike)
                continue
            measure = alike[0].measure
            which = f"{len(alike)} {'other ' * (len(alike) < len(of_kind))}{what} on {measure}"
            told = (
                f"{which} stand."
                if verdict
                else f"{which} cannot be tested: whether these conclusions stand is not known."
            )
            yield f"{Otherwise(beside, {measure: alike[0].left_out}).in_words(measure)} {told}"


def _standing_effect(
    measure: MeasureStatistics, effect: Effect, without: MeasureStatistics, otherwise: Otherwise
) -> Standing:
    then = next((each for each in without.effects if set(each.factors) == set(effect.factors)), None)
    p_value = None if then is None else then.p_value
    what = f"effect of {effect.label} on {measure.name}"
    if then is None or p_value is None or effect.is_significant is None:
        why = without.not_computed[0].why if without.not_computed else "no test fits."
        text, stands = f"the {what} cannot be tested: {why.rstrip('.')}", None
    else:
        turned = _turned(measure, without, effect.factors)
        stands = effect.is_significant == then.is_significant and not (then.is_significant and turned)
        figures = p_values_in_words(p_value, then.adjusted_p_value)
        text = f"the {what} is {_changed(effect, then, turned=turned)} ({figures})"
    runs = tuple(otherwise.left_out.get(measure.name, ()))
    conclusion = f"{otherwise.in_words(measure.name)} {text}{_verdict(stands, otherwise.beside)}"
    return Standing(
        measure.name, effect.factors, "", runs, effect.p_value, p_value, stands, conclusion, otherwise.beside
    )


def _changed(effect: Effect, then: Effect, *, turned: bool) -> str:
    if effect.is_significant and then.is_significant:
        return "significant in the other direction" if turned else "still significant"
    if then.is_significant:
        return "significant"
    return "no longer significant" if effect.is_significant else "still not significant"


def _turned(measure: MeasureStatistics, without: MeasureStatistics, factors: Sequence[str]) -> bool:
    """Return whether the difference of two treatments has changed its sign."""
    now, then = (
        [pair.difference for each in of.post_hoc if each.factors == tuple(factors) for pair in each.comparisons]
        for of in (measure, without)
    )
    return len(now) == len(then) == 1 and now[0] * then[0] < 0


def _verdict(stands: bool | None, beside: Beside) -> str:
    if stands is None:
        return "; whether the conclusion stands is not known."
    if stands:
        return ": the conclusion stands."
    # The plan chose the adjustment, without which effects are less precise: this does not refute the conclusion.
    where = " without the adjustment" if beside is Beside.WITHOUT_COVARIATES else ""
    return f": the conclusion does not stand{where}."
