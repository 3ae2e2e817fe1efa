"""How far a run has come, and the word for it in the run table (paper, Fig. 3)."""

from __future__ import annotations

from enum import Enum

__all__ = ["RunStatus", "status_of_word"]


class RunStatus(Enum):
    """How far a run has come; the value is the word in the run table.

    Example:
        >>> status_of_word("TODO")
        <RunStatus.TODO: '-'>
    """

    TODO = "-"
    RUNNING = "Running"
    DONE = "Done"
    FAILED = "Failed"

    #: Each member is there once; the enumeration's own would hash its name, in Python, at each look into a dictionary.
    __hash__ = object.__hash__


# Spreadsheets turn a hyphen into a dash, and people write what they see elsewhere.
_WORDS = {status.value.casefold(): status for status in RunStatus} | dict.fromkeys(
    ("", "–", "—", "todo", "to do", "to_do"),  # noqa: RUF001 - the dashes are meant
    RunStatus.TODO,
)


def status_of_word(word: str) -> RunStatus | None:
    """Return the status that is written so, whatever the case of its letters, or None."""
    return _WORDS.get(word.strip().casefold())
