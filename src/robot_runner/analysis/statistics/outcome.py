"""The statistics of an experiment and of each measure, as plain data.

A value that could not be computed is None, and a `NotComputed` beside it says why. Names of treatments are the texts of
the run table.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from robot_runner.analysis.statistics.disclosed import Adjustment, Beside, LeftOut
from robot_runner.core.words import combination_label

if TYPE_CHECKING:
    from robot_runner.analysis.statistics.surface_model import Surface
    from robot_runner.analysis.statistics.tested import (
        AssumptionCheck,
        ContrastTest,
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
    """A run whose value lies far from those of its group.

    Attributes:
        is_extreme: further than 3 interquartile ranges beyond the quartiles; others are further than 1.5 (Tukey's
            fences).
    """

    run_id: str
    value: float
    is_extreme: bool


@dataclass(frozen=True, slots=True)
class GroupOfRuns:
    """The runs of one group, which something is said of.

    Attributes:
        treatments: which group, by factor; empty for all runs together.
        n: how many runs have a value.
        missing: how many runs are done and have none.
    """

    treatments: Mapping[str, str]
    n: int
    missing: int

    @property
    def label(self) -> str:
        """The group in words: its treatments, with ` / ` between; `all runs` for all of them."""
        return combination_label(self.treatments.values()) or "all runs"


@dataclass(frozen=True, slots=True)
class Description(GroupOfRuns):
    """Descriptive statistics of one measure over the runs of one group.

    Attributes:
        sd: standard deviation with n - 1; None for fewer than two values.
        mean_interval: confidence interval of the mean.
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
        """The third quartile less the first."""
        if self.first_quartile is None or self.third_quartile is None:
            return None
        return self.third_quartile - self.first_quartile


@dataclass(frozen=True, slots=True)
class Proportion(GroupOfRuns):
    """How often a measure that is yes or no is yes, over the runs of one group.

    Attributes:
        count: how many say yes.
        percent: of the runs that have a value; None where none has.
        interval: its confidence interval, percent.
    """

    count: int
    percent: float | None
    interval: Interval | None


@dataclass(frozen=True, slots=True)
class Proportions:
    """The proportions of a measure that is yes or no.

    Attributes:
        overall: all runs together.
        by_treatment: one a treatment of each factor, factors in their order.
        by_combination: one a combination, where there are two and more factors.
    """

    overall: Proportion
    by_treatment: tuple[Proportion, ...]
    by_combination: tuple[Proportion, ...]


