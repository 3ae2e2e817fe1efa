from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from robot_runner.cli.commands import demo
from robot_runner.cli.templating import template
from robot_runner.core.errors import Finding

if TYPE_CHECKING:
    from collections.abc import Callable

pytestmark = pytest.mark.filterwarnings("ignore:.*multi-threaded:DeprecationWarning")


@pytest.fixture
def short_demo(monkeypatch: pytest.MonkeyPatch) -> None:
    """The demo with one repetition of a short mission."""
    shorter = template("demo_config.py").replace("range(1, 6)", "[1]")
    shorter = shorter.replace("BasicTurtlebot3()", "BasicTurtlebot3(sleep_s=1, drive_s=2, task_s=2, rotate_s=8)")
    monkeypatch.setattr(demo, "template", lambda _: shorter)


@pytest.mark.long
def test_the_papers_experiment_is_executed_and_shown(executed_demo: Path) -> None:
    said = (executed_demo / "answer.txt").read_text(encoding="utf-8")
    folder = executed_demo / "robot-runner-demo" / "basic_experiment"
    with (folder / "run_table.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 15
    assert {row["status"] for row in rows} == {"Done"}
    assert sorted((row["Task"], row["Repetition"]) for row in rows) == sorted(
        (task, repetition) for task in ("Computation", "Video", "Network") for repetition in "12345"
    )
    assert all(float(row[measure]) > 0 for row in rows for measure in ("CPU", "Memory", "Energy"))
    # The populated table, the means by task, where everything is, and what is next.
    shown = [line.split() for line in said.splitlines() if line.startswith("  r_")]
    assert [line[0] for line in shown] == [row["run_id"] for row in rows]
    means = [line.split() for line in said.splitlines() if line.endswith("█")]
    energies = {name: float(value) for name, value, *_ in means}
    assert min(energies, key=energies.__getitem__) == "Network"
    assert "Results  robot-runner-demo/basic_experiment/run_table.csv" in said
    assert "CPU, Memory, Energy: simulated, not measured" in said
    assert "robot-runner robot-runner-demo/demo.py" in said
    assert json.loads((folder / "manifest.json").read_text())["deviations"] == {}


@pytest.mark.long
@pytest.mark.usefixtures("short_demo")
def test_a_second_demo_has_a_folder_beside_the_first_and_the_same_energies_and_can_be_executed_again(
    robot_runner: Callable, tmp_path: Path
) -> None:
    tables = []
    for folder in ("robot-runner-demo", "robot-runner-demo-2", "robot-runner-demo-3"):
        assert robot_runner("demo").code == 0
        with (tmp_path / folder / "basic_experiment" / "run_table.csv").open(encoding="utf-8", newline="") as file:
            tables.append([(row["Task"], row["Energy"], row["CPU"]) for row in csv.DictReader(file)])
    assert tables[0] == tables[1] == tables[2]
    answer = robot_runner("robot-runner-demo/demo.py", "--set", "experiment_name=mine")
    assert answer.code == 0
    assert "All 3 runs are done" in answer.out


@pytest.mark.long
@pytest.mark.usefixtures("short_demo")
def test_a_folder_can_be_named(robot_runner: Callable, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "a_file").write_text("", encoding="utf-8")
    assert robot_runner("demo", "--folder", "empty").code == 0
    assert robot_runner("demo", "--folder", "a_file").code == 0
    assert robot_runner("demo", "--folder", tmp_path / "new" / "one").code == 0
    assert {path.name for path in tmp_path.iterdir()} == {"empty", "a_file", "a_file-2", "new"}
    assert (tmp_path / "new" / "one" / "demo.py").exists()
    assert (tmp_path / "a_file-2" / "basic_experiment" / "run_table.csv").exists()


def test_without_the_simulator_nothing_is_written(
    robot_runner: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    missing = [Finding.error("robot", "mujoco cannot be imported", "Install it.")]
    monkeypatch.setattr(demo, "link_findings", lambda _: missing)
    answer = robot_runner("demo")
    assert answer.code == 2
    assert "error: robot: mujoco cannot be imported" in answer.err
    assert list(tmp_path.iterdir()) == []


def test_the_current_folder_may_be_named_whether_it_is_empty_or_in_use(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert demo._fresh(Path()) == Path()
    (tmp_path / "notes.txt").touch()
    assert demo._fresh(Path()) == Path("robot-runner-demo")
    (tmp_path / "robot-runner-demo" / "demo.py").touch()
    assert demo._fresh(Path()) == Path("robot-runner-demo-2")
    (tmp_path / "below").mkdir()
    assert demo._fresh(Path("below/..")) == Path("below/../robot-runner-demo-2")
