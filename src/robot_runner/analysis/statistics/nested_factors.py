"""Conditional factors: nested within the treatments of their parent factors.

A conditional factor has effects among the runs to which it applies. In the mean of a treatment that it is nested
within, its treatments have equal weights: `y ~ Sensor / Resolution` in R, with sum coding within each level
(Montgomery, Design and Analysis of Experiments, 2013, chapter 14). So the effects of all factors, and the interactions
of those that apply together, are contrasts of the means of combinations, and together explain all their differences.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property, lru_cache
from graphlib import TopologicalSorter
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
from scipy import linalg

from robot_runner.analysis.arrays import Floats, Numbers
from robot_runner.analysis.statistics.effect_coding import Conditions, Factors, Term, kron, sum_coding
from robot_runner.core.words import INACTIVE

if TYPE_CHECKING:
    import pandas as pd
    from numpy.typing import NDArray


#: The value of a conditional factor where it does not apply.
IDLE = str(INACTIVE)

_PAIR = 2


class NestedFactors(Factors):
    """Factors with their treatments, some of them conditional; `inactive` is not a treatment.

    Attributes:
        conditions: of the conditional factors.

    Example:
        >>> found = NestedFactors(
        ...     {"Sensor": ["camera", "lidar"], "Resolution": ["720p", "1080p"]},
        ...     {"Resolution": {"Sensor": ("camera",)}},
        ... )
        >>> found.cells
        (('camera', '720p'), ('camera', '1080p'), ('lidar', 'inactive'))
        >>> found.terms(2), found.weights({"Sensor": "camera"}).tolist()
        ((('Sensor',), ('Resolution',)), [0.5, 0.5, 0.0])
    """

    def __init__(self, treatments: Mapping[str, Sequence[str]], conditions: Conditions) -> None:
        super().__init__(treatments, conditions)
        self._columns = lru_cache(maxsize=16)(self._columns_of)

    def has(self, term: Sequence[str]) -> bool:
        """Return whether these factors have an effect together: whether they apply together, and vary there."""
        return all(map(len, self.scope(term).values())) and min(map(len, self.levels(term))) >= _PAIR

    @property
    def count(self) -> int:
        """The number of possible combinations."""
        bound = {name for name, of in self.conditions.items() for name in (name, *of)}
        apart = math.prod(len(levels) for name, levels in self.items() if name not in bound)
        return apart * len(self.only(bound).cells)

    @cached_property
    def cells(self) -> tuple[tuple[str, ...], ...]:
        """All possible combinations, in the order of treatments; the last factor changes fastest."""
        found: list[dict[str, str]] = [{}]
        for name in TopologicalSorter({name: self.conditions.get(name, ()) for name in self}).static_order():
            found = [{**cell, name: text} for cell in found for text in self._texts(name, cell)]
        order = {name: {text: at for at, text in enumerate([*levels, IDLE])} for name, levels in self.items()}
        every = [tuple(cell[name] for name in self) for cell in found]
        return tuple(sorted(every, key=lambda cell: [order[name][text] for name, text in zip(self, cell, strict=True)]))

    def _texts(self, name: str, cell: Mapping[str, str]) -> list[str]:
        applies = all(cell[parent] in wanted for parent, wanted in self.conditions.get(name, {}).items())
        return self[name] if applies else [IDLE]

    def numbers(self, codes: Mapping[str, Numbers]) -> Numbers:
        """Return the index of each run's combination among the cells.

        The index of a treatment is one more than the last where its factor does not apply.
        """
        sizes = [len(levels) + 1 for levels in self.values()]
        known = [
            [([*levels, IDLE]).index(text) for levels, text in zip(self.values(), cell, strict=True)]
            for cell in self.cells
        ]
        if not sizes:
            return np.zeros(len(next(iter(codes.values()), ())), dtype=np.intp)
        places = np.ravel_multi_index(tuple(np.array(known).T), sizes)
        return np.searchsorted(places, np.ravel_multi_index(tuple(codes[name] for name in self), sizes))

    @cached_property
    def _shares(self) -> Floats:
        """The weight of each cell in the overall mean: the treatments of each factor have equal weights."""
        parts = [
            math.prod(1 / len(self[name]) for name, text in zip(self, cell, strict=True) if text in self[name])
            for cell in self.cells
        ]
        return np.array(parts)

    def weights(self, treatments: Mapping[str, str]) -> Floats:
        """Return the weights of the cells in a marginal mean, equal over the treatments of the other factors.

        For a single combination, treatments may include `inactive`.
        """
        named = [(list(self).index(name), text) for name, text in treatments.items()]
        found = self._shares * [all(cell[at] == text for at, text in named) for cell in self.cells]
        return np.asarray(found / found.sum(), dtype=np.float64)

    def contrasts(self, term: Sequence[str]) -> Floats:
        """Return the orthonormal contrasts of an effect, (degrees of freedom, cells); for no factor, the mean."""
        levels = self.levels(term)
        means = np.stack([self.weights(dict(zip(term, texts, strict=True))) for texts in product(*levels)])
        rows = kron([linalg.helmert(len(each)) for each in levels], np.ones((1, 1))) @ means
        turned, triangle = np.linalg.qr(rows.T)
        return np.asarray((turned * np.sign(np.diag(triangle))).T, dtype=np.float64)

    def row(self, terms: Sequence[Term], treatments: Mapping[str, str]) -> Floats:
        """Return the row of the design matrix (1, then the effects) for a marginal mean; see `weights`."""
        return np.asarray(self.weights(treatments) @ self._columns(tuple(terms)), dtype=np.float64)

    def columns(self, codes: Mapping[str, Numbers], terms: Sequence[Term]) -> dict[Term, Floats]:
        """Return the sum-coded columns of effects; 0 where factors do not apply."""
        numbers = self.numbers(codes)
        return {term: self._coded(term)[numbers] for term in terms}

    def squares(self, term: Sequence[str]) -> Floats:
        """Return the mean over all combinations of the products of the columns of an effect.

        The columns are projected on the contrasts of the effect: if more is nested within one treatment than within
        others, the effects do not sum up to zero over all combinations.
        """
        seen = self.contrasts(term) @ self._coded(term)
        return np.asarray(seen.T @ seen / len(self.cells), dtype=np.float64)

    def _columns_of(self, terms: Sequence[Term]) -> Floats:
        """Return the columns of effects, (cells, columns); 0 where an effect does not apply to a cell."""
        return np.column_stack([np.ones((len(self.cells), 1)), *map(self._coded, terms)])

    def _coded(self, term: Sequence[str]) -> Floats:
        places = [list(self).index(name) for name in term]
        coded = [dict(zip(levels, sum_coding(len(levels)), strict=True)) for levels in self.levels(term)]
        nothing = np.zeros(self.size(term))
        rows = []
        for cell in self.cells:
            own = [of.get(cell[at]) for of, at in zip(coded, places, strict=True)]
            known = [each for each in own if each is not None]
            rows.append(kron(known, np.ones(1)) if len(known) == len(own) else nothing)
        return np.stack(rows)


def codes_of(frame: pd.DataFrame, factors: Mapping[str, Sequence[str]]) -> dict[str, Numbers]:
    """Return the index of each run's treatment, by factor; one more than the last where a factor does not apply."""
    return {
        name: frame[name]
        .astype(str)
        .map({IDLE: len(levels)} | {text: place for place, text in enumerate(levels)})
        .to_numpy(np.intp)
        for name, levels in factors.items()
    }


