"""How often the intervals of a meta-analysis hold what they are to hold, where experiments are few and small.

`python -m benchmarks.meta_analysis --replications 10000` takes longer and is surer of the last digit.
"""

from __future__ import annotations

import argparse
import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from benchmarks.table import Row, print_table
from robot_runner.analysis.comparison.combined import combine

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from robot_runner.analysis.comparison.combined import Combined
    from robot_runner.analysis.statistics.tested import Interval

_SEED = 2021
_ALPHA = 0.05
_REPLICATIONS = 2000
_COUNTS = (3, 5, 10)
#: Standard deviations between experiments, in those between runs; runs a treatment of one experiment after another.
_BETWEEN = (0.0, 0.5, 1.5)
_RUNS = ((5,), (10,), (5, 5, 20))
_COVERED = (93.5, 97.0)
_FOUND = (3.5, 6.5)
_FEW_RUNS = "92 % and more: weights are estimated from five runs"


class _Case(NamedTuple):
    """Experiments of two treatments, without a difference on average."""

    experiments: int
    between: float
    runs: tuple[int, ...]

    def __str__(self) -> str:
        return f"k {self.experiments}, tau {self.between}, n {'/'.join(map(str, self.runs))}"

    def combined(self, random: np.random.Generator) -> tuple[Combined, float]:
        """Return what is found of one set of experiments, and the effect that a further one has."""
        estimates, errors, freedom = [], [], []
        for place in range(self.experiments):
            runs = self.runs[place % len(self.runs)]
            one, other = random.normal(size=(2, runs))
            shares = one.var(ddof=1) / runs, other.var(ddof=1) / runs
            estimates.append(float(one.mean() - other.mean() + self.between * random.normal()))
            errors.append(math.sqrt(sum(shares)))
            freedom.append(sum(shares) ** 2 * (runs - 1) / (shares[0] ** 2 + shares[1] ** 2))
        return combine(estimates, errors, freedom, alpha=_ALPHA), self.between * float(random.normal())


def main(arguments: list[str] | None = None) -> None:
    """Print coverage and false positives, each with what is expected of it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--replications", type=int, default=_REPLICATIONS, help="simulated meta-analyses a case")
    count = parser.parse_args(arguments if arguments is not None else []).replications
    random = np.random.default_rng(_SEED)
    cases = [_Case(*each) for each in ((k, tau, runs) for k in _COUNTS for tau in _BETWEEN for runs in _RUNS)]
    rows = [row for case in cases for row in _rows_of(case, random, count)]
    print_table(f"Meta-analyses of two treatments ({count:,} a case): 95 % intervals and tests at 5 %", rows)


def _rows_of(case: _Case, random: np.random.Generator, count: int) -> Iterator[Row]:
    found = [case.combined(random) for _ in range(count)]
    few = _FEW_RUNS if case.runs[0] == 5 else ""
    yield _row(f"average, {case}", [_holds(each.random.interval, 0.0) for each, _ in found], _COVERED, few)
    if not case.between:
        yield _row(f"common effect, {case}", [_holds(each.common.interval, 0.0) for each, _ in found], _COVERED, "")
        found_to_differ = [each.heterogeneity.p_value < _ALPHA for each, _ in found]
        yield _row(f"found to differ, {case}", found_to_differ, _FOUND, "")
    else:
        truth = case.between**2
        variances = [_holds(each.heterogeneity.tau_squared_interval, truth) for each, _ in found]
        yield _row(f"tau squared, {case}", variances, _COVERED, few and "92 % and more: as for the average")
        further = [_holds(each.prediction, effect) for each, effect in found]
        yield _row(f"prediction, {case}", further, _COVERED, _predicted(case))


def _predicted(case: _Case) -> str:
    if case.experiments == _COUNTS[0]:
        return "98 % and more: with one degree of freedom"
    return "87 % and more: tau is often taken for 0" if case.between < 1 else ""


def _holds(interval: Interval | None, truth: float) -> bool:
    return interval is not None and interval.low <= truth <= interval.high


def _row(name: str, happened: Sequence[bool], bounds: tuple[float, float], expectation: str) -> Row:
    share = 100 * float(np.mean(happened))
    slack = 2 * 100 * math.sqrt(_ALPHA * (1 - _ALPHA) / len(happened))
    holds = bounds[0] - slack <= share <= bounds[1] + slack
    verdict = "holds" if holds else "does not hold" if expectation else "DOES NOT HOLD"
    return Row(name, f"{share:.1f} %", "", verdict, expectation or f"{bounds[0]} to {bounds[1]} %")


if __name__ == "__main__":
    import sys

    main(sys.argv[1:])
