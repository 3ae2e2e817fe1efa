"""Loading a config file: its config object, subscriptions, and the plugins that its imports activate."""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import sys
import threading
from collections.abc import Iterable, Mapping
from contextvars import ContextVar
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import Any

from robot_runner.core.config.local_modules import local_modules_among
from robot_runner.core.config.parameter_kinds import FLAG, Kind, choice
from robot_runner.core.config.parameters import PARAMETERS
from robot_runner.core.config.raised_errors import raised_in
from robot_runner.core.config.source import ConfigSource, activating_imports, read_source
from robot_runner.core.errors import ConfigError, Finding, did_you_mean
from robot_runner.core.events.manager import Subscription, recorded_subscriptions
from robot_runner.core.plugin import Plugin
from robot_runner.core.secret_names import shown_settings
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.table_columns import OWN_SPELLING, TableSpelling
from robot_runner.core.treatments import CONFIG_MODULE, parameters_guarded

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
            fix = "Write --set name=value, as in --set robot=simulated."
            raise ConfigError(f"{assignment!r} is not an assignment", where="--set", fix=fix)
        parsed[name.strip()] = value
    return parsed


def apply_overrides(config_class: type, overrides: Mapping[str, str]) -> dict[str, Any]:
    """Set static parameters of a config class, each read as the type that it has, and return them by name.

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
            kind_of_own = type(getattr(config_class, name)).__name__
            problem = f"{name!r} is of type {kind_of_own}, which cannot be set from outside"
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
        subscriptions: what it subscribed explicitly.
        activated: the plugins that import lines such as `import plugins.profilers.Ina219` asked for.
        overrides: the static parameters that were set from outside, by name.
        local_modules: the files of modules that it, or its callbacks, import and that are not installed, each with its
            path in the folder in which the config is kept.
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
        config_class = getattr(execute_source(source), source.class_name)
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
        fix = "Give it a name that ends in .py."
        raise ConfigError("the config cannot be imported", where=str(source.path), fix=fix)
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
