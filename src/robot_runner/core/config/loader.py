"""Loading a config file: its config object, subscriptions, and the plugins that its imports activate."""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import os
import re
import shlex
import sys
import threading
import traceback
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import Any

from robot_runner.core.config.local_modules import local_modules_among
from robot_runner.core.config.parameter_kinds import FLAG, Kind, choice
from robot_runner.core.config.parameters import PARAMETERS
from robot_runner.core.config.source import ConfigSource, activating_imports, read_source
from robot_runner.core.errors import ConfigError, Finding, RobotRunnerError, did_you_mean
from robot_runner.core.events.manager import Subscription, recorded_subscriptions
from robot_runner.core.late_annotations import signature_of
from robot_runner.core.plugin import Plugin
from robot_runner.core.secret_names import shown_settings
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.table_columns import OWN_SPELLING, TableSpelling
from robot_runner.core.treatments import CONFIG_MODULE, is_waiting, parameters_guarded

# Static parameters set from the command line: `--set robot=simulated`.

_SIMPLE_TYPES = (bool, int, float, str, Path, Enum)


def parse_assignments(assignments: Iterable[str]) -> dict[str, str]:
    """Return the names and texts of `name=value` assignments; a later one replaces an earlier.

    Raises:
        ConfigError: one of them is not an assignment.
    """
    parsed: dict[str, str] = {}
    for assignment in assignments:
        name, equals, value = assignment.partition("=")
        if not equals or not name.strip():
            raise ConfigError(
                f"{assignment!r} is not an assignment",
                where="--set",
                fix="Write --set name=value, as in --set robot=simulated.",
            )
        parsed[name.strip()] = value
    return parsed


def apply_overrides(config_class: type, overrides: Mapping[str, str]) -> dict[str, Any]:
    """Set static parameters of a config class, each read as the type that the parameter has.

    Returns:
        The values that were set, by name.

    Raises:
        ConfigError: a parameter is not known or its text cannot be read; all findings at once.
    """
    values: dict[str, Any] = {}
    findings: list[Finding] = []
    for name, text in overrides.items():
        try:
            values[name] = _read(config_class, name, text)
        except ConfigError as error:
            findings += error.findings
    ConfigError.refuse(findings)
    for name, value in values.items():
        setattr(config_class, name, value)
    return values


def own_parameters(config_class: type) -> dict[str, Any]:
    """Return the config's own attributes of a simple type, which can be set like the known ones."""
    return {
        name: value
        for parent in reversed(config_class.__mro__)
        for name, value in vars(parent).items()
        if not name.startswith("_") and isinstance(value, _SIMPLE_TYPES) and name not in PARAMETERS
    }


def _read(config_class: type, name: str, text: str) -> Any:
    own = own_parameters(config_class)
    shown = shown_settings({name: text})[name]
    where = f"--set {name}={shown}"
    kind = PARAMETERS[name].kind if name in PARAMETERS else _kind_of(type(own[name])) if name in own else None
    if kind is None:
        if hasattr(config_class, name) and not name.startswith("_"):
            problem = (
                f"{name!r} is of type {type(getattr(config_class, name)).__name__}, which cannot be set from outside"
            )
            raise ConfigError(problem, where=where, fix="Set it in the config.")
        fix = did_you_mean(name, [*PARAMETERS, *own])
        raise ConfigError(f"there is no static parameter {name!r}", where=where, fix=fix)
    try:
        return kind.from_text(text)
    except (ValueError, KeyError) as error:
        raise ConfigError(f"{shown!r} cannot be read", where=where, fix=f"It must be {kind.expected}.") from error


def _kind_of(own: type) -> Kind:
    if issubclass(own, Enum):
        return choice(own)
    return FLAG if own is bool else Kind(f"a value of type {own.__name__}", lambda _: True, own)


@dataclass(frozen=True, slots=True)
class LoadedConfig:
    """A config file that was executed and whose class was instantiated.

    Attributes:
        config: the instance of the config class.
        subscriptions: what it subscribed explicitly.
        activated: the plugins that import lines such as `import plugins.profilers.Ina219` asked for.
        overrides: the static parameters that were set from outside, by name.
        local_modules: the files of modules that it, or its callbacks, import and that are not installed, each with its
            path in the folder in which the config is kept.
        findings: of loading it.
        folder: the experiment's folder, where the static parameters alone do not determine it.
        spelling: how its run table's file spells headings and statuses.
        threads: the names of threads that it started while it was loaded and that are alive.
        lacking: what it needs and this machine does not have.
        kept: what the experiment's folder keeps of its source, see `Experiment`.
    """

    source: ConfigSource
    config: Any
    subscriptions: tuple[Subscription, ...]
    activated: tuple[type[Plugin], ...]
    overrides: Mapping[str, str]
    local_modules: Mapping[Path, Path]
    findings: tuple[Finding, ...] = ()
    folder: ExperimentFolder | None = None
    spelling: TableSpelling = OWN_SPELLING
    threads: tuple[str, ...] = ()
    lacking: tuple[Finding, ...] = ()
    kept: str = "file"

    @property
    def where(self) -> str:
        """The file and class, for findings."""
        return f"{self.source.path.name}, {self.source.class_name}"


