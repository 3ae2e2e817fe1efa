"""From a config file of any dialect to an experiment, or to everything that stands in its way."""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING

from robot_runner.config import preparation
from robot_runner.dialects.loading import load_config

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from robot_runner.config.experiment import Experiment
    from robot_runner.config.preparation import Preparation

__all__ = ["prepare", "prepare_or_refuse"]


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
