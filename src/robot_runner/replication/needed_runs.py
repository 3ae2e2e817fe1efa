"""How many runs of a combination would have decided what a replication left open."""

from __future__ import annotations

import math
from statistics import NormalDist
from typing import TYPE_CHECKING, Any

from robot_runner.core.words import counted

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

#: The probability with which a decision is to be had, as planning takes it where nothing else is said.
_POWER = 0.8
#: More cannot be meant: the difference lies at the bound.
_MOST = 100_000


def runs_for_equivalence(variance: float, difference: float, bound: float, alpha: float) -> int | None:
    """Return how many runs of each experiment two one-sided tests need; None where the difference reaches the bound.

    n = V (z(1 - alpha) + z(power))^2 / (bound - |difference|)^2, with z(1 - (1 - power) / 2) where the difference is 0,
    and V the sum of both variances (Julious, Statistics in Medicine 23, 2004).

    Example:
        >>> runs_for_equivalence(2.0, 0.0, 1.0, 0.05)
        18
    """
    room = bound - abs(difference)
    if room <= 0:
        return None
    normal = NormalDist()
    power = normal.inv_cdf(_POWER if difference else 1 - (1 - _POWER) / 2)
    return _whole(variance * (normal.inv_cdf(1 - alpha) + power) ** 2 / room**2)


def runs_for_difference(variance: float, difference: float, alpha: float) -> int | None:
    """Return how many runs of each experiment a two-sided test needs; None where there is no difference.

    n = V (z(1 - alpha / 2) + z(power))^2 / difference^2 (Julious 2004).

    Example:
        >>> runs_for_difference(2.0, 1.0, 0.05)
        16
    """
    if not difference:
        return None
    normal = NormalDist()
    return _whole(variance * (normal.inv_cdf(1 - alpha / 2) + normal.inv_cdf(_POWER)) ** 2 / difference**2)


def _whole(runs: float) -> int | None:
    return max(2, math.ceil(runs)) if runs < _MOST else None


def needed_runs(differences: Sequence[Mapping[str, Any]], alpha: float) -> str:
    """Return in words what would decide the combinations of a measure that are undecided.

    Args:
        differences: as a comparison has them: `verdict`, `first_n`, `first_sd`, `second_sd`, `difference`, `bound`,
            `not_computed`; where runs count together, `unit`, and `first_units` and `first_error` of both experiments.
        alpha: the level of significance.
    """
    if not differences:
        return "there are no runs of the same combination"
    undecided = [each for each in differences if each["verdict"] == "undecided"]
    fewest = min(min(each["first_n"], each["second_n"]) for each in undecided or differences)
    there_are = f"there {'is' if fewest == 1 else 'are'} {counted(fewest, 'run')} a combination"
    unit = next((str(each["unit"]) for each in undecided if each.get("unit")), "")
    if fewest < 2:  # noqa: PLR2004 - one value has no spread
        return f"{there_are}, and 2 of each experiment are the fewest that can be tested"
    if why := next((str(each["not_computed"]) for each in undecided if each.get("not_computed")), ""):
        return f"{why[0].lower()}{why[1:].rstrip('.')}"  # more runs of the same kind have no test either
    needed = [_needed(each, alpha) for each in undecided if each["first_sd"] is not None]
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


def _needed(each: Mapping[str, Any], alpha: float) -> int | None:
    """Return how many runs would decide a combination one way or the other."""
    variance = sum(_variance(each, side) for side in _SIDES)
    difference, bound = each["difference"] or 0.0, each["bound"]
    ways = [runs_for_difference(variance, difference, alpha)]
    if bound:
        ways.append(runs_for_equivalence(variance, difference, bound, alpha))
    found = [way for way in ways if way is not None]
    fewest = min(found, default=None)
    return None if fewest is None else max(fewest, min(_units(each, side) for side in _SIDES) + 1)


_SIDES = ("first", "second")


def _units(each: Mapping[str, Any], side: str) -> int:
    """Return how many units a combination has that vary by chance: its runs, where none count together."""
    return int(each.get(f"{side}_units") or each[f"{side}_n"])


def _variance(each: Mapping[str, Any], side: str) -> float:
    """Return the variance of one such unit."""
    error = each.get(f"{side}_error")
    return float(error) ** 2 * _units(each, side) if error is not None else (each[f"{side}_sd"] or 0.0) ** 2
