"""Ask and tell: designs whose next runs depend on the results so far.

Whenever all planned runs are done, an `Asking` gets all of them and returns the next ones. It is pure: the same history
and the same seed give the same answer, so that an experiment that was killed before the answer was recorded gets it
again. A recorded answer is never asked for again.
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
#: What is decided from the results, in words: by the rules of `repeat_until`, or by a design.
HOW_OFTEN = "how often it is repeated until it is precise"
WHICH_RUNS = "which runs follow from the results"


class Told(NamedTuple):
    """A planned run with its values, for the decision on the next runs; warm-up runs are left out.

    Attributes:
        run: its combination, repetition and batch.
        values: of the measures of `Asking.measures`, by name; without those of a run that failed, and without doubtful
            ones where the analysis plan leaves them out.
        is_excluded: whether the run was excluded, or a doubtful value of it is left out by the analysis plan: a missing
            value is not a failure then.
        is_doubtful: whether only a doubtful value is left out, and the run counts.
    """

    run: PlannedRun
    values: Mapping[str, Any]
    is_excluded: bool = False
    is_doubtful: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Decision:
    """A decision: the next runs, or none, and the reason.

    Attributes:
        name: of the next runs, such as `repetition 4`; their order is drawn from it and the experiment's seed.
        in_words: what is known by now and what follows, for people.
        runs: the combination and the repetition of each, in the order as written; empty where nothing follows.
        blocks: as in a run-table model; None for those of the model.
        confirms: whether they are a batch of their own that confirms what was found; otherwise they belong to the
            batch before them.
        kind: of the journal's record of it.
        facts: further fields of the record, as plain data.
        findings: shown at the end of the experiment, as problem and fix.
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
    """Decides which runs are executed next, from the results so far; pure."""

    @property
    def measures(self) -> Sequence[str]:
        """The measures whose values it needs."""

    def may_add(self, runs: Sequence[PlannedRun]) -> bool:
        """Return whether more runs may follow these planned ones."""

    def ask(self, told: Sequence[Told]) -> Decision:
        """Return the next runs; `told` has all runs of the run table so far."""


@runtime_checkable
class AdaptiveDesign(Protocol):
    """A design that plans its first runs, and decides on the next ones from their results.

    Its facts (see `DesignedRuns.facts`) have `decides`, in words what is decided, and `most_runs`, how many runs there
    are at most. Its runs are exploratory, except those of decisions that confirm.
    """

    @property
    def measures(self) -> Sequence[str]:
        """The measures that it decides by."""

    def repetition_findings(self, factors: Sequence[Factor], repetitions: int) -> Iterator[Finding]:
        """Yield an error where the design cannot have so many repetitions of each combination."""

    def asking(self, factors: Sequence[Factor], is_allowed: IsAllowed, repetitions: int) -> Asking:
        """Return the object that decides; `is_allowed` returns whether a combination is not excluded."""


def decides_order(design: object) -> bool:
    """Return whether a design fixes order and blocks itself, instead of the model or results."""
    # Designs that choose combinations may have an attribute `runs`, too: their number.
    return isinstance(design, Design) and not isinstance(design, CombinationDesign | AdaptiveDesign)
