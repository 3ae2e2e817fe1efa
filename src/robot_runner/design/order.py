"""The order of the runs: as written, randomised, or randomised within complete blocks. Always from a known seed."""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field
from itertools import chain
from random import Random
from secrets import randbits
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

__all__ = ["RunOrder", "arranged"]


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
