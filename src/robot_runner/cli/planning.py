"""The runs that an experiment would execute: planned from the config, or by the run table in the folder."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from robot_runner.cli.console import quiet_loading, shown_path
from robot_runner.cli.design_words import order_in_words
from robot_runner.core.config.checks import create_model, read_parameters
from robot_runner.core.config.dialects import load_config
from robot_runner.core.config.experiment import event_manager_for, experiment_folder, extended_model
from robot_runner.core.config.loader import LoadedConfig, parse_assignments
from robot_runner.core.config.parameters import Parameters
from robot_runner.core.config.plugin_checks import companions, gather_plugins
from robot_runner.core.config.preparation import measure_columns
from robot_runner.core.design.batches import as_configured
from robot_runner.core.design.listed_runs import ListedRunTableModel
from robot_runner.core.design.planned_runs import PlannedRun
from robot_runner.core.design.precision import rule_in_words
from robot_runner.core.design.run_table_model import RunTableModel
from robot_runner.core.errors import ConfigError, Finding, StorageError
from robot_runner.core.events.measure import MeasureColumns
from robot_runner.core.execution.before_first_run import unplanned_additions
from robot_runner.core.execution.deciding import asking_of, what_follows
from robot_runner.core.execution.durations import Durations, Estimate, durations_of
from robot_runner.core.execution.experiment_history import ExperimentHistory
from robot_runner.core.execution.probe import probe_window_of, probed_plugins
from robot_runner.core.execution.recovered_table import lacks_runs
from robot_runner.core.execution.resumption import table_differences
from robot_runner.core.execution.table_deviations import is_reordered
from robot_runner.core.plugin import Plugin
from robot_runner.core.storage.executed_runs import moved_in_words, moved_runs
from robot_runner.core.storage.journal import read_journal
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.manifest import read_manifest
from robot_runner.core.storage.run_table_reading import read_run_table
from robot_runner.core.storage.table_columns import TableLayout, TableSpelling


@dataclass(frozen=True, slots=True)
class Plan:
    """The runs of an experiment in the order in which they would be executed.

    Attributes:
        source: the run table on disk that it was read from, or None where it was planned from the config.
        seed: what a randomised order comes from; None where the table was made by hand.
        is_recorded: whether the seed is that of an experiment which has begun, so that executing it goes on in
            this order.
        durations: what is known of how long runs take; None where that cannot be found out.
        duration: how long the runs take that are still to be executed.
        executed: the runs that were begun, in the order in which they were.
        repeated: until when combinations are repeated, how often at least and how often at most; empty where they
            are executed as often as is planned.
    """

    model: RunTableModel
    columns: MeasureColumns
    findings: tuple[Finding, ...]
    runs: Sequence[PlannedRun] = ()
    source: Path | None = None
    seed: int | None = None
    is_recorded: bool = False
    durations: Durations | None = None
    duration: Estimate = field(default_factory=lambda: Estimate(None))
    executed: Sequence[str] = ()
    excluded: Mapping[str, str] = field(default_factory=dict)
    repeated: str = ""

    @property
    def order(self) -> str:
        """How the runs were put in order, and how many were executed out of it."""
        moved = moved_in_words(moved_runs([run.run_id for run in self.runs], self.executed), self.executed)
        order = f"as in {shown_path(self.source)}" if self.source else order_in_words(self.model, self.seed)
        return f"{order}; {moved}" if moved else order

    @property
    def how_to_repeat(self) -> str:
        """How to make the same order again."""
        if self.source is not None or not (self.model.shuffle or self.model.batches):
            return ""
        if self.is_recorded:
            return "the experiment has begun: executing it goes on in this order"
        if isinstance(self.model, ListedRunTableModel) and not self.model.seed_is_given:
            return "another order is drawn each time until the experiment has begun: then it is recorded"
        if self.model.seed_is_registered:
            return "the registration has the seed: this order comes again each time"
        if self.model.seed_is_given:
            return "the config gives the seed: this order comes again each time"
        blocks = f", blocks={self.model.blocks!r}" if self.model.blocks else ""
        return (
            f"another seed is drawn each time; for this order write run_table.randomize_runs_order({self.seed}{blocks})"
        )


def plan_of(config: Path, overrides: Mapping[str, str]) -> Plan:
    """Return the run table that would be executed; nothing is executed, and nothing else is validated.

    Raises:
        ConfigError: the config cannot be loaded, or makes no run table.
        StorageError: a run table on disk cannot be read.
    """
    loaded = load_config(config, overrides)
    model, findings = create_model(loaded)
    if model is None:
        raise ConfigError.of_findings(findings)
    plugins, _ = gather_plugins(loaded, model)
    parameters, _ = read_parameters(loaded)
    folder = None
    if parameters is not None:
        folder = experiment_folder(parameters, loaded)
        model = extended_model(model, folder)
        plugins = (*companions(parameters, plugins)[0], *plugins)
    column_findings: list[Finding] = []
    columns = measure_columns(loaded, model, plugins, parameters, column_findings)
    ConfigError.refuse(finding for finding in column_findings if finding.is_error)
    warnings = (*loaded.findings, *findings, *column_findings)
    plan = Plan(model, columns, warnings)
    plan, settled = _with_runs(plan, config, folder, loaded.spelling)
    if parameters is None or folder is None:
        return plan
    return _with_duration(plan, settled, loaded, plugins, parameters, folder)


def _with_duration(
    plan: Plan,
    settled: Collection[str],
    loaded: LoadedConfig,
    plugins: tuple[Plugin, ...],
    parameters: Parameters,
    folder: ExperimentFolder,
) -> Plan:
    """Add how long the runs take that are still to be executed."""
    try:
        events = event_manager_for(loaded, plugins)
    except ConfigError as error:
        return replace(plan, duration=Estimate(None, unknown=(f"the config is refused: {error.problem}",)))
    combinations = [run.combination for run in plan.runs]
    durations = durations_of(loaded.config, plugins, events, parameters, combinations, folder.journal)
    rules = parameters.repeat_until
    durations.plan(
        (run.combination for run in plan.runs if run.run_id not in settled),
        follows=what_follows(asking_of(plan.model, rules), plan.runs),
    )
    plan = replace(plan, repeated=rule_in_words(rules, as_configured(plan.model).repetitions))
    window = probe_window_of(probed_plugins(plugins, events, parameters)) if parameters.probe else 0.0
    probed = window * max(1, len(parameters.robots))  # beside one robot after another
    estimate = durations.estimate(probe_s=probed)
    findings = (*plan.findings, *durations.declared.findings)
    return replace(plan, duration=estimate, durations=durations, findings=findings)


def _with_runs(
    plan: Plan, config: Path, folder: ExperimentFolder | None, spelling: TableSpelling
) -> tuple[Plan, Collection[str]]:
    """Return the plan with its runs, and those that are not executed any more: they are done, or excluded."""
    try:
        manifest = {} if folder is None else read_manifest(folder.manifest)
    except StorageError:  # nothing was executed: there is no table, or one that was made by hand
        manifest = {}
    if folder is not None and (folder.run_table.exists() or _is_of_config(manifest)):
        return _with_begun_runs(plan, config, folder, manifest, spelling)
    table = plan.model.plan()
    return replace(plan, runs=table, seed=table.seed), ()


def _is_of_config(manifest: Mapping[str, Any]) -> bool:
    return "seed" in manifest and bool(manifest.get("design", {}).get("source") == "config")


def _with_begun_runs(
    plan: Plan, config: Path, folder: ExperimentFolder, manifest: Mapping[str, Any], spelling: TableSpelling
) -> tuple[Plan, Collection[str]]:
    model, warnings = plan.model, plan.findings
    if unplanned := unplanned_additions(config, model, manifest):
        found = (Finding.warning(each.where, each.problem, each.fix) for each in unplanned)
        table = model.plan(manifest["seed"])
        return replace(plan, runs=table, seed=table.seed, findings=(*warnings, *found)), ()
    history = ExperimentHistory()
    for record in read_journal(folder.journal):
        history.take(record)
    known = history.exclusions
    layout = replace(TableLayout.of_model(model, plan.columns.names, spelling=spelling), has_exclusions=known.were_any)
    excluded = {run_id: each.reason for run_id, each in known.present.items()}
    plan = replace(plan, executed=history.executed, excluded=excluded)
    if _is_of_config(manifest):
        table = model.plan(manifest["seed"])
        planned = replace(plan, runs=table, seed=table.seed, is_recorded=True)
        if not folder.run_table.exists():
            history.read_table(folder)
            problem = "the run table is missing: it is rebuilt from the journal when the experiment is executed next"
            missing = Finding.warning(str(folder.run_table), problem)
            return replace(planned, findings=(*warnings, missing)), history.settled
        rows = read_run_table(folder.run_table, layout, table)
        history.take_rows(rows)
        if is_reordered(table, rows):
            problem = "the rows were put into another order by hand: runs are executed in that order"
            odd = Finding.warning(str(folder.run_table), problem)
        elif lacks_runs(table, rows):  # as where an extension was killed before it wrote the table
            return planned, history.settled
        elif differing := next(table_differences(folder.run_table, table, rows), None):
            odd = Finding.warning(differing.where, f"{differing.problem}: shown are the runs of the table")
        else:
            return planned, history.settled
        warnings = (*warnings, odd)
    rows = read_run_table(folder.run_table, layout)
    history.take_rows(rows)
    findings = (*warnings, *rows.warnings)
    return replace(plan, runs=list(rows.planned), source=folder.run_table, findings=findings), history.settled


def configured_folder(path: Path, assignments: Sequence[str]) -> ExperimentFolder:
    """Return the folder where a config file has its results, with parameters set by `name=value`.

    Raises:
        ConfigError: the config file cannot be loaded, or does not say where its results are.
    """
    with quiet_loading():
        loaded = load_config(path, parse_assignments(assignments))
        parameters, findings = read_parameters(loaded)
        if parameters is None:
            raise ConfigError.of_findings(findings)
        return experiment_folder(parameters, loaded)
