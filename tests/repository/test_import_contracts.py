"""Arrows point down: the import contracts of pyproject.toml hold, cover every package, and notice a breach.

No files import each other in a circle, either: not even for types only, or within a function.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import grimp
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


#: What is added to a module, and the contract that it breaks, as it is reported.
BREACHES = [
    ("core/errors.py", "robot_runner.core.events.manager", "Arrows in the core point down"),
    ("core/new_floor.py", "", "Arrows in the core point down"),
    ("core/errors.py", "robot_runner.meters.polled", "Rooms stand beside the core"),
    ("core/links/connect.py", "robot_runner.simulator.embedded_robot", "Rooms stand beside the core"),
    ("cli/planning.py", "robot_runner.legacy.recognition", "Rooms stand beside the core"),
    ("legacy/recognition.py", "robot_runner.replication.replicating", "Rooms stand beside the core"),
    ("new_room.py", "", "Rooms stand beside the core"),
    ("analysis/results.py", "robot_runner.cli.console", "Only commands use the command line"),
    ("replication/packing.py", "robot_runner.analysis.results", "Of the analysis, the verdict on a replication uses"),
    ("legacy/recognition.py", "robot_runner.ros.shapes", "The simulator and the fakes speak as ROS does"),
    ("testing/fake_run.py", "robot_runner.meters.polled", "Only the adapters of the earlier tools' profilers need"),
    ("core/events/manager.py", "robot_runner", "Nothing inside imports a door"),
    ("core/words.py", "os", "Design is pure"),
]


@pytest.fixture(scope="module")
def verdict_on_breaches(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Return what is said of each contract where every breach is committed."""
    folder = tmp_path_factory.mktemp("breached")
    copy = shutil.copytree(SOURCE, folder / "robot_runner", ignore=shutil.ignore_patterns("__pycache__"))
    for module, imported, _ in BREACHES:
        with (copy / module).open("a", encoding="utf-8") as file:
            file.write(f"\nimport {imported}\n" if imported else "\n")
    said = re.sub(r"\x1b\[[0-9;]*m", "", _lint_imports(folder).stdout)  # some versions colour it whatever NO_COLOR says
    sections = re.split(r"^(\S.*)\n-+\n", said.partition("Broken contracts")[2], flags=re.MULTILINE)
    return dict(zip(sections[1::2], sections[2::2], strict=True))


@pytest.mark.parametrize(("module", "imported", "contract"), BREACHES)
def test_a_breach_is_noticed(module: str, imported: str, contract: str, verdict_on_breaches: dict[str, str]) -> None:
    (said,) = (text for name, text in verdict_on_breaches.items() if name.startswith(contract))
    name = "robot_runner." + module.removesuffix(".py").replace("/", ".")
    assert re.search(rf"{name} -> {imported}\s+\(l\." if imported else rf"- {name}\n", said), said


def _circles(package: str) -> list[tuple[str, ...]]:
    """Return the circles among the files of a package, each once, from its alphabetically first module.

    All imports count: those of a package's modules, for types only and within functions, too.
    """
    graph = grimp.build_graph(package, cache_dir=None)
    edges = ((module, other) for module in graph.modules for other in graph.find_modules_directly_imported_by(module))
    chains = (graph.find_shortest_chain(other, module) for module, other in edges)
    found = [chain for chain in chains if chain is not None]
    return sorted({chain[chain.index(min(chain)) :] + chain[: chain.index(min(chain))] for chain in found})


def test_no_files_import_each_other_in_a_circle() -> None:
    assert _circles("robot_runner") == []


def test_a_circle_is_noticed_however_it_is_imported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files = {
        "__init__": "",
        "run": "from circular_study import robot, table",
        "robot": "def drive() -> None:\n    from circular_study.wheels import turn",
        "wheels": "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from circular_study.motor import Motor",
        "motor": "from .robot import drive",
        "table": "import circular_study.rows",
        "rows": "from . import table",
        "words": "",
    }
    package = tmp_path / "circular_study"
    package.mkdir()
    for name, text in files.items():
        (package / f"{name}.py").write_text(text + "\n", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    found = _circles("circular_study")
    assert [[module.removeprefix("circular_study.") for module in circle] for circle in found] == [
        ["motor", "robot", "wheels"],
        ["rows", "table"],
    ]
