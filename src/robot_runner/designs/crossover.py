"""The crossover design: each robot, machine or person gets all treatments, one per period."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

from robot_runner.core.design.design import HELD_ORDER, DesignedRuns, HeldOrder, IsAllowed
from robot_runner.core.design.factor import Factor, factor_name
from robot_runner.core.design.numeric_range import is_number
from robot_runner.core.errors import Finding
from robot_runner.core.words import counted
from robot_runner.designs.choosing import Described
from robot_runner.designs.factor_roles import Roles, refused, role_findings, shuffled, texts_of_combination


def williams_sequences(treatments: int) -> list[tuple[int, ...]]:
    """Return sequences in which each treatment follows each other one, and is in each period, equally often.

    Source: Williams, Experimental designs balanced for the estimation of residual effects of treatments, Australian
    Journal of Scientific Research A 2 (1949), 149-168: one square of sequences for an even number of treatments, and
    for an odd one this square with its mirror image.

    Example:
        >>> williams_sequences(4)
        [(0, 1, 3, 2), (1, 2, 0, 3), (2, 3, 1, 0), (3, 0, 2, 1)]
    """
    first = [place // 2 + 1 if place % 2 else -(place // 2) for place in range(treatments)]  # 0, 1, -1, 2, -2, ...
    square = [tuple((each + shift) % treatments for each in first) for shift in range(treatments)]
    return square if treatments % 2 == 0 else [*square, *(sequence[::-1] for sequence in square)]


@dataclass(frozen=True, slots=True)
class Crossover(Described):
    """Give each unit (a robot, a machine, a person) each treatment in one period, with balanced carry-over.

    The other factors are studied; the number of periods is that of their combinations. Repetitions are executed within
    the period, before the unit changes to its next treatment. `WarmUp(2, per="combination")` begins each period with
    runs that wash out the previous treatment and are not analysed. With `shuffle`, treatments and units are assigned to
    the sequences at random. Units are in the order of their treatments, each with its periods in order; the runs of a
    unit are never executed in parallel.

    Attributes:
        unit: the factor whose treatments are the units; their number must be a multiple of the number of sequences.
        period: the factor whose treatments are the periods, in order.
        washout_in_s: the rest of a unit between two periods, in s, so that no effect of a treatment remains.

    Example:
        >>> from robot_runner import Factor, RunTableModel
        >>> factors = [Factor("Robot", ["A", "B"]), Factor("Period", [1, 2]), Factor("Planner", ["old", "new"])]
        >>> model = RunTableModel(factors, design=Crossover("Robot", "Period", washout_in_s=60))
        >>> [run.combination["Planner"] for run in model.plan()]
        ['old', 'new', 'new', 'old']
    """

    kind: ClassVar[str] = "crossover"
    unit: str | Factor
    period: str | Factor
    washout_in_s: float = 0

    def findings(self, factors: Sequence[Factor]) -> Iterator[Finding]:
        """Yield findings on the factors and on the washout."""
        named = [("unit", factor_name(self.unit)), ("period", factor_name(self.period))]
        yield from role_findings("Crossover", named, factors)
        if not is_number(self.washout_in_s) or self.washout_in_s < 0:
            problem = f"{self.washout_in_s!r} is not a time to wait"
            yield Finding.error("design: Crossover(washout_in_s=...)", problem, "Give seconds, from 0.")

    def runs(
        self, factors: Sequence[Factor], is_allowed: IsAllowed, repetitions: int, seed: int, shuffle: bool
    ) -> DesignedRuns:
        """Return the runs, unit by unit, each with its periods in order.

        Raises:
            DesignError: the numbers of units, periods and treatments do not match, or a treatment is excluded for some
                units or periods only.
        """
        roles = Roles.of(factors, [factor_name(self.unit), factor_name(self.period)])
        treatments = roles.allowed_treatments("Crossover", is_allowed)
        units, periods = roles.blocks
        sequences = williams_sequences(len(treatments))
        _refuse_numbers(roles, len(treatments), len(sequences))
        drawn = seed if shuffle else None
        labels = shuffled(treatments, drawn, "treatments")
        per_unit = [
            [labels[each] for each in sequence]
            for turn in range(len(units.treatments) // len(sequences))
            for sequence in shuffled(sequences, drawn, "sequences", turn)
        ]
        runs = [
            (roles.combined((units, unit), (periods, period), treatment), repetition, number)
            for number, (unit, sequence) in enumerate(zip(units.treatments, per_unit, strict=True), start=1)
            for period, treatment in zip(periods.treatments, sequence, strict=True)
            for repetition in range(1, repetitions + 1)
        ]
        texts = [[texts_of_combination(each) for each in sequence] for sequence in per_unit]
        held = HeldOrder(one_by_one=units.name, rest_between=periods.name, rest_in_s=self.washout_in_s)
        follows = len(units.treatments) // len(treatments)
        return DesignedRuns.in_order(
            runs,
            {
                **self.as_mapping(),
                "subject": units.name,
                "washout": bool(self.washout_in_s),
                "sequences": dict(zip(units.texts, texts, strict=True)),
                "follows": follows,
                "repetitions_in_place": True,
                "grows_by": f"units: treatments of {units.name}",
                HELD_ORDER: held.as_mapping(),
                "block_columns": [units.name, periods.name],
                "notes": [f"each treatment follows each other one in {counted(follows, 'unit')}"],
                "layout": [
                    {
                        "title": "Sequences",
                        "heading": [f"{units.name} \\ {periods.name}", *periods.texts],
                        "rows": [[text, *sequence] for text, sequence in zip(units.texts, texts, strict=True)],
                    }
                ],
            },
        )


def _refuse_numbers(roles: Roles, treatments: int, sequences: int) -> None:
    units, periods = (len(factor.treatments) for factor in roles.blocks)
    what = " x ".join(factor.name for factor in roles.studied)
    if treatments < 2:  # noqa: PLR2004
        raise refused("Crossover", f"{what} has one combination: nothing is compared", "Give it another treatment.")
    if periods != treatments:
        problem = f"{what} has {treatments} combinations, and {roles.blocks[1].name} has {periods} periods"
        raise refused("Crossover", problem, f"Have {treatments} periods: each unit gets each treatment once.")
    if units % sequences:
        below, above = units // sequences * sequences, (units // sequences + 1) * sequences
        problem = (
            f"{roles.blocks[0].name} has {units} units, and {treatments} treatments take {sequences} sequences, "
            "each as often, to balance what follows what"
        )
        raise refused("Crossover", problem, f"Have {f'{below} or ' if below else ''}{above} units.")
