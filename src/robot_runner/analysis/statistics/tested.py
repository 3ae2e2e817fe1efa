"""The results of tests as plain data, with reasons. Invalid p-values are left out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Any, NamedTuple

from robot_runner.core.words import listed

if TYPE_CHECKING:
    from robot_runner.core.design.analysis_plan import Correction


def named_within(name: str, within: str) -> str:
    """Return an effect with the runs within which it is estimated.

    Example:
        >>> named_within("Resolution", "Sensor=camera")
        'Resolution within Sensor=camera'
    """
    return f"{name} within {within}" if within else name


@dataclass(frozen=True, slots=True)
class NotComputed:
    """A result that could not be computed.

    Attributes:
        what: the result, as in `Shapiro-Wilk test of Task=Video`.
        why: the reason, one sentence.
    """

    what: str
    why: str


@dataclass(frozen=True, slots=True)
class NoVariation(NotComputed):
    """A result that could not be computed because values do not vary, or by rounding alone."""


@dataclass(frozen=True, slots=True)
class Interval:
    """A confidence interval.

    Attributes:
        level: the confidence level, 0.95 for 95 %.
        method: as in `bootstrap (BCa)`.
    """

    low: float
    high: float
    level: float
    method: str


class Magnitude(Enum):
    """The magnitude of an effect, in a word."""

    NEGLIGIBLE = "negligible"
    SMALL = "small"
    MEDIUM = "medium"
    LARGE = "large"


class TestMethod(Enum):
    """A test, by its name in a paper."""

    __test__ = False  # no tests for pytest

    WELCH_T = "Welch's t-test"
    WELCH_ANOVA = "Welch's ANOVA"
    ANOVA_TYPE = "ANOVA-type test"
    WELCH_JAMES = "Welch-James tests of marginal means"
    COMBINED = "Welch-James and ANOVA-type tests combined"
    PAIRED_T = "paired t-test"
    BLOCKS = "tests of contrasts within blocks"
    LINEAR_MODEL = "linear model with one variance"
    MIXED_MODEL = "linear mixed model"
    COVARIANCE = "analysis of covariance"
    ADJUSTED_FOR_BLOCKS = "analysis of variance adjusted for blocks"
    CROSSOVER = "analysis of variance of a crossover"
    SPLIT_PLOT = "analysis of variance of a split-plot design"
    LENTH = "Lenth's method"
    SURFACE = "response surface"
    PROPORTIONS = "exact tests of proportions"


class EffectTest(NamedTuple):
    """The computed test of one effect.

    The numbers are arrays if several experiments were computed at once.

    Attributes:
        factors: one name, or several for an interaction.
        test: its name, as in `Welch's t`.
        statistic_name: `t` or `F`.
        freedom: degrees of freedom, one or two.
        variance: the mean of the squared effects on all combinations.
        parts: the tests whose p-values are combined: name, statistic, degrees of freedom and p-value of each.
    """

    factors: tuple[str, ...]
    test: str
    statistic_name: str
    statistic: Any
    freedom: tuple[Any, ...]
    p_value: Any
    variance: Any
    parts: tuple[tuple[str, Any, tuple[Any, Any], Any], ...] = ()


@dataclass(frozen=True, slots=True)
class EffectSize:
    """An effect size.

    Attributes:
        name: as in `Cohen's d`, `Cliff's delta`, `Vargha-Delaney A12`, `partial omega squared`.
        interval: its confidence interval; None if it cannot be computed.
        magnitude: by the thresholds of `source`.
    """

    name: str
    value: float
    interval: Interval | None
    magnitude: Magnitude
    source: str


@dataclass(frozen=True, slots=True)
class AssumptionCheck:
    """The check of a distribution assumption, as a description; no test is chosen by it.

    Attributes:
        name: `Shapiro-Wilk` or `Levene`.
        treatments: of the checked group; empty for all groups together (residuals).
        holds: whether the assumption is not rejected at alpha.
    """

    name: str
    treatments: Mapping[str, str]
    statistic: float
    p_value: float
    holds: bool
    conclusion: str


@dataclass(frozen=True, slots=True)
class QuantilePairs:
    """The points of a normal Q-Q plot of the residuals from the model, in ascending order.

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
class Check:
    """A robustness check: the test of the ranks of all values, or of the means if ranks are tested.

    Attributes:
        of: `ranks` or `means`.
        p_value: before adjustment; None if it could not be computed.
        agrees: whether it is on the same side of alpha as the main test; None if that is unknown.
    """

    of: str
    statistic_name: str
    statistic: float | None
    degrees_of_freedom: tuple[float, ...]
    p_value: float | None
    agrees: bool | None


@dataclass(frozen=True, slots=True)
class TestPart:
    """One of the tests whose p-values are combined for an effect.

    Attributes:
        name: `Welch-James` or `ANOVA-type`.
        statistic: F.
        degrees_of_freedom: two.
        p_value: of this test alone, from which nothing is concluded.
    """

    __test__ = False  # no tests for pytest

    name: str
    statistic: float
    degrees_of_freedom: tuple[float, ...]
    p_value: float


