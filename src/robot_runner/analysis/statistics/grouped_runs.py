"""Groups: the runs of one treatment or of one combination, which are described and compared."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from robot_runner.analysis.arrays import Floats, Numbers
from robot_runner.core.words import combination_label

if TYPE_CHECKING:
    import pandas as pd
    from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Group:
    """The runs of one treatment, or of one combination, that have a value.

    Attributes:
        treatments: the treatments as texts, by factor.
        missing: how many runs of the group have no value.
        units: the number of the experimental unit of each run: its block, whole plot or subject; None for independent
            runs.
        unit: the name of such a unit.
    """

    treatments: dict[str, str]
    values: Floats
    run_ids: tuple[str, ...]
    missing: int = 0
    units: Numbers | None = None
    unit: str = ""

    @property
    def label(self) -> str:
        """The group in words."""
        return combination_label(self.treatments.values()) or "all runs"

    @property
    def of_units(self) -> tuple[float, int] | None:
        """The variance of the mean for correlated runs of a unit, and the number of units.

        None if no unit has several runs. It is the cluster-robust variance (Liang and Zeger, Biometrika 73, 1986) with
        J / (J - 1) for J units: with equally many runs in each, it is that of the mean of the units' means.
        """
        if self.units is None or (count := len(np.unique(self.units))) == len(self.units):
            return None
        sums = np.bincount(self.units, self.values - np.mean(self.values))  # 0 for a unit without runs
        return (float(count / (count - 1) * (sums @ sums)) / len(self.units) ** 2 if count > 1 else math.nan), count

    @property
    def in_words(self) -> str:
        """The note on an interval that is based on units."""
        return f", runs of one {self.unit} counting together"


def numbered(frame: pd.DataFrame, columns: Sequence[str]) -> Numbers:
    """Return the number of each row's combination of values in these columns."""
    return np.asarray(frame.groupby(list(columns), observed=True, dropna=False).ngroup(), dtype=np.intp)


def group_of(
    treatments: dict[str, str], values: Floats, run_ids: NDArray[np.object_], units: Numbers | None, unit: str
) -> Group:
    """Return the group of these runs; NaN values are missing."""
    present = ~np.isnan(values)
    shared = None if units is None else units[present]
    return Group(treatments, values[present], tuple(run_ids[present]), int((~present).sum()), shared, unit)
