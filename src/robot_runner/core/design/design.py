"""The protocols of designs, which choose the combinations of an experiment, and perhaps their order and blocks."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import count
from typing import Any, Final, Protocol, Self, runtime_checkable

from robot_runner.core.design.columns import numbered_run_id
from robot_runner.core.design.factor import Combination, Factor, factor_places
from robot_runner.core.design.full_factorial import full_factorial
from robot_runner.core.design.planned_runs import PlannedRun
from robot_runner.core.errors import DesignError, Finding

#: Returns whether a combination is not excluded. That of a run-table model is an `exclusions.Allowed`, which also says
#: which treatments exclude each other, for designs that build combinations factor by factor.
IsAllowed = Callable[[Combination], bool]

#: The `kind` of the default design in manifests and registrations.
FULL_FACTORIAL: Final = "full_factorial"


@dataclass(frozen=True, slots=True)
class DesignedRuns:
    """The runs that a design plans.

    Attributes:
        runs: in the order of execution.
        facts: of the design, for `plan`, the manifest and the report, as plain JSON data: its `kind`; where it has
            them, `aliases`, `resolution`, `model`, and the roles of columns (`whole_plot_factors`, `period`, ...).
    """

    runs: Sequence[PlannedRun]
    facts: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def in_order(cls, runs: Iterable[tuple[Combination, int, int | None]], facts: Mapping[str, Any]) -> DesignedRuns:
        """Return runs (combination, repetition from 1, block from 1 or None) numbered in this order of execution."""
        planned = (
            PlannedRun(numbered_run_id(number), number, combination, repetition, block)
            for number, (combination, repetition, block) in zip(count(1), runs, strict=False)
        )
        return cls(list(planned), facts)


@dataclass(frozen=True, slots=True)
class ChosenCombinations:
    """The combinations that a design chooses.

    Attributes:
        combinations: in the order as written; repeated only on purpose, as centre points are.
        facts: see `DesignedRuns.facts`.
        factors: with the treatments that the design chose within ranges; None where it chose none.
        warnings: findings that do not refuse the design.
    """

    combinations: list[Combination]
    facts: Mapping[str, Any] = field(default_factory=dict)
    factors: Sequence[Factor] | None = None
    warnings: tuple[Finding, ...] = ()


@runtime_checkable
class _DescribedDesign(Protocol):
    def findings(self, factors: Sequence[Factor]) -> Iterator[Finding]:
        """Yield all reasons why the design is impossible for these factors, before anything is made."""

    def as_mapping(self) -> Mapping[str, Any]:
        """Return the design as plain JSON data, its `kind` first, for manifest, registration and package."""


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
            is_allowed: returns whether a combination is not excluded.
            repetitions: how often each combination is executed.
            seed: of a randomised order.
            shuffle: whether the order is randomised, as far as the design leaves it open.

        Raises:
            DesignError: all combinations are excluded, or the design is impossible for these factors.
        """


@runtime_checkable
class CombinationDesign(_DescribedDesign, Protocol):
    """Chooses combinations; repetitions, blocks and order are the run-table model's.

    A random choice has a seed of its own, so that a study which is executed again in another order measures the same
    combinations.
    """

    def choose(self, factors: Sequence[Factor], is_allowed: IsAllowed) -> ChosenCombinations:
        """Return the combinations to execute.

        Raises:
            DesignError: all combinations are excluded, or the design is impossible for these factors.
        """


@dataclass(frozen=True, slots=True)
class FullFactorial:
    """Every combination of the factors' treatments, the default of a run-table model.

    Example:
        >>> from robot_runner import Factor
        >>> factors = [Factor("Task", ["Video", "Network"]), Factor("Speed", [0.1, 0.2])]
        >>> len(FullFactorial().choose(factors, lambda combination: True).combinations)
        4
    """

    def findings(self, factors: Sequence[Factor]) -> Iterator[Finding]:
        """Yield nothing: a full factorial is possible for any factors."""
        del factors
        yield from ()

    def as_mapping(self) -> Mapping[str, Any]:
        """Return its kind."""
        return {"kind": FULL_FACTORIAL}

    def choose(self, factors: Sequence[Factor], is_allowed: IsAllowed) -> ChosenCombinations:
        """Return every combination that is allowed; the first factor changes slowest."""
        return ChosenCombinations([each for each in full_factorial(factors) if is_allowed(each)], self.as_mapping())


