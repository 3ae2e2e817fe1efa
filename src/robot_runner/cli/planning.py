"""An experiment as it is named on the command line: by its folder, or by its config file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from robot_runner.cli.console import quiet_loading, shown_path
from robot_runner.cli.design_words import later_orders_in_words
from robot_runner.cli.parser import UsageError
from robot_runner.core.config.checks import create_model, read_parameters
from robot_runner.core.config.dialects import load_config
from robot_runner.core.config.experiment import experiment_folder, grown_model
from robot_runner.core.config.loader import parse_assignments
from robot_runner.core.config.plugin_checks import gather_plugins
from robot_runner.core.design.listed_runs import ListedRunTableModel
from robot_runner.core.errors import ConfigError, Finding, StorageError, did_you_mean
from robot_runner.core.events.measure import resolve_columns, with_phases
from robot_runner.core.execution.extension import unplanned_additions
from robot_runner.core.execution.table_recovery import is_reordered
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.manifest import read_manifest
from robot_runner.core.storage.run_table_reading import read_run_table
from robot_runner.core.storage.table_columns import TableLayout
from robot_runner.core.words import listed

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from robot_runner.core.config.loader import LoadedConfig
    from robot_runner.core.design.planned_runs import PlannedRun
    from robot_runner.core.design.run_table_model import RunTableModel
    from robot_runner.core.events.measure import MeasureColumns
    from robot_runner.core.storage.table_columns import TableSpelling

__all__ = ["Plan", "folder_of", "folder_of_target", "plan_of"]


# The run table that an experiment would be executed with: planned, or as it stands in its folder.


@dataclass(frozen=True, slots=True)
class Plan:
    """The runs of an experiment in the order in which they would be executed.

    Attributes:
        source: the run table on disk that it was read from, or None where it was planned from the config.
        seed: what a randomised order comes from; None where the table was made by hand.
        is_recorded: whether the seed is that of an experiment which has begun, so that executing it goes on in
            this order.
    """

    model: RunTableModel
    columns: MeasureColumns
    runs: Sequence[PlannedRun]
    source: Path | None
    seed: int | None
    is_recorded: bool
    findings: tuple[Finding, ...]

    @property
    def order(self) -> str:
        """How the runs were put in order."""
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
    if folder is not None and folder.run_table.exists():
        return _plan_on_disk(config, folder, model, columns, warnings, loaded.spelling)
    table = model.plan()
    return Plan(model, columns, table, None, table.seed, is_recorded=False, findings=warnings)


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
) -> Plan:
    try:
        manifest = read_manifest(folder.manifest)
    except StorageError:  # a table that was made by hand, before anything was executed
        manifest = {}
    layout = TableLayout.of_model(model, columns.names, spelling=spelling)
    if unplanned := unplanned_additions(config, model, manifest):
        told = (Finding.warning(each.where, each.problem, each.fix) for each in unplanned)
        table = model.plan(manifest["seed"])
        return Plan(model, columns, table, None, table.seed, is_recorded=False, findings=(*warnings, *told))
    if manifest.get("design", {}).get("source") == "config":
        table = model.plan(manifest["seed"])
        rows = read_run_table(folder.run_table, layout, table)
        if not is_reordered(table, rows):
            return Plan(model, columns, table, None, table.seed, is_recorded=True, findings=warnings)
        problem = "the rows were put into another order by hand: runs are executed in that order"
        warnings = (*warnings, Finding.warning(str(folder.run_table), problem))
    rows = read_run_table(folder.run_table, layout)
    runs = list(rows.planned)
    findings = (*warnings, *rows.warnings)
    return Plan(model, columns, runs, folder.run_table, None, is_recorded=False, findings=findings)


def folder_of_target(target: str, assignments: Sequence[str]) -> ExperimentFolder:
    """Return the folder of the experiment that is meant.

    Raises:
        UsageError: parameters are set for a folder, which takes none.
        ConfigError: the config file cannot be loaded, or does not say where its results are.
        StorageError: there is no such file or folder, or no experiment in it.
    """
    path = Path(target).expanduser()
    if path.is_dir():
        if assignments:
            raise UsageError("--set is for config files", where=target, fix="Leave it out, or name the config file.")
        return _in_folder(path)
    if not path.exists() and path.suffix != ".py":
        names = [each.name for each in path.parent.iterdir()] if path.parent.is_dir() else []
        fix = did_you_mean(path.name, names) if len(names) < _MOST_NAMES else "Name a folder that is there."
        raise StorageError("there is no such file or folder", where=target, fix=fix)
    return _of_config(path, assignments)


_MOST_NAMES = 20


def _in_folder(path: Path) -> ExperimentFolder:
    folder = ExperimentFolder.found_at(path.resolve())
    if folder.manifest.exists():
        return folder
    within = sorted(each.name for each in path.iterdir() if ExperimentFolder(each).manifest.exists())
    if within:
        names = listed(shown_path(path / name) for name in within)
        fix = f"Name the experiment's own folder: {names}."
    else:
        fix = "Name the folder that holds run_table.csv and manifest.json, or the config file."
    raise StorageError("there is no experiment here", where=str(path), fix=fix)


def _of_config(path: Path, assignments: Sequence[str]) -> ExperimentFolder:
    with quiet_loading():
        loaded = load_config(path, parse_assignments(assignments))
        folder = folder_of(loaded)
    if folder is None:
        raise ConfigError.of_findings(read_parameters(loaded)[1])
    if not folder.manifest.exists():
        raise StorageError(
            f"this experiment was never executed: there is nothing in {shown_path(folder.root)}",
            where=str(path),
            fix=f"Execute it: robot-runner {path}",
        )
    return folder
