"""Extending an experiment that has begun: by repetitions, treatments and factors."""

from __future__ import annotations

import math
import shlex
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from decimal import Decimal
from enum import Enum
from numbers import Real
from types import MappingProxyType
from typing import Any

from robot_runner.core.design.asking import decides_order
from robot_runner.core.design.columns import REPETITION
from robot_runner.core.design.design_findings import MAX_RUNS
from robot_runner.core.design.factor import Combination, Factor, texts_of
from robot_runner.core.design.listed_runs import ListedRunTableModel
from robot_runner.core.design.planned_runs import PlannedRun
from robot_runner.core.design.run_table_model import RunTableModel
from robot_runner.core.errors import DesignError, Finding, did_you_mean
from robot_runner.core.words import INACTIVE

_WRITTEN_ONE_BY_ONE = "the runs were listed one by one, and no factorial says which are to be added"


@dataclass(frozen=True, slots=True)
class NewFactor:
    """A factor that an experiment gets after it has begun.

    Attributes:
        default: the treatment that is assumed for earlier runs, as text.
        treatments: its other treatments, as text; those of the config need not be listed.
    """

    default: str
    treatments: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Additions:
    """The additions by the command line; those of the config to the run table are made in any case.

    Attributes:
        repetitions: how often each combination is to be executed, all batches together; None for as often as now.
        treatments: further treatments of existing factors, as text, by factor.
        factors: new factors, by name.
    """

    repetitions: int | None = None
    treatments: Mapping[str, Sequence[str]] = field(default_factory=lambda: MappingProxyType({}))
    factors: Mapping[str, NewFactor] = field(default_factory=lambda: MappingProxyType({}))


@dataclass(frozen=True, slots=True, kw_only=True)
class Begun:
    """The present design of an experiment, by its run table.

    Attributes:
        factors: with the treatments so far.
        runs: all that are planned so far, in the order of the table.
        chosen: the treatments that were added on the command line, as text, by factor.
        has_repetition: whether the table counts repetitions; if not, runs of one combination are counted here.
        is_by_hand: whether the runs were written into the table by hand, so that the config does not plan them.
        copies: how often each repetition has a combination, as `copies_in`; once where it is not named.
    """

    factors: tuple[Factor, ...]
    runs: Sequence[PlannedRun]
    chosen: Mapping[str, Sequence[str]]
    has_repetition: bool
    is_by_hand: bool
    copies: Counter[frozenset[tuple[str, str]]] = field(default_factory=Counter)

    @property
    def counted_runs(self) -> list[PlannedRun]:
        """The runs with the number of each repetition, also where the table has no such column."""
        if self.has_repetition:
            return list(self.runs)
        seen: Counter[frozenset[tuple[str, str]]] = Counter()
        counted = []
        for run in self.runs:
            key, which = treatments_of(run.combination), 0
            if not run.is_warm_up:
                which = 1 + seen[key] // max(1, self.copies[key])
                seen[key] += 1
            counted.append(run._replace(repetition=which))
        return counted

    @property
    def repetitions(self) -> int:
        """How often the combination that has most is repeated."""
        return max((run.repetition for run in self.counted_runs), default=1)


def treatments_of(combination: Combination) -> frozenset[tuple[str, str]]:
    """Return the treatments of a combination as text, in no order."""
    return frozenset(texts_of(combination).items())


def copies_in(runs: Iterable[PlannedRun]) -> Counter[frozenset[tuple[str, str]]]:
    """Return how often each repetition of a plan has a combination: the centre of a response surface several times."""
    return Counter(treatments_of(run.combination) for run in runs if run.repetition == 1)


