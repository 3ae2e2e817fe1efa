"""Choosing runs by their ids or treatments: `r_1,r_2`, `Task=Video`, `Task=Video,Speed=0.2`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from robot_runner.core.design.columns import REPETITION
from robot_runner.core.design.planned_runs import PlannedRun
from robot_runner.core.errors import ExecutionError, Finding, did_you_mean

_MOST_KNOWN = 1000  # ids that are compared with a misspelt one


@dataclass(frozen=True, slots=True)
class Chosen:
    """The chosen runs.

    Attributes:
        places: their indices in the run table, in the order of the expressions; for treatments in the table's order.
        named: the indices of those that were named by their ids.
    """

    places: tuple[int, ...]
    named: frozenset[int]


class RunChooser:
    """Chooses runs of one run table.

    An expression has ids and treatments, separated by commas. Treatments of one factor are alternatives, those of
    several factors must all match; a run that is named by its id is chosen, too. Several expressions are united. With
    `has_repetition`, `Repetition=2` chooses by the repetition.

    Example:
        >>> from robot_runner.core.design.factor import Factor
        >>> from robot_runner.core.design.run_table_model import RunTableModel
        >>> model = RunTableModel([Factor("Task", ["Video", "Network"]), Factor("Speed", [0.1, 0.2])])
        >>> RunChooser(model.plan()).choose("--only", ["Task=Network,Speed=0.1,Speed=0.2", "r_1"]).places
        (2, 3, 0)
    """

    def __init__(self, runs: Iterable[PlannedRun], *, has_repetition: bool = False) -> None:
        self._runs = tuple(runs)
        self._places = {run.run_id: place for place, run in enumerate(self._runs)}
        self._has_repetition = has_repetition
        self._factors: dict[str, dict[str, set[int]]] | None = None
        self.findings: list[Finding] = []

    def choose(self, option: str, expressions: Sequence[str]) -> Chosen:
        """Return the runs that these expressions choose; errors are kept until `refuse` is called."""
        places: dict[int, None] = {}
        named: set[int] = set()
        for expression in expressions:
            ids, treatments = self._read(option, expression)
            named |= set(ids)
            places |= dict.fromkeys(ids)
            if treatments:
                having = sorted(set.intersection(*treatments.values()))
                places |= dict.fromkeys(having)
                if not having and all(treatments.values()):
                    self._note(f"{option} {expression}", "no run has these treatments", "Name others, or fewer.")
        return Chosen(tuple(places), frozenset(named))

    def refuse(self) -> None:
        """Raise an error with all errors of the expressions so far, if there are any.

        Raises:
            ExecutionError: there are some.
        """
        ExecutionError.refuse(self.findings)

    def _read(self, option: str, expression: str) -> tuple[list[int], dict[str, set[int]]]:
        """Return the indices of runs named by ids, and for each factor those with one of its treatments."""
        ids: list[int] = []
        treatments: dict[str, set[int]] = {}
        parts = [part for part in expression.split(",") if part.strip()]
        if not parts:
            self._note(option, "no run is named", "Name ids or treatments, such as r_1,r_2 or Task=Video.")
        while parts:
            word = parts[0].strip()
            if word in self._places:
                ids.append(self._places[parts.pop(0).strip()])
                continue
            name, equals, _ = word.partition("=")
            if not equals:
                self._note(f"{option} {parts.pop(0).strip()}", "the run table has no such run", self._fix_of_id(word))
                continue
            count, places = self._with_treatment(f"{option} {word}", name.strip(), parts)
            treatments.setdefault(name.strip(), set()).update(places)
            del parts[:count]
        return ids, treatments

    def _with_treatment(self, where: str, name: str, parts: Sequence[str]) -> tuple[int, set[int]]:
        """Return how many parts one treatment takes (its text may contain commas), and the indices of its runs."""
        factors = self._by_factor()
        if name not in factors:
            self._note(where, f"there is no factor {name!r}", did_you_mean(name, factors))
            return 1, set()
        known = factors[name]
        for count in range(len(parts), 0, -1):
            text = ",".join(parts[:count]).partition("=")[2].strip()
            if (found := _meant(text, known)) is not None:
                return count, known[found]
        text = parts[0].partition("=")[2].strip()
        self._note(where, f"{text!r} is not a treatment of {name!r} in the run table", did_you_mean(text, known))
        return 1, set()

    def _by_factor(self) -> Mapping[str, Mapping[str, set[int]]]:
        if self._factors is None:
            self._factors = {}
            for place, run in enumerate(self._runs):
                for name, text in self._texts(run):
                    self._factors.setdefault(name, {}).setdefault(text, set()).add(place)
        return self._factors

    def _texts(self, run: PlannedRun) -> Iterator[tuple[str, str]]:
        for name, treatment in run.combination.items():
            yield name, str(treatment)
        if self._has_repetition:
            yield REPETITION, str(run.repetition)

    def _fix_of_id(self, word: str) -> str:
        some = next(iter(self._runs), None)
        example = f"{some.run_id} or {next(iter(some.combination), 'Factor')}=..." if some else "r_1"
        otherwise = f"Name runs by ids or treatments, such as {example}"
        return did_you_mean(word, list(self._places)[:_MOST_KNOWN], otherwise)

    def _note(self, where: str, problem: str, fix: str) -> None:
        self.findings.append(Finding.error(where, problem, fix))


def _meant(text: str, known: Iterable[str]) -> str | None:
    """Return the known text that is meant: the same, or the only one that differs only in case."""
    if text in known:
        return text
    alike = [each for each in known if each.casefold() == text.casefold()]
    return alike[0] if len(alike) == 1 else None
