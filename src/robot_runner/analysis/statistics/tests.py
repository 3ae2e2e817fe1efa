"""Carrying out the test that was chosen."""

from __future__ import annotations

import math
from importlib.metadata import version
from typing import TYPE_CHECKING, Any, NamedTuple

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
    two_group_effects,
)
from robot_runner.analysis.statistics.linear_model import aligned_ranks, coded_frame, fit_aligned, formula_of
from robot_runner.analysis.statistics.tested import AssumptionCheck, Effect, EffectSize, MeasureTest, TestMethod
from robot_runner.analysis.wording import p_in_words
from robot_runner.core.words import enumerated

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from numpy.typing import NDArray

    from robot_runner.analysis.statistics.design import MeasureData

__all__ = ["carry_out", "mixed_model"]


class _Result(NamedTuple):
    """What a library computed for one effect; its factors are those of the measure where nothing else is said."""

    name: str
    statistic: float
    freedom: tuple[float, ...]
    p_value: float
    sizes: tuple[EffectSize | None, ...]
    factors: tuple[str, ...] = ()


def carry_out(data: MeasureData, choice: Choice, alpha: float) -> MeasureTest:
    """Return the results of the test that was chosen."""
    compute, library = _CARRIED_OUT[choice.method]
    with quiet():
        effects = tuple(_effect(data, result, alpha) for result in compute(data, choice))
    notes = [
        choice.fit.terms.note,
        _NOTES.get(choice.method, ""),
        _balance_note(data, choice),
        _variances_note(choice),
        _size_note(data, choice),
    ]
    return MeasureTest(
        choice.method, choice.reason, effects, f"{library} {version(library)}", tuple(filter(None, notes))
    )


def _effect(data: MeasureData, result: _Result, alpha: float) -> Effect:
    """Return a line of the table of tests, with its conclusion in plain words; a p-value of NaN becomes None."""
    factors = result.factors or data.factors
    statistic, p_value = float(result.statistic), float(result.p_value)
    if not all(map(math.isfinite, (p_value, statistic, *result.freedom))):
        conclusion = f"The effect of {enumerated(factors)} was not computed."
        return Effect(factors, result.name, None, (), None, None, (), conclusion)
    is_significant = p_value < alpha
    sizes = tuple(size for size in result.sizes if size is not None)
    freedom = ", ".join(f"{each:g}" if float(each).is_integer() else f"{each:.2f}" for each in result.freedom)
    figures = f"{result.name}{f'({freedom})' if freedom else ''} = {statistic:.3g}, {p_in_words(p_value)}"
    conclusion = _conclusion(data.name, factors, figures, sizes, is_significant)
    return Effect(factors, result.name, statistic, result.freedom, p_value, is_significant, sizes, conclusion)


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


def _student(data: MeasureData, choice: Choice) -> Iterator[_Result]:
    first, second = (group.values for group in data.groups(data.factors))
    found = stats.ttest_ind(first, second, equal_var=choice.method is TestMethod.STUDENT_T)
    sizes = two_group_effects(first, second, by_ranks=False)
    yield _Result("t", found.statistic, (float(found.df),), found.pvalue, sizes)


def _mann_whitney(data: MeasureData, _choice: Choice) -> Iterator[_Result]:
    first, second = (group.values for group in data.groups(data.factors))
    found = stats.mannwhitneyu(first, second, method="auto")
    yield _Result("U", found.statistic, (), found.pvalue, two_group_effects(first, second, by_ranks=True))


def _anova(data: MeasureData, choice: Choice) -> Iterator[_Result]:
    from statsmodels.stats.oneway import anova_oneway  # noqa: PLC0415 - takes a second to import

    groups = [group.values for group in data.groups(data.factors)]
    found = anova_oneway(groups, use_var="equal" if choice.method is TestMethod.ANOVA else "unequal")
    # Eta squared is a share of the sums of squares, whichever way the test weighs the groups.
    (term,) = choice.fit.tests.values()
    size = eta_squared(term.f_value, term.freedom)
    yield _Result("F", found.statistic, (float(found.df_num), float(found.df_denom)), found.pvalue, (size,))


