"""What the number of runs suffices for, whatever their values: the power of the observed effect is not among it.

`analysis.planning` answers how many runs a study needs, by the report's own tests.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import brentq

from robot_runner.analysis.statistics.descriptive import quiet
from robot_runner.analysis.statistics.outcome import Power, RepetitionsNeeded
from robot_runner.analysis.statistics.tested import NotComputed

if TYPE_CHECKING:
    from collections.abc import Sequence

    from robot_runner.analysis.statistics.grouped_runs import Group

_TARGET = 0.8
_MOST_REPETITIONS = 100_000
_SMALLEST, _LARGEST = 1e-6, 100.0  # effects between which the detectable one is looked for

#: Cohen, Statistical Power Analysis for the Behavioral Sciences, 1988.
_COHEN_D = {"small": 0.2, "medium": 0.5, "large": 0.8}
_COHEN_F = {"small": 0.1, "medium": 0.25, "large": 0.4}

_NOTE = (
    "Figures are for a test of independent groups with equal spreads, with as many runs in each as in the groups on "
    "average (harmonic mean). Plan the next study by its own tests, with the effect that matters: robot-runner power."
)
_NOTE_ON_BLOCKS = "Blocks are left out of account: where they differ from each other, the power is higher than this."


def power_of(groups: Sequence[Group], alpha: float, *, is_blocked: bool = False) -> Power | NotComputed:
    """Return the power for the groups of one factor: of a t-test for two, of an analysis of variance for more.

    Args:
        groups: the runs of each treatment.
        alpha: the level of significance.
        is_blocked: whether runs belong to blocks, which are left out of account.
    """
    sizes = [len(group.values) for group in groups]
    if len(groups) < 2 or min(sizes) < 2:  # noqa: PLR2004 - a single run has no spread
        return NotComputed("power", "the power of a test takes two groups of two runs each.")
    if all(np.ptp(group.values) == 0 for group in groups):
        return NotComputed("power", "within each group all values are equal.")
    each = len(sizes) / sum(1 / size for size in sizes)
    count = len(groups)
    named = _COHEN_D if count == 2 else _COHEN_F  # noqa: PLR2004
    return Power(
        effect_name="Cohen's d" if count == 2 else "Cohen's f",  # noqa: PLR2004
        alpha=alpha,
        target_power=_TARGET,
        detectable_effect=_detectable(each, count, alpha),
        needed=tuple(
            RepetitionsNeeded(size, name, runs)
            for name, size in named.items()
            if (runs := repetitions_needed(size, count, alpha=alpha)) is not None
        ),
        note=f"{_NOTE} {_NOTE_ON_BLOCKS}" if is_blocked else _NOTE,
    )


def repetitions_needed(effect: float, groups: int, *, alpha: float = 0.05, power: float = _TARGET) -> int | None:
    """Return how many runs each group needs so that an effect is found with this power.

    Args:
        effect: Cohen's d for two groups, Cohen's f for more.
        groups: how many groups there are.
        alpha: the level of significance.
        power: the probability of finding the effect, 0..1.

    Returns:
        None where no reasonable number suffices.

    Example:
        >>> repetitions_needed(0.8, groups=2)
        26
    """
    if not effect > 0 or _power(effect, _MOST_REPETITIONS, groups, alpha) < power:
        return None
    enough = 2
    while _power(effect, enough, groups, alpha) < power:
        enough *= 2
    return bisect_left(range(enough), power, lo=2, key=lambda runs: _power(effect, runs, groups, alpha))


def _power(effect: float, runs: float, groups: int, alpha: float) -> float:
    from statsmodels.stats.power import FTestAnovaPower, TTestIndPower  # noqa: PLC0415 - takes a second to import

    with quiet():
        if groups == 2:  # noqa: PLR2004
            found = TTestIndPower().power(effect, runs, alpha)
        else:
            found = FTestAnovaPower().power(effect, runs * groups, alpha, k_groups=groups)
    return float(found) if math.isfinite(found) else 1.0  # an effect beyond what the noncentral distribution computes


def _detectable(runs: float, groups: int, alpha: float) -> float | None:
    """Return the smallest effect that is found with the target power."""
    try:
        found = brentq(lambda effect: _power(effect, runs, groups, alpha) - _TARGET, _SMALLEST, _LARGEST)
    except ValueError:  # not even the largest
        return None
    return float(found)
