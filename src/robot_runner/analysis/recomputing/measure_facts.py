"""The facts of one measure for a recomputation: its comparisons, their procedures, and the reported numbers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from math import isfinite, prod
from typing import TYPE_CHECKING

import numpy as np

from robot_runner.analysis.recomputing.designed_facts import Designed, designed_facts, surface_facts
from robot_runner.analysis.recomputing.reported import (
    LEVEL,
    Reported,
    about_residuals,
    contrasts_table,
    described_row,
    freedom_row,
    pair_row,
    tested_table,
)
from robot_runner.analysis.recomputing.study_facts import (
    Answered,
    Compared,
    Contrasted,
    MeasureFacts,
    Paired,
    TestedEffect,
)
from robot_runner.analysis.statistics.batch_strata import comparable
from robot_runner.analysis.statistics.cell_layout import Layout
from robot_runner.analysis.statistics.cell_means import CellMeans
from robot_runner.analysis.statistics.descriptive import quiet
from robot_runner.analysis.statistics.known_precision import level_of_looks
from robot_runner.analysis.statistics.lenth_test import LENTH, LenthModel
from robot_runner.analysis.statistics.linear_model import FittedModel
from robot_runner.analysis.statistics.proportion_contrasts import most_runs
from robot_runner.analysis.statistics.proportions import QUANTITY
from robot_runner.analysis.statistics.shares import in_points
from robot_runner.analysis.statistics.strata_model import StrataModel
from robot_runner.analysis.statistics.surface_model import SurfaceModel
from robot_runner.analysis.statistics.tested import Effect, NotComputed, PostHoc, TestMethod
from robot_runner.analysis.statistics.tests import Choices, check_estimand, model_of
from robot_runner.analysis.statistics.unit_responses import within_units
from robot_runner.core.design.analysis_plan import Estimand
from robot_runner.core.design.columns import RUN_ID

if TYPE_CHECKING:
    from robot_runner.analysis.statistics.analysed_design import Design, MeasureData
    from robot_runner.analysis.statistics.outcome import Description, MeasureStatistics, Proportion
    from robot_runner.analysis.statistics.tests import UnadjustedModel
    from robot_runner.core.design.hypothesis import Hypothesis

#: The procedure of each test of the report, by the test's name in the report.
_PROCEDURES = {
    "Welch's t": "welch",
    "t within blocks": "welch",
    "Welch's ANOVA": "welch_james",
    "Welch-James": "welch_james",
    "ANOVA-type": "anova_type",
    "Welch-James and ANOVA-type": "combined",
    "Greenhouse-Geisser": "greenhouse_geisser",
    "Greenhouse-Geisser, sign flips": "sign_flips",
    "Huynh-Feldt": "huynh_feldt",
    "linear model with one variance": "model",
    "linear mixed model": "model",
    "analysis of variance adjusted for blocks": "model",
    "analysis of variance of a crossover": "model",
    "analysis of variance of a split-plot design": "model",
    "response surface": "model",
    LENTH: "lenth",
}
#: The most combinations of the factors of a fraction that scripts can handle.
_MOST_CELLS = 5_000
_OF_BLOCKS, _BOOTSTRAP = " of blocks", ", parametric bootstrap"
_PAIR, _EXACT = 2, TestMethod.PROPORTIONS


def facts_of_measure(
    design: Design,
    measure: MeasureStatistics,
    choices: Choices,
    hypotheses: Sequence[Hypothesis],
    key_of: Callable[[str], str],
    beside: str = "",
) -> MeasureFacts:
    """Return the facts of one measure; the design is already without its left-out runs."""
    data = design.data(measure.name) or design.answers(measure.name)
    assert data is not None  # noqa: S101 - it has statistics
    label = f"{measure.name} {beside}".rstrip()
    effect_keys = {effect.factors: key_of(f"{label}: {effect.label}") for effect in measure.effects}
    contrast_keys = {each.statement: key_of(f"{label}: {each.statement}") for each in measure.contrasts}
    levels = level_of_looks(design.results, measure.name)
    residuals = about_residuals(measure)
    compared, left, taken = None, [], {}
    is_exact = measure.proportions is not None and (measure.test is None or measure.test.method is _EXACT)
    if measure.proportions is not None and not is_exact:
        data, choices = in_points(data), replace(choices, estimand=Estimand.MEAN)
    designed = None if is_exact else designed_facts(data, design.results)
    if not is_exact and designed is None and (data.covariates or not data.known.is_plain):
        # Scripts cannot compute their residuals.
        left = [*residuals.values(), *_not_recomputed(measure)]
        residuals = dict.fromkeys(residuals, Reported())
    elif not is_exact and measure.test is not None:
        compared = _compared(data, measure, choices, hypotheses, effect_keys, contrast_keys, designed)
        left = [] if compared is not None else _not_recomputed(measure)
    if left:
        p_values = {effect_keys[each.factors]: each.p_value for each in measure.effects}
        p_values |= {contrast_keys[each.statement]: each.p_value for each in measure.contrasts}
        taken = {key: value for key, value in p_values.items() if value is not None}
    return MeasureFacts(
        key=key_of(label),
        name=measure.name,
        label=label,
        factors=data.factors,
        left_out=tuple(sorted(design.without & set(design.frame[RUN_ID]))),
        described=tuple(
            (names, Reported.of([(each.label, described_row(each)) for each in of])) for names, of in _groups(measure)
        ),
        is_extended=data.is_extended,
        distributed=measure.assumptions if residuals["distribution"] else (),
        **residuals,
        compared=compared,
        effect_keys=effect_keys,
        contrast_keys=contrast_keys,
        taken=taken,
        skipped=sum(len(each.numbers) for each in left),
        level=LEVEL if levels is None else levels,
        answered=_answered(data, measure, choices, hypotheses, effect_keys, contrast_keys),
        designed=designed,
    )


def _groups(measure: MeasureStatistics) -> Iterator[tuple[tuple[str, ...], list[Description | Proportion]]]:
    """Yield the described groups, by their factors."""
    groups: dict[tuple[str, ...], list[Description | Proportion]] = {}
    described = measure.proportions or measure
    if described.overall is not None:
        groups[()] = [described.overall]
    for each in (*described.by_treatment, *described.by_combination):
        groups.setdefault(tuple(each.treatments), []).append(each)
    yield from groups.items()


def _answered(
    data: MeasureData,
    measure: MeasureStatistics,
    choices: Choices,
    hypotheses: Sequence[Hypothesis],
    effect_keys: Mapping[tuple[str, ...], str],
    contrast_keys: Mapping[str, str],
) -> Answered | None:
    """Return the facts of a yes-or-no measure; None for others."""
    if measure.proportions is None:
        return None
    is_exact = measure.test is not None and measure.test.method is _EXACT
    are_by_score = is_exact or measure.test is None
    known = {each.statement for each in measure.contrasts} if are_by_score else set()
    stated = [each for each in hypotheses if each.statement in known]
    post_hoc = measure.post_hoc if is_exact else ()
    tested = [each for each in measure.effects if each.p_value is not None and is_exact]
    # P-values for three or more treatments are random.
    drawn = {each.factors: each.p_value for each in tested if len(data.levels(each.factors[0])) > _PAIR}
    rows = [
        (each.label, {"statistic": each.statistic, **freedom_row(each.degrees_of_freedom, ""), "p": each.p_value})
        for each in tested
    ]
    return Answered(
        is_blocked=data.is_blocked,
        is_extended=data.is_extended,
        effects=tuple(
            (each.factors[0], tuple(data.others(each.factors)), effect_keys[each.factors], drawn.get(each.factors))
            for each in tested
        ),
        tested=Reported.of(rows),
        pairs=tuple(_paired(each, effect_keys[each.factors], "ranks", data) for each in post_hoc),
        treatments=tuple(tuple((each.first, each.second) for each in of.comparisons) for of in post_hoc),
        contrasts=tuple(_of_proportions(data, each, choices, contrast_keys[each.statement]) for each in stated),
        contrasted=contrasts_table(measure) if are_by_score else Reported.of([]),
    )


def _of_proportions(data: MeasureData, hypothesis: Hypothesis, choices: Choices, key: str) -> Contrasted:
    levels = {name: data.levels(name) for name in data.factors}
    found = _contrasted(hypothesis, levels, choices, key)
    most = most_runs(data, found.weights, hypothesis)
    return replace(found, others=tuple(data.others(hypothesis.factors)), most=most if isfinite(most) else None)


def _not_recomputed(measure: MeasureStatistics) -> list[Reported]:
    """Return the tables of tests that are not recomputed."""
    pairs = (_paired(each, "", "ranks", None).reported for each in measure.post_hoc)
    surface = None if measure.surface is None else surface_facts(measure.surface)
    of_surface = () if surface is None else (surface.reported, surface.whole)
    return [tested_table(measure, "ranks"), contrasts_table(measure), *pairs, *of_surface]


def _compared(
    data: MeasureData,
    measure: MeasureStatistics,
    choices: Choices,
    hypotheses: Sequence[Hypothesis],
    effect_keys: Mapping[tuple[str, ...], str],
    contrast_keys: Mapping[str, str],
    designed: Designed | None,
) -> Compared | None:
    """Return the comparisons of a measure and their procedures; None if scripts do not support them."""
    used, _, _ = comparable(data)
    model = model_of(used, choices.estimand, choices.statistic)
    beside = model_of(used, check_estimand(choices.estimand), choices.statistic)
    if measure.test is None or isinstance(model, NotComputed):
        return None
    if (nested := used.treatments.conditions) and not _is_known(model):
        return None
    if designed is not None and not _is_designed(model, measure):
        return None
    tested, checked = (_procedures(each) for each in (model, beside))
    effects = [
        _effect(each, effect_keys[each.factors], tested[each.factors], checked.get(each.factors, ""), used)
        for each in measure.test.effects
    ]
    levels = model.factors
    of = "means" if choices.estimand is Estimand.RANK else "ranks"
    by_statement = {each.statement: each for each in hypotheses}
    is_blocked = isinstance(model, CellMeans) and model.layout.is_blocked
    of_cells = "blocks" if is_blocked else "runs"
    rest = set(used.frame[RUN_ID])
    return Compared(
        kind=of_cells if isinstance(model, CellMeans) else _kind(model),
        factors=tuple((name, tuple(treatments)) for name, treatments in levels.items()),
        between=model.layout.between if isinstance(model, CellMeans) and is_blocked else (),
        estimand=choices.estimand.value,
        is_extended=used.is_extended,
        dropped=tuple(run for run in data.frame[RUN_ID] if run not in rest),
        left_out=_left_out(used, model),
        effects=tuple(effects),
        tested=tested_table(measure, of),
        pairs=tuple(_paired(each, effect_keys[each.factors], of, used) for each in measure.post_hoc),
        contrasts=tuple(
            _contrasted(by_statement[each.statement], levels, choices, contrast_keys[each.statement])
            if each.degrees_of_freedom is not None
            else _of_proportions(data, by_statement[each.statement], choices, contrast_keys[each.statement])
            for each in measure.contrasts
        ),
        contrasted=contrasts_table(measure),
        of=of,
        d_name="robust d" if choices.estimand is Estimand.TRIMMED_MEAN else "Cohen's d",
        has_check=not isinstance(beside, NotComputed),
        is_uniform=_is_uniform(model) and _is_uniform(beside),
        terms=_terms(model),
        nested=tuple((name, tuple(of.items())) for name, of in nested.items()),
        units=_reduced_by(used, model) if isinstance(model, StrataModel) else (),
        responses=within_units(used, used.unit_names) if isinstance(model, StrataModel) and model.has_responses else (),
        has_plots=isinstance(model, StrataModel) and len(model.fits) > 1,
        surface=None if measure.surface is None else surface_facts(measure.surface),
    )


def _kind(model: FittedModel | StrataModel | LenthModel | SurfaceModel) -> str:
    if isinstance(model, FittedModel):
        return "linear" if model.blocks is None else "mixed"
    return "strata" if isinstance(model, StrataModel) else "lenth" if isinstance(model, LenthModel) else "surface"


def _reduced_by(data: MeasureData, model: StrataModel) -> tuple[str, ...]:
    """Return the columns within which repeated runs of a combination are averaged."""
    return tuple(name for name in data.known.columns if not (model.is_of_units and name == data.known.period))


def _is_designed(model: UnadjustedModel, measure: MeasureStatistics) -> bool:
    """Return whether scripts support the model of a special design."""
    if isinstance(model, CellMeans):
        return prod(map(len, model.layout.factors.values())) <= _MOST_CELLS
    return not (isinstance(model, LenthModel | SurfaceModel) and measure.contrasts)


def _is_known(model: object) -> bool:
    """Return whether scripts support a model with conditional factors."""
    if not isinstance(model, CellMeans):
        return False
    return model.layout.inverse is None and not (model.layout.is_blocked and model.layout.between)


def _terms(model: UnadjustedModel) -> tuple[tuple[bool, ...], ...]:
    """Return the effects of an incomplete factorial; empty for any other."""
    if not isinstance(model, CellMeans) or not model.layout.has_gaps:
        return ()
    return tuple(tuple(name in term for name in model.layout.factors) for term in model.layout.terms)


def _effect(effect: Effect, key: str, tested: str, checked: str, data: MeasureData) -> TestedEffect:
    """Return an effect with the procedures of its test and its check."""
    has_check = effect.check is not None and effect.check.p_value is not None
    test, check = tested.removesuffix(_BOOTSTRAP), checked.removesuffix(_BOOTSTRAP) if has_check else ""
    return TestedEffect(
        key=key,
        label=effect.label,
        factors=effect.factors,
        test=_PROCEDURES[test],
        check=_PROCEDURES.get(check, ""),
        drawn=effect.p_value if tested.endswith(_BOOTSTRAP) or test == LENTH else None,
        check_is_drawn=has_check and (checked.endswith(_BOOTSTRAP) or check == LENTH),
        levels=_levels_of(effect, data),
    )


def _levels_of(effect: Effect, data: MeasureData) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """Return the treatments of an effect's factors where all of them apply; empty without conditional factors."""
    if not (treatments := data.treatments).conditions:
        return ()
    return tuple(zip(effect.factors, map(tuple, treatments.levels(effect.factors)), strict=True))


