"""Carrying out the test that was chosen."""

from __future__ import annotations

import math
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import stats

from robot_runner.analysis.statistics.choice import LEVENE, Choice, paired_differences
from robot_runner.analysis.statistics.descriptive import quiet
from robot_runner.analysis.statistics.effect_sizes import (
    eta_squared,
    eta_squared_of_ranks,
    kendalls_w,
    paired_d,
    paired_rank_biserial,
    partial_eta_squared,
    two_group_effects,
)
from robot_runner.analysis.statistics.linear_model import aligned_ranks, coded_frame, fit_aligned, formula_of
from robot_runner.analysis.statistics.tested import AssumptionCheck, Effect, EffectSize, MeasureTest, TestMethod
from robot_runner.analysis.wording import enumerated, p_in_words

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

    from robot_runner.analysis.statistics.design import MeasureData
    from robot_runner.analysis.statistics.tested import EffectSize

__all__ = ["carry_out", "library", "make_effect", "mixed_model"]


# The line of a table of tests, with its conclusion in plain words.


def library(name: str) -> str:
    """Return a library with its version, as in `scipy 1.17.1`."""
    return f"{name} {version(name)}"


def make_effect(
    measure: str,
    factors: tuple[str, ...],
    statistic: tuple[str, float],
    freedom: tuple[float, ...],
    p_value: float,
    alpha: float,
    sizes: tuple[EffectSize, ...],
) -> Effect:
    """Return a tested effect; a p-value that is no number is none."""
    name, value = statistic
    if not all(map(math.isfinite, (p_value, value, *freedom))):
        return Effect(factors, name, None, (), None, None, (), f"The effect of {_named(factors)} was not computed.")
    is_significant = p_value < alpha
    in_brackets = ", ".join(map(_number, freedom))
    figures = f"{name}{f'({in_brackets})' if freedom else ''} = {value:.3g}, {p_in_words(p_value)}"
    return Effect(
        factors,
        name,
        value,
        freedom,
        p_value,
        is_significant,
        sizes,
        _conclusion(measure, factors, figures, sizes, is_significant),
    )


def _conclusion(
    measure: str, factors: tuple[str, ...], figures: str, sizes: tuple[EffectSize, ...], is_significant: bool
) -> str:
    if not is_significant:
        what = f"an interaction of {enumerated(factors)}" if len(factors) > 1 else f"an effect of {factors[0]}"
        return f"The data do not show {what} on {measure} ({figures}); that is no proof that there is none."
    size = f"; the effect is {sizes[0].magnitude.value}, {sizes[0].name} = {sizes[0].value:.2f}" if sizes else ""
    if len(factors) > 1:
        others = enumerated(factors[1:])
        return f"The effect of {factors[0]} on {measure} depends on {others} ({figures}{size})."
    return f"{factors[0]} has an effect on {measure} ({figures}{size})."


def _named(factors: tuple[str, ...]) -> str:
    return enumerated(factors)


def _number(value: float) -> str:
    return f"{value:g}" if float(value).is_integer() else f"{value:.2f}"


def carry_out(data: MeasureData, choice: Choice, alpha: float) -> MeasureTest:
    """Return the results of the test that was chosen."""
    with quiet():
        effects, source = _CARRIED_OUT[choice.method](data, choice, alpha)
    notes = [
        choice.fit.terms.note,
        _NOTES.get(choice.method, ""),
        _balance_note(data, choice),
        _variances_note(choice),
        _size_note(data, choice),
    ]
    return MeasureTest(choice.method, choice.reason, tuple(effects), library(source), tuple(filter(None, notes)))


#: By simulation: of groups of three runs, five err in 8 % and ten in 14 % of experiments at an alpha of 5 %.
_FEW_GROUPS, _ENOUGH_FOR_WELCH = 4, 6

_CONTAINMENT = (
    "Each block has a random mean. Degrees of freedom are those between blocks for effects that only differences "
    "between blocks tell, else those within (containment)."
)
_NOTES = {
    TestMethod.MIXED_MODEL: _CONTAINMENT,
    TestMethod.MIXED_ALIGNED_RANKS: _CONTAINMENT,
    TestMethod.BLOCKED_ANOVA: "Blocks are taken to add the same to all treatments.",
}

