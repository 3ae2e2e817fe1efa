"""Treatments that a run table could not recognise again: they get a text of their own, and callbacks the value."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from robot_runner.design.treatments import treatment_text

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

__all__ = ["ShownTreatment", "shown_treatments", "value_of"]

_ADDRESS = re.compile(r" at 0x[0-9A-Fa-f]+")


@dataclass(frozen=True, slots=True, eq=False)
class ShownTreatment:
    """A value with another text than its own.

    Example:
        >>> str(ShownTreatment(print, "print"))
        'print'
    """

    value: Any
    text: str

    def __str__(self) -> str:
        return self.text

    def __repr__(self) -> str:
        return self.text


def value_of(treatment: Any) -> Any:
    """Return the value that a callback is to see."""
    return treatment.value if isinstance(treatment, ShownTreatment) else treatment


def shown_treatments(values: Iterable[Any], warn: Callable[[Any, str], None]) -> list[tuple[Any, Any]]:
    """Return each different value with the treatment that stands for it in the design.

    Args:
        values: in order, perhaps repeated.
        warn: takes a value whose text had to be changed, and the text that it has now.
    """
    shown: list[tuple[Any, Any]] = []
    texts: set[str] = set()
    for value in values:
        if any(_is_same(value, known) for known, _ in shown):
            continue
        text = treatment_text(value)
        fit = _fit_text(value, text, texts)
        texts.add(fit)
        if fit == text:
            shown.append((value, value))
        else:
            warn(value, fit)
            shown.append((value, ShownTreatment(value, fit)))
    return shown


def _is_same(one: Any, other: Any) -> bool:
    if one is other:
        return True
    return type(one) is type(other) and not _ADDRESS.search(str(one)) and str(one) == str(other)


def _fit_text(value: Any, text: str, taken: set[str]) -> str:
    if isinstance(value, set | frozenset) and len(value) > 1:
        text = "{" + ", ".join(sorted(map(repr, value))) + "}"  # a set is written in another order by each process
    elif _ADDRESS.search(text):
        text = getattr(value, "__qualname__", None) or type(value).__name__
    elif text in taken:
        text = repr(value)
    unique, number = text, 1
    while unique in taken:
        number += 1
        unique = f"{text}_{number}"
    return unique
