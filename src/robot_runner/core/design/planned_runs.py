"""The rows of the run table as planned: one for each run, in the order of execution."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import chain, repeat
from random import Random
from secrets import randbits
from typing import Any, NamedTuple

from robot_runner.core.design.columns import numbered_run_id
from robot_runner.core.design.factor import Combination

# The order of the runs: as written, randomised, or randomised within complete blocks, always from a recorded seed.


@dataclass(frozen=True, slots=True, kw_only=True)
class RunOrder:
    """The order of runs.

    Attributes:
        shuffle: whether the order is randomised (within the blocks, if there are any).
        blocks: `Repetition` or the name of a factor: runs that share its value are kept together.
        seed: of the randomised order.
        seed_is_given: whether the seed was chosen by the user, and not drawn.

    Example:
        >>> RunOrder(shuffle=True, seed=42, seed_is_given=True).blocks is None
        True
    """

    shuffle: bool = False
    blocks: str | None = None
    seed: int = field(default_factory=lambda: randbits(32))
    seed_is_given: bool = False


def arranged(count: int, block_of: Sequence[int] | None, order: RunOrder) -> Sequence[int]:
    """Return the numbers from 0 to `count` - 1 in the order in which the runs are executed.

    `block_of` has the number of each run's block, from 0; None where all runs are one block.
    """
    if block_of is None and not order.shuffle:
        return range(count)
    blocks = [list(range(count))] if block_of is None else _blocks(block_of)
    if order.shuffle:
        draw = Random(order.seed).random  # noqa: S311 - reproducible, not secret
        for block in blocks:
            shuffle_in_place(block, draw)
    return list(chain.from_iterable(blocks))


def _blocks(block_of: Sequence[int]) -> list[list[int]]:
    blocks: list[list[int]] = [[] for _ in range(max(block_of) + 1)]
    for run, block in enumerate(block_of):
        blocks[block].append(run)
    return blocks


def shuffle_in_place(places: list[Any], draw: Callable[[], float]) -> None:
    """Shuffle a list (Fisher and Yates); `draw` is the method `random` of a random number generator.

    Only `random()` is promised to give the same numbers in every version of Python: `shuffle()` is not.
    """
    for last in range(len(places) - 1, 0, -1):
        other = int(draw() * (last + 1))
        places[last], places[other] = places[other], places[last]


# The rows.


class PlannedRun(NamedTuple):
    """One row of the run table, before it is executed.

    A named tuple, which is made in half the time of a frozen dataclass: there may be millions.

    Attributes:
        run_id: names the run in the table and its folder.
        number: the place in the order of execution, from 1.
        repetition: which repetition of the combination it is, from 1; 0 for a warm-up run.
        block: which block it belongs to, from 1; None where the design has no blocks.
        batch: in which batch it was planned, from 1; each extension of an experiment adds one.

    Example:
        >>> from robot_runner.core.design.factor import Combination
        >>> PlannedRun("r_1", 1, Combination({"Task": 0}, ("Video",)), 1).combination["Task"]
        'Video'
    """

    run_id: str
    number: int
    combination: Combination
    repetition: int
    block: int | None = None
    batch: int = 1

    @property
    def is_warm_up(self) -> bool:
        """Whether it only warms up: executed and kept, but not analysed. It is not a repetition of its combination."""
        return self.repetition == 0  # no field of its own, as there may be millions of runs


def planned_runs(
    combinations: list[Combination], repetitions: int, block_of: Sequence[int] | None, order: RunOrder
) -> list[PlannedRun]:
    """Return the runs in the order of execution.

    As written, all combinations come once, then all again. `block_of` has the number of each run's block in that order,
    from 0 without gaps.
    """
    count = len(combinations)
    places = arranged(count * repetitions, block_of, order)
    numbers = range(1, len(places) + 1)
    return list(
        map(
            PlannedRun,
            map(numbered_run_id, numbers),
            numbers,
            map((combinations * repetitions).__getitem__, places),
            [place // count + 1 for place in places],
            repeat(None) if block_of is None else [block_of[place] + 1 for place in places],
        )
    )


@contextmanager
def garbage_collection_paused() -> Iterator[None]:
    """Pause the cyclic garbage collector while many rows are made.

    Its full collections would take two thirds of the time of a million rows, and rows are in no cycles.
    """
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            if gc.get_freeze_count() == 0:
                # Moves all new objects to the oldest generation; otherwise they would all be scanned right away.
                gc.freeze()
                gc.unfreeze()
            gc.enable()
