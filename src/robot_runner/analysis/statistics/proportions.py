"""Yes-or-no measures, such as the success of a mission: proportions, exact tests, and pairs of treatments.

Runs are compared within strata: runs of the same block that differ only in the tested factor. A test is conditional on
the treatments and the number of yes in each stratum (Cochran 1954; Mantel and Haenszel 1959; Agresti, Categorical Data
Analysis, 2013, chapter 8): its p-value is the probability that random allocation of the yes is as uneven. So it holds
its level for few runs, too. Tests of means do not: a treatment that always succeeds has no variance.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import version
from itertools import combinations
from typing import TYPE_CHECKING, Self

import numpy as np
from scipy import stats

from robot_runner.analysis.arrays import Floats
from robot_runner.analysis.statistics.analysed_design import MeasureData
from robot_runner.analysis.statistics.outcome import Proportion, Proportions
from robot_runner.analysis.statistics.post_hoc import with_adjusted
from robot_runner.analysis.statistics.score_intervals import DIFFERENCE, Share, score_ends, sum_ends, sum_of
from robot_runner.analysis.statistics.tested import (
    Comparison,
    Effect,
    Interval,
    MeasureTest,
    NotComputed,
    PostHoc,
    TestMethod,
)
from robot_runner.analysis.statistics.tests import Choices, stranded_in_words
from robot_runner.core.words import counted, enumerated, listed

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from robot_runner.analysis.statistics.grouped_runs import Group

    Integers = NDArray[np.int64]

#: The names of the estimand in the report.
PROPORTION = "proportion"
QUANTITY = "proportions, in percentage points"
#: The test of a pair, which determines its significance, and the interval of the difference.
_METHOD = "exact tests, beside Newcombe's score intervals"
_LEVEL = 0.95
_STATISTIC = "Mantel-Haenszel \N{GREEK SMALL LETTER CHI}\N{SUPERSCRIPT TWO}"
_PAIR = 2
#: Random tables for three or more treatments: a p-value of 5 % is then known to 0.1 percentage points.
_DRAWS = 49_999
#: With many strata, fewer tables are drawn, so that a test takes seconds at most; 5 % is then known to 0.2 points.
_FEWEST_DRAWS, _MOST_DEALT = 9_999, 20_000_000
_SEED = 20210525
#: Tables are as probable as the observed one if their probabilities differ by rounding only (as in R's fisher.test).
_ROUNDING = 1e-7
#: A smaller statistic is 0 but for rounding; one that is not is larger than this in tables of many million runs, too.
_NOTHING = 1e-9


def proportions_of(data: MeasureData, most_groups: int) -> Proportions:
    """Return the proportions of yes: over all runs, for each treatment, and for each combination.

    Values are 1 for yes and 0 for no. If there are more groups than `most_groups`, none is described.
    """

    def by(factors: tuple[str, ...]) -> tuple[Proportion, ...]:
        groups = data.described_groups(factors) if len(factors) > 1 else data.applied_groups(factors)
        return tuple(map(_proportion, groups)) if len(groups) <= most_groups else ()

    return Proportions(
        overall=_proportion(data.described_groups(())[0]),
        by_treatment=tuple(each for factor in data.factors for each in by((factor,))),
        by_combination=by(data.factors) if len(data.factors) > 1 else (),
    )


def _proportion(group: Group) -> Proportion:
    n, count = len(group.values), int(np.sum(group.values))
    if not n:
        return Proportion(group.treatments, 0, group.missing, 0, None, None)
    return Proportion(group.treatments, n, group.missing, count, 100 * count / n, _interval(group, count / n, n))


def _interval(group: Group, share: float, n: float) -> Interval | None:
    """Return Wilson's interval; with several runs per unit, for the effective number of runs.

    Source of the latter: Dean and Pagano, Journal of Survey Statistics and Methodology 3, 2015.
    """
    reach, method = float(stats.norm.isf((1 - _LEVEL) / 2)), "Wilson's score interval"
    if group.of_units is not None:
        variance, units = group.of_units
        if units == 1:
            return None
        of_runs = share * (1 - share) / n
        n /= min(max(variance / of_runs, 1.0), n / units) if of_runs else n / units
        reach, method = float(stats.t.isf((1 - _LEVEL) / 2, units - 1)), f"{method}{group.in_words}"
    low, high = score_ends(share, n, reach)
    return Interval(100 * low, 100 * high, _LEVEL, method)


# Tests of effects.


def carry_out_proportions(data: MeasureData, choices: Choices) -> MeasureTest | NotComputed:
    """Return the tests of the main effects, without adjusted p-values and conclusions.

    Values are 1 for yes and 0 for no; the estimand is ignored.
    """
    problem = problem_of(data)
    if problem:
        return NotComputed("the test", problem)
    effects = tuple(_effect(data, factor, choices.alpha) for factor in data.factors)
    several, where = len(data.factors) > 1, " and of one block" if data.is_blocked else ""
    alike = f" that differ in no other factor{where}" if several else where.replace(" and", "", 1)
    return MeasureTest(
        method=TestMethod.PROPORTIONS,
        estimand=PROPORTION,
        reason=f"The measure is yes or no: proportions are compared among runs{alike}, and chance deals out the yes.",
        effects=effects,
        family="",
        family_size=len(effects),
        spread=None,
        library=f"scipy {version('scipy')}",
        notes=tuple(_notes(data, effects)),
    )


def problem_of(data: MeasureData, *, is_of_bound: bool = False) -> str:
    """Return why proportions are not tested; empty where they are. Equal ones may still be within a bound."""
    if not data.factors:
        return "all runs with a value have the same treatments, so that there is nothing to compare."
    if np.ptp(data.values) == 0 and not is_of_bound:
        return f"all runs say {'yes' if data.values[0] else 'no'}."
    if data.stranded:
        return stranded_in_words(data)
    if not data.known.is_plain:
        fit = "proportions are tested in factorials, of runs by themselves or in blocks"
        return f"{fit}, and this is another design ({data.known.in_words})."
    return ""


def _notes(data: MeasureData, effects: Sequence[Effect]) -> Iterator[str]:
    if (treatments := data.treatments).conditions:
        counts = "each run counts the same, whatever it has of a factor that is nested within"
        yield treatments.in_words("proportion", counts)
    if len(data.factors) > 1:
        yield "Interactions of proportions are not tested: compare the proportions of the combinations."
    unknown = [each.factors[0] for each in effects if each.p_value is None]
    if unknown:
        yield f"No runs with different answers differ in nothing but {enumerated(unknown)}: that is not tested."
    if data.is_blocked and runs_together(data) > 1:
        # In 10 to 34 %, by simulation: 4 to 10 blocks of 5 to 20 runs, log-odds that differ by a deviation of 1.
        yield (
            f"Too few blocks ({data.block or 'block'}) hold all combinations, or all of these respond in the same way: "
            "so runs of one count as independent of each other. Where blocks respond differently to a treatment, a "
            "difference of all of them is then found too often. Check whether it is that of each."
        )
    if any(len(data.levels(factor)) > _PAIR for factor in data.factors):
        yield f"p-values of three and more treatments are shares of tables dealt by chance: {_FEWEST_DRAWS:,} and more."


def runs_together(data: MeasureData) -> int:
    """Return how many runs of one treatment a block has at the most."""
    counts = (data.frame.groupby([data.frame[name].astype(str), data.blocks]).size() for name in data.factors)
    return int(max((each.max() for each in counts), default=0))


def _effect(data: MeasureData, factor: str, alpha: float) -> Effect:
    table = Strata.of(data, factor, data.levels(factor))
    statistic, freedom = table.statistic()
    p_value = table.p_value() if freedom else None
    stratified = "exact Cochran-Mantel-Haenszel" if len(table.runs) > 1 else "Fisher's exact"
    return Effect(
        factors=(factor,),
        test=stratified if table.runs.shape[1] == _PAIR else "Cochran-Mantel-Haenszel, permuted",
        statistic_name=_STATISTIC,
        statistic=statistic if freedom else None,
        degrees_of_freedom=(float(freedom),) if freedom else (),
        p_value=p_value,
        adjusted_p_value=p_value,
        is_significant=None if p_value is None else p_value < alpha,
        effect_sizes=(),
        check=None,
        conclusion="",
        within=data.within([factor]),
    )


@dataclass(frozen=True, slots=True)
class Strata:
    """The numbers of runs and of yes of each treatment of a factor, in strata of otherwise equal runs.

    Attributes:
        runs: (strata, treatments).
        yes: (strata, treatments).
    """

    runs: Integers
    yes: Integers

    @classmethod
    def of(cls, data: MeasureData, factor: str, levels: Sequence[str]) -> Self:
        """Count the runs with these treatments of a factor."""
        return next(cls.of_each(data, factor, levels, data.values[None]))

    @classmethod
    def of_each(cls, data: MeasureData, factor: str, levels: Sequence[str], answers: Floats) -> Iterator[Self]:
        """Count the runs with these treatments of a factor, in many experiments.

        The data is of one of them; answers are 1 for yes and 0 for no, (experiments, runs).
        """
        is_of = np.asarray(data.frame[factor].isin(levels))
        frame = data.frame[is_of]
        alike = frame[data.strata_columns(but=factor)].astype(str)
        numbers = alike.groupby(list(alike.columns)).ngroup() if len(alike.columns) else alike.index * 0
        runs = np.zeros((int(numbers.max()) + 1, len(levels)), dtype=np.int64)
        places = frame[factor].astype(str).map({level: place for place, level in enumerate(levels)})
        cells = np.asarray(numbers), np.asarray(places)
        np.add.at(runs, cells, 1)
        for told in answers[:, is_of]:
            yes = np.zeros_like(runs)
            np.add.at(yes, cells, told.astype(np.int64))
            yield cls(runs, yes)

    @property
    def pooled(self) -> Strata:
        """All runs in one stratum."""
        return Strata(self.runs.sum(axis=0, keepdims=True), self.yes.sum(axis=0, keepdims=True))

    def statistic(self) -> tuple[float, int]:
        """Return the generalised Mantel-Haenszel statistic and its degrees of freedom, which may be 0."""
        inverse, rank = self._spread()
        excess = (self.yes - self._expected()).sum(axis=0)
        found = float(excess @ inverse @ excess)
        return found if found > _NOTHING else 0.0, rank

    def p_value(self, draws: int = _DRAWS) -> float:
        """Return the probability of tables that are at least as uneven, given the runs and yes of each stratum.

        For three or more treatments, random tables are drawn.
        """
        return self._exact() if self.runs.shape[1] == _PAIR else self._permuted(draws)

    def _expected(self) -> Floats:
        totals = self.runs.sum(axis=1, keepdims=True)
        return np.asarray(self.runs * self.yes.sum(axis=1, keepdims=True) / totals, dtype=np.float64)

    def _spread(self) -> tuple[Floats, int]:
        """Return the generalised inverse of the null covariance of yes, and its rank."""
        return _spread_of(*self._margins)

    @property
    def _margins(self) -> tuple[tuple[tuple[int, ...], ...], tuple[int, ...]]:
        """The runs of each treatment, and the number of yes, of each stratum."""
        return tuple(map(tuple, self.runs.tolist())), tuple(self.yes.sum(axis=1).tolist())

    def _exact(self) -> float:
        """Return the probability of all tables that are no more probable than the observed one."""
        chances, least = np.ones(1), 0
        for sizes, count in zip(self.runs, self.yes.sum(axis=1), strict=True):
            n, first = int(sizes.sum()), int(sizes[0])
            low, high = max(0, int(count) - n + first), min(int(count), first)
            chances = np.convolve(chances, _chances(low, high, n, int(count), first))
            least += low
        seen = chances[int(self.yes[:, 0].sum()) - least]
        found = min(1.0, chances[chances <= seen * (1 + _ROUNDING)].sum())
        return float(f"{found:.12g}")  # it is a fraction, which may be the level itself

    def _permuted(self, draws: int) -> float:
        draws = min(draws, max(_FEWEST_DRAWS, _MOST_DEALT // len(self.runs)))
        drawn = _statistics_drawn(*self._margins, draws)
        as_large = draws - np.searchsorted(drawn, self.statistic()[0] * (1 - _ROUNDING) - _NOTHING)
        return float((1 + as_large) / (1 + draws))

    def shares(self, weights: Sequence[float] = DIFFERENCE) -> tuple[Share, ...] | None:
        """Return the share of yes of each treatment; None if no stratum has runs of all.

        Strata have Mantel-Haenszel weights, so that treatments with unequal numbers of runs are compared within strata.
        With equal numbers in all strata, all runs have the same weight. A stratum counts by how precisely it tells the
        sum with these weights of treatments.
        """
        has_all = (self.runs > 0).all(axis=1)
        runs, yes = self.runs[has_all], self.yes[has_all]
        if not len(runs):
            return None
        of_strata = 1 / (np.square(weights) / runs).sum(axis=1)
        of_strata = of_strata / of_strata.sum()
        values, worth = of_strata @ (yes / runs), 1 / (of_strata**2 @ (1 / runs))
        return tuple(Share(min(1.0, float(value)), float(n)) for value, n in zip(values, worth, strict=True))


# Thousands of simulated experiments have the same margins.


@lru_cache(maxsize=4096)
def _spread_of(runs: tuple[tuple[int, ...], ...], yes: tuple[int, ...]) -> tuple[Floats, int]:
    """Return the generalised inverse of the null covariance of yes, and its rank, given the margins of each stratum."""
    covariance = np.zeros((len(runs[0]),) * 2)
    for sizes, count in zip(np.asarray(runs, dtype=np.float64), yes, strict=True):
        n = sizes.sum()
        if n > 1:
            covariance += count * (n - count) / (n * n * (n - 1)) * (np.diag(sizes) * n - np.outer(sizes, sizes))
    inverse = np.asarray(np.linalg.pinv(covariance, hermitian=True), dtype=np.float64)
    return inverse, int(np.linalg.matrix_rank(covariance, hermitian=True))


@lru_cache(maxsize=128)
def _statistics_drawn(runs: tuple[tuple[int, ...], ...], yes: tuple[int, ...], draws: int) -> Floats:
    """Return the statistics of random tables with these margins of each stratum, in ascending order."""
    random = np.random.default_rng(_SEED)
    excess = np.zeros((draws, len(runs[0])))
    for sizes, count in zip(np.asarray(runs), yes, strict=True):
        if 0 < count < sizes.sum():
            excess += random.multivariate_hypergeometric(sizes, count, size=draws) - sizes * count / sizes.sum()
    return np.sort(np.einsum("ij,jk,ik->i", excess, _spread_of(runs, yes)[0], excess))


@lru_cache(maxsize=4096)
def _chances(low: int, high: int, runs: int, yes: int, first: int) -> Floats:
    """Return the probability of each number of yes, from low to high, among the runs of the first treatment."""
    return np.asarray(stats.hypergeom.pmf(np.arange(low, high + 1), runs, yes, first), dtype=np.float64)


# Pairs of treatments.


def compare_proportions(data: MeasureData, choices: Choices, most_pairs: int) -> Iterator[PostHoc | NotComputed]:
    """Compare the treatments of each factor pair by pair."""
    for factor in data.factors:
        pairs = list(combinations(data.levels(factor), 2))
        if len(pairs) > most_pairs:
            why = f"{counted(len(data.levels(factor)), 'treatment')} make {len(pairs):,} pairs: compare chosen ones."
            yield NotComputed(f"pairwise comparisons of {factor}", why)
            continue
        if not Strata.of(data, factor, data.levels(factor)).statistic()[1]:
            why = f"no runs with different answers differ in nothing but {factor}."
            yield NotComputed(f"pairwise comparisons of {factor}", why)
            continue
        tables = {pair: Strata.of(data, factor, pair) for pair in pairs}
        known = {pair: shares for pair, table in tables.items() if (shares := table.shares()) is not None}
        if told := with_adjusted(
            [_comparison(pair, shares, tables[pair].p_value(), choices.alpha) for pair, shares in known.items()],
            choices,
        ):
            yield PostHoc((factor,), _METHOD, choices.correction, QUANTITY, told, data.within([factor]))
        if apart := [" and ".join(pair) for pair in pairs if pair not in known]:
            why = f"no run of one differs from a run of the other in nothing but {factor}."
            yield NotComputed(f"comparisons of {listed(apart)}", why)


def _comparison(pair: tuple[str, str], shares: Sequence[Share], p_value: float, alpha: float) -> Comparison:
    low, high = sum_ends(shares, DIFFERENCE, float(stats.norm.isf(alpha / 2)))
    return Comparison(
        *pair,
        difference=100 * sum_of(shares, DIFFERENCE),
        interval=Interval(100 * low, 100 * high, 1 - alpha, "Newcombe's score interval"),
        statistic_name="",
        statistic=None,
        degrees_of_freedom=None,
        p_value=p_value,
        adjusted_p_value=None,
        is_significant=None,
        check_p_value=None,
        effect_sizes=(),
    )
