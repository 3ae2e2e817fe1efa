"""Compute how many runs of a combination would decide an undecided measure of a replication."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Mapping, Sequence
from statistics import NormalDist
from typing import Any

from robot_runner.core.design.repeated_intervals import t_probability, t_quantile
from robot_runner.core.words import counted

#: The power: the probability of a decision, planning's default.
_POWER = 0.8
#: No larger number is reported: the difference is too close to the bound.
_MOST = 100_000
#: Above so many degrees of freedom, the normal distribution replaces Student's t.
_MANY = 300

#: The variance of one run of the first experiment, and of the second.
Variances = tuple[float, float]


def runs_for_equivalence(variances: Variances, difference: float, bound: float, alpha: float) -> int | None:
    """Return how many runs of each experiment two one-sided tests need; None if the difference reaches the bound.

    The power of n runs is P(t < (bound - |difference|) / error - t(1 - alpha))
    + P(t < (bound + |difference|) / error - t(1 - alpha)) - 1, for Student's t and the standard error of the
    difference (Julious, Statistics in Medicine 23, 2004).

    Example:
        >>> runs_for_equivalence((1.0, 1.0), 0.0, 1.0, 0.05)
        18
    """
    return _fewest(variances, (bound - abs(difference), bound + abs(difference)), 1 - alpha)


def runs_for_difference(variances: Variances, difference: float, alpha: float) -> int | None:
    """Return how many runs of each experiment a two-sided test needs; None if there is no difference.

    The power of n runs is P(t < |difference| / error - t(1 - alpha / 2)), for Student's t and the standard error of
    the difference.

    Example:
        >>> runs_for_difference((1.0, 1.0), 1.0, 0.05)
        17
    """
    return _fewest(variances, (abs(difference),), 1 - alpha / 2)


def _fewest(variances: Variances, rooms: Sequence[float], level: float) -> int | None:
    """Return the fewest runs with enough power: the probability that all one-sided tests at these distances reject.

    The degrees of freedom are Welch's. The normal distribution is not a substitute for few runs: it gives 2, not 4.
    """
    largest = max(variances)
    if min(rooms) <= 0:
        return None
    if not largest:
        return 2
    first, second = (each / largest for each in variances)
    share = (first + second) ** 2 / (first**2 + second**2)  # from 1 to 2
    unit = math.sqrt(largest) * math.sqrt(first + second)

    def power(runs: int) -> float:
        freedom, ratio = (runs - 1) * share, math.sqrt(runs) / unit
        critical = _quantile(level, freedom)
        return 1 - sum(1 - _probability(room * ratio - critical, freedom) for room in rooms)

    return None if power(_MOST) < _POWER else bisect_left(range(_MOST), _POWER, lo=2, key=power)


def _quantile(level: float, freedom: float) -> float:
    """Return the quantile of Student's t."""
    return NormalDist().inv_cdf(level) if freedom > _MANY else t_quantile(level, math.floor(freedom))


def _probability(value: float, freedom: float) -> float:
    """Return the probability that Student's t is below a value."""
    return NormalDist().cdf(value) if freedom > _MANY else t_probability(value, math.floor(freedom))


def needed_runs(differences: Sequence[Mapping[str, Any]], alpha: float, *, is_relative: bool = False) -> str:
    """Return in words what would decide the undecided combinations of a measure.

    Args:
        differences: the differences of a comparison: `verdict`, `first_n`, `first_sd`, `second_sd`, `difference`,
            `bound`, `not_computed`; if runs are grouped into units, `unit`, and `first_units` and `first_error` of both
            experiments; if bounds are relative, `first_mean`.
        alpha: the level of significance.
        is_relative: whether the bound is a percentage of the first mean, which has a standard error, too.
    """
    undecided = [each for each in differences if each["verdict"] == "undecided"]
    fewest = min(min(each["first_n"], each["second_n"]) for each in undecided or differences)
    there_are = f"there {'is' if fewest == 1 else 'are'} {counted(fewest, 'run')} a combination"
    unit = next((str(each["unit"]) for each in undecided if each.get("unit")), "")
    if fewest < 2:  # noqa: PLR2004 - one value has no spread
        return f"{there_are}, and 2 of each experiment are the fewest that can be tested"
    if why := next((str(each["not_computed"]) for each in undecided if each.get("not_computed")), ""):
        return f"{why[0].lower()}{why[1:].rstrip('.')}"  # more such runs cannot be tested either
    # Holm's adjustment of p-values: for all combinations except those that were found to differ.
    tested = [each for each in differences if each["verdict"] != "different" and each.get("p_value") is not None]
    shared = alpha / max(1, len(tested))
    needed = [_needed(each, alpha, shared, is_relative) for each in undecided if each["first_sd"] is not None]
    known = [each for each in needed if each is not None]
    if not known or len(known) < len(undecided):
        return f"{there_are}, and the difference lies so close to the bound that no number of runs would do"
    fix = "--bound names another bound" if max(known) > _MOST / 100 else "`robot-runner extend` adds runs to both"
    if unit:
        fewest = min(_units(each, side) for each in undecided for side in _SIDES)
        there_are += f", of {counted(fewest, 'unit')} of {unit}"
        return (
            f"{there_are}, and about {max(known):,} units of each experiment would be needed, if means and spread stay "
            f"as they are ({_POWER:.0%} power; more runs of the same units hardly help)"
        )
    return (
        f"{there_are}, and about {max(known):,} of each experiment would be needed, if means and spread stay as they "
        f"are ({_POWER:.0%} power; {fix})"
    )


def _needed(each: Mapping[str, Any], alpha: float, shared: float, is_relative: bool) -> int | None:
    """Return how many runs would decide a combination either way; `shared` is alpha with Holm's adjustment."""
    first, second = (_variance(each, side) for side in _SIDES)
    difference, bound = each["difference"] or 0.0, each["bound"]
    ways = [runs_for_difference((first, second), difference, shared)]
    if bound:
        # With a relative bound, the second mean is tested against the first mean times (1 + bound).
        times = 1 + bound / abs(each["first_mean"]) if is_relative and each["first_mean"] else 1.0
        ways.append(runs_for_equivalence((first * times**2, second), difference, bound, alpha))
    fewest = min((way for way in ways if way is not None), default=None)
    return None if fewest is None else max(fewest, min(_units(each, side) for side in _SIDES) + 1)


_SIDES = ("first", "second")


def _units(each: Mapping[str, Any], side: str) -> int:
    """Return the number of independent units of a combination: its runs, unless they are grouped."""
    return int(each.get(f"{side}_units") or each[f"{side}_n"])


def _variance(each: Mapping[str, Any], side: str) -> float:
    """Return the variance of one unit."""
    error = each.get(f"{side}_error")
    return float(error) ** 2 * _units(each, side) if error is not None else (each[f"{side}_sd"] or 0.0) ** 2
