"""How far a run had come in the earlier tools."""

from __future__ import annotations

from enum import Enum

__all__ = ["RunProgress"]


class RunProgress(Enum):
    """The `__done` of a row; its name is what stood in the file."""

    TODO = 1
    DONE = 2
    KILLED = 3
