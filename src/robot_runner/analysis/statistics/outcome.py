"""What statistics yield: plain data that carry the numbers, the reasons, and what could not be computed and why.

A value that could not be computed is None, and a `NotComputed` beside it says why. No p-value is given that does not
hold. Names of treatments are the texts of the run table. What the parts are made of can be imported from here, too.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from robot_runner.analysis.statistics.described import Description, Interval, NotComputed, Outlier
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
    from robot_runner.design.analysis_plan import Correction, Hypothesis

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
