"""What a treatment looks like in the run table, and what keeps a value from being one."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

from robot_runner.errors import Finding

if TYPE_CHECKING:
    from collections.abc import Hashable, Iterator, Sequence

__all__ = ["treatment_findings", "treatment_text", "treatments_are_equal"]

_ADDRESS = re.compile(r" at 0x[0-9A-Fa-f]+")


def treatment_text(treatment: Any) -> str:
    """Return how a treatment is written in the run table: its `str()`.

    For a float that is exact (Python writes the shortest text that gives the same number back).
    """
    return str(treatment)


def treatments_are_equal(one: Any, other: Any) -> bool:
    """Return whether two values are equal; a bool equals no number, as True is another treatment than 1."""
    if isinstance(one, bool) is not isinstance(other, bool):
        return False
    try:
        return bool(one == other)
    except (TypeError, ValueError):  # an array compares element by element and has no truth value
        return False


def treatment_findings(where: str, treatments: Sequence[Any]) -> Iterator[Finding]:
    """Say which values cannot be treatments of one factor, alone or beside each other.

    Args:
        where: the factor that they belong to.
        treatments: the values, in order.

    Yields:
        An error finding for each value that could not be recognised in the run table.
    """
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
        text = treatment_text(treatment)
    except Exception as error:  # noqa: BLE001 - a user's __str__ may raise anything
        problem = f"a treatment of type {kind} has no text: its str() raised {type(error).__name__}: {error}"
        return Finding.error(where, problem, "Mend the __str__ of its class.")
    try:
        text.encode()
    except UnicodeEncodeError as error:
        problem = f"treatment {text!r} holds {text[error.start : error.end]!r}, which UTF-8 cannot hold"
        return Finding.error(where, problem, "Leave it out.")
    if not isinstance(treatment, str) and _ADDRESS.search(text):
        problem = f"treatment {text} shows a memory address, so it could not be recognised when resuming"
        return Finding.error(where, problem, f"Give its class a __str__ ({kind}).")
    if isinstance(treatment, set | frozenset) and len(treatment) > 1:
        problem = f"treatment {text} is a set: its elements are written in another order by each process"
        return Finding.error(where, problem, "Give a tuple or a sorted list.")
    return text


def _same_text(where: str, earlier: Any, later: Any, text: str) -> Finding:
    if type(earlier) is type(later):
        return _given_twice(where, later)
    return Finding.error(
        where,
        f"treatments {earlier!r} and {later!r} would both be written {text!r} in the run table",
        "Change one of them so that they look different.",
    )


def _same_value(where: str, by_value: dict[tuple[type, Hashable], Any], treatment: Any) -> Iterator[Finding]:
    try:
        earlier = by_value.setdefault((type(treatment), treatment), treatment)
    except TypeError:  # not hashable: its text has told it from the others
        return
    if earlier is not treatment:
        yield _given_twice(where, treatment)


def _given_twice(where: str, treatment: Any) -> Finding:
    return Finding.error(
        where,
        f"treatment {treatment!r} is given twice",
        "Remove one; repetitions=2 executes each combination twice.",
    )
