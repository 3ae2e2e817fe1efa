"""Factors that apply under a condition only: nested within the treatments of other factors that decide on them.

A conditional factor has effects among the runs where it applies. In the mean of a treatment that it is nested within,
each of its own treatments counts the same: `y ~ Sensor / Resolution` with sums to zero within each level, as R writes
it (Montgomery, Design and Analysis of Experiments, 2013, chapter 14). So effects of all factors, and the interactions
of those that apply together, are contrasts of the means of combinations, and together tell all of their differences.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property, lru_cache
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


#: What a conditional factor has where it does not apply.
IDLE = str(INACTIVE)

_PAIR = 2


class NestedFactors(Factors):
    """Factors with their treatments, some of which apply under a condition only; `inactive` is no treatment.

    Attributes:
        conditions: of those that do not apply everywhere.

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
        """Return whether there is an effect of these factors: whether they apply together, and vary there."""
        return all(map(len, self.scope(term).values())) and min(map(len, self.levels(term))) >= _PAIR

    @property
    def count(self) -> int:
        """How many combinations there can be."""
        bound = {name for name, of in self.conditions.items() for name in (name, *of)}
        apart = math.prod(len(levels) for name, levels in self.items() if name not in bound)
        return apart * len(self.only(bound).cells)

    @cached_property
    def cells(self) -> tuple[tuple[str, ...], ...]:
        """All combinations that there can be, in the order of treatments; the last factor changes fastest."""
        found: list[dict[str, str]] = [{}]
        for name in self._by_decision:
            found = [{**cell, name: text} for cell in found for text in self._texts(name, cell)]
        order = {name: {text: at for at, text in enumerate([*levels, IDLE])} for name, levels in self.items()}
        every = [tuple(cell[name] for name in self) for cell in found]
        return tuple(sorted(every, key=lambda cell: [order[name][text] for name, text in zip(self, cell, strict=True)]))

    @property
    def _by_decision(self) -> list[str]:
        """The factors, those that decide before those that they decide on."""
        order: list[str] = []
        while len(order) < len(self):
            order += [name for name in self if name not in order and set(self.conditions.get(name, ())) <= set(order)]
        return order

    def _texts(self, name: str, cell: Mapping[str, str]) -> list[str]:
        applies = all(cell[parent] in wanted for parent, wanted in self.conditions.get(name, {}).items())
        return self[name] if applies else [IDLE]

    def numbers(self, codes: Mapping[str, Numbers]) -> Numbers:
        """Return the number of each run's combination among the cells.

        Args:
            codes: the number of each run's treatment, by factor; where it does not apply, one more than the last.
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
        """How much each cell counts in the mean of all: at each decision, treatments count the same."""
        parts = [
            math.prod(1 / len(self[name]) for name, text in zip(self, cell, strict=True) if text in self[name])
            for cell in self.cells
        ]
        return np.array(parts)

    def weights(self, treatments: Mapping[str, str]) -> Floats:
        """Return the weights of the cells in the mean of some treatments; of others, each counts the same.

        Args:
            treatments: by factor, `inactive` among them where they are of one combination.
        """
        named = [(list(self).index(name), text) for name, text in treatments.items()]
        found = self._shares * [all(cell[at] == text for at, text in named) for cell in self.cells]
        return np.asarray(found / found.sum(), dtype=np.float64)

    def contrasts(self, term: Sequence[str]) -> Floats:
        """Return the contrasts of an effect, orthonormal, (degrees of freedom, cells); of no factor the mean of all."""
        levels = self.levels(term)
        means = np.stack([self.weights(dict(zip(term, texts, strict=True))) for texts in product(*levels)])
        rows = kron([linalg.helmert(len(each)) for each in levels], np.ones((1, 1))) @ means
        turned, triangle = np.linalg.qr(rows.T)
        return np.asarray((turned * np.sign(np.diag(triangle))).T, dtype=np.float64)

    def row(self, terms: Sequence[Term], treatments: Mapping[str, str]) -> Floats:
        """Return 1 and the columns of each effect, of the mean of some treatments; see `weights`."""
        return np.asarray(self.weights(treatments) @ self._columns(tuple(terms)), dtype=np.float64)

    def columns(self, codes: Mapping[str, Numbers], terms: Sequence[Term]) -> dict[Term, Floats]:
        """Return the columns of effects, coded to sum up to zero; where factors do not apply, 0."""
        numbers = self.numbers(codes)
        return {term: self._coded(term)[numbers] for term in terms}

    def squares(self, term: Sequence[str]) -> Floats:
        """Return the mean over all combinations of the products of the columns of an effect.

        The columns are those that its contrasts see: where more is nested within one treatment than within others, the
        effects do not sum up to zero over all combinations.
        """
        seen = self.contrasts(term) @ self._coded(term)
        return np.asarray(seen.T @ seen / len(self.cells), dtype=np.float64)

    def _columns_of(self, terms: Sequence[Term]) -> Floats:
        """Return the columns of effects, (cells, columns): of those that do not apply to a cell 0."""
        parts = [np.ones((len(self.cells), 1)), *map(self._coded, terms)]
        return np.column_stack(parts)

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
    """Return the number of each run's treatment, by factor; where one does not apply, one more than the last."""
    return {
        name: frame[name]
        .astype(str)
        .map({IDLE: len(levels)} | {text: place for place, text in enumerate(levels)})
        .to_numpy(np.intp)
        for name, levels in factors.items()
    }


def factors_of(treatments: Mapping[str, Sequence[str]], conditions: Conditions) -> Factors:
    """Return factors with their treatments, nested where some apply to some runs only."""
    return NestedFactors(treatments, conditions) if conditions else Factors(treatments)


def conditions_of(planned: pd.DataFrame) -> Conditions:
    """Return where factors apply that do not apply everywhere, as the combinations of a run table tell.

    A factor is conditional where treatments of others decide whether it is `inactive`: each of these factors by itself.

    Args:
        planned: the treatments of each factor, as texts; one row a combination. Of columns that decide alike, the last
            one is taken.

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
        own = dict(_deciding(planned, name, ~rests))
        for parent in sorted(own, key=lambda each: each not in idle):  # those that follow from others
            if _decide({each: of for each, of in own.items() if each != parent}, planned, ~rests):
                del own[parent]
        if _decide(own, planned, ~rests):
            found[name] = own
    # Of two that decide on each other, one has a treatment that happens to be called so.
    while circular := [name for name in found if name in _above(found, name)]:
        del found[min(circular, key=lambda name: active[name])]
    return found


def _deciding(planned: pd.DataFrame, name: str, applies: NDArray[np.bool_]) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Yield the factors of which not all treatments occur where a factor applies, with those that do."""
    for parent in map(str, planned):
        texts = tuple(dict.fromkeys(planned[parent][applies]))
        if parent != name and 0 < len(texts) < len(set(planned[parent])):
            yield parent, texts


def _decide(conditions: Mapping[str, Sequence[str]], planned: pd.DataFrame, applies: NDArray[np.bool_]) -> bool:
    """Return whether a factor applies where these conditions hold, and only there."""
    if not conditions:
        return False
    held = np.all([planned[parent].isin(texts).to_numpy() for parent, texts in conditions.items()], axis=0)
    return bool(np.array_equal(held, applies))


def _above(conditions: Conditions, name: str) -> set[str]:
    """Return the factors that decide on a factor, directly or through others."""
    found: set[str] = set()
    open_names = list(conditions.get(name, ()))
    while open_names:
        parent = open_names.pop()
        if parent not in found:
            found.add(parent)
            open_names += conditions.get(parent, ())
    return found
