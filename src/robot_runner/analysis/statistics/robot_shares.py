"""Which treatments were executed on which of several robots: where shares differ, robots may pass for an effect.

Robots take turns so that each combination is executed equally often on each. That ends where one was set aside, runs
failed or were excluded.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from robot_runner.core.events.measure import ROBOTS_OWNER
from robot_runner.core.words import counted, enumerated, listed

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from robot_runner.analysis.results import Results
    from robot_runner.analysis.statistics.outcome import DesignSummary

#: Differences of shares, and of runs from what even shares would be, that rounding makes are below these.
_LEAST_SHARE, _LEAST_RUNS = 0.2, 1.0
_MOST_TOLD = 4


def robot_warnings(results: Results, design: DesignSummary) -> Iterator[str]:
    """Yield the factors whose treatments are unevenly spread over robots that are no blocks of the analysis."""
    done = results.confirming.done
    robots = [name for name in results.measures if results.columns[name].owner == ROBOTS_OWNER and name != design.block]
    for column in robots:
        for name in design.factors:
            counts = pd.crosstab(done[name].astype("str"), done[column])
            if _are_uneven(counts.to_numpy(dtype=np.float64)):
                told = [f"{treatment} {_of_robots(row)}" for treatment, row in counts.iterrows()]
                yield (
                    f"Treatments of {name} are unevenly spread over robots: {listed(told, _MOST_TOLD)}. What robots "
                    f"differ in may pass for an effect of {name}."
                )


def _are_uneven(counts: NDArray[np.float64]) -> bool:
    if counts.size == 0:
        return False
    shares = counts / counts.sum(axis=1, keepdims=True)
    even = counts.sum(axis=1, keepdims=True) * counts.sum(axis=0, keepdims=True) / counts.sum()
    return bool(np.ptp(shares, axis=0).max() > _LEAST_SHARE and np.abs(counts - even).max() > _LEAST_RUNS)


def _of_robots(row: pd.Series) -> str:
    return enumerated(f"{counted(int(runs), 'run')} on {robot}" for robot, runs in row.items() if runs)
