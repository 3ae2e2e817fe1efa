"""How often tests of proportions find a difference where there is none, and how often intervals hold the true one."""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy import stats

from benchmarks.table import Judged
from robot_runner.analysis.statistics.proportions import Strata
from robot_runner.analysis.statistics.score_intervals import DIFFERENCE, sum_ends

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

__all__ = ["PROPORTIONS"]

#: Tests of three and more treatments draw tables: they are computed of so many fewer experiments, from fewer draws.
_FEWER, _DRAWS = 20, 1_999
#: An exact test errs in no more than it says; how much less hangs on how few tables there are.
_ERRS = (0.0, 5.0)
#: Newcombe (1998) found a mean coverage of 95 to 96 % and a smallest one of 87 %, for small and unequal numbers.
_HOLDS = (93.0, 100.0)


class _Null(NamedTuple):
    """Runs of treatments that succeed as often, though not as often in each stratum."""

    treatments: int
    runs: int
    shares: tuple[float, ...]

    def __str__(self) -> str:
        where = "" if len(self.shares) == 1 else f" in {len(self.shares)} strata"
        return f"{self.treatments} of {self.runs} runs{where}, {', '.join(f'{each:g}' for each in self.shares)}"

    def experiments(self, random: np.random.Generator, count: int) -> list[Strata]:
        sizes = np.full((len(self.shares), self.treatments), self.runs)
        return [Strata(sizes, random.binomial(sizes, np.array(self.shares)[:, None])) for _ in range(count)]


_NULLS = (
    _Null(2, 5, (0.5,)),
    _Null(2, 10, (0.8,)),
    _Null(2, 30, (0.7,)),
    _Null(2, 30, (0.95,)),
    _Null(2, 5, (0.5, 0.8, 0.95)),
    _Null(2, 3, (0.9, 0.2, 0.5, 0.9, 0.7, 0.6)),
    _Null(3, 10, (0.8,)),
    _Null(4, 5, (0.7,)),
    _Null(3, 6, (0.9, 0.6, 0.3)),
)


def _false_positives(null: _Null, random: np.random.Generator, count: int) -> Judged:
    made = null.experiments(random, count if null.treatments == 2 else count // _FEWER)
    found = 100 * np.mean([each.statistic()[1] > 0 and each.p_value(_DRAWS) < 0.05 for each in made])
    slack = 300 * math.sqrt(0.05 * 0.95 / len(made))
    return Judged(f"false positives, {null}", float(found), float(found), _ERRS, slack=slack)


def _coverage(null: _Null, random: np.random.Generator, count: int) -> Judged:
    z = float(stats.norm.isf(0.025))
    ends = [sum_ends(shares, DIFFERENCE, z) for each in null.experiments(random, count) if (shares := each.shares())]
    found = float(100 * np.mean([low <= 0 <= high for low, high in ends]))
    return Judged(f"interval of a difference, {null}", found, found, _HOLDS)


#: Each returns a share, from a source of random numbers and how many experiments to make.
PROPORTIONS: Sequence[Callable[[np.random.Generator, int], Judged]] = (
    *(partial(_false_positives, each) for each in _NULLS),
    *(partial(_coverage, each) for each in _NULLS if each.treatments == 2),
)
