"""Meta-analysis: combine the effects of treatments over several experiments, measure by measure."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from scipy import special

from robot_runner.analysis.comparison.combined import (
    CombinedEffect,
    CombinedMeasure,
    EffectIn,
    MetaAnalysis,
    combine,
    label_of_effect,
)
from robot_runner.analysis.comparison.combined_document import conclusion_of_effect
from robot_runner.analysis.comparison.compared import Side
from robot_runner.analysis.comparison.harmonising import (
    Experiment,
    MeasureChoice,
    chosen_measures_of_all,
    differing_names,
    renamed,
    repeated,
    unit_findings,
    value_findings,
)
from robot_runner.analysis.comparison.matching import differing_circumstances, names_of
from robot_runner.analysis.results import Results, results_of
from robot_runner.analysis.run_frame import several
from robot_runner.analysis.statistics.batch_strata import comparable
from robot_runner.analysis.statistics.cell_moments import freedom_of
from robot_runner.analysis.statistics.descriptive import out_of_range, quiet
from robot_runner.analysis.statistics.experiment_statistics import SEARCHED
from robot_runner.analysis.statistics.lost_runs import failures_in_words
from robot_runner.analysis.statistics.post_hoc import adjusted_known
from robot_runner.analysis.statistics.tested import NotComputed
from robot_runner.analysis.statistics.tests import AnyModel, planned_model_of
from robot_runner.core.design.analysis_plan import Correction, Estimand
from robot_runner.core.design.outliers import Doubtful
from robot_runner.core.errors import AnalysisError, Finding
from robot_runner.core.storage.executed_runs import changes_in_words

if TYPE_CHECKING:
    from robot_runner.analysis.statistics.analysed_design import MeasureData
    from robot_runner.core.design.analysis_plan import AnalysisPlan

_ALPHA = 0.05
_FEWEST = 2
_NO_NUMBERS = "the values are not numbers."
_NO_PROPORTIONS = "proportions are not combined: compare two experiments at a time."
#: More pairs could not be read, and correction would leave no power to test them.
_MOST_PAIRS = 105


def meta_analyse(
    *experiments: Results | Path | str,
    measures: str | Sequence[str] | None = None,
    alpha: float = _ALPHA,
    same: str | Sequence[str] = (),
) -> MetaAnalysis:
    """Combine the effects of treatments over several experiments, which are replications of each other.

    Within each experiment, treatments are compared by the difference of means, as in its report; the differences are
    then averaged over experiments.

    Args:
        experiments: at least two experiments, or their folders.
        measures: names, or `one=other` where names differ between experiments; None for the primary measures of the
            experiments' plans or, without any, all numeric measures of at least two experiments.
        alpha: the level of significance, below 0.5.
        same: factors and treatments whose names differ between experiments, each as `name=other`.

    Example:
        >>> found = meta_analyse("original", "replication", "third_lab", measures=["Energy"])  # doctest: +SKIP
        >>> found.measure("Energy").effects[0].difference.random.interval  # doctest: +SKIP

    Raises:
        StorageError: a folder holds no experiment, or cannot be read.
        AnalysisError: the experiments cannot be combined: one is given twice, or is a copy of another; there is no such
            measure, or units cannot be converted; `findings` lists all problems.
    """
    if not 0 < alpha < 0.5:  # noqa: PLR2004 - what is above is meant as a confidence
        raise AnalysisError(f"alpha is {alpha!r}", where="meta_analyse", fix="Give a number between 0 and 0.5.")
    results = list(map(results_of, experiments))
    if len(results) < _FEWEST:
        raise AnalysisError(f"{len(results)} experiment is given", where="meta_analyse", fix="Give two and more.")
    given = [Experiment.of_results(*each) for each in zip(names_of(*results), results, strict=True)]
    findings = list(repeated(given))
    alike, found = renamed(given, several(same))
    findings += [*found, *differing_names(alike)]
    chosen, found = chosen_measures_of_all(alike, None if measures is None else several(measures))
    findings += found
    findings += [finding for of in (unit_findings, value_findings) for each in chosen for finding in of(each, alike)]
    told = [(each.name, (failures_in_words(each.results), changes_in_words(each.results.manifest))) for each in alike]
    findings += [Finding.warning(name, why) for name, whys in told for why in whys if why]
    findings += [Finding.warning(each.name, why) for each in alike if (why := _other_estimand(each.results.plan))]
    findings += [Finding.warning(each.name, odd.problem, odd.fix) for each in alike for odd in each.results.findings]
    AnalysisError.refuse(each for each in findings if each.is_error)
    factors = [name for each in alike for name in each.design.factors]
    return MetaAnalysis(
        tuple(Side(each.name, each.results.name, each.results.folder, len(each.results.done)) for each in alike),
        alpha,
        tuple(name for name in dict.fromkeys(factors) if factors.count(name) >= _FEWEST),
        tuple(_combined(choice, alike, alpha) for choice in chosen),
        differing_circumstances(*results),
        tuple(findings),
    )


def _other_estimand(plan: AnalysisPlan | None) -> str:
    """Return that the report of an experiment compares no means; empty where it does."""
    if plan is None or plan.estimand is Estimand.MEAN:
        return ""
    return f"the plan of this experiment compares {plan.estimand.value}s, and means are combined"


class _Estimated(NamedTuple):
    """One experiment's model of one measure."""

    experiment: str
    data: MeasureData
    model: AnyModel


