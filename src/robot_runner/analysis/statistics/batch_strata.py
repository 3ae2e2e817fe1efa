"""The batches of an extended experiment as fixed strata: runs are compared within batches only.

The mean of a combination is a weighted mean of its means within batches. The weights are the same for all combinations,
so a shift of a whole batch cancels exactly in every difference. The weights depend on the numbers of runs alone, and
minimise the variance of differences if spreads are equal. For two treatments they equal those of least squares with a
constant for each batch.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from robot_runner.analysis.arrays import Floats, Numbers
from robot_runner.analysis.statistics.tested import NotComputed
from robot_runner.analysis.wording import listed
from robot_runner.core.design.columns import RUN_ID
from robot_runner.core.words import combination_label, counted, enumerated

if TYPE_CHECKING:
    import pandas as pd
    from numpy.typing import NDArray

    from robot_runner.analysis.statistics.analysed_design import MeasureData


class Comparable(NamedTuple):
    """The part of a measure's data that can be compared within batches.

    Attributes:
        data: the data without the runs and the factors that are confounded with batches.
        note: how the batches were treated; empty for a single batch.
        missing: the effects and comparisons that are confounded with batches.
    """

    data: MeasureData
    note: str = ""
    missing: tuple[NotComputed, ...] = ()


def batch_shares(counts: Floats) -> Floats:
    """Return the weight of each batch, summing up to 1, given numbers of runs, (combinations, batches).

    A batch that lacks a combination has the weight 0.

    Example:
        >>> batch_shares(np.array([[3.0, 1.0, 4.0], [3.0, 1.0, 0.0]])).tolist()
        [0.75, 0.25, 0.0]
    """
    is_complete = counts.min(axis=0) > 0
    means = 1 / np.mean(1 / np.maximum(counts, 1), axis=0) * is_complete
    return np.asarray(means / max(float(means.sum()), 1e-300), dtype=np.float64)


def run_counts(cell: Numbers, batch: Numbers) -> Numbers:
    """Return the numbers of runs, (cells, batches)."""
    counts = np.zeros((cell.max() + 1, batch.max() + 1), dtype=np.intp)
    np.add.at(counts, (cell, batch), 1)
    return counts


def weights_in_blocks(block: Numbers, cell: Numbers, batches: Numbers, cells: int) -> Floats:
    """Return the weight of each run in the mean of its cell in its block.

    Batches have the same weights for all cells of a block, so batch effects cancel in differences within the block.
    Runs of a batch that lacks a cell of the block have the weight 0.
    """
    _, batch = np.unique(batches, return_inverse=True)
    counts = np.zeros((block.max() + 1, cells, batch.max() + 1))
    np.add.at(counts, (block, cell, batch), 1)
    shares = np.stack([batch_shares(each) for each in counts])
    return np.asarray(shares[block, batch] / counts[block, cell, batch], dtype=np.float64)


def comparable(data: MeasureData) -> Comparable:
    """Return the data that can be compared within the batches of a measure's runs.

    Factors that are constant within every batch are left out. If batches do not connect all combinations, the largest
    connected set is kept. Then only batches with all of these combinations are kept, if they have enough runs.
    """
    if not data.is_extended:
        return Comparable(data)
    missing = [
        NotComputed(
            f"the effect of {name}",
            f"{name} differs only between batches, so that it cannot be told apart from what changed between these.",
        )
        for name in data.factors
        if data.frame.groupby(data.batches)[name].nunique().max() == 1
    ]
    gone = {each.what.removeprefix("the effect of ") for each in missing}
    for name in data.factors:
        if gone & set(data.conditions.get(name, ())) and name not in gone:
            gone.add(name)
            parents = enumerated(list(data.conditions[name]))
            missing.append(NotComputed(f"the effect of {name}", f"it applies within {parents} alone, {_UNTOLD}"))
    data = replace(data, factors=tuple(name for name in data.factors if name not in gone))
    if not data.factors:
        return Comparable(data, "", tuple(missing))
    connected = _connected(data)
    if not connected.all():
        missing.append(NotComputed(f"comparisons with {listed(_combinations(data, ~connected))}", _NOT_CONNECTED))
        data = _without(data, ~connected)
    complete = np.ones(len(data.frame), dtype=bool) if data.is_blocked or not data.factors else _complete(data)
    told = ""
    if not complete.all():
        runs = data.frame[RUN_ID][~complete]
        told = f" Their batches do not hold all combinations, so {counted(len(runs), 'run')} are left out of the tests:"
        told += f" {listed(runs)}."
        data = _without(data, ~complete)
    return Comparable(data, _note(data) + told, tuple(missing))


_UNTOLD = "whose treatments lie in different batches: repeat them in one batch."
_NOT_CONNECTED = (
    "no batch has runs of them and of the others, so that differences cannot be told apart from what changed between "
    "batches; the tests leave these runs out. Add repetitions of the others to the later batch."
)


def _note(data: MeasureData) -> str:
    if not data.is_extended:
        return f"The experiment was extended: the tests compare runs of batch {data.batches[0]} only."
    names = enumerated(list(dict.fromkeys(map(str, sorted(data.batches)))))
    return f"The experiment was extended: treatments are compared within batches {names}, which may differ as a whole."


def _cells(data: MeasureData) -> Numbers:
    """Return the number of each run's combination."""
    return np.asarray(data.frame.groupby(list(data.factors), observed=True).ngroup(), dtype=np.intp)


def _combinations(data: MeasureData, rows: NDArray[np.bool_]) -> list[str]:
    found: pd.DataFrame = data.frame.loc[rows, list(data.factors)].drop_duplicates()
    return [combination_label(row) for row in found.itertuples(index=False)]


def _connected(data: MeasureData) -> NDArray[np.bool_]:
    """Return which runs belong to the largest set of combinations that batches connect.

    Of sets with as many combinations, the one with the most runs is taken, then the later one. Differences of
    combinations are estimable beside batch effects if and only if batches connect them (Searle, Linear Models, 1971,
    section 7.4).
    """
    cell, batch = _cells(data), data.batches
    parts = cell.copy()
    for _ in range(len(set(cell))):  # each round joins what shares a batch, then what shares a combination
        for of in (batch, cell):
            parts = np.asarray([parts[of == each].min() for each in of])
    most = max(
        set(parts.tolist()),
        key=lambda part: (len(set(cell[parts == part])), int((parts == part).sum()), int(batch[parts == part].max())),
    )
    return np.asarray(parts == most)


def _complete(data: MeasureData) -> NDArray[np.bool_]:
    """Return which runs belong to batches with all combinations, or all runs if those are too few."""
    cell, batch = _cells(data), data.batches
    all_of_it = np.ones(len(cell), dtype=bool)
    holding = [each for each in set(batch.tolist()) if len(set(cell[batch == each])) == len(set(cell))]
    kept = np.isin(batch, holding)
    suffices = bool(holding) and np.bincount(cell[kept]).min() > len(holding)
    return kept if suffices else all_of_it


def _without(data: MeasureData, rows: NDArray[np.bool_]) -> MeasureData:
    gone: Iterator[str] = iter(data.frame[RUN_ID][rows])
    names = set(gone)
    frame, every = (each[~each[RUN_ID].isin(names)].reset_index(drop=True) for each in (data.frame, data.every))
    left = replace(data, frame=frame, every=every)
    left = replace(left, factors=tuple(name for name in data.factors if len(left.levels(name)) > 1))
    return replace(left, is_extended=len(set(left.batches.tolist())) > 1)