@dataclass(frozen=True, slots=True)
class ExtendedDesign:
    """The design that an extended experiment is to reach.

    Attributes:
        factors: all of them with all treatments, new ones last.
        combinations: those that get further runs.
        repetitions: how often each of these is executed, all batches together.
        defaults: for each new factor, the treatment that is assumed for earlier runs.
        chosen: the treatments that were added on the command line, as text, by factor.
        copies: as `Begun.copies`.
    """

    factors: tuple[Factor, ...]
    combinations: Sequence[Combination]
    repetitions: int
    defaults: Mapping[str, Any]
    chosen: Mapping[str, Sequence[str]]
    copies: Counter[frozenset[tuple[str, str]]] = field(default_factory=Counter)

    def texts_of(self, combination: Mapping[str, Any]) -> tuple[str, ...]:
        """Return the treatments of a combination as text, in the order of the factors, defaults where it lacks some."""
        treatments = {**self.defaults, **combination}
        return tuple(str(treatments[factor.name]) for factor in self.factors)

    def repetitions_of(self, runs: Iterable[PlannedRun]) -> defaultdict[tuple[str, ...], set[int]]:
        """Return the repetitions of each combination among these runs, by its `texts_of`, without warm-up runs."""
        found: defaultdict[tuple[str, ...], set[int]] = defaultdict(set)
        for run in runs:
            if not run.is_warm_up:
                found[self.texts_of(run.combination)].add(run.repetition)
        return found


def extended_design(begun: Begun, config: RunTableModel, added: Additions) -> ExtendedDesign:
    """Return the extended design: the present one, with the additions of the config and the command line.

    Treatments that the config does not have any more get no further runs; those of the command line do.

    Raises:
        DesignError: something cannot be added; `findings` lists all problems.
    """
    extending = _Extending(begun, config, added)
    DesignError.refuse(extending.findings())
    return extending.extended()


