"""An experiment, ready to be executed: what the config file says, checked and resolved."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from robot_runner.core.design.asking import DECIDED
from robot_runner.core.design.batches import EXTENDED, REPEATED, GrownRunTableModel, batches_of
from robot_runner.core.design.columns import WARM_UP
from robot_runner.core.events.manager import EventManager, OwnerKind
from robot_runner.core.events.measure import CONFIG_OWNER, MeasureColumns
from robot_runner.core.plugin import Plugin, System
from robot_runner.core.storage.journal import read_journal
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.table_columns import OWN_SPELLING, TableLayout, TableSpelling

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from robot_runner.core.config.loader import LoadedConfig
    from robot_runner.core.config.parameters import Parameters
    from robot_runner.core.design.run_table_model import RunTableModel
    from robot_runner.core.storage.input_files import InputFile
    from robot_runner.core.storage.registration import Registration


@dataclass(frozen=True, slots=True)
class Experiment:
    """One config, found to be well formed, with everything that executing it needs.

    Attributes:
        config_path: the config file, absolute.
        overrides: static parameters that were set from outside: deviations from the file.
        folder: where everything of this experiment is kept.
        columns: the measures that runs may yield, and which of them the run table has columns for.
        spelling: how the run table's file spells headings and statuses.
        replication: which package is executed again and what was changed on purpose, for the manifest; None where
            the experiment is nobody's replication.
        registration: what was registered before the first run; None where nothing was.
        inputs: the files that its plugins and robots read, as the config names them.
        kept: how much of the config's source the folder keeps: the `file`, the notebook's `cell` alone, or `nothing`.
    """

    config_path: Path
    class_name: str
    config: Any
    parameters: Parameters
    plugins: tuple[Plugin, ...]
    events: EventManager
    model: RunTableModel
    columns: MeasureColumns
    overrides: Mapping[str, str]
    local_modules: tuple[Path, ...]
    folder: ExperimentFolder
    spelling: TableSpelling = OWN_SPELLING
    replication: Mapping[str, Any] | None = None
    kept: str = "file"
    registration: Registration | None = None
    inputs: tuple[InputFile, ...] = ()

    def table_layout(self, types: Mapping[str, str] | None = None, *, warms_up: bool = False) -> TableLayout:
        """Return the columns of the run table.

        Args:
            types: those in its schema, where there is one already.
            warms_up: whether the table has warm-up runs though the config may have none any more.

        Raises:
            DesignError: a measure is called like a factor.
        """
        layout = TableLayout.of_model(self.model, self.columns.names, types, self.spelling)
        if warms_up and WARM_UP not in layout.marks:
            return replace(layout, marks=(*layout.marks, WARM_UP))
        return layout

    @property
    def systems(self) -> tuple[System, ...]:
        """The plugins that operate robots."""
        return tuple(plugin for plugin in self.plugins if isinstance(plugin, System))


def experiment_folder(parameters: Parameters, loaded: LoadedConfig) -> ExperimentFolder:
    """Return where everything of an experiment is kept; a relative results path begins where the config file is."""
    if loaded.folder is not None:
        return loaded.folder
    root = (loaded.source.path.parent / parameters.results_output_path.expanduser()).resolve()
    return ExperimentFolder(root / parameters.experiment_name)


def grown_model(model: RunTableModel, folder: ExperimentFolder) -> RunTableModel:
    """Return the design with the batches and repetitions that were added to the experiment, as its journal has them.

    Raises:
        StorageError: the journal cannot be read.
        DesignError: the config lacks a treatment that runs have.
    """
    if not folder.journal.exists():
        return model
    batches = batches_of(read_journal(folder.journal, kinds={EXTENDED, REPEATED, DECIDED}))
    return GrownRunTableModel(model, batches) if batches else model


def event_manager_for(loaded: LoadedConfig, plugins: tuple[Plugin, ...]) -> EventManager:
    """Subscribe plugins, then the config: its explicit subscriptions first, then its methods named like events.

    Raises:
        ConfigError: a callback's signature does not fit.
    """
    manager = EventManager()
    for plugin in plugins:
        kind = OwnerKind.SYSTEM if isinstance(plugin, System) else OwnerKind.PROFILER
        manager.subscribe_methods(plugin, owner=plugin.name, kind=kind)
    for request in loaded.subscriptions:
        manager.subscribe(request.event, request.callback, owner=CONFIG_OWNER, kind=OwnerKind.CONFIG)
    manager.subscribe_methods(loaded.config, owner=CONFIG_OWNER, kind=OwnerKind.CONFIG)
    return manager
