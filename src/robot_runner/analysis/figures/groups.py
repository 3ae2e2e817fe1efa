"""Values of a measure, group by group."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["Group"]


@dataclass(frozen=True, slots=True)
class Group:
    """The values of the runs that had one treatment.

    Attributes:
        label: the treatment, or several with ` / ` between.
        values: one a run; none is missing.
        run_ids: the run of each value.
        mean_low, mean_high: confidence interval of the mean, where one was computed.

    Example:
        >>> Group("Video", (866.9, 877.5), ("r_3", "r_5")).label
        'Video'
    """

    label: str
    values: Sequence[float]
    run_ids: Sequence[str]
    mean_low: float | None = None
    mean_high: float | None = None

    @property
    def size(self) -> int:
        """How many runs there are."""
        return len(self.values)

    @property
    def mean(self) -> float:
        """The mean; there must be a run."""
        return sum(self.values) / len(self.values)
