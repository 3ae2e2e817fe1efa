"""The documentation as it is built, once for all tests."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from tests.made_once import made_once

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="session")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the built documentation; what mkdocs warns of fails whoever needs it."""
    return made_once(tmp_path_factory, "site", _build)


def _build(folder: Path) -> None:
    # Not `--quiet`: that keeps warnings from being counted, and so makes `--strict` mean nothing.
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    built = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300, check=False, env=environment)
    assert built.returncode == 0, built.stdout + built.stderr
