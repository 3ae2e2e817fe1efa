"""A factor: what is varied, and the treatments that it takes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from itertools import islice
from typing import Any

from robot_runner.design.columns import name_findings
from robot_runner.design.treatments import treatment_findings, treatment_text, treatments_are_equal
from robot_runner.errors import DesignError, Finding, nearest

__all__ = ["MAX_TREATMENTS", "Factor"]

#: More than this is taken for an endless iterable.
MAX_TREATMENTS = 1_000_000

_SHOWN = 10
_COMPARED = 1000  # comparing takes some 0.1 ms a treatment


@dataclass(frozen=True, slots=True, init=False)
class Factor:
    """What is varied in an experiment, with its treatments in the order in which they are to be executed.

    Attributes:
        name: the column of the run table.
        treatments: the values, of any type; an object is written as its `str()` and comes back as the object.
        texts: how each treatment is written in the run table.

    Raises:
        DesignError: the name or a treatment cannot be; `findings` lists everything that was found.

    Example:
        >>> Factor("Repetition", range(1, 4)).treatments
        (1, 2, 3)
    """

    name: str
    treatments: tuple[Any, ...]
    texts: tuple[str, ...] = field(repr=False, compare=False)
    _positions: Mapping[str, int] = field(repr=False, compare=False)

    def __init__(self, name: str, treatments: Iterable[Any]) -> None:
        where = f"factor {name!r}"
        listed, findings = _listed(where, treatments)
        findings = [*name_findings(name, kind="factor"), *findings, *treatment_findings(where, listed)]
        if findings:
            raise DesignError.of_findings(findings)
        texts = tuple(map(treatment_text, listed))
        object.__setattr__(self, "name", name)
        object.__setattr__(self, "treatments", listed)
        object.__setattr__(self, "texts", texts)
        object.__setattr__(self, "_positions", {text: place for place, text in enumerate(texts)})

    def __hash__(self) -> int:
        return hash(self.name)  # treatments need not be hashable

    def position_of(self, value: Any) -> int | None:
        """Return the place of the treatment that `value` means, or None.

        The same type and text come first, then equality, where exactly one treatment is equal. True is never 1.
        """
        place = self.position_of_text(treatment_text(value))
        if place is not None and type(self.treatments[place]) is type(value):
            return place
        equal = [place for place, treatment in enumerate(self.treatments) if treatments_are_equal(treatment, value)]
        same_type = [place for place in equal if type(self.treatments[place]) is type(value)]
        candidates = same_type or equal
        return candidates[0] if len(candidates) == 1 else None

    def position_of_text(self, text: str) -> int | None:
        """Return the place of the treatment that is written exactly so, or None."""
        return self._positions.get(text)

    def suggestion(self, value: Any) -> str:
        """Return a fix for a value that is no treatment: the nearest one, or a list of all."""
        near = nearest(treatment_text(value), self.texts) if len(self.texts) <= _COMPARED else None
        if near is not None:
            return f"Did you mean {self.treatments[self._positions[near]]!r}?"
        shown = ", ".join(map(repr, self.treatments[:_SHOWN]))
        more = len(self.treatments) - _SHOWN
        return f"Choose one of: {shown}{f' and {more} more' if more > 0 else ''}."


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
        return (), [Finding.error(where, "it has no treatments", "Give at least one.")]
    if len(listed) > MAX_TREATMENTS:
        problem = f"it has more than {MAX_TREATMENTS:,} treatments"
        return (), [Finding.error(where, problem, "Give fewer; an endless iterable cannot be planned.")]
    return listed, []
