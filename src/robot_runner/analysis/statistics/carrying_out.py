"""Carrying out the test that was chosen."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import stats

from robot_runner.analysis.statistics.aligned_ranks import fit_aligned
from robot_runner.analysis.statistics.choice import Choice, paired_differences
from robot_runner.analysis.statistics.effect_sizes import (
    eta_squared,
    eta_squared_of_ranks,
    kendalls_w,
    paired_d,
    paired_rank_biserial,
    partial_eta_squared,
    two_group_effects,
)
from robot_runner.analysis.statistics.effects import library, make_effect
from robot_runner.analysis.statistics.linear_model import coded_frame, formula_of
from robot_runner.analysis.statistics.quiet import quiet
from robot_runner.analysis.statistics.tested import Effect, EffectSize, MeasureTest, TestMethod

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from robot_runner.analysis.statistics.design import MeasureData

__all__ = ["carry_out", "mixed_model"]


def carry_out(data: MeasureData, choice: Choice, alpha: float) -> MeasureTest:
    """Return the results of the test that was chosen."""
    with quiet():
        effects, source = _CARRIED_OUT[choice.method](data, choice, alpha)
    notes = [choice.fit.terms.note, _NOTES.get(choice.method, ""), _balance_note(data, choice)]
    return MeasureTest(choice.method, choice.reason, tuple(effects), library(source), tuple(filter(None, notes)))


_NOTES = {
    TestMethod.MIXED_MODEL: "The p-values are of Wald tests, which hold for many blocks and are too small for few.",
    TestMethod.BLOCKED_ANOVA: "Blocks are taken to add the same to all treatments.",
}


def _balance_note(data: MeasureData, choice: Choice) -> str:
    counts = {len(group.values) for group in data.groups(data.factors)}
    if choice.method in {TestMethod.FACTORIAL_ANOVA, TestMethod.ALIGNED_RANKS} and len(counts) > 1:
        return "The combinations have unequal numbers of runs: sums of squares are of type II."
    return ""


def _student(data: MeasureData, choice: Choice, alpha: float) -> tuple[list[Effect], str]:
    first, second = (group.values for group in data.groups(data.factors))
    result = stats.ttest_ind(first, second, equal_var=choice.method is TestMethod.STUDENT_T)
    sizes = two_group_effects(first, second, by_ranks=False)
    return [_effect(data, ("t", result.statistic), (float(result.df),), result.pvalue, alpha, sizes)], "scipy"


def _mann_whitney(data: MeasureData, choice: Choice, alpha: float) -> tuple[list[Effect], str]:
    del choice
    first, second = (group.values for group in data.groups(data.factors))
    result = stats.mannwhitneyu(first, second, method="auto")
    sizes = two_group_effects(first, second, by_ranks=True)
    return [_effect(data, ("U", result.statistic), (), result.pvalue, alpha, sizes)], "scipy"


def _anova(data: MeasureData, choice: Choice, alpha: float) -> tuple[list[Effect], str]:
    from statsmodels.stats.oneway import anova_oneway  # noqa: PLC0415 - takes a second to import

    groups = [group.values for group in data.groups(data.factors)]
    result = anova_oneway(groups, use_var="equal" if choice.method is TestMethod.ANOVA else "unequal")
    freedom = (float(result.df_num), float(result.df_denom))
    # Eta squared is a share of the sums of squares, whichever way the test weighs the groups.
    (term,) = choice.fit.tests.values()
    sizes = (eta_squared(term.f_value, term.freedom),)
    return [_effect(data, ("F", result.statistic), freedom, result.pvalue, alpha, sizes)], "statsmodels"


def _kruskal_wallis(data: MeasureData, choice: Choice, alpha: float) -> tuple[list[Effect], str]:
    del choice
    groups = [group.values for group in data.groups(data.factors)]
    result = stats.kruskal(*groups)
    sizes = (eta_squared_of_ranks(groups),)
    return [_effect(data, ("H", result.statistic), (len(groups) - 1.0,), result.pvalue, alpha, sizes)], "scipy"


def _linear(data: MeasureData, choice: Choice, alpha: float) -> tuple[list[Effect], str]:
    is_ranked = choice.method is TestMethod.ALIGNED_RANKS
    effects = []
    for factors in choice.fit.terms.effects:
        fit = fit_aligned(data, choice.fit.terms, factors) if is_ranked else choice.fit
        test = fit.tests[factors]
        sizes = (partial_eta_squared(test.f_value, test.freedom),)
        effects.append(make_effect(data.name, factors, ("F", test.f_value), test.freedom, test.p_value, alpha, sizes))
    return effects, "statsmodels"


def _paired(data: MeasureData, choice: Choice, alpha: float) -> tuple[list[Effect], str]:
    differences = paired_differences(data)
    if choice.method is TestMethod.PAIRED_T:
        result = stats.ttest_1samp(differences, 0.0)
        size = paired_d(differences)
        return [_effect(data, ("t", result.statistic), (float(result.df),), result.pvalue, alpha, _only(size))], "scipy"
    result = stats.wilcoxon(differences)
    size = paired_rank_biserial(differences)
    return [_effect(data, ("W", result.statistic), (), result.pvalue, alpha, _only(size))], "scipy"


def _friedman(data: MeasureData, choice: Choice, alpha: float) -> tuple[list[Effect], str]:
    del choice
    wide = data.by_block()
    levels = data.levels(data.factors[0])
    result = stats.friedmanchisquare(*(wide[level].to_numpy(dtype=np.float64) for level in levels))
    sizes = (kendalls_w(float(result.statistic), len(wide), len(levels)),)
    return [_effect(data, ("chi2", result.statistic), (len(levels) - 1.0,), result.pvalue, alpha, sizes)], "scipy"


def mixed_model(data: MeasureData, choice: Choice) -> Any:
    """Return the fitted linear mixed model with a random intercept for each block (REML), as statsmodels returns it."""
    from statsmodels.formula.api import mixedlm  # noqa: PLC0415 - takes a second to import

    formula = formula_of(data, choice.fit.terms.effects, with_blocks=False)
    with quiet():  # blocks that do not differ: their variance is at its bound, 0
        return mixedlm(formula, coded_frame(data), groups="b").fit(reml=True)


def _mixed(data: MeasureData, choice: Choice, alpha: float) -> tuple[list[Effect], str]:
    results = mixed_model(data, choice)
    table = results.wald_test_terms(scalar=True).table
    effects = []
    for factors in choice.fit.terms.effects:
        row = table.loc[formula_of(data, [factors], with_blocks=False).removeprefix("y ~ ")]
        statistic = ("chi2", float(row["statistic"]))
        freedom = (float(row["df_constraint"]),)
        effects.append(make_effect(data.name, factors, statistic, freedom, float(row["pvalue"]), alpha, ()))
    return effects, "statsmodels"


def _effect(
    data: MeasureData,
    statistic: tuple[str, float],
    freedom: tuple[float, ...],
    p_value: float,
    alpha: float,
    sizes: tuple[EffectSize, ...],
) -> Effect:
    name, value = statistic
    return make_effect(data.name, data.factors, (name, float(value)), freedom, float(p_value), alpha, sizes)


def _only(size: EffectSize | None) -> tuple[EffectSize, ...]:
    return () if size is None else (size,)


_CARRIED_OUT: Mapping[TestMethod, Callable[[MeasureData, Choice, float], tuple[list[Effect], str]]] = {
    TestMethod.STUDENT_T: _student,
    TestMethod.WELCH_T: _student,
    TestMethod.MANN_WHITNEY: _mann_whitney,
    TestMethod.PAIRED_T: _paired,
    TestMethod.WILCOXON: _paired,
    TestMethod.ANOVA: _anova,
    TestMethod.WELCH_ANOVA: _anova,
    TestMethod.KRUSKAL_WALLIS: _kruskal_wallis,
    TestMethod.FACTORIAL_ANOVA: _linear,
    TestMethod.BLOCKED_ANOVA: _linear,
    TestMethod.ALIGNED_RANKS: _linear,
    TestMethod.FRIEDMAN: _friedman,
    TestMethod.MIXED_MODEL: _mixed,
}
