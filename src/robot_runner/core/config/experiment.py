"""An experiment that is ready to be executed, and how its parts are made from a loaded config."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from robot_runner.core.config.loader import LoadedConfig
from robot_runner.core.config.parameters import Parameters
from robot_runner.core.config.plugin_checks import with_each_treatment
from robot_runner.core.design.batches import GROWTH, GrownRunTableModel, batches_of
from robot_runner.core.design.columns import WARM_UP
from robot_runner.core.design.run_table_model import RunTableModel
from robot_runner.core.errors import ConfigError, Finding
from robot_runner.core.events.manager import EventManager, OwnerKind, methods_of, no_context, takes_a_context
from robot_runner.core.events.measure import CONFIG_OWNER, MeasureColumns
from robot_runner.core.links.connect import robot_input_files
from robot_runner.core.plugin import Plugin, System
from robot_runner.core.storage.input_files import InputFile
from robot_runner.core.storage.journal import read_journal
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.registration import Registration
from robot_runner.core.storage.table_columns import OWN_SPELLING, TableLayout, TableSpelling


@dataclass(frozen=True, slots=True)
class Experiment:
    """One config without errors, with everything that is needed to execute it.

    Attributes:
        config_path: the config file, absolute.
        overrides: static parameters that were set from outside: deviations from the file.
        folder: where everything of this experiment is kept.
        columns: the measures that runs may yield, and the columns of the run table among them.
        spelling: how the run table's file spells headings and statuses.
        replication: for the manifest, which package is executed again and what was changed on purpose; None where
            the experiment is not a replication.
        registration: what was registered before the first run, or None.
        inputs: the files that its plugins and robots read, as the config names them.
        kept: what the folder keeps of the config's source: the `file`, only the notebook's `cell`, or `nothing`.
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
    local_modules: Mapping[Path, Path]
    folder: ExperimentFolder
    spelling: TableSpelling = OWN_SPELLING
    replication: Mapping[str, Any] | None = None
    kept: str = "file"
    registration: Registration | None = None
    inputs: tuple[InputFile, ...] = ()

    def table_layout(self, types: Mapping[str, str] | None = None, *, warms_up: bool = False) -> TableLayout:
        """Return the columns of the run table.

        `types` are those in its schema, if there is one; with `warms_up` it has warm-up runs, also if the config has
        none any more.

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


#: How many characters of an invalid path a message shows.
_MOST_SHOWN = 80


def experiment_folder(parameters: Parameters, loaded: LoadedConfig) -> ExperimentFolder:
    """Return where everything of an experiment is kept; a relative results path begins where the config file is.

    Raises:
        ConfigError: there cannot be a folder.
    """
    if loaded.folder is not None:
        return loaded.folder
    path = parameters.results_output_path
    try:
        root = (loaded.source.path.parent / path.expanduser()).resolve()
        folder = ExperimentFolder(root / parameters.experiment_name)
        with suppress(FileNotFoundError, NotADirectoryError, PermissionError):  # to be made, or found elsewhere
            folder.run_table.stat()  # of a path that is too long, or leads through itself, the system cannot tell
    except (OSError, RuntimeError) as error:
        told = error.strerror if isinstance(error, OSError) else str(error).rstrip(".")
        shown = str(path) if len(str(path)) <= _MOST_SHOWN else f"{str(path)[:_MOST_SHOWN]}..."
        problem = f"no folder can lie at {shown!r}: {told}"
        fix = "Give the path of a folder, or of one that is to be made."
        raise ConfigError(problem, where=f"{loaded.where}.results_output_path", fix=fix) from error
    return folder


def extended_model(model: RunTableModel, folder: ExperimentFolder) -> RunTableModel:
    """Return the design with the batches and repetitions that were added to the experiment, by its journal.

    Raises:
        StorageError: the journal cannot be read.
        DesignError: the config lacks a treatment that runs have.
    """
    if not folder.journal.exists():
        return model
    batches = batches_of(read_journal(folder.journal, kinds=GROWTH))
    return GrownRunTableModel(model, batches) if batches else model


def event_manager_for(loaded: LoadedConfig, plugins: tuple[Plugin, ...]) -> EventManager:
    """Subscribe plugins, then the config: its explicit subscriptions first, then its methods named like events.

    Raises:
        ConfigError: callbacks, or a `make_safe`, cannot be called; with a finding for each.
    """
    manager = EventManager()
    findings: list[Finding] = []

    for plugin in plugins:
        is_system = isinstance(plugin, System)
        kind = OwnerKind.SYSTEM if is_system else OwnerKind.PROFILER
        for event, method in methods_of(plugin):
            findings += ConfigError.raised_by(manager.subscribe, event, method, owner=plugin.name, kind=kind)
        for name in ("make_safe", "stand_by") if is_system else ():
            findings += ConfigError.raised_by(_check_called_with_context, name, getattr(plugin, name), plugin.name)
    for event, callback in (*loaded.subscriptions, *methods_of(loaded.config)):
        own = {"owner": CONFIG_OWNER, "kind": OwnerKind.CONFIG}
        findings += ConfigError.raised_by(manager.subscribe, event, callback, **own)
    ConfigError.refuse(findings)
    return manager


def _check_called_with_context(name: str, method: Any, owner: str) -> None:
    """Check a method that is not an event's callback, such as `make_safe`, before a robot has to be stopped by it."""
    if not callable(method):
        fix = f"Write def {name}(self, context), or leave it out."
        raise ConfigError(f"{name} is {method!r}, which cannot be called", where=owner, fix=fix)
    if not takes_a_context(name, method, owner):
        raise no_context(name, method, owner)


_log = logging.getLogger(__name__)


def named_inputs(
    parameters: Parameters, plugins: Sequence[Plugin], model: RunTableModel | None, config: object = None
) -> tuple[InputFile, ...]:
    """Return the input files that plugins, robots and the config (by a method `input_files`) name, each once.

    One whose method raises is logged and left out.
    """
    found: dict[InputFile, None] = {}
    asked: list[tuple[str, Callable[[], Any]]] = [
        *((robot, partial(robot_input_files, robot)) for robot in parameters.links),
        *((f"plugin {plugin.name}", partial(_of_plugin, plugin, model)) for plugin in plugins),
    ]
    if callable(own := getattr(config, "input_files", None)):
        asked.append(("the config", own))
    for where, ask in asked:
        try:
            found |= dict.fromkeys(_inputs(ask()))
        except (Exception, SystemExit) as error:  # noqa: BLE001 - a stranger's code; an experiment is worth more than a copy
            _log.warning("%s: which files it reads is not known: %s", where, error)
    return tuple(found)


def _of_plugin(plugin: Plugin, model: RunTableModel | None) -> Iterator[InputFile]:
    for built in with_each_treatment(plugin, model):
        yield from _inputs(built.input_files())


def _inputs(named: Any) -> Iterator[InputFile]:
    """Yield the input files that a method has named: a path, or its text, stands for one, and one for a list."""
    for each in (named,) if isinstance(named, str | os.PathLike | InputFile) else named:
        yield each if isinstance(each, InputFile) else InputFile(Path(each))
