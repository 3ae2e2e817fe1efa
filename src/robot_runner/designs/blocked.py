"""Blocks: the runs of each combination are spread evenly over days, operators or machines, complete or not."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from math import lcm
from typing import Any

from robot_runner.core.design.design import DesignedRuns, IsAllowed
from robot_runner.core.design.factor import Factor, factor_name
from robot_runner.core.errors import Finding
from robot_runner.core.words import counted
from robot_runner.designs.balanced_blocks import balanced_blocks, pair_count
from robot_runner.designs.block_search import concurrences, distributed, efficiency, efficiency_bound
from robot_runner.designs.factor_roles import Roles, refused, role_findings, shuffled, texts_of_combination

#: The most runs for which the search improves the blocks; more are spread evenly at random, as it would take long.
_MOST_IMPROVED = 4000


@dataclass(frozen=True, init=False, slots=True)
class Blocks:
    """Spread the repetitions of each combination evenly over blocks, such as days, operators or machines.

    The other factors are studied; the repetitions of each of their combinations are spread over all blocks. If the
    number of repetitions is a multiple of the number of blocks, blocks are complete. Else they are incomplete: balanced
    (each pair of combinations in equally many blocks) if such a design is found, or else the best one found, with its
    efficiency. Several factors are crossed: each combination is spread evenly over the days, and over the operators.
    Blocks are executed in the order of their treatments; with `shuffle`, the assignment and the order within each block
    are random.

    Attributes:
        by: the factors whose treatments are the blocks.

    Example:
        >>> from robot_runner import Factor, RunTableModel
        >>> factors = [Factor("Day", ["Mon", "Tue", "Wed"]), Factor("Planner", ["A", "B", "C"])]
        >>> model = RunTableModel(factors, repetitions=2, design=Blocks("Day"))
        >>> [(run.combination["Day"], run.combination["Planner"]) for run in model.plan()][:4]
        [('Mon', 'A'), ('Mon', 'B'), ('Tue', 'A'), ('Tue', 'C')]
    """

    by: tuple[str | Factor, ...]

    def __init__(self, *by: str | Factor) -> None:
        object.__setattr__(self, "by", by)

    def findings(self, factors: Sequence[Factor]) -> Iterator[Finding]:
        """Yield findings on missing and unknown factors."""
        if not self.by:
            yield Finding.error("design: Blocks(...)", "no factor is named", 'Name one, such as Blocks("Day").')
        yield from role_findings("Blocks", [("by", factor_name(each)) for each in self.by], factors)

    def as_mapping(self) -> Mapping[str, Any]:
        """Return its kind and the factors of the blocks."""
        return {"kind": "blocks", "by": list(map(factor_name, self.by))}

    def runs(
        self, factors: Sequence[Factor], is_allowed: IsAllowed, repetitions: int, seed: int, shuffle: bool
    ) -> DesignedRuns:
        """Return the runs, block by block.

        Raises:
            DesignError: there are fewer runs than blocks, some combinations are never compared, or a combination is
                excluded in some blocks only.
        """
        roles = Roles.of(factors, list(map(factor_name, self.by)))
        treatments = roles.allowed_treatments("Blocks", is_allowed)
        cells = list(product(*(factor.treatments for factor in roles.blocks)))
        if len(treatments) * repetitions < len(cells):
            problem = f"{counted(len(treatments) * repetitions, 'run')} are spread over {counted(len(cells), 'block')}"
            raise refused("Blocks", problem, "Have more repetitions, or fewer blocks.")
        spread = _spread(len(treatments), repetitions, roles.blocks, seed if shuffle else None)
        seen = [0] * len(treatments)
        runs = []
        for number, (cell, held) in enumerate(zip(cells, spread, strict=True), start=1):
            for each in shuffled(held, seed if shuffle else None, "order", number):
                seen[each] += 1
                combination = roles.combined(treatments[each], *zip(roles.blocks, cell, strict=True))
                runs.append((combination, seen[each], number))
        return DesignedRuns.in_order(runs, self._facts(roles, list(map(texts_of_combination, treatments)), spread))

    def _facts(self, roles: Roles, texts: Sequence[str], spread: Sequence[Sequence[int]]) -> dict[str, Any]:
        names = [factor.name for factor in roles.blocks]
        kinds = {
            factor.name: _described(len(texts), _of_kind(roles.blocks, spread, place))
            for place, factor in enumerate(roles.blocks)
        }
        for name, found in kinds.items():
            if not found["efficiency"]:
                problem = f"some combinations are never compared within one {name}, not even by way of others"
                raise refused("Blocks", problem, "Have more repetitions, or fewer blocks.")
        cells = product(*(factor.texts for factor in roles.blocks))
        rows = [[*cell, " · ".join(texts[each] for each in held)] for cell, held in zip(cells, spread, strict=True)]
        what = " x ".join(factor.name for factor in roles.studied)
        return {
            **self.as_mapping(),
            "block": names,
            "block_columns": names,
            "balance": kinds,
            "grows_by": f"blocks and repetitions in proportion: treatments of {names[0]}",
            "notes": [f"{name}: {found['in_words']}" for name, found in kinds.items()],
            "layout": [{"title": "Blocks", "heading": [*names, what], "rows": rows}],
        }


def _spread(treatments: int, replicates: int, blocks: Sequence[Factor], seed: int | None) -> list[list[int]]:
    """Return the treatments of each cell of the blocks, in the order of the cells."""
    cells = list(product(*(range(len(factor.treatments)) for factor in blocks)))
    complete, rest = divmod(replicates, len(cells))
    if treatments * rest % len(cells):  # the first cells are larger
        cells = _evenly(blocks)
    more = _incomplete(treatments, rest, cells, seed) if rest else [[] for _ in cells]
    spread = [sorted([*range(treatments)] * complete + extra) for extra in more]
    return [held for _, held in sorted(zip(cells, spread, strict=True))]


def _evenly(blocks: Sequence[Factor]) -> list[tuple[int, ...]]:
    """Return the cells in an order in which any first ones are spread evenly over the blocks of each kind."""
    cells: list[tuple[int, ...]] = [()]
    for size in (len(factor.treatments) for factor in blocks):
        count, turn = len(cells), lcm(len(cells), size)  # after a turn the same pairs would repeat
        cells = [(*cells[place % count], (place + place // turn) % size) for place in range(count * size)]
    return cells


def _incomplete(
    treatments: int, replicates: int, cells: Sequence[tuple[int, ...]], seed: int | None
) -> list[list[int]]:
    """Return the treatments of each cell if there are fewer replicates than cells."""
    size, rest = divmod(treatments * replicates, len(cells))
    balanced = None if rest or len(cells[0]) > 1 else _balanced(treatments, size, len(cells), seed)
    if balanced is not None:
        return balanced
    if treatments * replicates > _MOST_IMPROVED:
        places = shuffled((each for _ in range(replicates) for each in range(treatments)), seed, "places")
        return [places[number :: len(cells)] for number in range(len(cells))]
    return distributed(treatments, replicates, cells, seed or 0)


def _balanced(treatments: int, size: int, count: int, seed: int | None) -> list[list[int]] | None:
    if size == 1 or pair_count(treatments, size, count) is None:
        return None
    if (found := balanced_blocks(treatments, size, count)) is None:
        return None
    labels = shuffled(range(treatments), seed, "treatments")
    return [[labels[each] for each in block] for block in shuffled(found, seed, "blocks")]


def _of_kind(blocks: Sequence[Factor], spread: Sequence[Sequence[int]], place: int) -> list[list[int]]:
    """Return the treatments of each block of one kind, from those of the cells."""
    found: list[list[int]] = [[] for _ in blocks[place].treatments]
    for cell, held in zip(product(*(range(len(factor.treatments)) for factor in blocks)), spread, strict=True):
        found[cell[place]] += held
    return found


def _described(treatments: int, blocks: Sequence[Sequence[int]]) -> dict[str, Any]:
    """Return the balance and the efficiency of blocks of one kind, as plain data."""
    pairs = sorted(concurrences(treatments, blocks).values())
    least, most = (pairs[0], pairs[-1]) if pairs else (0, 0)
    sizes = sorted(map(len, blocks))
    found, bound = efficiency(treatments, blocks), efficiency_bound(treatments, blocks)
    is_complete = all(block.count(each) == block.count(0) > 0 for block in blocks for each in range(treatments))
    is_balanced = least == most and sizes[0] == sizes[-1]
    size = counted(sizes[0], "run") if sizes[0] == sizes[-1] else f"{sizes[0]} to {sizes[-1]} runs"
    if is_complete:
        words = f"complete blocks of {size}: each combination equally often in each"
    elif is_balanced:
        together = f"each pair together {counted(least, 'time')}"
        words = f"balanced incomplete blocks of {size}: {together}, efficiency {found:.3f}"
    else:
        together = f"each pair together {least} to {most} times"
        most_efficient = f"efficiency {found:.3f} (no design of this size exceeds {bound:.3f})"
        words = f"incomplete blocks of {size}, not balanced: {together}, {most_efficient}"
    return {
        "is_complete": is_complete,
        "is_balanced": is_balanced,
        "sizes": [sizes[0], sizes[-1]],
        "pairs": [least, most],
        "efficiency": round(found, 6),
        "efficiency_bound": round(bound, 6),
        "in_words": words,
    }
