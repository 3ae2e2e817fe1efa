"""Factors with their treatments, and combinations with one treatment for each factor."""

from __future__ import annotations

import math
import re
from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass, field
from functools import partial
from itertools import islice
from types import FunctionType, MethodType
from typing import Any

from robot_runner.core.design.columns import name_findings
from robot_runner.core.design.numeric_range import Range
from robot_runner.core.design.revision import Revision, is_revision_name
from robot_runner.core.errors import DesignError, Finding, nearest
from robot_runner.core.words import INACTIVE

# Checks of treatments. In the run table each is written as its `str()`, which is exact for a float: Python writes the
# shortest text that is read back as the same number.

_ADDRESS = re.compile(r" at 0x[0-9A-Fa-f]+")
_PLUGIN = re.compile(r"\w\(\.\.\.\)")  # as a plugin shows itself, also in a list


def treatments_are_equal(one: Any, other: Any) -> bool:
    """Return whether two values are equal; unlike in Python, a bool equals no number: True is not the treatment 1."""
    if isinstance(one, bool) is not isinstance(other, bool):
        return False
    try:
        return bool(one == other)
    except (TypeError, ValueError):  # the comparison of arrays has no truth value
        return False


def treatment_findings(where: str, treatments: Sequence[Any]) -> Iterator[Finding]:
    """Yield an error for each value that could not be recognised in the run table, alone or beside the others."""
    by_text: dict[str, Any] = {}
    by_value: dict[tuple[type, Hashable], Any] = {}
    for treatment in treatments:
        text = _text_or_finding(where, treatment)
        if isinstance(text, Finding):
            yield text
        elif text in by_text:
            yield _same_text(where, by_text[text], treatment, text)
        else:
            by_text[text] = treatment
            yield from _same_value(where, by_value, treatment)


def _text_or_finding(where: str, treatment: Any) -> str | Finding:
    kind = type(treatment).__name__
    try:
        text = str(treatment)
    except Exception as error:  # noqa: BLE001 - a user's __str__ may raise anything
        problem = f"a treatment of type {kind} has no text: its str() raised {type(error).__name__}: {error}"
        return Finding.error(where, problem, "Correct the __str__ of its class.")
    try:
        text.encode()
    except UnicodeEncodeError as error:
        problem = f"treatment {text!r} holds {text[error.start : error.end]!r}, which UTF-8 cannot hold"
        return Finding.error(where, problem, "Leave it out.")
    if not isinstance(treatment, str) and _ADDRESS.search(text):
        problem = f"treatment {text} shows a memory address, so it could not be recognised when resuming"
        is_function = isinstance(treatment, FunctionType | MethodType | partial)
        fix = "Give a text in its place, by which a callback finds the function." if is_function else ""
        return Finding.error(where, problem, fix or f"Give its class a __str__ ({kind}).")
    if not isinstance(treatment, str) and _PLUGIN.search(text):
        problem = f"treatment {text} does not show its parameters, so it could not be recognised when resuming"
        fix = f"Bind a parameter of the plugin by treatment({where.partition(' ')[2]}), or give its class a __str__."
        return Finding.error(where, problem, fix)
    if isinstance(treatment, set | frozenset) and len(treatment) > 1:
        problem = f"treatment {text} is a set: its elements are written in another order by each process"
        return Finding.error(where, problem, "Give a tuple or a sorted list.")
    return text


def _same_text(where: str, earlier: Any, later: Any, text: str) -> Finding:
    if type(earlier) is type(later):
        return _given_twice(where, later)
    problem = f"treatments {earlier!r} and {later!r} would both be written {text!r} in the run table"
    return Finding.error(where, problem, "Change one of them so that they look different.")


def _same_value(where: str, by_value: dict[tuple[type, Hashable], Any], treatment: Any) -> Iterator[Finding]:
    try:
        earlier = by_value.setdefault((type(treatment), treatment), treatment)
    except TypeError:  # not hashable: it differs from the others by its text
        return
    if earlier is not treatment:
        yield _given_twice(where, treatment)


