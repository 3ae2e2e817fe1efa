"""The statistics of an experiment and of each measure, as plain data.

A value that could not be computed is None, and a `NotComputed` says why. Treatments are the texts of the run table.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from robot_runner.analysis.statistics.disclosed import Adjustment, Beside, LeftOut
from robot_runner.core.words import combination_label, listed

if TYPE_CHECKING:
    from robot_runner.analysis.statistics.surface_model import Surface
    from robot_runner.analysis.statistics.tested import (
        AssumptionCheck,
        ContrastTest,
        Effect,
        Interval,
        Magnitude,
        MeasureTest,
        NotComputed,
        PostHoc,
        QuantilePairs,
    )
    from robot_runner.core.design.analysis_plan import AnalysisPlan, Correction
    from robot_runner.core.design.hypothesis import Hypothesis


@dataclass(frozen=True, slots=True)
class Outlier:
    """A run whose value is an outlier of its group, by Tukey's fences.

    Attributes:
        is_extreme: whether it is more than 3 interquartile ranges beyond the quartiles; all outliers are more than 1.5
            beyond.
    """

    run_id: str
    value: float
    is_extreme: bool


@dataclass(frozen=True, slots=True)
class GroupOfRuns:
    """A group of runs.

    Attributes:
        treatments: of the group, by factor; empty for all runs together.
        n: the number of runs with a value.
        missing: the number of runs that are done without a value.
    """

    treatments: Mapping[str, str]
    n: int
    missing: int

    @property
    def label(self) -> str:
        """The group in words: its treatments, separated by ` / `, or `all runs`."""
        return combination_label(self.treatments.values()) or "all runs"


@dataclass(frozen=True, slots=True)
class Description(GroupOfRuns):
    """Descriptive statistics of one measure over the runs of one group.

    Attributes:
        sd: standard deviation with n - 1; None for fewer than two values.
        mean_interval: confidence interval of the mean; None if it cannot be computed.
    """

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
        """The third quartile minus the first."""
        if self.first_quartile is None or self.third_quartile is None:
            return None
        return self.third_quartile - self.first_quartile


@dataclass(frozen=True, slots=True)
class Proportion(GroupOfRuns):
    """The proportion of yes of a yes-or-no measure, over the runs of one group.

    Attributes:
        count: the number of runs with yes.
        percent: of the runs with a value; None without such runs.
        interval: its confidence interval, percent.
    """

    count: int
    percent: float | None
    interval: Interval | None


@dataclass(frozen=True, slots=True)
class Proportions:
    """The proportions of a yes-or-no measure.

    Attributes:
        overall: of all runs.
        by_treatment: of each treatment of each factor, factors in their order.
        by_combination: of each combination; empty for a single factor.
    """

    overall: Proportion
    by_treatment: tuple[Proportion, ...]
    by_combination: tuple[Proportion, ...]


@dataclass(frozen=True, slots=True)
class Drift:
    """The drift of a measure over the order of execution, such as by the battery or the room.

    The residuals from the model of the design are correlated with those of the place in the order of execution: within
    treatments, and within blocks if the model has blocks.

    Attributes:
        places: the residual of each run's place from the model, rounded, from 1; of a single treatment, the place in
            the order of execution. `residuals` and `run_ids` have the same order.
        correlation: Spearman's rho.
        slope: Theil-Sen slope, in the measure's unit per run.
        is_confounded: whether treatments are unevenly spread over the order, so that drift may look like an effect.
        warning: a sentence for readers; without a significant drift, on runs in a row that are alike; or empty.
        within: the names of the blocks, or `treatments`, within which places are compared; empty for one treatment.
    """

    places: tuple[int, ...]
    residuals: tuple[float, ...]
    run_ids: tuple[str, ...]
    correlation: float
    p_value: float
    slope: float
    slope_interval: Interval
    is_significant: bool
    is_confounded: bool
    warning: str
    within: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class RepetitionsNeeded:
    """The number of runs of a group that detects an effect with the target power."""

    effect_size: float
    magnitude: str
    repetitions: int


@dataclass(frozen=True, slots=True)
class Power:
    """The effects that the numbers of runs can detect.

    The power for the observed effect is not included: it has no more information than the p-value (Hoenig and Heisey,
    The abuse of power, 2001).

    Attributes:
        effect_name: `Cohen's d` or `Cohen's f`.
        target_power: the power of all figures.
        detectable_effect: the smallest effect with the target power; None if there is none.
        needed: the runs per group, or the blocks (see `counted`), for a small, a medium and a large effect.
        counted: the unit of `needed`: `runs of a group`, `blocks of a group` or `blocks`.
    """

    effect_name: str
    alpha: float
    target_power: float
    detectable_effect: float | None
    needed: tuple[RepetitionsNeeded, ...]
    note: str
    counted: str = "runs of a group"


@dataclass(frozen=True, slots=True)
class Correlation:
    """The correlation of two measures.

    Attributes:
        n: the number of runs with both measures.
        pearson, spearman: over all runs.
        within: Pearson's r of the residuals, without the effects of treatments.
        p_value: of Spearman's rho; `adjusted_p_value` is corrected for the number of pairs. Both, and the interval, are
            None if several runs share an experimental unit, such as a block.
    """

    first: str
    second: str
    n: int
    pearson: float
    pearson_interval: Interval | None
    spearman: float
    p_value: float | None
    adjusted_p_value: float | None
    within: float | None
    magnitude: Magnitude


@dataclass(frozen=True, slots=True)
class MeasureStatistics:
    """The statistics of one measure.

    Attributes:
        origin: `measured`, `simulated`, `estimated`, or None if it is unknown.
        is_planned: whether its analysis was fixed before the experiment; else it is exploratory.
        overall: of all runs; None if it is not a number.
        by_treatment: of each treatment of each factor, factors in their order.
        by_combination: of each combination; empty for a single factor.
        assumptions: checks of the residuals' normality, of equal variances, then of each group's normality; nothing
            depends on them.
        post_hoc: pairs of treatments of each factor; of combinations if factors interact.
        contrasts: of the hypotheses with a contrast or a bound.
        left_out: the values that are left out of everything here, except that descriptions and Levene's test include
            those that only lack a covariate.
        rule_false_positives: the simulated false positives at 5 % due to the plan's outlier rule, in percent, for two
            combinations of the smallest and the largest size; None if no outlier was left out.
        adjustment: how the tests were adjusted for covariates; descriptions are of unadjusted values.
        surface: its response surface over numeric factors; None for other designs.
        proportions: of a yes-or-no measure, whose unit is then percent; None for others.
        kept_together: the blocks and batches whose means are subtracted from residuals.
    """

    name: str
    unit: str
    origin: str | None
    is_planned: bool
    is_primary: bool = False
    overall: Description | None = None
    by_treatment: tuple[Description, ...] = ()
    by_combination: tuple[Description, ...] = ()
    assumptions: tuple[AssumptionCheck, ...] = ()
    quantiles: QuantilePairs | None = None
    test: MeasureTest | None = None
    post_hoc: tuple[PostHoc, ...] = ()
    contrasts: tuple[ContrastTest, ...] = ()
    drift: Drift | None = None
    power: Power | None = None
    not_computed: tuple[NotComputed, ...] = ()
    left_out: tuple[LeftOut, ...] = ()
    rule_false_positives: float | None = None
    adjustment: Adjustment | None = None
    surface: Surface | None = None
    proportions: Proportions | None = None
    kept_together: tuple[str, ...] = ()

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The tested effects; none without a test."""
        return () if self.test is None else self.test.effects


