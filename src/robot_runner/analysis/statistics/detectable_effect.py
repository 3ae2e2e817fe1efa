"""The detectable effect and the runs needed, from the numbers of runs alone, not the power of the observed effect.

`analysis.planning` computes how many runs a study needs, with the tests of the report.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from scipy import stats
from scipy.optimize import brentq

from robot_runner.analysis.statistics.cell_layout import COMPLETE
from robot_runner.analysis.statistics.descriptive import quiet
from robot_runner.analysis.statistics.outcome import Power, RepetitionsNeeded
from robot_runner.analysis.statistics.tested import NotComputed

if TYPE_CHECKING:
    from robot_runner.analysis.statistics.analysed_design import MeasureData
    from robot_runner.analysis.statistics.grouped_runs import Group

_TARGET = 0.8
_MOST_REPETITIONS = 100_000
_SMALLEST, _LARGEST = 1e-6, 100.0  # effects between which the detectable one is looked for
_EXACT = 1e-6  # by how much its power may differ from the target

#: Cohen, Statistical Power Analysis for the Behavioral Sciences, 1988.
_COHEN_D = {"small": 0.2, "medium": 0.5, "large": 0.8}
_COHEN_F = {"small": 0.1, "medium": 0.25, "large": 0.4}

_PLAN = "Plan the next study by its own tests, with the effect that matters: robot-runner power."
_NOTE = (
    "Figures are for a test of independent groups with equal spreads, with as many runs in each as in the groups on "
    f"average (harmonic mean). {_PLAN}"
)
_NOTE_BETWEEN = (
    "Figures are for a test of the means of blocks, each of which has one treatment, and effects are in standard "
    f"deviations of these means: more runs of the same blocks hardly help. {_PLAN}"
)
_NOTE_WITHIN = (
    "Figures are for a test within complete blocks, with equal spreads; effects are in standard deviations of the "
    "means of treatments in a block, of what is left once the means of blocks are taken away. More runs in the same "
    f"blocks hardly help. {_PLAN}"
)


@dataclass(frozen=True, slots=True)
class Units:
    """The experimental units.

    Attributes:
        sizes: the number of units in each group.
        are_blocks: whether they are blocks; else runs.
        are_shared: whether each block has all groups.
    """

    sizes: Sequence[int]
    are_blocks: bool = False
    are_shared: bool = False


def units_of(data: MeasureData) -> Units | NotComputed:
    """Return the experimental units of a measure with one factor.

    With blocks these are the blocks: either each block has one treatment, or nearly every block has all.
    """
    if not data.is_blocked:
        return Units([len(group.values) for group in data.groups(data.factors)])
    (name,) = data.factors
    held = data.frame[name].astype("str").groupby(data.blocks).agg(set)
    if max(map(len, held)) == 1:
        only = [next(iter(each)) for each in held]
        return Units([only.count(level) for level in data.levels(name)], are_blocks=True)
    levels = data.levels(name)
    complete = sum(len(each) == len(levels) for each in held)
    if complete < COMPLETE * len(held):
        return NotComputed("power", "it is computed for runs that stand by themselves, and for complete blocks.")
    return Units([complete] * len(levels), are_blocks=True, are_shared=True)


def power_of(groups: Sequence[Group], units: Units, alpha: float) -> Power | NotComputed:
    """Return the power for the groups of one factor: of a t-test for two, of an analysis of variance for more."""
    sizes = units.sizes
    if len(groups) < 2 or min(sizes) < 2:  # noqa: PLR2004 - a single run has no spread
        of = "blocks" if units.are_blocks else "groups of two runs"
        return NotComputed("power", f"the power of a test takes two {of} each.")
    if all(np.ptp(group.values) == 0 for group in groups):
        return NotComputed("power", "within each group all values are equal.")
    each = len(sizes) / sum(1 / size for size in sizes)
    count = len(groups)
    named = _COHEN_D if count == 2 else _COHEN_F  # noqa: PLR2004
    needed = [
        RepetitionsNeeded(size, name, found)
        for name, size in named.items()
        if (found := repetitions_needed(size, count, alpha=alpha, in_blocks=units.are_shared)) is not None
    ]
    return Power(
        effect_name="Cohen's d" if count == 2 else "Cohen's f",  # noqa: PLR2004
        alpha=alpha,
        target_power=_TARGET,
        detectable_effect=_detectable(each, count, alpha, in_blocks=units.are_shared),
        needed=tuple(needed),
        note=_NOTE_WITHIN if units.are_shared else _NOTE_BETWEEN if units.are_blocks else _NOTE,
        counted="blocks" if units.are_shared else "blocks of a group" if units.are_blocks else "runs of a group",
    )


def repetitions_needed(
    effect: float, groups: int, *, alpha: float = 0.05, power: float = _TARGET, in_blocks: bool = False
) -> int | None:
    """Return how many runs each group needs, or how many blocks, to detect an effect with this power.

    The effect is Cohen's d for two groups, Cohen's f for more. None if no reasonable number suffices.

    Example:
        >>> repetitions_needed(0.8, groups=2)
        26
    """

    def found(runs: float) -> float:
        return _power(effect, runs, groups, alpha, in_blocks=in_blocks)

    if not effect > 0 or found(_MOST_REPETITIONS) < power:
        return None
    enough = 2
    while found(enough) < power:
        enough *= 2
    return bisect_left(range(enough), power, lo=2, key=found)


@lru_cache(maxsize=1024)  # the measures of a report have groups of one size, mostly
def _power(effect: float, runs: float, groups: int, alpha: float, *, in_blocks: bool = False) -> float:
    between = groups - 1
    freedom = between, (between if in_blocks else groups) * (runs - 1)  # blocks take degrees of freedom
    # For two groups this is the two-sided t-test.
    squares = runs * effect**2 / 2 if groups == 2 else runs * groups * effect**2  # noqa: PLR2004
    with quiet():
        share = float(stats.ncf.sf(stats.f.isf(alpha, *freedom), *freedom, squares))
    return share if math.isfinite(share) else 1.0  # an effect beyond what the noncentral distribution computes


def _detectable(runs: float, groups: int, alpha: float, *, in_blocks: bool) -> float | None:
    """Return the smallest effect with the target power; None if there is none, or it cannot be computed."""

    def lacking(effect: float) -> float:
        return _TARGET - _power(effect, runs, groups, alpha, in_blocks=in_blocks)

    try:
        found = float(brentq(lacking, _SMALLEST, _LARGEST))
    except ValueError:  # not even the largest
        return None
    # Where the noncentral distribution cannot be computed, the power jumps to 1: this is not the target.
    return found if abs(lacking(found)) < _EXACT else None
