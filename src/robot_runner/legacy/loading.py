"""From a config file of any dialect to an experiment, or to everything that stands in its way."""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING

from robot_runner.core.config import preparation
from robot_runner.core.config.loader import LoadedConfig
from robot_runner.core.config.loader import load_config as load_own_config
from robot_runner.legacy.recognition import recognise

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from robot_runner.core.config.experiment import Experiment
    from robot_runner.core.config.preparation import Preparation

__all__ = ["load_config", "prepare", "prepare_or_refuse"]


# From a config file of any dialect to a config object: the one entry for whoever loads config files.


def load_config(path: Path, overrides: Mapping[str, str] = MappingProxyType({})) -> LoadedConfig:
    """Execute a config file and instantiate its config class; one of an earlier tool is lifted to ours.

    Raises:
        ConfigError: the file cannot be read, parsed or executed, mixes dialects, has no config class, or a parameter
            that is to be set does not exist.
    """
    recognised = recognise(path)
    if recognised is None:
        return load_own_config(path, overrides)
    from robot_runner.legacy.lifting import lift  # noqa: PLC0415 - own configs need none of it

    return lift(recognised, overrides)


def prepare(
    path: Path, overrides: Mapping[str, str] = MappingProxyType({}), *, is_for_here: bool = True
) -> Preparation:
    """Load and validate a config file of any dialect; all findings at once, and nothing on disk is touched.

    Args:
        path: the config file.
        overrides: static parameters to set, by name.
        is_for_here: whether it is to be executed on this machine; if not, nobody asks what the machine has.
    """
    return preparation.prepare(path, overrides, load_config, is_for_here=is_for_here)


def prepare_or_refuse(path: Path, overrides: Mapping[str, str] = MappingProxyType({})) -> Experiment:
    """Load and validate a config file of any dialect.

    Raises:
        ConfigError: it is refused; carries every finding.
    """
    return preparation.prepare_or_refuse(path, overrides, load_config)
