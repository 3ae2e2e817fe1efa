"""Relative error and limits of agreement of two experiments."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from robot_runner.analysis.comparison.outcome import Agreement

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

__all__ = ["agreement_of"]

_PERCENT = 100.0
#: Bland and Altman, "Statistical methods for assessing agreement between two methods of clinical measurement" (Lancet
#: 327, 1986): 95 % of normally distributed differences.
_SPREAD = 1.96
_FEWEST = 2


def agreement_of(
    groups: Mapping[str, tuple[NDArray[np.float64], NDArray[np.float64]]], *, is_paired: bool
) -> Agreement | None:
    """Return relative error and limits of agreement, or None where there is no pair.

    Args:
        groups: by combination: the values of the first and the second experiment; of pairs in the same order.
        is_paired: whether values belong together; otherwise those of one combination are put beside each other.
    """
    pairs = {
        label: [(float(one), float(other)) for one, other in zip(first, second, strict=False)]
        for label, (first, second) in groups.items()
        if len(first) and len(second)
    }
    differences = np.array([other - one for several in pairs.values() for one, other in several])
    if not len(differences):
        return None
    bias = float(differences.mean())
    spread = float(differences.std(ddof=1)) * _SPREAD if len(differences) >= _FEWEST else None
    references = (
        [pair for several in pairs.values() for pair in several]
        if is_paired
        else [
            (float(first.mean()), float(second.mean())) for first, second in groups.values() if len(first) * len(second)
        ]
    )
    return Agreement(
        pairs,
        are_natural=is_paired,
        bias=bias,
        lower=None if spread is None else bias - spread,
        upper=None if spread is None else bias + spread,
        error=_error(references),
    )


def _error(pairs: Sequence[tuple[float, float]]) -> float | None:
    """Return the mean absolute percentage error of the second values, in percent of the first ones."""
    if any(one == 0 for one, _ in pairs):
        return None
    return float(np.mean([abs(other - one) / abs(one) for one, other in pairs])) * _PERCENT
