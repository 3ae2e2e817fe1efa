"""The search for efficient incomplete blocks if no balanced design is known, and the efficiency of a design."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import combinations, product
from random import Random
from typing import Final

#: The number of tried exchanges of two treatments per place, their total over all starts (under 1 s), and the most
#: starts.
_TRIED_PER_PLACE: Final = 60
_MOST_TRIED: Final = 20_000
_MOST_BEGINNINGS: Final = 24


def distributed(treatments: int, replicates: int, cells: Sequence[tuple[int, ...]], seed: int) -> list[list[int]]:
    """Distribute treatments over the cells of one or several kinds of blocks, as balanced as possible.

    Cells have the same size; the first ones may have one run more. The goal is that pairs of treatments share a block
    of each kind about equally often, and that the numbers of a treatment in two blocks differ by one at most. Exchanges
    minimise the sum of squared concurrences (the (M,S) criterion of Eccleston and Hedayat, On the theory of connected
    designs, Annals of Statistics 2 (1974), 1238-1255). The most efficient design of several searches is returned.

    Args:
        treatments: their number.
        replicates: of each treatment.
        cells: the block of each kind that a cell is in, by numbers from 0.
        seed: of the search.

    Returns:
        the treatments of each cell.
    """
    tried = treatments * replicates * _TRIED_PER_PLACE
    beginnings = max(1, min(_MOST_BEGINNINGS, _MOST_TRIED // tried))
    # Reproducible, not secret.
    randoms = [Random(f"{seed}/{beginning}") for beginning in range(beginnings)]  # noqa: S311
    found = [_Exchange(treatments, replicates, cells, random).found(min(tried, _MOST_TRIED)) for random in randoms]

    def worth(design: list[list[int]]) -> float:
        blocks: list[dict[int, list[int]]] = [{} for _ in cells[0]]
        for cell, held in zip(cells, design, strict=True):
            for kind, block in enumerate(cell):
                blocks[kind].setdefault(block, []).extend(held)
        return min(efficiency(treatments, list(each.values())) for each in blocks)

    return max(found, key=worth) if beginnings > 1 else found[0]


class _Exchange:
    def __init__(self, treatments: int, replicates: int, cells: Sequence[tuple[int, ...]], random: Random) -> None:
        self._random = random.random
        self._count = treatments
        self._cells = cells
        self._kinds = range(len(cells[0]))
        #: The cell of each place, evenly spread, and its treatment.
        self._cell_of = [place % len(cells) for place in range(treatments * replicates)]
        self._at = [0] * (treatments * replicates)
        order = sorted(range(treatments * replicates), key=lambda _place: self._random())
        for number, place in enumerate(order):
            self._at[place] = number % treatments
        #: The number of each treatment in each block of each kind.
        self._in_block: list[dict[int, Counter[int]]] = [{} for _ in self._kinds]
        for place, treatment in enumerate(self._at):
            for kind, number in enumerate(self._cells[self._cell_of[place]]):
                self._in_block[kind].setdefault(number, Counter())[treatment] += 1
        #: The concurrences of treatments, for each kind of blocks.
        self._together = [[[0] * treatments for _ in range(treatments)] for _ in self._kinds]
        for kind in self._kinds:
            for block in self._in_block[kind].values():
                for one, other in product(block, repeat=2):
                    self._together[kind][one][other] += block[one] * block[other]

    def found(self, tried: int) -> list[list[int]]:
        """Return the treatments of each cell after `tried` attempted exchanges."""
        places = len(self._at)
        for _ in range(tried):
            one, other = int(self._random() * places), int(self._random() * places)
            if self._at[one] != self._at[other] and self._cell_of[one] != self._cell_of[other]:
                before = self._criterion_of(one, other)
                self._exchange(one, other)
                if self._criterion_of(one, other) > before:
                    self._exchange(one, other)
        cells: list[list[int]] = [[] for _ in self._cells]
        for place, treatment in enumerate(self._at):
            cells[self._cell_of[place]].append(treatment)
        return [sorted(each) for each in cells]

    def _criterion_of(self, one: int, other: int) -> int:
        """Return the part of the criterion that an exchange of two places changes."""
        a, b = sorted((self._at[one], self._at[other]))
        total = 0
        for together in self._together:
            rows = together[a], together[b]
            both = sum(count * count for row in rows for count in row)  # off the diagonal each counts twice
            once = rows[0][a] ** 2 + rows[1][b] ** 2 + 2 * rows[0][b] ** 2
            total += 2 * both - once
        return total

    def _exchange(self, one: int, other: int) -> None:
        a, b = self._at[one], self._at[other]
        for kind in self._kinds:
            first, second = self._cells[self._cell_of[one]][kind], self._cells[self._cell_of[other]][kind]
            if first != second:
                for block, out, into in ((first, a, b), (second, b, a)):
                    self._move(kind, block, out, -1)
                    self._move(kind, block, into, 1)
        self._at[one], self._at[other] = b, a

    def _move(self, kind: int, block: int, treatment: int, more: int) -> None:
        together, held = self._together[kind], self._in_block[kind][block]
        for other, count in held.items():
            if other != treatment and count:
                together[treatment][other] += more * count
                together[other][treatment] += more * count
        was = held[treatment]
        held[treatment] = was + more
        together[treatment][treatment] += (was + more) ** 2 - was**2


def concurrences(treatments: int, blocks: Sequence[Sequence[int]]) -> Counter[tuple[int, int]]:
    """Return how often each pair of treatments shares a block."""
    found = Counter(dict.fromkeys(combinations(range(treatments), 2), 0))
    for block in blocks:
        counts = Counter(block)
        for one, other in combinations(sorted(counts), 2):
            found[one, other] += counts[one] * counts[other]
    return found


def efficiency(treatments: int, blocks: Sequence[Sequence[int]]) -> float:
    """Return the average efficiency factor: 1 if blocks cost no information, 0 if a comparison is not estimable.

    It is the harmonic mean of the canonical efficiency factors. Source: John and Williams, Cyclic and Computer
    Generated Designs, 2nd ed., 1995, section 2.2.
    """
    replicates = Counter(each for block in blocks for each in block)
    if treatments < 2:  # noqa: PLR2004
        return 1.0
    # The information matrix, scaled by the replicates, plus the projection on the mean, which makes it regular.
    total = replicates.total()
    roots = [replicates[each] ** 0.5 for each in range(treatments)]
    matrix = [[one * other / total for other in roots] for one in roots]
    for each in range(treatments):
        matrix[each][each] += 1.0
    for block in blocks:
        counts = Counter(block)
        for one, count in counts.items():
            for other, more in counts.items():
                matrix[one][other] -= count * more / len(block) / (roots[one] * roots[other])
    trace = _trace_of_inverse(matrix)
    return 0.0 if trace is None else (treatments - 1) / (trace - 1)


def efficiency_bound(treatments: int, blocks: Sequence[Sequence[int]]) -> float:
    """Return an upper bound of the efficiency factor for these sizes: that of a balanced design, if there were one.

    A block of size k contributes at most as much as in a design that estimates all differences equally well.
    """
    runs = sum(map(len, blocks))
    lost = sum(_least_square_sum(len(block), treatments) / len(block) for block in blocks)
    return (runs - lost) / (runs - runs / treatments) if treatments > 1 else 1.0


def _least_square_sum(size: int, treatments: int) -> int:
    """Return the least sum of squared numbers of treatments in a block of this size."""
    often, rest = divmod(size, treatments)
    return (treatments - rest) * often**2 + rest * (often + 1) ** 2


def _trace_of_inverse(matrix: list[list[float]]) -> float | None:
    """Return the trace of the inverse of a symmetric matrix, by Gauss-Jordan elimination; None if it is singular."""
    size = len(matrix)
    rows = [[*row, *(float(place == other) for other in range(size))] for place, row in enumerate(matrix)]
    for place in range(size):
        pivot = max(range(place, size), key=lambda row: abs(rows[row][place]))
        if abs(rows[pivot][place]) < 1e-9:  # noqa: PLR2004 - zero but for rounding; entries are about 1
            return None
        rows[place], rows[pivot] = rows[pivot], rows[place]
        scale = rows[place][place]
        rows[place] = [each / scale for each in rows[place]]
        for other in range(size):
            if other != place and (factor := rows[other][place]):
                rows[other] = [a - factor * b for a, b in zip(rows[other], rows[place], strict=True)]
    return sum(rows[place][size + place] for place in range(size))
