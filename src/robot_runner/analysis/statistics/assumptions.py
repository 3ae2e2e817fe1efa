"""Checks of distribution assumptions. They describe the data; no test is chosen by them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from scipy import stats

from robot_runner.analysis.arrays import Floats
from robot_runner.analysis.statistics.descriptive import quiet
from robot_runner.analysis.statistics.tested import AssumptionCheck, NotComputed, NoVariation, QuantilePairs
from robot_runner.analysis.wording import listed, p_in_words, shown_coefficient
from robot_runner.core.words import combination_label, enumerated

if TYPE_CHECKING:
    from robot_runner.analysis.statistics.grouped_runs import Group

SHAPIRO_WILK = "Shapiro-Wilk"
LEVENE = "Levene"

#: The fewest values for which scipy computes the test, and the most for which its p-value is valid (Royston 1995).
LEAST = 3
_MOST = 5000

_LEAST_FOR_VARIANCE = 2

#: Distances from the median that differ by less, relative to the values, differ by rounding only.
_SAME = 1e-12
#: P-values below this are 0: for three values, two of them equal, rounding yields 8e-16.
_ROUNDED = 1e-15


def normality(
    values: Floats, alpha: float, treatments: Mapping[str, str] | None = None, *, freedom: int | None = None
) -> AssumptionCheck | NotComputed:
    """Check with the Shapiro-Wilk test whether values may come from a normal distribution.

    Args:
        values: residuals of all groups together, or the values of one group.
        alpha: the level of the test: `holds` is False for smaller p-values.
        treatments: the group; empty for residuals.
        freedom: the degrees of freedom of the values; None for their number.

    Example:
        >>> normality(np.array([4.1, 5.0, 5.2, 5.9, 6.3]), alpha=0.05).holds
        True
    """
    group = dict(treatments or {})
    what = f"{SHAPIRO_WILK} test of {combination_label(group.values()) or 'the residuals'}"
    if len(values) < LEAST:
        return NotComputed(what, f"the test takes {LEAST} values, and there {_are(len(values))}.")
    if freedom is not None and freedom < LEAST:
        return NotComputed(what, f"with fewer than {LEAST} degrees of freedom their design fixes what they look like.")
    if len(values) > _MOST:
        return NotComputed(what, f"the test's p-value holds for up to {_MOST} values, and there are {len(values)}.")
    if np.ptp(values) == 0:
        return NoVariation(what, "all values are equal.")
    with quiet():
        result = stats.shapiro(values)
    if not np.isfinite([result.statistic, result.pvalue]).all():
        return NotComputed(what, "the values hardly vary.")
    p_value = 0.0 if result.pvalue < _ROUNDED else float(result.pvalue)
    holds = p_value >= alpha
    whose = f"The values of {combination_label(group.values())}" if group else "The residuals"
    verdict = "may be normally distributed" if holds else "are not normally distributed"
    conclusion = f"{whose} {verdict} (W = {shown_coefficient(result.statistic)}, {p_in_words(p_value)})."
    return AssumptionCheck(SHAPIRO_WILK, group, float(result.statistic), p_value, holds, conclusion)


def few_values(groups: Sequence[Mapping[str, str]]) -> list[NotComputed]:
    """Return what tells of all groups whose values are too few for the test, by their treatments; none without any."""
    labels = listed(combination_label(treatments.values()) for treatments in groups)
    why = f"the test takes {LEAST} values of a group, and there are fewer."
    return [NotComputed(f"{SHAPIRO_WILK} test of {labels}", why)] if groups else []


def equal_variances(groups: Sequence[Group], alpha: float, within: Sequence[str] = ()) -> AssumptionCheck | NotComputed:
    """Check with Levene's test, centred at medians (Brown and Forsythe 1974), whether variances may be equal.

    For p-values below alpha, `holds` is False. The test needs independent runs: it is not computed where several runs
    share what `within` names, such as blocks.
    """
    what = f"{LEVENE} test"
    if within:
        # With blocks that vary three times as much as runs, the test has hardly any power, whatever the spreads.
        return NotComputed(
            what, f"all groups also have the spread of {enumerated(within)}, which hides how theirs differ."
        )
    samples = [group.values for group in groups if len(group.values)]
    if len(samples) < _LEAST_FOR_VARIANCE:
        return NotComputed(what, "there is only one group.")
    if min(map(len, samples)) < _LEAST_FOR_VARIANCE:
        return NotComputed(what, "a group has a single value, which has no variance.")
    # Two values are always equally far from their median, except for rounding.
    if all(np.ptp(np.abs(each - np.median(each))) <= _SAME * np.max(np.abs(each)) for each in samples):
        return NoVariation(what, "within each group all values are equally far from the median.")
    with quiet():
        result = stats.levene(*samples, center="median")
    if not np.isfinite([result.statistic, result.pvalue]).all():
        return NotComputed(what, "the values hardly vary.")
    holds = bool(result.pvalue >= alpha)
    verdict = "may be equal" if holds else "differ"
    figures = f"F = {shown_coefficient(result.statistic)}, {p_in_words(result.pvalue)}"
    conclusion = f"The variances of the groups {verdict} ({figures})."
    return AssumptionCheck(LEVENE, {}, float(result.statistic), float(result.pvalue), holds, conclusion)


def quantile_pairs(residuals: Floats, run_ids: Sequence[str]) -> QuantilePairs | None:
    """Return the points of a normal Q-Q plot, as R's `qqnorm` and `qqline`; None for too few or equal values."""
    count = len(residuals)
    if count < LEAST or np.ptp(residuals) == 0:
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
