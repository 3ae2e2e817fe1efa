"""The run-table model (factors, repetitions, order), and the run table that is made from it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from types import MappingProxyType
from typing import Any, Final, overload

from robot_runner.core.design.batch import Batch
from robot_runner.core.design.columns import REPETITION, NamedColumn
from robot_runner.core.design.design import (
    ChosenCombinations,
    CombinationDesign,
    Design,
    DesignedRuns,
    FullFactorial,
    extended_choice,
)
from robot_runner.core.design.design_findings import design_findings, order_findings, size_findings
from robot_runner.core.design.exclusions import Allowed, Exclusion, Exclusions, apply_exclusions
from robot_runner.core.design.factor import Combination, Factor
from robot_runner.core.design.full_factorial import full_factorial
from robot_runner.core.design.planned_runs import PlannedRun, RunOrder, garbage_collection_paused, planned_runs
from robot_runner.core.design.warm_up import WarmUp, warm_up_of, with_warm_ups
from robot_runner.core.errors import DesignError, Finding


class RunTable(Sequence[PlannedRun]):
    """All runs of an experiment in the order of execution. Immutable.

    Example:
        >>> table = RunTableModel([Factor("Task", ["Video", "Network"])], repetitions=2).plan()
        >>> [(run.run_id, run.combination["Task"], run.repetition) for run in table]
        [('r_1', 'Video', 1), ('r_2', 'Network', 1), ('r_3', 'Video', 2), ('r_4', 'Network', 2)]
    """

    def __init__(self, model: RunTableModel, runs: Iterable[PlannedRun], order: RunOrder) -> None:
        self.model = model
        self.order = order
        self._runs = tuple(runs)

    def __len__(self) -> int:
        return len(self._runs)

    @overload
    def __getitem__(self, place: int) -> PlannedRun: ...

    @overload
    def __getitem__(self, place: slice) -> Sequence[PlannedRun]: ...

    def __getitem__(self, place: int | slice) -> PlannedRun | Sequence[PlannedRun]:
        return self._runs[place]

    def __iter__(self) -> Iterator[PlannedRun]:
        return iter(self._runs)

    def __repr__(self) -> str:
        return f"<RunTable: {len(self)} runs, seed {self.order.seed}>"

    @property
    def seed(self) -> int:
        """The seed of its order."""
        return self.order.seed


class RunTableModel:
    """The plan of all runs: the combinations that a design chooses, each of them repeated, in some order.

    Without a `design` it is the full factorial without the exclusions. Runs are in the order as written (the first
    factor changes slowest; all combinations once, then all again), or randomised with `shuffle`. `blocks` keeps runs
    together: `"Repetition"` makes a block of each repetition of all combinations, the name of a factor makes one of
    each of its treatments. Blocks stay in the order as written; `shuffle` randomises within them.

    Attributes:
        factors: what is varied.
        design: chooses the combinations, or the runs with their blocks and order.
        design_facts: see `DesignedRuns.facts`.
        repetitions: how often each combination is executed; from two on the table has a column `Repetition`.
        data_columns: the measures with columns in the run table, by name, or as a `Measure` for the config's own; None
            for all measures of all plugins.
        warm_up: how the experiment warms up; None where it does not.
        seed_is_registered: whether the seed is that of the study's registration.
        batches: of an experiment that was extended; empty for others.
        defaults: for each factor that was added later, the treatment that is assumed for earlier runs.
        warnings: findings that do not refuse the design, as on exclusions that remove nothing.

    Example:
        >>> from robot_runner import Factor
        >>> model = RunTableModel(
        ...     [Factor("Task", ["Computation", "Video", "Network"]), Factor("Speed", [0.1, 0.2])],
        ...     exclude_combinations=[{"Task": "Network", "Speed": 0.2}],
        ...     repetitions=3,
        ...     data_columns=["Energy"],
        ... )
        >>> len(model.plan())
        15
    """

    warm_up: WarmUp | None = None
    seed_is_registered: bool = False
    batches: tuple[Batch, ...] = ()
    design: Design | CombinationDesign = FullFactorial()
    design_facts: Mapping[str, Any] = MappingProxyType(FullFactorial().as_mapping())
    defaults: Mapping[str, Any] = MappingProxyType({})
    _too_large: Finding | None = None
    _listed_runs: tuple[PlannedRun, ...] | None = None

    def __init__(  # noqa: PLR0913 - all that there is to say of a plan, each with a default
        self,
        factors: Iterable[Factor],
        exclude_combinations: Sequence[Exclusion] = (),
        repetitions: int = 1,
        data_columns: Sequence[NamedColumn] | None = None,
        shuffle: bool = False,
        seed: int | None = None,
        blocks: str | Factor | None = None,
        warm_up: int | WarmUp | None = None,
        *,
        design: Design | CombinationDesign | None = None,
    ) -> None:
        """Check the whole design.

        Raises:
            DesignError: it is invalid; `findings` lists all problems.
        """
        # Anything but an iterable of factors stays as it is, for the checks to refuse it.
        is_listed = isinstance(factors, Iterable) and not isinstance(factors, str | bytes)
        listed: Any = tuple(factors) if is_listed else factors
        is_full = design is None or isinstance(design, FullFactorial)
        findings = list(design_findings(listed, repetitions, data_columns, shuffle, seed, blocks, warm_up, design))
        if any(finding.where.startswith("factors") for finding in findings):
            raise DesignError.of_findings(findings)  # without factors there is nothing to exclude from
        too_large = next(size_findings(listed, repetitions if isinstance(repetitions, int) else 1), None)
        exclusions = None if too_large or not is_full else _applied(listed, exclude_combinations)
        findings += exclusions.errors if exclusions else ()
        findings += () if is_full else DesignError.raised_by(Allowed, listed, exclude_combinations)
        if findings:
            raise DesignError.of_findings(findings) from (exclusions.cause if exclusions else None)
        self.factors: tuple[Factor, ...] = listed
        self.design = design or FullFactorial()
        self.repetitions: Final = repetitions
        self.data_columns: Final = None if data_columns is None else tuple(data_columns)
        self.warm_up = warm_up_of(warm_up)
        self.warnings: tuple[Finding, ...] = exclusions.warnings if exclusions else ()
        self._exclusions = exclude_combinations
        self._kept = exclusions.kept if exclusions else None
        self._order = _ordered(RunOrder(shuffle=shuffle), seed, blocks)
        self._planned: RunTable | None = None
        self._too_large = too_large if is_full else None
        if not is_full:
            self._choose()

    @property
    def shuffle(self) -> bool:
        """Whether the order is randomised."""
        return self._order.shuffle

    @property
    def seed(self) -> int:
        """The seed of a randomised order: given, or drawn when the model was made."""
        return self._order.seed

    @property
    def seed_is_given(self) -> bool:
        """Whether the user chose the seed."""
        return self._order.seed_is_given

    @property
    def blocks(self) -> str | None:
        """The column whose values are the blocks: `Repetition`, a factor, or None."""
        return self._order.blocks

    def _choose(self) -> None:
        """Let the design choose now, as it may also choose treatments, or find errors."""
        if isinstance(self.design, CombinationDesign):
            self.factors = tuple(self._chosen.factors or self.factors)
            self.warnings = self._chosen.warnings
        if not self.plan():
            problem = "the exclusions leave no run of the design"
            raise DesignError(problem, where="exclude_combinations", fix="Exclude fewer, or choose another design.")

    @property
    def is_full_factorial(self) -> bool:
        """Whether every combination that is not excluded is executed, in the model's order."""
        return isinstance(self.design, FullFactorial)

    def combinations_of(self, factors: Sequence[Factor]) -> list[Combination]:
        """Return the combinations of other factors that are not excluded, in order.

        A design other than the full factorial returns its earlier choice, and what it adds if it can grow.

        Raises:
            DesignError: an exclusion does not fit these factors, or the design cannot grow.
        """
        if not self.is_full_factorial:
            return extended_choice(self.design, self.plan(), self.factors, factors, self.allowed_of)
        exclusions = _applied(factors, self._exclusions)
        if exclusions is None:
            return full_factorial(factors)
        if exclusions.errors:
            raise DesignError.of_findings(exclusions.errors) from exclusions.cause
        return exclusions.kept

    def repeated(self, repetitions: int) -> RunTableModel:
        """Return the same plan with another number of repetitions, for planning a study.

        Raises:
            DesignError: the design does not allow so many.
        """
        return self.designed(self.design, repetitions=repetitions)

    def designed(
        self,
        design: Design | CombinationDesign,
        *,
        repetitions: int | None = None,
        more: Sequence[Factor] = (),
        blocks: str | None = None,
    ) -> RunTableModel:
        """Return a model with another design for the same factors and exclusions.

        Args:
            design: chooses the combinations, or the runs.
            repetitions: how often each combination is executed; None for as often as here.
            more: further factors of the design, such as whole plots; they come first.
            blocks: what makes blocks; None for the present ones, where the design leaves that open.

        Raises:
            DesignError: the design is impossible.
        """
        chosen = blocks or (self.blocks if isinstance(design, CombinationDesign) else None)
        count = self.repetitions if repetitions is None else repetitions
        return RunTableModel(
            (*more, *self.factors),
            self._exclusions,
            count,
            self.data_columns,
            self.shuffle,
            self.seed,
            chosen if chosen != REPETITION or count > 1 else None,
            design=design,
        )

    def create_experiment_run_table(self) -> RunTable:
        """Make the run table in the present order (the paper's call; returning the model itself does the same)."""
        return self.plan()

    def randomize_runs_order(self, seed: int | None = None, blocks: str | Factor | None = None) -> RunTable:
        """Randomise the order of the runs, within `blocks` where given, from `seed` or from one that is drawn.

        Raises:
            DesignError: the seed or the blocks are invalid.
        """
        DesignError.refuse(order_findings(seed, blocks, self.factors, self.repetitions))
        self._order = _ordered(replace(self._order, shuffle=True), seed, blocks)
        return self.plan()

    @property
    def is_extended(self) -> bool:
        """Whether runs were added to the experiment in batches of their own."""
        return len(self.batches) > 1

    @property
    def is_too_large(self) -> bool:
        """Whether the design has so many runs that only those of an existing table can be planned."""
        return self._too_large is not None

    def take_runs(self, runs: Iterable[PlannedRun]) -> None:
        """Take the runs of a table as the plan, in place of a full factorial that is too large."""
        self._listed_runs = tuple(runs)
        self._planned = None

    def take_order(self, order: RunOrder) -> None:
        """Take the order of a table that was planned from this model, as when a config returns `plan(seed=42)`."""
        self._order = order

    def take_seed(self, seed: int, *, is_registered: bool = False) -> None:
        """Take the seed of a registration, or of an experiment that is executed again.

        Args:
            seed: of the randomised order.
            is_registered: whether it is that of the registration.
        """
        self._order = replace(self._order, seed=seed)
        self.seed_is_registered = is_registered
        self._planned = None

    def plan(self, seed: int | None = None) -> RunTable:
        """Return the run table; the model does not change.

        Args:
            seed: replaces a seed that was drawn, so that an experiment goes on in its recorded order; not one that the
                user gave.

        Raises:
            DesignError: the design is too large, and no table lists its runs.
        """
        if self._too_large is not None and self._listed_runs is None:
            raise DesignError.of_findings([self._too_large])
        order = self._order
        if seed is not None and not self.seed_is_given:
            order = replace(order, seed=seed, seed_is_given=True)
        if self._planned is None or self._planned.order != order:
            with garbage_collection_paused():
                runs = self._listed_runs or self._arranged(order)
                self._planned = RunTable(self, runs, order)
        return self._planned

    def _arranged(self, order: RunOrder) -> Sequence[PlannedRun]:
        if isinstance(self.design, CombinationDesign):
            runs = planned_runs(self._chosen.combinations, self.repetitions, self._block_of(order.blocks), order)
            designed = DesignedRuns(runs, self._chosen.facts)
        else:
            designed = self.design.runs(self.factors, self.allowed, self.repetitions, order.seed, order.shuffle)
        self.design_facts = designed.facts
        return with_warm_ups(designed.runs, self.warm_up)

    @cached_property
    def _chosen(self) -> ChosenCombinations:
        """The design's choice; made at first use, as a table on disk needs none."""
        if not isinstance(self.design, CombinationDesign) or isinstance(self.design, FullFactorial):
            kept = full_factorial(self.factors) if self._kept is None else self._kept
            return ChosenCombinations(kept, self.design_facts)
        return self.design.choose(self.factors, self.allowed)

    @property
    def allowed(self) -> Allowed:
        """Decides whether a combination is not excluded."""
        return self.allowed_of(self.factors)

    def allowed_of(self, factors: Sequence[Factor]) -> Allowed:
        """Return the same as `allowed` for other factors.

        Raises:
            DesignError: an exclusion does not fit these factors.
        """
        return Allowed(factors, self._exclusions)

    def _block_of(self, blocks: str | None) -> list[int] | None:
        """Return the number of each run's block in the order as written, from 0 without gaps."""
        if blocks is None:
            return None
        if blocks == REPETITION and self.repetitions > 1:
            return [number for number in range(self.repetitions) for _ in self._chosen.combinations]
        factor = next(factor for factor in self.factors if factor.name == blocks)
        present = {id(combination[blocks]) for combination in self._chosen.combinations}  # the factor's own objects
        left = [id(treatment) for treatment in factor.treatments if id(treatment) in present]
        number_of = {treatment: number for number, treatment in enumerate(left)}
        return [number_of[id(combination[blocks])] for combination in self._chosen.combinations] * self.repetitions


def _applied(factors: Sequence[Factor], exclusions: Any) -> Exclusions | None:
    """Apply the exclusions; None if there are none."""
    if isinstance(exclusions, list | tuple) and not exclusions:
        return None
    with garbage_collection_paused():
        return apply_exclusions(factors, full_factorial(factors), exclusions)


def _ordered(order: RunOrder, seed: int | None, blocks: str | Factor | None) -> RunOrder:
    if seed is not None:
        order = replace(order, seed=seed, seed_is_given=True)
    if blocks is not None:
        order = replace(order, blocks=blocks.name if isinstance(blocks, Factor) else blocks)
    return order
