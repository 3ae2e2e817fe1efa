"""Samples over time."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import islice
from operator import le
from typing import TYPE_CHECKING

from robot_runner.errors import PluginError

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["Series"]


@dataclass(frozen=True, slots=True)
class Series:
    """Samples of one quantity, oldest first; any sequences do, such as lists or `array("d")`.

    Attributes:
        times: when each sample was taken, s; never falling.
        values: one value for each time.

    Raises:
        PluginError: there are more times than values or the reverse, or the times fall.

    Example:
        >>> len(Series([0.0, 0.1, 0.2], [7.5, 7.6, 7.4]))
        3
    """

    times: Sequence[float]
    values: Sequence[float]

    def __post_init__(self) -> None:
        if len(self.times) != len(self.values):
            raise PluginError(
                f"there are {len(self.times)} times and {len(self.values)} values",
                where="Series",
                fix="Give one time for each value.",
            )
        if not all(map(le, self.times, islice(self.times, 1, None))):
            raise PluginError(
                "the times of the samples are not in order", where="Series", fix="Sort the samples by time."
            )

    def __len__(self) -> int:
        return len(self.times)
