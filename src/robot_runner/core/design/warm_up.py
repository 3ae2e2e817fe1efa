"""Runs that only warm up the robot, its computer and its instruments: executed and kept, but not analysed."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, islice, repeat

from robot_runner.core.design.columns import numbered_warm_up_id
from robot_runner.core.design.factor import Factor
from robot_runner.core.design.numeric_range import is_whole
from robot_runner.core.design.planned_runs import PlannedRun
from robot_runner.core.errors import DesignError, Finding, did_you_mean

#: The value of `WarmUp.per` for a warm-up of each combination.
COMBINATION = "combination"
#: More warm-up runs are a mistake, and planning them would take minutes.
_MOST_RUNS = 10_000
_READABLE = 10**15


@dataclass(frozen=True, slots=True, init=False)
class WarmUp:
    """How an experiment warms up.

    Attributes:
        runs: how many warm-up runs there are: at the start, or for each of what `per` names.
        per: None for the start, with the treatments of the first runs; the name of a factor for each of its treatments,
            or `combination` for each combination: then directly before the first run that has it, with the treatments
            of that run.
        each_session: whether a resumed experiment warms up again for what is left to do; otherwise a warm-up run that
            is done is not executed again.

    Raises:
        DesignError: an attribute is of a wrong type, or there is less than one run, or more than 10,000.

    Example:
        >>> WarmUp(2, per="Task").per
        'Task'
    """

    runs: int
    per: str | None
    each_session: bool

    def __init__(self, runs: int = 1, per: str | Factor | None = None, *, each_session: bool = False) -> None:
        DesignError.refuse(_findings(runs, per, each_session))
        object.__setattr__(self, "runs", runs)
        object.__setattr__(self, "per", per.name if isinstance(per, Factor) else per)
        object.__setattr__(self, "each_session", each_session)

    def __str__(self) -> str:
        runs = "1 warm-up run" if self.runs == 1 else f"{self.runs:,} warm-up runs"
        if self.per is None:
            return f"{runs} at the start"
        return f"{runs} for each {'combination' if self.per == COMBINATION else f'treatment of {self.per}'}"

    def unknown_factor(self, factors: Sequence[Factor]) -> Iterator[Finding]:
        """Yield an error where `per` names nothing that a design with these factors has."""
        known = [*(factor.name for factor in factors), COMBINATION]
        if self.per is not None and self.per not in known:
            problem = f"there is no factor {self.per!r} to warm up for"
            yield Finding.error("warm_up", problem, did_you_mean(self.per, known))

    def key(self, run: PlannedRun) -> tuple[int, ...]:
        """Return the key by which runs of one batch share a warm-up."""
        if self.per is None:
            return ()
        if self.per in run.combination:
            return (id(run.combination[self.per]),)  # the factor's own object
        return tuple(map(id, run.combination.treatments))

    def group(self, run: PlannedRun) -> tuple[int, ...]:
        """Return the key by which runs share a warm-up, over all batches."""
        return (run.batch, *self.key(run))


def warm_up_of(given: object) -> WarmUp | None:
    """Return the warm-up of a design, given as such, or as the number of runs at the start.

    Raises:
        DesignError: it is neither.
    """
    if given is None or (given == 0 and not isinstance(given, bool)):
        return None
    if isinstance(given, WarmUp):
        return given
    if not is_whole(given):
        problem = f"{given!r} is of type {type(given).__name__}"
        raise DesignError(problem, where="warm_up", fix='Give a number of runs, or WarmUp(2, per="Task").')
    return WarmUp(given)


def with_warm_ups(runs: Sequence[PlannedRun], warm_up: WarmUp | None, *, first: int = 1) -> Sequence[PlannedRun]:
    """Return planned runs with the warm-up runs among them, numbered in the order of execution.

    `runs`, in the order of execution, are those of one batch; the first warm-up run has the number `first`.
    """
    if warm_up is None or not runs:
        return runs
    start = runs[0].number
    ordered: list[PlannedRun] = []
    warmed: set[tuple[int, ...]] = set()
    for place, run in enumerate(runs):
        if warm_up.key(run) not in warmed:
            warmed.add(warm_up.key(run))
            same = chain.from_iterable(repeat(runs[place:])) if warm_up.per is None else repeat(run)
            ordered += (each._replace(repetition=0) for each in islice(same, warm_up.runs))
        ordered.append(run)
    numbered = (run._replace(number=number) for number, run in enumerate(ordered, start))
    ids = map(numbered_warm_up_id, range(first, first + len(ordered)))
    return [run._replace(run_id=next(ids)) if run.is_warm_up else run for run in numbered]


def with_warm_ups_again(
    runs: Sequence[PlannedRun], selected: Sequence[int], done: Iterable[int], warm_up: WarmUp
) -> list[int]:
    """Return the indices of runs to execute, with warm-up runs of `done` before the first run that they are for."""
    again: dict[tuple[int, ...], list[int]] = {}
    for place in set(done).difference(selected):
        if runs[place].is_warm_up:
            again.setdefault(warm_up.group(runs[place]), []).append(place)
    ordered: list[int] = []
    for place in selected:
        if not runs[place].is_warm_up:
            ordered += sorted(again.pop(warm_up.group(runs[place]), ()))
        ordered.append(place)
    return ordered


def _findings(runs: object, per: object, each_session: object) -> Iterator[Finding]:
    if not is_whole(runs):
        problem = f"the number of runs is {runs!r}, of type {type(runs).__name__}"
        yield Finding.error("warm_up", problem, "Give a whole number from 1.")
    elif not 1 <= runs <= _MOST_RUNS:
        shown = f"{runs:,}" if abs(runs) < _READABLE else "a number of many digits"
        fix = f"Give a whole number from 1 to {_MOST_RUNS:,}."
        yield Finding.error("warm_up", f"the number of runs is {shown}", fix)
    if per is not None and not isinstance(per, str | Factor):
        problem = f"per is {per!r}, of type {type(per).__name__}"
        yield Finding.error("warm_up", problem, f"Give the name of a factor, {COMBINATION!r}, or leave it out.")
    if not isinstance(each_session, bool):
        problem = f"each_session is {each_session!r}, of type {type(each_session).__name__}"
        yield Finding.error("warm_up", problem, "Give True or False.")
