"""A profiler as a user names it on the command line, made with the parameters that were set there."""

from __future__ import annotations

import ast
import importlib
import importlib.util
import inspect
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robot_runner.errors import PluginError, did_you_mean
from robot_runner.plugins.api.plugin import Plugin, Profiler
from robot_runner.plugins.registry import find_plugin

if TYPE_CHECKING:
    from collections.abc import Mapping
    from types import ModuleType

__all__ = ["make_plugin", "profiler_class"]

_ROBOT = "robot"


def make_plugin(chosen: str, values: Mapping[str, str]) -> tuple[Plugin, str | None]:
    """Return an instance of the profiler, and how a robot is reached if `robot` was set.

    Args:
        chosen: as `profiler_class` takes it.
        values: the parameters, by name, each as it was typed: a Python literal, or else a text.

    Raises:
        PluginError: there is no such profiler or parameter, or it cannot be made; what its code raises is told.
    """
    kind = profiler_class(chosen)
    parameters = inspect.signature(kind).parameters
    takes_any = any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters.values())
    robot = None if _ROBOT in parameters else values.get(_ROBOT)
    own = {name: text for name, text in values.items() if name in parameters or name != _ROBOT}
    for name in own:
        if name not in parameters and not takes_any:
            raise PluginError(
                f"it has no parameter {name!r}", where=kind.__name__, fix=did_you_mean(name, [*parameters, _ROBOT])
            )
    try:
        plugin = kind(**{name: _value(text) for name, text in own.items()})
    except PluginError:
        raise
    except Exception as error:
        raise _raised(kind.__name__, "when it was made", error) from error
    if not hasattr(plugin, "name"):
        fix = "Call super().__init__(name=name) in its __init__."
        raise PluginError("it has no name", where=kind.__name__, fix=fix)
    return plugin, robot


def profiler_class(chosen: str) -> type[Plugin]:
    """Return the class of an installed profiler, or that of `module:Class`, `file.py` or `file.py:Class`.

    Raises:
        PluginError: there is no such profiler, or it cannot be imported.

    Example:
        >>> profiler_class("robot_runner.plugins.profilers:PsUtil").__name__
        'PsUtil'
    """
    source, _, name = chosen.partition(":")
    if source.endswith(".py"):
        module = _imported_file(Path(source))
        return _class_in(module, name, where=source)
    if name:
        return _class_in(_imported_module(source), name, where=source)
    return find_plugin("profilers", chosen).load()


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
        raise PluginError("it cannot be imported", where=str(path), fix="Name a Python file.")
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
        if isinstance(found, type) and issubclass(found, Profiler) and found.__module__ == module.__name__
    }
    if not name:
        if len(own) == 1:
            return next(iter(own.values()))
        found_here = f"it holds {len(own)} profilers" if own else "it holds no class that derives from Profiler"
        raise PluginError(found_here, where=where, fix=f"Name one: {where}:{next(iter(own), 'MyProfiler')}.")
    found = getattr(module, name, None)
    if found is None:
        raise PluginError(f"it has no class {name!r}", where=where, fix=did_you_mean(name, own))
    if not (isinstance(found, type) and issubclass(found, Profiler)):
        raise PluginError(f"{name} is no Profiler", where=where, fix="Derive it from robot_runner.plugins.Profiler.")
    return found


def _value(text: str) -> Any:
    try:
        return ast.literal_eval(text)
    except (ValueError, SyntaxError):
        return text


def _raised(where: str, when: str, error: BaseException) -> PluginError:
    problem = f"it raised {type(error).__name__} {when}: {error}"
    return PluginError(problem, where=where, fix="Mend it, or tell its author; --debug shows the traceback.")
