"""What of the order of runs is held where several are executed at once: periods of a unit, whole plots."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Self

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from robot_runner.core.design.planned_runs import PlannedRun


#: The fact of a design that holds what is described here.
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
        """Return what a design says in its facts; nothing is held where it says nothing."""
        return cls(**facts.get(HELD_ORDER, {}))

    @property
    def is_open(self) -> bool:
        """Whether runs may overlap and change places as they like."""
        return not (self.one_by_one or self.one_after_another)

    def as_mapping(self) -> dict[str, Any]:
        """Return it as plain data, for the facts of a design."""
        return {name: value for name in self.__slots__ if (value := getattr(self, name))}

    def waits_for(self, run: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
        """Return whether a run has to wait until another one is over, which comes before it in the plan."""
        if self.one_by_one and _is_same(self.one_by_one, run, other):
            return True
        return bool(self.one_after_another) and not _is_same(self.one_after_another, run, other)

    def rests(self, runs: Iterable[PlannedRun]) -> dict[str, float]:
        """Return how long the unit of each run rests before it, s, by the run's id, where it does."""
        found: dict[str, float] = {}
        last: dict[str, Mapping[str, Any]] = {}
        for run in runs if self.rest_in_s else ():
            before = last.setdefault(str(run.combination[self.one_by_one]), run.combination)
            if not _is_same(self.rest_between, before, run.combination):
                found[run.run_id] = self.rest_in_s
            last[str(run.combination[self.one_by_one])] = run.combination
        return found


def _is_same(factor: str, one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    # By their texts, as in the run table: of two objects of a user's, equality may say anything.
    return one[factor] is other[factor] or str(one[factor]) == str(other[factor])