class _Question(NamedTuple):
    """A difference or contrast to estimate in each experiment."""

    factor: str
    weights: Mapping[str, float]
    statement: str = ""


def _combined(choice: MeasureChoice, experiments: Sequence[Experiment], alpha: float) -> CombinedMeasure:
    missing: list[NotComputed] = []
    telling: list[_Estimated] = []
    for each in experiments:
        found = _estimated(each, choice) if each.name in choice.columns else None
        if isinstance(found, NotComputed):
            missing.append(found)
        elif found is not None:
            telling.append(found)
    effects: list[CombinedEffect] = []
    for question in _questions(choice, experiments, telling, missing):
        answers = _answers(question, telling, alpha)
        if len(answers) < _FEWEST:
            known = f"only {answers[0].experiment} estimates it" if answers else "no experiment estimates it"
            what = f"average of {label_of_effect(question.weights, question.statement)}"
            missing.append(NotComputed(what, f"{known}: two are needed."))
            continue
        effects.append(_averaged(question, answers, alpha))
    if not effects and not missing:
        missing.append(NotComputed(f"effects on {choice.name}", "no two experiments vary the same factor."))
    names = {each.name: each for each in experiments}
    origins = {name: names[name].results.columns[column].origin for name, column in choice.columns.items()}
    judged = tuple(_judged(effects, choice, alpha))
    return CombinedMeasure(choice.name, choice.columns, choice.unit, origins, choice.is_primary, judged, tuple(missing))


def _estimated(experiment: Experiment, choice: MeasureChoice) -> _Estimated | NotComputed:
    """Estimate the means of an experiment's combinations, as in its report."""
    what, column, plan = f"{choice.name} in {experiment.name}", choice.columns[experiment.name], experiment.results.plan
    if experiment.results.confirming.is_exploratory:
        return NotComputed(what, SEARCHED)
    if plan is not None and plan.doubtful is Doubtful.REFUSE and column in experiment.doubtful:
        return NotComputed(what, "the experiment's plan draws no conclusion on a measure with doubtful values.")
    data = experiment.data(column, choice.unit)
    if data is None or not len(data.frame):
        why = _NO_PROPORTIONS if experiment.design.answers(column) is not None else _NO_NUMBERS
        return NotComputed(what, why if data is None else "no run that is done has a value.")
    if odd := out_of_range(data.values):
        return NotComputed(what, f"the measure {odd}")
    compared, _, apart = comparable(data)
    if not compared.factors:
        return NotComputed(what, apart[0].why if apart else "all runs that have a value have the same treatments.")
    model = planned_model_of(compared, Estimand.MEAN)
    return (
        NotComputed(what, model.why) if isinstance(model, NotComputed) else _Estimated(experiment.name, compared, model)
    )


def _questions(
    choice: MeasureChoice, experiments: Sequence[Experiment], telling: Sequence[_Estimated], missing: list[NotComputed]
) -> Iterator[_Question]:
    """Yield all pairs of treatments of factors that at least two experiments vary, then the contrasts of plans."""
    factors = [name for each in telling for name in each.data.factors]
    shared = [name for name in dict.fromkeys(factors) if factors.count(name) >= _FEWEST]
    for factor in shared:
        levels = dict.fromkeys(
            name for each in telling if factor in each.data.factors for name in each.data.levels(factor)
        )
        if math.comb(len(levels), 2) > _MOST_PAIRS:
            why = f"{len(levels)} treatments make {math.comb(len(levels), 2):,} pairs: name contrasts in a plan."
            missing.append(NotComputed(f"pairs of {factor}", why))
            continue
        yield from (_Question(factor, {one: 1.0, other: -1.0}) for one, other in combinations(levels, 2))
    asked = {
        (each.factor, frozenset(each.weights.items())): each
        for experiment in reversed(experiments)
        for each in _planned(experiment, choice)
    }
    yield from (question for question in reversed(asked.values()) if question.factor in shared)


