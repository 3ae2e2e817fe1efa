"""Which test fits the design and the data, and why; the checks of assumptions that the choice rests on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import stats

from robot_runner.analysis.statistics.descriptive import quiet
from robot_runner.analysis.statistics.linear_model import LinearFit, fit_linear, terms_of
from robot_runner.analysis.statistics.tested import AssumptionCheck, NotComputed, QuantilePairs, TestMethod
from robot_runner.analysis.wording import p_in_words
from robot_runner.core.words import counted

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from robot_runner.analysis.statistics.design import Group, MeasureData

__all__ = [
    "LEVENE",
    "SHAPIRO_WILK",
    "Choice",
    "choose_test",
    "equal_variances",
    "normality",
    "paired_differences",
    "quantile_pairs",
]


SHAPIRO_WILK = "Shapiro-Wilk"
LEVENE = "Levene"

#: scipy computes the test for no fewer, and its p-value holds for no more (Royston 1995).
_LEAST = 3
_MOST = 5000

_LEAST_FOR_VARIANCE = 2

#: Distances that differ by less, beside the values, are the same but for rounding.
_SAME = 1e-12


def normality(
    values: NDArray[np.float64],
    alpha: float,
    treatments: Mapping[str, str] | None = None,
    *,
    subject: str = "the residuals",
) -> AssumptionCheck | NotComputed:
    """Check by Shapiro and Wilk's test whether values may come from a normal distribution.

    Args:
        values: residuals of all groups together, or the values of one group.
        alpha: below this p-value they are taken not to.
        treatments: the group; empty for residuals.
        subject: what the values are, where they are no group's.

    Example:
        >>> normality(np.array([4.1, 5.0, 5.2, 5.9, 6.3]), alpha=0.05).holds
        True
    """
    group = dict(treatments or {})
    what = f"{SHAPIRO_WILK} test of {' / '.join(group.values()) or subject}"
    if len(values) < _LEAST:
        return NotComputed(what, f"the test takes {_LEAST} values, and there {_are(len(values))}.")
    if len(values) > _MOST:
        return NotComputed(what, f"the test's p-value holds for up to {_MOST} values, and there are {len(values)}.")
    if np.ptp(values) == 0:
        return NotComputed(what, "all values are equal.")
    with quiet():
        result = stats.shapiro(values)
    if not np.isfinite([result.statistic, result.pvalue]).all():
        return NotComputed(what, "the values hardly vary.")
    holds = bool(result.pvalue >= alpha)
    whose = f"The values of {' / '.join(group.values())}" if group else subject[0].upper() + subject[1:]
    verdict = "may be normally distributed" if holds else "are not normally distributed"
    conclusion = f"{whose} {verdict} (W = {result.statistic:.3f}, {p_in_words(result.pvalue)})."
    return AssumptionCheck(SHAPIRO_WILK, group, float(result.statistic), float(result.pvalue), holds, conclusion)


def equal_variances(groups: Sequence[Group], alpha: float) -> AssumptionCheck | NotComputed:
    """Check by Levene's test, around medians (Brown and Forsythe 1974), whether groups may have equal variances."""
    what = f"{LEVENE} test"
    samples = [group.values for group in groups if len(group.values)]
    if len(samples) < _LEAST_FOR_VARIANCE:
        return NotComputed(what, "there is only one group.")
    if min(map(len, samples)) < _LEAST_FOR_VARIANCE:
        return NotComputed(what, "a group has a single value, which has no variance.")
    # So are any two values, but for rounding.
    if all(np.ptp(np.abs(each - np.median(each))) <= _SAME * np.max(np.abs(each)) for each in samples):
        return NotComputed(what, "within each group all values are equally far from the median.")
    with quiet():
        result = stats.levene(*samples, center="median")
    if not np.isfinite([result.statistic, result.pvalue]).all():
        return NotComputed(what, "the values hardly vary.")
    holds = bool(result.pvalue >= alpha)
    verdict = "may be equal" if holds else "differ"
    conclusion = f"The variances of the groups {verdict} (F = {result.statistic:.3f}, {p_in_words(result.pvalue)})."
    return AssumptionCheck(LEVENE, {}, float(result.statistic), float(result.pvalue), holds, conclusion)


