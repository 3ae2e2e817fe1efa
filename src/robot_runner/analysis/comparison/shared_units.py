"""Units (blocks, whole plots, subjects, robots) whose runs vary together, and the cluster-robust variance of means.

Chance between experiments is then the difference between units, not only between runs. The variance of a mean is robust
to any dependence of a unit's runs (Liang and Zeger, Biometrika 73, 1986). Where units cross, as days and operators do,
it is the sum for each kind, minus that of their intersection (Cameron, Gelbach and Miller, Journal of Business and
Economic Statistics 29, 2011). As units are few, bias and degrees of freedom are corrected like Bell and McCaffrey
(Survey Methodology 28, 2002), for runs of a unit that vary as a whole. With the same number of runs in each unit, the
test of two means is Welch's test of the units' means.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy import special, stats

from robot_runner.analysis.arrays import Floats, Numbers
from robot_runner.analysis.statistics.known_design import KnownDesign
from robot_runner.analysis.statistics.score_intervals import Share
from robot_runner.analysis.statistics.tested import Interval
from robot_runner.core.events.measure import ROBOTS_OWNER

if TYPE_CHECKING:
    import pandas as pd
    from numpy.typing import NDArray

    from robot_runner.analysis.results import Results

    #: For each kind of unit, the index of the unit of each run.
    Kinds = tuple[Numbers, ...]

#: A variance of a mean below this share of its square is 0 but for rounding.
_ROUNDING = 1e-26


@dataclass(frozen=True, slots=True)
class UnitColumns:
    """The columns of a design that are not treatments: blocks, whole plots, subjects, periods, robots.

    Attributes:
        every: all of them.
        kinds: for each kind of random unit, the columns that identify the unit, its own first. Periods are not random
            units: they are the same in each experiment.
    """

    every: tuple[str, ...] = ()
    kinds: tuple[tuple[str, ...], ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the kinds."""
        return tuple(dict.fromkeys(columns[0] for columns in self.kinds))

    def numbers(self, runs: pd.DataFrame) -> Kinds:
        """Return the index of the unit of each run, for each kind."""
        return tuple(
            np.asarray(runs[list(columns)].astype("str").groupby(list(columns), sort=False).ngroup(), dtype=np.intp)
            for columns in self.kinds
        )