def _planned(experiment: Experiment, choice: MeasureChoice) -> Iterator[_Question]:
    """Yield the contrasts in the hypotheses of an experiment's plan."""
    names = experiment.new_names
    for hypothesis in experiment.results.plan.hypotheses if experiment.results.plan else ():
        weights = {names.get(name, name): weight for name, weight in (hypothesis.contrast or {}).items()}
        is_pair = sorted(weights.values()) == [-1.0, 1.0]
        if weights and not is_pair and hypothesis.measure == choice.columns.get(experiment.name):
            (factor,) = hypothesis.factors
            yield _Question(names.get(factor, factor), weights, hypothesis.statement)


def _answers(question: _Question, telling: Sequence[_Estimated], alpha: float) -> list[EffectIn]:
    """Return each experiment's estimate of a difference, with the variance of g at the average g, weighted by runs.

    With the variance at an experiment's own g, a g that is larger by chance would get less weight, so that the average
    of large effects in few runs would be too small (Hedges, Estimation of effect size from a series of independent
    experiments, Psychological Bulletin 92, 1982; in R `metafor::escalc(vtype = "AV")`). This holds for independent
    runs. Within blocks, errors and standard deviations are small together, their influences on the weight are opposite,
    and the average is right with the variance at the own g.
    """
    first = [answer for each in telling if (answer := _answer(question, each, alpha)) is not None]
    known = [each.g for each in first if each.g is not None]
    if len(known) < len(first) or not known:
        return first
    average = sum(each.runs * g for each, g in zip(first, known, strict=True)) / sum(each.runs for each in first)
    return [answer for each in telling if (answer := _answer(question, each, alpha, average)) is not None]


def _answer(question: _Question, of: _Estimated, alpha: float, average: float | None = None) -> EffectIn | None:
    """Return an experiment's estimate of a difference; None where it lacks a treatment, or its values do not vary."""
    factor, weights = question.factor, question.weights
    if factor not in of.data.factors or not set(weights) <= set(of.data.levels(factor)):
        return None
    with quiet():
        found = of.model.difference([({factor: level}, weight) for level, weight in weights.items()])
    estimate, error, freedom, spread = (float(each) for each in (*found, of.model.spread))
    if not (error > 0 and freedom > 0 and math.isfinite(freedom) and spread > 0):
        return None
    own = freedom_of(of.model.spread_parts) if of.model.spread_parts else freedom
    is_alone = of.data.known.is_plain and not of.data.is_blocked
    g, g_error = hedges_g(estimate, error, own, spread, average if is_alone else None)
    return EffectIn(
        of.experiment,
        int(of.data.frame[factor].astype(str).isin(list(weights)).sum()),
        estimate,
        error,
        freedom,
        found.interval(alpha),
        float(found.p_value),
        g,
        g_error,
        # The common part of error and standard deviation cancels out of the error of g (Satterthwaite 1946).
        freedom * own / (own - freedom) if own > freedom else math.inf,
    )


def hedges_g(
    difference: float, error: float, freedom: float, spread: float, average: float | None = None
) -> tuple[float, float] | tuple[None, None]:
    """Return Hedges' g of a difference, and its standard error.

    The difference is divided by the same standard deviation as in the report, and corrected for bias; the variance is
    unbiased, too (Hedges, Distribution theory for Glass's estimator of effect size and related estimators, Journal of
    Educational Statistics 6, 1981). The error is that of the difference, and the degrees of freedom are those of the
    standard deviation `spread`. The variance is computed at the average g; with None at the own one. Both are None for
    a single degree of freedom, where g has no mean.
    """
    if freedom <= 1:
        return None, None
    logarithm = float(special.gammaln(freedom / 2) - special.gammaln((freedom - 1) / 2))
    correction = math.exp(logarithm) * math.sqrt(2 / freedom)
    g = correction * difference / spread
    share = 1 - (freedom - 2) / (freedom * correction**2)
    return g, math.sqrt((error / spread) ** 2 + share * (g if average is None else average) ** 2)


def _averaged(question: _Question, told: Sequence[EffectIn], alpha: float) -> CombinedEffect:
    difference = combine(
        [each.estimate for each in told], [each.error for each in told], [each.freedom for each in told], alpha=alpha
    )
    sizes = [(each.g, each.g_error) for each in told if each.g is not None and each.g_error is not None]
    standardised = None
    if len(sizes) == len(told):
        g, g_error = zip(*sizes, strict=True)
        standardised = combine(g, g_error, [each.g_freedom for each in told], alpha=alpha)
    return CombinedEffect(*question, tuple(told), difference, standardised)


def _judged(effects: Sequence[CombinedEffect], choice: MeasureChoice, alpha: float) -> Iterator[CombinedEffect]:
    """Yield the effects with adjusted p-values and conclusions."""
    after = adjusted_known((each.difference.random.p_value for each in effects), Correction.HOLM)
    for each, p_value in zip(effects, after, strict=True):
        judged = replace(each, adjusted_p_value=p_value, is_significant=None if p_value is None else p_value < alpha)
        yield replace(judged, conclusion=conclusion_of_effect(judged, choice.name, choice.unit, alpha))
