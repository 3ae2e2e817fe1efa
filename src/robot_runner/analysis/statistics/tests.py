"""The tests of the effects on a measure, which the design and the plan determine, never the values."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib.metadata import version
from typing import TYPE_CHECKING

import numpy as np

from robot_runner.analysis.arrays import Floats
from robot_runner.analysis.statistics.adjusted_means import AdjustedMeans, fit_adjusted
from robot_runner.analysis.statistics.cell_layout import MOST_FACTORS, incomplete_layout, layout_of, relative_ranks
from robot_runner.analysis.statistics.cell_means import BOOTSTRAP, SIGN_FLIPS, CellMeans
from robot_runner.analysis.statistics.descriptive import quiet
from robot_runner.analysis.statistics.designed_columns import taken_beside_plots
from robot_runner.analysis.statistics.designed_models import designed_model_of
from robot_runner.analysis.statistics.effect_sizes import f_of_p_value, omega_squared
from robot_runner.analysis.statistics.lenth_test import LenthModel
from robot_runner.analysis.statistics.linear_model import FittedModel, fit_model
from robot_runner.analysis.statistics.strata_model import StrataModel
from robot_runner.analysis.statistics.surface_model import SurfaceModel
from robot_runner.analysis.statistics.tested import (
    Check,
    Effect,
    EffectTest,
    MeasureTest,
    NotComputed,
    NoVariation,
    TestPart,
)
from robot_runner.analysis.statistics.unit_responses import note_on_responses
from robot_runner.analysis.wording import listed
from robot_runner.core.design.analysis_plan import Correction, Estimand, Statistic
from robot_runner.core.design.columns import RUN_ID
from robot_runner.core.words import counted, enumerated

if TYPE_CHECKING:
    from robot_runner.analysis.statistics.analysed_design import MeasureData

#: The models that may be fitted to a measure. Each has the tests of effects, differences of marginal means (of
#: treatments by factor, with their weights), and the standard deviation that standardises these, with the components of
#: its square: none if it is known as precisely as differences are.
UnadjustedModel = CellMeans | FittedModel | StrataModel | LenthModel | SurfaceModel
AnyModel = UnadjustedModel | AdjustedMeans

_PAIR = 2


@dataclass(frozen=True, slots=True)
class Choices:
    """The choices for the analysis of a measure, made before its values are known."""

    alpha: float = 0.05
    correction: Correction = Correction.HOLM
    estimand: Estimand = Estimand.MEAN
    statistic: Statistic = Statistic.COMBINED


def check_estimand(estimand: Estimand) -> Estimand:
    """Return the estimand of the robustness check."""
    return Estimand.MEAN if estimand is Estimand.RANK else Estimand.RANK


def model_of(
    data: MeasureData, estimand: Estimand, statistic: Statistic = Statistic.COMBINED
) -> UnadjustedModel | NotComputed:
    """Return the model of a measure without adjustment for covariates, or why there is none."""
    found = _model_of(data, estimand, statistic)
    why = _why_not_ranked(data, found) if estimand is Estimand.RANK else ""
    return NotComputed("the test", why) if why else found


@lru_cache(maxsize=8)  # the tests, the pairs and the adjustment of a measure fit the same ones
def _model_of(data: MeasureData, estimand: Estimand, statistic: Statistic) -> UnadjustedModel | NotComputed:
    problem = _problem(data)
    designed = NotComputed("the test", problem) if problem else designed_model_of(data, estimand, statistic)
    if designed is not None:
        return designed
    if data.known.whole_plot:  # some have lost a run, so that effects are in no single stratum
        ranks = _ranks(data) if estimand is Estimand.RANK else None
        return fit_model(data.with_plots_as_blocks(), ranks, taken_beside_plots(data))
    layout = layout_of(data) or incomplete_layout(data)
    if layout is None or (layout.is_blocked and estimand is Estimand.TRIMMED_MEAN):
        if estimand is Estimand.TRIMMED_MEAN:
            why = "trimmed means are compared of runs of their own, two and more of each combination."
            return NotComputed("the test", why)
        return fit_model(data, _ranks(data) if estimand is Estimand.RANK else None)
    found = CellMeans.of_values(layout, data.values, estimand, statistic)
    if not np.all(found.has_variation):
        same = "all blocks respond to the treatments in the same way"
        same = same if layout.is_blocked else "within each combination all values are equal"
        return NoVariation("the test", f"{same}, so that there is no variation to test against.")
    return found


def planned_model_of(
    data: MeasureData, estimand: Estimand, statistic: Statistic = Statistic.COMBINED
) -> AnyModel | NotComputed:
    """Return the model of a measure, adjusted for its covariates, if any, or why there is none."""
    if not data.covariates or not data.known.is_plain or _problem(data):
        return model_of(data, estimand, statistic)
    return fit_adjusted(data, estimand, statistic)


#: The fewest runs, and runs beyond the coefficients, for tests of ranks in a linear model. In random designs of factors
#: with two to six treatments, by all orders of 7 runs and 6,000 of 8 to 14, false positives at 5 % are then up to 8 %;
#: with one run beyond the coefficients up to 20 %, and of 6 runs 10 %.
_FEWEST_IN_MODEL, _FEWEST_BEYOND = 7, 2


def _why_not_ranked(data: MeasureData, found: UnadjustedModel | NotComputed) -> str:
    """Return why the ranks of a single factor, or in a model with one variance, are not compared; else nothing."""
    lacking = found.layout.missing_for_ranks if isinstance(found, CellMeans) else ""
    if isinstance(found, SurfaceModel) or (isinstance(found, FittedModel) and found.blocks is None):
        beyond = min(effect.freedom[1] for effect in found.effects())
        if beyond < _FEWEST_BEYOND or len(data.frame) < _FEWEST_IN_MODEL:
            lacking = f"{_FEWEST_IN_MODEL} runs, and {_FEWEST_BEYOND} more than the model has coefficients"
    return f"ranks of so few runs differ by chance too often: it takes {lacking}." if lacking else ""


def _ranks(data: MeasureData) -> Floats:
    return relative_ranks(data.values, data.batches if data.is_extended else None)


def carry_out(data: MeasureData, model: AnyModel, choices: Choices) -> MeasureTest:
    """Return the tests of all effects, without adjusted p-values and conclusions."""
    beside = planned_model_of(data, check_estimand(choices.estimand), choices.statistic)
    with quiet():
        checks = {} if isinstance(beside, NotComputed) else {each.factors: each for each in beside.effects()}
        effects = tuple(
            replace(
                _effect(model, each, checks.get(each.factors), choices),
                aliases=data.known.aliases.get(each.factors, ()),
                within=data.within(each.factors),
            )
            for each in model.effects()
        )
    notes = [*_notes(data, model), *_notes_on_values(data, model)]
    if (treatments := data.treatments).conditions:
        notes.insert(0, treatments.in_words("mean", "each treatment of a factor that is nested within counts the same"))
    if isinstance(beside, NotComputed):
        notes.append(f"There is no check of {_checked(choices.estimand)}: {beside.why}")
    return MeasureTest(
        method=model.method,
        estimand=choices.estimand.value,
        reason=_reason(data, model, choices.estimand),
        effects=effects,
        family="",
        family_size=len(effects),
        # Unreplicated runs have no standard deviation.
        spread=None if choices.estimand is Estimand.RANK or isinstance(model, LenthModel) else float(model.spread),
        library=f"scipy {version('scipy')}",
        notes=tuple(notes),
    )


def _checked(estimand: Estimand) -> str:
    return "means" if estimand is Estimand.RANK else "ranks"


def _effect(model: AnyModel, found: EffectTest, beside: EffectTest | None, choices: Choices) -> Effect:
    statistic, p_value, variance = float(found.statistic), float(found.p_value), float(found.variance)
    statistic = 0.0 if abs(statistic) < _NOTHING else statistic
    freedom = tuple(map(float, found.freedom))
    is_known = all(map(math.isfinite, (statistic, p_value, *freedom)))
    p_value_of = p_value if is_known else None
    size = None
    if is_known and choices.estimand is not Estimand.RANK:
        f_value, both = (statistic**2, (1.0, *freedom)) if len(freedom) == 1 else (statistic, freedom)
        if found.parts or BOOTSTRAP in found.test or SIGN_FLIPS in found.test:
            # The interval must agree with the p-value.
            f_value = f_of_p_value(p_value, (both[0], both[1]))
        size = omega_squared(
            f_value,
            (both[0], both[1]),
            variance,
            float(model.spread),
            model.spread_parts,
            alpha=choices.alpha,
            is_partial=len(model.factors) > 1,
        )
    return Effect(
        factors=found.factors,
        test=found.test,
        statistic_name=found.statistic_name,
        statistic=statistic if is_known else None,
        degrees_of_freedom=freedom if is_known else (),
        p_value=p_value_of,
        adjusted_p_value=p_value_of,
        is_significant=None if p_value_of is None else p_value_of < choices.alpha,
        effect_sizes=() if size is None else (size,),
        check=None if beside is None else _check(beside, p_value_of, choices),
        conclusion="",
        parts=tuple(
            TestPart(name, float(value), tuple(map(float, of)), float(p_of))
            for name, value, of, p_of in found.parts
            if is_known
        ),
    )


def _check(beside: EffectTest, p_value: float | None, choices: Choices) -> Check:
    of = _checked(choices.estimand)
    figures = tuple(map(float, (beside.statistic, beside.p_value, *beside.freedom)))
    if not all(map(math.isfinite, figures)):
        return Check(of, beside.statistic_name, None, (), None, None)
    agrees = None if p_value is None else (p_value < choices.alpha) == (figures[1] < choices.alpha)
    return Check(of, beside.statistic_name, figures[0], figures[2:], figures[1], agrees)


def _problem(data: MeasureData) -> str:
    """Return why no test is possible; empty if one is."""
    if not len(data.frame):
        return "no run has a value."
    if not data.factors:
        return "all runs with a value have the same treatments, so that there is nothing to compare."
    if np.ptp(data.values) == 0:
        return "all values are equal."
    if data.stranded:
        return stranded_in_words(data)
    if max(len(group.values) for group in data.groups(data.factors)) < _PAIR and len(data.factors) == 1:
        return "each treatment has a single run, so that there is no variation to test against: repeat the runs."
    return ""


def stranded_in_words(data: MeasureData) -> str:
    """Return why conditional factors cannot be tested without a factor that their condition is on."""
    parents = enumerated(list(dict.fromkeys(parent for name in data.stranded for parent in data.conditions[name])))
    return (
        f"what {enumerated(data.stranded)} does shows within {parents} alone, which is not compared here. Compare it, "
        f"with other blocks or with runs of all its treatments in each batch."
    )


#: A smaller statistic is what rounding leaves of 0.
_NOTHING = 1e-24

_COMPARED = {Estimand.MEAN: "means", Estimand.TRIMMED_MEAN: "trimmed means", Estimand.RANK: "relative ranks"}


def _reason(data: MeasureData, model: AnyModel, estimand: Estimand) -> str:
    if isinstance(model, StrataModel | LenthModel | SurfaceModel):
        return model.reason + (f" Of the values, {_COMPARED[estimand]} are compared." * (estimand is not Estimand.MEAN))
    if not data.known.is_plain and isinstance(model, CellMeans):
        of = f"{counted(len(data.factors), 'factor')} in {len(model.layout.sizes)} combinations ({data.known.in_words})"
        each = f"{_COMPARED[estimand]} are compared, with a variance for each combination."
        return f"{of}, each run by itself: {each}"
    return _reason_of_factorial(data, model, estimand)


def _reason_of_factorial(data: MeasureData, model: CellMeans | FittedModel | AdjustedMeans, estimand: Estimand) -> str:
    compared = _COMPARED[estimand]
    count = len(data.factors)
    of = f"{count} factors and their interactions" if count > 1 else "One factor"
    if count == 1:
        of += f" with {counted(len(data.levels(data.factors[0])), 'treatment')}"
    if isinstance(model, AdjustedMeans):
        where = (
            "within blocks" if model.design.is_within else "of blocks" if data.is_blocked else "of runs by themselves"
        )
        return f"{of}: {compared} {where} are compared at the mean of {listed(data.covariates)}."
    if isinstance(model, FittedModel):
        if model.blocks is None:
            return f"{of}: {compared} are compared; {_TOO_FEW[data.is_extended]}, so that one variance serves all."
        beside = [*data.known.blocks, *data.covariates]  # of a split plot
        told = f", adjusted for {enumerated(beside)}" if beside else ""
        return (
            f"{of}, in blocks that do not hold all combinations: {compared} are compared, "
            f"each block with a random mean{told}."
        )
    if model.layout.is_blocked:
        how = "within each block" if model.layout.within else "between blocks"
        return f"{of}, in blocks: {compared} are compared {how}, and chance is how blocks differ in that."
    each = "combination" if count > 1 else "treatment"
    if model.layout.inverse is not None:
        of = f"{count} factors, of whose combinations {len(model.layout.sizes)} have runs"
    return f"{of}, each run by itself: {compared} are compared, with a variance for each {each}."


#: Why combinations have no separate variances, by whether the experiment was extended.
_TOO_FEW = {
    False: "some combinations have fewer than two runs",
    True: "some combinations have too few runs in each batch, and each batch adds a constant",
}

#: Notes for factorials with combinations without runs.
_NO_INTERACTIONS = "Interactions cannot be estimated: some combinations have no run."
_GAPS = (
    "Some combinations have no run: effects are those that least squares estimate from the means of the others, with "
    "interactions of two factors; those of more are taken to be none."
)

_CONTAINMENT = (
    "Degrees of freedom are those between blocks for effects that only differences between blocks tell, else those "
    "within (containment). All blocks are taken to vary alike."
)


def _notes(data: MeasureData, model: AnyModel) -> Iterator[str]:
    if isinstance(model, StrataModel | LenthModel | SurfaceModel):
        yield from model.notes
        yield from (*data.known.notes, *note_on_responses(data, model))
    elif not data.known.is_plain and isinstance(model, CellMeans):
        yield from data.known.notes
    elif isinstance(model, AdjustedMeans):
        yield from filter(None, (model.design.note,))
    elif isinstance(model, FittedModel):
        yield from filter(None, (model.note, _CONTAINMENT if model.blocks is not None else ""))
        yield from note_on_responses(data, model)
    else:
        layout = model.layout
        if layout.inverse is not None:
            yield _GAPS if any(len(each) > 1 for each in layout.terms) else _NO_INTERACTIONS
        elif len(layout.factors) > MOST_FACTORS:
            yield f"Interactions of more than {MOST_FACTORS} factors are left out."
        if layout.left_out:
            runs = listed(data.frame[RUN_ID].iloc[list(layout.left_out)])
            lacking = (
                "What their batch has of their block lacks some combinations"
                if data.is_extended
                else "Their blocks do not hold all combinations"
            )
            yield f"{lacking}, so these runs are left out of the tests: {runs}."
        if layout.is_replicated:
            yield "Runs of one combination in the same block are reduced to their mean: chance is how blocks differ."
    if data.known.is_plain and len({len(each.values) for each in data.groups(data.factors)}) > 1 < len(data.factors):
        yield "The combinations have unequal numbers of runs; in the means that are compared each counts the same."


#: So few runs, beside so many times more of others: by simulation Welch's t errs from there on, also of normal values.
_FEW, _LOPSIDED = 3, 3


def note_on_few(*compared: Mapping[str, int]) -> str:
    """Return a note on groups of two or three runs that are compared with much larger ones; empty without any.

    By simulation Welch's t errs in 12 to 13 % with 2 runs beside 20 of equal spread, and in 27 % of shares near 100 %.
    """
    sizes = [(name, count, max(counts.values())) for counts in compared for name, count in counts.items()]
    few = dict.fromkeys(name for name, count, largest in sizes if _PAIR <= count <= min(_FEW, largest / _LOPSIDED))
    told = f"{listed(few)}: {_PAIR} or {_FEW} runs, and others have {_LOPSIDED} times as many or more."
    return f"{told} {_OF_FEW}" if few else ""


_OF_FEW = (
    "So few hardly tell how they vary: differences are found in up to 13 % at 5 %, of skewed values in up to 28 %. "
    "Repeat these runs."
)


def _notes_on_values(data: MeasureData, model: AnyModel) -> Iterator[str]:
    """Yield where so few values tell too little of how they vary."""
    # In other designs, shares of yes are compared as means are.
    if data.known.is_plain and np.array_equal(np.unique(data.values), (0, 1)):
        yield (
            "All values are 0 or 1. Where these stand for no and yes, publish False and True: they are compared as "
            "proportions, by exact tests where runs are independent, however few there are."
        )
    if not isinstance(model, CellMeans) or model.layout.is_blocked:
        return
    groups = data.groups(data.factors)
    if model.estimand is not Estimand.RANK and (few := note_on_few({each.label: len(each.values) for each in groups})):
        yield few
    most = max((len(each.values) for each in groups if np.ptp(each.values) > 0), default=0)
    if alike := [each.label for each in groups if np.ptp(each.values) == 0 and _PAIR <= len(each.values) < most]:
        # By simulation 20 % of 5 and 20 runs of which a quarter say yes, 9 to 11 % of counts and durations of mostly 0.
        yield (
            f"All runs of {listed(alike)} have the same value, and others, with more runs, vary: its variance counts "
            "as 0. Where so few are alike by chance only, as zeros of a count, differences are found in up to 20 %."
        )
