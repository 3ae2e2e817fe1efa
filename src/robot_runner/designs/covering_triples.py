"""Constructions of covering arrays of strength three: orthogonal arrays, and the doubling of columns."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from robot_runner.designs.covering_search import field_of, is_field, pairwise_array

Array = NDArray[np.intp]

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
    order = symbols
    while not is_field(order) or columns > order + (2 if order % 2 == 0 else 1):
        order += 1
        if order > 2 * symbols:
            break
    else:
        yield _orthogonal(order)[:, :columns] % symbols
    if symbols == 2 and columns <= _PALEY:  # noqa: PLR2004
        yield _paley()[:, :columns]
    yield _doubled(symbols, columns, seed)


def _orthogonal(order: int) -> Array:
    """Return the orthogonal array of strength three of a field (Bush, 1952): polynomials of degree two.

    It has order³ rows and order + 1 columns, or order + 2 columns if the order is even.
    """
    plus, times = field_of(order)
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
