"""From a config file to an experiment, or to everything that stands in its way; nothing is touched."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

from robot_runner.config.checks.analysis import check_analysis
from robot_runner.config.checks.names import check_names
from robot_runner.config.checks.parameters import read_parameters
from robot_runner.config.checks.plugins import check_plugins, gather_plugins
from robot_runner.config.checks.results import check_disk_space, check_results_path
from robot_runner.config.checks.robot import check_robot, choose_robot
from robot_runner.config.checks.run_table import create_model
from robot_runner.config.checks.threads import check_threads
from robot_runner.config.experiment import Experiment, event_manager_for, experiment_folder
from robot_runner.config.loader import LoadedConfig, load_config
from robot_runner.errors import ConfigError, Finding
from robot_runner.events.columns import MeasureColumns, resolve_columns
from robot_runner.events.manager import EventManager

if TYPE_CHECKING:
    from collections.abc import Iterator

    from robot_runner.config.parameters import Parameters
    from robot_runner.design.run_table_model import RunTableModel
    from robot_runner.plugins.api.plugin import Plugin

__all__ = ["Loader", "Preparation", "prepare", "prepare_or_refuse"]

#: From a config file and what is set from outside to a config object; raises ConfigError.
Loader = Callable[[Path, Mapping[str, str]], LoadedConfig]


@dataclass(frozen=True, slots=True)
class Preparation:
    """What came of reading a config file.

    Attributes:
        experiment: ready to be executed, or None where a finding refuses it.
        findings: everything that was found, errors first.
    """

    experiment: Experiment | None
    findings: tuple[Finding, ...]


def prepare(
    path: Path,
    overrides: Mapping[str, str] = MappingProxyType({}),
    load: Loader = load_config,
    *,
    is_for_here: bool = True,
) -> Preparation:
    """Load and validate a config file; all findings at once, and nothing on disk is touched.

    Args:
        path: the config file.
        overrides: static parameters to set, by name.
        load: how the file becomes a config object.
        is_for_here: whether it is to be executed on this machine; if not, nobody asks what the machine has.
    """
    try:
        loaded = load(path, overrides)
    except ConfigError as error:
        return Preparation(None, error.findings)
    findings = [*loaded.findings, *check_names(loaded), *(choose_robot(loaded) if is_for_here else ())]
    parameters, parameter_findings = read_parameters(loaded)
    plugins, plugin_findings = gather_plugins(loaded)
    model, model_findings = create_model(loaded)
    findings += [*parameter_findings, *plugin_findings, *model_findings]
    events = _subscribe(loaded, plugins, findings)
    columns = _columns(model, plugins, findings)
    if parameters is not None:
        findings += [*check_analysis(parameters, model, columns), *check_threads(loaded, parameters)]
    if is_for_here:
        findings += _check_machine(loaded, parameters, plugins, model)
    ordered = tuple(sorted(findings, key=lambda finding: not finding.is_error))
    if any(finding.is_error for finding in ordered) or parameters is None or model is None:
        return Preparation(None, ordered)
    return Preparation(_experiment(loaded, parameters, plugins, events, model, columns), ordered)


def _check_machine(
    loaded: LoadedConfig, parameters: Parameters | None, plugins: tuple[Plugin, ...], model: RunTableModel | None
) -> Iterator[Finding]:
    yield from loaded.lacking
    yield from check_plugins(plugins, model, getattr(loaded.config, "robot", None))
    if parameters is not None:
        runs = len(model.plan()) if model is not None else 0
        yield from check_robot(loaded, parameters, plugins)
        yield from check_results_path(loaded, parameters)
        yield from check_disk_space(loaded, parameters, plugins, runs)


def prepare_or_refuse(
    path: Path, overrides: Mapping[str, str] = MappingProxyType({}), load: Loader = load_config
) -> Experiment:
    """Load and validate a config file, as `prepare` does.

    Raises:
        ConfigError: it is refused; carries every finding.
    """
    preparation = prepare(path, overrides, load)
    if preparation.experiment is None:
        raise ConfigError.of_findings(preparation.findings)
    return preparation.experiment


def _subscribe(loaded: LoadedConfig, plugins: tuple[Plugin, ...], findings: list[Finding]) -> EventManager:
    try:
        return event_manager_for(loaded, plugins)
    except ConfigError as error:
        findings += error.findings
        return EventManager()


def _columns(model: RunTableModel | None, plugins: tuple[Plugin, ...], findings: list[Finding]) -> MeasureColumns:
    measures = {plugin.name: tuple(plugin.measures) for plugin in plugins}
    columns, column_findings = resolve_columns(model.data_columns if model else None, measures)
    findings += column_findings
    return columns


def _experiment(
    loaded: LoadedConfig,
    parameters: Parameters,
    plugins: tuple[Plugin, ...],
    events: EventManager,
    model: RunTableModel,
    columns: MeasureColumns,
) -> Experiment:
    return Experiment(
        config_path=loaded.source.path,
        class_name=loaded.source.class_name,
        config=loaded.config,
        parameters=parameters,
        plugins=plugins,
        events=events,
        model=model,
        columns=columns,
        overrides=loaded.overrides,
        local_modules=loaded.local_modules,
        folder=experiment_folder(parameters, loaded),
        spelling=loaded.spelling,
    )
