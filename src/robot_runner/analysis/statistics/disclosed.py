"""Plain data on what an analysis plan changes in a result: values left out, covariates, adjusted means."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

from robot_runner.core.words import combination_label

if TYPE_CHECKING:
    from robot_runner.analysis.statistics.tested import Interval


class Reason(Enum):
    """The reason why the value of a run that is done is not analysed."""

    OUTLIER = "outlier"
    DOUBTFUL = "doubtful"
    COVARIATE = "covariate missing"
    DISPLACED = "out of its place"


class Beside(Enum):
    """Sensitivity analyses besides the planned analysis, each with one choice changed."""

    WITHOUT_DOUBTFUL = "without doubtful values"
    ALL_RUNS = "with all runs"
    WITHOUT_COVARIATES = "without covariates"


@dataclass(frozen=True, slots=True)
class LeftOut:
    """A value that the planned analysis of its measure leaves out; the run table still has it.

    Attributes:
        why: the reason in words, by the rule of the plan.
    """

    run_id: str
    value: float
    reason: Reason
    why: str


def runs_without_value(left_out: Iterable[LeftOut]) -> frozenset[str]:
    """Return the runs whose value of a measure is used nowhere; those that only lack a covariate are not among them."""
    return frozenset(each.run_id for each in left_out if each.reason is not Reason.COVARIATE)


@dataclass(frozen=True, slots=True)
class Slope:
    """The slope of a measure over a covariate, adjusted for treatments, blocks and other covariates.

    Attributes:
        covariate: a measure, `order` or `elapsed`.
        unit: of the slope, as in `J per V`.
        value: the slope; None if the covariate is the same in all runs (or within all blocks).
        interval: at 1 - alpha.
        p_value: of a slope of 0; below alpha if the interval excludes 0.
        centre: the mean of the covariate, to which means are adjusted.
        inflation: the variance inflation factor of the slope, due to treatments, blocks and other covariates.
        treatments_p_value: of the test that the covariate does not differ between treatments, adjusted for the number
            of effects; None where it cannot be tested.
    """

    covariate: str
    unit: str
    value: float | None
    interval: Interval | None
    statistic: float | None
    degrees_of_freedom: float | None
    p_value: float | None
    centre: float | None
    inflation: float | None
    treatments_p_value: float | None


@dataclass(frozen=True, slots=True)
class AdjustedMean:
    """The adjusted mean of a treatment, at the mean of the covariates; combinations have equal weights.

    Attributes:
        mean: without adjustment.
        interval: of the adjusted mean, at 1 - alpha; None with blocks, where only differences have one.
    """

    treatments: Mapping[str, str]
    mean: float | None
    adjusted: float
    interval: Interval | None

    @property
    def label(self) -> str:
        """The treatment in words."""
        return combination_label(self.treatments.values())


@dataclass(frozen=True, slots=True)
class Adjustment:
    """How the comparison of a measure was adjusted for covariates.

    Attributes:
        slopes: one for each covariate of the plan.
        means: one for each treatment of each factor.
        slopes_p_value: of the test that slopes are the same for all treatments; nothing depends on it. None if it
            cannot be computed.
        spread: the standard deviation within combinations, without covariates.
        residual_spread: the same, with covariates.
    """

    slopes: tuple[Slope, ...]
    means: tuple[AdjustedMean, ...]
    slopes_p_value: float | None
    spread: float
    residual_spread: float
    warnings: tuple[str, ...]
