"""Noticing which treatments of a run are read: a factor that is never read was never applied."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from robot_runner.core.design.factor import UnknownFactorError
from robot_runner.core.errors import Finding


class WatchedCombination(Mapping[str, Any]):
    """A run's combination that calls `tell` when a treatment is read for the first time. Read-only.

    Example:
        >>> watched = WatchedCombination({"Task": "Video", "Speed": 0.2}, print)
        >>> watched["Speed"], watched["Speed"]
        Speed
        (0.2, 0.2)
    """

    __slots__ = ("_combination", "_told", "_unread")

    def __init__(self, combination: Mapping[str, Any], tell: Callable[[str], None]) -> None:
        self._combination = combination
        self._told = tell
        self._unread = set(combination)

    def __getitem__(self, factor: str) -> Any:
        try:
            treatment = self._combination[factor]
        except KeyError:
            raise UnknownFactorError(factor, self._combination) from None
        self._read(factor)
        return treatment

    def __contains__(self, factor: object) -> bool:
        found = factor in self._combination
        if found:
            self._read(str(factor))
        return found

    def __iter__(self) -> Iterator[str]:
        self._read(*self._combination)
        return iter(self._combination)

    def __len__(self) -> int:
        return len(self._combination)

    def __repr__(self) -> str:
        self._read(*self._combination)
        return repr(self._combination)

    def __str__(self) -> str:
        self._read(*self._combination)
        return str(self._combination)

    def __reduce__(self) -> tuple[type[dict[str, Any]], tuple[dict[str, Any]]]:
        """Pickle it as a plain mapping: reads in another process are not noticed."""
        return dict, (dict(self),)

    @property
    def unwatched(self) -> Mapping[str, Any]:
        """The combination itself, whose reads are not noticed."""
        return self._combination

    @property
    def unread(self) -> frozenset[str]:
        """The factors whose treatments were not read so far."""
        return frozenset(self._unread)

    def _read(self, *factors: str) -> None:
        for factor in factors:
            if factor in self._unread:
                self._unread.discard(factor)
                self._told(factor)


def unread(run_id: str, factor: str) -> Finding:
    """Return the finding on a factor whose treatment nothing has read in a run."""
    return Finding.warning(
        f"{run_id}, factor {factor!r}",
        f"no callback and no plugin looked at {factor}: its treatments may never have been applied",
        f"Bind it to a parameter of a plugin, as in BasicTurtlebot3(speed=treatment({factor!r})), or read "
        f"context.combination[{factor!r}] in a callback, which may also tell the person who applies it by hand.",
    )
