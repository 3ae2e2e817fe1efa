"""An experiment as it is named on the command line: by its folder, or by its config file."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robot_runner.cli.console import quiet_loading, shown_path
from robot_runner.cli.design_words import later_orders_in_words
from robot_runner.cli.parser import UsageError
from robot_runner.core.config.checks import create_model, read_parameters
from robot_runner.core.config.dialects import load_config
from robot_runner.core.config.experiment import event_manager_for, experiment_folder, grown_model
from robot_runner.core.config.loader import parse_assignments
from robot_runner.core.config.plugin_checks import gather_plugins
from robot_runner.core.design.batches import as_configured
from robot_runner.core.design.listed_runs import ListedRunTableModel
from robot_runner.core.design.precision import rule_in_words
from robot_runner.core.errors import ConfigError, Finding, StorageError, did_you_mean
from robot_runner.core.events.measure import resolve_columns, with_phases
from robot_runner.core.execution.begun_experiment import unplanned_additions
from robot_runner.core.execution.deciding import asking_of, what_follows
from robot_runner.core.execution.durations import Estimate, durations_of
from robot_runner.core.execution.probe import probe_window_of, probed_plugins
from robot_runner.core.execution.table_recovery import is_reordered
from robot_runner.core.storage.cells import RunStatus
from robot_runner.core.storage.executed_runs import ExcludedRuns, executed_order, moved_in_words, moved_runs
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.manifest import read_manifest
from robot_runner.core.storage.run_table_reading import read_run_table
from robot_runner.core.storage.table_columns import TableLayout
from robot_runner.core.words import listed

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from robot_runner.core.config.loader import LoadedConfig
    from robot_runner.core.config.parameters import Parameters
    from robot_runner.core.design.planned_runs import PlannedRun
    from robot_runner.core.design.run_table_model import RunTableModel
    from robot_runner.core.events.measure import MeasureColumns
    from robot_runner.core.execution.durations import Durations
    from robot_runner.core.plugin import Plugin
    from robot_runner.core.storage.run_table_rows import RunTableRows
    from robot_runner.core.storage.table_columns import TableSpelling

# The run table that an experiment would be executed with: planned, or as it stands in its folder.


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
        excluded: why runs are left out, by id.
        repeated: until when combinations are repeated, how often at least and how often at most; empty where they
            are executed as often as is planned.
    """

    model: RunTableModel
    columns: MeasureColumns
    runs: Sequence[PlannedRun]
    source: Path | None
    seed: int | None
    is_recorded: bool
    findings: tuple[Finding, ...]
    durations: Durations | None = None
    duration: Estimate = field(default_factory=lambda: Estimate(None))
    executed: Sequence[str] = ()
    excluded: Mapping[str, str] = field(default_factory=dict)
    repeated: str = ""

    @property
    def order(self) -> str:
        """How the runs were put in order, and how many were executed out of it."""
        moved = moved_in_words(moved_runs([run.run_id for run in self.runs], self.executed), self.executed)
        return f"{self._order_of_table}; {moved}" if moved else self._order_of_table

    @property
    def _order_of_table(self) -> str:
        if self.source is not None:
            return f"as in {shown_path(self.source)}"
        return "; ".join([self._order_of_first, *later_orders_in_words(self.model)])

    @property
    def _order_of_first(self) -> str:
        blocks = self.model.blocks
        if not self.model.shuffle:
            return f"as written, in blocks of {blocks}" if blocks else "as written"
        return f"randomised{f' within blocks of {blocks}' if blocks else ''} from seed {self.seed}"

    @property
    def how_to_repeat(self) -> str:
        """What makes the same order again."""
        if self.source is not None or not (self.model.shuffle or self.model.batches):
            return ""
        if self.is_recorded:
            return "the experiment has begun: executing it goes on in this order"
        if isinstance(self.model, ListedRunTableModel):
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
    folder = folder_of(loaded)
    if folder is not None:
        model = grown_model(model, folder)
    phases = parameters.phases if parameters is not None else ()
    columns, column_findings = resolve_columns(
        model.data_columns, {plugin.name: with_phases(plugin.measures, phases) for plugin in plugins}
    )
    refused = [finding for finding in column_findings if finding.is_error]
    if refused:
        raise ConfigError.of_findings(refused)
    warnings = (*loaded.findings, *findings, *column_findings)
    plan, rows = _planned(config, folder, model, columns, warnings, loaded.spelling)
    if parameters is None or folder is None:
        return plan
    return _with_duration(plan, rows, loaded, plugins, parameters, folder)


def _with_duration(
    plan: Plan,
    rows: RunTableRows | None,
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
        (
            run.combination
            for place, run in enumerate(plan.runs)
            if rows is None or (rows.status(place) is not RunStatus.DONE and rows.excluded(place) is None)
        ),
        follows=what_follows(asking_of(plan.model, rules), plan.runs),
    )
    plan = replace(plan, repeated=rule_in_words(rules, as_configured(plan.model).repetitions))
    window = probe_window_of(probed_plugins(plugins, events, parameters)) if parameters.probe else 0.0
    probed = window * max(1, len(parameters.robots))  # beside one robot after another
    estimate = durations.estimate(probe_s=probed)
    findings = (*plan.findings, *durations.knowledge.findings)
    return replace(plan, duration=estimate, durations=durations, findings=findings)


def _planned(
    config: Path,
    folder: ExperimentFolder | None,
    model: RunTableModel,
    columns: MeasureColumns,
    warnings: tuple[Finding, ...],
    spelling: TableSpelling,
) -> tuple[Plan, RunTableRows | None]:
    """Return the plan, and the rows on disk where there are any, in the same order."""
    if folder is not None and folder.run_table.exists():
        return _plan_on_disk(config, folder, model, columns, warnings, spelling)
    table = model.plan()
    return Plan(model, columns, table, None, table.seed, is_recorded=False, findings=warnings), None


