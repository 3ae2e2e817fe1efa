"""Covering arrays of strength two and three.

An array has a row for each run and a column for each factor; its symbols are treatment indices. A pair of columns is
covered if each pair of their symbols is in some row. For pairs, structured initial arrays are completed column by
column by a tabu search; for triples, arrays are constructed.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache
from itertools import combinations, count, pairwise, product
from math import comb

import numpy as np
from numpy.typing import NDArray

from robot_runner.designs.finite_fields import finite_field

Array = NDArray[np.int64]

#: The most moves in the search of a column, the most moves without gain, and the most repairs of columns.
_MOVES, _IDLE, _ROUNDS = 400, 150, 20
#: The most uncovered pairs before an array is given up: more rows are quicker than more search.
_GIVEN_UP = 2
#: The fewest moves before a cell may return to its previous symbol.
_TENURE = 4
#: Fields of prime powers: the prime, and the polynomial of lower degree that x^n equals, its constant first.
_FIELDS = {4: (2, (1, 1)), 8: (2, (1, 1, 0)), 9: (3, (1, 2)), 16: (2, (1, 1, 0, 0))}
_PRIMES = (2, 3, 5, 7, 11, 13, 17, 19, 23)
_ORDERS = tuple(sorted((*_PRIMES, *_FIELDS)))


def pairwise_array(levels: Sequence[int], seed: int) -> Array:
    """Return an array that covers each pair of symbols of any two columns.

    Args:
        levels: the number of symbols of each column.
        seed: of the search; the same seed yields the same array.
    """
    order = sorted(range(len(levels)), key=lambda column: -levels[column])
    ordered = [levels[column] for column in order]
    has_two = ordered[0] <= 2  # noqa: PLR2004 - for two symbols the optimum is known
    found = _binary(ordered) if has_two else _searched(ordered, np.random.default_rng(seed))
    array = np.empty_like(found)
    array[:, order] = found
    return array


def _searched(levels: list[int], random: np.random.Generator) -> Array:
    """Return the smallest array that can be completed: doubling steps, then bisection, find its number of rows."""
    bases = list(_bases(levels, random))
    sure = [len(base) for base in bases if base.shape[1] >= len(levels) and base.max() + 1 >= levels[0]]
    fewest = levels[0] * levels[1]
    step, rows, found = 1, fewest, None
    while found is None:
        found = _completed(levels, bases, rows, random)
        if found is None:
            fewest, rows, step = rows + 1, min([rows + step, *(each for each in sure if each > rows)]), 2 * step
    while fewest < len(found):
        rows = (fewest + len(found)) // 2
        smaller = _completed(levels, bases, rows, random)
        if smaller is None:
            fewest = rows + 1
        else:
            found = smaller
    return found


def _completed(levels: list[int], bases: Sequence[Array], rows: int, random: np.random.Generator) -> Array | None:
    attempts = (_Completing(levels, base, rows, random).array() for base in bases if len(base) <= rows)
    return next((array for array in attempts if array is not None), None)


# Two symbols: Kleitman & Spencer (1973), "Families of k-independent sets": no array has fewer rows.


def _binary(levels: Sequence[int]) -> Array:
    varying = sum(each > 1 for each in levels)
    rows = next(n for n in count(4 if varying > 1 else max(levels)) if comb(n - 1, (n + 1) // 2) >= varying)
    array = np.zeros((rows, len(levels)), dtype=np.int64)
    chosen = combinations(range(1, rows), (rows + 1) // 2)
    for column in range(varying):
        array[list(next(chosen)), column] = 1
    return array


# Structured initial arrays, whose columns cover each other, for the first of the given columns.


def _bases(levels: list[int], random: np.random.Generator) -> Iterator[Array]:
    """Yield initial arrays."""
    first, second = np.divmod(np.arange(levels[0] * levels[1]), levels[1])
    yield np.column_stack([first, second])
    for symbols in sorted(set(levels)):
        wanted = sum(each <= symbols for each in levels)
        if symbols > 2 and wanted > 2:  # noqa: PLR2004 - else the grid covers them
            yield from _uniform(symbols, wanted, random)


def _uniform(symbols: int, columns: int, random: np.random.Generator) -> Iterator[Array]:
    order = next((each for each in _ORDERS if each >= symbols), None)
    if order is not None:
        yield _orthogonal(order)
        if columns > order + 1:
            narrow = -(-(columns - 1) // order)
            yield _product(_searched([order] * narrow, random) if narrow > order + 1 else _orthogonal(order), order)
    starter = _starter(symbols, columns) if symbols > 3 and columns > symbols + 1 else None  # noqa: PLR2004
    if starter is not None:
        yield starter


@lru_cache
def _orthogonal(order: int) -> Array:
    """Return the orthogonal array of a field: order² rows, order + 1 columns (Bush, 1952), constant rows first."""
    plus, times = _field_of(order)
    slope, shift = np.divmod(np.arange(order**2), order)
    columns = [plus[times[slope, point], shift] for point in range(order)]
    return np.column_stack([*columns, slope])


def _field_of(order: int) -> tuple[Array, Array]:
    """Return the tables of addition and multiplication of a finite field."""
    prime, reduced = _FIELDS.get(order, (order, (0,)))
    operations = finite_field(prime, len(reduced), reduced)
    times, plus = (np.array([[each(a, b) for b in range(order)] for a in range(order)]) for each in operations)
    return plus, times


def _product(array: Array, order: int) -> Array:
    """Return an array with `order` times as many columns plus one, and order² - order more rows.

    Stevens & Mendelsohn (1999), "New recursive methods for transversal covers": the upper part covers pairs of equal
    symbols, so the lower part leaves out the constant rows of the orthogonal array.
    """
    below = _orthogonal(order)[order:]
    wide = np.repeat(array, order, axis=1)
    lower = np.tile(below[:, :order], array.shape[1])
    extra = np.concatenate([np.zeros(len(array), dtype=np.int64), below[:, order]])
    return np.column_stack([np.vstack([wide, lower]), extra])


@lru_cache
def _starter(symbols: int, columns: int) -> Array | None:
    """Return the array of a starter vector: columns * (symbols - 1) + 1 rows; None if none is found.

    Meagher & Stevens (2005), "Group construction of covering arrays": the rotations of the vector, with each number
    added modulo symbols - 1 to all but one fixed symbol, and a row of that symbol. The entries of the vector at each
    distance must have all differences.
    """
    order = symbols - 1
    random = np.random.default_rng(0)
    for _ in range(40):
        vector = random.integers(order, size=columns)
        vector[0] = -1
        if _improved(vector, order, random):
            shifted = [(vector + number) % order for number in range(order)]
            for each in shifted:
                each[0] = order
            rows = [np.roll(each, shift) for each in shifted for shift in range(columns)]
            return np.vstack([*rows, np.full(columns, order)])
    return None


def _improved(vector: Array, order: int, random: np.random.Generator) -> bool:
    missing = _missing_differences(vector, order)
    for _ in range(3000):
        if not missing:
            return True
        place = int(random.integers(1, len(vector)))
        before = vector[place]
        vector[place] = random.integers(order)
        now = _missing_differences(vector, order)
        if now > missing:
            vector[place] = before
        else:
            missing = now
    return False


def _missing_differences(vector: Array, order: int) -> int:
    lengths = np.arange(1, len(vector) // 2 + 1)
    places = np.arange(len(vector))
    ends = vector[(places[None, :] + lengths[:, None]) % len(vector)]
    is_finite = (ends >= 0) & (vector >= 0)[None, :]
    differences = np.where(is_finite, (ends - vector[None, :]) % order, order)
    seen = np.zeros((len(lengths), order + 1), dtype=bool)
    seen[np.arange(len(lengths))[:, None], differences] = True
    return int((~seen[:, :order]).sum())


# Completion: columns are added one by one, each by a search for symbols that cover its pairs with earlier columns.


class _Completing:
    """An array with a given number of rows, which begins with a base and is completed if possible.

    Args:
        levels: of the columns, in descending order.
        base: the initial array; its columns are used for columns with no more symbols, the largest first, and symbols
            that a column does not have are replaced at random.
        rows: the number of rows.
        random: the random generator of the search.
    """

    def __init__(self, levels: list[int], base: Array, rows: int, random: np.random.Generator) -> None:
        self._levels = levels
        self._random = random
        self._starts = np.concatenate([[0], np.cumsum(levels)])
        self._cells = random.integers(levels, size=(rows, len(levels)))
        self._is_set = np.zeros((rows, self._starts[-1]), dtype=np.float32)  # one column for each symbol of a column
        symbols = base.max(axis=0) + 1
        is_grid = base.shape[1] == 2  # noqa: PLR2004 - made for the two largest columns
        free = [column for column, each in enumerate(levels) if is_grid or each <= symbols[0]]
        self._done = free[: base.shape[1]]
        for place, column in enumerate(self._done):
            known = base[:, place] < levels[column]
            self._cells[: len(base), column][known] = base[:, place][known]
            self._mark(column)
        self._open = [column for column in range(len(levels)) if column not in self._done]

    def array(self) -> Array | None:
        """Return the completed array; None if a column cannot be covered."""
        left = 0
        for column in self._open:
            left += self._search(column)
            if left > _GIVEN_UP:
                return None
            self._done.append(column)
        return self._cells if left == 0 or self._is_repaired() else None

    def _is_repaired(self) -> bool:
        """Search columns with uncovered pairs again; return whether all pairs are covered."""
        for _ in range(_ROUNDS):
            missing = self._missing()
            if not missing:
                return True
            column = missing[int(self._random.integers(len(missing)))]
            self._search(column)
        return not self._missing()

    def _missing(self) -> list[int]:
        """Return the columns with uncovered pairs."""
        together = (self._is_set.T @ self._is_set) == 0
        spans = list(pairwise(self._starts))
        for start, end in spans:
            together[start:end, start:end] = False
        return [column for column, (start, end) in enumerate(spans) if together[start:end].any()]

    def _mark(self, column: int) -> None:
        start, end = self._starts[column], self._starts[column + 1]
        self._is_set[:, start:end] = self._cells[:, column, None] == np.arange(self._levels[column])

    def _search(self, column: int) -> int:
        """Search the symbols of a column by tabu search; return the number of its uncovered pairs."""
        start, end = self._starts[column], self._starts[column + 1]
        self._is_set[:, start:end] = 0
        others = self._is_set[:, self._is_set.any(axis=0)]
        symbols, rows = np.array(self._cells[:, column]), np.arange(len(self._cells))
        together = others.T @ (symbols[:, None] == np.arange(self._levels[column])).astype(np.float32)
        until = np.zeros((len(rows), self._levels[column]), dtype=np.int64)
        least, best = int((together == 0).sum()), symbols.copy()
        left, since = least, 0
        for move in range(_MOVES):
            if not least or move - since > _IDLE:
                break
            gain = others @ (together == 0)
            gain -= (others @ (together == 1))[rows, symbols][:, None]
            is_open = (until <= move) | (left - gain < least)
            is_open[rows, symbols] = False
            gain = np.where(is_open, gain + self._random.random(gain.shape) / 2, -np.inf)  # ties are broken at random
            row, symbol = divmod(int(np.argmax(gain)), gain.shape[1])
            if not np.isfinite(gain[row, symbol]):
                continue
            until[row, symbols[row]] = move + _TENURE + self._random.integers(_TENURE)
            together[:, symbols[row]] -= others[row]
            together[:, symbol] += others[row]
            symbols[row] = symbol
            left = int((together == 0).sum())
            if left < least:
                least, best, since = left, symbols.copy(), move
        self._cells[:, column] = best
        self._mark(column)
        return least


# Triples: orthogonal arrays, and the doubling of columns.

_TRIPLE = 3
#: The columns of Paley's Hadamard matrix of order 12, which cover all triples of two symbols.
_PALEY = 11


def triples_array(levels: Sequence[int], seed: int) -> Array:
    """Return an array that covers each triple of symbols of any three columns, (rows, columns).

    It is made for the largest number of symbols; in columns with fewer, the others are replaced.
    """
    best = min(_arrays(max(levels), len(levels), seed), key=len)
    return np.asarray(best % np.asarray(levels))


def _arrays(symbols: int, columns: int, seed: int) -> Iterator[Array]:
    if columns <= _TRIPLE:
        yield np.array(list(product(range(symbols), repeat=columns)))
        return
    wide = (each for each in _ORDERS if columns <= each + (2 if each % 2 == 0 else 1))
    order = next((each for each in wide if symbols <= each <= 2 * symbols), None)
    if order is not None:
        yield _orthogonal_triples(order)[:, :columns] % symbols
    if symbols == 2 and columns <= _PALEY:  # noqa: PLR2004
        yield _paley()[:, :columns]
    yield _doubled(symbols, columns, seed)


def _orthogonal_triples(order: int) -> Array:
    """Return the orthogonal array of strength three of a field (Bush, 1952): polynomials of degree two.

    It has order³ rows and order + 1 columns, or order + 2 columns if the order is even.
    """
    plus, times = _field_of(order)
    shift, slope, curve = (each.ravel() for each in np.indices((order, order, order)))
    columns = [plus[plus[shift, times[slope, x]], times[curve, times[x, x]]] for x in range(order)]
    return np.column_stack([*columns, curve, *([slope] if order % 2 == 0 else [])])


def _paley() -> Array:
    """Return 12 rows that cover all triples of 11 columns: Paley's matrix (1933) without its constant column."""
    squares = {number**2 % _PALEY for number in range(1, _PALEY)}
    rows = [[int((column - row) % _PALEY in squares) for column in range(_PALEY)] for row in range(_PALEY)]
    return np.array([[1] * _PALEY, *rows])


def _doubled(symbols: int, columns: int, seed: int) -> Array:
    """Return an array by doubling: one of half the columns, twice side by side, and pairs beside each of their shifts.

    Source: Roux (1987) for two symbols; Chateauneuf and Kreher, On the state of strength-three covering arrays,
    Journal of Combinatorial Designs 10 (2002), 217-238.
    """
    half = -(-columns // 2)
    triples = min(_arrays(symbols, half, seed), key=len)
    pairs = pairwise_array([symbols] * half, seed)
    shifted = [np.hstack([pairs, (pairs + shift) % symbols]) for shift in range(1, symbols)]
    return np.vstack([np.hstack([triples, triples]), *shifted])[:, :columns]
