"""What tests of results, statistics, figures and reports share: experiment folders that nobody had to execute."""

from __future__ import annotations

import itertools
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from tests.analysis import experiment_folders
from tests.analysis.experiment_folders import Folder

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

#: The console script, which lies beside the interpreter.
PROGRAM = Path(sys.executable).with_name("robot-runner")


@pytest.fixture
def make_folder(tmp_path: Path) -> Callable[..., Folder]:
    """Return what makes an experiment folder; it is written, and can be added to."""
    numbers = itertools.count(1)

    def make(**settings: Any) -> Folder:
        root = settings.pop("root", tmp_path / f"experiment_{next(numbers)}")
        folder = Folder(root=root, **settings)
        folder.write()
        return folder

    return make


@pytest.fixture
def two_tasks(tmp_path: Path) -> Callable[..., Folder]:
    """Return what makes an experiment of one factor with two treatments and five runs of each; energies are given."""
    numbers = itertools.count(1)

    def make(
        video: Sequence[Any] = (870.1, 872.4, 869.0, 874.2, 871.3),
        network: Sequence[Any] = (834.0, 836.1, 833.2, 838.0, 835.5),
        **settings: Any,
    ) -> Folder:
        root = tmp_path / f"two_tasks_{next(numbers)}"
        return experiment_folders.two_tasks(root, video, network, **settings)

    return make
