from __future__ import annotations

import importlib
import json
import subprocess
import sys

import pytest

DOORS = [
    "robot_runner",
    "robot_runner.analysis",
    "robot_runner.plugins",
    "robot_runner.plugins.profilers",
    "robot_runner.plugins.systems",
    "robot_runner.testing",
]

STUDY = """
from robot_runner import ExperimentConfig, Nonesuch
from robot_runner.analysis import analyse, load_results
from robot_runner.plugins.profilers import PsUtil

reveal_type(ExperimentConfig().attempts)
reveal_type(PsUtil(rate_hz=5).rate_hz)
results = load_results("experiments/basic_experiment")
reveal_type(results)
reveal_type(results.factors)
reveal_type(analyse(results).measure("Energy").test)
results.factor
"""

each_door = pytest.mark.parametrize("door", DOORS)


def modules_after(statement: str) -> set[str]:
    """Return the names of all modules that a fresh interpreter holds after a statement."""
    script = f"import json, sys; {statement}; print(json.dumps(list(sys.modules)))"
    answer = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=True)
    return set(json.loads(answer.stdout))


@pytest.mark.long
@each_door
def test_every_name_that_a_door_promises_is_behind_it(door):
    module = importlib.import_module(door)
    assert module.__all__ == sorted(module.__all__, key=lambda name: (name.islower(), name))
    for name in module.__all__:
        found = getattr(module, name)
        # A constant has no name of its own: it is called as its class is.
        assert (type(found).__name__.upper() if name.isupper() else found.__name__) == name
    assert set(module.__all__) <= set(dir(module))


@each_door
def test_a_name_that_is_not_behind_a_door_is_an_attribute_error(door):
    with pytest.raises(AttributeError, match="has no attribute 'Nonesuch'"):
        _ = importlib.import_module(door).Nonesuch


@each_door
def test_opening_a_door_imports_nothing_of_ours_behind_it(door):
    imported = {name for name in modules_after(f"import {door}") if name.startswith("robot_runner")}
    hinges = {"robot_runner.core", "robot_runner.core.doors"}
    if door == "robot_runner.analysis":  # whose extra may be missing
        hinges |= {"robot_runner.analysis.libraries", "robot_runner.core.errors"}
    assert imported <= {"robot_runner", "robot_runner.plugins", door, *hinges}


def test_a_star_imports_all_that_a_door_promises():
    names = {}
    exec("from robot_runner import *", names)  # noqa: S102 - a star import is for a module's top alone
    assert set(importlib.import_module("robot_runner").__all__) <= names.keys()


@pytest.mark.long
def test_type_checkers_see_what_a_door_promises_and_nothing_else(tmp_path):
    """The package says that it is typed, and is: what users write with it is no unknown."""
    pytest.importorskip("mypy")
    (tmp_path / "study.py").write_text(STUDY, encoding="utf-8")
    command = [sys.executable, "-m", "mypy", "--strict", "--cache-dir", "cache", "study.py"]
    said = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=200, check=False).stdout
    assert 'Module "robot_runner" has no attribute "Nonesuch"' in said
    assert '"Results" has no attribute "factor"' in said
    assert [line.rpartition("is ")[2] for line in said.splitlines() if "Revealed" in line] == [
        '"int"',
        '"float"',
        '"robot_runner.analysis.results.Results"',
        '"tuple[str, ...]"',
        '"robot_runner.analysis.statistics.tested.MeasureTest | None"',
    ], said
    assert "Found 2 errors in 1 file" in said


@pytest.mark.parametrize("plugin", ["systems.BasicTurtlebot3", "profilers.Ina219", "profilers.PsUtil"])
def test_a_built_in_plugin_needs_neither_numpy_nor_mujoco(plugin):
    kind, name = plugin.split(".")
    imported = modules_after(f"from robot_runner.plugins.{kind} import {name}; {name}()")
    assert imported & {"numpy", "mujoco", "pytest"} == set()
