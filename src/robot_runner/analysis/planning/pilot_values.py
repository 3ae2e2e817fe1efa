"""Assumptions from a pilot experiment: means and standard deviations of combinations, and the variance of blocks."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy import stats

from robot_runner.analysis.comparison.matching import in_unit, of_one_quantity, why_incomparable
from robot_runner.analysis.planning.assumed_values import AssumedMeasure
from robot_runner.analysis.statistics.analysed_design import BATCH, VALUE, Design, design_of
from robot_runner.analysis.statistics.designed_models import designed_model_of
from robot_runner.analysis.statistics.effect_coding import Factors, Term
from robot_runner.analysis.statistics.known_design import role_column
from robot_runner.analysis.statistics.shares import in_points
from robot_runner.analysis.statistics.strata_model import StrataModel
from robot_runner.analysis.statistics.unit_responses import UnitRuns
from robot_runner.core.design.analysis_plan import Estimand, Statistic
from robot_runner.core.errors import AnalysisError, did_you_mean
from robot_runner.core.words import combination_label, counted, enumerated

if TYPE_CHECKING:
    import pandas as pd

    from robot_runner.analysis.arrays import Floats
    from robot_runner.analysis.planning.planned_study import Cell, Study
    from robot_runner.analysis.results import Results
    from robot_runner.analysis.statistics.analysed_design import MeasureData

#: The probability that a standard deviation is no larger than its upper limit; the limit's ratio that needs no note.
_SURE, _HARDLY_MORE = 0.8, 1.1
#: The fewest runs for a separate standard deviation of a combination: with fewer, its error is half of it and more, and
#: the pooled one is taken.
_ENOUGH = 5
_BLOCK, _CELL, _UNIT = " block", " cell", " unit"


@dataclass(frozen=True, slots=True)
class Pilot:
    """The measures of a pilot, by name.

    Attributes:
        notes: the limits of the pilot, and how they were dealt with.
        freedoms: the degrees of freedom of the standard deviation of runs, by measure.
    """

    name: str
    measures: dict[str, AssumedMeasure]
    notes: tuple[str, ...]
    freedoms: dict[str, int]

    def on_spreads(self, assumed: Sequence[AssumedMeasure]) -> Iterator[str]:
        """Yield notes on how much larger the standard deviations of the pilot may be, if it has few runs.

        Source: Browne, On the use of a pilot sample for sample size determination (Statistics in Medicine 14, 1995),
        for planning with the upper limit of a standard deviation instead of its estimate.
        """
        for each in assumed:
            freedom, spreads = self.freedoms.get(each.name, 0), tuple(each.spreads.values())
            if each.is_share or not freedom or each.spreads != self.measures[each.name].spreads:
                continue
            factor = math.sqrt(freedom / stats.chi2.ppf(1 - _SURE, freedom))
            if factor > _HARDLY_MORE:
                of_all = math.sqrt(math.fsum(spread**2 for spread in spreads) / len(spreads))
                yield (
                    f"The pilot tells the standard deviation of {each.name} by {counted(freedom, 'degree')} of freedom "
                    f"only: in one of five such pilots the true one is {factor:.2f} times as large or more, and so "
                    f"many repetitions find less than is asked for. --sd {each.name}={factor * of_all:.3g} plans for "
                    "that (Browne 1995)."
                )


def pilot_values(study: Study, results: Results, measures: Sequence[str]) -> Pilot:
    """Return the assumptions on measures from a pilot, for each combination of a study.

    Runs that differ only in factors that the study does not have are pooled. The batch means of an extended pilot are
    subtracted.

    Raises:
        AnalysisError: the pilot lacks a measure, a treatment or a combination of the study, or has too few runs.
    """
    where = f"--pilot {results.name}"
    design = design_of(results, blocks=study.plan.blocks if study.plan is not None else None)
    for name in measures:
        if name not in results.measures:
            problem = f"the pilot has no measure {name!r}"
            raise AnalysisError(problem, where=where, fix=did_you_mean(name, results.measures))
        if why := why_incomparable(results.unit(name), study.units[name]):
            fix = "Correct the unit in the config, or name other measures with --measure."
            raise AnalysisError(f"the pilot has another {name}. {why}", where=where, fix=fix)
    shared = _shared(study, design, where)
    units = {name: (results.unit(name), study.units[name]) for name in measures}
    found = {name: _measure(study, design, name, shared, where, units[name]) for name in measures}
    told = {name: each for name, (each, _) in found.items()}
    freedoms = {name: freedom for name, (_, freedom) in found.items()}
    return Pilot(results.name, told, (*_notes(study, design, shared), *_notes_on_units(units)), freedoms)


def _shared(study: Study, design: Design, where: str) -> list[str]:
    """Return the factors that the study and the pilot vary; the pilot must have all treatments of the study."""
    shared = [name for name in study.factors if name in design.frame]
    for name in shared:
        known = list(map(str, design.frame[name].cat.categories))
        for text in study.factors[name]:
            if text not in known and name in study.varied:
                problem = f"the pilot has no runs with {name} = {text}"
                raise AnalysisError(problem, where=where, fix=did_you_mean(text, known))
    return [name for name in shared if name in study.varied]


def _notes(study: Study, design: Design, shared: Sequence[str]) -> Iterator[str]:
    yield (
        "A pilot's effect is uncertain, and one that was large enough to go on with is more often too large than too "
        "small: plan with the smallest effect that matters to you (--difference)."
    )
    alone = [name for name in study.varied if name not in shared]
    if alone:
        of = "it" if len(alone) == 1 else "them"
        yield f"The pilot did not vary {enumerated(alone)}: no effect of {of} is assumed."
    has_units = design.block is not None or bool(design.known.unit_columns)
    if study.has_units and not has_units:
        yield "The pilot has no blocks: blocks are taken not to vary, unless --block-sd and --response-sd say how."
    if has_units and not study.has_units:
        yield "The study has no blocks: how those of the pilot vary is taken for chance between runs."


def _notes_on_units(units: Mapping[str, tuple[str, str]]) -> Iterator[str]:
    for name, (own, wanted) in units.items():
        if own != wanted:
            taken = f"converted to {wanted}" if of_one_quantity(own, wanted) else "taken as they are"
            both = f"in {own or 'no unit'} in the pilot, and in {wanted or 'no unit'} in the config"
            yield f"{name} is {both}: its values are {taken}."


def _measure(
    study: Study, design: Design, name: str, shared: Sequence[str], where: str, units: tuple[str, str]
) -> tuple[AssumedMeasure, int]:
    """Return the assumptions on a measure, and the degrees of freedom of its standard deviation.

    `units` are those of the measure in the pilot, and in the study.
    """
    answers = design.answers(name)
    data = design.data(name) if answers is None else in_points(answers)
    if data is None:
        fix = "Name another with --measure."
        raise AnalysisError(f"{name} is not a number in the pilot", where=where, fix=fix)
    frame = _with_cells(data.frame.assign(**{VALUE: in_unit(data.frame[VALUE], *units)}), shared)
    means = frame.groupby(_CELL)[VALUE].mean().to_dict()
    counts = frame[_CELL].value_counts().to_dict()
    wanted = {cell: _part(study, cell, shared) for cell in study.cells}
    missing = [combination_label(part) for part in dict.fromkeys(wanted.values()) if part not in means]
    if missing:
        which = f"{counted(len(missing), 'combination')}: {enumerated(missing[:5])}"
        fix = "Execute these runs, or give --sd and --difference instead."
        raise AnalysisError(f"the pilot has no value of {name} for {which}", where=where, fix=fix)
    freedom = len(frame) - len(means)
    varying = _varying(study, data, frame, freedom, shared) if freedom > 0 else None
    if varying is None:
        batch, without = (" in each batch", " without these") if freedom > 0 else ("", "")
        problem = f"the pilot has a single run of each combination{batch}: {name} has no spread{without}"
        raise AnalysisError(problem, where=where, fix="Repeat its runs, or give --sd and --difference instead.")
    told = {cell: float(means[part]) for cell, part in wanted.items()}
    if answers is not None:
        blocks = AssumedMeasure(name, told, told, varying.block_sd, varying.responses)
        return AssumedMeasure.of_shares(name, told, blocks), varying.freedom
    squares = varying.left**2
    pooled = math.sqrt(float(squares.sum()) / freedom)
    own = squares.groupby(frame[_CELL]).agg(lambda each: math.sqrt(each.sum() / max(1, len(each) - 1)))
    spreads = {cell: float(own[part]) if counts[part] >= _ENOUGH else pooled for cell, part in wanted.items()}
    return AssumedMeasure(name, told, spreads, varying.block_sd, varying.responses), varying.freedom


def _varying(
    study: Study, data: MeasureData, frame: pd.DataFrame, freedom: int, shared: Sequence[str]
) -> _Blocks | None:
    """Return how blocks and runs vary; None where nothing is left of runs without their batches.

    Blocks of the pilot are chance between runs in a study without any.
    """
    beside = [_CELL, *([BATCH] if data.is_extended else [])]
    residuals, rank = _residuals(frame, _columns(frame, beside))
    if study.has_units and data.is_blocked:
        return _blocks(residuals, frame, shared)
    if study.has_units and data.known.unit_columns:
        others = (name for name in data.known.columns if name not in data.known.unit_columns)
        known = _within_units(data, frame[VALUE].to_numpy(dtype=np.float64), shared)
        units = _units(frame.assign(**{_UNIT: data.unit_names}), [*beside, *map(role_column, others)], known)
        if units is not None:
            return units
    own = len(frame) - rank
    return None if own < 1 else _Blocks(0.0, {}, residuals * math.sqrt(freedom / own), own)


def _columns(frame: pd.DataFrame, names: Sequence[str]) -> Floats:
    """Return a column of 0 and 1 for each value of these columns."""
    codes = (frame.groupby(name, sort=False, observed=True).ngroup().to_numpy() for name in names)
    return np.column_stack([np.eye(each.max() + 1)[each] for each in codes])


def _residuals(frame: pd.DataFrame, columns: Floats) -> tuple[pd.Series, int]:
    """Return what is left of values without what columns add, and the rank of these."""
    solved, _, rank, _ = np.linalg.lstsq(columns, frame[VALUE].to_numpy(dtype=np.float64))
    return frame[VALUE] - columns @ solved, int(rank)


def _within_units(data: MeasureData, values: Floats, shared: Sequence[str]) -> list[_MeanSquare]:
    """Return how whole plots or subjects differ in each effect, as the tests have it; empty where runs do not tell."""
    units = UnitRuns.of_data(data)
    if units is None or not set(units.factors) <= set(shared) or units.held.max() > 1:
        return []
    model = designed_model_of(data, Estimand.MEAN, Statistic.COMBINED, values)
    responses = model.fits[-1].responses if isinstance(model, StrataModel) else ()
    terms = units.factors.terms(len(units.factors))
    found = [
        _MeanSquare(term, float(of.mean_square), int(of.freedom * of.contrasts), units.factors.only(term).count)
        for term, of in zip(terms, responses, strict=False)
    ]
    return found[::-1]


def _units(frame: pd.DataFrame, beside: Sequence[str], known: Sequence[_MeanSquare]) -> _Blocks | None:
    """Estimate how whole plots, subjects or incomplete blocks vary, beside runs; None where runs do not tell.

    Units need not have each combination: what they add beside other columns is estimated by Henderson's method 3
    (Estimation of variance and covariance components, Biometrics 9, 1953).
    """
    others, units = _columns(frame, beside), _columns(frame, [_UNIT])
    without, fewer = _residuals(frame, others)
    left, rank = _residuals(frame, np.column_stack([others, units]))
    own = len(frame) - rank
    if own < 1 or rank == fewer:
        return None
    chance = float((left**2).sum()) / own
    weight = float(((units - others @ np.linalg.lstsq(others, units)[0]) ** 2).sum())
    between = (float((without**2).sum()) - float((left**2).sum()) - chance * (rank - fewer)) / weight
    scale = math.sqrt((len(frame) - frame[_CELL].nunique()) / own)
    variances: dict[Term, float] = {}
    if known and chance > 0:
        least, own, cells = known[0].square, known[0].freedom, known[0].levels
        variances, scale = _responses(known, least, cells), scale * math.sqrt(least / chance)
        between -= (least - chance) * (rank - fewer) / weight + _of_means(known, variances)
    return _Blocks(math.sqrt(max(0.0, between)), _deviations(variances), left * scale, own)


def _with_cells(frame: pd.DataFrame, shared: Sequence[str]) -> pd.DataFrame:
    if not shared:
        return frame.assign(**{_CELL: [()] * len(frame)})
    return frame.assign(**{_CELL: [tuple(map(str, row)) for row in frame[list(shared)].itertuples(index=False)]})


def _part(study: Study, cell: Cell, shared: Sequence[str]) -> Cell:
    return tuple(text for name, text in zip(study.factors, cell, strict=True) if name in shared)


class _Blocks(NamedTuple):
    """The standard deviations of blocks and of their responses to treatments, and the remaining residuals.

    Attributes:
        responses: by the factors that blocks respond to.
        left: the residuals without these, scaled to the degrees of freedom of all residuals.
        freedom: the degrees of freedom of the remaining residuals.
    """

    block_sd: float
    responses: dict[Term, float]
    left: pd.Series
    freedom: int


def _blocks(residuals: pd.Series, frame: pd.DataFrame, shared: Sequence[str]) -> _Blocks:
    """Estimate variance components by moments (analysis of variance), with the harmonic mean of the numbers of runs.

    Without repeated runs in blocks, responses to all factors together are confounded with the error and included in it.
    If blocks cannot be separated either, everything is error.
    """
    block, total = frame[_BLOCK].astype(str), len(residuals)
    within = residuals.groupby([block, frame[_CELL]])
    sizes, means = within.size(), within.mean()
    of_blocks = means.groupby(level=0).mean()
    blocks, cells = len(of_blocks), frame[_CELL].nunique()
    each = len(sizes) / float((1 / sizes).sum())
    freedom = len(sizes) - blocks - cells + 1
    between = float(((means - means.groupby(level=0).transform("mean")) ** 2).sum()) / freedom if freedom > 0 else 0.0
    effects = _mean_squares(means, shared) or [_MeanSquare(tuple(shared), between, freedom, cells)]
    if total > len(sizes):
        left = residuals - within.transform("mean")
        own = total - len(sizes)
        chance, scale = float((left**2).sum()) / own, math.sqrt((total - cells) / own)
    elif freedom > 0:
        left = residuals - block.map(of_blocks)
        chance, own = effects[0].square, effects[0].freedom
        scale = math.sqrt((total - cells) / freedom * (chance / between if between else 1.0))
    else:
        return _Blocks(0.0, {}, residuals, total - cells)
    variances = _responses(effects, chance / each, cells)
    noise = _of_means(effects, variances) + chance / each * blocks / len(sizes)
    spread = float(of_blocks.var(ddof=1)) if blocks > 1 else 0.0
    return _Blocks(math.sqrt(max(0.0, spread - noise)), _deviations(variances), left * scale, own)


class _MeanSquare(NamedTuple):
    """How blocks differ in an effect: its factors, the mean square, its degrees of freedom, and the treatments."""

    term: Term
    square: float
    freedom: int
    levels: int


def _responses(effects: Sequence[_MeanSquare], chance: float, cells: int) -> dict[Term, float]:
    """Return the variance of the response to each effect, of which chance and wider interactions are taken away."""
    variances: dict[Term, float] = {}
    levels = {effect.term: effect.levels for effect in effects}
    for term, square, *_ in effects:
        others = math.fsum(of * cells / levels[other] for other, of in variances.items() if set(term) < set(other))
        variances[term] = max(0.0, square - chance - others) * levels[term] / cells
    return variances


def _of_means(effects: Sequence[_MeanSquare], variances: Mapping[Term, float]) -> float:
    """Return what responses add to the variance of the means of blocks."""
    return math.fsum(variances[effect.term] / effect.levels for effect in effects)


def _deviations(variances: Mapping[Term, float]) -> dict[Term, float]:
    return {term: math.sqrt(variance) for term, variance in variances.items() if variance}


def _mean_squares(means: pd.Series, shared: Sequence[str]) -> list[_MeanSquare]:
    """Return how blocks differ in each effect of several factors, interactions first.

    Blocks that lack a combination are left out. The list is empty for a single factor, of fewer than two blocks, and
    where combinations are not those of a full factorial.
    """
    table = means.unstack().dropna()  # noqa: PD010 - a series
    cells = [tuple(each) for each in table]
    factors = Factors({name: list(dict.fromkeys(cell[at] for cell in cells)) for at, name in enumerate(shared)})
    if len(shared) == 1 or len(table) < 2 or factors.count != len(cells):  # noqa: PLR2004 - two blocks differ
        return []
    codes = {
        name: np.array([levels.index(cell[at]) for cell in cells]) for at, (name, levels) in enumerate(factors.items())
    }
    centred = table.to_numpy() - table.to_numpy().mean(axis=0)
    found = []
    for term in reversed(factors.terms(len(shared))):
        contrasts = factors.contrasts(term)[:, factors.numbers(codes)]
        freedom = (len(table) - 1) * len(contrasts)
        square = float(np.sum((centred @ contrasts.T) ** 2)) / freedom
        found.append(_MeanSquare(term, square, freedom, math.prod(len(factors[name]) for name in term)))
    return found
