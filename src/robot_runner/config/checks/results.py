"""The results folder: that it can be made or written, found out without touching it."""

from __future__ import annotations

import os
import shutil
from typing import TYPE_CHECKING

from robot_runner.config.experiment import experiment_folder
from robot_runner.errors import Finding

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from robot_runner.config.loader import LoadedConfig
    from robot_runner.config.parameters import Parameters
    from robot_runner.plugins.api.plugin import Plugin

__all__ = ["check_disk_space", "check_results_path"]

#: What Robot Runner itself keeps of a run: its records in the journal, its row, its log.
_BYTES_PER_RUN = 4096


def check_results_path(loaded: LoadedConfig, parameters: Parameters) -> list[Finding]:
    """Return why the experiment's folder could not be made."""
    where = f"{loaded.where}.results_output_path"
    try:
        existing = _nearest_existing(experiment_folder(parameters, loaded).root)
    except (OSError, RuntimeError) as error:
        return [Finding.error(where, f"{parameters.results_output_path} cannot be resolved: {error}", "Name a folder.")]
    if not existing.is_dir():
        return [Finding.error(where, f"{existing} is no folder", "Name a folder, or move this file away.")]
    if not os.access(existing, os.W_OK | os.X_OK):
        fix = "Mend its permissions, or name another folder: --set results_output_path=..."
        return [Finding.error(where, f"{existing} cannot be written", fix)]
    return []


def check_disk_space(
    loaded: LoadedConfig, parameters: Parameters, plugins: Sequence[Plugin], runs: int
) -> list[Finding]:
    """Return a finding where the disk is too small for what the plugins say that they will keep."""
    needed = runs * (_BYTES_PER_RUN + sum(plugin.bytes_per_run for plugin in plugins))
    try:
        folder = _nearest_existing(experiment_folder(parameters, loaded).root)
        free = shutil.disk_usage(folder).free
    except (OSError, RuntimeError):  # found by the check of the path
        return []
    if free >= needed:
        return []
    where = f"{loaded.where}.results_output_path"
    problem = f"{runs:,} runs will keep about {needed / 1e6:,.2f} MB, and {free / 1e6:,.2f} MB are free in {folder}"
    return [Finding.error(where, problem, "Make room, or name a folder on another disk: --set results_output_path=...")]


def _nearest_existing(folder: Path) -> Path:
    return next(path for path in (folder, *folder.parents) if path.exists())
