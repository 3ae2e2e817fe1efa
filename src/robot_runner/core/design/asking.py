"""Ask and tell: which runs come next depends on what the runs so far have yielded.

Whenever all runs are done that were planned, what decides is told of all of them and asked for the next ones. It is
pure: the same history and the same seed give the same answer, so that an experiment that was killed before the answer
was taken down asks the same question, and gets the same answer. An answer that was taken down is never asked for again.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from robot_runner.core.errors import Finding

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from robot_runner.core.design.factor import Combination
    from robot_runner.core.design.planned_runs import PlannedRun

__all__ = ["DECIDED", "Asking", "Decision", "Told"]

#: The kind of the journal's record of runs that were decided on; see `Decision.kind`.
DECIDED = "decided"


class Told(NamedTuple):
    """A run that was planned, as it is told to what decides on the next ones; runs that only warm up are not.

    Attributes:
        run: its combination, repetition and batch.
        values: of the measures that are asked for, by name; those that the run did not yield, as it failed, are not in
            it, nor are doubtful ones where the analysis plan leaves them out.
        is_excluded: whether somebody left the run out of the analysis: then it has no values.
    """

    run: PlannedRun
    values: Mapping[str, Any]
    is_excluded: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Decision:
    """What follows: the next runs and why, or nothing more and why.

    Attributes:
        name: of what is executed next, such as `repetition 4`; their order comes from it and the experiment's seed.
        in_words: what is known by now and what follows, for people.
        runs: the combination and the repetition of each, in the order as written; empty where nothing follows.
        confirms: whether they are a batch of their own that confirms what was found; if not, they belong to the
            batch before them.
        kind: of the journal's record of it.
        facts: what else the record keeps, as plain data.
        findings: what is told at the end of the experiment, as problem and fix.
    """

    name: str
    in_words: str
    runs: Sequence[tuple[Combination, int]] = ()
    confirms: bool = False
    kind: str = DECIDED
    facts: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))
    findings: Sequence[tuple[str, str]] = ()

    def warnings(self, where: str) -> list[Finding]:
        """Return its findings as warnings of this place."""
        return [Finding.warning(where, problem, fix) for problem, fix in self.findings]


class Asking(Protocol):
    """Decides which runs are executed next, from what those so far have yielded; pure."""

    @property
    def measures(self) -> Sequence[str]:
        """The measures whose values it is told."""

    def may_add(self, runs: Sequence[PlannedRun]) -> bool:
        """Return whether more runs may follow when these are planned."""

    def ask(self, told: Sequence[Told]) -> Decision:
        """Return what is executed next.

        Args:
            told: all runs of the run table, in its order.
        """
