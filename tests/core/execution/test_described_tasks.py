"""A run that is executed by a process which loads the config anew has the treatments that the run table tells."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from robot_runner.core.config.preparation import prepare_or_refuse
from robot_runner.core.design.factor import Factor
from robot_runner.core.design.revision import Revision
from robot_runner.core.errors import ConfigError
from robot_runner.core.execution.task import RunTask
from robot_runner.core.execution.worker import describe_revisions, described_task, restore_revisions, task_of

if TYPE_CHECKING:
    from pathlib import Path

CONFIG = """
from robot_runner import ExperimentConfig, Factor, RunProcess, RunTableModel


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"

    def create_run_table(self):
        return RunTableModel([Factor("World", {worlds!r})])
"""


def _ordered(folder: Path, here: list[object], there: list[object], treatment: object) -> object:
    """Return the treatment of a run that was ordered by one process, in another one, whose config has other worlds."""
    path = folder / "config.py"
    path.write_text(CONFIG.format(worlds=here), encoding="utf-8")
    orders = prepare_or_refuse(path, {})
    path.write_text(CONFIG.format(worlds=there), encoding="utf-8")
    executes = prepare_or_refuse(path, {})
    task = RunTask("r_1", 1, 3, 1, {"World": treatment}, 1, 1, 1)
    described = json.loads(json.dumps(described_task(orders, task)))
    assert replace(task_of(executes, described), combination={}) == replace(task, combination={})
    return task_of(executes, described).combination["World"]


def test_a_treatment_is_the_same_whatever_order_a_set_or_a_folder_has_there(tmp_path: Path) -> None:
    assert _ordered(tmp_path, ["lab", "hall", "1"], ["hall", "1", "lab"], "lab") == "lab"
    assert _ordered(tmp_path, [0.1, 2, True], [True, 0.1, 2], 2) == 2


def test_a_treatment_that_another_process_does_not_have_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"treatment '0\.25' is not there when the config is loaded again"):
        _ordered(tmp_path, [0.25, 0.5], [0.75, 0.5], 0.25)


def test_a_revision_has_the_work_tree_that_was_made_for_it_whatever_order_a_set_has_there() -> None:
    here, there = (Factor("Planner", [Revision("nav", name) for name in names]) for names in ("ab", "ba"))
    for each in here.treatments:
        each.prepare(commit=f"commit of {each.name}", path=f"tree of {each.name}")
    restore_revisions([there], json.loads(json.dumps(describe_revisions([here]))))
    assert [(each.commit, each.path) for each in there.treatments] == [
        ("commit of b", "tree of b"),
        ("commit of a", "tree of a"),
    ]


@pytest.mark.long
def test_a_fresh_interpreter_is_started_with_the_options_of_the_first_one(tmp_path: Path) -> None:
    told = """
    run_process = RunProcess.SPAWN

    def create_run_table(self):
        return RunTableModel([Factor("World", ["lab", "hall"])], data_columns=["Debug", "Options"])

    def populate_run_data(self, context):
        import sys
        return {"Debug": __debug__, "Options": f"{sys.warnoptions} {sys._xoptions}"}
"""
    (tmp_path / "config.py").write_text(CONFIG.format(worlds=[]) + told, encoding="utf-8")
    options = ["-O", "-W", "error::UserWarning", "-X", "dev"]
    command = [sys.executable, *options, "-m", "robot_runner", "run", "config.py", "--set", "robot=none"]
    subprocess.run(command, cwd=tmp_path, check=True, timeout=60)
    with next(tmp_path.rglob("run_table.csv")).open(encoding="utf-8", newline="") as file:
        values = [(row["Debug"], row["Options"]) for row in csv.DictReader(file)]
    assert values == [("False", "['default', 'error::UserWarning'] {'dev': True}")] * 2
