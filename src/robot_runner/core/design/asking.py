"""Ask and tell: which runs come next depends on what the runs so far have yielded.

Whenever all runs are done that were planned, what decides is told of all of them and asked for the next ones. It is
pure: the same history and the same seed give the same answer, so that an experiment that was killed before the answer
was taken down asks the same question, and gets the same answer. An answer that was taken down is never asked for again.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol, runtime_checkable

from robot_runner.core.design.design import CombinationDesign, Design, IsAllowed
from robot_runner.core.design.factor import Combination, Factor
from robot_runner.core.design.planned_runs import PlannedRun
from robot_runner.core.errors import Finding

#: The kind of the journal's record of runs that were decided on; see `Decision.kind`.
DECIDED = "decided"


class Told(NamedTuple):
    """A planned run, as the decision on the next runs is told of it; warm-up runs are left out.

    Attributes:
        run: its combination, repetition and batch.
        values: of the measures that are asked for, by name; those that the run did not yield, as it failed, are not in
            it, nor are doubtful ones where the analysis plan leaves them out.
        is_excluded: whether the run, by somebody, or a doubtful value of it, by the analysis plan, is left out of the
            analysis: what it lacks then tells of no failure.
        is_doubtful: whether it is a doubtful value alone, and the run counts.
    """

    run: PlannedRun
    values: Mapping[str, Any]
    is_excluded: bool = False
    is_doubtful: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Decision:
    """What follows: the next runs and why, or nothing more and why.

    Attributes:
        name: of what is executed next, such as `repetition 4`; their order comes from it and the experiment's seed.
        in_words: what is known by now and what follows, for people.
        runs: the combination and the repetition of each, in the order as written; empty where nothing follows.
        blocks: what its runs are kept together by, as in a run-table model; None for what the model says.
        confirms: whether they are a batch of their own that confirms what was found; if not, they belong to the
            batch before them.
        kind: of the journal's record of it.
        facts: what else the record keeps, as plain data.
        findings: what is told at the end of the experiment, as problem and fix.
    """

    name: str
    in_words: str
    runs: Sequence[tuple[Combination, int]] = ()
    blocks: str | None = None
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
        """Return what is executed next, by all runs of the run table so far."""


@runtime_checkable
class AdaptiveDesign(Protocol):
    """A design that plans its first runs, and decides on the next ones from what these yield.

    Its facts (see `DesignedRuns.facts`) have `decides`, which says in words what is decided, and `most_runs`, how many
    runs there are at most. What it plans and decides on is exploratory, but for decisions that confirm.
    """

    @property
    def measures(self) -> Sequence[str]:
        """The measures that it decides by."""

    def repetition_findings(self, factors: Sequence[Factor], repetitions: int) -> Iterator[Finding]:
        """Say why it cannot be with so many repetitions of each combination."""

    def asking(self, factors: Sequence[Factor], is_allowed: IsAllowed, repetitions: int) -> Asking:
        """Return what decides.

        Args:
            factors: what is varied, as the config has it.
            is_allowed: whether the exclusions leave a combination.
            repetitions: how often each combination is executed.
        """


def decides_order(design: object) -> bool:
    """Return whether a design decides on order and blocks, once and for all: neither the model nor results do."""
    # Designs that choose combinations may have an attribute `runs`, too: their number.
    return isinstance(design, Design) and not isinstance(design, CombinationDesign | AdaptiveDesign)