def _given_twice(where: str, treatment: Any) -> Finding:
    fix = "Remove one; repetitions=2 executes each combination twice."
    return Finding.error(where, f"treatment {treatment!r} is given twice", fix)


# Factors.

#: More treatments are taken for an endless iterable.
MAX_TREATMENTS = 1_000_000

_SHOWN = 10
_COMPARED = 1000  # comparing takes some 0.1 ms a treatment


@dataclass(frozen=True, slots=True, init=False)
class Factor:
    """A variable that an experiment manipulates, with its treatments in the order in which they are to be executed.

    Attributes:
        name: the column of the run table.
        treatments: the values, of any type; an object is written as its `str()` and read back as the object. For a
            range the two ends, until a design chooses others. With `when`, the last one is `INACTIVE`.
        texts: how each treatment is written in the run table.
        range: the range of a numeric factor; None where the treatments are listed.
        unit: of the treatments; empty where they have none.
        when: under which treatments of other factors this one applies, by factor.

    Raises:
        DesignError: the name or a treatment is invalid; `findings` lists all problems.

    Example:
        >>> from robot_runner import Range
        >>> Factor("Repetition", range(1, 4)).treatments
        (1, 2, 3)
        >>> Factor("Speed", Range(0.05, 0.22, unit="m/s")).treatments
        (0.05, 0.22)
        >>> Factor("Resolution", ["720p", "1080p"], when={"Sensor": "camera"}).treatments
        ('720p', '1080p', inactive)
    """

    name: str
    treatments: tuple[Any, ...]
    texts: tuple[str, ...] = field(repr=False, compare=False)
    range: Range | None = field(repr=False)
    unit: str = field(repr=False)
    when: Mapping[str, tuple[Any, ...]] = field(repr=False)
    _positions: Mapping[str, int] = field(repr=False, compare=False)

    def __init__(
        self, name: str, treatments: Iterable[Any] | Range, *, unit: str = "", when: Mapping[Any, Any] | None = None
    ) -> None:
        where = f"factor {name!r}"
        span = treatments if isinstance(treatments, Range) else None
        listed, unlisted = _listed(where, (span.lower, span.upper) if span else treatments)
        conditions, wrong = _conditions(where, when)
        if conditions and not any(each is INACTIVE for each in listed):
            listed = (*listed, INACTIVE)
        findings = [*name_findings(name, kind="factor"), *unlisted, *treatment_findings(where, listed)]
        findings += [*_unit_findings(where, unit, span), *wrong]
        DesignError.refuse(findings)
        texts = tuple(map(str, listed))
        positions = {text: place for place, text in enumerate(texts)}
        given = (name, listed, texts, span, span.unit if span else unit, conditions, positions)
        for attribute, value in zip(self.__slots__, given, strict=True):
            object.__setattr__(self, attribute, value)

    def with_treatments(self, treatments: Iterable[Any]) -> Factor:
        """Return the factor with other treatments, and with its range, unit and condition."""
        changed = Factor(self.name, treatments, unit=self.unit, when=self.when or None)
        object.__setattr__(changed, "range", self.range)
        return changed

    def with_chosen(self, combinations: Iterable[Mapping[str, Any]]) -> Factor:
        """Return the factor of a range with the treatments of these combinations, too; any other as it is."""
        if self.range is None:
            return self
        chosen = {str(each[self.name]): each[self.name] for each in combinations}
        found = {**chosen, **dict(zip(self.texts, self.treatments, strict=True))}.values()
        return self.with_treatments(sorted(found, key=lambda each: math.inf if each is INACTIVE else each))

    @classmethod
    def revisions(cls, name: str, repository: Any, revisions: Iterable[str], *, build: str = "") -> Factor:
        """Make a factor of revisions of a git repository: each has a work tree of its own, built once.

        Args:
            name: the column of the run table.
            repository: the path of a repository on this machine, or a URL that git can clone.
            revisions: tags, branches or hashes of commits.
            build: a command for the shell, executed in each work tree, such as `make -j2`; empty for none.

        Raises:
            DesignError: the name or a revision is invalid.

        Example:
            >>> Factor.revisions("Version", "~/planner", ["v1.0", "main"], build="make").texts
            ('v1.0', 'main')
        """
        where, fix = f"factor {name!r}", "Name a tag, a branch or a commit, such as 'v1.0' or 'main'."
        listed, findings = _listed(where, revisions)
        wrong = [each for each in listed if not is_revision_name(each)]
        findings += [Finding.error(where, f"{each!r} names no revision", fix) for each in wrong]
        DesignError.refuse(findings)
        return cls(name, [Revision(str(repository), each, build=build) for each in listed])

    def __hash__(self) -> int:
        return hash(self.name)  # treatments need not be hashable

    def position_of(self, value: Any) -> int | None:
        """Return the index of the treatment that `value` means, or None.

        That is the one with the same type and text, else the only one that is equal. True is never 1.
        """
        place = self.position_of_text(str(value))
        if place is not None and type(self.treatments[place]) is type(value):
            return place
        equal = [place for place, treatment in enumerate(self.treatments) if treatments_are_equal(treatment, value)]
        same_type = [place for place in equal if type(self.treatments[place]) is type(value)]
        candidates = same_type or equal
        return candidates[0] if len(candidates) == 1 else None

    def named(self, wanted: Any) -> Sequence[Any]:
        """Return the treatments that a condition or an exclusion names: one, which may be a tuple, or several."""
        if self.position_of(wanted) is None:
            if isinstance(wanted, list | tuple | range):
                return wanted
            if isinstance(wanted, set | frozenset):
                return sorted(wanted, key=repr)
        return (wanted,)

    def position_of_text(self, text: str) -> int | None:
        """Return the index of the treatment with exactly this text, or None."""
        return self._positions.get(text)

    def suggestion(self, value: Any) -> str:
        """Return a fix for a value that is not a treatment: the nearest one, or a list of all."""
        near = nearest(str(value), self.texts) if len(self.texts) <= _COMPARED else None
        if near is not None:
            return f"Did you mean {self.treatments[self._positions[near]]!r}?"
        shown = ", ".join(map(repr, self.treatments[:_SHOWN]))
        more = len(self.treatments) - _SHOWN
        return f"Choose one of: {shown}{f' and {more} more' if more > 0 else ''}."


