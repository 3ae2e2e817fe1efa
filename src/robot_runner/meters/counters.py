"""Counters that only rise, and wrap around or are set back."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

from robot_runner.meters.polled import Meter

#: Several counters at one moment.
Counters = tuple[int, ...]


class FileCounters(Meter[Counters]):
    """Counters that stand in files of the kernel, which can be read from the beginning on."""

    def __init__(self, paths: Sequence[Path]) -> None:
        self._paths = paths
        self.read()

    def read(self) -> Counters:
        """Return the counters of this moment."""
        return tuple(int(path.read_bytes()) for path in self._paths)


def unwrapped(counts: Sequence[int] | Sequence[float], wraps_at: float | None = None) -> list[float]:
    """Return a counter that goes on where the true one began at 0 again, from 0 at its first count.

    A single count that is too low, with the next one where the counter would be, was misread and is passed over.

    Args:
        counts: as they were read, oldest first.
        wraps_at: the value at which the counter begins at 0 again; None where it never does. Where it did not, a lower
            count can only mean that it was set to 0 meanwhile, so that what it counted since then is all that is known.

    Example:
        >>> unwrapped([90, 97, 5], wraps_at=100)
        [0, 7, 15]
        >>> unwrapped([90, 97, 5])
        [0, 7, 12]
        >>> unwrapped([90, 97, 0, 99])
        [0, 7, 7, 9]
    """
    total: float = 0
    totals: list[float] = [0] if counts else []
    for sooner, later in pairwise(_without_dips(counts)):
        total += later if later < sooner else later - sooner
        if wraps_at is not None and _goes_round(sooner, later, wraps_at):
            total += wraps_at - sooner
        totals.append(total)
    return totals


def _without_dips(counts: Sequence[int] | Sequence[float]) -> Sequence[float]:
    """Return the counts without those that were misread; one that had begun at 0 again would not be so high so soon."""
    mended = list(counts)
    for place in range(1, len(counts) - 1):
        if counts[place] < mended[place - 1] <= counts[place + 1]:
            mended[place] = mended[place - 1]
    return mended


def fall_count(counts: Sequence[int] | Sequence[float], wraps_at: float | None = None) -> int:
    """Return how often a counter was lower than at the reading before, though it had not gone round.

    Example:
        >>> fall_count([90, 97, 5, 6]), fall_count([90, 97, 5, 6], wraps_at=100), fall_count([90, 5, 97], wraps_at=100)
        (1, 0, 1)
    """
    mended = _without_dips(counts)
    misread = sum(each != count for each, count in zip(mended, counts, strict=True))
    return misread + sum(
        later < sooner and (wraps_at is None or not _goes_round(sooner, later, wraps_at))
        for sooner, later in pairwise(mended)
    )


def _goes_round(sooner: float, later: float, wraps_at: float) -> bool:
    """Whether a counter began at 0 again by itself: it was read often enough to count less than half its range."""
    return later < sooner <= wraps_at and sooner - later > wraps_at / 2
