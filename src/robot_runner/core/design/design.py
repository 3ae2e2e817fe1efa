"""What a design is: it chooses the combinations of an experiment, and may decide on their order and blocks, too."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import count
from typing import TYPE_CHECKING, Any, Final, Protocol, runtime_checkable

from robot_runner.core.design.columns import numbered_run_id
from robot_runner.core.design.factor import Combination, Factor, full_factorial
from robot_runner.core.design.planned_runs import PlannedRun

if TYPE_CHECKING:
    from collections.abc import Iterator

    from robot_runner.core.errors import Finding


#: Whether the exclusions leave a combination. The one that a run-table model gives is an `exclusions.Allowed`, which
#: also says which treatments exclude each other, for designs that build combinations factor by factor.
IsAllowed = Callable[[Combination], bool]

#: What the default design is called wherever a design is kept.
FULL_FACTORIAL: Final = "full_factorial"


@dataclass(frozen=True, slots=True)
class DesignedRuns:
    """The runs that a design plans.

    Attributes:
        runs: in the order of execution.
        facts: what `plan`, the manifest and the report say of the design, as plain JSON data: its `kind`; where it has
            them, `aliases`, `resolution`, `model`, and which columns are what (`whole_plot_factors`, `period`, ...).
    """

    runs: Sequence[PlannedRun]
    facts: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def in_order(cls, runs: Iterable[tuple[Combination, int, int | None]], facts: Mapping[str, Any]) -> DesignedRuns:
        """Return runs that are numbered as they come.

        Args:
            runs: combination, repetition (from 1) and block (from 1, or None) of each, in the order of execution.
            facts: see the attribute.
        """
        planned = (
            PlannedRun(numbered_run_id(number), number, combination, repetition, block)
            for number, (combination, repetition, block) in zip(count(1), runs, strict=False)
        )
        return cls(list(planned), facts)


@dataclass(frozen=True, slots=True)
class ChosenCombinations:
    """The combinations that a design chooses.

    Attributes:
        combinations: in the order as written; none twice but where the design says so, as centre points.
        facts: see `DesignedRuns.facts`.
        factors: with the treatments that the design chose for them, as it does within a range; None for the same.
        warnings: what the design has to say that does not refuse it.
    """

    combinations: list[Combination]
    facts: Mapping[str, Any] = field(default_factory=dict)
    factors: Sequence[Factor] | None = None
    warnings: tuple[Finding, ...] = ()


@runtime_checkable
class _DescribedDesign(Protocol):
    def findings(self, factors: Sequence[Factor], repetitions: int) -> Iterator[Finding]:
        """Say why the design cannot be: all findings at once, before anything is made."""

    def as_mapping(self) -> Mapping[str, Any]:
        """Return the design as plain JSON data, its `kind` first: what manifest, registration and package keep."""


@runtime_checkable
class Design(_DescribedDesign, Protocol):
    """Decides which runs are executed, in which blocks and order. Pure: the same seed gives the same runs.

    Columns such as the day, the operator or the period are ordinary factors; `facts` say which column has which role.
    """

    def runs(
        self, factors: Sequence[Factor], is_allowed: IsAllowed, repetitions: int, seed: int, shuffle: bool
    ) -> DesignedRuns:
        """Return the runs in the order of execution.

        Args:
            factors: what is varied; combinations hold the factors' own treatments.
            is_allowed: whether the exclusions leave a combination.
            repetitions: how often each combination is executed.
            seed: what a randomised order comes from.
            shuffle: whether the order is randomised, as far as the design leaves it open.

        Raises:
            DesignError: nothing is left, or it cannot be made for these factors.
        """


@runtime_checkable
class CombinationDesign(_DescribedDesign, Protocol):
    """Chooses combinations; repetitions, blocks and order are the run-table model's.

    The choice belongs to the design: where it draws, it does so from a seed of its own, so that a study which is
    executed again in another order measures the same combinations.
    """

    def choose(self, factors: Sequence[Factor], is_allowed: IsAllowed) -> ChosenCombinations:
        """Return the combinations to execute.

        Raises:
            DesignError: nothing is left, or it cannot be made for these factors.
        """


@dataclass(frozen=True, slots=True)
class FullFactorial:
    """Every combination of the factors' treatments: what a run-table model plans where it is given no design.

    Example:
        >>> factors = [Factor("Task", ["Video", "Network"]), Factor("Speed", [0.1, 0.2])]
        >>> len(FullFactorial().choose(factors, lambda combination: True).combinations)
        4
    """

    def findings(self, factors: Sequence[Factor], repetitions: int) -> Iterator[Finding]:
        """Say nothing: every combination of any factors can be."""
        del factors, repetitions
        yield from ()

    def as_mapping(self) -> Mapping[str, Any]:
        """Return its kind."""
        return {"kind": FULL_FACTORIAL}

    def choose(self, factors: Sequence[Factor], is_allowed: IsAllowed) -> ChosenCombinations:
        """Return every combination that is allowed; the first factor changes slowest."""
        return ChosenCombinations([each for each in full_factorial(factors) if is_allowed(each)], self.as_mapping())
