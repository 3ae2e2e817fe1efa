"""Counters that only rise, and wrap around or are reset."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

from robot_runner.meters.polled import Meter

#: Several counters at one moment.
Counters = tuple[int, ...]


class FileCounters(Meter[Counters]):
    """Counters in files of the kernel, which are read again from their beginning each time."""

    def __init__(self, paths: Sequence[Path]) -> None:
        self._paths = paths
        self.read()

    def read(self) -> Counters:
        """Return the current values."""
        return tuple(int(path.read_bytes()) for path in self._paths)


def unwrapped(counts: Sequence[int] | Sequence[float], wraps_at: float | None = None) -> list[float]:
    """Return a counter without its restarts at 0, from 0 at its first count.

    A single count that is too low, followed by one where the counter would be, was misread and is skipped.

    Args:
        counts: as they were read, oldest first.
        wraps_at: the value at which the counter wraps to 0; None if it never does. Unless it wrapped, a lower count
            means a reset to 0 in between, of which only the count since then is known.

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
    """Return the counts without misread ones; after a restart at 0 the next count would not be so high so soon."""
    mended = list(counts)
    for place in range(1, len(counts) - 1):
        if counts[place] < mended[place - 1] <= counts[place + 1]:
            mended[place] = mended[place - 1]
    return mended


def fall_count(counts: Sequence[int] | Sequence[float], wraps_at: float | None = None) -> int:
    """Return how often a counter was lower than at the reading before without a wrap-around.

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
    """Whether a counter wrapped: between two readings it counts less than half its range, as these are frequent."""
    return later < sooner <= wraps_at and sooner - later > wraps_at / 2
