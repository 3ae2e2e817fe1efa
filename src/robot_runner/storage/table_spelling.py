"""How the file of a run table spells what it holds: the headings, and the words for how far a run has come."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import TYPE_CHECKING

from robot_runner.design.columns import RUN_ID, STATUS
from robot_runner.storage.run_status import RunStatus

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["EARLIER_SPELLING", "OWN_SPELLING", "TableSpelling", "spelling_of_headings"]

_OWN_WORDS = MappingProxyType({status: status.value for status in RunStatus})


@dataclass(frozen=True, slots=True)
class TableSpelling:
    """How the file of a run table spells what it holds; in memory, columns have the names of Robot Runner.

    Attributes:
        headings: the heading of a column, by its name; a column that is not here is headed by its name.
        status_words: the word for each status. Two statuses may share a word: the journal tells them apart.
        has_stamps: whether there are columns for the events' time stamps.
        blank_is_missing: whether a blank stands for a missing value, as nothing does.

    Example:
        >>> spelling = TableSpelling(headings={"run_id": "__run_id"})
        >>> spelling.heading("run_id"), spelling.name("__run_id"), spelling.heading("Task")
        ('__run_id', 'run_id', 'Task')
    """

    headings: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))
    status_words: Mapping[RunStatus, str] = field(default_factory=lambda: _OWN_WORDS)
    has_stamps: bool = True
    blank_is_missing: bool = False

    def heading(self, name: str) -> str:
        """Return what stands at the head of a column."""
        return self.headings.get(name, name)

    def name(self, heading: str) -> str:
        """Return the name of the column that has this heading; a heading that is not known is a name."""
        return next((name for name, known in self.headings.items() if known == heading), heading)

    def tells_apart(self, one: RunStatus, other: RunStatus) -> bool:
        """Return whether the file shows which of two statuses a run has."""
        return self.status_words[one] != self.status_words[other]


OWN_SPELLING = TableSpelling()

#: As the earlier tools wrote it: a run is done or to do, nothing else.
EARLIER_SPELLING = TableSpelling(
    headings=MappingProxyType({RUN_ID: "__run_id", STATUS: "__done"}),
    status_words=MappingProxyType(dict.fromkeys(RunStatus, "TODO") | {RunStatus.DONE: "DONE"}),
    has_stamps=False,
    blank_is_missing=True,
)


def spelling_of_headings(headings: Mapping[str, str]) -> TableSpelling:
    """Return the spelling of a file in which some columns are headed by something else than their names.

    Example:
        >>> spelling_of_headings({"run_id": "__run_id"}).status_words[RunStatus.FAILED]
        'TODO'
    """
    is_earlier = headings.get(RUN_ID) == EARLIER_SPELLING.heading(RUN_ID)
    return replace(EARLIER_SPELLING if is_earlier else OWN_SPELLING, headings=headings)
