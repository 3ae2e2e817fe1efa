"""Latin squares, and pairs of orthogonal ones: as tables of symbols from 0, before anything is randomised."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cache, reduce
from typing import Final

from robot_runner.designs.finite_fields import finite_field

#: The symbol of each cell, by row and column.
Square = tuple[tuple[int, ...], ...]

#: A quasi-difference matrix over the residues of 11 with three points at infinity (None), of which two orthogonal
#: squares of order 14 are developed; no general construction here yields that order. Found by a search of our own,
#: definition after Colbourn and Dinitz (eds.), Handbook of Combinatorial Designs, 2nd ed., 2007, VI.17.
_OF_14: Final = (
    (0, 0, 7, 5), (0, 10, 5, 1), (0, 8, 0, 8), (0, 7, 1, 3), (0, 5, 6, 0), (0, 2, None, 10), (0, None, 3, 6),
    (0, None, 10, 9), (0, 6, 8, None), (0, None, 4, 4), (0, 1, None, 2), (0, 9, 9, None), (None, 0, 4, 10),
    (0, 4, 2, None), (0, 3, None, 7), (None, 0, 10, 3), (None, 0, 8, 9),
)  # fmt: skip

#: The rows of an orthogonal array: in any two columns, each pair of symbols occurs once.
_Rows = list[tuple[int, ...]]
#: A row of a quasi-difference matrix; None is a point at infinity.
_Differences = tuple[int | None, ...]


def latin_square(order: int) -> Square:
    """Return the cyclic Latin square: each symbol once in each row and column.

    Example:
        >>> latin_square(3)
        ((0, 1, 2), (1, 2, 0), (2, 0, 1))
    """
    return tuple(tuple((row + column) % order for column in range(order)) for row in range(order))


def has_orthogonal_pair(order: int) -> bool:
    """Return whether there are two orthogonal Latin squares: of each order but 2 and 6.

    Source: Bose, Shrikhande and Parker, Further results on the construction of mutually orthogonal Latin squares and
    the falsity of Euler's conjecture, Canadian Journal of Mathematics 12 (1960), 189-203.
    """
    return order >= 1 and order not in {2, 6}


def orthogonal_pair(order: int) -> tuple[Square, Square]:
    """Return two Latin squares that, one upon the other, show each pair of symbols once.

    Raises:
        ValueError: there are none of this order.
    """
    if not has_orthogonal_pair(order):
        message = f"there is no pair of orthogonal Latin squares of order {order}"
        raise ValueError(message)
    symbols = {(row, column): rest for row, column, *rest in _array(order, 4)}
    first, second = (
        tuple(tuple(symbols[row, column][which] for column in range(order)) for row in range(order)) for which in (0, 1)
    )
    return first, second


@cache
def _array(order: int, width: int) -> _Rows:
    """Return an orthogonal array of strength two: rows for each pair of symbols, in `width` columns."""
    if order == 1:
        return [(0,) * width]
    if order % 4 != 2:  # noqa: PLR2004 - then each prime power in it is large enough
        return reduce(_product, (_of_field(prime, power, width) for prime, power in _factors(order)))
    if order == 14:  # noqa: PLR2004
        return _developed(_OF_14, 11, 3)
    if order % 6 == 4:  # noqa: PLR2004
        return _developed(list(_parker((order - 1) // 3)), 2 * ((order - 1) // 3) + 1, (order - 1) // 3)
    return _wilson(order)


# Prime powers, and products of orders (MacNeish 1922).


def _of_field(prime: int, power: int, width: int) -> _Rows:
    """Return the array of the lines y = m x + b over a finite field: its order must be at least `width` - 1."""
    times, plus = finite_field(prime, power)
    elements = range(prime**power)
    return [(x, b, *(plus(times(m, x), b) for m in elements[1 : width - 1])) for x in elements for b in elements]


def _product(one: _Rows, other: _Rows) -> _Rows:
    size = max(symbol for row in other for symbol in row) + 1
    return [tuple(x * size + y for x, y in zip(a, b, strict=True)) for a in one for b in other]


def _factors(number: int) -> Iterable[tuple[int, int]]:
    prime = 2
    while number > 1:
        power = 0
        while number % prime == 0:
            number, power = number // prime, power + 1
        if power:
            yield prime, power
        prime += 1


# Orders 2 more than a multiple of 4.


def _parker(m: int) -> Iterable[_Differences]:
    """Yield the quasi-difference matrix of order 3 m + 1 for an odd m.

    Source: Parker, Orthogonal Latin squares, Proceedings of the National Academy of Sciences 45 (1959), 859-862.
    """
    for i in range(1, m + 1):
        minus = 2 * m + 1 - i
        yield from ((0, i, minus, None), (i, 0, None, minus), (minus, None, 0, i), (None, minus, i, 0))
    yield (0, 0, 0, 0)


def _developed(rows: Sequence[_Differences], modulus: int, infinities: int) -> _Rows:
    """Add each residue to each row of a quasi-difference matrix; infinite points have symbols after the residues."""
    taken = [0, 0, 0, 0]
    array: _Rows = []
    for row in rows:
        infinite = [modulus + count for count in taken]
        taken = [count + (each is None) for count, each in zip(taken, row, strict=True)]
        pairs = list(zip(row, infinite, strict=True))
        array += [
            tuple(symbol if each is None else (each + shift) % modulus for each, symbol in pairs)
            for shift in range(modulus)
        ]
    return array + [tuple(modulus + each for each in row) for row in _array(infinities, 4)]


def _wilson(order: int) -> _Rows:
    """Return the array of an order 3 t + u, from arrays of the orders 3, 4, t and u.

    Source: Wilson, Concerning the number of mutually orthogonal Latin squares, Discrete Mathematics 9 (1974), 181-198.
    """
    sizes = ((t, order - 3 * t) for t in range(order // 3, 0, -1))
    t, u = next((t, u) for t, u in sizes if u <= t and _has_width_of_5(t) and has_orthogonal_pair(u))
    array: _Rows = []
    for *points, last in _array(t, 5):
        if last < u:  # symbol 0 of order 4 is the point `last`; the row that shows nothing else is left to order u
            array += [
                tuple(
                    3 * t + last if not each else 3 * point + each - 1 for point, each in zip(points, row, strict=True)
                )
                for row in _array(4, 4)
                if any(row)
            ]
        else:
            array += [tuple(3 * point + each for point, each in zip(points, row, strict=True)) for row in _array(3, 4)]
    return array + [tuple(3 * t + each for each in row) for row in _array(u, 4)]


def _has_width_of_5(order: int) -> bool:
    return all(prime**power > 3 for prime, power in _factors(order))  # noqa: PLR2004 - slopes but 0 are columns, too