def _kruskal_wallis(data: MeasureData, _choice: Choice) -> Iterator[_Result]:
    groups = [group.values for group in data.groups(data.factors)]
    found = stats.kruskal(*groups)
    yield _Result("H", found.statistic, (len(groups) - 1.0,), found.pvalue, (eta_squared_of_ranks(groups),))


def _linear(data: MeasureData, choice: Choice) -> Iterator[_Result]:
    is_ranked = choice.method is TestMethod.ALIGNED_RANKS
    for factors in choice.fit.terms.effects:
        fit = fit_aligned(data, choice.fit.terms, factors) if is_ranked else choice.fit
        test = fit.robust_tests[factors] if choice.method is TestMethod.ROBUST_ANOVA else fit.tests[factors]
        # As of a one-way analysis: the size is a share of the sums of squares, whichever way the test weighs the runs.
        size = eta_squared(fit.tests[factors].f_value, test.freedom, is_partial=True)
        yield _Result("F", test.f_value, test.freedom, test.p_value, (size,), factors)


def _paired_t(data: MeasureData, _choice: Choice) -> Iterator[_Result]:
    differences = paired_differences(data)
    found = stats.ttest_1samp(differences, 0.0)
    yield _Result("t", found.statistic, (float(found.df),), found.pvalue, (paired_d(differences),))


def _wilcoxon(data: MeasureData, _choice: Choice) -> Iterator[_Result]:
    differences = paired_differences(data)
    found = stats.wilcoxon(differences)
    yield _Result("W", found.statistic, (), found.pvalue, (paired_rank_biserial(differences),))


def _friedman(data: MeasureData, _choice: Choice) -> Iterator[_Result]:
    wide = data.by_block()
    levels = data.levels(data.factors[0])
    found = stats.friedmanchisquare(*(wide[level].to_numpy(dtype=np.float64) for level in levels))
    size = kendalls_w(float(found.statistic), len(wide), len(levels))
    yield _Result("chi2", found.statistic, (len(levels) - 1.0,), found.pvalue, (size,))


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


def _mixed(data: MeasureData, choice: Choice) -> Iterator[_Result]:
    is_ranked = choice.method is TestMethod.MIXED_ALIGNED_RANKS
    of_values = None if is_ranked else mixed_model(data, choice)
    for factors in choice.fit.terms.effects:
        results = of_values or mixed_model(data, choice, aligned_ranks(data, factors))
        table = results.wald_test_terms(scalar=True).table
        row = table.loc[formula_of(data, [factors], with_blocks=False).removeprefix("y ~ ")]
        # Wald's chi squared would hold for many blocks only.
        freedom = (float(row["df_constraint"]), choice.fit.freedom_within(factors))
        f_value = float(row["statistic"]) / freedom[0]
        p_value = float(stats.f.sf(f_value, *freedom))
        sizes = (eta_squared(f_value, freedom, is_partial=True),) if math.isfinite(p_value) else ()
        yield _Result("F", f_value, freedom, p_value, sizes, factors)


#: What computes each test, and the library that does the work.
_CARRIED_OUT: Mapping[TestMethod, tuple[Callable[[MeasureData, Choice], Iterator[_Result]], str]] = {
    TestMethod.STUDENT_T: (_student, "scipy"),
    TestMethod.WELCH_T: (_student, "scipy"),
    TestMethod.MANN_WHITNEY: (_mann_whitney, "scipy"),
    TestMethod.PAIRED_T: (_paired_t, "scipy"),
    TestMethod.WILCOXON: (_wilcoxon, "scipy"),
    TestMethod.ANOVA: (_anova, "statsmodels"),
    TestMethod.WELCH_ANOVA: (_anova, "statsmodels"),
    TestMethod.KRUSKAL_WALLIS: (_kruskal_wallis, "scipy"),
    TestMethod.FACTORIAL_ANOVA: (_linear, "statsmodels"),
    TestMethod.ROBUST_ANOVA: (_linear, "statsmodels"),
    TestMethod.BLOCKED_ANOVA: (_linear, "statsmodels"),
    TestMethod.ALIGNED_RANKS: (_linear, "statsmodels"),
    TestMethod.FRIEDMAN: (_friedman, "scipy"),
    TestMethod.MIXED_MODEL: (_mixed, "statsmodels"),
    TestMethod.MIXED_ALIGNED_RANKS: (_mixed, "statsmodels"),
}