def folder_of(loaded: LoadedConfig) -> ExperimentFolder | None:
    """Return the folder of the experiment, or None where the static parameters do not say."""
    parameters, _ = read_parameters(loaded)
    if parameters is None:
        return None
    return experiment_folder(parameters, loaded)


def _plan_on_disk(
    config: Path,
    folder: ExperimentFolder,
    model: RunTableModel,
    columns: MeasureColumns,
    warnings: tuple[Finding, ...],
    spelling: TableSpelling,
) -> tuple[Plan, RunTableRows | None]:
    try:
        manifest = read_manifest(folder.manifest)
    except StorageError:  # a table that was made by hand, before anything was executed
        manifest = {}
    if unplanned := unplanned_additions(config, model, manifest):
        found = (Finding.warning(each.where, each.problem, each.fix) for each in unplanned)
        table = model.plan(manifest["seed"])
        return Plan(model, columns, table, None, table.seed, is_recorded=False, findings=(*warnings, *found)), None
    known = ExcludedRuns.read(folder.journal)
    layout = replace(TableLayout.of_model(model, columns.names, spelling=spelling), has_exclusions=known.were_any)
    told: dict[str, Any] = {
        "executed": executed_order(folder.journal),
        "excluded": {run_id: each.reason for run_id, each in known.present.items()},
    }
    if manifest.get("design", {}).get("source") == "config":
        table = model.plan(manifest["seed"])
        rows = read_run_table(folder.run_table, layout, table)
        if not is_reordered(table, rows):
            planned = Plan(model, columns, table, None, table.seed, is_recorded=True, findings=warnings, **told)
            return planned, rows
        problem = "the rows were put into another order by hand: runs are executed in that order"
        warnings = (*warnings, Finding.warning(str(folder.run_table), problem))
    rows = read_run_table(folder.run_table, layout)
    runs = list(rows.planned)
    findings = (*warnings, *rows.warnings)
    return Plan(model, columns, runs, folder.run_table, None, is_recorded=False, findings=findings, **told), rows


def folder_of_target(target: str, assignments: Sequence[str], *, takes_older: bool = False) -> ExperimentFolder:
    """Return the folder of the experiment that is meant.

    Args:
        target: a folder or a config file.
        assignments: static parameters to set, as `name=value`.
        takes_older: whether a folder will do that another tool has filled, with a run table and no manifest.

    Raises:
        UsageError: parameters are set for a folder, which takes none.
        ConfigError: the config file cannot be loaded, or does not say where its results are.
        StorageError: there is no such file or folder, or no experiment in it.
    """
    path = Path(target).expanduser()
    if path.is_dir():
        if assignments:
            raise UsageError("--set is for config files", where=target, fix="Leave it out, or name the config file.")
        return _in_folder(path, takes_older=takes_older)
    if not path.exists() and path.suffix != ".py":
        names = [each.name for each in path.parent.iterdir()] if path.parent.is_dir() else []
        fix = did_you_mean(path.name, names) if len(names) < _MOST_NAMES else "Name a folder that is there."
        raise StorageError("there is no such file or folder", where=target, fix=fix)
    return _of_config(path, assignments, takes_older=takes_older)


_MOST_NAMES = 20


def _in_folder(path: Path, *, takes_older: bool) -> ExperimentFolder:
    folder = ExperimentFolder.found_at(path.resolve())
    if folder.manifest.exists() or (takes_older and _is_of_older_tool(folder)):
        return folder
    if _is_of_older_tool(folder):
        raise _older(folder)
    within = sorted(each.name for each in path.iterdir() if ExperimentFolder(each).manifest.exists())
    if len(within) == 1:  # a folder of results, such as `experiments`
        return ExperimentFolder.found_at(path.resolve() / within[0])
    if within:
        names = listed(shown_path(path / name) for name in within)
        fix = f"Name the experiment's own folder: {names}."
    else:
        fix = "Name the folder that holds run_table.csv and manifest.json, or the config file."
    raise StorageError("there is no experiment here", where=str(path), fix=fix)


def _is_of_older_tool(folder: ExperimentFolder) -> bool:
    """Return whether a folder has a run table with runs that were executed, and nothing of ours.

    Raises:
        StorageError: the run table cannot be read.
    """
    if folder.manifest.exists() or not folder.run_table.exists():
        return False
    rows = read_run_table(folder.run_table, TableLayout((), stamps=()))
    return len(rows) > rows.count(RunStatus.TODO)


def _older(folder: ExperimentFolder) -> StorageError:
    fix = "Go on with its config (robot-runner run), or adopt the results (robot-runner import)."
    return StorageError("another tool executed this experiment", where=shown_path(folder.root), fix=fix)


def _of_config(path: Path, assignments: Sequence[str], *, takes_older: bool) -> ExperimentFolder:
    with quiet_loading():
        loaded = load_config(path, parse_assignments(assignments))
        folder = folder_of(loaded)
    if folder is None:
        raise ConfigError.of_findings(read_parameters(loaded)[1])
    if _is_of_older_tool(folder) and not takes_older:
        raise _older(folder)
    if not folder.manifest.exists() and not _is_of_older_tool(folder):
        raise StorageError(
            f"this experiment was never executed: there is nothing in {shown_path(folder.root)}",
            where=str(path),
            fix=f"Execute it: robot-runner {path}",
        )
    return folder
