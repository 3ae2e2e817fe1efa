"""What tests yield: plain data that carry the numbers and the reasons. No p-value is given that does not hold."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

    from robot_runner.analysis.statistics.outcome import Interval
    from robot_runner.core.design.analysis_plan import Correction

__all__ = [
    "AssumptionCheck",
    "Comparison",
    "Correlation",
    "Drift",
    "Effect",
    "EffectSize",
    "Magnitude",
    "MeasureTest",
    "PostHoc",
    "Power",
    "QuantilePairs",
    "RepetitionsNeeded",
    "TestMethod",
]


class Magnitude(Enum):
    """How much an effect is, in a word."""

    NEGLIGIBLE = "negligible"
    SMALL = "small"
    MEDIUM = "medium"
    LARGE = "large"


class TestMethod(Enum):
    """A test, by the name under which a paper names it."""

    __test__ = False  # no tests for pytest

    STUDENT_T = "Student's t-test"
    WELCH_T = "Welch's t-test"
    MANN_WHITNEY = "Mann-Whitney U test"
    PAIRED_T = "paired t-test"
    WILCOXON = "Wilcoxon signed-rank test"
    ANOVA = "one-way ANOVA"
    WELCH_ANOVA = "Welch's ANOVA"
    KRUSKAL_WALLIS = "Kruskal-Wallis test"
    FACTORIAL_ANOVA = "factorial ANOVA"
    ROBUST_ANOVA = "factorial ANOVA with heteroscedasticity-consistent covariance (HC3)"
    ALIGNED_RANKS = "aligned-rank-transform ANOVA"
    BLOCKED_ANOVA = "ANOVA with blocks"
    FRIEDMAN = "Friedman test"
    MIXED_MODEL = "linear mixed model"
    MIXED_ALIGNED_RANKS = "aligned-rank-transform mixed model"


@dataclass(frozen=True, slots=True)
class EffectSize:
    """How much an effect is.

    Attributes:
        name: as in `Cohen's d`, `Cliff's delta`, `Vargha-Delaney A12`, `partial eta squared`.
        interval: its confidence interval, where one can be computed.
        magnitude: its name, by the thresholds of `source`.
        source: where the thresholds come from.
    """

    name: str
    value: float
    interval: Interval | None
    magnitude: Magnitude
    source: str


@dataclass(frozen=True, slots=True)
class AssumptionCheck:
    """Whether a test's assumption holds.

    Attributes:
        name: `Shapiro-Wilk` or `Levene`.
        treatments: the group that was looked at; empty for all groups together (residuals).
        holds: whether it is not refuted at alpha; None where it could not be computed.
        conclusion: one sentence.
    """

    name: str
    treatments: Mapping[str, str]
    statistic: float | None
    p_value: float | None
    holds: bool | None
    conclusion: str


@dataclass(frozen=True, slots=True)
class QuantilePairs:
    """The points of a normal Q-Q figure of the residuals (value less the mean of its combination), in ascending order.

    Attributes:
        theoretical: quantiles of the standard normal distribution.
        observed: the residuals, in the measure's unit.
        run_ids: the run of each point.
        slope, intercept: the reference line, through the quartiles.
    """

    theoretical: tuple[float, ...]
    observed: tuple[float, ...]
    run_ids: tuple[str, ...]
    slope: float
    intercept: float


@dataclass(frozen=True, slots=True)
class Effect:
    """One line of a table of tests: the effect of a factor, or of several together (their interaction).

    Attributes:
        factors: one name, or several for an interaction.
        statistic_name: as in `t`, `U`, `F`, `H`, `chi2`, `W`, `z`.
        degrees_of_freedom: none, one or two.
        p_value: None where it could not be computed.
        is_significant: whether the p-value is below alpha; None where there is none.
        effect_sizes: how much it is.
        conclusion: one plain sentence.
    """

    factors: tuple[str, ...]
    statistic_name: str
    statistic: float | None
    degrees_of_freedom: tuple[float, ...]
    p_value: float | None
    is_significant: bool | None
    effect_sizes: tuple[EffectSize, ...]
    conclusion: str

    @property
    def label(self) -> str:
        """The effect in words, as in `Task` or `Task x Speed`."""
        return " x ".join(self.factors)


@dataclass(frozen=True, slots=True)
class MeasureTest:
    """The test of a measure that fits the design.

    Attributes:
        method: the test.
        reason: why this one, in a sentence.
        effects: its results, main effects first.
        library: what computed it, with its version.
        notes: what else the reader has to know, such as that an interaction could not be estimated.
    """

    method: TestMethod
    reason: str
    effects: tuple[Effect, ...]
    library: str
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Comparison:
    """Two groups compared, among all pairs.

    Attributes:
        first, second: the treatments, as texts.
        difference: the mean of the first less that of the second (medians where the test is of ranks).
        interval: confidence interval of the difference, not adjusted for the number of comparisons.
        p_value: before adjustment.
        adjusted_p_value: after it.
    """

    first: str
    second: str
    difference: float
    interval: Interval | None
    statistic_name: str
    statistic: float | None
    p_value: float | None
    adjusted_p_value: float | None
    is_significant: bool | None
    effect_sizes: tuple[EffectSize, ...]


@dataclass(frozen=True, slots=True)
class PostHoc:
    """All pairs of the treatments of one factor (or of combinations of several).

    Attributes:
        factors: whose treatments are compared; several where combinations are.
        method: the test of each pair, in words.
        correction: how p-values were adjusted.
        is_of_means: whether differences are of means; of medians otherwise.
    """

    factors: tuple[str, ...]
    method: str
    correction: Correction
    is_of_means: bool
    comparisons: tuple[Comparison, ...]


@dataclass(frozen=True, slots=True)
class Drift:
    """Whether a measure drifts over the order of execution: is the battery or the room confounding?

    Residuals (value less the mean of its combination) are compared with the place in the order of execution.

    Attributes:
        places: the place of each run in the order of execution, from 1; `residuals` and `run_ids` belong to it.
        correlation: Spearman's rho.
        slope: Theil-Sen slope, in the measure's unit a run.
        is_significant: whether the drift is not explained by chance at alpha.
        is_confounded: whether treatments are also unevenly spread over the order, so that drift may pass for an effect.
        warning: one sentence for the reader; empty where nothing was found.
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


