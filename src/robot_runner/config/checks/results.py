"""The results folder: that it can be made or written, found out without touching it."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from robot_runner.config.experiment import experiment_folder
from robot_runner.errors import Finding

if TYPE_CHECKING:
    from pathlib import Path

    from robot_runner.config.loader import LoadedConfig
    from robot_runner.config.parameters import Parameters

__all__ = ["check_results_path"]


def check_results_path(loaded: LoadedConfig, parameters: Parameters) -> list[Finding]:
    """Return why the experiment's folder could not be made."""
    where = f"{loaded.where}.results_output_path"
    try:
        existing = _nearest_existing(experiment_folder(parameters, loaded.source.path).root)
    except (OSError, RuntimeError) as error:
        return [Finding.error(where, f"{parameters.results_output_path} cannot be resolved: {error}", "Name a folder.")]
    if not existing.is_dir():
        return [Finding.error(where, f"{existing} is no folder", "Name a folder, or move this file away.")]
    if not os.access(existing, os.W_OK | os.X_OK):
        fix = "Mend its permissions, or name another folder: --set results_output_path=..."
        return [Finding.error(where, f"{existing} cannot be written", fix)]
    return []


def _nearest_existing(folder: Path) -> Path:
    return next(path for path in (folder, *folder.parents) if path.exists())
