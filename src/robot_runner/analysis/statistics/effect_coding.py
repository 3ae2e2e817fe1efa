"""Sum coding of factors: the coefficients of the treatments of each factor sum up to zero.

So an effect is the plain average over the other factors, whatever the numbers of runs (type III), and a marginal mean
needs no list of all combinations: the effects of the other factors sum up to zero.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations
from typing import Self

import numpy as np
from scipy import linalg

from robot_runner.analysis.arrays import Floats, Numbers
from robot_runner.core.words import enumerated

#: The factors of an effect: one for a main effect, several for an interaction.
Term = tuple[str, ...]

#: The conditions of conditional factors: for each parent factor, the treatments under which the factor applies.
Conditions = dict[str, dict[str, tuple[str, ...]]]


class Factors(dict[str, list[str]]):
    """The compared factors with their ordered treatments; all factors apply to all runs.

    Attributes:
        conditions: of conditional factors; none here, see `NestedFactors`.

    Example:
        >>> found = Factors({"A": ["x", "y"], "B": ["p", "q"]})
        >>> found.terms(2), found.count
        ((('A',), ('B',), ('A', 'B')), 4)
        >>> found.weights({"A": "x"}).tolist(), found.row(found.terms(2), {"A": "x"}).tolist()
        ([0.5, 0.5, 0.0, 0.0], [1.0, 1.0, 0.0, 0.0])
    """

    def __init__(self, treatments: Mapping[str, Sequence[str]], conditions: Conditions | None = None) -> None:
        super().__init__({name: list(levels) for name, levels in treatments.items()})
        self.conditions = conditions or {}

    def only(self, names: Iterable[str]) -> Self:
        """Return some of the factors; their parents must be among them."""
        chosen = set(names)
        own = {name: of for name, of in self.conditions.items() if name in chosen}
        return type(self)({name: levels for name, levels in self.items() if name in chosen}, own)

    def is_apart(self, names: Iterable[str]) -> bool:
        """Return whether no condition links these factors with the others."""
        chosen = set(names)
        return all((name in chosen) is (parent in chosen) for name, of in self.conditions.items() for parent in of)

    def nested_in(self, names: Iterable[str]) -> set[str]:
        """Return the factors that are nested in these, directly or indirectly."""
        found = set(names)
        for _ in self.conditions:
            found |= {name for name, of in self.conditions.items() if found & set(of)}
        return found - set(names)

    def scope(self, term: Iterable[str]) -> dict[str, list[str]]:
        """Return the treatments of each factor that are possible where all factors of an effect apply."""
        left, open_names = dict(self), list(term)
        while open_names:
            for parent, wanted in self.conditions.get(open_names.pop(), {}).items():
                left[parent] = [text for text in left[parent] if text in wanted]
                open_names.append(parent)
        return left

    def levels(self, term: Sequence[str]) -> list[list[str]]:
        """Return the treatments of each factor of an effect, where all of them apply."""
        scope = self.scope(term)
        return [scope[name] for name in term]

    def has(self, _: Sequence[str]) -> bool:
        """Return whether these factors have an effect together: whether some combination has them all."""
        return True

    def terms(self, most: int) -> tuple[Term, ...]:
        """Return the effects of up to `most` factors, main effects first."""
        sizes = range(1, min(len(self), most) + 1)
        return tuple(term for size in sizes for term in combinations(self, size) if self.has(term))

    def size(self, term: Sequence[str]) -> int:
        """Return the number of columns, or degrees of freedom, of an effect."""
        return math.prod(len(levels) - 1 for levels in self.levels(term))

    def within(self, term: Iterable[str]) -> str:
        """Return the runs within which an effect is estimated, as in `Sensor=camera`; empty for all runs."""
        left: dict[str, list[str]] = {}
        for name in term:
            for parent, wanted in self.conditions.get(name, {}).items():
                left[parent] = [text for text in left.get(parent, self[parent]) if text in wanted]
        return " and ".join(f"{parent}={' or '.join(texts)}" for parent, texts in left.items())

    def in_words(self, mean: str, counts: str) -> str:
        """Return a note on where conditional factors are tested, and what counts in the means of their parents."""
        told = [f"{name} within {self.within([name])}" for name in self.conditions]
        parents = enumerated(list(dict.fromkeys(parent for of in self.conditions.values() for parent in of)))
        return (
            f"Some factors apply to some runs only, and are tested among these: {enumerated(told)}. In a {mean} of "
            f"{parents}, {counts}."
        )

    @property
    def count(self) -> int:
        """The number of possible combinations."""
        return math.prod(map(len, self.values()))

    def numbers(self, codes: Mapping[str, Numbers]) -> Numbers:
        """Return the index of each run's combination from those of its treatments; the last factor changes fastest."""
        number = np.zeros(len(next(iter(codes.values()), ())), dtype=np.intp)
        for name, levels in self.items():
            number = number * len(levels) + codes[name]
        return number

    def weights(self, treatments: Mapping[str, str]) -> Floats:
        """Return the weights of the combinations in a marginal mean, equal over the other factors.

        Treatments of all factors select a single combination.
        """
        rows = [
            np.array([float(level == treatments[name]) for level in levels])
            if name in treatments
            else np.full(len(levels), 1 / len(levels))
            for name, levels in self.items()
        ]
        return kron(rows, np.ones(1))

    def contrasts(self, term: Sequence[str]) -> Floats:
        """Return the orthonormal contrasts of an effect, (degrees of freedom, combinations); the mean for no factor."""
        parts = [
            linalg.helmert(len(levels)) if name in term else np.full((1, len(levels)), len(levels) ** -0.5)
            for name, levels in self.items()
        ]
        return kron(parts, np.ones((1, 1)))

    def row(self, terms: Sequence[Term], treatments: Mapping[str, str]) -> Floats:
        """Return the row of the design matrix (1, then the effects) for a marginal mean; see `weights`."""
        coded = {name: sum_coding(len(self[name]))[self[name].index(text)] for name, text in treatments.items()}
        parts = [
            kron([coded[name] for name in term], np.ones(1)) if set(term) <= set(coded) else np.zeros(self.size(term))
            for term in terms
        ]
        return np.concatenate([np.ones(1), *parts])

    def columns(self, codes: Mapping[str, Numbers], terms: Sequence[Term]) -> dict[Term, Floats]:
        """Return the sum-coded columns of effects, from what `codes_of` returns; 0 where factors do not apply."""
        sizes = {name: len(levels) for name, levels in self.items()}
        return {term: coded_columns(codes, sizes, term) for term in terms}

    def squares(self, term: Sequence[str]) -> Floats:
        """Return the mean over all combinations of the products of the columns of an effect."""
        codings = [sum_coding(len(self[name])) for name in term]
        return kron([coding.T @ coding / len(coding) for coding in codings], np.ones((1, 1)))


def kron(parts: Sequence[Floats], start: Floats) -> Floats:
    """Return the Kronecker product of several arrays, the last one's index changing fastest."""
    for part in parts:
        start = np.asarray(np.kron(start, part), dtype=np.float64)
    return start


def coded_columns(codes: Mapping[str, Numbers], sizes: Mapping[str, int], term: Sequence[str]) -> Floats:
    """Return the columns of an effect, (runs, degrees of freedom), from the index of each run's treatment."""
    columns = np.ones((len(codes[term[0]]), 1))
    for name in term:
        mine = sum_coding(sizes[name])[codes[name]]
        columns = (columns[:, :, None] * mine[:, None, :]).reshape(len(columns), -1)
    return columns


def sum_coding(count: int) -> Floats:
    """Return the sum coding of a factor, a row for each treatment: (treatments, treatments - 1)."""
    return np.vstack([np.eye(count - 1), np.full(count - 1, -1.0)])
