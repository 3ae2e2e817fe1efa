"""Folders of an experiment in whose place something else lies, and those of a user by the XDG specification."""

from __future__ import annotations

from pathlib import Path

import pytest

from robot_runner.core.errors import StorageError
from robot_runner.core.storage.layout import ExperimentFolder, home_folder, last_config, runs_put_away, user_folder


def test_a_file_in_the_place_of_a_folder_of_earlier_attempts_or_configs_holds_none(tmp_path: Path) -> None:
    folder = ExperimentFolder(tmp_path)
    folder.earlier_attempts.touch()
    folder.earlier_configs.touch()
    assert runs_put_away(folder) == []
    assert last_config(folder) == folder.config


@pytest.mark.parametrize(
    ("variable", "usual"), [("XDG_STATE_HOME", ".local/state/robot-runner"), ("XDG_CACHE_HOME", ".cache/robot-runner")]
)
def test_an_absolute_path_counts_and_a_relative_one_is_passed_over(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, variable: str, usual: str
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    for given, wanted in {
        str(tmp_path / "own"): tmp_path / "own/robot-runner",
        "~/own": tmp_path / "own/robot-runner",
        "": tmp_path / usual,
        "state": tmp_path / usual,  # else experiments in two folders know nothing of each other
        "../state": tmp_path / usual,
    }.items():
        monkeypatch.setenv(variable, given)
        assert user_folder(variable) == wanted
    monkeypatch.delenv(variable)
    assert user_folder(variable) == tmp_path / usual


def test_a_user_without_a_home_folder_is_told_what_to_set(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)

    def refuse(_: Path) -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(Path, "expanduser", refuse)
    with pytest.raises(StorageError, match="Set XDG_CACHE_HOME to a folder of your own"):
        user_folder("XDG_CACHE_HOME")
    assert home_folder() is None
