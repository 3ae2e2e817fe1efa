"""A small experiment, its package, and a package that a test may damage."""

from __future__ import annotations

import zipfile
from typing import TYPE_CHECKING

import pytest
from tests.replication.small_experiment import execute, home, write_config

from robot_runner.replication.packing import Packed, pack

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture(scope="session")
def ada(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the home folder of who executes and packs."""
    return tmp_path_factory.mktemp("house") / "ada"


@pytest.fixture(scope="session")
def experiment(ada: Path) -> Path:
    """Return the folder of an executed experiment; nobody may change it."""
    return execute(write_config(ada / "study"))


@pytest.fixture(scope="session")
def packed(experiment: Path, ada: Path, tmp_path_factory: pytest.TempPathFactory) -> Packed:
    """Return the package of the experiment; nobody may change it."""
    with home(ada):
        return pack(experiment, tmp_path_factory.mktemp("packages") / "small.zip")


@pytest.fixture
def unpacked(packed: Packed, tmp_path: Path) -> Path:
    """Return a folder with the package's files in it, to be damaged."""
    folder = tmp_path / "unpacked"
    with zipfile.ZipFile(packed.path) as archive:
        archive.extractall(folder)
    return folder
