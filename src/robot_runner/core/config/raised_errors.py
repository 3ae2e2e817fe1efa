"""What a config's code raised, as a finding: the line that raised it, and what to do about it."""

from __future__ import annotations

import builtins
import importlib
import inspect
import os
import re
import shlex
import sys
import traceback
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from robot_runner.core.config.local_modules import is_local
from robot_runner.core.errors import ConfigError, Finding, RobotRunnerError, did_you_mean, nearest
from robot_runner.core.late_annotations import signature_of
from robot_runner.core.treatments import is_waiting


@contextmanager
def raised_in(path: Path, when: str) -> Iterator[None]:
    """Turn an exception of a config's code into a ConfigError that names the line.

    Raises:
        ConfigError: it raised.
    """
    try:
        yield
    except RobotRunnerError as error:
        raise ConfigError.of_findings(_placed(path, error)) from error
    except (Exception, SystemExit) as error:
        raise ConfigError(
            f"the config raised {type(error).__name__} {when}: {error}{_before(error)}",
            where=_place_of(path, error),
            fix=_fix_of_import(path, error)
            or _fix_of(path, error)
            or _fix_of_name(error)
            or _fix_of_method(error)
            or misspelt_keyword(path, error)
            or "Correct this line.",
        ) from error


def _before(error: BaseException) -> str:
    """Return the first error, in words, if this one was raised while another was handled: the first is the cause."""
    first = error
    while (earlier := first.__cause__ or (None if first.__suppress_context__ else first.__context__)) is not None:
        first = earlier
    return "" if first is error else f" (after {type(first).__name__}: {first})"


def place_in(path: Path, error: BaseException) -> str:
    """Return the last line of the file `path` that `error` passed through, as `file:line`."""
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if Path(frame.filename) == path]
    return f"{path}:{lines[-1]}" if lines else str(path)


def _place_of(path: Path, error: BaseException) -> str:
    """Return the line that raised `error`: of the config, or of a module beside it, with the line that led there."""
    frames = [(each.filename, each.lineno) for each in traceback.extract_tb(error.__traceback__)]
    if isinstance(error, SyntaxError):
        frames.append((error.filename or "", error.lineno))
    beside = [(name, line) for name, line in frames if Path(name) == path or is_local(Path(name), path.parent)]
    if not beside or Path(beside[-1][0]) == path:
        return place_in(path, error)
    return f"{beside[-1][0]}:{beside[-1][1]}, from {place_in(path, error)}"


def _placed(path: Path, error: RobotRunnerError) -> tuple[Finding, ...]:
    """Return the findings of an error; those without a place get the line of the config."""
    place = place_in(path, error)
    return tuple(
        each
        if each.where.startswith(("--set", str(path)))
        else replace(each, where=f"{place}, {each.where}".rstrip(", "))
        for each in error.findings
    )


#: The file of `os.environ` in a traceback; newer Pythons have a frozen module.
_OF_OS = {os.__file__, "<frozen os>"}
_WITHOUT_SELF = re.compile(r"\.(?P<name>\w+)\(\) takes 0 positional arguments but 1 was given")
_NOT_IN_MODULE = re.compile(r"cannot import name '(?P<name>\w+)' from '(?P<module>[\w.]+)'")
_OURS = "robot_runner"
#: The modules from which configs import; they are imported only after an import from the wrong one has failed.
_DOORS = tuple(f"robot_runner{each}" for each in ("", ".plugins", ".plugins.profilers", ".plugins.systems", ".designs",
                                                  ".adaptive", ".analysis"))  # fmt: skip
#: Python's modules of names that configs forget to import, and the usual short names of packages.
_STANDARD = ("collections.abc", "typing", "pathlib", "dataclasses", "enum")
_SHORT = {"np": "numpy", "pd": "pandas", "plt": "matplotlib.pyplot"}


def fix_of_missing(config: Path, package: str) -> str:
    """Return the fix for a module that is not there: some configs import by their path from a folder above them."""
    near = nearest(package, [_OURS, *(each for each in _DOORS if each.endswith(package.rpartition(".")[2]))], 0.8)
    if near is not None:
        return f"Did you mean {near!r}?"
    parent, _, name = package.rpartition(".")
    for folder in getattr(sys.modules.get(parent), "__path__", ()):
        return f"{parent!r} is in {folder}, which has no {name!r}: correct the name, or get the version that has it."
    places = [f"{package}.py", f"{package}/*.py", f"{package}/*/*.py"]
    above = config.absolute().parent.parents
    folder = next((each for each in above if any(any(each.glob(place)) for place in places)), None)
    if folder is None:
        return f"Install the package that brings {package!r}, or correct the name."
    return (
        f"Python does not search {folder}, which has a {package!r}. If it is meant, write "
        f"PYTHONPATH={shlex.quote(str(folder))} before the command; otherwise install the package that brings "
        f"{package!r}."
    )