def _unit_findings(where: str, unit: object, span: Range | None) -> Iterator[Finding]:
    if not isinstance(unit, str):
        yield Finding.error(where, f"the unit {unit!r} is not text", "Give it as in unit='m/s'.")
    elif unit and span is not None:
        yield Finding.error(where, f"the unit {unit!r} is given beside a range", f"Give Range(..., unit={unit!r}).")


def _conditions(where: str, when: object) -> tuple[dict[str, tuple[Any, ...]], list[Finding]]:
    """Return the treatments of other factors under which a factor applies, and errors."""
    if when is None:
        return {}, []
    fix = 'Give it as in when={"Sensor": "camera"}.'
    if not isinstance(when, Mapping) or not when:
        return {}, [Finding.error(where, f"when={when!r} names no other factor", fix)]
    named: dict[str, tuple[Any, ...]] = {}
    for key, wanted in when.items():
        name = key.name if isinstance(key, Factor) else key
        if not isinstance(name, str):
            return {}, [Finding.error(where, f"when={when!r} names {key!r}, which is not a factor", fix)]
        if isinstance(wanted, set | frozenset):  # whose order differs between processes
            wanted = sorted(wanted, key=repr)  # noqa: PLW2901
        named[name] = tuple(wanted) if isinstance(wanted, list | tuple | range) else (wanted,)
        if not named[name]:
            return {}, [Finding.error(where, f"when={when!r} names no treatment of {name!r}", fix)]
    return named, []


