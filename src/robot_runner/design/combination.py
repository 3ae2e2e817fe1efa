"""One treatment for each factor, and all of them together: the full factorial, held in columns."""

from __future__ import annotations

from array import array
from collections.abc import Mapping
from itertools import chain, repeat
from math import prod
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from robot_runner.design.factor import Factor

__all__ = ["Combination", "combinations_of", "full_factorial", "index_array"]


class Combination(Mapping[str, Any]):
    """One treatment for each factor, by the factor's name. Read-only.

    Example:
        >>> Combination({"Task": 0, "Speed": 1}, ("Video", 0.2))["Speed"]
        0.2
    """

    __slots__ = ("_places", "_treatments")

    def __init__(self, places: Mapping[str, int], treatments: tuple[Any, ...]) -> None:
        self._places = places
        self._treatments = treatments

    def __getitem__(self, factor: str) -> Any:
        return self._treatments[self._places[factor]]

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)

    def __repr__(self) -> str:
        return repr(dict(self))

    def __str__(self) -> str:
        return ", ".join(f"{name}={treatment!r}" for name, treatment in self.items())


def index_array(largest: int, values: Any = ()) -> array[int]:
    """Return an array of whole numbers from 0 to `largest`, in as few bytes each as that takes."""
    code = next(code for code, bits in (("B", 8), ("H", 16), ("I", 32), ("Q", 64)) if largest < 1 << bits)
    return array(code, values)


def full_factorial(factors: Sequence[Factor]) -> tuple[array[int], ...]:
    """Return, for each factor, the place of its treatment in each combination; the first factor is the slowest."""
    columns = []
    for place, factor in enumerate(factors):
        count = len(factor.treatments)
        stretch = prod(len(faster.treatments) for faster in factors[place + 1 :])
        times = prod(len(slower.treatments) for slower in factors[:place])
        once = index_array(count - 1, chain.from_iterable(map(repeat, range(count), repeat(stretch))))
        columns.append(once * times)
    return tuple(columns)


def combinations_of(factors: Sequence[Factor], columns: Sequence[array[int]]) -> Iterator[Combination]:
    """Yield the combination of each row of `columns`, which hold the places of treatments."""
    places = {factor.name: place for place, factor in enumerate(factors)}
    treatments = [map(factor.treatments.__getitem__, column) for factor, column in zip(factors, columns, strict=True)]
    for row in zip(*treatments, strict=True):
        yield Combination(places, row)