@dataclass(frozen=True, slots=True)
class DesignSummary:
    """A summary of the design.

    Attributes:
        factors: those with two or more treatments among the runs that are done.
        constant_factors: those with one treatment.
        used: the number of used runs: those that are done.
        left_out: the number of runs of the table that failed or are still to do.
        smallest_group, largest_group: the fewest and the most runs of a combination.
        kind: of the design, its name in the manifest.
        within: the conditional factors, each with its condition, as in `Sensor=camera`.
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
    kind: str = "full_factorial"
    within: Mapping[str, str] = field(default_factory=dict)

    @property
    def is_balanced(self) -> bool:
        """Whether all combinations of the design have the same number of runs."""
        return self.smallest_group == self.largest_group and not self.lacking_combinations

    @property
    def lacking_combinations(self) -> int:
        """The number of combinations without a run in a full factorial; 0 for other designs."""
        return self.empty_combinations if self.kind == "full_factorial" else 0


@dataclass(frozen=True, slots=True)
class HypothesisOutcome:
    """The outcome of a hypothesis that was fixed before the experiment.

    Attributes:
        p_value: of its effect or contrast; None if it could not be tested.
        adjusted_p_value: after correction for the family of tests.
        is_supported: whether it is significant at alpha; None if it could not be tested.
    """

    hypothesis: Hypothesis
    p_value: float | None
    adjusted_p_value: float | None
    is_supported: bool | None
    conclusion: str


@dataclass(frozen=True, slots=True)
class Standing:
    """Whether a conclusion stands in a sensitivity analysis, such as without doubtful values.

    Attributes:
        statement: of the hypothesis; empty for an effect.
        left_out: the runs that are left out, in the sensitivity analysis or in the planned one.
        p_value: of the planned analysis; adjusted for a hypothesis.
        p_value_without: of the sensitivity analysis; None if it could not be computed.
        stands: None if this is unknown.
    """

    measure: str
    factors: tuple[str, ...]
    statement: str
    left_out: tuple[str, ...]
    p_value: float | None
    p_value_without: float | None
    stands: bool | None
    conclusion: str
    beside: Beside = Beside.WITHOUT_DOUBTFUL

    @property
    def label(self) -> str:
        """The hypothesis, or the effect as in `Task x Speed`."""
        return self.statement or " x ".join(self.factors)


@dataclass(frozen=True, slots=True)
class ExperimentStatistics:
    """The statistics of an experiment.

    Attributes:
        is_planned: whether measures, alpha and hypotheses were fixed before the experiment.
        measures: the statistics of each measure, planned ones first.
        warnings: threats to validity: drift, imbalance, runs left out.
        without_doubtful: the measures with doubtful values, analysed without these.
        standings: whether conclusions stand in the sensitivity analyses.
        with_all_runs: the measures with values that the plan leaves out, analysed with these.
        without_covariates: the measures that are adjusted for covariates, analysed without these.
        plan: the plan that was followed: fixed before the experiment, or given to this analysis; None without one.
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
    without_doubtful: tuple[MeasureStatistics, ...] = ()
    standings: tuple[Standing, ...] = ()
    with_all_runs: tuple[MeasureStatistics, ...] = ()
    without_covariates: tuple[MeasureStatistics, ...] = ()
    plan: AnalysisPlan | None = None

    def __repr__(self) -> str:
        """Return what a notebook shows: all numbers would fill pages."""
        return f"<ExperimentStatistics of {listed(each.name for each in self.measures)}>"

    def beside(self, which: Beside) -> tuple[MeasureStatistics, ...]:
        """Return the measures of a sensitivity analysis."""
        return {
            Beside.WITHOUT_DOUBTFUL: self.without_doubtful,
            Beside.ALL_RUNS: self.with_all_runs,
            Beside.WITHOUT_COVARIATES: self.without_covariates,
        }[which]

    def measure(self, name: str) -> MeasureStatistics:
        """Return the statistics of one measure.

        Raises:
            KeyError: there is no measure of that name.
        """
        return {each.name: each for each in self.measures}[name]