def _listed(where: str, treatments: object) -> tuple[tuple[Any, ...], list[Finding]]:
    kind = type(treatments).__name__
    if isinstance(treatments, str | bytes | Mapping) or not isinstance(treatments, Iterable):
        problem = f"the treatments are {treatments!r}, which is of type {kind}"
        return (), [Finding.error(where, problem, "Give a list.")]
    if isinstance(treatments, set | frozenset):
        problem = "the treatments are a set, which has another order in each process"
        return (), [Finding.error(where, problem, "Give a list.")]
    listed = tuple(islice(treatments, MAX_TREATMENTS + 1))
    if not listed:
        return (), [Finding.error(where, "the factor has no treatments", "Give at least one.")]
    if len(listed) > MAX_TREATMENTS:
        problem = f"the factor has more than {MAX_TREATMENTS:,} treatments"
        return (), [Finding.error(where, problem, "Give fewer; an endless iterable cannot be planned.")]
    return listed, []


class UnknownFactorError(KeyError):
    """A run's combination has no such factor; the text names the nearest one.

    Example:
        >>> str(UnknownFactorError("Sped", ["Speed", "Task"]))
        "the run has no factor 'Sped': did you mean 'Speed'?"
    """

    def __init__(self, factor: object, known: Iterable[str]) -> None:
        super().__init__(factor)
        self.known = tuple(known)

    def __str__(self) -> str:
        near = nearest(self.args[0], self.known) if isinstance(self.args[0], str) else None
        meant = f"did you mean {near!r}?" if near else f"it has {', '.join(map(repr, self.known))}"
        return f"the run has no factor {self.args[0]!r}: {meant}"

    def __reduce__(self) -> tuple[type[UnknownFactorError], tuple[object, tuple[str, ...]]]:
        """Return how to pickle it: `KeyError` would lose the known factors."""
        return type(self), (self.args[0], self.known)


class Combination(Mapping[str, Any]):
    """One treatment for each factor, by the factor's name. Read-only.

    The treatments are the factors' own objects; the names are shared by all combinations of a design.

    Example:
        >>> Combination({"Task": 0, "Speed": 1}, ("Video", 0.2))["Speed"]
        0.2
    """

    __slots__ = ("_places", "treatments")

    def __init__(self, places: Mapping[str, int], treatments: tuple[Any, ...]) -> None:
        self._places = places
        self.treatments = treatments

    def __getitem__(self, factor: str) -> Any:
        try:
            return self.treatments[self._places[factor]]
        except KeyError:
            raise UnknownFactorError(factor, self._places) from None

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)

    def __repr__(self) -> str:
        return repr(dict(self))

    def __str__(self) -> str:
        return ", ".join(f"{name}={treatment!r}" for name, treatment in self.items())

    def of_one_run(self) -> Combination:
        """Return a copy for a single run: if its callbacks change a list, say, other runs keep theirs."""
        return Combination(self._places, tuple(map(_of_one_run, self.treatments)))

    @property
    def texts(self) -> tuple[str, ...]:
        """The treatments as text, in the order of the factors: unique among the combinations of a design."""
        return tuple(map(str, self.treatments))


def _of_one_run(treatment: Any) -> Any:
    try:
        hash(treatment)
    except Exception:  # noqa: BLE001 - what can be changed cannot be hashed, and strangers' objects say so in many ways
        with suppress(Exception):
            return deepcopy(treatment)
    return treatment


def texts_of(combination: Mapping[str, Any]) -> dict[str, str]:
    """Return the treatment of each factor as text, as the journal and the run table have it."""
    return {name: str(treatment) for name, treatment in combination.items()}


def factor_name(given: Any) -> Any:
    """Return the name of a factor that was given by name or as an object; anything else is returned unchanged."""
    return given.name if isinstance(given, Factor) else given


def factor_places(names: Iterable[str]) -> dict[str, int]:
    """Return the index of each factor's treatment in a combination."""
    return {name: place for place, name in enumerate(names)}