@dataclass(frozen=True, slots=True)
class Effect:
    """The test of an effect, of a factor or an interaction: a row of a table of tests.

    Attributes:
        factors: one name, or several for an interaction.
        test: its name, as in `Welch's t`.
        statistic_name: `t` or `F`.
        statistic: of the first part, if there are parts.
        degrees_of_freedom: one or two.
        p_value: before adjustment; None if it could not be computed.
        adjusted_p_value: after adjustment for its family of tests.
        is_significant: whether the adjusted p-value is below alpha; None without a p-value.
        parts: the tests whose p-values are combined; empty for a single test.
        aliases: the effects that are aliased with it, by their factors.
        within: the runs within which a conditional factor is tested, as in `Sensor=camera`; else empty.
    """

    factors: tuple[str, ...]
    test: str
    statistic_name: str
    statistic: float | None
    degrees_of_freedom: tuple[float, ...]
    p_value: float | None
    adjusted_p_value: float | None
    is_significant: bool | None
    effect_sizes: tuple[EffectSize, ...]
    check: Check | None
    conclusion: str
    parts: tuple[TestPart, ...] = ()
    aliases: tuple[tuple[str, ...], ...] = ()
    within: str = ""

    @property
    def label(self) -> str:
        """The effect in words, as in `Task` or `Task x Speed`, with its condition and aliases."""
        name = named_within(" x ".join(self.factors), self.within)
        return f"{name} (aliased with {listed([' x '.join(each) for each in self.aliases])})" if self.aliases else name


@dataclass(frozen=True, slots=True)
class TestFamily:
    """A family of tests, over which the error rate is controlled.

    Attributes:
        name: its tests, in words.
        size: their number, of all measures.
        tests: those of one measure, by their labels.
    """

    __test__ = False  # no tests for pytest

    name: str
    size: int
    tests: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class MeasureTest:
    """The test of a measure, which the design and the plan determine.

    Attributes:
        estimand: `mean`, `trimmed mean`, `rank`, or `proportion` for a yes-or-no measure.
        reason: a sentence on why this test is used.
        effects: its results, main effects first.
        family: the tests over which the error rate is controlled, in words; of several families, the first.
        spread: the standard deviation for Cohen's d; None if there is none.
        library: the library that computed it, with its version.
        notes: further notes for readers, such as that an interaction could not be estimated.
        families: all families that its tests belong to.
    """

    method: TestMethod
    estimand: str
    reason: str
    effects: tuple[Effect, ...]
    family: str
    family_size: int
    spread: float | None
    library: str
    notes: tuple[str, ...] = ()
    families: tuple[TestFamily, ...] = ()


@dataclass(frozen=True, slots=True)
class Comparison:
    """The comparison of a pair of groups.

    Attributes:
        first, second: the treatments, as texts.
        difference: the estimate of the first minus that of the second; combinations have equal weights.
        interval: confidence interval of the difference at 1 - alpha, not adjusted for the number of comparisons.
        p_value: before adjustment; below alpha if the interval excludes 0.
        adjusted_p_value: after adjustment for the number of pairs, and no smaller than that of the effect.
        is_significant: whether the adjusted p-value is below alpha.
        check_p_value: of the same comparison by ranks (by means, if ranks are compared).
    """

    first: str
    second: str
    difference: float
    interval: Interval | None
    statistic_name: str
    statistic: float | None
    degrees_of_freedom: float | None
    p_value: float | None
    adjusted_p_value: float | None
    is_significant: bool | None
    check_p_value: float | None
    effect_sizes: tuple[EffectSize, ...]


@dataclass(frozen=True, slots=True)
class PostHoc:
    """All pairs of the treatments of one factor (or of combinations of several).

    Attributes:
        factors: the factor, or several if combinations are compared.
        method: the test of each pair, in words.
        quantity: the compared quantity, such as `means`, `trimmed means`, `relative ranks` or proportions.
        within: the runs within which a conditional factor is compared; else empty.
    """

    factors: tuple[str, ...]
    method: str
    correction: Correction
    quantity: str
    comparisons: tuple[Comparison, ...]
    within: str = ""

    @property
    def label(self) -> str:
        """The compared factors in words."""
        return named_within(" x ".join(self.factors), self.within)


@dataclass(frozen=True, slots=True)
class ContrastTest:
    """The test of a hypothesis on a contrast, or on a bound of a difference.

    Attributes:
        statement: the hypothesis in words.
        estimate: the weighted sum of means, or of proportions in percent.
        interval: at 1 - alpha; for equivalence at 1 - 2 alpha, which decides it.
        statistic: t; None of proportions, likewise the degrees of freedom.
        p_value: of the test against zero; for equivalence, of two one-sided tests.
    """

    statement: str
    estimate: float
    interval: Interval
    statistic: float | None
    degrees_of_freedom: float | None
    p_value: float
