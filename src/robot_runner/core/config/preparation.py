"""Preparing an experiment from a config file: loading and all checks, without touching robot or disk."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import permutations
from pathlib import Path
from types import MappingProxyType
from typing import Any

from robot_runner.core.config import checks
from robot_runner.core.config.callback_checks import check_callbacks
from robot_runner.core.config.claims import check_workers
from robot_runner.core.config.dialects import load_config
from robot_runner.core.config.experiment import (
    Experiment,
    event_manager_for,
    experiment_folder,
    extended_model,
    named_inputs,
)
from robot_runner.core.config.graph_checks import GraphCheck
from robot_runner.core.config.loader import LoadedConfig
from robot_runner.core.config.local_modules import check_neighbours
from robot_runner.core.config.name_checks import check_published, check_undefined_names, check_unused_names
from robot_runner.core.config.notify import check_notify
from robot_runner.core.config.operator_checks import check_operator_steps
from robot_runner.core.config.operator_steps import operator_measures
from robot_runner.core.config.parameters import Parameters
from robot_runner.core.config.plugin_checks import check_plugins, companions, gather_plugins, unbuilt_names
from robot_runner.core.config.registered_config import check_registration, registered
from robot_runner.core.config.treatment_makers import maker_findings
from robot_runner.core.design.batches import as_configured
from robot_runner.core.design.precision import most_repetitions
from robot_runner.core.design.run_table_model import RunTableModel
from robot_runner.core.design.warm_up import WarmUp
from robot_runner.core.errors import ConfigError, DesignError, Finding, LinkError, StorageError, errors_first
from robot_runner.core.events.manager import EventManager
from robot_runner.core.events.measure import (
    OPERATOR_OWNER,
    ROBOT,
    ROBOTS_OWNER,
    Measure,
    MeasureColumns,
    resolve_columns,
    with_phases,
)
from robot_runner.core.links.connect import (
    found_robot,
    is_simulated,
    link_findings,
    looks_for_robot,
    meant_robot,
    robot_on_graph,
)
from robot_runner.core.plugin import Plugin
from robot_runner.core.storage.table_columns import TableLayout
from robot_runner.core.words import enumerated


def choose_robot(loaded: LoadedConfig) -> list[Finding]:
    """Replace `robot = "auto"` by the robot that is found, in the manifest, too; tell which one, or that none was."""
    robot = getattr(loaded.config, "robot", None)
    try:
        found = found_robot(robot if isinstance(robot, str) else None)
    except LinkError as error:
        return [Finding.error(f"{loaded.where}.robot", error.problem, error.fix)]
    if found is None:
        return []
    loaded.config.robot = found.name
    problem = f"robot is {robot!r}, and {found.name!r} was chosen: {found.reason}"
    return [Finding.warning(f"{loaded.where}.robot", problem, f"Write robot = {found.name!r} to be sure of it.")]


def check_robot(loaded: LoadedConfig, parameters: Parameters, plugins: Sequence[Plugin] = ()) -> list[Finding]:
    """Return the findings on the robots of the experiment, and of the checks of installed packages."""
    if looks_for_robot(parameters.robot):
        return []  # nothing was found, which is a finding already

    def announced(link: str | None) -> list[Finding]:
        return checks.announced_checks(loaded.where, parameters.but(robot=link), plugins)

    return [*_link_findings(parameters), *_of_each(parameters, announced)]


def _link_findings(parameters: Parameters) -> Iterator[Finding]:
    """Yield why a robot cannot be reached, and whether robots that take turns differ in kind, or are the same."""
    for link in dict.fromkeys(parameters.links):
        yield from link_findings(link)
    if parameters.robots and parameters.cluster is not None:
        problem = "several robots take turns on this machine, and the runs are to be executed on a cluster"
        yield Finding.error("robot", problem, "Name one robot, or leave cluster out.")
    looked_for = [name for name, link in parameters.robots.items() if looks_for_robot(link)]
    if looked_for or len(set(map(is_simulated, parameters.robots.values()))) > 1:
        problem = (
            f"{enumerated(looked_for)} would be looked for" if looked_for else "simulated and real robots take turns"
        )
        yield Finding.error("robot", problem, "Name robots of one kind, each by its own link.")
    yield from _one_robot_twice(parameters.robots)


def _one_robot_twice(robots: Mapping[str, str]) -> Iterator[Finding]:
    """Yield which of the robots that take turns are the same, or may be: a whole graph, and a robot on it."""
    reached: dict[str, list[str]] = {}
    for name, link in robots.items():
        with suppress(LinkError):  # reported by `_link_findings`
            if not (is_simulated(link) or looks_for_robot(link)):
                reached.setdefault(robot_on_graph(link), []).append(name)
    for robot, names in reached.items():
        if len(names) > 1:
            problem = f"{enumerated(names)} are one robot ({robot}), which two runs would drive at the same time"
            yield Finding.error("robot", problem, "Name each robot once.")
    for whole, part in permutations(reached, 2):
        if part.startswith(f"{whole}/"):
            problem = f"{reached[whole][0]} ({whole}) includes {reached[part][0]} ({part})"
            fix = "Name each robot by its namespace, or the graph alone."
            yield Finding.error("robot", f"{problem}, which two runs would drive at the same time", fix)


#: Loads a config file with the static parameters that are set from outside; raises ConfigError.
Loader = Callable[[Path, Mapping[str, str]], LoadedConfig]


@dataclass(frozen=True, slots=True)
class Preparation:
    """The experiment of a config file, or None where a finding refuses it, and all findings, errors first."""

    experiment: Experiment | None
    findings: tuple[Finding, ...]


def prepare(
    path: Path,
    overrides: Mapping[str, str] = MappingProxyType({}),
    load: Loader = load_config,
    *,
    is_for_here: bool = True,
    looks_at_graph: bool = True,
    first: Callable[[Experiment], Iterable[Finding]] = lambda _: (),
) -> Preparation:
    """Load and validate a config file of any dialect; nothing on disk is changed.

    With `is_for_here` it is checked whether this machine can execute it, with `looks_at_graph` the robot's graph now.
    What `first` does with a valid experiment comes before that, as it takes seconds; after an error there is no check.
    """
    try:
        loaded = load(path, overrides)
    except ConfigError as error:
        return Preparation(None, error.findings)
    findings = [*loaded.findings, *_name_findings(loaded), *(choose_robot(loaded) if is_for_here else ())]
    parameters, parameter_findings = checks.read_parameters(loaded)
    model, model_findings = checks.create_model(loaded)
    model = _grown(loaded, parameters, model, model_findings)
    complete = _with_all_factors(model)
    plugins, plugin_findings = gather_plugins(loaded, complete)
    findings += [*parameter_findings, *plugin_findings, *model_findings]
    if parameters is not None:
        added, companion_findings = companions(parameters, plugins)
        plugins, findings = (*added, *plugins), [*findings, *companion_findings]
    events = _subscribe(loaded, plugins, findings)
    columns = measure_columns(loaded, model, plugins, parameters, findings)
    if parameters is not None:
        findings += checks.check_analysis(parameters, complete, columns)
        findings += checks.check_run_process(loaded, parameters)
        findings += check_callbacks(loaded, parameters, events)
        findings += check_published(loaded, events, columns)
        findings += check_registration(loaded, model, parameters, columns) if is_for_here else ()
        findings += checks.check_repeat_until(loaded, parameters, model, columns)
        findings += checks.check_reboots(loaded, parameters, model)
        findings += check_workers(loaded.where, parameters, plugins, events, model)
    experiment = None
    if parameters is not None and model is not None and not any(finding.is_error for finding in findings):
        experiment = Experiment(
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
            kept=loaded.kept,
            registration=registered(loaded),
        )
        done = [*first(experiment)]
        findings += done
        is_for_here = is_for_here and not any(finding.is_error for finding in done)  # a person is to know now
    if is_for_here:
        findings += _check_machine(loaded, parameters, plugins, complete, events if looks_at_graph else None)
    # Two checks may have the same finding, one of them as an error.
    refused = {(each.where, each.fix) for each in findings if each.is_error}
    findings = [each for each in findings if each.is_error or (each.where, each.fix) not in refused]
    ordered = tuple(errors_first(dict.fromkeys(findings)))
    if experiment is None or any(finding.is_error for finding in ordered):
        return Preparation(None, ordered)
    inputs = named_inputs(experiment.parameters, plugins, model, loaded.config)
    return Preparation(replace(experiment, inputs=inputs), ordered)


def _grown(
    loaded: LoadedConfig, parameters: Parameters | None, model: RunTableModel | None, findings: list[Finding]
) -> RunTableModel | None:
    """Return the design with the batches that were added to it; None, with findings, where the config lacks a part."""
    if parameters is None or model is None:
        return model
    try:
        return extended_model(model, experiment_folder(parameters, loaded))
    except (ConfigError, DesignError) as error:
        findings += error.findings
        return None
    except StorageError as error:  # the journal cannot be read: the rest of the config is checked all the same
        findings += error.findings
    except (OSError, RuntimeError):  # found by the check of the path
        pass
    return model


def _with_all_factors(model: RunTableModel | None) -> RunTableModel | None:
    """Return the design with which plugins are checked, which includes factors that only the config has so far."""
    own = as_configured(model) if model else None
    known = {factor.name for factor in model.factors} if model else set()
    return own if own and any(factor.name not in known for factor in own.factors) else model


def _name_findings(loaded: LoadedConfig) -> list[Finding]:
    """Return findings on names of a config that are misspelt, unused or not defined."""
    refused = checks.check_names(loaded)
    places = {finding.where for finding in refused}
    dead = [finding for finding in check_unused_names(loaded) if finding.where not in places]
    return [*refused, *dead, *check_undefined_names(loaded), *check_neighbours(loaded.source.path.parent)]


def _check_machine(
    loaded: LoadedConfig,
    parameters: Parameters | None,
    plugins: tuple[Plugin, ...],
    model: RunTableModel | None,
    events: EventManager | None,
) -> Iterator[Finding]:
    yield from loaded.lacking
    graph = None
    if parameters is not None and events is not None and parameters.cluster is None:  # each worker has its own graph
        graph = GraphCheck(parameters, plugins, model, events)
    yield from _robot_first(loaded, parameters, plugins, model)
    if parameters is not None:
        if graph is not None:
            yield from _of_each(parameters, graph.findings)
        if model is not None:
            yield from maker_findings(model.factors, experiment_folder(parameters, loaded))
        yield from check_notify(f"{loaded.where}.notify", parameters.notify)
        yield from checks.check_results_path(loaded, parameters)
        runs = 0 if model is None else _most_runs(model, parameters)
        yield from checks.check_disk_space(loaded, parameters, plugins, runs)


def _robot_first(
    loaded: LoadedConfig, parameters: Parameters | None, plugins: tuple[Plugin, ...], model: RunTableModel | None
) -> Iterator[Finding]:
    """Yield the findings on the robot, then those of the plugins, which are checked with the robot that was meant.

    Otherwise each plugin would report a misspelt name of the robot, or one of a wrong type, too.
    """
    if parameters is not None:
        yield from check_robot(loaded, parameters, plugins)
    unbuilt = unbuilt_names(loaded, plugins)
    robot: Any = parameters.robot if parameters is not None else getattr(loaded.config, "robot", None)
    if parameters is not None and parameters.robots:
        yield from _cold_robots(len(parameters.robots), None if model is None else model.warm_up)
        links = parameters.links
        yield from _of_each(parameters, lambda link: check_plugins(plugins, model, link, links, unbuilt))
    elif robot is None:
        yield from check_plugins(plugins, model, None, unbuilt=unbuilt)
    elif isinstance(robot, str) and (meant := meant_robot(robot)) is not None:
        found = check_plugins(plugins, model, meant, unbuilt=unbuilt)
        yield from found if parameters is None or parameters.cluster is None else map(_left_to_workers, found)


def _cold_robots(count: int, warm_up: WarmUp | None) -> Iterator[Finding]:
    """Yield a warning if there are fewer warm-up runs than robots that take turns."""
    if warm_up is not None and warm_up.runs < count:
        problem = f"{count} robots take turns, and {warm_up}: the other robots measure without having warmed up"
        yield Finding.warning("warm_up", problem, f"Plan as many as there are robots, {count}: each robot has one.")


def _of_each(parameters: Parameters, look: Callable[[str | None], Iterable[Finding]]) -> Iterator[Finding]:
    """Yield the findings on the robot; of several, those on each with its name, and once those that all have."""
    if not parameters.robots:
        yield from look(parameters.robot)
        return
    found = {name: list(look(link)) for name, link in parameters.robots.items()}
    alike = [each for each in next(iter(found.values())) if all(each in others for others in found.values())]
    yield from alike
    for name, findings in found.items():
        yield from (replace(each, where=f"{each.where}, robot {name}") for each in findings if each not in alike)


def _left_to_workers(finding: Finding) -> Finding:
    """Return a finding on this machine as a warning: workers of a cluster check their own machine when they join."""
    if not finding.is_error:
        return finding
    problem = f"on this machine: {finding.problem}; each worker is looked at when it joins"
    return Finding.warning(finding.where, problem, finding.fix)


def _most_runs(model: RunTableModel, parameters: Parameters) -> int:
    """Return how many runs there are at most, including those that may follow from results."""
    runs = max(len(model.plan()), int(model.design_facts.get("most_runs", 0)))
    return max(runs, runs * most_repetitions(parameters.repeat_until) // model.repetitions)


def prepare_or_refuse(
    path: Path,
    overrides: Mapping[str, str] = MappingProxyType({}),
    *,
    is_for_here: bool = True,
    looks_at_graph: bool = True,
) -> Experiment:
    """Load and validate a config file, as `prepare` does.

    Raises:
        ConfigError: it has errors; with all findings.
    """
    preparation = prepare(path, overrides, is_for_here=is_for_here, looks_at_graph=looks_at_graph)
    if preparation.experiment is None:
        raise ConfigError.of_findings(preparation.findings)
    return preparation.experiment


def _subscribe(loaded: LoadedConfig, plugins: tuple[Plugin, ...], findings: list[Finding]) -> EventManager:
    try:
        return event_manager_for(loaded, plugins)
    except ConfigError as error:
        findings += error.findings
        return EventManager()


def measure_columns(
    loaded: LoadedConfig,
    model: RunTableModel | None,
    plugins: tuple[Plugin, ...],
    parameters: Parameters | None,
    findings: list[Finding],
) -> MeasureColumns:
    """Return the measures that runs may yield, with the columns of the run table; problems are added to `findings`."""
    phases = parameters.phases if parameters is not None else ()
    measures = {plugin.name: with_phases(plugin.measures, phases) for plugin in plugins}
    steps = parameters.operator_steps if parameters is not None else ()
    step_findings = check_operator_steps(loaded.where, steps, model)
    if answers := operator_measures(steps) if not step_findings else ():
        measures[OPERATOR_OWNER] = answers
    if parameters is not None and parameters.robots:
        if model and any(factor.name == ROBOT for factor in model.factors):
            problem = f"several robots take turns, and the factor {ROBOT!r} does not choose which one executes a run"
            fix = f"Rename it, or have it choose: robot='ros2', say, and namespace=treatment({ROBOT!r}) of plugins."
            findings.append(Finding.error("robot", problem, fix))
        else:
            measures[ROBOTS_OWNER] = (Measure(ROBOT, "", "The robot that executed the run."),)
    columns, column_findings = resolve_columns(model.data_columns if model else None, measures)
    findings += [*step_findings, *column_findings, *checks.check_columns(columns)]
    columns = columns.with_all_of(OPERATOR_OWNER).with_all_of(ROBOTS_OWNER)
    if parameters is not None and parameters.quality_columns:
        columns = columns.with_quality()
    findings += DesignError.raised_by(TableLayout.of_model, model, columns.names) if model else ()
    return columns