def _procedures(model: UnadjustedModel | NotComputed) -> dict[tuple[str, ...], str]:
    """Return the name of the test of each effect, without "of blocks"."""
    if isinstance(model, NotComputed):
        return {}
    with quiet():
        return {each.factors: each.test.replace(_OF_BLOCKS, "") for each in model.effects()}


def _is_uniform(model: UnadjustedModel | NotComputed) -> bool:
    """Return whether all combinations vary, as the functions of R and scipy assume."""
    return not isinstance(model, CellMeans) or bool(np.all(np.einsum("gcc->gc", model.moments.errors) > 0))


def _left_out(data: MeasureData, model: UnadjustedModel) -> tuple[str, ...]:
    of = model.layout if isinstance(model, CellMeans) else model
    rows = of.left_out if isinstance(of, Layout | StrataModel) else ()
    return tuple(data.frame[RUN_ID].iloc[list(rows)])


def _paired(post_hoc: PostHoc, key: str, of: str, data: MeasureData | None) -> Paired:
    pairs = [(f"{each.first} and {each.second}", each) for each in post_hoc.comparisons]
    adjusted = Reported.of([(label, {"adjusted p": each.adjusted_p_value}) for label, each in pairs])
    reported = Reported.of([(label, pair_row(each, of)) for label, each in pairs])
    others = () if data is None else tuple(data.others(post_hoc.factors))
    exact = tuple(
        (place, each.first, each.second)
        for place, (_, each) in enumerate(pairs, start=1)
        if post_hoc.quantity == QUANTITY and each.statistic is None and each.p_value is not None
    )
    return Paired(key, post_hoc.factors, others, reported, adjusted, _chosen(post_hoc, data), exact)


def _chosen(post_hoc: PostHoc, data: MeasureData | None) -> tuple[int, ...]:
    """Return the numbers, from 1, of the compared pairs among all pairs; empty if all are compared."""
    if data is None or not data.known.is_one_at_a_time:
        return ()
    compared = {(each.first, each.second) for each in post_hoc.comparisons}
    every = enumerate(combinations(data.levels(post_hoc.factors[0]), 2), start=1)
    return tuple(place for place, pair in every if pair in compared)


def _contrasted(hypothesis: Hypothesis, levels: Mapping[str, Sequence[str]], choices: Choices, key: str) -> Contrasted:
    (factor,) = hypothesis.factors
    told = hypothesis.contrast or dict(zip(levels[factor], (1.0, -1.0), strict=True))
    weights = {name: weight for name, weight in told.items() if weight}
    level = 1 - (2 if hypothesis.has_bound else 1) * choices.alpha
    return Contrasted(key, hypothesis, factor, weights, level)
