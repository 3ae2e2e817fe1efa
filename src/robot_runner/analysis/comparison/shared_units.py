"""Runs that vary together, as those of one block, whole plot, subject or robot: which they are, and how means vary.

What differs by chance from one experiment to the next is then its units as a whole, and not its runs alone. The
variance of a mean is robust to whatever runs of a unit share (Liang and Zeger, Biometrika 73, 1986); where units cross,
as days and operators do, it is that of each kind, less what both have (Cameron, Gelbach and Miller, Journal of Business
and Economic Statistics 29, 2011). Units are few: bias and degrees of freedom are corrected as Bell and McCaffrey do
(Survey Methodology 28, 2002), for units that vary as a whole. With as many runs in each unit, the test of two means is
Welch's of the means of units.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy import stats

from robot_runner.analysis.arrays import Floats, Numbers
from robot_runner.analysis.statistics.known_design import KnownDesign
from robot_runner.analysis.statistics.proportions import Share
from robot_runner.core.events.measure import ROBOTS_OWNER

if TYPE_CHECKING:
    import pandas as pd
    from numpy.typing import NDArray

    from robot_runner.analysis.results import Results

    #: For each kind of unit, the number of the unit of each run.
    Kinds = tuple[Numbers, ...]

#: What variances of means that are equal may be once they were computed, of their squared size.
_ROUNDING = 1e-26


@dataclass(frozen=True, slots=True)
class UnitColumns:
    """The columns of an experiment that are no treatments: blocks, whole plots, subjects, periods, robots.

    Attributes:
        every: all of them.
        kinds: for each kind of unit that runs share by chance, the columns that tell which unit it is, its own first.
            Periods are no such units: they are the same in each experiment.
    """

    every: tuple[str, ...] = ()
    kinds: tuple[tuple[str, ...], ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """What the kinds are called."""
        return tuple(dict.fromkeys(columns[0] for columns in self.kinds))

    def numbers(self, runs: pd.DataFrame) -> Kinds:
        """Return the number of the unit of each run, of each kind."""
        return tuple(
            np.asarray(runs[list(columns)].astype("str").groupby(list(columns), sort=False).ngroup(), dtype=np.intp)
            for columns in self.kinds
        )


def unit_columns_of_both(*experiments: Results) -> tuple[UnitColumns, ...]:
    """Return what the designs of two experiments add beside treatments.

    Several robots are units unless both experiments have used the very same ones: those are the same units, and how
    they differ adds nothing to the difference of experiments that share the runs out among them alike.
    """
    found = [_unit_columns(each) for each in experiments]
    if not same_robots(*experiments):
        robots = map(_robots_column, experiments)
        found = [
            replace(each, kinds=(*each.kinds, (name,))) if name else each
            for each, name in zip(found, robots, strict=True)
        ]
    shared = dict.fromkeys(kind for each in found for kind in each.kinds)
    return tuple(
        replace(
            each,
            kinds=tuple(
                kind
                for kind in shared
                if (kind in each.kinds or kind[0] not in each.names) and _are_several(results.done, kind)
            ),
        )
        for each, results in zip(found, experiments, strict=True)
    )


def same_robots(*experiments: Results) -> tuple[str, ...]:
    """Return the several robots that each of the experiments used; nothing where they differ, or are planned blocks."""
    found: set[tuple[str, ...]] = set()
    for each in experiments:
        name = _robots_column(each)
        is_planned = name in _unit_columns(each).every
        found.add(() if name is None or is_planned else tuple(sorted(map(str, each.done[name].dropna().unique()))))
    return found.pop() if len(found) == 1 else ()


def _are_several(done: pd.DataFrame, kind: Sequence[str]) -> bool:
    """Return whether there are several units of a kind; one alone tells nothing of how they differ, and is no kind."""
    return set(kind) <= set(done) and len(done[list(kind)].astype("str").drop_duplicates()) > 1


def _unit_columns(results: Results) -> UnitColumns:
    """Return what the design of an experiment adds beside its treatments, as its report takes it."""
    known = KnownDesign.of_manifest(results.manifest, results.runs.columns)
    planned = results.plan.blocks if results.plan is not None else None
    block = planned if planned in results.runs.columns else results.block
    blocks = tuple(dict.fromkeys(name for name in (*known.blocks, block) if name))
    done = results.done
    kinds: list[tuple[str, ...]] = [(name,) for name in blocks if name != known.period]
    if known.whole_plot:
        kinds.insert(0, (known.whole_plot, *_numbered_anew(done, known.whole_plot, blocks)))
    return UnitColumns((*blocks, *filter(None, [known.whole_plot])), tuple(kinds))


def _numbered_anew(done: pd.DataFrame, plot: str, blocks: Sequence[str]) -> Iterator[str]:
    """Yield the blocks within which whole plots are numbered anew: several of them have a plot of the same number."""
    plots = done.groupby(plot, observed=True)
    return (name for name in blocks if len(done) and plots[name].nunique().max() > 1)


def _robots_column(results: Results) -> str | None:
    """Return the column that says on which of several robots a run was executed, if there were several."""
    owned = (name for name in results.measures if results.columns[name].owner == ROBOTS_OWNER)
    return next((name for name in owned if _are_several(results.done, (name,))), None)


class Units(NamedTuple):
    """The units of the runs of one combination, in the first and the second experiment."""

    first: Kinds = ()
    second: Kinds = ()
    names: tuple[str, ...] = ()

    @classmethod
    def of(cls, runs: Sequence[pd.DataFrame], columns: Sequence[UnitColumns]) -> Units:
        """Return the units of the runs of a combination in both experiments."""
        first, second = (each.numbers(rows) for rows, each in zip(runs, columns, strict=True))
        several = [
            kind[0]
            for each, units in zip(columns, (first, second), strict=True)
            for kind, own in zip(each.kinds, units, strict=True)
            if _is_shared(own)
        ]
        return cls(first, second, tuple(dict.fromkeys(several)))

    def of_runs(self, first: NDArray[np.bool_], second: NDArray[np.bool_]) -> Units:
        """Return the units of some of the runs, numbered without gaps."""
        ours, theirs = (
            tuple(_crossed([each[chosen]]) for each in kinds)
            for kinds, chosen in zip(self.kinds, (first, second), strict=True)
        )
        return Units(ours, theirs, self.names)

    @property
    def name(self) -> str:
        """What such a unit is called."""
        return " or ".join(self.names)

    @property
    def kinds(self) -> tuple[Kinds, Kinds]:
        """The units of both experiments."""
        return self.first, self.second

    @property
    def of_pairs(self) -> Kinds:
        """The units of pairs: those of either run."""
        return (*self.first, *self.second)

    @property
    def are_shared(self) -> bool:
        """Whether several runs are of one unit, in either experiment."""
        return any(map(_is_shared, self.of_pairs))

    @property
    def counts(self) -> tuple[int | None, int | None]:
        """How many units each experiment has, of the kind of which there are fewest; None where runs are apart."""
        shared = [[_count(each) for each in kinds if _is_shared(each)] for kinds in self.kinds]
        return min(shared[0], default=None), min(shared[1], default=None)

    @property
    def why_unknown(self) -> str:
        """Why units do not tell how much they differ by chance; empty where they do."""
        if 1 not in self.counts:
            return ""
        return f"All runs of one experiment are of one {self.name}: how much these differ by chance is not known."

    @property
    def in_words(self) -> str:
        """What a test or an interval has to say where runs of a unit count together."""
        return f", runs of one {self.name} counting together" if self.are_shared else ""


#: Runs that stand by themselves.
APART = Units()


class Estimate(NamedTuple):
    """A mean, the variance of it, and the degrees of freedom of that."""

    mean: float
    variance: float
    freedom: float


def estimate_of(values: Floats, kinds: Kinds) -> Estimate:
    """Return the mean of two and more runs with its variance, where those of one unit vary together.

    Example:
        >>> estimate_of(np.array([1.0, 1.0, 3.0, 3.0]), (np.array([0, 0, 1, 1]),))
        Estimate(mean=2.0, variance=1.0, freedom=1.0)
    """
    mean = float(values.mean())
    shared = _coarsest([each for each in kinds if _is_shared(each)])
    if not shared:
        return Estimate(mean, float(values.var(ddof=1)) / len(values), len(values) - 1)
    parts = [
        (_variance(values - mean, _crossed(several)), len(several))
        for count in range(1, len(shared) + 1)
        for several in combinations(shared, count)
    ]
    both = sum(variance * (-1) ** (count + 1) for (variance, _), count in parts)
    # By chance the sum may be less than what the units of one kind say: no mean is better known than that.
    variance = max([both, *(each for (each, _), count in parts if count == 1)])
    fewest = min(freedom for (_, freedom), _ in parts)
    if variance <= _ROUNDING * mean**2:
        return Estimate(mean, 0.0, fewest)
    spread = sum(each**2 / freedom for (each, freedom), _ in parts)
    return Estimate(mean, variance, max(variance**2 / spread, fewest))


def _variance(residuals: Floats, units: Numbers) -> tuple[float, float]:
    """Return the variance of a mean by what units add to it, and its degrees of freedom."""
    count = np.bincount(units)
    sums, share = np.bincount(units, residuals) / len(units), count / len(units)
    weights, total = share**2, float(share @ share)
    centring = np.eye(len(count)) - share
    form = centring.T @ (weights[:, None] * centring)
    return total / float(np.trace(form)) * float(sums @ sums), float(np.trace(form) ** 2 / np.sum(form * form))


def _count(units: Numbers) -> int:
    return len(np.unique(units))


def _is_shared(units: Numbers) -> bool:
    return _count(units) < len(units)


def _crossed(kinds: Sequence[Numbers]) -> Numbers:
    """Return the number of what each run has of all of these kinds, from 0 and without gaps."""
    return np.asarray(np.unique(np.column_stack(kinds), axis=0, return_inverse=True)[1].ravel(), dtype=np.intp)


def _coarsest(kinds: Sequence[Numbers]) -> list[Numbers]:
    """Return the kinds of units that lie in no units of another kind."""
    found: list[Numbers] = []
    for each in sorted(kinds, key=_count):
        if all(_count(_crossed((each, other))) > _count(each) for other in found):
            found.append(each)
    return found


def shares_of(first: Floats, second: Floats, units: Units) -> tuple[Share, Share, Any]:
    """Return two proportions, each of as many runs as it is worth, and what their difference is distributed as.

    Where answers vary together, it is t in the place of z, with the degrees of freedom of the experiment that has fewer
    (Dean and Pagano, Journal of Survey Statistics and Methodology 3, 2015).
    """
    shares = []
    freedoms = []
    for values, kinds, count in zip((first, second), units.kinds, units.counts, strict=True):
        share, runs = float(values.mean()), float(len(values))
        if count is not None:
            found, of_runs = estimate_of(values, kinds), share * (1 - share) / runs
            runs /= min(max(found.variance / of_runs, 1.0), runs / count) if of_runs else runs / count
            freedoms.append(found.freedom)
        shares.append(Share(share, runs))
    return *shares, stats.t(min(freedoms)) if freedoms else stats.norm


class MeansTest(NamedTuple):
    """Student's t of a difference whose variance is known to some degrees of freedom; as scipy's tests are."""

    difference: float
    error: float
    freedom: float
    alternative: str = "two-sided"

    @classmethod
    def of_means(cls, one: Estimate, other: Estimate, alternative: str = "two-sided") -> MeansTest:
        """Test the difference of two independent means, one less other, with Welch's degrees of freedom."""
        variance = one.variance + other.variance
        spread = sum(each.variance**2 / each.freedom for each in (one, other))
        return cls(one.mean - other.mean, variance**0.5, variance**2 / spread if spread else 1.0, alternative)

    @classmethod
    def of_pairs(cls, differences: Estimate, alternative: str = "two-sided") -> MeansTest:
        """Test whether the mean of differences is 0."""
        return cls(differences.mean, differences.variance**0.5, differences.freedom, alternative)

    @property
    def pvalue(self) -> float:
        """How probable a difference is that is at least as large, where there is none."""
        t = self.difference / self.error
        if self.alternative == "two-sided":
            return 2 * float(stats.t.sf(abs(t), self.freedom))
        return float(stats.t.sf(t if self.alternative == "greater" else -t, self.freedom))

    def confidence_interval(self, confidence_level: float) -> Ends:
        """Return where the difference lies with this confidence."""
        reach = self.error * float(stats.t.isf((1 - confidence_level) / 2, self.freedom))
        return Ends(self.difference - reach, self.difference + reach)


class Ends(NamedTuple):
    """The ends of an interval."""

    low: float
    high: float
