"""The run-table model (what an experiment varies, how often, and in which order), and the run table made from it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import replace
from functools import cached_property
from math import prod
from typing import TYPE_CHECKING, Any, Final, overload

from robot_runner.core.design.columns import REPETITION, column_name, name_findings
from robot_runner.core.design.exclusions import apply_exclusions
from robot_runner.core.design.factor import Factor, full_factorial
from robot_runner.core.design.planned_runs import PlannedRun, RunOrder, garbage_collection_paused, planned_runs
from robot_runner.core.errors import DesignError, Finding, did_you_mean

if TYPE_CHECKING:
    from collections.abc import Iterator

    from robot_runner.core.design.columns import NamedColumn
    from robot_runner.core.design.exclusions import Exclusion, Exclusions
    from robot_runner.core.design.factor import Combination

__all__ = ["MAX_RUNS", "RunTable", "RunTableModel", "design_findings", "listed_elsewhere", "order_findings"]


#: Whether the runs of a design that is too large are listed in a table.
_ARE_LISTED: ContextVar[bool] = ContextVar("_ARE_LISTED", default=False)


@contextmanager
def listed_elsewhere() -> Iterator[None]:
    """While this lasts, designs of too many runs are taken: a table lists those that are to be executed.

    See `RunTableModel.take_runs`. A config makes its model itself, so that nothing can be handed to it.
    """
    token = _ARE_LISTED.set(True)
    try:
        yield
    finally:
        _ARE_LISTED.reset(token)


# What keeps factors, repetitions, columns and order from making a design: each check lists all that it finds.

#: More runs than this are taken for a slip: at one second a run they would take four months.
MAX_RUNS = 10_000_000


def design_findings(
    factors: object, repetitions: object, data_columns: object, shuffle: object, seed: object, blocks: object
) -> Iterator[Finding]:
    """Say everything that is wrong with a design, its exclusions left aside.

    Args:
        factors: what is to be a sequence of factors.
        repetitions: what is to be how often each combination is executed.
        data_columns: what is to be the names of the measures' columns, or None.
        shuffle: what is to be whether the order is randomised.
        seed: what is to be the seed, or None.
        blocks: what is to be what runs are kept together by, or None.

    Yields:
        An error finding for each problem.
    """
    known = tuple(factor for factor in factors if isinstance(factor, Factor)) if isinstance(factors, Sequence) else ()
    repeated = repetitions if isinstance(repetitions, int) else 1
    yield from _factor_findings(factors)
    yield from _repetition_findings(repetitions, known)
    yield from _data_column_findings(data_columns, known, repeated)
    if not isinstance(shuffle, bool):
        problem = f"{shuffle!r} is of type {type(shuffle).__name__}"
        yield Finding.error("shuffle", problem, "Give True or False.")
    yield from order_findings(seed, blocks, known, repeated)
    if not _ARE_LISTED.get():
        yield from _size_findings(known, repeated)


def _factor_findings(factors: object) -> Iterator[Finding]:
    kind = type(factors).__name__
    if not isinstance(factors, Sequence):
        yield Finding.error("factors", f"{factors!r} is of type {kind}", "Give a list of Factor(...).")
        return
    if not factors:
        yield Finding.error("factors", "there are none", "Give at least one Factor(...).")
    seen: set[str] = set()
    for place, factor in enumerate(factors):
        if not isinstance(factor, Factor):
            problem = f"{factor!r} is of type {type(factor).__name__}"
            yield Finding.error(f"factors[{place}]", problem, "Give a Factor(name, treatments).")
        elif factor.name in seen:
            yield Finding.error(f"factors[{place}]", f"factor {factor.name!r} is given twice", "Rename or remove it.")
        else:
            seen.add(factor.name)


def _repetition_findings(repetitions: object, factors: Sequence[Factor]) -> Iterator[Finding]:
    if isinstance(repetitions, bool) or not isinstance(repetitions, int):
        problem = f"{repetitions!r} is of type {type(repetitions).__name__}"
        yield Finding.error("repetitions", problem, "Give a whole number from 1.")
    elif repetitions < 1:
        yield Finding.error("repetitions", f"{repetitions} is less than 1", "Give a whole number from 1.")
    else:
        for factor in factors:
            yield from name_findings(factor.name, kind="factor", repetitions=repetitions)


def _data_column_findings(columns: object, factors: Sequence[Factor], repetitions: int) -> Iterator[Finding]:
    if columns is None:
        return
    if not isinstance(columns, Sequence) or isinstance(columns, str | bytes):
        problem = f"{columns!r} is of type {type(columns).__name__}"
        yield Finding.error("data_columns", problem, "Give a list of names, or leave it out for all measures.")
        return
    names_of_factors = {factor.name for factor in factors}
    seen = set()
    for place, column in enumerate(columns):
        where = f"data_columns[{place}]"
        name = column_name(column)
        yield from name_findings(name, kind="data column", repetitions=repetitions)
        if not isinstance(name, str):
            continue
        if name in seen:
            yield Finding.error(where, f"column {name!r} is given twice", "Remove one.")
        if name in names_of_factors:
            yield Finding.error(where, f"{name!r} is the name of a factor", "Rename the factor or the measure.")
        seen.add(name)


def order_findings(seed: object, blocks: object, factors: Sequence[Factor], repetitions: int) -> Iterator[Finding]:
    """Say what is wrong with the seed and the blocks."""
    is_seed = seed is None or (isinstance(seed, int) and not isinstance(seed, bool) and seed >= 0)
    if not is_seed:  # random.Random takes -1 for 1, so that two seeds would give one order
        problem = f"{seed!r} is of type {type(seed).__name__}"
        yield Finding.error("seed", problem, "Give a whole number from 0, or leave it out.")
    if blocks is None:
        return
    known = [factor.name for factor in factors]
    if repetitions > 1:
        known.append(REPETITION)
    name = blocks.name if isinstance(blocks, Factor) else blocks
    if name not in known:
        yield Finding.error("blocks", f"there is nothing called {name!r} to make blocks of", _blocks_fix(name, known))


def _size_findings(factors: Sequence[Factor], repetitions: int) -> Iterator[Finding]:
    runs = prod(len(factor.treatments) for factor in factors) * repetitions
    if runs > MAX_RUNS:
        problem = f"the design has {runs:,} runs before exclusions; {MAX_RUNS:,} is the most"
        yield Finding.error("factors", problem, "Give fewer treatments or repetitions.")


def _blocks_fix(name: object, known: Iterable[str]) -> str:
    if name == REPETITION:
        return "Give repetitions=2 or more, or name a factor."
    return did_you_mean(str(name), known)


class RunTable(Sequence[PlannedRun]):
    """All runs of an experiment in the order of execution. Immutable.

    Attributes:
        model: the model that it was made from.
        order: how its runs were put in order, with the seed.

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
        """What its order comes from."""
        return self.order.seed


