"""Names for files and links: safe, and no two alike."""

from __future__ import annotations

from robot_runner.analysis.figures.style import file_name

__all__ = ["SafeNames"]


class SafeNames:
    """Gives each name a safe one of its own; the same name always gets the same.

    Example:
        >>> names = SafeNames()
        >>> [names("a/b"), names("a b"), names("a/b")]
        ['a_b', 'a_b-2', 'a_b']
    """

    def __init__(self) -> None:
        self._given: dict[str, str] = {}
        self._taken: set[str] = set()

    def __call__(self, name: str) -> str:
        """Return the safe name."""
        if name not in self._given:
            safe = base = file_name(name)
            number = 1
            while safe.casefold() in self._taken:
                number += 1
                safe = f"{base}-{number}"
            self._taken.add(safe.casefold())
            self._given[name] = safe
        return self._given[name]
