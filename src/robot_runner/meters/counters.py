"""What a counter that only rises says of a window, also where it wraps around or is set back."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

from robot_runner.core.sampling.series import Series, Window, cut

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["fall_count", "increase", "unwrapped"]


def unwrapped(counts: Sequence[float], wraps_at: float | None = None) -> list[float]:
    """Return a counter that goes on where the true one began at 0 again, from 0 at its first count.

    Args:
        counts: as they were read, oldest first.
        wraps_at: the value at which the counter begins at 0 again; None where a lower count can only mean that it was
            set to 0 meanwhile, so that what it counted since then is all that is known.

    Example:
        >>> unwrapped([90, 97, 5], wraps_at=100)
        [0, 7, 15]
        >>> unwrapped([90, 97, 5])
        [0, 7, 12]
    """
    total: float = 0
    totals: list[float] = [0] if counts else []
    for sooner, later in pairwise(counts):
        total += later - sooner if later >= sooner else later if wraps_at is None else later - sooner + wraps_at
        totals.append(total)
    return totals


def fall_count(counts: Sequence[float]) -> int:
    """Return how often a counter was lower than at the reading before.

    Example:
        >>> fall_count([90, 97, 5, 6])
        1
    """
    return sum(later < sooner for sooner, later in pairwise(counts))


def increase(counter: Series, window: Window, *, wraps_at: float | None = None) -> float | None:
    """Return by how much a counter rose in a window, or None where two readings do not span any of it.

    On the window's edges it is interpolated between the readings on either side. Where the readings begin or end
    inside, what lies between them and the edge counts at the mean rate of the rest.

    Example:
        >>> increase(Series([0.0, 10.0, 20.0], [5.0, 25.0, 35.0]), Window(5.0, 15.0))
        15.0
    """
    within = cut(Series(counter.times, unwrapped(counter.values, wraps_at)), window)
    span = within.times[-1] - within.times[0] if len(within) else 0.0
    return (within.values[-1] - within.values[0]) * window.duration / span if span else None