class _Extending:
    def __init__(self, begun: Begun, config: RunTableModel, added: Additions) -> None:
        self._begun = begun
        self._added = added
        self._config = config
        self._there = {factor.name: factor for factor in begun.factors}
        self._own = {} if begun.is_by_hand else {factor.name: factor for factor in config.factors}
        self._is_listed = begun.is_by_hand or isinstance(config, ListedRunTableModel)

    def findings(self) -> Iterator[Finding]:
        yield from self._repetition_findings()
        for name, texts in self._added.treatments.items():
            yield from self._treatment_findings(name, texts)
        for name in self._new:
            yield from self._factor_findings(name, self._added.factors.get(name))
        for name in () if self._begun.is_by_hand else self._there:
            if name not in self._own and name not in self._begun.chosen:
                problem = "the config does not have this factor any more, and the runs that were planned do"
                yield Finding.error(f"factor {name!r}", problem, "Put it back into the config.")

    def extended(self) -> ExtendedDesign:
        """Return the extended design; call it only if there are no findings."""
        chosen = {name: self._written(name, texts) for name, texts in self._added.treatments.items()}
        for name, new in self._added.factors.items():
            if name not in self._own:
                chosen[name] = (new.default, *new.treatments)
            elif new.treatments:
                chosen[name] = self._written(name, new.treatments)
        all_chosen = {name: (*self._begun.chosen.get(name, ()), *chosen.get(name, ())) for name in self._names}
        factors = tuple(self._factor(name, chosen.get(name, ())) for name in self._names)
        defaults = {name: _own_treatment(factors, name, self._added.factors[name].default) for name in self._new}
        repetitions = self._added.repetitions or max(self._begun.repetitions, self._repetitions_of_config)
        combinations = self._combinations(factors, all_chosen)
        return ExtendedDesign(factors, combinations, repetitions, defaults, chosen, self._begun.copies)

    @property
    def _new(self) -> list[str]:
        return list(dict.fromkeys([*(name for name in self._own if name not in self._there), *self._added.factors]))

    @property
    def _names(self) -> list[str]:
        return [*self._there, *self._new]

    @property
    def _repetitions_of_config(self) -> int:
        if self._begun.is_by_hand:
            return 1
        if isinstance(self._config, ListedRunTableModel):
            return max(Counter(run.combination.texts for run in self._config.plan()).values())
        return self._config.repetitions

    def _written(self, name: str, texts: Sequence[str]) -> tuple[str, ...]:
        """Return the texts of treatments of the command line as in the run table: `1` as 1.0 among floats."""
        like = self._own.get(name) or self._there[name]
        return tuple(dict.fromkeys(str(typed(like, text)) for text in texts))

    def _factor(self, name: str, chosen: Sequence[str]) -> Factor:
        """Return a factor with its treatments so far, those that the config adds, and those that were chosen."""
        there, own = self._there.get(name), self._own.get(name)
        like = own or there
        if like is None:
            return Factor(name, _by_looks(chosen))
        listed = dict(zip(there.texts, there.treatments, strict=True)) if there else {}
        for text in (*(own.texts if own else ()), *chosen):
            if text not in listed:
                listed[text] = typed(like, text)
        return like.with_treatments(listed.values())

    def _combinations(self, factors: tuple[Factor, ...], chosen: Mapping[str, Sequence[str]]) -> Sequence[Combination]:
        if self._begun.is_by_hand:
            return _distinct(run.combination for run in self._begun.runs)
        if self._is_listed or decides_order(self._config.design):  # such a design plans its runs itself
            return _distinct(run.combination for run in self._config.plan())
        planned = [_only(factor, self._own.get(factor.name), chosen.get(factor.name, ())) for factor in factors]
        return self._config.combinations_of(planned)

    def _repetition_findings(self) -> Iterator[Finding]:
        asked, there = self._added.repetitions, self._begun.repetitions
        if asked is None:
            return
        where = "--repetitions"
        if asked < there:
            problem = f"{asked} is fewer than the {there} repetitions that there are"
            yield Finding.error(where, problem, f"Give the new total, such as {there + 1}; no run is ever taken away.")
        counting = [name for name in (*self._there, *self._own) if name.casefold() == REPETITION.casefold()]
        sizes = [len(factor.treatments) for factor in (*self._there.values(), *self._own.values())]
        if max(sizes, default=1) * asked > MAX_RUNS:
            yield Finding.error(where, f"{asked:,} repetitions are more than {MAX_RUNS:,} runs", "Give fewer.")
        if counting and asked > there:
            problem = f"the factor {counting[0]!r} counts the repetitions of this experiment"
            yield Finding.error(where, problem, _adding_treatments(counting[0]))

    def _treatment_findings(self, name: str, texts: Sequence[str]) -> Iterator[Finding]:
        where = f"--treatments {name}"
        factor = self._there.get(name)
        if factor is None:
            fix = did_you_mean(name, self._there)
            if name in self._own:
                fix = f"The config has it and the run table not yet: --factor {shlex.quote(f'{name}=DEFAULT')}."
            yield Finding.error(where, f"the run table has no factor {name!r}", fix)
        elif self._is_listed:
            fix = "Write their rows into the run table." if self._begun.is_by_hand else "Add them to the config."
            yield Finding.error(where, _WRITTEN_ONE_BY_ONE, fix)
        else:
            for text in texts:
                yield from _text_findings(where, text, factor, self._own.get(name, factor))

    def _factor_findings(self, name: str, new: NewFactor | None) -> Iterator[Finding]:
        where, own = f"--factor {name}", self._own.get(name)
        if name in self._there:
            problem = "the run table has this factor already"
            yield Finding.error(where, problem, _adding_treatments(name))
        elif self._is_listed and own is None:
            yield Finding.error(where, _WRITTEN_ONE_BY_ONE, "Add it to the config, or begin another experiment.")
        elif new is None:
            problem = f"the config has the factor {name!r}, and nothing says which treatment the runs so far had"
            known = ", ".join(own.texts if own else ())
            fix = f"Say it: --factor {shlex.quote(f'{name}=DEFAULT')} (one of {known})."
            yield Finding.error(f"factor {name!r}", problem, fix)
        elif own is not None:
            if own.position_of_text(new.default) is None:
                problem = f"{new.default!r} is not a treatment of the factor in the config"
                yield Finding.error(where, problem, own.suggestion(new.default))
            for text in new.treatments:
                yield from _text_findings(where, text, own, own)
        elif not new.treatments:
            problem = f"the factor would have the treatment {new.default!r} alone"
            option = shlex.quote(f"{name}={new.default}:OTHER,...")
            yield Finding.error(where, problem, f"Give others: --factor {option} .")
        else:
            yield from DesignError.raised_by(Factor, name, _by_looks((new.default, *new.treatments)))


