"""Checks of a config of an earlier tool: names in its text, callbacks, missing packages and plugins."""

from __future__ import annotations

import ast
import difflib
import importlib.util
from collections.abc import Collection, Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from robot_runner.core.config.parameters import OperationType
from robot_runner.core.config.raised_errors import fix_of_missing
from robot_runner.core.config.source import read_tree
from robot_runner.core.errors import ConfigError, Finding, did_you_mean, nearest
from robot_runner.legacy.earlier_experiment import check_callback
from robot_runner.legacy.profilers.profiler_catalogue import EarlierPlugin, plugin_of
from robot_runner.legacy.recognition import Dialect, Recognised, is_earlier_import
from robot_runner.legacy.run_ids import Clone, clone_around
from robot_runner.legacy.session import Session
from robot_runner.legacy.stand_ins.events import CONTEXT_ATTRIBUTES, RobotRunnerEvents, RunnerEvents, own_event
from robot_runner.legacy.stand_ins.modules import MODULES, PACKAGES, names_in
from robot_runner.legacy.syntax import (
    ImportedName,
    attributes_of,
    bound_names,
    classes_of,
    imports_of,
    nodes,
    used_names,
)

#: The similarity of two names from which one counts as a misspelling of the other (1.0: equal).
_ALIKE = 0.85

_EVENTS: dict[str, Any] = {"RobotRunnerEvents": RobotRunnerEvents, "RunnerEvents": RunnerEvents}
_SELF_MEASURE = ("self_measure", "self_measure_bin", "self_measure_logfile")
_OF_BOTH = ("name", "operation_type", "time_between_runs_in_ms", "results_output_path", "experiment_path")
_PARAMETERS = {
    Dialect.ROBOT_RUNNER: (*_OF_BOTH, "required_ros_version", "required_ros_distro"),
    Dialect.EXPERIMENT_RUNNER: (*_OF_BOTH, *_SELF_MEASURE),
}
_OPTIONAL = frozenset({"experiment_path", *_SELF_MEASURE})
#: The fix for an event that a fork added, if the config is in a clone of this fork.
_CALL_IT = "The fork whose clone this is raised it itself: call the method from another one, such as before_experiment."
_TABLES = ("create_run_table", "create_run_table_model")


def check_file(recognised: Recognised) -> list[Finding]:
    """Return the findings on the text of the config, before it is executed."""
    return [
        *_unknown_imports(recognised),
        *_unknown_events(recognised),
        *_unknown_context_attributes(recognised),
        *_misspelt_members(recognised),
    ]


def _unknown_imports(recognised: Recognised) -> Iterator[Finding]:
    clone = clone_around(recognised.path)
    for each in imports_of(recognised.tree):
        if not is_earlier_import(each.module) or each.is_guarded or _is_in_clone(each, clone):
            continue
        where = f"{recognised.path}:{each.line}"
        plugin = plugin_of(f"{each.module}.{each.name}")
        if plugin is not None and not plugin.names:
            yield Finding.error(where, f"{plugin.name} has nothing that stands in for it", plugin.note)
        elif each.module not in MODULES and each.module not in PACKAGES:
            yield Finding.error(where, _no_module(each.module), _nearest_module(each.module))
        elif each.name not in {"", "*"} and each.name not in names_in(each.module):
            known = names_in(each.module)
            is_plugin = each.module.startswith(("Plugins", "plugins")) and each.module in PACKAGES
            problem = _no_module(f"{each.module}.{each.name}") if is_plugin else f"{each.module} has no {each.name!r}"
            yield Finding.error(where, problem, did_you_mean(each.name, known))


def _is_in_clone(imported: ImportedName, clone: Clone) -> bool:
    if imported.module in MODULES:
        return clone.defines(imported.module, imported.name)
    modules = (imported.module, f"{imported.module}.{imported.name}")
    return any(clone.file_of(module) is not None for module in modules)


