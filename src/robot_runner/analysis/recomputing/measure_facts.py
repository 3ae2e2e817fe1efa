"""What a recomputation has to know of one measure: what was compared by which procedure, and what the report says."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from robot_runner.analysis.recomputing.study_facts import (
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
from robot_runner.analysis.statistics.tested import NotComputed
from robot_runner.analysis.statistics.tests import check_estimand, model_of
from robot_runner.core.design.analysis_plan import Estimand
from robot_runner.core.design.columns import RUN_ID

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from robot_runner.analysis.recomputing.study_facts import Number
    from robot_runner.analysis.statistics.design import Design, MeasureData
    from robot_runner.analysis.statistics.linear_model import FittedModel
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
    "Welch-James, parametric bootstrap": "bootstrap",
    "Greenhouse-Geisser": "greenhouse_geisser",
    "Huynh-Feldt": "huynh_feldt",
    "linear model with one variance": "model",
    "linear mixed model": "model",
}
_OF_BLOCKS = " of blocks"


def facts_of_measure(
    design: Design,
    measure: MeasureStatistics,
    choices: Choices,
    hypotheses: Sequence[Hypothesis],
    key_of: Callable[[str], str],
) -> MeasureFacts:
    """Return what a recomputation has to know of one measure.

    Args:
        design: of the experiment; without the runs that are left out of this measure.
        measure: its statistics, as the report has them.
        choices: what was chosen for the analysis beforehand.
        hypotheses: of the plan.
        key_of: makes a name its own among all of the study.
    """
    data = design.data(measure.name)
    assert data is not None  # noqa: S101 - it has statistics
    label = f"{measure.name}{' without doubtful runs' if design.without else ''}"
    key = key_of(label)
    groups: dict[tuple[str, ...], list[Description]] = {}
    if measure.overall is not None:
        groups[()] = [measure.overall]
    for each in (*measure.by_treatment, *measure.by_combination):
        groups.setdefault(tuple(each.treatments), []).append(each)
    checks = [(" / ".join(each.treatments.values()) or "all groups", each) for each in measure.assumptions]
    return MeasureFacts(
        key=key,
        name=measure.name,
        label=label,
        factors=data.factors,
        left_out=tuple(sorted(design.without & set(design.frame[RUN_ID]))),
        described=tuple(
            (names, Reported.of([(each.label, _described(each)) for each in of])) for names, of in groups.items()
        ),
        is_extended=data.is_extended,
        distributed=tuple(Distributed(each.name, dict(each.treatments)) for each in measure.assumptions),
        distribution=Reported.of(
            [(f"{each.name}, {of}", {"statistic": each.statistic, "p": each.p_value}) for of, each in checks]
        ),
        quantiles=_quantiles(measure),
        drift=_drift(measure),
        power=_power(measure),
        power_groups=0 if measure.power is None else len(data.groups(data.factors)),
        compared=_compared(data, measure, choices, hypotheses, lambda text: key_of(f"{label}: {text}")),
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
    data: MeasureData,
    measure: MeasureStatistics,
    choices: Choices,
    hypotheses: Sequence[Hypothesis],
    key_of: Callable[[str], str],
) -> Compared | None:
    test = measure.test
    if test is None:
        return None
    used, _, _ = comparable(data)
    model = model_of(used, choices.estimand, choices.statistic)
    beside = model_of(used, check_estimand(choices.estimand), choices.statistic)
    assert not isinstance(model, NotComputed)  # noqa: S101 - it was tested
    keys = {effect.factors: key_of(effect.label) for effect in test.effects}
    tested, checked = (_procedures(each) for each in (model, beside))
    levels = dict(model.layout.factors if isinstance(model, CellMeans) else model.factors)
    effects = tuple(
        TestedEffect(
            key=keys[effect.factors],
            label=effect.label,
            factors=effect.factors,
            which=tuple(name in effect.factors for name in levels),
            test=tested[effect.factors],
            check="" if effect.check is None or effect.check.p_value is None else checked[effect.factors],
            drawn=effect.p_value if tested[effect.factors] == "bootstrap" else None,
        )
        for effect in test.effects
    )
    of = "means" if choices.estimand is Estimand.RANK else "ranks"
    by_statement = {each.statement: each for each in hypotheses}
    contrasts = tuple(
        _contrasted(by_statement[each.statement], levels, choices, key_of(each.statement)) for each in measure.contrasts
    )
    is_blocked = isinstance(model, CellMeans) and model.layout.is_blocked
    return Compared(
        kind=("blocks" if is_blocked else "runs")
        if isinstance(model, CellMeans)
        else ("linear" if model.blocks is None else "mixed"),
        factors=tuple((name, tuple(of)) for name, of in levels.items()),
        between=model.layout.between if isinstance(model, CellMeans) and is_blocked else (),
        estimand=choices.estimand.value,
        is_extended=used.is_extended,
        dropped=tuple(run for run in data.frame[RUN_ID] if run not in set(used.frame[RUN_ID])),
        left_out=_left_out(used, model),
        effects=effects,
        tested=Reported.of([(effect.label, _effect_row(effect, test.spread, of)) for effect in test.effects]),
        pairs=tuple(_paired(each, keys[each.factors], of) for each in measure.post_hoc),
        contrasts=contrasts,
        contrasted=Reported.of(
            [
                (
                    each.statement,
                    {
                        "estimate": each.estimate,
                        "low": each.interval.low,
                        "high": each.interval.high,
                        "statistic": each.statistic,
                        "df": each.degrees_of_freedom,
                        "p": each.p_value,
                    },
                )
                for each in measure.contrasts
            ]
        ),
        of=of,
        d_name="robust d" if choices.estimand is Estimand.TRIMMED_MEAN else "Cohen's d",
        has_check=not isinstance(beside, NotComputed),
        is_uniform=_is_uniform(model) and _is_uniform(beside),
    )


def _procedures(model: Model | NotComputed) -> dict[tuple[str, ...], str]:
    """Return the procedure that each effect is tested by."""
    if isinstance(model, NotComputed):
        return {}
    with quiet():
        return {each.factors: _PROCEDURES[each.test.removesuffix(_OF_BLOCKS)] for each in model.effects()}


def _is_uniform(model: Model | NotComputed) -> bool:
    """Return whether all combinations vary, as the functions of R and scipy take for granted."""
    return not isinstance(model, CellMeans) or bool(np.all(np.einsum("gcc->gc", model.moments.errors) > 0))


def _left_out(data: MeasureData, model: Model) -> tuple[str, ...]:
    rows = model.layout.left_out if isinstance(model, CellMeans) else ()
    return tuple(data.frame[RUN_ID].iloc[list(rows)])


def _effect_row(effect: Effect, spread: float | None, of: str) -> Row:
    row: Row = {"statistic": effect.statistic, **_freedom(effect.degrees_of_freedom, ""), "p": effect.p_value}
    row |= {"spread": spread}
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
