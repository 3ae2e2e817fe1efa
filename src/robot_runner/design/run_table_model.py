"""The run-table model: what an experiment varies, how often, and in which order."""

from __future__ import annotations

from array import array
from collections.abc import Iterable
from dataclasses import replace
from itertools import compress
from typing import TYPE_CHECKING, Any, Final

from robot_runner.design.checks import design_findings, order_findings
from robot_runner.design.combination import full_factorial
from robot_runner.design.exclusions import apply_exclusions
from robot_runner.design.factor import Factor
from robot_runner.design.order import RunOrder
from robot_runner.design.run_table import RunTable
from robot_runner.errors import DesignError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from robot_runner.design.exclusions import Exclusion
    from robot_runner.errors import Finding

__all__ = ["RunTableModel"]


class RunTableModel:
    """The plan of all runs: the full factorial less the exclusions, each combination repeated, in some order.

    Runs are in the order as written (the first factor changes slowest; all combinations once, then all again),
    or randomised with `shuffle`. `blocks` keeps runs together: `"Repetition"` makes a block of each repetition of
    all combinations, the name of a factor makes one of each of its treatments. Blocks stay in the order as written;
    `shuffle` randomises within them.

    Attributes:
        factors: what is varied.
        repetitions: how often each combination is executed; from two on the table has a column `Repetition`.
        data_columns: the measures that the run table has columns for; None stands for all measures of all plugins.
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
        data_columns: Sequence[str] | None = None,
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
        columns = full_factorial(listed)
        exclusions = apply_exclusions(listed, columns, exclude_combinations)
        findings += exclusions.errors
        if findings:
            raise DesignError.of_findings(findings) from exclusions.cause
        self.factors: Final = listed
        self.repetitions: Final = repetitions
        self.data_columns: Final = None if data_columns is None else tuple(data_columns)
        self.warnings: Final[tuple[Finding, ...]] = exclusions.warnings
        self._combinations = tuple(array(column.typecode, compress(column, exclusions.keep)) for column in columns)
        self._order = _ordered(RunOrder(shuffle=shuffle), seed, blocks)
        self._planned: RunTable | None = None

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

    def take_seed(self, seed: int) -> None:
        """Take the seed of an experiment that is executed again, in place of the one that is given or was drawn."""
        self._order = replace(self._order, seed=seed)
        self._planned = None

    def plan(self, seed: int | None = None) -> RunTable:
        """Return the run table; the model does not change.

        Args:
            seed: takes the place of a seed that was drawn, so that an experiment goes on in its recorded order. A
                seed that the user gave stays.
        """
        order = self._order if seed is None or self.seed_is_given else replace(self._order, seed=seed)
        if self._planned is None or self._planned.order != order:
            self._planned = RunTable(self, self._combinations, order)
        return self._planned


def _as_tuple(factors: Any) -> Any:
    """Return the factors as a tuple, or what was given where the checks are to refuse it."""
    return tuple(factors) if isinstance(factors, Iterable) and not isinstance(factors, str | bytes) else factors


def _ordered(order: RunOrder, seed: int | None, blocks: str | Factor | None) -> RunOrder:
    if seed is not None:
        order = replace(order, seed=seed, seed_is_given=True)
    if blocks is not None:
        order = replace(order, blocks=blocks.name if isinstance(blocks, Factor) else blocks)
    return order