def _no_module(module: str) -> str:
    kind = "plugin" if module.startswith(("Plugins", "plugins")) else "module"
    return f"neither Robot Runner nor Experiment Runner ever had a {kind} {module}"


def _nearest_module(module: str) -> str:
    """Return a fix that names the module with the nearest last part: folders changed more often than names."""
    by_last = {known.rpartition(".")[2]: known for known in reversed(list(MODULES))}
    near = nearest(module.rpartition(".")[2], by_last)
    if near is not None:
        return f"Did you mean {by_last[near]!r}?"
    return (
        "If it is your own, put it beside the config file as the import names it; otherwise choose one of: "
        + ", ".join(sorted(name for name in names_in("Plugins.Profilers") if name[:1].isupper()))
        + "."
    )


def _unknown_events(recognised: Recognised) -> Iterator[Finding]:
    clone = clone_around(recognised.path)
    for owner, node in attributes_of(recognised.tree, _EVENTS):
        name, event, known = owner.id, node.attr, _EVENTS[owner.id].__members__
        if event not in known and not event.startswith("_"):
            is_of_fork = event in clone.text_of(f"EventManager.Models.{name}")
            fix = _CALL_IT if is_of_fork else _counterpart(event, known)
            yield Finding.error(f"{recognised.path}:{node.lineno}", f"{name} has no event {event!r}", fix)


def _counterpart(event: str, names: Collection[str]) -> str:
    meant = {"LAUNCH_MISSION": "INTERACT", "INTERACT": "LAUNCH_MISSION"}.get(event)
    return f"Did you mean {meant!r}?" if meant in names else did_you_mean(event, names)


def _unknown_context_attributes(recognised: Recognised) -> Iterator[Finding]:
    config = classes_of(recognised.tree).get(recognised.dialect.class_name)
    functions = [node for node in config.body if isinstance(node, ast.FunctionDef)] if config else []
    own = {node.attr for _, node in attributes_of(recognised.tree, {"context"}) if isinstance(node.ctx, ast.Store)}
    for function in functions:
        names = {argument.arg for argument in function.args.args if argument.arg == "context"}
        for _, node in attributes_of(function, names):
            if node.attr not in {*CONTEXT_ATTRIBUTES, *own} and isinstance(node.ctx, ast.Load):
                near = _alike(node.attr, CONTEXT_ATTRIBUTES)
                if near is not None:
                    where = f"{recognised.path}:{node.lineno}"
                    yield Finding.error(where, f"the context has no {node.attr!r}", f"Did you mean {near!r}?")


def _misspelt_members(recognised: Recognised) -> Iterator[Finding]:
    config = classes_of(recognised.tree).get(recognised.dialect.class_name)
    if config is None:
        return
    parameters = _PARAMETERS[recognised.dialect]
    methods = {node.name for node in config.body if isinstance(node, ast.FunctionDef)}
    bound = bound_names(config.body)
    there = {node.attr for _, node in attributes_of(config, {"self"}) if isinstance(node.ctx, ast.Store)} | bound.keys()
    there |= set(_TABLES) if there & set(_TABLES) else set()  # one of them is enough
    for name, line in bound.items():
        known = _TABLES if name in methods else parameters
        near = None if name in known or name.startswith("_") else _alike(name, known)
        if near is not None and near not in there and name not in (*parameters, *_TABLES):
            what = "no method is called" if name in methods else "there is no static parameter"
            # The earlier tool refused a missing member, too, unless it is optional or inherited.
            is_missed = near not in _OPTIONAL and not config.bases
            yield (Finding.error if is_missed else Finding.warning)(
                f"{recognised.path}:{line}",
                f"{what} {name!r}",
                f"Did you mean {near!r}? Otherwise begin the name with '_'.",
            )


def _alike(name: str, known: tuple[str, ...]) -> str | None:
    return next(iter(difflib.get_close_matches(name.casefold(), known, n=1, cutoff=_ALIKE)), None)


