"""Arrows point down: the import contracts of pyproject.toml hold, cover every package, and notice a breach."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PROJECT = ROOT / "pyproject.toml"
SOURCE = ROOT / "src" / "robot_runner"
LINT_IMPORTS = Path(sys.executable).with_name("lint-imports")


def _lint_imports(source: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [LINT_IMPORTS, "--config", PROJECT, "--no-cache"],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(source), "NO_COLOR": "1"},
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )


def test_the_contracts_hold() -> None:
    verdict = _lint_imports(ROOT / "src")
    assert verdict.returncode == 0, verdict.stdout + verdict.stderr


@pytest.mark.parametrize(
    ("module", "breach", "contract"),
    [
        ("core/errors.py", "import robot_runner.core.events.manager", "Arrows in the core point down"),
        ("core/errors.py", "import robot_runner.meters.polled", "Rooms stand beside the core"),
        ("new_room.py", "import os", "Rooms stand beside the core"),
        ("core/events/manager.py", "import robot_runner", "Nothing inside imports a door"),
        ("core/errors.py", "import os", "Design is pure"),
    ],
)
def test_a_breach_is_noticed(module: str, breach: str, contract: str, tmp_path: Path) -> None:
    copy = shutil.copytree(SOURCE, tmp_path / "robot_runner", ignore=shutil.ignore_patterns("__pycache__"))
    with (copy / module).open("a", encoding="utf-8") as file:
        file.write(f"\n{breach}\n")
    verdict = _lint_imports(tmp_path)
    said = re.sub(r"\x1b\[[0-9;]*m", "", verdict.stdout)  # some versions colour it whatever NO_COLOR says
    assert re.search(rf"^{contract} BROKEN", said, re.MULTILINE), verdict.stdout + verdict.stderr
