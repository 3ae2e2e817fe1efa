"""Adding runs to an experiment that has begun: a batch with a seed of its own, in the journal and in the run table.

What was executed is not touched. Once there is a batch, the journal, and no longer the config, says what is planned.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from secrets import randbits
from types import MappingProxyType
from typing import Any

from robot_runner.cli.excluding import refuse_without_journal, told_as_recorded
from robot_runner.core.config.experiment import Experiment
from robot_runner.core.config.plugin_checks import check_treatments
from robot_runner.core.design.asking import AdaptiveDesign, decides_order
from robot_runner.core.design.batch import Batch
from robot_runner.core.design.batches import (
    EXTENDED,
    GrownRunTableModel,
    as_configured,
    described_design,
    first_batch,
    next_batch,
    records_of,
)
from robot_runner.core.design.columns import WARM_UP
from robot_runner.core.design.design import Design
from robot_runner.core.design.extended_design import Additions, Begun, ExtendedDesign, copies_in, extended_design
from robot_runner.core.design.factor import Combination, Factor
from robot_runner.core.design.planned_runs import PlannedRun, RunOrder
from robot_runner.core.design.run_table_model import RunTableModel
from robot_runner.core.errors import DesignError, ExecutionError, Finding
from robot_runner.core.execution.before_first_run import shown_config, unplanned_additions
from robot_runner.core.execution.given_values import accept_given
from robot_runner.core.execution.manifest_content import keep_config_files, kept_manifest, restored_manifest
from robot_runner.core.execution.recovered_table import RecoveredTable
from robot_runner.core.execution.resumption import ACCEPT, Resumption, TableDisagreementError, config_changes
from robot_runner.core.execution.table_recovery import recover_table
from robot_runner.core.storage.guarded_files import sha256_of
from robot_runner.core.storage.journal import Journal, read_journal, utc_now
from robot_runner.core.storage.lock import ExperimentLock
from robot_runner.core.storage.manifest import write_manifest
from robot_runner.core.storage.run_table_reading import read_run_table
from robot_runner.core.storage.run_table_rows import RunTableRows, write_run_table
from robot_runner.core.storage.table_columns import FactorColumn
from robot_runner.core.words import counted


@dataclass(frozen=True, slots=True, kw_only=True)
class ExtensionRequest:
    """The additions that the user requests.

    Attributes:
        added: what is added beyond what the config has.
        seed: of the order of the new runs; None draws one.
        as_written: whether the new runs keep the order of the config instead of being randomised.
        accept_changes: go on though the config differs in more than its design, or the run table from the plan.
        dry_run: find out what would be added, and write nothing.
    """

    added: Additions
    seed: int | None = None
    as_written: bool = False
    accept_changes: bool = False
    dry_run: bool = False


@dataclass(frozen=True, slots=True)
class Extension:
    """The new batch, the design with it, its runs in the order of execution, and warnings."""

    batch: Batch
    model: GrownRunTableModel
    runs: Sequence[PlannedRun]
    findings: tuple[Finding, ...]


def extend_experiment(experiment: Experiment, request: ExtensionRequest) -> Extension:
    """Add runs to an experiment that has begun; they are executed when the experiment is executed next.

    Raises:
        ExecutionError: it has not begun, is being executed, has nothing to add, or its config or run table was changed.
        DesignError: something cannot be added; `findings` lists everything that was found.
        StorageError: something cannot be read or written.
    """
    if experiment.folder.manifest.exists():
        refuse_without_journal(experiment.folder)
    if not any(read_journal(experiment.folder.journal, kinds={"experiment_started"})):
        problem = "the experiment has not begun: there is nothing to add to"
        fix = f"Change the config, and execute it: robot-runner {shown_config(experiment.config_path)}"
        raise ExecutionError(problem, where=str(experiment.folder.root), fix=fix)
    if isinstance(as_configured(experiment.model).design, AdaptiveDesign):
        problem = "the design decides on the runs from their results: nothing is added by hand"
        config = shown_config(experiment.config_path)
        fix = f"Give it more runs in the config, and go on: robot-runner {config} {ACCEPT}"
        raise ExecutionError(problem, where=str(experiment.folder.root), fix=fix)
    with ExperimentLock(experiment.folder.lock):
        return _Extending(experiment, request).extension()


class _Extending:
    """One extension; the experiment's folder is locked while it lasts."""

    def __init__(self, experiment: Experiment, request: ExtensionRequest) -> None:
        self._experiment = experiment
        self._request = request
        self._folder = experiment.folder
        restored = restored_manifest(experiment)
        self._manifest = restored[0] if restored else kept_manifest(experiment)
        self._findings = [restored[1]] if restored else []
        self._design: Mapping[str, Any] = self._manifest["design"]
        self._config = as_configured(experiment.model)

    def extension(self) -> Extension:
        if not self._request.accept_changes:
            ExecutionError.refuse(config_changes(self._experiment, of_design=False, of_settings=False))
        recovered = self._recovered()
        begun = self._begun(recovered.rows)
        design = extended_design(begun, self._config, self._request.added)
        batches = self._experiment.model.batches or (first_batch(begun, self._first_order()),)
        seed = self._request.seed if self._request.seed is not None else randbits(32)
        order = RunOrder(shuffle=not self._request.as_written, blocks=self._config.blocks, seed=seed)
        wanted = None
        if is_in_order := decides_order(self._config.design):
            self._refuse_order(batches[0].order)
            wanted = runs_of_extended_design(begun, self._config, design, batches[0].order)
            order = RunOrder(seed=batches[0].order.seed)  # of what is in order already
        number = len(batches) + 1
        batch = next_batch(begun, design, self._config.warm_up, order=order, number=number, at=utc_now(), wanted=wanted)
        if is_in_order:
            batch = replace(batch, order=replace(batch.order, shuffle=batches[0].order.shuffle))
        if not batch.runs:
            raise self._nothing_to_add(begun)
        model = GrownRunTableModel(self._config, [*batches, batch])
        grown = replace(self._experiment, model=model)
        runs = [run for run in model.plan() if run.batch == batch.number]
        was = recovered.rows.layout
        layout = replace(grown.table_layout(was.types), extras=was.extras, has_exclusions=was.has_exclusions)
        self._refuse_unfit(runs)
        if not self._request.dry_run:
            recovered.rows = recovered.rows.with_plan(model.plan(), layout)
            self._write(recovered, model)
        return Extension(batch, model, runs, (*self._findings, *recovered.findings))

    def _refuse_order(self, first: RunOrder) -> None:
        """Refuse another order than that of a design that puts its runs in order itself.

        Raises:
            DesignError: another order is asked for.
        """
        asked = self._request
        if asked.seed not in {None, first.seed} or (asked.as_written and first.shuffle):
            how = f"randomised from the first seed, {first.seed}" if first.shuffle else "as written"
            problem = f"the design puts the new runs in order itself: {how}"
            raise DesignError(problem, where="--as-written" if asked.as_written else "--seed", fix="Leave it out.")

    def _recovered(self) -> RecoveredTable:
        """Return the run table as it is before anything is added, compared with the journal."""
        resumption = Resumption(accept_changes=self._request.accept_changes)
        try:
            recovered = recover_table(self._as_executed(), self._manifest, resumption)
        except TableDisagreementError as error:
            raise TableDisagreementError.of_findings([*error.findings, self._settle()]) from error
        if recovered.deviations:
            raise TableDisagreementError.of_findings([self._settle()])
        return recovered

    def _settle(self) -> Finding:
        problem = "the run table and the journal disagree, and an extension changes nothing of that"
        command = f"robot-runner {shown_config(self._experiment.config_path)} --table journal (or file)"
        return Finding.error(str(self._folder.run_table), problem, f"Settle it before: {command}")

    def _as_executed(self) -> Experiment:
        """Return the experiment with the design that it was executed with, where the config has another one now.

        Raises:
            ExecutionError: it cannot be found out any more which runs were planned.
        """
        experiment = self._experiment
        has_changed = unplanned_additions(experiment.config_path, experiment.model, self._manifest) or config_changes(
            experiment, of_settings=False
        )
        if experiment.model.batches or self._is_by_hand or not has_changed:
            return experiment
        path = self._folder.run_table
        written = [each.get("sha256") for each in read_journal(self._folder.journal, kinds={"table_written"})]
        if not path.exists():
            problem = "the run table is missing and the design has changed: nothing tells which runs were planned"
            fix = "Restore the run table. Or undo the change, and execute the experiment: the table is rebuilt."
            raise ExecutionError(problem, where=str(path), fix=fix)
        if sha256_of(path) != written[-1] and not self._request.accept_changes:
            problem = "both the config's design and the run table were changed: nothing tells which runs were planned"
            fix = f"Undo one of them, or let the table count ({ACCEPT})."
            raise ExecutionError(problem, where=str(path), fix=fix)
        own = {factor.name: factor for factor in self._config.factors}
        columns = tuple(FactorColumn(name, own.get(name)) for name in self._design["factors"])
        layout = replace(
            experiment.table_layout(),
            factors=columns,
            has_repetition=int(self._design["repetitions"]) > 1,
            marks=(WARM_UP,) if self._design.get("warm_up") else (),
        )
        begun = self._begun(read_run_table(path, layout))
        return replace(experiment, model=GrownRunTableModel(self._config, [first_batch(begun, self._first_order())]))

    @property
    def _is_by_hand(self) -> bool:
        return bool(self._design.get("source") != "config")

    def _first_order(self) -> RunOrder:
        seed, shuffle = int(self._manifest["seed"]), bool(self._design.get("shuffle"))
        return RunOrder(shuffle=shuffle, blocks=self._design.get("blocks"), seed=seed, seed_is_given=True)

    def _begun(self, rows: RunTableRows) -> Begun:
        runs = list(rows.planned)
        model = self._experiment.model
        return Begun(
            factors=tuple(self._factor_there(column, runs) for column in rows.layout.factors),
            runs=runs,
            chosen=model.chosen if isinstance(model, GrownRunTableModel) else MappingProxyType({}),
            has_repetition=rows.layout.has_repetition,
            is_by_hand=self._is_by_hand,
            copies=copies_in(() if self._is_by_hand or self._config.is_full_factorial else self._config.plan()),
        )

    def _factor_there(self, column: FactorColumn, runs: Sequence[PlannedRun]) -> Factor:
        """Return a factor with the treatments that it has had so far, including those of a changed table."""
        there = {str(run.combination[column.name]): run.combination[column.name] for run in runs}
        own = dict(zip(column.factor.texts, column.factor.treatments, strict=True)) if column.factor else {}
        recorded = {*self._design["factors"].get(column.name, ()), *there}
        listed = {**{text: own[text] for text in own if text in recorded}, **there}.values()
        return column.factor.with_treatments(listed) if column.factor else Factor(column.name, listed)

    def _nothing_to_add(self, begun: Begun) -> ExecutionError:
        there = counted(begun.repetitions, "repetition")
        problem = f"there is nothing to add: the run table has {there} of each combination that the config plans"
        fix = f"Ask for more, such as --repetitions {begun.repetitions + 1}, or change create_run_table."
        return ExecutionError(problem, where=str(self._folder.run_table), fix=fix)

    def _refuse_unfit(self, runs: Sequence[PlannedRun]) -> None:
        experiment = self._experiment
        combinations = [run.combination for run in runs]
        found = check_treatments(experiment.plugins, self._config, experiment.parameters.robot, combinations)
        self._findings += [finding for finding in found if not finding.is_error]
        ExecutionError.refuse(finding for finding in found if finding.is_error)

    def _write(self, recovered: RecoveredTable, model: GrownRunTableModel) -> None:
        """Write everything; if this is interrupted, the journal's record counts."""
        *_, fields = records_of(model.batches)
        keep_config_files(self._experiment)
        with Journal(self._folder.journal) as journal:
            journal.append(EXTENDED, flush=True, **fields)
            with told_as_recorded("the extension"):
                self._write_files(journal, recovered, model)

    def _write_files(self, journal: Journal, recovered: RecoveredTable, model: GrownRunTableModel) -> None:
        journal.append("table_written", sha256=write_run_table(self._folder.run_table, recovered.rows))
        recovered.write_schema(self._folder.schema)
        self._manifest["design"] |= described_design(model)
        if self._request.accept_changes:
            accept_given(self._experiment, self._manifest)
        write_manifest(self._folder.manifest, self._manifest)


def runs_of_extended_design(
    begun: Begun, config: RunTableModel, design: ExtendedDesign, order: RunOrder
) -> list[tuple[Combination, int]]:
    """Return the runs that the design plans beyond the existing ones, in the design's order, made from its first seed.

    Raises:
        DesignError: there is no such design for so many runs, or it would not contain the existing ones.
    """
    if not isinstance(config.design, Design):
        return []
    allowed = config.allowed_of(design.factors)
    planned = config.design.runs(design.factors, allowed, design.repetitions, order.seed, order.shuffle)
    wanted, there = design.repetitions_of(planned.runs), design.repetitions_of(begun.counted_runs)
    fits = all(numbers <= wanted[texts] for texts, numbers in there.items())
    in_place = planned.facts.get("repetitions_in_place") and design.repetitions > begun.repetitions
    if in_place or not fits:
        grows = planned.facts.get("grows_by", "repetitions")
        problem = "with the additions, the existing runs would not be part of the design"
        raise DesignError(problem, where="design", fix=f"Add {grows}, or begin another experiment.")
    return [
        (run.combination, run.repetition)
        for run in planned.runs
        if run.repetition not in there[design.texts_of(run.combination)]
    ]