def quantile_pairs(residuals: NDArray[np.float64], run_ids: Sequence[str]) -> QuantilePairs | None:
    """Return the points of a normal Q-Q figure, as R's `qqnorm` and `qqline` draw them; None for fewer than three."""
    count = len(residuals)
    if count < _LEAST or np.ptp(residuals) == 0:
        return None
    order = np.argsort(residuals, kind="stable")
    offset = 3 / 8 if count <= 10 else 1 / 2  # noqa: PLR2004 - R's ppoints
    theoretical = stats.norm.ppf((np.arange(1, count + 1) - offset) / (count + 1 - 2 * offset))
    low, high = np.quantile(residuals, [0.25, 0.75])
    slope = float((high - low) / (stats.norm.ppf(0.75) - stats.norm.ppf(0.25)))
    return QuantilePairs(
        tuple(map(float, theoretical)),
        tuple(map(float, residuals[order])),
        tuple(run_ids[place] for place in order),
        slope,
        float(low - slope * stats.norm.ppf(0.25)),
    )


def _are(count: int) -> str:
    return "is 1" if count == 1 else f"are {count}" if count else "is none"


#: With so many runs means are close to normal whatever the values are (and Shapiro-Wilk has no p-value for them).
_MANY = 5000

_PAIR = 2


@dataclass(frozen=True, slots=True)
class Choice:
    """The test of a measure.

    Attributes:
        method: the test.
        reason: why, in a sentence.
        checks: what it rests on: the residuals' normality, the groups' variances.
        fit: the linear model whose residuals were looked at.
    """

    method: TestMethod
    reason: str
    checks: tuple[AssumptionCheck | NotComputed, ...]
    fit: LinearFit


def choose_test(data: MeasureData, alpha: float) -> Choice | NotComputed:
    """Return the test that fits, or why there is none.

    Args:
        data: the measure, with one factor at least.
        alpha: the level at which assumptions count as refuted.
    """
    problem = _problem(data)
    terms = None if problem else terms_of(data)
    if terms is None:
        return NotComputed("the test", problem or "there are too few runs for the number of treatments.")
    fit = fit_linear(data, terms)
    if not fit.is_estimable:
        return NotComputed("the test", "the factors go together so closely that their effects cannot be told apart.")
    if not fit.has_variation:
        return NotComputed("the test", "within each combination all values are equal, so that chance has no measure.")
    is_complete = _blocks_are_complete(data)
    variances = equal_variances(data.groups(data.factors), alpha)
    residuals, subject = _residuals(data, fit, variances, is_complete=is_complete)
    normal = normality(residuals, alpha, subject=subject)
    if is_complete:
        method, reason = _blocked(data, _holds(normal, residuals))
    elif data.is_blocked:
        method, reason = _incomplete(_holds(normal, residuals))
    elif len(data.factors) > 1:
        method, reason = _factorial(data, _holds(normal, residuals), variances)
    else:
        method, reason = _independent(data, _holds(normal, residuals), variances)
    if method in {TestMethod.ALIGNED_RANKS, TestMethod.MIXED_ALIGNED_RANKS} and not terms.is_full:
        why = f"{_normal_words(normal)}, and ranks cannot be aligned: {terms.note[0].lower()}{terms.note[1:]}"
        return NotComputed("the test", why)
    return Choice(method, f"{reason}; {_normal_words(normal)}.", (normal, variances), fit)


def paired_differences(data: MeasureData) -> NDArray[np.float64]:
    """Return the first treatment's value less the second's, for each block in which both have one."""
    first, second = data.levels(data.factors[0])
    wide = data.by_block()
    return np.asarray((wide[first] - wide[second]).dropna(), dtype=np.float64)


def _problem(data: MeasureData) -> str:
    """Return why no test can be made at all; empty where one can."""
    if not len(data.frame):
        return "no run has a value."
    if not data.factors:
        return "all runs with a value have the same treatments, so that there is nothing to compare."
    if np.ptp(data.values) == 0:
        return "all values are equal."
    if max(len(group.values) for group in data.groups(data.factors)) < _PAIR and len(data.factors) == 1:
        return "each treatment has a single run, so that chance has no measure: repeat the runs."
    return ""


def _residuals(
    data: MeasureData, fit: LinearFit, variances: AssumptionCheck | NotComputed, *, is_complete: bool
) -> tuple[NDArray[np.float64], str]:
    """Return what is to be normally distributed, and what it is."""
    if is_complete and _is_pair(data):
        return paired_differences(data), "the differences within pairs"
    may_differ = isinstance(variances, AssumptionCheck) and not variances.holds
    if may_differ and not data.is_blocked:
        # Values of several spreads thrown together are not normal, even where those of each group are.
        groups = [group.values for group in data.groups(data.factors) if np.ptp(group.values) > 0]
        scaled = [(values - values.mean()) / values.std(ddof=1) for values in groups]
        return np.concatenate(scaled), "the residuals, in standard deviations of their groups,"
    return fit.residuals, "the residuals"


