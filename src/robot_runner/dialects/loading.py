"""From a config file of any dialect to a config object: the one entry for whoever loads config files."""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING

from robot_runner.config.loader import LoadedConfig
from robot_runner.config.loader import load_config as load_own_config
from robot_runner.dialects.recognition import recognise

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

__all__ = ["load_config"]


def load_config(path: Path, overrides: Mapping[str, str] = MappingProxyType({})) -> LoadedConfig:
    """Execute a config file and instantiate its config class; one of an earlier tool is lifted to ours.

    Raises:
        ConfigError: the file cannot be read, parsed or executed, mixes dialects, has no config class, or a parameter
            that is to be set does not exist.
    """
    recognised = recognise(path)
    if recognised is None:
        return load_own_config(path, overrides)
    from robot_runner.dialects.lifting import lift  # noqa: PLC0415 - own configs need none of it

    return lift(recognised, overrides)
