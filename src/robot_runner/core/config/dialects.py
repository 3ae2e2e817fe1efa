"""Loading a config file of any dialect: the one way in which config files are loaded.

Our own dialect is the core's; others are announced in the group `robot_runner.dialects`, each as a `Dialect`.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Protocol

from robot_runner.core.config import loader
from robot_runner.core.config.loader import LoadedConfig
from robot_runner.core.entry_points import EntryPoint, entry_points
from robot_runner.core.errors import Finding, PluginError
from robot_runner.core.secret_names import is_secret_name

#: The environment variable with the file of the config, and the parameters that were set from outside.
LOADED_VARIABLE = "ROBOT_RUNNER_CONFIG"
#: The folder with a module that has the name of a loaded config.
_FOR_CHILDREN = str(Path(__file__).parent / "in_children")


class Dialect(Protocol):
    """How another tool, or an earlier version, spells a config file. Importing it must be cheap."""

    def recognise(self, path: Path) -> Callable[[Mapping[str, str]], LoadedConfig] | None:
        """Return a function that loads this file, given static parameters to set; None where it is of another dialect.

        The file is read, and nothing of it is executed.

        Raises:
            ConfigError: it cannot be read or parsed, or is neither of this dialect nor of another.
        """

    def stand_in_modules(self) -> frozenset[str]:
        """Return the top-level modules that files of this dialect import and that exist only while one is loaded."""


def load_config(path: Path, overrides: Mapping[str, str] = MappingProxyType({})) -> LoadedConfig:
    """Execute a config file and instantiate its config class; one of another dialect is converted to ours.

    Raises:
        ConfigError: the file cannot be read, parsed or executed, mixes dialects, has no config class, or a parameter
            that is to be set does not exist.
    """
    _tell_children(path, overrides)
    unusable: list[Finding] = []
    for point in entry_points("dialects"):
        try:
            load = point.called(partial(_recognised, point, path))
        except PluginError as error:
            unusable.append(Finding.warning(error.where, error.problem, error.fix))
            continue
        if load is not None:
            return point.called(partial(load, overrides))
    loaded = loader.load_config(path, overrides)
    return replace(loaded, findings=(*loaded.findings, *unusable)) if unusable else loaded


def _recognised(point: EntryPoint, path: Path) -> Callable[[Mapping[str, str]], LoadedConfig] | None:
    dialect: Dialect = point.load()
    load = dialect.recognise(path)
    if load is not None and not callable(load):
        raise TypeError(f"{load!r}, which `recognise` returned, cannot be called")
    return load


def _tell_children(path: Path, overrides: Mapping[str, str]) -> None:
    """Let processes that `multiprocessing` does not fork (on macOS, and from Python 3.14 on) find the config.

    They get `sys.path`, and inherit the environment, where secrets are left out, as programs of callbacks may print it.
    """
    told = {name: text for name, text in overrides.items() if not is_secret_name(name)}
    os.environ[LOADED_VARIABLE] = json.dumps({"file": os.path.realpath(path), "set": told})
    if _FOR_CHILDREN not in sys.path:
        sys.path.append(_FOR_CHILDREN)


def stand_in_modules() -> frozenset[str]:
    """Return the top-level modules that config files of some dialect may import though no package has them."""
    found: frozenset[str] = frozenset()
    for point in entry_points("dialects"):
        with suppress(PluginError):  # one that cannot be used reads no config, which says so when it is loaded
            found |= point.called(lambda: frozenset(point.load().stand_in_modules()))  # noqa: B023 - called at once
    return found
