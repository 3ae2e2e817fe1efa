"""The candidate designs of a study and their durations, for `robot-runner design`."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

from robot_runner.core.design.columns import REPETITION
from robot_runner.core.design.design import CombinationDesign, Design, FullFactorial
from robot_runner.core.design.factor import Factor
from robot_runner.core.design.full_factorial import full_size
from robot_runner.core.design.run_table_model import RunTableModel
from robot_runner.core.errors import DesignError
from robot_runner.core.words import INACTIVE
from robot_runner.designs.covering import CoveringArray
from robot_runner.designs.fractional import FractionalFactorial
from robot_runner.designs.one_at_a_time import OneFactorAtATime
from robot_runner.designs.optimal import DOptimal
from robot_runner.designs.split_plot import SplitPlot

#: The column of the whole plots of a candidate split-plot design.
_PLOT = "Whole plot"
#: The most repetitions: the budget does not limit a study that could have more.
_MOST = 200
#: The number of D-optimal combinations per parameter of the model, so that some are left to estimate the error.
_COMBINATIONS_A_PARAMETER = 1.5
_ROMAN = {3: "III", 4: "IV", 5: "V"}


@dataclass(frozen=True, slots=True)
class RunTimes:
    """The duration of runs, and the cost of changing a treatment.

    Attributes:
        of_run: returns the duration of a run of a combination, in s.
        pause: between two runs, in s.
        changes: the time to change the treatment of a factor, in s, by its name.
    """

    of_run: Callable[[Mapping[str, object]], float]
    pause: float
    changes: Mapping[str, float]

    def seconds(self, model: RunTableModel) -> float:
        """Return the duration of all runs of a plan, in its order, in s."""
        combinations = [run.combination for run in model.plan()]
        total = math.fsum(map(self.of_run, combinations)) + self.pause * max(0, len(combinations) - 1)
        for name, cost in self.changes.items():
            total += cost * sum(one[name] != other[name] for one, other in pairwise(combinations))
        return total


@dataclass(frozen=True, slots=True)
class Candidate:
    """A candidate design; `made` returns its model for a number of repetitions (replicates of a split plot)."""

    name: str
    made: Callable[[int], RunTableModel]

    def problem(self) -> str:
        """Return why it is impossible for these factors; empty if it is possible."""
        try:
            self.made(1).plan()
        except DesignError as error:
            return "; ".join(finding.problem for finding in error.findings) or error.problem
        return ""


def candidates_of(model: RunTableModel, hard: Sequence[str]) -> Iterator[Candidate]:
    """Yield the designs that are possible for the factors of a study, that of the config first."""
    if not model.is_full_factorial:
        kind = str(model.design_facts.get("kind", "design")).replace("_", " ")
        yield Candidate(f"the config's own ({kind})", model.repeated)
    yield Candidate("full factorial", partial(_designed, model, FullFactorial()))
    yield Candidate("full factorial in blocks of a repetition", partial(_in_blocks, model))
    if hard:
        yield Candidate(f"split plot, {' x '.join(hard)} in whole plots", partial(_split_plot, model, tuple(hard)))
    if all(len(factor.treatments) == 2 for factor in model.factors):  # noqa: PLR2004 - what fractions are of
        least = full_size(model.factors)
        for resolution in (5, 4, 3):
            design = FractionalFactorial(resolution=resolution)
            size = _count(model, design)
            if size < least:  # else it is the previous fraction, or the full factorial
                least = size
                yield Candidate(f"fraction of resolution {_ROMAN[resolution]}", partial(_designed, model, design))
    if len(model.factors) > 1:
        base = {
            factor.name: next(each for each in factor.treatments if each is not INACTIVE) for factor in model.factors
        }
        yield Candidate("one factor at a time", partial(_designed, model, OneFactorAtATime(base=base)))
        full = _count(model, FullFactorial()) or full_size(model.factors)
        if _count(model, CoveringArray(strength=2)) < full:
            yield Candidate("covering array of pairs", partial(_designed, model, CoveringArray(strength=2)))
        for words, kind, parameters in _models(model.factors):
            size = math.ceil(_COMBINATIONS_A_PARAMETER * parameters)
            if size < full:
                yield Candidate(f"D-optimal for {words}", partial(_designed, model, DOptimal(runs=size, model=kind)))


def _count(model: RunTableModel, design: Design | CombinationDesign) -> int:
    try:
        return len(model.designed(design, repetitions=1).plan())
    except DesignError:
        return 0  # the comparison reports why


def _models(factors: Sequence[Factor]) -> Iterator[tuple[str, str, int]]:
    widths = [len([each for each in factor.treatments if each is not INACTIVE]) - 1 for factor in factors]
    main = 1 + sum(widths)
    yield "main effects", "main", main
    yield (
        "interactions of two factors",
        "interactions",
        main + (sum(widths) ** 2 - sum(each**2 for each in widths)) // 2,
    )


def _designed(model: RunTableModel, design: Design | CombinationDesign, repetitions: int) -> RunTableModel:
    made = model.designed(design, repetitions=repetitions)
    made.randomize_runs_order(model.seed)
    return made


def _in_blocks(model: RunTableModel, repetitions: int) -> RunTableModel:
    made = model.designed(FullFactorial(), repetitions=max(2, repetitions), blocks=REPETITION)
    made.randomize_runs_order(model.seed, blocks=REPETITION)
    return made


def _split_plot(model: RunTableModel, hard: tuple[str, ...], replicates: int) -> RunTableModel:
    held = {tuple(str(run.combination[name]) for name in hard) for run in model.plan()}
    plots = Factor(_PLOT, list(range(1, max(2, replicates) * len(held) + 1)))
    made = model.designed(SplitPlot(hard=list(hard), plot=_PLOT), repetitions=1, more=(plots,))
    made.randomize_runs_order(model.seed)
    return made


def most_repetitions(candidate: Candidate, times: RunTimes, budget: float) -> int:
    """Return how many repetitions of a design fit into a budget, in s; 0 if none does.

    Raises:
        DesignError: the design is impossible.
    """
    once = times.seconds(candidate.made(1))
    if once > budget:
        return 0
    low, high = 1, min(_MOST, max(2, int(2 * budget / max(once, 1e-9))))
    while low < high:  # bisection: plans with more repetitions take longer
        middle = (low + high + 1) // 2
        if times.seconds(candidate.made(middle)) <= budget:
            low = middle
        else:
            high = middle - 1
    return low
