"""The report on covariates: slopes, adjusted means and warnings."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from robot_runner.analysis.statistics.analysed_design import VALUE, MeasureData
from robot_runner.analysis.statistics.descriptive import quiet
from robot_runner.analysis.statistics.disclosed import AdjustedMean, Adjustment, Slope
from robot_runner.analysis.statistics.post_hoc import adjusted
from robot_runner.analysis.statistics.tested import NotComputed
from robot_runner.analysis.statistics.tests import Choices, model_of
from robot_runner.analysis.wording import p_in_words
from robot_runner.core.design.analysis_plan import ELAPSED, ORDER, Correction, Estimand
from robot_runner.core.words import enumerated

if TYPE_CHECKING:
    from robot_runner.analysis.statistics.adjusted_means import AdjustedMeans

#: The variance inflation from which on a covariate is nearly collinear with the rest of the design (Marquardt 1970;
#: Kutner et al., Applied Linear Statistical Models, 2005, section 10.5).
_MOST_INFLATED = 10.0

_UNITS = {ORDER: "run", ELAPSED: "s"}


def adjustment_of(
    data: MeasureData, model: AdjustedMeans, choices: Choices, unit_of: Callable[[str], str]
) -> Adjustment:
    """Return how a measure was adjusted for its covariates."""
    slopes = tuple(_slope(data, model, name, choices, unit_of) for name in data.covariates)
    with quiet():
        means = tuple(_means(data, model, choices))
    warnings = (*_doubts(data, slopes, choices.alpha), *_slopes_differ(data, model, choices.alpha))
    return Adjustment(slopes, means, model.slopes_p_value, model.spread, model.residual_spread, warnings)


def _slope(
    data: MeasureData, model: AdjustedMeans, name: str, choices: Choices, unit_of: Callable[[str], str]
) -> Slope:
    covariate = next((each for each in model.covariates if each.name == name), None)
    if covariate is None:
        return Slope(name, "", None, None, None, None, None, None, None, None)
    if choices.estimand is Estimand.RANK:
        unit = "ranks per rank"
    else:
        per = _UNITS.get(name) or unit_of(name) or f"unit of {name}"
        unit = f"{unit_of(data.name)} per {per}".strip()
    found = model.slope(covariate)
    p_value = float(found.p_value)
    is_known = math.isfinite(p_value)
    return Slope(
        name,
        unit,
        float(found.estimate),
        found.interval(choices.alpha) if is_known else None,
        float(found.t_value) if is_known else None,
        float(found.freedom) if is_known else None,
        p_value if is_known else None,
        covariate.centre,
        covariate.inflation,
        _treatments_p_value(data, name),
    )


def _treatments_p_value(data: MeasureData, name: str) -> float | None:
    """Return the p-value of the test that treatments do not change a covariate: of all effects, corrected by Holm."""
    frame = data.frame.assign(**{VALUE: data.covariate(name)})
    model = model_of(replace(data, frame=frame, every=frame), Estimand.MEAN)
    if isinstance(model, NotComputed):
        return None
    with quiet():
        found = [float(effect.p_value) for effect in model.effects()]
    return min(adjusted([each for each in found if math.isfinite(each)], Correction.HOLM), default=None)


def _means(data: MeasureData, model: AdjustedMeans, choices: Choices) -> Iterator[AdjustedMean]:
    plain = model_of(data, choices.estimand, choices.statistic)
    for factor in data.factors:
        for level in data.levels(factor):
            weights = [({factor: level}, 1.0)]
            found = model.difference(weights)
            mean = None if isinstance(plain, NotComputed) else float(plain.difference(weights).estimate)
            interval = None if data.is_blocked else found.interval(choices.alpha)
            yield AdjustedMean({factor: level}, mean, float(found.estimate), interval)


def _doubts(data: MeasureData, slopes: Sequence[Slope], alpha: float) -> Iterator[str]:
    if constant := [slope.covariate for slope in slopes if slope.value is None]:
        where = "within each block" if data.is_blocked else "in all runs"
        same = f"which {'is' if len(constant) == 1 else 'are'} the same {where}"
        yield f"{data.name} is not adjusted for {enumerated(constant)}, {same}."
    for slope in slopes:
        if slope.inflation is not None and slope.inflation > _MOST_INFLATED:
            yield (
                f"The covariate {slope.covariate} goes closely together with treatments, blocks or others "
                f"(its variance is inflated {slope.inflation:.3g} times): what it explains of {data.name} can "
                "hardly be told apart from these."
            )
        p_value = slope.treatments_p_value
        if p_value is not None and p_value < alpha:
            yield _affected(data.name, slope.covariate, p_value)


def _affected(measure: str, covariate: str, p_value: float) -> str:
    if covariate in _UNITS:
        how = "order of execution" if covariate == ORDER else "time"
        return (
            f"Treatments are unevenly spread over the {how} ({p_in_words(p_value)}): what changes with it and what "
            f"they do to {measure} is told apart by a straight line alone."
        )
    return (
        f"The covariate {covariate} differs between treatments ({p_in_words(p_value)}): if they change it, it is a "
        f"result and no covariate, and adjusting {measure} for it takes away a part of their effect."
    )


def _slopes_differ(data: MeasureData, model: AdjustedMeans, alpha: float) -> Iterator[str]:
    p_value = model.slopes_p_value
    if p_value is not None and p_value < alpha:
        names = enumerated([covariate.name for covariate in model.covariates])
        yield (
            f"Slopes of {data.name} over {names} differ between treatments ({p_in_words(p_value)}): differences of "
            "adjusted means hold at the mean of the covariates."
        )
