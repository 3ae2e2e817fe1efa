"""Finite fields: elements are polynomials over a prime field, written as numbers whose digits are the coefficients."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import product
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    Operation = Callable[[int, int], int]


def finite_field(prime: int, power: int, reduced: Sequence[int] = ()) -> tuple[Operation, Operation]:
    """Return multiplication and addition of the field with prime**power elements.

    Args:
        prime: its characteristic.
        power: the degree of the field over the prime field.
        reduced: the coefficients of the polynomial that x**power equals, the constant first; x must generate all
            elements except 0. If left out, the first such polynomial is taken.
    """
    size = prime**power

    def digits(number: int) -> list[int]:
        return [number // prime**place % prime for place in range(power)]

    def plus(one: int, other: int) -> int:
        sums = ((a + b) % prime for a, b in zip(digits(one), digits(other), strict=True))
        return sum(digit * prime**place for place, digit in enumerate(sums))

    def times_x(number: int, reduced: Sequence[int]) -> int:
        top = number // prime ** (power - 1)
        shifted = number * prime % size
        return plus(shifted, sum(top * each % prime * prime**place for place, each in enumerate(reduced)))

    def powers(reduced: Sequence[int]) -> list[int]:
        found = [1]
        while (following := times_x(found[-1], reduced)) not in (0, 1) and len(found) < size:
            found.append(following)
        return found

    if power == 1:
        return lambda a, b: a * b % prime, lambda a, b: (a + b) % prime
    every = ([-each for each in modulus] for modulus in product(range(prime), repeat=power))
    candidates: Iterable[Sequence[int]] = [reduced] if reduced else every
    cycle = next(each for candidate in candidates if len(each := powers(candidate)) == size - 1)
    log = {element: exponent for exponent, element in enumerate(cycle)}

    def times(one: int, other: int) -> int:
        return cycle[(log[one] + log[other]) % (size - 1)] if one and other else 0

    return times, plus
