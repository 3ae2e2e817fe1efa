"""Balanced incomplete block designs: equal replication of treatments, and equal concurrence of all pairs.

They are found by prescribing a group of symmetries (Kramer and Mesner, t-designs on hypergraphs, Discrete Mathematics
15 (1976), 263-296; with the residues of v this is Bose's method of differences, Annals of Eugenics 9 (1939), 353-399):
a design has all images of its blocks, so that the search needs only a few base blocks, whose differences cover each
orbit of pairs equally.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import chain, combinations, product, repeat
from math import comb, gcd
from typing import Final

#: The most partial blocks that are tried for one group; designs of the published table up to ten replicates need fewer.
_MOST_TRIED: Final = 60_000
#: The most treatments; with more, a nearly balanced design is searched.
_MOST_TREATMENTS: Final = 60

_Block = tuple[int, ...]
_Permutation = tuple[int, ...]


def pair_count(treatments: int, size: int, blocks: int) -> int | None:
    """Return the number of blocks that each pair must share; None if counting excludes such a design."""
    replicates, rest = divmod(size * blocks, treatments)
    pairs, left = divmod(replicates * (size - 1), max(1, treatments - 1))
    is_possible = not rest and not left and (blocks >= treatments or size == treatments)  # Fisher's inequality
    return pairs if is_possible and 1 < size <= treatments else None


@cache
def balanced_blocks(treatments: int, size: int, blocks: int) -> tuple[_Block, ...] | None:
    """Return the blocks of a balanced incomplete block design; None if there is none, or none is found.

    Example:
        >>> balanced_blocks(7, 3, 7)[0]
        (0, 1, 3)
    """
    pairs = pair_count(treatments, size, blocks)
    if pairs is None or treatments > _MOST_TREATMENTS:
        return None
    if size == treatments:
        return tuple(repeat(tuple(range(treatments)), blocks))
    for copies in range(blocks, 0, -1):
        if blocks % copies == 0 and pair_count(treatments, size, blocks // copies) is not None:
            found = _found(treatments, size, blocks // copies)
            if found is not None:
                return found * copies
    return None


def _found(treatments: int, size: int, blocks: int) -> tuple[_Block, ...] | None:
    """Return a design that is not a repetition of a smaller one."""
    if blocks == comb(treatments, size):
        return tuple(combinations(range(treatments), size))
    if 2 * size > treatments:
        found = balanced_blocks(treatments, treatments - size, blocks) if treatments - size > 1 else None
        return found and tuple(tuple(each for each in range(treatments) if each not in block) for block in found)
    pairs = pair_count(treatments, size, blocks) or 0
    for group in _groups(treatments):
        if (found := _Search(group, size, blocks, pairs).found()) is not None:
            return found
    return None


# The groups: lists of permutations of the points.


def _groups(points: int) -> Iterator[list[_Permutation]]:
    """Yield groups that move all points, or all but one, in one orbit or several equal ones, large groups first."""
    for fixed, copies in ((0, 1), (1, 1), (0, 2), (1, 2), (0, 3), (1, 3)):
        moved, rest = divmod(points - fixed, copies)
        if not rest and moved > 1:
            for cycles in _abelian(moved):
                yield _translations(cycles, copies, fixed)


def _abelian(order: int, least: int = 2) -> Iterator[tuple[int, ...]]:
    """Yield the orders of the cyclic factors of each abelian group of this order, the cyclic group first."""
    yield (order,)
    for first in range(least, order):
        if order % first == 0:
            for rest in _abelian(order // first, first):
                if gcd(first, rest[0]) > 1:  # else it is the same group as one with fewer cycles
                    yield (first, *rest)


def _translations(cycles: Sequence[int], copies: int, fixed: int) -> list[_Permutation]:
    elements = list(product(*map(range, cycles)))
    place = {element: number for number, element in enumerate(elements)}
    size = len(elements)

    def moved(shift: Sequence[int]) -> Iterable[int]:
        return (place[tuple((a + b) % n for a, b, n in zip(e, shift, cycles, strict=True))] for e in elements)

    moves = [list(moved(shift)) for shift in elements]
    still = range(size * copies, size * copies + fixed)
    return [(*(copy * size + each for copy in range(copies) for each in images), *still) for images in moves]


# The search for base blocks.


@dataclass(frozen=True, slots=True)
class _Orbit:
    """The images of a block, and how often they cover each orbit of pairs."""

    blocks: tuple[_Block, ...]
    covers: Counter[int]


class _TriedEnoughError(Exception):
    """The search has reached its limit."""


class _Search:
    def __init__(self, group: Sequence[_Permutation], size: int, blocks: int, pairs: int) -> None:
        self._group = group
        self._points = len(group[0])
        self._size, self._blocks, self._pairs = size, blocks, pairs
        self._tried = 0
        self._of_pair: dict[tuple[int, int], int] = {}
        self._pair_orbits: list[tuple[int, int]] = []
        self._lengths: list[int] = []
        for pair in combinations(range(self._points), 2):
            if pair not in self._of_pair:
                images = {tuple(sorted((each[pair[0]], each[pair[1]]))) for each in group}
                self._of_pair |= {(a, b): len(self._lengths) for a, b in images}
                self._pair_orbits.append(pair)
                self._lengths.append(len(images))
        #: How often a pair of a base block with a full orbit of images covers the orbit of the pair.
        self._weights = [len(group) // length for length in self._lengths]

    def found(self) -> tuple[_Block, ...] | None:
        left = [self._pairs] * len(self._lengths)
        try:
            for short in self._short_choices(left):
                count = self._blocks - sum(len(orbit.blocks) for orbit in short)
                if count % len(self._group) == 0:
                    rest = [each - sum(orbit.covers[place] for orbit in short) for place, each in enumerate(left)]
                    bases = self._bases(rest, count // len(self._group))
                    if bases is not None:
                        images = (self._images(base) for base in bases)
                        return tuple(chain(*(orbit.blocks for orbit in short), *images))
        except _TriedEnoughError:
            pass
        return None

    def _images(self, block: Iterable[int]) -> list[_Block]:
        points = list(block)
        return [tuple(sorted(each[point] for point in points)) for each in self._group]

    def _short_choices(self, left: Sequence[int]) -> Iterator[list[_Orbit]]:
        """Yield each choice of blocks with fewer images than the group has elements, the empty choice first."""
        short = self._short_orbits()

        def choices(first: int, left: Sequence[int], taken: list[_Orbit]) -> Iterator[list[_Orbit]]:
            yield taken
            for place in range(first, len(short)):
                self._count()
                orbit = short[place]
                rest = [each - orbit.covers[number] for number, each in enumerate(left)]
                if min(rest) >= 0:
                    yield from choices(place, rest, [*taken, orbit])

        return choices(0, left, [])

    def _short_orbits(self) -> list[_Orbit]:
        known: set[_Block] = set()
        found = []
        for element in self._group[1:]:
            cycles = sorted(_cycles(element), key=len)
            for block in _unions(cycles, self._size):
                if block not in known:
                    self._count(len(self._group))
                    images = tuple(dict.fromkeys(self._images(block)))
                    known.update(images)
                    covers = Counter(self._of_pair[pair] for each in images for pair in combinations(each, 2))
                    shares = Counter({place: count // self._lengths[place] for place, count in covers.items()})
                    if max(shares.values()) <= self._pairs:
                        found.append(_Orbit(images, shares))
        return found

    def _bases(self, left: list[int], count: int) -> list[list[int]] | None:
        """Return `count` base blocks that cover the remaining pairs."""
        if not count:
            return None if any(left) else []
        place = next((place for place, each in enumerate(left) if each), None)
        if place is None:
            return None
        for block in self._with_pair(self._pair_orbits[place], left):
            rest = self._bases(left, count - 1)
            if rest is not None:
                return [block, *rest]
        return None

    def _with_pair(self, pair: tuple[int, int], left: list[int]) -> Iterator[list[int]]:
        """Yield blocks with this pair that cover no pair too often; `left` is reduced by each while it is used."""
        block = [pair[0]]

        def extended(candidates: Iterable[int]) -> Iterator[list[int]]:
            for point in candidates:
                self._count()
                places = [self._of_pair[min(point, each), max(point, each)] for each in block]
                for place in places:
                    left[place] -= self._weights[place]
                if all(left[place] >= 0 for place in places):
                    block.append(point)
                    if len(block) == self._size:
                        yield list(block)
                    else:
                        first = point + 1 if len(block) > 2 else 0  # noqa: PLR2004 - the pair is in no order
                        yield from extended(each for each in range(first, self._points) if each not in pair)
                    block.pop()
                for place in places:
                    left[place] += self._weights[place]

        return extended([pair[1]])

    def _count(self, more: int = 1) -> None:
        self._tried += more
        if self._tried > _MOST_TRIED:
            raise _TriedEnoughError


def _cycles(permutation: _Permutation) -> Iterator[_Block]:
    left = set(range(len(permutation)))
    while left:
        cycle = [min(left)]
        while (following := permutation[cycle[-1]]) != cycle[0]:
            cycle.append(following)
        left.difference_update(cycle)
        yield tuple(cycle)


def _unions(cycles: Sequence[_Block], size: int, first: int = 0) -> Iterator[_Block]:
    """Yield each union of cycles that has this size."""
    if not size:
        yield ()
    for place in range(first, len(cycles)):
        if len(cycles[place]) > size:  # cycles are sorted by length
            return
        for rest in _unions(cycles, size - len(cycles[place]), place + 1):
            yield tuple(sorted((*cycles[place], *rest)))
