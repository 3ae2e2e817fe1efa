"""What describes values: plain data. A value that could not be computed is None, and a `NotComputed` says why."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["Description", "Interval", "NotComputed", "Outlier"]


@dataclass(frozen=True, slots=True)
class NotComputed:
    """Something that could not be computed.

    Attributes:
        what: as in `Shapiro-Wilk test of Task=Video`.
        why: one sentence.
    """

    what: str
    why: str


@dataclass(frozen=True, slots=True)
class Interval:
    """A confidence interval.

    Attributes:
        low, high: its ends.
        level: the confidence, 0.95 for 95 %.
        method: how it was computed, as in `bootstrap (BCa)`.
    """

    low: float
    high: float
    level: float
    method: str


@dataclass(frozen=True, slots=True)
class Outlier:
    """A run whose value lies far from those of its group.

    Attributes:
        is_extreme: further than 3 interquartile ranges beyond the quartiles; others are further than 1.5 (Tukey's
            fences).
    """

    run_id: str
    value: float
    is_extreme: bool


@dataclass(frozen=True, slots=True)
class Description:
    """Descriptive statistics of one measure over the runs of one group.

    Attributes:
        treatments: which group, by factor; empty for all runs together.
        n: how many runs have a value.
        missing: how many runs are done and have none.
        sd: standard deviation with n - 1; None for fewer than two values.
        mean_interval: confidence interval of the mean.
    """

    treatments: Mapping[str, str]
    n: int
    missing: int
    mean: float | None
    sd: float | None
    median: float | None
    first_quartile: float | None
    third_quartile: float | None
    minimum: float | None
    maximum: float | None
    mean_interval: Interval | None
    outliers: tuple[Outlier, ...] = ()

    @property
    def interquartile_range(self) -> float | None:
        """The third quartile less the first."""
        if self.first_quartile is None or self.third_quartile is None:
            return None
        return self.third_quartile - self.first_quartile

    @property
    def label(self) -> str:
        """The group in words: its treatments, with ` / ` between; `all runs` for all of them."""
        return " / ".join(self.treatments.values()) or "all runs"
