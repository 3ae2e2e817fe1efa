"""Arrows point down: the import contracts of pyproject.toml hold, cover every package, and notice a breach."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
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


def test_every_package_stands_on_a_floor() -> None:
    contracts = tomllib.loads(PROJECT.read_text(encoding="utf-8"))["tool"]["importlinter"]["contracts"]
    layers = next(contract for contract in contracts if contract["type"] == "layers")["layers"]
    floors = {name for layer in layers for name in re.findall(r"robot_runner\.[\w.]+", layer)}
    packages = {f"robot_runner.{path.stem}" for path in SOURCE.iterdir() if path.suffix == ".py" or _is_package(path)}
    packages -= {"robot_runner.__init__", "robot_runner.__main__", "robot_runner.plugins"}
    plugins = {path for path in (SOURCE / "plugins").iterdir() if path.stem != "__init__"}
    packages |= {f"robot_runner.plugins.{path.stem}" for path in plugins if path.suffix == ".py" or _is_package(path)}
    assert packages - floors == set()


def _is_package(path: Path) -> bool:
    return (path / "__init__.py").exists()


@pytest.mark.parametrize(
    ("module", "breach", "contract"),
    [
        ("errors.py", "import robot_runner.events.event", "Arrows point down"),
        ("events/event.py", "import robot_runner", "Nothing inside imports a door"),
        ("errors.py", "import os", "Design is pure"),
    ],
)
def test_a_breach_is_noticed(module: str, breach: str, contract: str, tmp_path: Path) -> None:
    copy = shutil.copytree(SOURCE, tmp_path / "robot_runner", ignore=shutil.ignore_patterns("__pycache__"))
    with (copy / module).open("a", encoding="utf-8") as file:
        file.write(f"\n{breach}\n")
    verdict = _lint_imports(tmp_path)
    said = re.sub(r"\x1b\[[0-9;]*m", "", verdict.stdout)  # some versions colour it whatever NO_COLOR says
    assert re.search(rf"^{contract} BROKEN", said, re.MULTILINE), verdict.stdout + verdict.stderr