@dataclass(frozen=True, slots=True)
class RepetitionsNeeded:
    """How many runs a group needs so that an effect is found with the given power."""

    effect_size: float
    magnitude: str
    repetitions: int


@dataclass(frozen=True, slots=True)
class Power:
    """What the number of runs suffices for.

    Attributes:
        effect_name: `Cohen's d` or `Cohen's f`.
        observed_effect: as estimated from the data.
        achieved_power: the power for an effect as large as the observed one, 0..1.
        target_power: the power that the other figures are for.
        detectable_effect: the smallest effect that would be found with the target power; None if there is none.
        needed: runs a group for a small, a medium, a large and the observed effect.
        note: how to read it.
    """

    effect_name: str
    observed_effect: float
    achieved_power: float
    alpha: float
    target_power: float
    detectable_effect: float | None
    needed: tuple[RepetitionsNeeded, ...]
    note: str


@dataclass(frozen=True, slots=True)
class Correlation:
    """How two measures go together.

    Attributes:
        n: runs that have both.
        pearson, spearman: over all runs.
        within: Pearson's r of the residuals: what is left once the treatments' own effect is taken away.
        p_value: of Spearman's rho; `adjusted_p_value` after correction for the number of pairs.
    """

    first: str
    second: str
    n: int
    pearson: float
    pearson_interval: Interval | None
    spearman: float
    p_value: float
    adjusted_p_value: float
    within: float | None
    magnitude: Magnitude
