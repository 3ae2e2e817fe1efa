"""A search for the best treatments, by Bayesian optimisation."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from random import Random
from types import MappingProxyType
from typing import Any

from robot_runner.adaptive.explored import (
    Direction,
    Explored,
    Places,
    SearchedSpace,
    baseline_findings,
    baseline_of,
    best_of,
    confirmation,
    confirmed,
    count_findings,
    decided,
    direction_findings,
    explored,
    in_direction,
    shown,
    without_values,
)
from robot_runner.core.design.asking import Decision, Told
from robot_runner.core.design.design import ChosenCombinations, IsAllowed
from robot_runner.core.design.factor import Combination, Factor, texts_of
from robot_runner.core.design.planned_runs import PlannedRun
from robot_runner.core.errors import DesignError, Finding
from robot_runner.core.execution.processes import no_process
from robot_runner.core.words import counted, enumerated, listed

#: The fewest combinations before there is a model; by default two more than twice the number of factors.
_LEAST_START = 5
#: More steps of a range take seconds to list, each time that it is decided.
_MOST_STEPS = 100_000
#: How long Optuna may take to answer, in s: it takes one or two.
_PATIENCE = 300.0
_PROGRAM = "robot_runner.adaptive.optuna_program"


@dataclass(frozen=True, slots=True, init=False)
class Optimise:
    """Search for the treatments with which a measure is least or most, by Bayesian optimisation (Optuna's TPE).

    The first combinations are spread over all treatments; each further one is where Optuna expects the best. None is
    tried twice. Treatments that are numbers are searched in their order, others as categories.

    Attributes:
        directions: which values of which measure are better. For several measures, the best combinations are the Pareto
            front.
        runs: how many runs the search has, failed ones included; each combination has `repetitions` of them.
        start: how many combinations come before there is a model; None for twice the number of factors and two, at
            least five.
        at_a_time: how many combinations are decided on at a time: as many as there are runs side by side.
        confirm: how many further runs each of the best combinations has after the search. Only these are analysed as a
            planned experiment; 0 for none.
        baseline: the treatments of a combination that is executed beside the best when it is confirmed.
        seed: of all random choices.

    Raises:
        DesignError: an attribute is invalid; `findings` lists all problems.

    Example:
        >>> search = Optimise("Energy", "minimise", runs=40, confirm=10)
        >>> search.as_mapping()["directions"]
        {'Energy': 'minimise'}
    """

    directions: Mapping[str, Direction]
    runs: int
    start: int | None
    at_a_time: int
    confirm: int
    baseline: Mapping[str, Any]
    seed: int

    def __init__(
        self,
        measure: str | Mapping[str, str],
        direction: str | Direction = Direction.MINIMISE,
        *,
        runs: int,
        start: int | None = None,
        at_a_time: int = 1,
        confirm: int = 0,
        baseline: Mapping[str, Any] | None = None,
        seed: int = 0,
    ) -> None:
        """Take one measure and its direction, or several with theirs: `{"Energy": "minimise", "Way": "maximise"}`."""
        asked = {measure: direction} if isinstance(measure, str) else measure
        where = f"Optimise({measure!r})"
        findings = [
            *direction_findings(where, asked),
            *count_findings(where, 1, runs=runs, at_a_time=at_a_time),
            *count_findings(where, 2, **({} if start is None else {"start": start})),
            *count_findings(where, confirm=confirm, seed=seed),
        ]
        if baseline and not confirm:
            problem = "a baseline is executed beside the best when that is confirmed, and confirm is 0"
            findings.append(Finding.error(where, problem, "Give confirm=10, say, or leave the baseline out."))
        DesignError.refuse(findings)
        directions = MappingProxyType({name: Direction(each) for name, each in asked.items()})
        given = (directions, runs, start, at_a_time, confirm, MappingProxyType(dict(baseline or {})), seed)
        for name, value in zip(self.__slots__, given, strict=True):
            object.__setattr__(self, name, value)

    @property
    def measures(self) -> Sequence[str]:
        """The measures by which it decides."""
        return tuple(self.directions)

    @property
    def _where(self) -> str:
        return f"Optimise({', '.join(self.measures)})"

    def findings(self, factors: Sequence[Factor]) -> Iterator[Finding]:
        """Yield errors: nothing to vary, too many steps, no Optuna, a baseline that does not fit."""
        where = self._where
        if find_spec("optuna") is None:
            problem = "Optuna, the library that decides where to search, is not installed"
            yield Finding.error(where, problem, "Install the extra: pip install 'robot-runner[adaptive]'")
        if all(len(factor.treatments) == 1 for factor in factors):
            problem = "no factor has two treatments, so that there is nothing to search among"
            yield Finding.error(where, problem, "Give a factor the treatments to search among: its range, in steps.")
        steps = {factor.name: factor.range.step_count for factor in factors if factor.range is not None}
        fine = {name: count for name, count in steps.items() if count > _MOST_STEPS}
        for name, count in fine.items():
            problem = f"{name} has {count:,} steps, and a search takes {_MOST_STEPS:,} at most"
            yield Finding.error(where, problem, "Give its range a wider step: Range(lower, upper, step=...).")
        if self.baseline and not fine:
            yield from baseline_findings(where, factors, self.baseline)

    def repetition_findings(self, factors: Sequence[Factor], repetitions: int) -> Iterator[Finding]:
        """Yield an error if there are too few runs to search with."""
        start = self._start(factors)
        if self.runs // repetitions <= start:
            problem = (
                f"{counted(self.runs, 'run')} are {counted(self.runs // repetitions, 'combination')} of "
                f"{counted(repetitions, 'repetition')}, and the first {start} are spread: none is left to search with"
            )
            yield Finding.error(self._where, problem, f"Plan runs={2 * start * repetitions} or more.")

    def as_mapping(self) -> Mapping[str, Any]:
        """Return the search as plain data."""
        return {
            "kind": "optimise",
            **{name: getattr(self, name) for name in self.__slots__},
            "directions": {name: each.value for name, each in self.directions.items()},
            "baseline": texts_of(self.baseline),
        }

    def choose(self, factors: Sequence[Factor], is_allowed: IsAllowed) -> ChosenCombinations:
        """Return the first combinations of the search.

        Raises:
            DesignError: all are excluded, or the baseline is, or it lacks a treatment of a conditional factor.
        """
        space = SearchedSpace(factors, is_allowed)
        first = space.spread(self._start(factors), f"{self.seed} start")
        if not first:
            fix = "Exclude fewer."
            raise DesignError("the exclusions leave no combination that could be found", where="design", fix=fix)
        if self.baseline and not is_allowed(baseline_of(factors, self.baseline)):
            problem = "the baseline is a combination that is excluded"
            raise DesignError(problem, where="design", fix="Choose another baseline, or exclude fewer.")
        combinations = [space.combination(places) for places in first]
        return ChosenCombinations(combinations, self._facts(), [each.with_chosen(combinations) for each in factors])

    def asking(self, factors: Sequence[Factor], is_allowed: IsAllowed, repetitions: int) -> _Search:
        """Return the object that decides where to search next."""
        return _Search(self, factors, is_allowed, repetitions)

    def _start(self, factors: Sequence[Factor]) -> int:
        if self.start is not None:
            return self.start
        return max(_LEAST_START, 2 * sum(len(factor.treatments) > 1 for factor in factors) + 2)

    def _facts(self) -> dict[str, Any]:
        what = " and ".join(in_direction(name, each) for name, each in self.directions.items())
        at_a_time = "the next one is" if self.at_a_time == 1 else f"the next {self.at_a_time} are"
        up_to = f"up to {counted(self.runs, 'run')}"
        decides = f"once these are done, {at_a_time} where {what} is expected by then, {up_to}"
        if self.confirm:
            beside = " and of the baseline" if self.baseline else ""
            decides += f"; then {counted(self.confirm, 'run')} of the best{beside}, which confirm it"
        confirming = self.confirm * ((1 if len(self.directions) == 1 else self.runs) + bool(self.baseline))
        most = self.runs + confirming
        return {"kind": "optimise", "decides": decides, "most_runs": most, "at_a_time": self.at_a_time}


class _Search:
    """Decides where to search next; see `Asking`."""

    def __init__(self, design: Optimise, factors: Sequence[Factor], is_allowed: IsAllowed, repetitions: int) -> None:
        self._design = design
        self._factors = factors
        self._space = SearchedSpace(factors, is_allowed)
        self._repetitions = repetitions
        self.measures = design.measures

    def may_add(self, runs: Sequence[PlannedRun]) -> bool:
        """Return whether there may be further runs, of the search or to confirm it."""
        searched = sum(run.batch == 1 for run in runs)
        return searched + self._repetitions <= self._design.runs or (self._design.confirm > 0 and searched == len(runs))

    def ask(self, told: Sequence[Told]) -> Decision:
        """Return the combinations to try next, then the runs that confirm the best, then nothing."""
        design = self._design
        points, odd = explored(told, self.measures)
        best = best_of(points, design.directions)
        facts = {"known": self._known(points, best)}
        words = self._in_words(points, best)
        if any(each.run.batch > 1 for each in told):
            return decided("end", confirmed(told, best, words), facts, findings=odd)
        # Where nothing has a value, the treatments are not the cause: the remaining runs are not wasted.
        left = design.runs // self._repetitions - len(points) if best else 0
        wanted = self._next(points, min(design.at_a_time, left)) if left > 0 else []
        if wanted:
            words = f"{words}. Next: {listed(shown(each) for each in wanted)}"
            runs = [(each, number) for number in range(1, self._repetitions + 1) for each in wanted]
            return decided(f"combination {len(points) + 1}", words, facts, runs=runs)
        if not best:
            odd = [*odd, without_values(self.measures)]
        ended = "the search has had its runs" if left <= 0 else "no further combination is allowed"
        words = f"{words}: {ended if best else 'nothing tells where to search'}"
        if design.confirm and best:
            return confirmation(self._to_confirm(points, best), design.confirm, words, facts)
        return decided("end", words, facts, findings=odd)

    def _next(self, points: Sequence[Explored], count: int) -> list[Combination]:
        space = self._space
        tried = {places: each for each in points if (places := space.places(each.combination)) is not None}
        found: dict[Places, None] = {}
        for offered in self._offered(list(tried.items()), count):
            fit = (each for each in map(tuple, offered) if each not in found and space.is_allowed(each))
            places = next(fit, None) or space.another({*tried, *found}, f"{self._design.seed} {len(tried)}")
            if places is not None:
                found[places] = None
        return [space.combination(places) for places in found]

    def _offered(self, tried: Sequence[tuple[Places, Explored]], count: int) -> list[list[Places]]:
        """Return Optuna's candidates for each of `count` combinations.

        Raises:
            DesignError: it does not answer.
            ExecutionError: the system has no process left for it.
        """
        design, space = self._design, self._space
        seed = Random(f"{design.seed} {len(tried)}").getrandbits(32)  # noqa: S311 - reproducible, not secret
        question = {
            "levels": space.active,
            "are_numbers": space.are_numbers,
            "conditions": space.conditions,
            "directions": [each.value.replace("se", "ze") for each in design.directions.values()],
            "points": [
                (places, means) for places, each in tried if (means := each.means(self.measures)) or each.has_failed
            ],
            "tried": [places for places, _ in tried],
            "start": design._start(self._factors),  # noqa: SLF001 - its own other half
            "count": count,
            "seed": seed,
        }
        try:
            # A group of its own: Ctrl-C is for the experiment, which ends once this is answered.
            asked = subprocess.run(  # noqa: S603 - a program of ours, and what it is told is not a command
                [sys.executable, "-P", "-m", _PROGRAM],
                input=json.dumps(question),
                capture_output=True,
                text=True,
                timeout=_PATIENCE,
                check=False,
                start_new_session=True,
            )
        except subprocess.TimeoutExpired as error:
            raise _unanswered(f"no answer came within {_PATIENCE:g} s") from error
        except OSError as error:
            raise no_process(error, "the search") from error
        if asked.returncode:
            told = asked.stderr.strip().splitlines() or [f"it ended with {asked.returncode}"]
            raise _unanswered(told[-1])
        answer: list[list[Places]] = json.loads(asked.stdout)
        return answer

    def _to_confirm(self, points: Sequence[Explored], best: Sequence[Explored]) -> list[Explored]:
        if not self._design.baseline:
            return list(best)
        beside = baseline_of(self._factors, self._design.baseline)
        known = {each.combination.texts: each for each in (Explored(beside), *points)}
        chosen = {each.combination.texts: each for each in (*best, known[beside.texts])}
        return list(chosen.values())

    def _known(self, points: Sequence[Explored], best: Sequence[Explored]) -> dict[str, Any]:
        """Return the state of the search as plain data."""
        return {
            "combinations": len(points),
            "without_value": sum(each.means(self.measures) is None for each in points),
            "best": [
                {"combination": texts_of(each.combination), "means": dict(zip(self.measures, means, strict=True))}
                for each in best
                if (means := each.means(self.measures))
            ],
        }

    def _in_words(self, points: Sequence[Explored], best: Sequence[Explored]) -> str:
        of = self._design.runs // self._repetitions
        after = f"after {len(points)} of {counted(of, 'combination')}"
        if not best:
            return f"{after}, none has a value of {enumerated(self.measures)}"
        found = listed(
            f"{shown(each.combination)} ({', '.join(f'{mean:.4g}' for mean in each.means(self.measures) or ())})"
            for each in best
        )
        what = " and ".join(in_direction(name, each) for name, each in self._design.directions.items())
        return f"{after}, {what}: {found}"


def _unanswered(reason: str) -> DesignError:
    problem = f"Optuna could not be asked where to search next: {reason}"
    return DesignError(problem, where="design", fix="See whether the extra is whole: robot-runner[adaptive].")
