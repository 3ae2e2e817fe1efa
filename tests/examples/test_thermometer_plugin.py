"""The tutorial's plugin is a package like a stranger's: installed, discovered, tried, and true to its contract."""

from __future__ import annotations

import importlib.util
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from examples.thermometer_plugin.thermometer_plugin import Thermometer

from robot_runner.plugins import Circumstances
from robot_runner.testing import FakeClock, FakeLinks, ProfilerContract, make_context, rehearse

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "examples" / "thermometer_plugin"
PAGE = ROOT / "docs" / "write-a-profiler.md"


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
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60, check=False)


@pytest.mark.long
def test_it_is_discovered_once_it_is_installed(installed: dict[str, str]) -> None:
    listed = json.loads(robot_runner(installed, "plugins", "--json").stdout)["profilers"]
    (found,) = [each for each in listed if each["name"] == "Thermometer"]
    assert (found["package"], found["version"]) == ("thermometer-plugin", "0.1.0")
    assert found["measures"][0]["unit"] == "°C"
    assert found["findings"] == []


@pytest.mark.long
def test_it_is_tried_by_its_name(installed: dict[str, str], tmp_path: Path) -> None:
    (tmp_path / "temp").write_text("41500\n")
    answer = robot_runner(
        installed, "try", "Thermometer", "--seconds", "0.5", "--set", f"path={tmp_path / 'temp'}", "--json"
    )
    assert answer.returncode == 0, answer.stderr
    told = json.loads(answer.stdout)
    temperature = told["measures"]["Temperature"]
    assert {name: temperature[name] for name in ("value", "unit", "origin", "quality")} == {
        "value": 41.5,
        "unit": "°C",
        "origin": "measured",
        "quality": "good",
    }
    assert [file["name"] for file in told["raw_files"]] == ["quality.json", "samples.csv"]


def test_it_takes_fewer_than_60_lines() -> None:
    files = [PACKAGE / "pyproject.toml", PACKAGE / "thermometer_plugin.py"]
    assert sum(len(path.read_text(encoding="utf-8").splitlines()) for path in files) < 60


@pytest.mark.parametrize("name", ["pyproject.toml", "thermometer_plugin.py"])
def test_the_tutorial_shows_the_package_as_it_is(name: str) -> None:
    blocks = re.findall(r"^```\w+\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    assert (PACKAGE / name).read_text(encoding="utf-8") in blocks


class TestThermometer(ProfilerContract):
    robot = None

    @pytest.fixture(autouse=True)
    def zone(self, tmp_path_factory: pytest.TempPathFactory) -> None:
        self.path = tmp_path_factory.mktemp("zone") / "temp"
        self.path.write_text("41500\n")

    def make_plugin(self) -> Thermometer:
        return Thermometer(path=str(self.path))

    def make_links(self, clock: FakeClock) -> FakeLinks:
        return FakeLinks()


def test_the_mean_is_that_of_the_measured_window(tmp_path: Path) -> None:
    path, clock = tmp_path / "temp", FakeClock()
    path.write_text("40000\n")
    clock.at(5.0, lambda: path.write_text("50000\n"))
    plugin = Thermometer(path=str(path))
    context = make_context(tmp_path, plugin, robot=None, clock=clock)
    measures = rehearse(context, plugin, mission=lambda: clock.sleep(10.0))
    assert measures["Temperature"] == pytest.approx(45.0, abs=0.2)


def test_a_machine_without_a_thermal_zone_is_refused(tmp_path: Path) -> None:
    (finding,) = Thermometer(path=str(tmp_path / "nothing")).check(Circumstances())
    assert finding.is_error
    assert finding.fix