class RunTableModel:
    """The plan of all runs: the full factorial less the exclusions, each combination repeated, in some order.

    Runs are in the order as written (the first factor changes slowest; all combinations once, then all again),
    or randomised with `shuffle`. `blocks` keeps runs together: `"Repetition"` makes a block of each repetition of
    all combinations, the name of a factor makes one of each of its treatments. Blocks stay in the order as written;
    `shuffle` randomises within them.

    Attributes:
        factors: what is varied.
        repetitions: how often each combination is executed; from two on the table has a column `Repetition`.
        data_columns: the measures that the run table has columns for, by name, or as a `Measure` where it is the
            config's own; None stands for all measures of all plugins.
        warnings: findings that do not refuse the design, as on exclusions that remove nothing.

    Example:
        >>> model = RunTableModel(
        ...     [Factor("Task", ["Computation", "Video", "Network"]), Factor("Speed", [0.1, 0.2])],
        ...     exclude_combinations=[{"Task": "Network", "Speed": 0.2}],
        ...     repetitions=3,
        ...     data_columns=["Energy"],
        ... )
        >>> len(model.plan())
        15
    """

    def __init__(
        self,
        factors: Iterable[Factor],
        exclude_combinations: Sequence[Exclusion] = (),
        repetitions: int = 1,
        data_columns: Sequence[NamedColumn] | None = None,
        shuffle: bool = False,
        seed: int | None = None,
        blocks: str | Factor | None = None,
    ) -> None:
        """Check the whole design.

        Raises:
            DesignError: it cannot be; `findings` lists everything that was found.
        """
        listed = _as_tuple(factors)
        findings = list(design_findings(listed, repetitions, data_columns, shuffle, seed, blocks))
        if any(finding.where.startswith("factors") for finding in findings):
            raise DesignError.of_findings(findings)  # without factors there is nothing to exclude from
        too_large = next(_size_findings(listed, repetitions if isinstance(repetitions, int) else 1), None)
        exclusions = None if too_large else _applied(listed, exclude_combinations)
        findings += exclusions.errors if exclusions else ()
        if findings:
            raise DesignError.of_findings(findings) from (exclusions.cause if exclusions else None)
        self.factors: Final = listed
        self.repetitions: Final = repetitions
        self.data_columns: Final = None if data_columns is None else tuple(data_columns)
        self.warnings: Final[tuple[Finding, ...]] = exclusions.warnings if exclusions else ()
        self._kept = exclusions.kept if exclusions else None
        self._order = _ordered(RunOrder(shuffle=shuffle), seed, blocks)
        self._planned: RunTable | None = None
        self._too_large = too_large
        self._listed_runs: tuple[PlannedRun, ...] | None = None

    @property
    def shuffle(self) -> bool:
        """Whether the order is randomised."""
        return self._order.shuffle

    @property
    def seed(self) -> int:
        """What a randomised order comes from: given, or drawn when the model was made."""
        return self._order.seed

    @property
    def seed_is_given(self) -> bool:
        """Whether the user chose the seed."""
        return self._order.seed_is_given

    @property
    def blocks(self) -> str | None:
        """What runs are kept together by: `Repetition`, the name of a factor, or None."""
        return self._order.blocks

    def create_experiment_run_table(self) -> RunTable:
        """Make the run table in the present order (the paper's call; returning the model itself does the same)."""
        return self.plan()

    def randomize_runs_order(self, seed: int | None = None, blocks: str | Factor | None = None) -> RunTable:
        """Randomise the order of the runs, within `blocks` where given, from `seed` or from one that is drawn.

        Raises:
            DesignError: the seed or the blocks cannot be.
        """
        findings = list(order_findings(seed, blocks, self.factors, self.repetitions))
        if findings:
            raise DesignError.of_findings(findings)
        self._order = _ordered(replace(self._order, shuffle=True), seed, blocks)
        return self.plan()

    @property
    def is_too_large(self) -> bool:
        """Whether the design has so many runs that none but those of a table can be planned."""
        return self._too_large is not None

    def take_runs(self, runs: Iterable[PlannedRun]) -> None:
        """Take the runs of a table as the plan, in place of the full factorial, of which there may be too much."""
        self._listed_runs = tuple(runs)
        self._planned = None

    def take_seed(self, seed: int) -> None:
        """Take the seed of an experiment that is executed again, in place of the one that is given or was drawn."""
        self._order = replace(self._order, seed=seed)
        self._planned = None

    def plan(self, seed: int | None = None) -> RunTable:
        """Return the run table; the model does not change.

        Args:
            seed: takes the place of a seed that was drawn, so that an experiment goes on in its recorded order. A
                seed that the user gave stays.

        Raises:
            DesignError: the design is too large, and no table lists its runs.
        """
        if self._too_large is not None and self._listed_runs is None:
            raise DesignError.of_findings([self._too_large])
        order = self._order if seed is None or self.seed_is_given else replace(self._order, seed=seed)
        if self._planned is None or self._planned.order != order:
            with garbage_collection_paused():
                runs = self._listed_runs or self._arranged(order)
                self._planned = RunTable(self, runs, order)
        return self._planned

    def _arranged(self, order: RunOrder) -> Sequence[PlannedRun]:
        return planned_runs(self._combinations, self.repetitions, self._block_of(order.blocks), order)

    @cached_property
    def _combinations(self) -> list[Combination]:
        """The combinations that are executed; made when they are first asked for, as a table on disk needs none."""
        return full_factorial(self.factors) if self._kept is None else self._kept

    def _block_of(self, blocks: str | None) -> list[int] | None:
        """Return the number of each run's block in the order as written, from 0 without gaps."""
        if blocks is None:
            return None
        if blocks == REPETITION and self.repetitions > 1:
            return [number for number in range(self.repetitions) for _ in self._combinations]
        factor = next(factor for factor in self.factors if factor.name == blocks)
        present = {id(combination[blocks]) for combination in self._combinations}  # they hold the factor's own objects
        left = [id(treatment) for treatment in factor.treatments if id(treatment) in present]
        number_of = {treatment: number for number, treatment in enumerate(left)}
        return [number_of[id(combination[blocks])] for combination in self._combinations] * self.repetitions


def _as_tuple(factors: Any) -> Any:
    """Return the factors as a tuple, or what was given where the checks are to refuse it."""
    return tuple(factors) if isinstance(factors, Iterable) and not isinstance(factors, str | bytes) else factors


def _applied(factors: Sequence[Factor], exclusions: Any) -> Exclusions | None:
    """Apply what is to be excluded; None where that is nothing."""
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
