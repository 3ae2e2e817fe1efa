"""What statistics yield: plain data that carry the numbers, the reasons, and what could not be computed and why.

A value that could not be computed is None, and a `NotComputed` beside it says why. No p-value is given that does not
hold. Names of treatments are the texts of the run table. What the parts are made of can be imported from here, too.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from robot_runner.analysis.statistics.tested import (
    AssumptionCheck,
    Comparison,
    Correlation,
    Drift,
    Effect,
    EffectSize,
    Magnitude,
    MeasureTest,
    PostHoc,
    Power,
    QuantilePairs,
    RepetitionsNeeded,
    TestMethod,
)

if TYPE_CHECKING:
    from collections.abc import Mapping

    from robot_runner.core.design.analysis_plan import Correction, Hypothesis

__all__ = [
    "AssumptionCheck",
    "Comparison",
    "Correlation",
    "Description",
    "DesignSummary",
    "Drift",
    "Effect",
    "EffectSize",
    "ExperimentStatistics",
    "HypothesisOutcome",
    "Interval",
    "Magnitude",
    "MeasureStatistics",
    "MeasureTest",
    "NotComputed",
    "Outlier",
    "PostHoc",
    "Power",
    "QuantilePairs",
    "RepetitionsNeeded",
    "TestMethod",
]


# What describes values: plain data. A value that could not be computed is None, and a `NotComputed` says why.


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


@dataclass(frozen=True, slots=True)
class MeasureStatistics:
    """Everything about one measure.

    Attributes:
        name: its column.
        origin: `measured`, `simulated`, `estimated`, or None where it is not known.
        is_planned: whether the analysis of it was fixed before the experiment; exploratory otherwise.
        overall: all runs together; None where it is not a number.
        by_treatment: one a treatment of each factor, factors in their order.
        by_combination: one a combination, where there are two and more factors.
        assumptions: what the choice of the test rests on first (residuals), then each group.
        post_hoc: empty where no effect has more than two treatments.
        not_computed: what could not be computed and why.
    """

    name: str
    unit: str
    origin: str | None
    is_planned: bool
    overall: Description | None = None
    by_treatment: tuple[Description, ...] = ()
    by_combination: tuple[Description, ...] = ()
    assumptions: tuple[AssumptionCheck, ...] = ()
    quantiles: QuantilePairs | None = None
    test: MeasureTest | None = None
    post_hoc: tuple[PostHoc, ...] = ()
    drift: Drift | None = None
    power: Power | None = None
    not_computed: tuple[NotComputed, ...] = ()


@dataclass(frozen=True, slots=True)
class DesignSummary:
    """The design as statistics saw it.

    Attributes:
        factors: those with two and more treatments among the runs that are done.
        constant_factors: those with one.
        block: the column of the blocks, or None.
        used: how many runs were used: those that are done.
        left_out: how many runs of the table were not, because they failed or are still to do.
        smallest_group, largest_group: runs a combination.
        sentence: all this in one sentence.
    """

    factors: tuple[str, ...]
    constant_factors: tuple[str, ...]
    block: str | None
    used: int
    left_out: int
    combinations: int
    empty_combinations: int
    smallest_group: int
    largest_group: int
    sentence: str

    @property
    def is_balanced(self) -> bool:
        """Whether each combination has the same number of runs."""
        return self.smallest_group == self.largest_group and not self.empty_combinations


@dataclass(frozen=True, slots=True)
class HypothesisOutcome:
    """What came of a hypothesis that was fixed before the experiment.

    Attributes:
        p_value: of the effect that it is about; None where it could not be tested.
        adjusted_p_value: after correction for the number of hypotheses.
        is_supported: whether the data speak for it at alpha; None where it could not be tested.
        conclusion: one sentence.
    """

    hypothesis: Hypothesis
    p_value: float | None
    adjusted_p_value: float | None
    is_supported: bool | None
    conclusion: str


@dataclass(frozen=True, slots=True)
class ExperimentStatistics:
    """The statistics of an experiment.

    Attributes:
        alpha: the level of significance.
        correction: how p-values of many comparisons were adjusted.
        is_planned: whether measures, alpha and hypotheses were fixed before the experiment.
        measures: one each, planned ones first.
        warnings: threats to validity that the statistics themselves noticed: drift, imbalance, runs left out.
    """

    alpha: float
    correction: Correction
    is_planned: bool
    design: DesignSummary
    measures: tuple[MeasureStatistics, ...]
    correlations: tuple[Correlation, ...]
    hypotheses: tuple[HypothesisOutcome, ...]
    warnings: tuple[str, ...]
    not_computed: tuple[NotComputed, ...] = field(default=())

    def measure(self, name: str) -> MeasureStatistics:
        """Return the statistics of one measure.

        Raises:
            KeyError: there is none of that name.
        """
        return {each.name: each for each in self.measures}[name]