def extended_choice(
    design: CombinationDesign | Design,
    planned: Iterable[PlannedRun],
    own: Sequence[Factor],
    factors: Sequence[Factor],
    allowed_of: Callable[[Sequence[Factor]], IsAllowed],
) -> list[Combination]:
    """Return the combinations of a plan, each once, with those that its design adds where `factors` have grown.

    A design can grow if its earlier choice is part of the present one, as with one factor at a time.

    Raises:
        DesignError: it cannot, so that existing runs would not belong to the design.
    """
    places = factor_places(factor.name for factor in factors)
    found = _by_texts(run.combination for run in planned)
    texts, own_texts = ({factor.name: set(factor.texts) for factor in each} for each in (factors, own))
    if texts != own_texts:
        there, found = found, {}
        has_more = texts.keys() == own_texts.keys() and all(own_texts[name] <= texts[name] for name in texts)
        if (
            has_more
            and all(factor.range is None for factor in own)
            and isinstance(design, CombinationDesign)
            and not any(design.findings(factors))
        ):
            found = _by_texts(design.choose(factors, allowed_of(factors)).combinations)
        if not there.keys() <= found.keys():
            raise _does_not_grow(design)
    return [Combination(places, tuple(each[name] for name in places)) for each in found.values()]


def _by_texts(combinations: Iterable[Combination]) -> dict[tuple[str, ...], Combination]:
    return {tuple(str(each[name]) for name in sorted(each)): each for each in combinations}


def _does_not_grow(design: CombinationDesign | Design) -> DesignError:
    kind = str(design.as_mapping()["kind"]).replace("_", " ")
    problem = f"the {kind} chose its combinations from the factors as the config has them, and would choose others"
    fix = (
        "Add repetitions, or execute an experiment of its own with the other factors. (A full factorial takes "
        "treatments and factors, one factor at a time takes treatments.)"
    )
    return DesignError(problem, where="design", fix=fix)


#: The key of `HeldOrder` in the facts of a design.
HELD_ORDER = "held_order"


@dataclass(frozen=True, slots=True)
class HeldOrder:
    """Which runs never overlap and never change places, and how long a unit rests between its periods.

    Attributes:
        one_by_one: a factor; runs that share its treatment are executed one at a time, in the order of the plan.
        one_after_another: a factor; all runs with one treatment are over before one with another begins.
        rest_between: a factor; runs of one unit (that share the treatment of `one_by_one`) that follow each other and
            differ in it have a rest between them.
        rest_in_s: how long that rest lasts, s.

    Example:
        >>> held = HeldOrder(one_by_one="Robot", rest_between="Period", rest_in_s=60.0)
        >>> held.waits_for({"Robot": "A", "Period": 2}, {"Robot": "A", "Period": 1})
        True
    """

    one_by_one: str = ""
    one_after_another: str = ""
    rest_between: str = ""
    rest_in_s: float = 0.0

    @classmethod
    def of_facts(cls, facts: Mapping[str, Any]) -> Self:
        """Read it from the facts of a design; without an entry, nothing is held."""
        return cls(**facts.get(HELD_ORDER, {}))

    @property
    def is_open(self) -> bool:
        """Whether runs may overlap and change places freely."""
        return not (self.one_by_one or self.one_after_another)

    def as_mapping(self) -> dict[str, Any]:
        """Return it as plain data, for the facts of a design."""
        return {name: value for name in self.__slots__ if (value := getattr(self, name))}

    def waits_for(self, run: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
        """Return whether a run has to wait until `other`, which comes before it in the plan, is over."""
        if self.one_by_one and _is_same(self.one_by_one, run, other):
            return True
        return bool(self.one_after_another) and not _is_same(self.one_after_another, run, other)

    def rest_before(self, run: Mapping[str, Any], last: Mapping[str, Any] | None) -> float:
        """Return how long a unit rests before a run, s; `last` is the run that it had last, None where it had none."""
        is_other = last is not None and bool(self.rest_between) and not _is_same(self.rest_between, run, last)
        return self.rest_in_s if is_other else 0.0


def _is_same(factor: str, one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    # By their texts, as in the run table: a user's objects may define any equality.
    return one[factor] is other[factor] or str(one[factor]) == str(other[factor])
