"""What tests yield: plain data that carry the numbers and the reasons. No p-value is given that does not hold."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

    from robot_runner.core.design.analysis_plan import Correction

__all__ = [
    "AssumptionCheck",
    "Comparison",
    "Effect",
    "EffectSize",
    "Interval",
    "Magnitude",
    "MeasureTest",
    "NotComputed",
    "PostHoc",
    "QuantilePairs",
    "TestMethod",
]


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
