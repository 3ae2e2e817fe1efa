"""A module that was edited after its import is executed as it was, and kept as it is: that is told."""

from __future__ import annotations

from importlib import import_module, reload
from pathlib import Path

import pytest

from robot_runner import run_experiment
from robot_runner.notebook.stale_modules import stale_names

STUDY = """
from functools import lru_cache
from unittest.mock import call
from robot_runner import ExperimentConfig, Factor, RunTableModel
from {name}_scale import scaled

OFFSET = 0


class Study(ExperimentConfig):
    experiment_name = "study"
    watch_machines = False
    gain = 2

    def populate_run_data(self, context):
        assert context is not None
        return {{"Way": scaled(self.gain * context.combination["Speed"]) + OFFSET}}

    @staticmethod
    @lru_cache
    def helps(value=frozenset((1, 2))):
        return [each for each in value if each > 1]

    @property
    def name(self):
        return "a name"

    def create_run_table(self):
        return RunTableModel([Factor("Speed", [1])], data_columns=["Way"])


Study.of = Study
"""
SCALE = "def scaled(value):\n    return value\n"


@pytest.mark.parametrize(
    ("file", "was", "becomes", "told"),
    [
        ("study", "", "", None),
        ("study", "OFFSET = 0", "# why\n\nOFFSET = 0", None),
        ("study", "OFFSET = 0", "OFFSET = 1", "OFFSET"),
        ("study", "gain = 2", "gain = 3", "gain"),
        ("study", "self.gain *", "2 * self.gain *", "Study.populate_run_data"),
        ("study", "each > 1", "each > 0", "Study.helps"),
        ("study", "a name", "another", "Study.name"),
        ("scale", "return value", "return -value", "scaled"),
    ],
)
def test_an_experiment_of_an_edited_module_tells_that_its_files_are_not_what_is_executed(
    file: str, was: str, becomes: str, told: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    name = f"edited_{abs(hash((file, becomes)))}"  # of its own, as a module is imported once
    paths = {"study": tmp_path / f"{name}.py", "scale": tmp_path / f"{name}_scale.py"}
    paths["study"].write_text(STUDY.format(name=name), "utf-8")
    paths["scale"].write_text(SCALE, "utf-8")
    module = import_module(name)
    path = paths[file]
    path.write_text(path.read_text("utf-8").replace(was, becomes), "utf-8")
    results = run_experiment(module.Study, folder=tmp_path)
    found = [each for each in results.findings if "in memory" in each.problem]
    assert [each.problem.split(" is not in memory")[0] for each in found] == ([told] if told else [])
    assert [each.where for each in found] == ([str(path)] if told else [])


def test_a_module_that_was_imported_again_is_what_its_file_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    path = tmp_path / "imported_again.py"
    (tmp_path / "imported_again_scale.py").write_text(SCALE, "utf-8")
    path.write_text(STUDY.format(name="imported_again"), "utf-8")
    module = import_module("imported_again")
    path.write_text(path.read_text("utf-8").replace("gain = 2", "gain = 30"), "utf-8")
    results = run_experiment(reload(module).Study, folder=tmp_path)
    assert results.rows[0]["Way"] == 30
    assert not [each for each in results.findings if "in memory" in each.problem]


#: What is in memory is not written literally, though the file is as it was.
CHANGING = """
from enum import Enum
from {package}.{name} import imported
parser = None
import json as parser


class Speed(float, Enum):
    FAST = 2


class Robot:
    made = 0

    def __init__(self):
        Robot.made += 1


Robot()
"""


def test_names_that_change_by_themselves_or_come_from_another_file_of_that_name_are_not_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    name, package = "changing_by_itself", tmp_path / "package_of_changing"
    package.mkdir()
    (package / f"{name}.py").write_text("def imported():\n    return 1\n", "utf-8")
    path = tmp_path / f"{name}.py"
    path.write_text(CHANGING.format(package=package.name, name=name), "utf-8")
    import_module(name)
    assert stale_names([path]) == {}
    path.write_text(path.read_text("utf-8").replace("FAST = 2", "FAST = 3"), "utf-8")
    assert stale_names([path]) == {path: "FAST"}
