"""What a pilot experiment tells of the values of a study: means and spreads of combinations, and how blocks vary."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from robot_runner.analysis.planning.assumed_values import AssumedMeasure
from robot_runner.analysis.statistics.design import BATCH, VALUE, design_of
from robot_runner.core.errors import AnalysisError, did_you_mean
from robot_runner.core.words import counted, enumerated

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    import pandas as pd

    from robot_runner.analysis.planning.study import Cell, Study
    from robot_runner.analysis.results import Results
    from robot_runner.analysis.statistics.design import Design, MeasureData

__all__ = ["Pilot", "pilot_values"]

#: Of fewer runs a combination's own standard deviation is hardly known (by half and more); that of all takes its place.
_ENOUGH = 5
_FEWEST = 2
_RESIDUAL, _BLOCK, _CELL = " residual", " block", " cell"


@dataclass(frozen=True, slots=True)
class Pilot:
    """What a pilot tells.

    Attributes:
        measures: by name.
        notes: what it does not tell, and what was done about that.
    """

    name: str
    measures: dict[str, AssumedMeasure]
    notes: tuple[str, ...]


def pilot_values(study: Study, results: Results, measures: Sequence[str]) -> Pilot:
    """Return what a pilot tells of some measures, for each combination of a study.

    Runs of a combination that differ in factors which the study does not have are taken together. What a batch of an
    extended pilot adds is taken out.

    Raises:
        AnalysisError: it lacks a measure, a treatment or a combination of the study, or has too few runs.
    """
    where = f"--pilot {results.name}"
    design = design_of(results, blocks=study.plan.blocks if study.plan is not None else None)
    for name in measures:
        if name not in results.measures:
            problem = f"the pilot has no measure {name!r}"
            raise AnalysisError(problem, where=where, fix=did_you_mean(name, results.measures))
    shared = _shared(study, design, where)
    found = {name: _measure(study, design, name, shared, where) for name in measures}
    return Pilot(results.name, found, tuple(_notes(study, design, shared)))


def _shared(study: Study, design: Design, where: str) -> list[str]:
    """Return the factors of the study that the pilot has, with all treatments of the study."""
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
        yield f"The pilot did not vary {enumerated(alone)}: no effect of {'it' if len(alone) == 1 else 'them'} is assumed."
    if (study.blocks or (study.plan is not None and study.plan.blocks)) and design.block is None:
        yield "The pilot has no blocks: blocks are taken not to vary, unless --block-sd and --response-sd say how."


def _measure(study: Study, design: Design, name: str, shared: Sequence[str], where: str) -> AssumedMeasure:
    data = design.data(name)
    if data is None:
        raise AnalysisError(f"{name} is no number in the pilot", where=where, fix="Name another with --measure.")
    frame = data.frame[data.frame[list(shared)].notna().all(axis=1)] if shared else data.frame
    cells = [tuple(map(str, row)) for row in frame[list(shared)].itertuples(index=False)] if shared else [()] * len(frame)
    frame = frame.assign(**{_CELL: cells})
    means = frame.groupby(_CELL)[VALUE].mean().to_dict()
    counts = frame[_CELL].value_counts().to_dict()
    wanted = {cell: _part(study, cell, shared) for cell in study.cells}
    missing = [" / ".join(part) for part in dict.fromkeys(wanted.values()) if part not in means]
    if missing:
        problem = f"the pilot has no value of {name} for {counted(len(missing), 'combination')}: {enumerated(missing[:5])}"
        raise AnalysisError(problem, where=where, fix="Execute these runs, or give --sd and --difference instead.")
    residuals = frame[VALUE] - frame[_CELL].map(means)
    if data.is_extended:
        residuals = residuals - residuals.groupby(frame[BATCH].astype(str)).transform("mean")
    freedom = len(frame) - len(means)
    if freedom < 1:
        fix = "Repeat its runs, or give --sd."
        raise AnalysisError(f"the pilot has a single run of each combination: {name} has no spread", where=where, fix=fix)
    block_sd, response_sd, residuals = _blocks(data, frame.assign(**{_RESIDUAL: residuals}))
    pooled = math.sqrt(float(np.sum(residuals**2)) / freedom)
    own = residuals.groupby(frame[_CELL]).agg(lambda each: math.sqrt(float(np.sum(each**2)) / max(1, len(each) - 1)))
    spreads = {
        cell: float(own[part]) if counts[part] >= _ENOUGH else pooled for cell, part in wanted.items()
    }
    return AssumedMeasure(name, {cell: float(means[part]) for cell, part in wanted.items()}, spreads, block_sd, response_sd)


def _part(study: Study, cell: Cell, shared: Sequence[str]) -> Cell:
    return tuple(text for name, text in zip(study.factors, cell, strict=True) if name in shared)


def _blocks(data: MeasureData, frame: pd.DataFrame) -> tuple[float, float, pd.Series]:
    """Return how blocks vary, how their responses to treatments do, and the residuals without both.

    By moments (analysis of variance of the residuals), with the harmonic mean of the numbers of runs. Without
    repeated runs in blocks, responses cannot be told from chance and stay in it.
    """
    residuals: pd.Series = frame[_RESIDUAL]
    if not data.is_blocked:
        return 0.0, 0.0, residuals
    blocks = frame[_BLOCK]
    within = residuals.groupby([blocks, frame[_CELL]])
    sizes = within.size()
    count, cells = blocks.nunique(), frame[_CELL].nunique()
    means = within.mean().unstack()
    of_blocks = means.mean(axis=1)
    each = len(sizes) / float((1 / sizes).sum())
    is_repeated = float(sizes.median()) >= _FEWEST and len(residuals) > len(sizes)
    if count < _FEWEST:
        return 0.0, 0.0, residuals
    rest = means.sub(of_blocks, axis=0)
    freedom = max(1, (count - 1) * max(1, cells - 1))
    between = float(np.nansum(rest.to_numpy() ** 2)) / freedom if cells > 1 else 0.0
    if is_repeated:
        chance = float(((residuals - within.transform("mean")) ** 2).sum()) / (len(residuals) - len(sizes))
        response = max(0.0, between - chance / each) if cells > 1 else 0.0
        left = residuals - within.transform("mean")
        left *= math.sqrt((len(residuals) - cells) / (len(residuals) - len(sizes)))
    else:
        response = 0.0
        left = residuals - blocks.map(of_blocks)
        left *= math.sqrt((len(residuals) - cells) / max(1, len(residuals) - cells - count + 1))
    spread = float(np.var(of_blocks, ddof=1))
    noise = (response + float(np.mean(left**2)) / each) / max(1, cells)
    return math.sqrt(max(0.0, spread - noise)), math.sqrt(response), left
