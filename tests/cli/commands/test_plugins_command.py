from __future__ import annotations

import json
import sys
from importlib.metadata import version
from typing import TYPE_CHECKING

import pytest

from robot_runner.cli.commands import doctor, plugins
from robot_runner.core.entry_points import EntryPoint
from robot_runner.core.late_annotations import parameters_of
from robot_runner.core.plugin import installed_plugins

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


def _installed(name: str, value: str) -> EntryPoint:
    return EntryPoint(name, "robot_runner.profilers", value, lambda: ("stranger", "2.1"))


def test_every_built_in_plugin_is_listed_with_all_there_is_to_know(robot_runner: Callable) -> None:
    answer = robot_runner("plugins")
    assert answer.code == 0
    for name in ("BasicTurtlebot3", "Ina219", "PsUtil"):
        assert f"  {name}  robot-runner {version('robot-runner')}\n" in answer.out
    assert "Energy (J): " in answer.out
    assert "rate_hz=10.0" in answer.out
    assert "robot='simulated'" in answer.out


def test_json_has_the_same(robot_runner: Callable) -> None:
    found = robot_runner("plugins", "--json").json
    systems = ["ActionMission", "BasicTurtlebot3", "ComposeProject", "Lifecycle", "PlayBag", "Program", "RosLaunch"]
    systems += ["RosNode", "RosParameters", "SimulatedWorld", "Simulation", "Together", "TopicMission", "Tune"]
    systems += ["Waypoints"]
    assert [plugin["name"] for plugin in found["systems"]] == systems
    launch = next(plugin for plugin in found["systems"] if plugin["name"] == "RosLaunch")
    assert {"package", "ros=None", "stop_signal=SIGINT", "grace_s=20.0", "ready=None"} <= set(launch["parameters"])
    assert {"Ina219", "PsUtil"} <= {plugin["name"] for plugin in found["profilers"]}
    (psutil,) = (plugin for plugin in found["profilers"] if plugin["name"] == "PsUtil")
    assert psutil["package"] == "robot-runner"
    assert [(measure["name"], measure["unit"]) for measure in psutil["measures"]] == [("CPU", "%"), ("Memory", "%")]
    assert "rate_hz=10.0" in psutil["parameters"]
    assert psutil["findings"] == []
    assert psutil["summary"].startswith("Measures CPU and memory")


@pytest.mark.long
@pytest.mark.parametrize(
    ("value", "problem"),
    [
        ("nowhere_at_all:Meter", "the profiler cannot be imported: ModuleNotFoundError"),
        ("robot_runner.plugins.profilers:Meter", "the profiler cannot be imported: AttributeError"),
        ("robot_runner.core.errors:Finding", "is not a Profiler"),
    ],
)
def test_a_broken_plugin_is_a_finding_and_hides_no_other(
    robot_runner: Callable, monkeypatch: pytest.MonkeyPatch, value: str, problem: str
) -> None:
    everything = (_installed("Meter", value), *installed_plugins())
    monkeypatch.setattr(plugins, "installed_plugins", lambda: everything)
    answer = robot_runner("plugins")
    assert answer.code == 0
    assert "  Meter  stranger 2.1\n" in answer.out
    assert problem in answer.out
    assert "fix: " in answer.out
    assert "  PsUtil  " in answer.out
    meter = robot_runner("plugins", "--json").json["profilers"][0]
    assert problem in meter["findings"][0]["problem"]


def test_a_plugin_whose_name_another_one_has_is_told_to_be_found_by_its_class_alone(
    robot_runner: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    theirs = _installed("PsUtil", "robot_runner.plugins.profilers:Rapl")
    monkeypatch.setattr(plugins, "installed_plugins", lambda: (*installed_plugins(), theirs))
    answer = robot_runner("plugins")
    assert answer.out.count("warning: profiler PsUtil (robot_runner.plugins.profilers:Rapl, of stranger 2.1)") == 1
    assert "by this name, that of robot-runner is found" in answer.out
    assert "robot_runner.plugins.profilers:Rapl" in answer.out.partition("fix: ")[2]
    assert answer.out.count("Energy of all processor packages") == 2  # it is described all the same


def test_a_plugin_that_cannot_be_looked_at_is_a_finding_too(
    robot_runner: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    def load(_: EntryPoint) -> type:
        raise RuntimeError("a licence is missing")

    monkeypatch.setattr(plugins, "installed_plugins", lambda: (_installed("Meter", "meters:Meter"),))
    monkeypatch.setattr(plugins, "load_plugin", load)
    answer = robot_runner("plugins")
    assert answer.code == 0
    assert "the plugin cannot be described: RuntimeError: a licence is missing" in answer.out
    assert "Systems\n  none is installed\n" in answer.out


def test_parameters_are_written_as_they_are_typed() -> None:
    class Meter:
        def __init__(self, port: str, *rest: int, rate_hz: float = 10.0, **more: str) -> None: ...

    written = [plugins._written(each) for each in parameters_of(Meter).values()]
    assert written == ["port", "*rest", "rate_hz=10.0", "**more"]


def test_what_a_plugin_prints_at_its_import_is_no_part_of_the_json(
    robot_runner: Callable, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "printing_meter.py").write_text(
        "print('a driver was loaded')\nfrom robot_runner.plugins import Profiler\nclass Meter(Profiler): pass\n",
        "utf-8",
    )
    monkeypatch.syspath_prepend(tmp_path)
    printing = _installed("Meter", "printing_meter:Meter")
    monkeypatch.setattr(plugins, "installed_plugins", lambda: (printing,))
    monkeypatch.setattr(doctor, "installed_plugins", lambda *_: (printing,))
    for command in ("plugins", "doctor"):
        monkeypatch.delitem(sys.modules, "printing_meter", raising=False)
        answer = robot_runner(command, "--json")
        assert "Meter" in json.dumps(answer.json)
        assert "a driver was loaded" in answer.err