def _adding_treatments(name: str) -> str:
    return f"Add treatments to it: --treatments {shlex.quote(f'{name}=...')} ."


def _text_findings(where: str, text: str, there: Factor, like: Factor) -> Iterator[Finding]:
    written = text
    if there.position_of_text(text) is None:
        try:
            written = str(typed(like, text))
        except DesignError as error:
            yield Finding.error(where, error.problem, error.fix)
            return
    if there.position_of_text(written) is not None:
        shown = "" if written == text else f", as {written}"
        yield Finding.error(where, f"the factor has the treatment {text!r} already{shown}", "Leave it out.")


_WORDS = MappingProxyType({"True": True, "False": False})


def typed(factor: Factor, text: str) -> Any:
    """Return the treatment that a text means, of the type of the factor's treatments.

    Raises:
        DesignError: it cannot be converted to that type, or they are objects, which cannot be made from a text.

    Example:
        >>> typed(Factor("Speed", [0.1, 0.2]), "0.3")
        0.3
    """
    place = factor.position_of_text(text)
    if place is not None:
        return factor.treatments[place]
    kinds = {type(treatment) for treatment in factor.treatments if treatment is not INACTIVE}
    kind: Any = kinds.pop() if len(kinds) == 1 else float if kinds == {int, float} else object
    if kind is str or (issubclass(kind, Real | Decimal) and not issubclass(kind, Enum)):  # Real: NumPy's numbers, too
        what = f"of type {kind.__name__}"
        with suppress(KeyError, TypeError, ValueError, ArithmeticError):
            # Python reads 0_3, a slip for 0.3, as 3.
            made: Any = _WORDS[text] if kind is bool else kind(text if kind is str else text.replace("_", "?"))
            if kind is str or abs(made) < math.inf:
                return made
            what = "a finite number"  # a config may have others, but on the command line they would be a mistake
        problem = f"{text!r} is not {what}, as the treatments of the factor are"
        raise DesignError(problem, where=f"factor {factor.name!r}", fix="Give one of that type.")
    problem = f"{text!r} is a text, and the treatments of the factor are objects of several types or of the config's"
    fix = "Add it to the factor in the config, and call `extend` without it."
    raise DesignError(problem, where=f"factor {factor.name!r}", fix=fix)


def _by_looks(texts: Sequence[str]) -> list[Any]:
    """Return treatments of the first type that fits all texts: integers, numbers, booleans, else texts."""
    for like in (Factor("_", [0]), Factor("_", [0.5]), Factor("_", [True])):
        try:
            found = [typed(like, text) for text in texts]
        except DesignError:
            continue
        if [str(each) for each in found] == list(texts):
            return found
    return list(texts)


def _own_treatment(factors: Sequence[Factor], name: str, text: str) -> Any:
    factor = next(factor for factor in factors if factor.name == name)
    return factor.treatments[factor.texts.index(text)]


def _only(factor: Factor, own: Factor | None, chosen: Sequence[str]) -> Factor:
    """Return a factor with the treatments that get further runs: the config's, and those of the command line."""
    wanted = {*(own.texts if own else ()), *chosen}
    kept = [each for each, text in zip(factor.treatments, factor.texts, strict=True) if text in wanted]
    return factor.with_treatments(kept)


def _distinct(combinations: Iterable[Combination]) -> list[Combination]:
    return list({each.texts: each for each in combinations}.values())
