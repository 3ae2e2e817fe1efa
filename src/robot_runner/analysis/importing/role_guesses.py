"""What a column of another tool's run table is taken for, how sure that is, and the option that settles it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

__all__ = ["Confidence", "Role", "RoleGuess", "Verdict"]


class Role(Enum):
    """What a column is."""

    RUN_ID = "run id"
    STATUS = "status"
    REPETITION = "repetition"
    BLOCK = "block"
    FACTOR = "factor"
    MEASURE = "measure"
    TEXT = "kept as text"


class Confidence(Enum):
    """How sure a role is: LIKELY has something to say for it and little against, UNSURE needs an answer."""

    SURE = "sure"
    LIKELY = "likely"
    UNSURE = "unsure"


#: A role, how sure it is, and the reason in words.
Verdict = tuple[Role, Confidence, str]


@dataclass(frozen=True, slots=True)
class RoleGuess:
    """What a column is taken for, how sure that is, and why.

    Example:
        >>> guess = RoleGuess("level", Role.FACTOR, Confidence.UNSURE, "few numbers, which repeat unevenly")
        >>> guess.question
        "column 'level' is taken for a factor: few numbers, which repeat unevenly"
    """

    column: str
    role: Role
    confidence: Confidence
    reason: str

    @property
    def question(self) -> str:
        """What is doubtful, in words."""
        taken = self.role.value if self.role is Role.TEXT else f"taken for a {self.role.value}"
        return f"column {self.column!r} is {taken}: {self.reason}"
