"""The page's system plugin is a package like a stranger's: installed, found, executed, and true to its contract."""

from __future__ import annotations

import importlib.util
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from examples.shuttle_plugin.shuttle_plugin import Shuttle

from robot_runner.plugins import Circumstances
from robot_runner.testing import SystemContract

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "examples" / "shuttle_plugin"
PAGE = ROOT / "docs" / "another-robot.md"

CONFIG = """
from pathlib import Path

from robot_runner import Factor, OperationType, RunTableModel
from shuttle_plugin import Shuttle


class RobotRunnerConfig:
    experiment_name = "shuttling"
    required_ros_version = None
    robot = "simulated"
    operation_type = OperationType.AUTO
    results_output_path = Path({results!r})
    plugins = [Shuttle(distance=0.1)]

    def create_run_table(self):
        return RunTableModel(factors=[Factor("Floor", ["smooth"])])
"""


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """An environment in which the package is installed into a folder of its own."""
    target = tmp_path_factory.mktemp("site")
    # Without hatchling here, pip builds in isolation and fetches it.
    isolation = ["--no-build-isolation", "--no-index"] if importlib.util.find_spec("hatchling") else []
    options = ["--quiet", "--disable-pip-version-check", "--no-input", "--no-deps", "--target", str(target)]
    command = [sys.executable, "-m", "pip", "install", *isolation, *options, str(PACKAGE)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=100, check=False)
    assert done.returncode == 0, done.stderr
    return {**os.environ, "PYTHONPATH": str(target)}


def robot_runner(environment: dict[str, str], *words: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "robot_runner", *map(str, words)]
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=100, check=False)


@pytest.mark.long
def test_it_is_discovered_once_it_is_installed(installed: dict[str, str]) -> None:
    listed = json.loads(robot_runner(installed, "plugins", "--json").stdout)["systems"]
    (found,) = [each for each in listed if each["name"] == "Shuttle"]
    assert (found["package"], found["measures"][0]["unit"]) == ("shuttle-plugin", "m")


@pytest.mark.long
def test_an_experiment_is_executed_with_it(installed: dict[str, str], tmp_path: Path) -> None:
    config = tmp_path / "config.py"
    config.write_text(CONFIG.format(results=str(tmp_path / "results")))
    answer = robot_runner(installed, "run", config)
    assert answer.returncode == 0, answer.stdout + answer.stderr
    header, row = (tmp_path / "results" / "shuttling" / "run_table.csv").read_text().splitlines()
    reach = dict(zip(header.split(","), row.split(","), strict=True))["Reach"]
    assert 0.1 <= float(reach) < 0.13


def test_it_takes_at_most_60_lines() -> None:
    files = [PACKAGE / "pyproject.toml", PACKAGE / "shuttle_plugin.py"]
    assert sum(len(path.read_text(encoding="utf-8").splitlines()) for path in files) <= 60


@pytest.mark.parametrize("name", ["pyproject.toml", "shuttle_plugin.py"])
def test_the_page_shows_the_package_as_it_is(name: str) -> None:
    blocks = re.findall(r"^```\w+\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    assert (PACKAGE / name).read_text(encoding="utf-8") in blocks


class TestShuttle(SystemContract):
    breaking_points = 4

    def make_plugin(self) -> Shuttle:
        return Shuttle(distance=0.05)


def test_an_experiment_without_a_robot_is_refused() -> None:
    (finding,) = Shuttle().check(Circumstances(robot=None))
    assert finding.is_error
    assert finding.fix