def check_subscriptions(session: Session, config: Any) -> Iterator[Finding]:
    """Yield findings on invalid callbacks, and on callbacks that would never be called."""
    for each in session.subscriptions:
        try:
            check_callback(each.callback, each.event)
        except ConfigError as error:
            yield error.as_finding()
    heard = {each.event for each in session.subscriptions}
    for name in {**RobotRunnerEvents.__members__, **RunnerEvents.__members__}:
        method = name.lower()
        if own_event(name) not in heard and method in vars(type(config)):
            problem = f"nothing subscribes it to {name}, so it is never called, as in the earlier tool"
            fix = "Subscribe it in __init__, or remove it."
            yield Finding.warning(f"{session.path.name}, {type(config).__name__}.{method}", problem, fix)


def check_waiting(session: Session, operation_type: object) -> Iterator[Finding]:
    """Yield a warning if runs wait for the user, unlike in the earlier tool."""
    subscribed = {each.event.value for each in session.subscriptions}
    if operation_type is OperationType.SEMI and "continue" not in subscribed:
        yield Finding.warning(
            f"{session.path.name}, operation_type",
            "operation_type is SEMI and nothing subscribes to CONTINUE: the earlier tool went on by itself, and now "
            "each run waits until the user says to go on",
            "Write OperationType.AUTO if the runs are to follow each other.",
        )


def check_packages(recognised: Recognised) -> Iterator[Finding]:
    """Yield a finding for each package that is not installed, at its first import; nothing is imported for this."""
    looked_for: set[str] = set()
    for each in imports_of(recognised.tree):
        package = each.module.partition(".")[0]
        if each.is_guarded or is_earlier_import(each.module) or package in looked_for:
            continue
        looked_for.add(package)
        spec: object = package
        with suppress(ValueError):  # a module such as `__main__`, which has no origin
            spec = importlib.util.find_spec(package)
        if spec is None:
            problem = f"there is no module {package!r}"
            yield Finding.error(f"{recognised.path}:{each.line}", problem, fix_of_missing(recognised.path, package))


def check_plugins(files: Iterable[Path]) -> list[Finding]:
    """Return findings on requirements that are missing for the plugins of a config file and the modules beside it."""
    return list(dict.fromkeys(finding for where, plugin in _used_plugins(files) for finding in _missing(where, plugin)))


def is_robot_operated(files: Iterable[Path]) -> bool:
    """Return whether any of the files uses a plugin that operates a robot."""
    return any(plugin.operates_robot for _, plugin in _used_plugins(files))


def _used_plugins(files: Iterable[Path]) -> Iterator[tuple[str, EarlierPlugin]]:
    for file in files:
        try:
            _, tree = read_tree(file)
        except ConfigError:  # a module that Python could import in another way
            continue
        used = used_names(tree) - _only_asked(tree)
        for each in imports_of(tree):
            plugin = plugin_of(f"{each.module}.{each.name}")
            if plugin is not None and plugin.names and not each.is_guarded and each.bound_as in used:
                yield f"{file}:{each.line}", plugin


def _only_asked(tree: ast.Module) -> set[str]:
    """Return the names of which only `parse_log` is used: reading a log does not need the program that wrote it."""
    asked = {id(owner) for owner, node in attributes_of(tree, used_names(tree)) if node.attr == "parse_log"}
    names = [node for node in nodes(tree, ast.Name) if isinstance(node.ctx, ast.Load)]
    return {node.id for node in names if id(node) in asked} - {node.id for node in names if id(node) not in asked}


def _missing(where: str, plugin: EarlierPlugin) -> Iterator[Finding]:
    ours = f"our {plugin.ours}, which `robot-runner plugins` describes." if plugin.ours else ""
    instead = f" Or take {ours}" if ours else ""
    for need in plugin.needs:
        if not need.is_there():
            yield Finding.error(where, f"{plugin.name} needs {need.what}, which is not here", need.fix + instead)
    if plugin.note:
        yield Finding.warning(where, plugin.note, f"Take {ours}" if ours else "")