def factors_of(treatments: Mapping[str, Sequence[str]], conditions: Conditions) -> Factors:
    """Return factors with their treatments, nested if some are conditional."""
    return NestedFactors(treatments, conditions) if conditions else Factors(treatments)


def conditions_of(planned: pd.DataFrame) -> Conditions:
    """Return the conditions of conditional factors, derived from the combinations of a run table.

    A factor is conditional if the treatments of other factors determine whether it is `inactive`, each by itself. The
    planned treatments are texts, one row for each combination. Of columns with the same information, the last is taken.

    Example:
        >>> import pandas as pd
        >>> rows = [("camera", "720p"), ("camera", "1080p"), ("lidar", "inactive")]
        >>> conditions_of(pd.DataFrame(rows, columns=["Sensor", "Resolution"]))
        {'Resolution': {'Sensor': ('camera',)}}
    """
    idle = {str(name): (planned[name] == IDLE).to_numpy() for name in planned if (planned[name] == IDLE).any()}
    active = {name: len(set(planned[name])) - 1 for name in idle}
    found: Conditions = {}
    for name, rests in idle.items():
        own = dict(_possible_parents(planned, name, ~rests))
        for parent in sorted(own, key=lambda each: each not in idle):  # drop conditions that follow from others
            if _determine({each: of for each, of in own.items() if each != parent}, planned, ~rests):
                del own[parent]
        if _determine(own, planned, ~rests):
            found[name] = own
    # Of two factors that depend on each other, one has a treatment that happens to be named `inactive`.
    while circular := [name for name in found if name in _ancestors(found, name)]:
        del found[min(circular, key=lambda name: active[name])]
    return found


def _possible_parents(
    planned: pd.DataFrame, name: str, applies: NDArray[np.bool_]
) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Yield the factors some of whose treatments never occur where a factor applies, with those that do."""
    for parent in map(str, planned):
        texts = tuple(dict.fromkeys(planned[parent][applies]))
        if parent != name and 0 < len(texts) < len(set(planned[parent])):
            yield parent, texts


def _determine(conditions: Mapping[str, Sequence[str]], planned: pd.DataFrame, applies: NDArray[np.bool_]) -> bool:
    """Return whether a factor applies if and only if these conditions hold."""
    if not conditions:
        return False
    held = np.all([planned[parent].isin(texts).to_numpy() for parent, texts in conditions.items()], axis=0)
    return bool(np.array_equal(held, applies))


def _ancestors(conditions: Conditions, name: str) -> set[str]:
    """Return the parents of a factor, direct and indirect."""
    found: set[str] = set()
    open_names = list(conditions.get(name, ()))
    while open_names:
        parent = open_names.pop()
        if parent not in found:
            found.add(parent)
            open_names += conditions.get(parent, ())
    return found
