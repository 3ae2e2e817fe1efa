"""Factors as numbers: effects coded so that the treatments of each factor sum up to zero.

Then an effect is what remains on the plain average over the other factors, whatever the numbers of runs (type III), and
a marginal mean takes no list of all combinations: what it leaves open sums up to zero.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Protocol, runtime_checkable

import numpy as np

from robot_runner.analysis.arrays import Floats, Numbers

#: The factors of an effect: one, or several of an interaction.
Term = tuple[str, ...]


@runtime_checkable
class Coded(Protocol):
    """Factors that are coded in a way of their own, as some of them apply under a condition only."""

    def row(self, terms: Sequence[Sequence[str]], treatments: Mapping[str, str]) -> Floats:
        """Return 1 and the columns of each effect."""

    def size(self, term: Sequence[str]) -> int:
        """Return how many degrees of freedom an effect has."""

    def squares(self, term: Sequence[str]) -> Floats:
        """Return the mean of the products of the columns of an effect."""


def kron(parts: Sequence[Floats], start: Floats) -> Floats:
    """Return the Kronecker product of several arrays, the last one's index changing fastest."""
    for part in parts:
        start = np.asarray(np.kron(start, part), dtype=np.float64)
    return start


def term_size(factors: Mapping[str, Sequence[str]], term: Sequence[str]) -> int:
    """Return how many columns, or degrees of freedom, an effect has."""
    if isinstance(factors, Coded):
        return factors.size(term)
    return math.prod(len(factors[name]) - 1 for name in term)


def marginal_row(
    factors: Mapping[str, Sequence[str]], terms: Sequence[Sequence[str]], treatments: Mapping[str, str]
) -> Floats:
    """Return 1 and the columns of each effect, of a mean over all treatments of the factors that are not named.

    Args:
        factors: the treatments of each factor.
        terms: the effects of the model.
        treatments: by factor; of all factors it is the row of one combination.

    Example:
        >>> marginal_row({"A": ["x", "y"], "B": ["p", "q"]}, [("A",), ("B",), ("A", "B")], {"A": "x"}).tolist()
        [1.0, 1.0, 0.0, 0.0]
    """
    if isinstance(factors, Coded):
        return factors.row(terms, treatments)
    coded = {name: sum_coding(len(factors[name]))[list(factors[name]).index(text)] for name, text in treatments.items()}
    parts = [
        kron([coded[name] for name in term], np.ones(1))
        if set(term) <= set(coded)
        else np.zeros(term_size(factors, term))
        for term in terms
    ]
    return np.concatenate([np.ones(1), *parts])


def coded_columns(codes: Mapping[str, Numbers], sizes: Mapping[str, int], term: Sequence[str]) -> Floats:
    """Return the columns of an effect, (runs, degrees of freedom).

    Args:
        codes: the number of each run's treatment, by factor.
        sizes: how many treatments each factor has.
        term: its factors.
    """
    columns = np.ones((len(codes[term[0]]), 1))
    for name in term:
        mine = sum_coding(sizes[name])[codes[name]]
        columns = (columns[:, :, None] * mine[:, None, :]).reshape(len(columns), -1)
    return columns


def mean_squares(factors: Mapping[str, Sequence[str]], term: Sequence[str]) -> Floats:
    """Return the mean over all combinations of the products of the columns of an effect."""
    if isinstance(factors, Coded):
        return factors.squares(term)
    parts = [sum_coding(len(factors[name])).T @ sum_coding(len(factors[name])) / len(factors[name]) for name in term]
    return kron(parts, np.ones((1, 1)))


def sum_coding(count: int) -> Floats:
    """Return a row for each treatment of a factor, (treatments, treatments - 1)."""
    return np.vstack([np.eye(count - 1), np.full(count - 1, -1.0)])
