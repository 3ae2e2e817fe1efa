"""The split-plot design: factors that are hard to change keep their treatment for a whole plot of runs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from robot_runner.core.design.design import HELD_ORDER, DesignedRuns, HeldOrder, IsAllowed
from robot_runner.core.design.factor import Combination, Factor, factor_name
from robot_runner.core.errors import Finding
from robot_runner.core.words import counted
from robot_runner.designs.factor_roles import Roles, refused, role_findings, shuffled


@dataclass(frozen=True, slots=True)
class SplitPlot:
    """Keep factors that are hard to change, such as the floor, constant for a whole plot of runs.

    Each whole plot has all combinations of the other factors. Whole plots are executed one after another. With
    `shuffle`, they are in random order within each replicate (each combination of the hard factors once), and so are
    the runs within each whole plot. Repetitions are executed within the whole plot; the precision of the effects of
    hard factors depends on the number of whole plots.

    Attributes:
        hard: the factors that are hard to change.
        plot: the factor whose treatments are the whole plots, in order; their number must be a multiple of the number
            of combinations of the hard factors.

    Example:
        >>> from robot_runner import Factor, RunTableModel
        >>> factors = [Factor("Plot", [1, 2]), Factor("Floor", ["wood", "carpet"]), Factor("Speed", [0.1, 0.2])]
        >>> [run.combination["Floor"] for run in RunTableModel(factors, design=SplitPlot("Floor", "Plot")).plan()]
        ['wood', 'wood', 'carpet', 'carpet']
    """

    hard: str | Factor | list[str | Factor] | tuple[str | Factor, ...]
    plot: str | Factor

    @property
    def hard_names(self) -> list[Any]:
        """The names of the factors that are hard to change."""
        return [factor_name(each) for each in (self.hard if isinstance(self.hard, list | tuple) else [self.hard])]

    def findings(self, factors: Sequence[Factor]) -> Iterator[Finding]:
        """Yield findings on the factors."""
        if not self.hard_names:
            yield Finding.error("design: SplitPlot(hard=...)", "no factor is hard to change", "Name at least one.")
        named = [("plot", factor_name(self.plot)), *(("hard", name) for name in self.hard_names)]
        yield from role_findings("SplitPlot", named, factors)

    def as_mapping(self) -> Mapping[str, Any]:
        """Return its kind, the hard factors and the whole plots."""
        return {"kind": "split_plot", "hard": self.hard_names, "plot": factor_name(self.plot)}

    def runs(
        self, factors: Sequence[Factor], is_allowed: IsAllowed, repetitions: int, seed: int, shuffle: bool
    ) -> DesignedRuns:
        """Return the runs, whole plot by whole plot.

        Raises:
            DesignError: the number of whole plots is not a multiple of the combinations of the hard factors, or a
                combination is excluded in some whole plots only.
        """
        roles = Roles.of(factors, [factor_name(self.plot)])
        (plots,) = roles.blocks
        drawn = seed if shuffle else None
        by_hard = self._by_hard(roles.allowed_treatments("SplitPlot", is_allowed))
        replicates, rest = divmod(len(plots.treatments), len(by_hard))
        if rest:
            raise _uneven(self.hard_names, len(by_hard), plots)
        held = [
            each for number in range(replicates) for each in shuffled(by_hard.values(), drawn, "whole plots", number)
        ]
        runs = [
            (roles.combined((plots, plot), treatment), repetition, number)
            for number, (plot, treatments) in enumerate(zip(plots.treatments, held, strict=True), start=1)
            for repetition, treatment in shuffled(
                [(repetition, each) for repetition in range(1, repetitions + 1) for each in treatments],
                drawn, "runs", number,
            )
        ]  # fmt: skip
        return DesignedRuns.in_order(runs, self._facts(plots, held, repetitions, replicates))

    def _by_hard(self, treatments: Sequence[Combination]) -> dict[tuple[int, ...], list[Combination]]:
        """Return the combinations of the studied factors, grouped by those of the hard factors."""
        found: dict[tuple[int, ...], list[Combination]] = {}
        for treatment in treatments:
            found.setdefault(tuple(id(treatment[name]) for name in self.hard_names), []).append(treatment)
        return found

    def _facts(
        self, plots: Factor, held: Sequence[Sequence[Combination]], repetitions: int, replicates: int
    ) -> dict[str, Any]:
        texts = [[str(each[0][name]) for name in self.hard_names] for each in held]
        changes = sum(one != other for one, other in pairwise(texts))
        what = " x ".join(self.hard_names)
        notes = [f"{what} changes {counted(changes, 'time')} in {counted(len(texts), 'whole plot')}"]
        if replicates == 1:
            notes.append(
                f"each combination of {what} has one whole plot: nothing tells how whole plots vary, so that {what} "
                "cannot be tested"
            )
        return {
            **self.as_mapping(),
            "whole_plot": plots.name,
            "whole_plot_factors": self.hard_names,
            "changes": changes,
            "repetitions_in_place": True,
            "grows_by": f"whole plots: treatments of {plots.name}",
            HELD_ORDER: HeldOrder(one_after_another=plots.name).as_mapping(),
            "block_columns": [plots.name],
            "notes": notes,
            "layout": [
                {
                    "title": "Whole plots",
                    "heading": [plots.name, *self.hard_names, "runs"],
                    "rows": [
                        [plot, *text, str(len(treatments) * repetitions)]
                        for plot, text, treatments in zip(plots.texts, texts, held, strict=True)
                    ],
                }
            ],
        }


def _uneven(hard: Sequence[str], combinations: int, plots: Factor) -> Exception:
    count = len(plots.treatments)
    below, above = count // combinations * combinations, (count // combinations + 1) * combinations
    what = f"{combinations} combinations of {' x '.join(hard)}"
    problem = f"{plots.name} has {count} whole plots, no multiple of the {what}"
    return refused("SplitPlot", problem, f"Have {f'{below} or ' if below else ''}{above} whole plots.")
