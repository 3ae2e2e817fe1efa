"""The runs of one treatment, or of one combination: what is described and compared."""

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
        treatments: which treatment of which factor, as texts.
        missing: how many of its runs have no value.
        units: the number of the unit of each run, which varies as a whole: its block, whole plot or subject; None where
            runs stand by themselves.
        unit: what such a unit is called.
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
        """The variance of the mean where runs of a unit vary together, and how many units there are.

        None where no unit has several runs. It is the cluster-robust variance (Liang and Zeger, Biometrika 73, 1986)
        with J / (J - 1) for J units: with equally many runs in each, that of the mean of the units' means.
        """
        if self.units is None or (count := len(np.unique(self.units))) == len(self.units):
            return None
        sums = np.bincount(self.units, self.values - np.mean(self.values))  # 0 where a unit has none
        return (float(count / (count - 1) * (sums @ sums)) / len(self.units) ** 2 if count > 1 else math.nan), count

    @property
    def in_words(self) -> str:
        """What an interval has to say where runs of a unit count together."""
        return f", runs of one {self.unit} counting together"


def numbered(frame: pd.DataFrame, columns: Sequence[str]) -> Numbers:
    """Return the number of what each row has in these columns."""
    return np.asarray(frame.groupby(list(columns), observed=True, dropna=False).ngroup(), dtype=np.intp)


def group_of(
    treatments: dict[str, str],
    values: Floats,
    run_ids: NDArray[np.object_],
    units: Numbers | None,
    unit: str,
) -> Group:
    """Return a group of runs, of some of which a value is missing."""
    present = ~np.isnan(values)
    shared = None if units is None else units[present]
    return Group(treatments, values[present], tuple(run_ids[present]), int((~present).sum()), shared, unit)