def _blocks_are_complete(data: MeasureData) -> bool:
    """Return whether each block holds each combination, equally often."""
    if not data.is_blocked:
        return False
    keys = [data.blocks, *(data.frame[factor].astype(str).to_numpy() for factor in data.factors)]
    counts = data.frame.groupby(keys).size()
    possible = len(set(data.blocks)) * int(np.prod([len(data.levels(factor)) for factor in data.factors]))
    return len(counts) == possible and counts.nunique() == 1


def _is_pair(data: MeasureData) -> bool:
    is_single = len(data.frame) == len(set(data.blocks)) * _PAIR
    return len(data.factors) == 1 and len(data.levels(data.factors[0])) == _PAIR and is_single


def _holds(check: AssumptionCheck | NotComputed, residuals: NDArray[np.float64]) -> bool:
    return bool(check.holds) if isinstance(check, AssumptionCheck) else len(residuals) > _MANY


def _normal_words(check: AssumptionCheck | NotComputed) -> str:
    if isinstance(check, AssumptionCheck):
        return check.conclusion[0].lower() + check.conclusion[1:-1]
    return f"whether the residuals are normally distributed cannot be judged: {check.why[:-1]}"


def _independent(
    data: MeasureData, is_normal: bool, variances: AssumptionCheck | NotComputed
) -> tuple[TestMethod, str]:
    count = len(data.levels(data.factors[0]))
    design = f"One factor with {counted(count, 'treatment')}, each with runs of its own"
    is_pair = count == _PAIR
    if not is_normal:
        method = TestMethod.MANN_WHITNEY if is_pair else TestMethod.KRUSKAL_WALLIS
        return method, f"{design}; ranks are compared, as normality is not given"
    if isinstance(variances, AssumptionCheck) and variances.holds:
        method = TestMethod.STUDENT_T if is_pair else TestMethod.ANOVA
        return method, f"{design}; means are compared, with one variance for all groups, which Levene's test allows"
    if isinstance(variances, NotComputed) or any(np.ptp(group.values) == 0 for group in data.groups(data.factors)):
        method = TestMethod.MANN_WHITNEY if is_pair else TestMethod.KRUSKAL_WALLIS
        return method, f"{design}; ranks are compared, as variances may differ and cannot be told"
    method = TestMethod.WELCH_T if is_pair else TestMethod.WELCH_ANOVA
    return method, f"{design}; means are compared, with a variance for each group, as they may differ"


def _factorial(data: MeasureData, is_normal: bool, variances: AssumptionCheck | NotComputed) -> tuple[TestMethod, str]:
    design = f"{len(data.factors)} factors and their interactions"
    if not is_normal:
        return TestMethod.ALIGNED_RANKS, f"{design}; aligned ranks are compared, as normality is not given"
    if isinstance(variances, AssumptionCheck) and not variances.holds:
        return (
            TestMethod.ROBUST_ANOVA,
            f"{design}; means are compared, with standard errors that hold where variances differ",
        )
    return TestMethod.FACTORIAL_ANOVA, f"{design}; means are compared"


def _incomplete(is_normal: bool) -> tuple[TestMethod, str]:
    design = "Runs belong to blocks, and not each block holds each combination equally often"
    if is_normal:
        return TestMethod.MIXED_MODEL, f"{design}; means are compared"
    return TestMethod.MIXED_ALIGNED_RANKS, f"{design}; aligned ranks are compared, as normality is not given"


def _blocked(data: MeasureData, is_normal: bool) -> tuple[TestMethod, str]:
    if _is_pair(data):
        method = TestMethod.PAIRED_T if is_normal else TestMethod.WILCOXON
        return method, "Two treatments, compared within each block"
    if is_normal:
        return TestMethod.BLOCKED_ANOVA, "Each block holds each combination; means are compared within blocks"
    if len(data.factors) > 1:
        return (
            TestMethod.ALIGNED_RANKS,
            "Several factors in complete blocks; aligned ranks are compared, as normality is not given",
        )
    is_single = len(data.frame) == len(set(data.blocks)) * len(data.levels(data.factors[0]))
    if is_single:
        return (
            TestMethod.FRIEDMAN,
            "Each block holds each treatment once; ranks are compared, as normality is not given",
        )
    return (
        TestMethod.ALIGNED_RANKS,
        "Each block holds each treatment several times; aligned ranks are compared, as normality is not given",
    )
