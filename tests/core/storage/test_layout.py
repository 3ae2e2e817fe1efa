"""Folders of an experiment in whose place something else lies."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robot_runner.core.storage.layout import ExperimentFolder, last_config, runs_put_away

if TYPE_CHECKING:
    from pathlib import Path


def test_a_file_in_the_place_of_a_folder_of_earlier_attempts_or_configs_holds_none(tmp_path: Path) -> None:
    folder = ExperimentFolder(tmp_path)
    folder.earlier_attempts.touch()
    folder.earlier_configs.touch()
    assert runs_put_away(folder) == []
    assert last_config(folder) == folder.config
