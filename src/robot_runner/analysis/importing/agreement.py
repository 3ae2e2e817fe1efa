"""How well the recomputed measures agree with the table's own, measure by measure."""

from __future__ import annotations

from dataclasses import dataclass
from statistics import median
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable

    from robot_runner.analysis.importing.recomputation import Difference

__all__ = ["TOLERANCE", "Agreement", "agreements"]

#: Values closer than this are the same but for rounding and the way of integrating, as a share of the table's value.
TOLERANCE = 0.001

#: Factors by which values differ when a unit was mistaken.
_FACTORS = (1e-9, 1e-6, 1e-3, 1e-2, 1 / 60, 60.0, 3.6, 1 / 3.6, 100.0, 1e3, 3600.0, 1 / 3600, 1e6, 1e9)
_SAME_FACTOR = 0.02


@dataclass(frozen=True, slots=True)
class Agreement:
    """One measure.

    Attributes:
        compared: how many runs have both values.
        differing: those that differ by more than the tolerance, the largest difference first.
        largest: the largest difference, whether it is tolerated or not.
        factor: by how much all recomputed values differ from the table's, where that looks like a mistaken unit.
    """

    measure: str
    compared: int
    differing: tuple[Difference, ...]
    largest: Difference
    factor: float | None


def agreements(differences: Iterable[Difference], *, tolerance: float = TOLERANCE) -> tuple[Agreement, ...]:
    """Return how well each measure agrees, in the order in which measures come.

    Args:
        differences: all pairs of values.
        tolerance: a share of the table's value.

    Example:
        >>> from robot_runner.analysis.importing.recomputation import Difference
        >>> agreements([Difference("r_1", "Energy", 870.0, 870.1)])[0].differing
        ()
    """
    by_measure: dict[str, list[Difference]] = {}
    for each in differences:
        by_measure.setdefault(each.measure, []).append(each)
    return tuple(_agreement(measure, found, tolerance) for measure, found in by_measure.items())


def _agreement(measure: str, found: list[Difference], tolerance: float) -> Agreement:
    ordered = sorted(found, key=_size, reverse=True)
    differing = tuple(each for each in ordered if _size(each) > tolerance)
    return Agreement(measure, len(found), differing, ordered[0], _factor(found) if differing else None)


def _size(difference: Difference) -> float:
    relative = difference.relative
    return float("inf") if relative is None else abs(relative)


def _factor(found: list[Difference]) -> float | None:
    ratios = [each.recomputed / each.table for each in found if each.table]
    if not ratios:
        return None
    middle = median(ratios)
    return next((factor for factor in _FACTORS if abs(middle / factor - 1) < _SAME_FACTOR), None)
