"""A small experiment, its package, and a package that a test may damage."""

from __future__ import annotations

import pickle
import zipfile
from typing import TYPE_CHECKING

import pytest
from tests.made_once import made_once
from tests.replication.small_experiment import execute, home, write_config

from robot_runner.replication.packing import Packed, pack

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture(scope="session")
def ada(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the home folder of who executed the experiment and packed it, once for all tests."""
    return made_once(tmp_path_factory, "replication", _execute_and_pack) / "house" / "ada"


@pytest.fixture(scope="session")
def experiment(ada: Path) -> Path:
    """Return the folder of an executed experiment; nobody may change it."""
    return ada / "study" / "results" / "small"


@pytest.fixture(scope="session")
def packed(ada: Path) -> Packed:
    """Return the package of the experiment; nobody may change it."""
    found = pickle.loads((ada.parents[1] / "packed.pickle").read_bytes())  # noqa: S301 - of our own, see below
    assert isinstance(found, Packed)
    return found


def _execute_and_pack(folder: Path) -> None:
    ada = folder / "house" / "ada"
    experiment = execute(write_config(ada / "study"))
    (folder / "packages").mkdir()
    with home(ada):
        packed = pack(experiment, folder / "packages" / "small.zip")
    (folder / "packed.pickle").write_bytes(pickle.dumps(packed))


@pytest.fixture
def unpacked(packed: Packed, tmp_path: Path) -> Path:
    """Return a folder with the package's files in it, to be damaged."""
    folder = tmp_path / "unpacked"
    with zipfile.ZipFile(packed.path) as archive:
        archive.extractall(folder)
    return folder
