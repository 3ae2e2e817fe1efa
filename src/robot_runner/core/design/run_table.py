"""The run table as planned: all runs in the order of execution, held in columns."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import chain, repeat
from random import Random
from secrets import randbits
from typing import TYPE_CHECKING, overload

from robot_runner.core.design.columns import REPETITION, numbered_run_id
from robot_runner.core.design.factor import Combination, index_array

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from robot_runner.core.design.run_table_model import RunTableModel

__all__ = ["PlannedRun", "RunOrder", "RunTable", "arranged"]


# The order of the runs: as written, randomised, or randomised within complete blocks. Always from a known seed.


@dataclass(frozen=True, slots=True, kw_only=True)
class RunOrder:
    """How runs are put in order.

    Attributes:
        shuffle: whether the order is randomised (within the blocks, where there are any).
        blocks: `Repetition` or the name of a factor: runs that share its value are kept together.
        seed: what the randomised order comes from.
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

    Args:
        count: how many runs there are.
        block_of: the number of each run's block, from 0; None where all runs are one block.
        order: whether and from which seed the order is randomised.
    """
    if block_of is None and not order.shuffle:
        return range(count)
    blocks = [list(range(count))] if block_of is None else _blocks(block_of)
    if order.shuffle:
        draw = Random(order.seed).random  # noqa: S311 - reproducible, not secret
        for block in blocks:
            _shuffle(block, draw)
    return array("I" if count < 1 << 32 else "Q", chain.from_iterable(blocks))


def _blocks(block_of: Sequence[int]) -> list[list[int]]:
    blocks: list[list[int]] = [[] for _ in range(max(block_of) + 1)]
    for run, block in enumerate(block_of):
        blocks[block].append(run)
    return blocks


def _shuffle(places: list[int], draw: Callable[[], float]) -> None:
    """Shuffle in place (Fisher and Yates).

    Only `random()` is promised to give the same numbers in every version of Python: `shuffle()` is not.
    """
    for last in range(len(places) - 1, 0, -1):
        other = int(draw() * (last + 1))
        places[last], places[other] = places[other], places[last]


@dataclass(frozen=True, slots=True)
class PlannedRun:
    """One row of the run table, before it is executed.

    Attributes:
        run_id: names the run in the table and its folder.
        number: the place in the order of execution, from 1.
        combination: the treatment of each factor, by the factor's name.
        repetition: which repetition of the combination it is, from 1.
        block: which block it belongs to, from 1; None where the design has no blocks.

    Example:
        >>> PlannedRun("r_1", 1, Combination({"Task": 0}, ("Video",)), 1).combination["Task"]
        'Video'
    """

    run_id: str
    number: int
    combination: Combination
    repetition: int
    block: int | None = None


class RunTable(Sequence[PlannedRun]):
    """All runs of an experiment in the order of execution. Immutable; rows are made when asked for.

    Attributes:
        model: the model that it was made from.
        order: how its runs were put in order, with the seed.

    Example:
        >>> from robot_runner.core.design.factor import Factor
        >>> from robot_runner.core.design.run_table_model import RunTableModel
        >>> table = RunTableModel([Factor("Task", ["Video", "Network"])], repetitions=2).plan()
        >>> [(run.run_id, run.combination["Task"], run.repetition) for run in table]
        [('r_1', 'Video', 1), ('r_2', 'Network', 1), ('r_3', 'Video', 2), ('r_4', 'Network', 2)]
    """

    def __init__(self, model: RunTableModel, combinations: tuple[array[int], ...], order: RunOrder) -> None:
        """Put the runs in order.

        Args:
            model: whose run table it is.
            combinations: for each factor, the place of its treatment in each combination that is executed.
            order: how the runs are put in order.
        """
        self.model = model
        self.order = order
        self._combinations = combinations
        self._combination_count = len(combinations[0])
        self._places = {factor.name: place for place, factor in enumerate(model.factors)}
        self._block_of = self._blocks(order.blocks)
        self._order = arranged(self._combination_count * model.repetitions, self._block_of, order)

    def __len__(self) -> int:
        return len(self._order)

    @overload
    def __getitem__(self, place: int) -> PlannedRun: ...

    @overload
    def __getitem__(self, place: slice) -> Sequence[PlannedRun]: ...

    def __getitem__(self, place: int | slice) -> PlannedRun | Sequence[PlannedRun]:
        if isinstance(place, slice):
            return tuple(self._run(each) for each in range(len(self))[place])
        return self._run(range(len(self))[place])

    def __iter__(self) -> Iterator[PlannedRun]:
        return map(self._run, range(len(self)))

    def __repr__(self) -> str:
        return f"<RunTable: {len(self)} runs, seed {self.order.seed}>"

    @property
    def seed(self) -> int:
        """What its order comes from."""
        return self.order.seed

    @property
    def run_ids(self) -> Sequence[str] | None:
        """The ids of the runs in the order of execution; None where runs are numbered in that order."""
        return None

    def treatment_places(self, factor: str) -> array[int]:
        """Return the place of the factor's treatment in each run, in the order of execution."""
        column = self._combinations[self._places[factor]] * self.model.repetitions
        return array(column.typecode, map(column.__getitem__, self._order))

    def repetition_numbers(self) -> array[int]:
        """Return which repetition of its combination each run is, from 1, in the order of execution."""
        count = self._combination_count
        return index_array(self.model.repetitions, (planned // count + 1 for planned in self._order))

    def _run(self, place: int) -> PlannedRun:
        planned = self._order[place]
        repetition, combination = divmod(planned, self._combination_count)
        treatments = tuple(
            factor.treatments[column[combination]]
            for factor, column in zip(self.model.factors, self._combinations, strict=True)
        )
        number = place + 1
        block = None if self._block_of is None else self._block_of[planned] + 1
        return PlannedRun(numbered_run_id(number), number, Combination(self._places, treatments), repetition + 1, block)

    def _blocks(self, blocks: str | None) -> array[int] | None:
        """Return the number of each run's block in the order as written, without gaps."""
        if blocks is None:
            return None
        repetitions = self.model.repetitions
        if blocks == REPETITION and repetitions > 1:
            return index_array(
                repetitions, chain.from_iterable(repeat(each, self._combination_count) for each in range(repetitions))
            )
        column = self._combinations[self._places[blocks]]
        numbers_by_treatment = {treatment: number for number, treatment in enumerate(sorted(set(column)))}
        return array(column.typecode, map(numbers_by_treatment.__getitem__, column)) * repetitions