def unit_columns_of_both(*experiments: Results) -> tuple[UnitColumns, ...]:
    """Return the columns that the designs of two experiments have beside treatments.

    Several robots are units unless both experiments used the same ones: how these differ cancels out of the difference
    of experiments that distribute their runs over them in the same way.
    """
    found = [_unit_columns(each) for each in experiments]
    if not same_robots(*experiments):
        found = [
            replace(each, kinds=(*each.kinds, (name,))) if name else each
            for each, name in zip(found, map(_robots_column, experiments), strict=True)
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
    """Return the robots, if each experiment used the same several; none where they differ, or are planned blocks."""
    found: set[tuple[str, ...]] = set()
    for each in experiments:
        name = _robots_column(each)
        is_planned = name in _unit_columns(each).every
        found.add(() if name is None or is_planned else tuple(sorted(map(str, each.done[name].dropna().unique()))))
    return found.pop() if len(found) == 1 else ()


def _are_several(done: pd.DataFrame, kind: Sequence[str]) -> bool:
    """Return whether there are several units of a kind; a single one tells nothing about differences between units."""
    return set(kind) <= set(done) and len(done[list(kind)].astype("str").drop_duplicates()) > 1


def _unit_columns(results: Results) -> UnitColumns:
    """Return the columns that a design has beside treatments, as in the experiment's report."""
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
    """Return the blocks that restart the numbering of whole plots: several of them have a plot of the same number."""
    plots = done.groupby(plot, observed=True)
    return (name for name in blocks if len(done) and plots[name].nunique().max() > 1)


def _robots_column(results: Results) -> str | None:
    """Return the column of the robot on which a run was executed, if there were several robots."""
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
        """Return the units of a selection of runs, numbered without gaps."""
        ours, theirs = (
            tuple(_crossed([each[chosen]]) for each in kinds)
            for kinds, chosen in zip(self.kinds, (first, second), strict=True)
        )
        return Units(ours, theirs, self.names)

    @property
    def name(self) -> str:
        """The name of the units."""
        return " or ".join(self.names)

    @property
    def kinds(self) -> tuple[Kinds, Kinds]:
        """The units of both experiments."""
        return self.first, self.second

    @property
    def of_pairs(self) -> Kinds:
        """The units of pairs: those of both runs."""
        return (*self.first, *self.second)

    @property
    def are_shared(self) -> bool:
        """Whether several runs share a unit, in either experiment."""
        return any(map(_is_shared, self.of_pairs))

    @property
    def counts(self) -> tuple[int | None, int | None]:
        """The number of units in each experiment, of the kind with the fewest; None where runs are independent."""
        shared = [[_count(each) for each in kinds if _is_shared(each)] for kinds in self.kinds]
        return min(shared[0], default=None), min(shared[1], default=None)

    @property
    def why_unknown(self) -> str:
        """Why the variance between units is not known; empty where it is."""
        if 1 not in self.counts:
            return ""
        return f"All runs of one experiment are of one {self.name}: how much these differ by chance is not known."

    @property
    def in_words(self) -> str:
        """The words for a test or an interval where runs of a unit count together; empty where they do not."""
        return f", runs of one {self.name} counting together" if self.are_shared else ""


#: Independent runs.
APART = Units()


class Estimate(NamedTuple):
    """A mean, its variance, and the degrees of freedom of the variance.

    Student's t around the mean gives tests, confidence intervals and the posterior of the reference prior alike.
    """

    mean: float
    variance: float
    freedom: float

    @property
    def error(self) -> float:
        """The standard error."""
        return math.sqrt(self.variance)

    def less(self, other: Estimate) -> Estimate:
        """Return the difference to an independent mean, with Welch's degrees of freedom."""
        variance = self.variance + other.variance
        spread = sum(each.variance**2 / each.freedom for each in (self, other))
        return Estimate(self.mean - other.mean, variance, variance**2 / spread if spread else 1.0)

    def below(self, edge: float) -> float:
        """Return the probability below an edge; NaN for the mean itself where there is no variance."""
        return float(special.stdtr(self.freedom, np.divide(edge - self.mean, self.error)))

    def above(self, edge: float) -> float:
        """Return the probability above an edge."""
        return Estimate(-self.mean, self.variance, self.freedom).below(-edge)

    def quantile(self, share: float) -> float:
        """Return the value below which the true mean lies with this probability."""
        return float(self.mean + self.error * special.stdtrit(self.freedom, share))

    def interval(self, level: float, method: str) -> Interval:
        """Return the interval of the mean at this level."""
        return Interval(self.quantile((1 - level) / 2), self.quantile((1 + level) / 2), level, method)


def estimate_of(values: Floats, kinds: Kinds) -> Estimate:
    """Return the mean of at least two runs with its variance, where runs of a unit vary together.

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
    # By chance the sum may be smaller than the variance by one kind of unit, which is a lower limit.
    variance = max([both, *(each for (each, _), count in parts if count == 1)])
    fewest = min(freedom for (_, freedom), _ in parts)
    if variance <= _ROUNDING * mean**2:
        return Estimate(mean, 0.0, fewest)
    spread = sum(each**2 / freedom for (each, freedom), _ in parts)
    return Estimate(mean, variance, max(variance**2 / spread, fewest))


def _variance(residuals: Floats, units: Numbers) -> tuple[float, float]:
    """Return the cluster-robust variance of a mean, and its degrees of freedom."""
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
    """Return the index of each run's combination of units of these kinds, from 0 and without gaps."""
    return np.asarray(np.unique(np.column_stack(kinds), axis=0, return_inverse=True)[1].ravel(), dtype=np.intp)


def _coarsest(kinds: Sequence[Numbers]) -> list[Numbers]:
    """Return the kinds of units that are not nested in another kind."""
    found: list[Numbers] = []
    for each in sorted(kinds, key=_count):
        if all(_count(_crossed((each, other))) > _count(each) for other in found):
            found.append(each)
    return found


def shares_of(first: Floats, second: Floats, units: Units) -> tuple[Share, Share, Any]:
    """Return two proportions with their effective numbers of runs, and the distribution of their difference.

    Where answers vary together, this is t in the place of z, with the smaller degrees of freedom of the two experiments
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
