"""What a plan of analysis changes about a result, as plain data: values left out, covariates, adjusted means."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

from robot_runner.core.words import combination_label

if TYPE_CHECKING:
    from robot_runner.analysis.statistics.tested import Interval


class Reason(Enum):
    """Why the value of a run that is done is not analysed."""

    OUTLIER = "outlier"
    DOUBTFUL = "doubtful"
    COVARIATE = "covariate missing"
    DISPLACED = "out of its place"


class Beside(Enum):
    """What is computed once more beside the planned analysis, with one choice made otherwise."""

    WITHOUT_DOUBTFUL = "without doubtful values"
    ALL_RUNS = "with all runs"
    WITHOUT_COVARIATES = "without covariates"


@dataclass(frozen=True, slots=True)
class LeftOut:
    """A value that the planned analysis of its measure leaves out; the run table keeps it.

    Attributes:
        why: as the rule says, in words.
    """

    run_id: str
    value: float
    reason: Reason
    why: str


def runs_without_value(left_out: Iterable[LeftOut]) -> frozenset[str]:
    """Return the runs whose value of a measure counts nowhere: not those that lack a covariate alone."""
    return frozenset(each.run_id for each in left_out if each.reason is not Reason.COVARIATE)


@dataclass(frozen=True, slots=True)
class Slope:
    """By how much a measure changes with a covariate, beside treatments, blocks and other covariates.

    Attributes:
        covariate: a measure, `order` or `elapsed`.
        unit: of the slope, as in `J per V`.
        value: None where the covariate is the same in all runs (or within all blocks).
        interval: at 1 - alpha.
        p_value: of a slope of 0; below alpha where the interval leaves out 0.
        centre: the mean of the covariate, at which means are adjusted.
        inflation: how much treatments, blocks and other covariates inflate the variance of the slope.
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
    """The mean of a treatment at the mean of the covariates, beside that without; each combination counts the same.

    Attributes:
        interval: of the adjusted mean, at 1 - alpha; None within blocks, where only differences have one.
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
        slopes: one a covariate of the plan.
        means: one a treatment of each factor.
        slopes_p_value: of the test that slopes are the same for all treatments; it decides nothing. None where the runs
            do not tell.
        spread: the standard deviation within combinations; `residual_spread` of what covariates leave of it.
        warnings: what is doubtful about the covariates, in sentences.
    """

    slopes: tuple[Slope, ...]
    means: tuple[AdjustedMean, ...]
    slopes_p_value: float | None
    spread: float
    residual_spread: float
    warnings: tuple[str, ...]
