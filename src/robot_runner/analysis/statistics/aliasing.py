"""Aliasing: which effects the combinations of a design can estimate separately, and the aliases of each.

Effects are considered in order, main effects first. An effect that is orthogonal to all earlier ones is tested. One
that these explain completely is their alias. One in between is partially aliased, and not tested. For regular fractions
this is the structure of the defining relation (Box and Hunter, The 2^(k-p) fractional factorial designs, Technometrics
3, 1961). It needs no generators, and is valid for factors with any number of treatments.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations
from math import comb
from typing import NamedTuple

import numpy as np

from robot_runner.analysis.arrays import Floats, Numbers
from robot_runner.analysis.statistics.effect_coding import Factors, Term

#: The most factors of an interaction: larger ones can hardly be interpreted.
_MOST_FACTORS = 3
#: The most effects that are considered: nobody would read a longer list of aliases.
_MOST_TERMS = 5_000
#: Shares below this count as 0, and above 1 minus this as 1: the difference is rounding.
_ROUNDING = 1e-8


class Aliasing(NamedTuple):
    """The effects that combinations can estimate.

    Attributes:
        terms: the effects that are tested.
        aliases: for each of them, the effects that it explains completely.
        mixed: the tested effects that are partially aliased with others.
    """

    terms: tuple[Term, ...]
    aliases: Mapping[Term, tuple[Term, ...]]
    mixed: frozenset[Term]


def aliasing_of(
    factors: Factors, codes: Mapping[str, Numbers], *, main_only: bool = False, together: int = 1
) -> Aliasing:
    """Return the effects that combinations can estimate, and their aliases.

    Args:
        factors: the factors, with their treatments.
        codes: the index of the treatment of each combination, by factor; each combination once.
        main_only: whether interactions are left out, as for designs that are made for main effects.
        together: effects of up to this many factors are kept if they are estimable, even if they are not orthogonal.

    Example:
        >>> a, b = np.array([0, 1, 0, 1]), np.array([0, 0, 1, 1])
        >>> codes = {"A": a, "B": b, "C": (a + b + 1) % 2}
        >>> found = aliasing_of(Factors(dict.fromkeys(codes, ["low", "high"])), codes)
        >>> found.terms, found.aliases[("A",)]
        ((('A',), ('B',), ('C',)), (('B', 'C'),))
    """
    count = len(next(iter(codes.values())))
    kept: dict[Term, Floats] = {}
    basis: Floats = np.full((count, 1), count**-0.5)
    aliases: dict[Term, list[Term]] = {}
    mixed: set[Term] = set()
    for term in _candidates(tuple(codes), main_only=main_only):
        if not factors.has(term):
            continue
        columns = factors.columns(codes, [term])[term]
        told = basis.T @ columns
        share = float(np.sum(told**2) / np.sum(columns**2))
        if share < _ROUNDING or (len(term) <= together and _is_estimable(basis, columns)):
            kept[term] = columns
            basis = np.column_stack([basis, _orthonormal(columns - basis @ told)])
            continue
        partners = [each for each, mine in kept.items() if np.sum((_orthonormal(mine).T @ columns) ** 2) > _ROUNDING]
        if share > 1 - _ROUNDING:
            for each in partners:
                aliases.setdefault(each, []).append(term)
        else:
            mixed.update(partners)
    return Aliasing(tuple(kept), {term: tuple(of) for term, of in aliases.items()}, frozenset(mixed))


def _candidates(names: Sequence[str], *, main_only: bool) -> Iterator[Term]:
    left = _MOST_TERMS
    for size in range(1, 2 if main_only else _MOST_FACTORS + 1):
        left -= comb(len(names), size)
        if left < 0 and size > 1:
            return
        yield from combinations(names, size)


def _is_estimable(basis: Floats, columns: Floats) -> bool:
    rest = columns - basis @ (basis.T @ columns)
    return bool(np.linalg.matrix_rank(rest, tol=_ROUNDING * len(rest)) == columns.shape[1])


def _orthonormal(columns: Floats) -> Floats:
    return np.asarray(np.linalg.qr(columns)[0], dtype=np.float64)