def load_config(path: Path, overrides: Mapping[str, str] = MappingProxyType({})) -> LoadedConfig:
    """Execute a config file and instantiate its config class.

    Raises:
        ConfigError: the file cannot be read, parsed or executed, has no config class, or a parameter that is to be
            set does not exist.
    """
    source = read_source(path)
    make_importable(source.path.parent)
    with (
        activating_imports() as activated,
        recorded_subscriptions() as subscriptions,
        raised_in(source.path, "while it was loaded"),
        parameters_guarded(),
    ):
        before, threads_before = set(sys.modules), set(threading.enumerate())
        module = execute_source(source)
        config_class = getattr(module, source.class_name)
        values = apply_overrides(config_class, overrides)
        config = config_class()
        for name, value in values.items():
            if name in getattr(config, "__dict__", {}):
                setattr(config, name, value)
        for name in (*PARAMETERS, "plugins"):
            if isinstance(inspect.getattr_static(config, name, None), property):
                getattr(config, name)  # so that an exception of a property is reported with its line
        local_modules = local_modules_among(source.path, set(sys.modules) - before)
        threads = threads_since(threads_before)
    return LoadedConfig(
        source=source,
        config=config,
        subscriptions=tuple(subscriptions),
        activated=tuple(activated),
        overrides=dict(overrides),
        local_modules=local_modules,
        threads=threads,
    )


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
            where=place_in(path, error),
            fix=_fix_of(path, error)
            or _fix_of_import(error)
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
#: The modules from which configs import; they are imported only after an import from the wrong one has failed.
_DOORS = tuple(f"robot_runner{each}" for each in ("", ".plugins", ".plugins.profilers", ".plugins.systems", ".designs",
                                                  ".adaptive", ".analysis"))  # fmt: skip


def fix_of_missing(config: Path, package: str) -> str:
    """Return the fix for a module that is not there: some configs import by their path from a folder above them."""
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


def _fix_of_import(error: BaseException) -> str:
    told = _NOT_IN_MODULE.search(str(error)) if isinstance(error, ImportError) else None
    if told is None:
        return ""
    name, module = told["name"], told["module"]
    neighbour = Path(traceback.extract_tb(error.__traceback__)[-1].filename).with_name(f"{module}.py")
    if module in sys.stdlib_module_names and neighbour.exists():
        return f"Rename {neighbour}: Python's own module of that name was imported instead."
    doors = _DOORS if module.partition(".")[0] == "robot_runner" else ()
    homes = [door for door in doors if name in dir(importlib.import_module(door))]
    if homes:
        return f"It is elsewhere: from {homes[0]} import {name}"
    return did_you_mean(name, dir(sys.modules[module]), "") if module in sys.modules else ""


def make_importable(folder: Path) -> None:
    """Let modules in this folder be imported, from now on: callbacks may import their neighbours later."""
    if str(folder) not in sys.path:
        sys.path.insert(0, str(folder))


_loaded_now: ContextVar[Path | None] = ContextVar("_loaded_now", default=None)


def file_being_loaded() -> Path | None:
    """Return the config file whose code at the top level is being executed by this thread, if one is."""
    return _loaded_now.get()


def execute_source(source: ConfigSource) -> ModuleType:
    """Execute a config file as a module of its own.

    Raises:
        ConfigError: it cannot be imported; what its code raises is raised as it is.
    """
    spec = importlib.util.spec_from_file_location(CONFIG_MODULE, source.path)
    if spec is None or spec.loader is None:
        raise ConfigError(
            "the config cannot be imported", where=str(source.path), fix="Give it a name that ends in .py."
        )
    module = importlib.util.module_from_spec(spec)
    sys.modules[CONFIG_MODULE] = module
    code = compile(source.text, str(source.path), "exec", dont_inherit=True)  # not the future statements of this module
    token = _loaded_now.set(source.path)
    try:
        exec(code, module.__dict__)  # noqa: S102 - a config file is code
    finally:
        _loaded_now.reset(token)
        # Imports pass over the None of `sys.path.append(os.getenv("UNSET"))`, and a `Path`: other readers do not.
        sys.path[:] = [each for each in sys.path if isinstance(each, str)]
    return module


def threads_since(before: set[threading.Thread]) -> tuple[str, ...]:
    """Return the names of the threads that there are now and were not `before`."""
    return tuple(sorted(thread.name for thread in set(threading.enumerate()) - before))


#: How CPython words it, since 3.10 with the class: `Ina219.__init__() got an unexpected keyword argument 'prt'`.
_UNEXPECTED = re.compile(r"(?P<called>[\w.<>]+)\(\) got an unexpected keyword argument '(?P<keyword>\w+)'")


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
