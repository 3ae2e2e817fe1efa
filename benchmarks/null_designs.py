"""Designs in which nothing is true, to see how often something is found all the same."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from robot_runner.analysis.statistics.analysed_design import VALUE, MeasureData

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

__all__ = ["DISTRIBUTIONS", "NULL_DESIGNS", "NullDesign"]

#: Each with a mean of 0 and a variance of 1.
DISTRIBUTIONS: dict[str, Callable[[np.random.Generator, tuple[int, ...]], Floats]] = {
    "normal": lambda random, shape: random.normal(size=shape),
    "uniform": lambda random, shape: random.uniform(-(3**0.5), 3**0.5, size=shape),
    "t5": lambda random, shape: random.standard_t(5, size=shape) * (3 / 5) ** 0.5,
    "t3": lambda random, shape: random.standard_t(3, size=shape) / 3**0.5,
    "exponential": lambda random, shape: random.exponential(size=shape) - 1,
    "lognormal": lambda random, shape: (np.exp(random.normal(size=shape)) - np.exp(0.5)) / ((np.e - 1) * np.e) ** 0.5,
}


@dataclass(frozen=True, slots=True)
class NullDesign:
    """A design without effects.

    Attributes:
        levels: how many treatments each factor has.
        runs: of each combination (of each block, where there are blocks), or of all of them.
        spread: the standard deviation of each combination, or of all.
        distribution: a name of `DISTRIBUTIONS`.
        blocks: how many there are; 0 for runs of their own.
        between: how many factors, the first ones, differ between blocks, of which there are so many for each treatment.
        response: the standard deviation of the blocks' own effects of treatments.
        lacking: how many combinations each block lacks, in turn.
        shift: an effect that is there: that of the last factor's first treatment, which is then not counted.
        is_ranked: whether ranks are compared, in the place of means.
        bounds: between which every single effect is to be found, in percent at alpha = 5 %.
        why: they are others than those of all designs; empty otherwise.
    """

    levels: tuple[int, ...]
    runs: int | Sequence[int] = 5
    spread: float | Sequence[float] = 1.0
    distribution: str = "normal"
    blocks: int = 0
    between: int = 0
    response: float = 0.0
    lacking: int = 0
    shift: float = 0.0
    is_ranked: bool = False
    bounds: tuple[float, float] = (3.5, 6.5)
    why: str = ""

    @property
    def name(self) -> str:
        """The design in words."""
        parts = [" x ".join(map(str, self.levels)), self.distribution, f"n {_shown(self.runs)}"]
        if self.spread != 1:
            parts.append(f"sd {_shown(self.spread)}")
        if self.blocks:
            parts.append(f"{self.blocks} blocks{' each' if self.between else ''}")
        if self.between:
            parts.append(f"{self.between} between")
        parts += [f"response sd {self.response:g}"] if self.response else []
        parts += [f"{self.lacking} lacking"] if self.lacking else []
        parts += [f"other effect {self.shift:g}"] if self.shift else []
        parts += ["ranks"] if self.is_ranked else []
        return ", ".join(parts)

    @property
    def cells(self) -> list[tuple[int, ...]]:
        """All combinations, the last factor changing fastest."""
        return list(product(*map(range, self.levels)))

    def rows(self) -> list[tuple[int, tuple[int, ...], int]]:
        """Return block, combination and its number, one a run."""
        runs = [self.runs] * len(self.cells) if isinstance(self.runs, int) else list(self.runs)
        numbered = list(enumerate(self.cells))
        if not self.blocks:
            return [(0, cell, place) for place, cell in numbered for _ in range(runs[place])]
        within = int(np.prod(self.levels[self.between :]))
        groups = list(product(*map(range, self.levels[: self.between])))
        rows = []
        for block in range(self.blocks * len(groups)):
            held = [(place, cell) for place, cell in numbered if cell[: self.between] == groups[block % len(groups)]]
            left = {(block + each) % within for each in range(self.lacking)}
            rows += [
                (block, cell, place)
                for number, (place, cell) in enumerate(held)
                if number not in left
                for _ in range(runs[place])
            ]
        return rows

    def data(self, values: Floats) -> MeasureData:
        """Return an experiment with these values."""
        rows = self.rows()
        frame = pd.DataFrame({VALUE: values, " block": [f"b{block}" for block, _, _ in rows]})
        names = tuple(f"F{place}" for place in range(len(self.levels)))
        for place, name in enumerate(names):
            texts = [f"t{level}" for level in range(self.levels[place])]
            frame[name] = pd.Categorical([texts[cell[place]] for _, cell, _ in rows], texts, ordered=True)
        frame["run_id"] = [f"r_{number}" for number in range(1, len(rows) + 1)]
        frame[" place"] = range(1, len(rows) + 1)
        return MeasureData("y", frame, frame, names, self.blocks > 0)

    def draw(self, random: np.random.Generator, experiments: int) -> Floats:
        """Return the values of all runs, (experiments, runs)."""
        rows = self.rows()
        cells = np.array([place for _, _, place in rows])
        blocks = np.array([block for block, _, _ in rows])
        spread = np.broadcast_to(np.asarray(self.spread, dtype=np.float64), len(self.cells))[cells]
        values: Floats = DISTRIBUTIONS[self.distribution](random, (experiments, len(rows))) * spread
        if self.blocks:
            count = blocks.max() + 1
            values += 3 * random.normal(size=(experiments, count))[:, blocks]
            values += self.response * random.normal(size=(experiments, count, len(self.cells)))[:, blocks, cells]
        shifts = self.shift * np.array([cell[-1] == 0 for _, cell, _ in rows], dtype=np.float64)
        return np.asarray(values + shifts, dtype=np.float64)


def _shown(numbers: float | Sequence[float]) -> str:
    several = [numbers] if isinstance(numbers, int | float) else list(numbers)
    return f"{several[0]:g}" if len(set(several)) == 1 else ":".join(f"{each:g}" for each in several)


def _one_large(count: int, large: float = 4.0) -> tuple[float, ...]:
    return (*[1.0] * (count - 1), large)


_SKEWED = "few skewed values: t is careful"
_SKEWED_UNEQUAL = "skewed values of unequal spreads bias t"
_TINY = "variances of three runs are hardly known"
_TWO_RUNS = "the variance of two runs is not known"
_RANKED = "ranks of few runs are coarse"
_RANKED_UNEQUAL = "spreads that differ are not told by ranks"
_FEW_BLOCKS = "Greenhouse-Geisser is careful of few blocks"

NULL_DESIGNS: tuple[NullDesign, ...] = (
    # Two treatments: Welch's t.
    *(NullDesign((2,), runs) for runs in (5, 10, 30)),
    *(NullDesign((2,), runs, distribution="uniform") for runs in (5, 10, 30)),
    *(NullDesign((2,), runs, distribution="t5") for runs in (10, 30)),
    NullDesign((2,), (5, 15), (3, 1)),
    NullDesign((2,), (5, 15), (1, 3)),
    NullDesign((2,), (10, 30), (4, 1)),
    NullDesign((2,), 10, (1, 10)),
    NullDesign((2,), 10, distribution="exponential"),
    NullDesign((2,), 30, distribution="lognormal"),
    # More treatments: Welch-James and ANOVA-type together, by a bootstrap where groups are many and small.
    *(NullDesign((3,), runs) for runs in (5, 10, 30)),
    NullDesign((3,), 5, _one_large(3)),
    NullDesign((3,), 10, _one_large(3)),
    NullDesign((3,), (5, 10, 15), (3, 2, 1)),
    NullDesign((3,), (5, 10, 15), (1, 2, 3)),
    NullDesign((3,), 10, distribution="uniform"),
    NullDesign((3,), 10, distribution="exponential"),
    NullDesign((3,), 10, distribution="t5"),
    NullDesign((3,), 4, _one_large(3)),
    NullDesign((3,), 10, _one_large(3, 10.0)),
    NullDesign((4,), 5, _one_large(4)),
    NullDesign((5,), 5),
    NullDesign((5,), 5, _one_large(5)),
    NullDesign((5,), 10, (1, 1.5, 2, 2.5, 3)),
    NullDesign((5,), 10, _one_large(5)),
    NullDesign((6,), 5, _one_large(6)),
    NullDesign((6,), 7, _one_large(6)),
    NullDesign((8,), 5),
    NullDesign((8,), 5, _one_large(8)),
    NullDesign((8,), 10, _one_large(8)),
    # Factorials: Welch's t, and the same two together.
    NullDesign((2, 2), 5),
    NullDesign((2, 2), 5, _one_large(4)),
    NullDesign((2, 2), 10, _one_large(4)),
    NullDesign((2, 2), (5, 10, 15, 5), (4, 2, 1, 3)),
    NullDesign((2, 2), (5, 10, 15, 5), (1, 2, 3, 4)),
    NullDesign((2, 2), 5, _one_large(4), shift=20.0),
    NullDesign((2, 2), 10, _one_large(4, 10.0), distribution="t5"),
    NullDesign((2, 2, 2), 5),
    NullDesign((2, 2, 2), 10),
    NullDesign((2, 2, 2), 10, _one_large(8)),
    NullDesign((2, 2, 2), 10, _one_large(8, 10.0)),
    NullDesign((2, 2, 2), 10, tuple(np.linspace(1, 10, 8).round(1).tolist()), distribution="t3"),
    NullDesign((3, 2), 5),
    NullDesign((3, 2), 5, _one_large(6)),
    NullDesign((3, 2), 10, _one_large(6)),
    NullDesign((3, 2), 5, shift=20.0),
    NullDesign((3, 2), (5, 8, 12, 5, 9, 6), (3, 2, 1, 4, 1, 2)),
    NullDesign((3, 3), 5),
    NullDesign((3, 3), 5, _one_large(9)),
    NullDesign((3, 3), 10, _one_large(9)),
    NullDesign((4, 3), 5),
    NullDesign((4, 3), 5, _one_large(12)),
    NullDesign((4, 3), 10, _one_large(12)),
    # Complete blocks: t of differences, Greenhouse-Geisser, Huynh-Feldt, sign flips.
    *(NullDesign((2,), 1, (1, 3), blocks=blocks) for blocks in (5, 10, 30)),
    *(NullDesign((3,), 1, blocks=blocks) for blocks in (6, 10, 30)),
    *(NullDesign((3,), 1, _one_large(3), blocks=blocks) for blocks in (5, 6, 10, 30)),
    NullDesign((3,), 1, blocks=5),
    NullDesign((3,), 1, _one_large(3), blocks=4),
    NullDesign((4,), 1, _one_large(4), blocks=6),
    NullDesign((4,), 1, blocks=8),
    NullDesign((4,), 1, _one_large(4), blocks=8),
    NullDesign((3, 3), 1, _one_large(9), blocks=9),
    NullDesign((4,), 1, (1, 2, 3, 4), blocks=15),
    NullDesign((6,), 1, _one_large(6), blocks=20),
    *(NullDesign((treatments,), 1, blocks=8) for treatments in (5, 6)),
    NullDesign((6,), 1, _one_large(6), blocks=8),
    NullDesign((6,), 1, _one_large(6), blocks=10),
    NullDesign((2, 2), 1, _one_large(4), blocks=8),
    NullDesign((3, 2), 1, _one_large(6), blocks=12),
    # Replicated blocks that respond differently.
    NullDesign((2,), 10, blocks=5, response=1.0),
    NullDesign((2,), 10, blocks=10, response=2.0),
    NullDesign((3,), 5, blocks=6, response=1.0),
    NullDesign((3,), 10, blocks=10, response=2.0),
    NullDesign((2, 2), 5, blocks=10, response=1.0),
    # Factors that differ between blocks only.
    NullDesign((2, 2), 1, blocks=6, between=1),
    NullDesign((2, 2), 1, (1, 1, 3, 3), blocks=6, between=1),
    NullDesign((2, 3), 1, (1, 1, 1, 3, 3, 3), blocks=8, between=1),
    NullDesign((2, 3), 1, _one_large(6), blocks=9, between=1),
    NullDesign((3, 2), 1, (1, 1, 2, 2, 4, 4), blocks=6, between=1),
    # Incomplete blocks (mixed model), single runs (one variance).
    NullDesign((3,), 1, blocks=12, lacking=1),
    NullDesign((4,), 1, blocks=16, lacking=2),
    NullDesign((3,), 4, blocks=12, lacking=1, response=1.0),
    NullDesign((4, 3), 1),
    # Where no test of means holds its level, and what is expected then.
    NullDesign((2,), 5, distribution="lognormal", bounds=(1.0, 3.0), why=_SKEWED),
    NullDesign((3,), 5, distribution="lognormal", bounds=(1.0, 3.0), why=_SKEWED),
    NullDesign((2, 2), 5, distribution="lognormal", bounds=(1.5, 3.5), why=_SKEWED),
    NullDesign((2,), 10, (1, 4), distribution="lognormal", bounds=(10.0, 20.0), why=_SKEWED_UNEQUAL),
    NullDesign((3,), (5, 10, 15), (3, 2, 1), distribution="lognormal", bounds=(10.0, 20.0), why=_SKEWED_UNEQUAL),
    NullDesign((2,), 3, bounds=(2.5, 5.0), why=_TINY),
    NullDesign((3,), 3, _one_large(3), bounds=(5.0, 7.0), why=_TINY),
    NullDesign((5,), 3, bounds=(2.0, 5.0), why=_TINY),
    NullDesign((8,), 3, _one_large(8), bounds=(4.0, 7.0), why=_TINY),
    NullDesign((4,), 1, blocks=5, bounds=(1.5, 4.0), why=_FEW_BLOCKS),
    NullDesign((2, 3), 1, blocks=4, between=1, bounds=(2.5, 6.5), why=_FEW_BLOCKS),
    NullDesign((2,), (2, 8), bounds=(8.0, 10.0), why=_TWO_RUNS),
    *(
        NullDesign(levels, runs, is_ranked=True, bounds=(2.0, 8.0), why=_RANKED)
        for levels, runs in (((2,), 4), ((2,), (4, 20)), ((2,), 10), ((3,), 3), ((3,), 5), ((20,), 4), ((2, 2), 3))
    ),
    NullDesign((3,), (5, 10, 15), (3, 2, 1), is_ranked=True, bounds=(6.0, 8.5), why=_RANKED_UNEQUAL),
)