#: In these, factors that go together share what they explain with each other.
_UNBALANCED = {
    TestMethod.FACTORIAL_ANOVA: "sums of squares are of type II",
    TestMethod.ROBUST_ANOVA: "tests are of type II",
    TestMethod.ALIGNED_RANKS: "sums of squares are of type II",
    TestMethod.MIXED_MODEL: "tests are of type III",
    TestMethod.MIXED_ALIGNED_RANKS: "tests are of type III",
}


def _balance_note(data: MeasureData, choice: Choice) -> str:
    counts = {len(group.values) for group in data.groups(data.factors)}
    if choice.method in _UNBALANCED and len(data.factors) > 1 and len(counts) > 1:
        return f"The combinations have unequal numbers of runs: {_UNBALANCED[choice.method]}."
    return ""


def _size_note(data: MeasureData, choice: Choice) -> str:
    if choice.method is not TestMethod.WELCH_ANOVA:
        return ""
    groups = data.groups(data.factors)
    if len(groups) <= _FEW_GROUPS or min(len(group.values) for group in groups) >= _ENOUGH_FOR_WELCH:
        return ""
    return "With many groups of few runs Welch's test errs more often than alpha says: read p near alpha with care."


def _variances_note(choice: Choice) -> str:
    differ = any(
        isinstance(check, AssumptionCheck) and check.name == LEVENE and not check.holds for check in choice.checks
    )
    if differ and choice.method in {TestMethod.ALIGNED_RANKS, TestMethod.MIXED_ALIGNED_RANKS}:
        return (
            "The variances of the groups differ, and aligned ranks take that for effects: read p near alpha with care."
        )
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
        test = fit.robust_tests[factors] if choice.method is TestMethod.ROBUST_ANOVA else fit.tests[factors]
        # As of a one-way analysis: the size is a share of the sums of squares, whichever way the test weighs the runs.
        sizes = (partial_eta_squared(fit.tests[factors].f_value, test.freedom),)
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


def mixed_model(data: MeasureData, choice: Choice, response: NDArray[np.float64] | None = None) -> Any:
    """Return the fitted linear mixed model with a random intercept for each block (REML), as statsmodels returns it.

    Args:
        data: the measure.
        choice: its test, with the effects of the model.
        response: takes the place of the values, as their ranks.
    """
    from statsmodels.formula.api import mixedlm  # noqa: PLC0415 - takes a second to import

    formula = formula_of(data, choice.fit.terms.effects, with_blocks=False)
    with quiet():  # blocks that do not differ: their variance is at its bound, 0
        return mixedlm(formula, coded_frame(data, response), groups="b").fit(reml=True)


def _mixed(data: MeasureData, choice: Choice, alpha: float) -> tuple[list[Effect], str]:
    is_ranked = choice.method is TestMethod.MIXED_ALIGNED_RANKS
    of_values = None if is_ranked else mixed_model(data, choice)
    effects = []
    for factors in choice.fit.terms.effects:
        results = of_values or mixed_model(data, choice, aligned_ranks(data, factors))
        table = results.wald_test_terms(scalar=True).table
        row = table.loc[formula_of(data, [factors], with_blocks=False).removeprefix("y ~ ")]
        # Wald's chi squared would hold for many blocks only.
        freedom = (float(row["df_constraint"]), choice.fit.freedom_within(factors))
        f_value = float(row["statistic"]) / freedom[0]
        p_value = float(stats.f.sf(f_value, *freedom))
        sizes = (partial_eta_squared(f_value, freedom),) if math.isfinite(p_value) else ()
        effects.append(make_effect(data.name, factors, ("F", f_value), freedom, p_value, alpha, sizes))
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
    TestMethod.ROBUST_ANOVA: _linear,
    TestMethod.BLOCKED_ANOVA: _linear,
    TestMethod.ALIGNED_RANKS: _linear,
    TestMethod.FRIEDMAN: _friedman,
    TestMethod.MIXED_MODEL: _mixed,
    TestMethod.MIXED_ALIGNED_RANKS: _mixed,
}