@dataclass(frozen=True, slots=True)
class Drift:
    """Whether a measure drifts over the order of execution: is the battery or the room confounding?

    Residuals (value less what the model of the design tells) are compared with the place in the order of execution;
    where the model takes out blocks, within these.

    Attributes:
        places: the place of each run in the order of execution, from 1; `residuals` and `run_ids` belong to it.
            Within blocks it is what the model leaves of that, rounded, and the least is 1.
        correlation: Spearman's rho.
        slope: Theil-Sen slope, in the measure's unit a run.
        is_significant: whether the drift is not explained by chance at alpha.
        is_confounded: whether treatments are also unevenly spread over the order, so that drift may pass for an effect.
        warning: one sentence for the reader; empty where nothing was found.
        within: the columns of the blocks that places are counted within.
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
    """How many runs a group needs so that an effect is found with the given power."""

    effect_size: float
    magnitude: str
    repetitions: int


@dataclass(frozen=True, slots=True)
class Power:
    """What the number of runs suffices for.

    The power for the observed effect is not among it: it says no more than the p-value does (Hoenig and Heisey, The
    abuse of power, 2001).

    Attributes:
        effect_name: `Cohen's d` or `Cohen's f`.
        target_power: the power that the figures are for.
        detectable_effect: the smallest effect that would be found with the target power; None if there is none.
        needed: runs a group for a small, a medium and a large effect; or blocks, where `counted` says so.
        note: how to read it.
        counted: what `needed` counts: `runs of a group`, `blocks of a group` or `blocks`.
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
    """How two measures go together.

    Attributes:
        n: runs that have both.
        pearson, spearman: over all runs.
        within: Pearson's r of the residuals: what is left once the treatments' own effect is taken away.
        p_value: of Spearman's rho; `adjusted_p_value` after correction for the number of pairs. None, as the interval
            is, where several runs are of one unit, such as a block, and vary together.
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
    """Everything about one measure.

    Attributes:
        name: its column.
        origin: `measured`, `simulated`, `estimated`, or None where it is not known.
        is_planned: whether the analysis of it was fixed before the experiment; exploratory otherwise.
        is_primary: whether it is one of those that the plan is about.
        overall: all runs together; None where it is not a number.
        by_treatment: one a treatment of each factor, factors in their order.
        by_combination: one a combination, where there are two and more factors.
        assumptions: how residuals are distributed, whether spreads differ, then each group; they decide nothing.
        post_hoc: pairs of treatments of each factor; of combinations where factors interact.
        contrasts: of the hypotheses that name one.
        not_computed: what could not be computed and why.
        left_out: the values that are left out; everything here is of the others, but descriptions and Levene's test
            have those that lack a covariate alone, which are measured as well as any.
        rule_false_positives: how often two combinations of so many runs (the smallest and the largest) differ at 5 % by
            chance alone where outliers are left out by the plan's rule, by simulation, percent; None where none was.
        adjustment: how the tests were adjusted for covariates; descriptions are of values as measured.
        surface: how it depends on factors that are numbers, where the design is one of a response surface.
        proportions: how often it is yes, where it is yes or no; the unit of it and of differences is percent then.
        kept_together: the blocks and batches whose effects residuals are without.
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
        kind: of the design, as the manifest names it.
        within: the factors that apply to some runs only, each with which: as in `Sensor=camera`.
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
        """Whether each combination has the same number of runs, of those that the design chose."""
        return self.smallest_group == self.largest_group and not self.lacking_combinations

    @property
    def lacking_combinations(self) -> int:
        """How many combinations have no run though the design is to have them all."""
        return self.empty_combinations if self.kind == "full_factorial" else 0


@dataclass(frozen=True, slots=True)
class HypothesisOutcome:
    """The outcome of a hypothesis that was fixed before the experiment.

    Attributes:
        p_value: of the effect that it is about; None where it could not be tested.
        adjusted_p_value: after correction for the family of tests.
        is_supported: whether the data speak for it at alpha; None where it could not be tested.
        conclusion: one sentence.
    """

    hypothesis: Hypothesis
    p_value: float | None
    adjusted_p_value: float | None
    is_supported: bool | None
    conclusion: str


@dataclass(frozen=True, slots=True)
class Standing:
    """Whether a conclusion stands when one choice is made otherwise, as when doubtful values are left out.

    Attributes:
        factors: of the effect that it is about.
        statement: the hypothesis that it is about; empty for an effect by itself.
        left_out: the runs that were left out, then or in the planned analysis.
        p_value: of the planned analysis; adjusted where it is about a hypothesis.
        p_value_without: of the other one; None where it could not be computed.
        stands: None where that could not be told.
        conclusion: one sentence.
        beside: which other analysis it is.
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
        """What it is about, in words: the hypothesis, or the effect as in `Task x Speed`."""
        return self.statement or " x ".join(self.factors)


@dataclass(frozen=True, slots=True)
class ExperimentStatistics:
    """The statistics of an experiment.

    Attributes:
        alpha: the level of significance.
        correction: how p-values of many comparisons were adjusted.
        is_planned: whether measures, alpha and hypotheses were fixed before the experiment.
        measures: one each, planned ones first.
        warnings: threats to validity that the statistics themselves noticed: drift, imbalance, runs left out.
        without_doubtful: the measures that have doubtful values, once more without these.
        standings: whether conclusions about measures that were computed once more stand.
        with_all_runs: the measures of which the plan leaves out values, once more with these.
        without_covariates: the measures that are adjusted for covariates, once more without.
        plan: what was followed: what was fixed before the experiment, or given for this analysis; None for neither.
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

    def beside(self, which: Beside) -> tuple[MeasureStatistics, ...]:
        """Return the measures that were computed once more, with one choice made otherwise."""
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
