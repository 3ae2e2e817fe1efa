"""What tests yield: plain data that carry the numbers and the reasons. No p-value is given that does not hold."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Any, NamedTuple

from robot_runner.core.words import listed

if TYPE_CHECKING:
    from robot_runner.core.design.analysis_plan import Correction


def named_within(name: str, within: str) -> str:
    """Return an effect with the runs among which it is told.

    Example:
        >>> named_within("Resolution", "Sensor=camera")
        'Resolution within Sensor=camera'
    """
    return f"{name} within {within}" if within else name


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
class NoVariation(NotComputed):
    """Something that could not be computed as nothing varies there, or by no more than rounding would make it."""


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
    BESIDE_BLOCKS = "analysis of variance beside blocks"
    CROSSOVER = "analysis of variance of a crossover"
    SPLIT_PLOT = "analysis of variance of a split-plot design"
    LENTH = "Lenth's method"
    SURFACE = "response surface"
    PROPORTIONS = "exact tests of proportions"


class EffectTest(NamedTuple):
    """What was computed for one effect.

    The numbers are arrays where several experiments were computed at once.

    Attributes:
        factors: one name, or several for an interaction.
        test: which test it is, as in `Welch's t`.
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
    """How the values are distributed, as a figure that describes; no test is chosen by it.

    Attributes:
        name: `Shapiro-Wilk` or `Levene`.
        treatments: the group that was looked at; empty for all groups together (residuals).
        holds: whether it is not refuted at alpha.
        conclusion: one sentence.
    """

    name: str
    treatments: Mapping[str, str]
    statistic: float
    p_value: float
    holds: bool
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
class Check:
    """The test of the ranks of all values, or of their means where ranks are tested: does a conclusion hang on it?

    Attributes:
        of: `ranks` or `means`.
        p_value: before adjustment; None where it could not be computed.
        agrees: whether it comes to the same side of alpha as the test beside it; None where that is not known.
    """

    of: str
    statistic_name: str
    statistic: float | None
    degrees_of_freedom: tuple[float, ...]
    p_value: float | None
    agrees: bool | None


@dataclass(frozen=True, slots=True)
class TestPart:
    """One of the tests whose p-values are combined to that of an effect.

    Attributes:
        name: `Welch-James` or `ANOVA-type`.
        statistic: an F.
        degrees_of_freedom: two.
        p_value: of this test alone, of which nothing is concluded.
    """

    __test__ = False  # no tests for pytest

    name: str
    statistic: float
    degrees_of_freedom: tuple[float, ...]
    p_value: float


@dataclass(frozen=True, slots=True)
class Effect:
    """One line of a table of tests: the effect of a factor, or of several together (their interaction).

    Attributes:
        factors: one name, or several for an interaction.
        test: which test it is, as in `Welch's t`.
        statistic_name: `t` or `F`.
        statistic: of the first part, where there are parts.
        degrees_of_freedom: one or two.
        p_value: before adjustment; None where it could not be computed.
        adjusted_p_value: after adjustment for the family of tests that it belongs to.
        is_significant: whether the adjusted p-value is below alpha; None where there is none.
        effect_sizes: how much it is.
        check: the test of ranks beside it.
        conclusion: one plain sentence, or two.
        parts: the tests whose p-values are combined; none where there is a single test.
        aliases: the effects that the design cannot tell apart from it, by their factors.
        within: among which runs it is told, as in `Sensor=camera`, where a factor applies to some only.
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
        """The effect in words, as in `Task` or `Task x Speed`; with what it cannot be told apart from."""
        name = named_within(" x ".join(self.factors), self.within)
        return f"{name} (aliased with {listed([' x '.join(each) for each in self.aliases])})" if self.aliases else name


@dataclass(frozen=True, slots=True)
class MeasureTest:
    """The test of a measure, as the design and the plan fix it.

    Attributes:
        method: the test.
        estimand: what is compared: `mean`, `trimmed mean`, `rank`, or `proportion` of a measure that is yes or no.
        reason: why this one, in a sentence.
        effects: its results, main effects first.
        family: the tests among which errors are controlled together, in words; how many they are.
        family_size: their number.
        spread: the standard deviation that differences are divided by for Cohen's d; None where there is none.
        library: what computed it, with its version.
        notes: what else the reader has to know, such as that an interaction could not be estimated.
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


@dataclass(frozen=True, slots=True)
class Comparison:
    """Two groups compared, among all pairs.

    Attributes:
        first, second: the treatments, as texts.
        difference: the estimate of the first less that of the second; each combination counts the same.
        interval: confidence interval of the difference at 1 - alpha, not adjusted for the number of comparisons.
        p_value: before adjustment; below alpha where the interval leaves out 0.
        adjusted_p_value: after adjustment for the number of pairs, and no smaller than that of the effect.
        is_significant: whether the adjusted p-value is below alpha.
        check_p_value: of the same comparison of the ranks of all values (of means, where ranks are compared).
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
        factors: whose treatments are compared; several where combinations are.
        method: the test of each pair, in words.
        correction: how p-values were adjusted.
        quantity: what differences are of: `means`, `trimmed means`, `relative ranks`, or `proportions`.
        within: among which runs, where a factor applies to some only.
    """

    factors: tuple[str, ...]
    method: str
    correction: Correction
    quantity: str
    comparisons: tuple[Comparison, ...]
    within: str = ""

    @property
    def label(self) -> str:
        """Whose treatments are compared, in words."""
        return named_within(" x ".join(self.factors), self.within)


@dataclass(frozen=True, slots=True)
class ContrastTest:
    """A contrast that a hypothesis names, or the difference that it bounds.

    Attributes:
        statement: the hypothesis in words.
        estimate: the weighted sum of means.
        interval: at 1 - alpha; at 1 - 2 alpha where the hypothesis is one of equivalence, which it decides.
        p_value: that the sum is not zero; of two one-sided tests where it is one of equivalence.
    """

    statement: str
    estimate: float
    interval: Interval
    statistic: float
    degrees_of_freedom: float
    p_value: float
