"""What a recomputation has to know of one measure: what was compared by which procedure, and what the report says."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from robot_runner.analysis.recomputing.study_facts import (
    LEVEL,
    Compared,
    Contrasted,
    Distributed,
    MeasureFacts,
    Paired,
    Reported,
    TestedEffect,
)
from robot_runner.analysis.statistics.batch_strata import comparable
from robot_runner.analysis.statistics.cell_means import CellMeans
from robot_runner.analysis.statistics.descriptive import quiet
from robot_runner.analysis.statistics.known_precision import level_of_looks
from robot_runner.analysis.statistics.linear_model import FittedModel
from robot_runner.analysis.statistics.tested import NotComputed
from robot_runner.analysis.statistics.tests import check_estimand, model_of
from robot_runner.core.design.analysis_plan import Estimand
from robot_runner.core.design.columns import RUN_ID

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from robot_runner.analysis.recomputing.study_facts import Number
    from robot_runner.analysis.statistics.analysed_design import Design, MeasureData
    from robot_runner.analysis.statistics.outcome import Description, MeasureStatistics
    from robot_runner.analysis.statistics.tested import Comparison, Effect, EffectSize, Interval, PostHoc
    from robot_runner.analysis.statistics.tests import Choices
    from robot_runner.core.design.hypothesis import Hypothesis

    Model = CellMeans | FittedModel
    Row = dict[str, Number]

__all__ = ["facts_of_measure"]

#: The procedure that carries out each test of the report, by what the report calls it.
_PROCEDURES = {
    "Welch's t": "welch",
    "t within blocks": "welch",
    "Welch's ANOVA": "welch_james",
    "Welch-James": "welch_james",
    "ANOVA-type": "anova_type",
    "Welch-James and ANOVA-type": "combined",
    "Greenhouse-Geisser": "greenhouse_geisser",
    "Huynh-Feldt": "huynh_feldt",
    "linear model with one variance": "model",
    "linear mixed model": "model",
}
#: The models that scripts know how to fit again; of others they take the p-values from the report.
_KNOWN = (CellMeans, FittedModel)
_OF_BLOCKS, _BOOTSTRAP = " of blocks", ", parametric bootstrap"


def facts_of_measure(
    design: Design,
    measure: MeasureStatistics,
    choices: Choices,
    hypotheses: Sequence[Hypothesis],
    key_of: Callable[[str], str],
    beside: str = "",
) -> MeasureFacts:
    """Return what a recomputation has to know of one measure.

    Args:
        design: of the experiment; without the runs whose values are left out.
        measure: its statistics, as the report has them.
        choices: what was chosen for the analysis beforehand.
        hypotheses: of the plan.
        key_of: makes a name its own among all of the study.
        beside: which choice is made otherwise than planned, in words.
    """
    data = design.data(measure.name)
    assert data is not None  # noqa: S101 - it has statistics
    label = f"{measure.name} {beside}".rstrip()
    effects = measure.test.effects if measure.test is not None else ()
    effect_keys = {effect.factors: key_of(f"{label}: {effect.label}") for effect in effects}
    contrast_keys = {each.statement: key_of(f"{label}: {each.statement}") for each in measure.contrasts}
    checks = [(" / ".join(each.treatments.values()) or "all groups", each) for each in measure.assumptions]
    levels = level_of_looks(design.results, measure.name)
    facts = MeasureFacts(
        key=key_of(label),
        name=measure.name,
        label=label,
        factors=data.factors,
        left_out=tuple(sorted(design.without & set(design.frame[RUN_ID]))),
        described=tuple(
            (names, Reported.of([(each.label, _described(each)) for each in of])) for names, of in _groups(measure)
        ),
        is_extended=data.is_extended,
        distributed=tuple(Distributed(each.name, dict(each.treatments)) for each in measure.assumptions),
        distribution=Reported.of(
            [(f"{each.name}, {of}", {"statistic": each.statistic, "p": each.p_value}) for of, each in checks]
        ),
        quantiles=_quantiles(measure),
        drift=_drift(measure),
        power=_power(measure),
        compared=None,
        effect_keys=effect_keys,
        contrast_keys=contrast_keys,
        taken={},
        skipped=0,
        level=LEVEL if levels is None else levels,
    )
    return _with_comparisons(facts, data, measure, choices, hypotheses)


def _groups(measure: MeasureStatistics) -> Iterator[tuple[tuple[str, ...], list[Description]]]:
    """Yield the groups that are described, by the factors that they differ in."""
    groups: dict[tuple[str, ...], list[Description]] = {}
    if measure.overall is not None:
        groups[()] = [measure.overall]
    for each in (*measure.by_treatment, *measure.by_combination):
        groups.setdefault(tuple(each.treatments), []).append(each)
    yield from groups.items()


def _with_comparisons(
    facts: MeasureFacts,
    data: MeasureData,
    measure: MeasureStatistics,
    choices: Choices,
    hypotheses: Sequence[Hypothesis],
) -> MeasureFacts:
    """Return facts with what is compared; without all that is adjusted for covariates, or compared in unknown ways."""
    has_own_residuals = bool(data.covariates) or not data.known.is_plain  # which scripts do not know
    if measure.test is None and not has_own_residuals:
        return facts
    p_values = {facts.effect_keys[each.factors]: each.p_value for each in measure.test.effects} if measure.test else {}
    p_values |= {facts.contrast_keys[each.statement]: each.p_value for each in measure.contrasts}
    compared = None if has_own_residuals else _compared(facts, data, measure, choices, hypotheses)
    if compared is not None:
        return replace(facts, compared=compared)
    left = [_tested(measure, "ranks"), _contrasts(measure)]
    left += [_paired(each, "", "ranks").reported for each in measure.post_hoc]
    left += [
        each for each in (facts.distribution, facts.quantiles, facts.drift, facts.power) if has_own_residuals and each
    ]
    skipped = sum(len(each.numbers) for each in left)
    taken = {key: value for key, value in p_values.items() if value is not None}
    if not has_own_residuals:
        return replace(facts, taken=taken, skipped=skipped)
    nothing = Reported.of([])
    return replace(
        facts,
        taken=taken,
        skipped=skipped,
        distributed=(),
        distribution=nothing,
        quantiles=None,
        drift=None,
        power=None,
    )


def _described(of: Description) -> Row:
    low, high = _ends(of.mean_interval)
    return {
        "n": of.n,
        "missing": of.missing,
        "mean": of.mean,
        "sd": of.sd,
        "minimum": of.minimum,
        "first quartile": of.first_quartile,
        "median": of.median,
        "third quartile": of.third_quartile,
        "maximum": of.maximum,
        "low": low,
        "high": high,
        "outliers": len(of.outliers),
        "extreme": sum(each.is_extreme for each in of.outliers),
    }


def _ends(interval: Interval | None) -> tuple[Number, Number]:
    return (None, None) if interval is None else (interval.low, interval.high)


def _quantiles(measure: MeasureStatistics) -> Reported | None:
    found = measure.quantiles
    if found is None:
        return None
    return Reported.of([("reference line", {"slope": found.slope, "intercept": found.intercept})])


def _drift(measure: MeasureStatistics) -> Reported | None:
    found = measure.drift
    if found is None:
        return None
    low, high = _ends(found.slope_interval)
    row = {"rho": found.correlation, "p": found.p_value, "slope": found.slope, "low": low, "high": high}
    return Reported.of([("over the order of execution", row)])


def _power(measure: MeasureStatistics) -> Reported | None:
    found = measure.power
    if found is None:
        return None
    row: Row = {"detectable effect": found.detectable_effect}
    row |= {f"runs for {each.effect_size:g}": each.repetitions for each in found.needed}
    return Reported.of([(found.effect_name, row)])


def _compared(
    facts: MeasureFacts,
    data: MeasureData,
    measure: MeasureStatistics,
    choices: Choices,
    hypotheses: Sequence[Hypothesis],
) -> Compared | None:
    """Return what is compared of a measure, and how; None where that is not known here."""
    used, _, _ = comparable(data)
    model = model_of(used, choices.estimand, choices.statistic)
    beside = model_of(used, check_estimand(choices.estimand), choices.statistic)
    if measure.test is None or not isinstance(model, _KNOWN) or not isinstance(beside, (*_KNOWN, NotComputed)):
        return None
    tested, checked = (_procedures(each) for each in (model, beside))
    effects = [_effect(each, facts, model, tested, checked) for each in measure.test.effects]
    known = [each for each in effects if each is not None]
    if len(known) < len(effects):
        return None
    levels = _levels(model)
    of = "means" if choices.estimand is Estimand.RANK else "ranks"
    by_statement = {each.statement: each for each in hypotheses}
    is_blocked = isinstance(model, CellMeans) and model.layout.is_blocked
    of_cells = "blocks" if is_blocked else "runs"
    rest = set(used.frame[RUN_ID])
    return Compared(
        kind=of_cells if isinstance(model, CellMeans) else "linear" if model.blocks is None else "mixed",
        factors=tuple((name, tuple(treatments)) for name, treatments in levels.items()),
        between=model.layout.between if isinstance(model, CellMeans) and is_blocked else (),
        estimand=choices.estimand.value,
        is_extended=used.is_extended,
        dropped=tuple(run for run in data.frame[RUN_ID] if run not in rest),
        left_out=_left_out(used, model),
        effects=tuple(known),
        tested=_tested(measure, of),
        pairs=tuple(_paired(each, facts.effect_keys[each.factors], of) for each in measure.post_hoc),
        contrasts=tuple(
            _contrasted(by_statement[each.statement], levels, choices, facts.contrast_keys[each.statement])
            for each in measure.contrasts
        ),
        contrasted=_contrasts(measure),
        of=of,
        d_name="robust d" if choices.estimand is Estimand.TRIMMED_MEAN else "Cohen's d",
        has_check=not isinstance(beside, NotComputed),
        is_uniform=_is_uniform(model) and _is_uniform(beside),
    )


def _levels(model: Model) -> dict[str, list[str]]:
    return {name: list(of) for name, of in (model.layout if isinstance(model, CellMeans) else model).factors.items()}


def _effect(
    effect: Effect,
    facts: MeasureFacts,
    model: Model,
    tested: Mapping[tuple[str, ...], str],
    checked: Mapping[tuple[str, ...], str],
) -> TestedEffect | None:
    """Return an effect with the procedures that test it; None where these are not known."""
    has_check = effect.check is not None and effect.check.p_value is not None
    names = [tested[effect.factors].removesuffix(_BOOTSTRAP)]
    names += [checked[effect.factors].removesuffix(_BOOTSTRAP)] if has_check else []
    if not set(names) <= set(_PROCEDURES):
        return None
    is_drawn = tested[effect.factors].endswith(_BOOTSTRAP)
    return TestedEffect(
        key=facts.effect_keys[effect.factors],
        label=effect.label,
        factors=effect.factors,
        which=tuple(name in effect.factors for name in _levels(model)),
        test=_PROCEDURES[names[0]],
        check=_PROCEDURES[names[1]] if has_check else "",
        drawn=effect.p_value if is_drawn else None,
        check_is_drawn=has_check and checked[effect.factors].endswith(_BOOTSTRAP),
    )


def _tested(measure: MeasureStatistics, of: str) -> Reported:
    if measure.test is None:
        return Reported.of([])
    return Reported.of([(each.label, _effect_row(each, measure.test.spread, of)) for each in measure.test.effects])


def _contrasts(measure: MeasureStatistics) -> Reported:
    rows: list[tuple[str, Row]] = []
    for each in measure.contrasts:
        low, high = _ends(each.interval)
        row: Row = {"estimate": each.estimate, "low": low, "high": high, "statistic": each.statistic}
        rows.append((each.statement, row | {"df": each.degrees_of_freedom, "p": each.p_value}))
    return Reported.of(rows)


def _procedures(model: Model | NotComputed) -> dict[tuple[str, ...], str]:
    """Return what the test of each effect is called, but for blocks."""
    if isinstance(model, NotComputed):
        return {}
    with quiet():
        return {each.factors: each.test.replace(_OF_BLOCKS, "") for each in model.effects()}


def _is_uniform(model: Model | NotComputed) -> bool:
    """Return whether all combinations vary, as the functions of R and scipy take for granted."""
    return not isinstance(model, CellMeans) or bool(np.all(np.einsum("gcc->gc", model.moments.errors) > 0))


def _left_out(data: MeasureData, model: Model) -> tuple[str, ...]:
    rows = model.layout.left_out if isinstance(model, CellMeans) else ()
    return tuple(data.frame[RUN_ID].iloc[list(rows)])


def _effect_row(effect: Effect, spread: float | None, of: str) -> Row:
    row: Row = {"statistic": effect.statistic, **_freedom(effect.degrees_of_freedom, ""), "p": effect.p_value}
    row |= {"spread": spread}
    for at, part in enumerate(effect.parts):
        row |= {f"p of {part.name}": part.p_value}
        if at:  # the first is the statistic itself
            row |= {f"statistic of {part.name}": part.statistic}
            row |= _freedom(part.degrees_of_freedom, f" of {part.name}")
    for size in effect.effect_sizes:
        if size.name.endswith("omega squared"):
            row |= _size(size, "omega squared")
    if effect.check is not None:
        row |= {f"statistic of {of}": effect.check.statistic}
        row |= {**_freedom(effect.check.degrees_of_freedom, f" of {of}"), f"p of {of}": effect.check.p_value}
    return row


def _freedom(freedom: Sequence[float], of: str) -> Row:
    return {f"df{'' if place == 0 else ' 2'}{of}": each for place, each in enumerate(freedom)}


def _size(size: EffectSize, name: str) -> Row:
    low, high = _ends(size.interval)
    return {name: size.value, f"{name} low": low, f"{name} high": high}


def _paired(post_hoc: PostHoc, key: str, of: str) -> Paired:
    labels = [f"{each.first} and {each.second}" for each in post_hoc.comparisons]
    return Paired(
        key,
        post_hoc.factors,
        Reported.of([(label, _pair(each, of)) for label, each in zip(labels, post_hoc.comparisons, strict=True)]),
        Reported.of(
            [
                (label, {"adjusted p": each.adjusted_p_value})
                for label, each in zip(labels, post_hoc.comparisons, strict=True)
            ]
        ),
    )


def _pair(pair: Comparison, of: str) -> Row:
    low, high = _ends(pair.interval)
    row: Row = {
        "difference": pair.difference,
        "low": low,
        "high": high,
        "statistic": pair.statistic,
        "df": pair.degrees_of_freedom,
        "p": pair.p_value,
        f"p of {of}": pair.check_p_value,
    }
    for size in pair.effect_sizes:
        row |= _size(size, size.name)
    return row


def _contrasted(hypothesis: Hypothesis, levels: Mapping[str, Sequence[str]], choices: Choices, key: str) -> Contrasted:
    (factor,) = hypothesis.factors
    weights = hypothesis.contrast or dict(zip(levels[factor], (1.0, -1.0), strict=True))
    level = 1 - (1 if hypothesis.within is None else 2) * choices.alpha
    return Contrasted(key, hypothesis.statement, factor, dict(weights), hypothesis.within, level)