def _fix_of(path: Path, error: BaseException) -> str:
    if isinstance(error, ImportError) and "relative import" in str(error):
        return "Import it by its name, without the dots: the folder of the config is searched for modules."
    if isinstance(error, ModuleNotFoundError) and error.name:
        return fix_of_missing(path, error.name)
    if isinstance(error, KeyError) and traceback.extract_tb(error.__traceback__)[-1].filename in _OF_OS:
        return f"Set it in the environment: export {error.args[0]}=... before the command."
    if isinstance(error, AttributeError) and is_waiting(error.obj):
        return "A plugin with a bound parameter is built once the run table is made: read its attributes in callbacks."
    if isinstance(error, AttributeError) and error.name and error.obj is not None:
        return did_you_mean(error.name, dir(error.obj), "")
    return ""


def _fix_of_method(error: BaseException) -> str:
    told = _WITHOUT_SELF.search(str(error)) if isinstance(error, TypeError) else None
    return "" if told is None else f"Write self as its first parameter: def {told['name']}(self)."


def _fix_of_name(error: BaseException) -> str:
    if not isinstance(error, NameError) or not error.name:
        return ""
    *_, (frame, _) = traceback.walk_tb(error.__traceback__)
    return fix_of_undefined(error.name, {**frame.f_globals, **frame.f_locals})


def fix_of_undefined(name: str, known: Iterable[str]) -> str:
    """Return the fix for a name that is not defined: its import, or the nearest of those that are `known`."""
    if home := _home_of(name):
        return f"Import it: from {home} import {name}"
    if name in sys.stdlib_module_names:
        return f"Import it: import {name}"
    if name in _SHORT:
        return f"Import it: import {_SHORT[name]} as {name}"
    if home := next((each for each in _STANDARD if name in importlib.import_module(each).__all__), None):
        return f"Import it: from {home} import {name}"
    slip = nearest(name, [each for each in dir(builtins) if each[0].casefold() == name[0].casefold()], 0.8)
    return did_you_mean(name, [*known, *filter(None, [slip])], "Define it, import it, or correct the name.")


def _home_of(name: str) -> str | None:
    """Return the module from which configs import a name of ours, if there is one."""
    return next((door for door in _DOORS if name in dir(importlib.import_module(door))), None)


def _fix_of_import(path: Path, error: BaseException) -> str:
    """Return the fix for a name that a module lacks: the file may be another module of that name."""
    told = _NOT_IN_MODULE.search(str(error)) if isinstance(error, ImportError) else None
    source = error.obj if isinstance(error, AttributeError) else sys.modules.get(told["module"]) if told else None
    if inspect.ismodule(source) and source.__name__ in sys.stdlib_module_names:
        file = Path(getattr(source, "__file__", None) or "")
        if is_local(file, path.parent):
            return f"Rename {file}: it is imported in place of Python's own module of that name."
    if "(most likely due to a circular import)" in str(error):
        return "Move what both modules need into a third, which both import."
    if told is None:
        return ""
    name, module = told["name"], told["module"]
    neighbour = Path(traceback.extract_tb(error.__traceback__)[-1].filename).with_name(f"{module}.py")
    if module in sys.stdlib_module_names and neighbour.exists():
        return f"Rename {neighbour}: Python's own module of that name was imported instead."
    home = _home_of(name) if module.partition(".")[0] == _OURS else None
    if home is not None:
        return f"It is elsewhere: from {home} import {name}"
    return did_you_mean(name, dir(sys.modules[module]), "") if module in sys.modules else ""


#: How CPython words it, since 3.10 with the class: `Ina219.__init__() got an unexpected keyword argument 'prt'`. Where
#: a parameter is bound to a factor, it is `Ina219(): got ...`.
_UNEXPECTED = re.compile(r"(?P<called>[\w.<>]+)\(\):? got an unexpected keyword argument '(?P<keyword>\w+)'")


def misspelt_keyword(path: Path, error: BaseException) -> str:
    """Return the fix for an unknown keyword argument, with the nearest name; empty for other errors."""
    found = _UNEXPECTED.search(str(error)) if isinstance(error, TypeError) else None
    if found is None:
        return ""
    name = found["called"].removesuffix(".__init__").rpartition(".")[2]
    for frame, _ in reversed(list(traceback.walk_tb(error.__traceback__))):
        if Path(frame.f_code.co_filename) == path:
            known = keywords_of(_named(name, {**frame.f_globals, **frame.f_locals}))
            return did_you_mean(found["keyword"], known)
    return ""


def keywords_of(called: Any) -> list[str]:
    """Return the names of the parameters of a class or function; none where it has no signature."""
    with suppress(TypeError, ValueError):  # it is not a callable, or one of Python's own
        parameters = signature_of(called).parameters.values()
        return [each.name for each in parameters if each.kind in {each.POSITIONAL_OR_KEYWORD, each.KEYWORD_ONLY}]
    return []


def _named(name: str, known: Mapping[str, Any]) -> Any:
    """Return the object with this name in the namespace of a call, also under an alias or in a module."""
    if name in known:
        return known[name]
    values = list(known.values())
    inside = [getattr(each, name, None) for each in values if inspect.ismodule(each)]
    return next((each for each in [*values, *inside] if getattr(each, "__name__", None) == name), None)
