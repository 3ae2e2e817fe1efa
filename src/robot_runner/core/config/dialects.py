"""From a config file of any dialect to a config object: the one way in which config files are loaded.

Our own dialect is the core's; others are announced in the group `robot_runner.dialects`, each by an object that keeps
to the protocol `Dialect`.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Protocol

from robot_runner.core.config import loader
from robot_runner.core.config.loader import LoadedConfig
from robot_runner.core.entry_points import entry_points
from robot_runner.core.errors import Finding, PluginError
from robot_runner.core.secret_names import is_secret_name

#: The variable of the environment that tells which config was loaded, and what was set from outside.
LOADED_VARIABLE = "ROBOT_RUNNER_CONFIG"
#: Where a module stands that is called as a config is once it is loaded.
_FOR_CHILDREN = str(Path(__file__).parent / "in_children")


class Dialect(Protocol):
    """How another tool, or an earlier version, spells a config file. Importing it must be cheap."""

    def recognise(self, path: Path) -> Callable[[Mapping[str, str]], LoadedConfig] | None:
        """Return what loads this file, given the static parameters to set; None where it is not of this dialect.

        The file is read, and nothing of it is executed.

        Raises:
            ConfigError: it cannot be read or parsed, or is neither of this dialect nor of another.
        """

    def stand_in_modules(self) -> frozenset[str]:
        """Return the top-level modules that files of this dialect import and that are there while one is loaded."""


def load_config(path: Path, overrides: Mapping[str, str] = MappingProxyType({})) -> LoadedConfig:
    """Execute a config file and instantiate its config class; one of another dialect is brought to ours.

    Raises:
        ConfigError: the file cannot be read, parsed or executed, mixes dialects, has no config class, or a parameter
            that is to be set does not exist.
    """
    _tell_children(path, overrides)
    dialects, unusable = _installed()
    for dialect in dialects:
        load = dialect.recognise(path)
        if load is not None:
            return load(overrides)
    loaded = loader.load_config(path, overrides)
    return replace(loaded, findings=(*loaded.findings, *unusable)) if unusable else loaded


def _tell_children(path: Path, overrides: Mapping[str, str]) -> None:
    """Let processes that `multiprocessing` starts anew (the default on macOS, and from Python 3.14 on) find the config.

    They are told what is on `sys.path`, and inherit the environment: what is secret does not go there, as programs that
    callbacks start may print it.
    """
    told = {name: text for name, text in overrides.items() if not is_secret_name(name)}
    os.environ[LOADED_VARIABLE] = json.dumps({"file": str(path.resolve()), "set": told})
    if _FOR_CHILDREN not in sys.path:
        sys.path.append(_FOR_CHILDREN)


def stand_in_modules() -> frozenset[str]:
    """Return the top-level modules that config files of some dialect may import though no package brings them."""
    return frozenset().union(*(dialect.stand_in_modules() for dialect in _installed()[0]))


def _installed() -> tuple[list[Dialect], tuple[Finding, ...]]:
    """Return the dialects that can be used, and a warning for each other: our own configs go without it."""
    dialects: list[Dialect] = []
    unusable: list[Finding] = []
    for point in entry_points("dialects"):
        try:
            dialects.append(point.load())
        except PluginError as error:
            unusable.append(Finding.warning(error.where, error.problem, error.fix))
    return dialects, tuple(unusable)
