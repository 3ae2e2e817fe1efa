"""A plugin as a user names it on the command line, made with the parameters that were set there."""

from __future__ import annotations

import ast
import importlib
import importlib.util
import inspect
import sys
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

from robot_runner.core.errors import PluginError, did_you_mean
from robot_runner.core.late_annotations import signature_of
from robot_runner.core.plugin import Plugin, installed_plugins, load_plugin, refused_name
from robot_runner.core.words import enumerated

_ROBOT = "robot"
_COLLECTING = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)


def make_plugin(chosen: str, values: Mapping[str, str]) -> tuple[Plugin, str | None]:
    """Return an instance of the plugin, and how a robot is reached if `robot` was set.

    Args:
        chosen: as `plugin_class` takes it.
        values: the parameters, by name, each as it was typed: a Python literal, or else a text.

    Raises:
        PluginError: there is no such plugin or parameter, or it cannot be made; what its code raises is told.
    """
    kind = plugin_class(chosen)
    parameters = signature_of(kind).parameters
    robot = None if _ROBOT in parameters else values.get(_ROBOT)
    own = {name: text for name, text in values.items() if name in parameters or name != _ROBOT}
    _check_names(kind, parameters, own)
    try:
        plugin = kind(**{name: parsed_value(text) for name, text in own.items()})
    except PluginError:
        raise
    except Exception as error:
        raise _raised(kind.__name__, "when it was made", error) from error
    if refused := refused_name(plugin):
        raise refused
    return plugin, robot


def _check_names(kind: type, parameters: Mapping[str, inspect.Parameter], own: Mapping[str, str]) -> None:
    """Refuse a parameter that the class does not have, and name those without which it cannot be made.

    Raises:
        PluginError: there is one.
    """
    takes_any = any(each.kind is each.VAR_KEYWORD for each in parameters.values())
    unknown = [name for name in own if name not in parameters and not takes_any]
    if unknown:
        fix = did_you_mean(unknown[0], [*parameters, _ROBOT])
        raise PluginError(f"the plugin has no parameter {unknown[0]!r}", where=kind.__name__, fix=fix)
    needed = [name for name, each in parameters.items() if each.default is each.empty and each.kind not in _COLLECTING]
    missing = [name for name in needed if name not in own]
    if missing:
        settings = " ".join(f"--set {name}=..." for name in missing)
        problem = f"the plugin cannot be built without {enumerated(missing)}"
        raise PluginError(
            problem, where=kind.__name__, fix=f"Add {settings}; `robot-runner plugins` describes its parameters."
        )


def plugin_class(chosen: str) -> type[Plugin]:
    """Return the class of an installed plugin, or that of `module:Class`, `file.py` or `file.py:Class`.

    Raises:
        PluginError: there is no such plugin, or it cannot be imported.

    Example:
        >>> plugin_class("robot_runner.plugins.profilers:PsUtil").__name__
        'PsUtil'
    """
    source, _, name = chosen.partition(":")
    if source.endswith(".py"):
        module = _imported_file(Path(source))
        return _class_in(module, name, where=source)
    if name:
        return _class_in(_imported_module(source), name, where=source)
    known = {plugin.name: plugin for plugin in installed_plugins()}
    if chosen not in known:
        fix = f"{did_you_mean(chosen, known)} `robot-runner plugins` describes them."
        raise PluginError(f"no plugin named {chosen!r} is installed", where="try", fix=fix)
    return load_plugin(known[chosen])


def _imported_module(name: str) -> ModuleType:
    try:
        return importlib.import_module(name)
    except Exception as error:
        raise _raised(name, "when it was imported", error) from error


def _imported_file(path: Path) -> ModuleType:
    if not path.is_file():
        raise PluginError("there is no such file", where=str(path), fix="Name a file that is there.")
    sys.path.insert(0, str(path.parent.resolve()))  # what it imports beside it is found
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None:
        raise PluginError("the file cannot be imported", where=str(path), fix="Name a Python file.")
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise _raised(str(path), "when it was imported", error) from error
    return module


def _class_in(module: ModuleType, name: str, *, where: str) -> type[Plugin]:
    own = {
        each: found
        for each, found in vars(module).items()
        if isinstance(found, type) and issubclass(found, Plugin) and found.__module__ == module.__name__
    }
    if not name:
        if len(own) == 1:
            return next(iter(own.values()))
        found_here = (
            f"the module holds {len(own)} plugins"
            if own
            else "the module holds no class that derives from Profiler or System"
        )
        raise PluginError(found_here, where=where, fix=f"Name one: {where}:{next(iter(own), 'MyPlugin')}.")
    found = getattr(module, name, None)
    if found is None:
        raise PluginError(f"the module has no class {name!r}", where=where, fix=did_you_mean(name, own))
    if not (isinstance(found, type) and issubclass(found, Plugin)):
        raise PluginError(
            f"{name} is no plugin", where=where, fix="Derive it from robot_runner.plugins.Profiler or .System."
        )
    return found


def parsed_value(text: str) -> Any:
    """Return the Python literal that a text is, or else the text."""
    try:
        return ast.literal_eval(text)
    except (ValueError, SyntaxError):
        return text


def _raised(where: str, when: str, error: BaseException) -> PluginError:
    problem = f"the code raised {type(error).__name__} {when}: {error}"
    return PluginError(problem, where=where, fix="Mend it, or tell its author; --debug shows the traceback.")
