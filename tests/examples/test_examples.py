"""Every example is executed, shortened where its mission is long."""

from __future__ import annotations

import csv
import json
import re
import subprocess
import time
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from tests.analysis.report.agreement import disagreements
from tests.command_line import PROGRAM

from robot_runner.analysis.report.writing import ReportFormat, write_report
from robot_runner.cli.main import main

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.command_line import Answer

pytestmark = pytest.mark.filterwarnings("ignore:.*multi-threaded:DeprecationWarning")

EXAMPLES = Path(__file__).parents[2] / "examples"

#: The paper's Listing 1, read from its PDF.
PRINTED = """\
# Import plugins
import plugins.systems.BasicTurtlebot3
import plugins.profilers.Ina219
import plugins.profilers.PsUtil
class RobotRunnerConfig:
    # Static parameters
    experiment_name: str = 'basic_experiment'
    required_ros_version: int = 1
    required_ros_distro: str = "melodic"
    operation_type: OperationType = OperationType.SEMI
    results_output_path: Path = Path('~/example_mission_results/')
    def __init__(self):
        # Events subscription
        EventSubscriptionController.subscribe_to_multiple_events([
            (RobotRunnerEvents.LAUNCH_MISSION, self.launch_mission),
        ])
    # Event callbacks
    def launch_mission(self, context: RobotRunnerContext) -> None:
    # Creation of the run table
    def create_run_table(self) -> List[Dict]:
        run_table = RunTableModel(
            factors = [
                Factor('Task', ['Computation', 'Video', 'Network']),
                Factor('Repetition', range(1, 6))],
            data_columns=['CPU', 'Memory', 'Energy']
        )
        run_table.create_experiment_run_table()
        run_table.randomize_runs_order()
        return run_table
"""

#: How each example is shortened, and how many runs it has then.
SETTINGS = {
    "listing_1": (["robot=simulated", "operation_type=auto"], 3),
    "basic_experiment": (["repetitions=1"], 3),
    "sorting_algorithms": (["largest=100"], 12),
    "speed_and_energy": (["repetitions=1"], 3),
    "two_rooms": (["repetitions=1", "task_s=0.5"], 5),
    "offloading": (["repetitions=1"], 10),
}


@pytest.fixture
def executed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., Path]:
    """Return what executes an example and returns its folder."""
    monkeypatch.chdir(tmp_path)

    def execute(name: str, *more: str) -> Path:
        settings = [*SETTINGS[name][0], f"results_output_path={tmp_path}", f"experiment_name={name}"]
        words = [word for setting in settings for word in ("--set", setting)]
        code = main([str(EXAMPLES / f"{name}.py"), *words, *more])
        said = capsys.readouterr()
        assert code == 0, said
        assert said.err == ""
        assert "  ! " not in said.out, "nothing looks odd"
        written = write_report(tmp_path / name, ReportFormat.JSON, output=tmp_path / "out")
        assert disagreements(json.loads(written.document.read_text(encoding="utf-8"))) == []
        return tmp_path / name

    return execute


def table_of(folder: Path) -> list[dict[str, str]]:
    with (folder / "run_table.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def assert_full(name: str, table: list[dict[str, str]]) -> None:
    assert len(table) == SETTINGS[name][1]
    assert {row["status"] for row in table} == {"Done"}
    assert "" not in [value for row in table for heading, value in row.items() if heading != "continue_at"]


def test_every_example_is_executed_here_and_listed_in_the_readme() -> None:
    assert {path.stem for path in EXAMPLES.glob("*.py")} == set(SETTINGS)
    readme = (EXAMPLES / "README.md").read_text(encoding="utf-8")
    assert set(re.findall(r"\[`(\w+)\.py`\]", readme)) == set(SETTINGS)


@pytest.mark.long
@pytest.mark.parametrize("name", ["basic_experiment", "sorting_algorithms", "speed_and_energy"])
def test_an_example_fills_its_run_table(name: str, executed: Callable[[str], Path]) -> None:
    assert_full(name, table_of(executed(name)))


def test_listing_1_stands_as_it_is_printed_with_nothing_added_but_imports_and_a_body() -> None:
    lines = (EXAMPLES / "listing_1.py").read_text(encoding="utf-8").splitlines()
    printed = PRINTED.splitlines()
    kept = iter(lines)
    assert [line for line in printed if line not in kept] == [], "each printed line, in its order"
    added = "\n".join(line for line in lines if line.strip() and line not in printed)
    body = added.partition("RunTableModel,\n)\n")[2]
    assert body.count("\n") == 1
    assert body.splitlines()[0].startswith("        # ")
    assert body.splitlines()[1].startswith("        print(")


@pytest.mark.long
def test_listing_1_is_refused_without_its_robot_and_says_what_to_do(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("ROS_VERSION", "ROS_DISTRO", "ROS_ROOT"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("robot_runner.ros.required_ros.installed_ros", lambda: None)  # Debian has one
    monkeypatch.setenv("HOME", str(tmp_path))
    assert main(["run", str(EXAMPLES / "listing_1.py")]) == 2
    said = capsys.readouterr().err
    assert "the experiment requires ROS 1 melodic" in said
    assert "--set robot=simulated" in said
    assert list(tmp_path.iterdir()) == []


@pytest.mark.long
def test_listing_1_is_executed_and_what_it_was_set_to_is_recorded_as_a_deviation(
    executed: Callable[..., Path],
) -> None:
    folder = executed("listing_1", "--only", "Repetition=1")
    planned = table_of(folder)
    table = [row for row in planned if row["Repetition"] == "1"]
    assert_full("listing_1", table)
    deviations = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))["deviations"]
    assert {"robot": "simulated", "operation_type": "auto"}.items() <= deviations.items()
    assert {row["Task"] for row in table} == {"Computation", "Video", "Network"}
    assert sorted(row["Repetition"] for row in planned) == sorted("12345" * 3)
    for row in table:
        log = (folder / "runs" / row["run_id"] / "log.txt").read_text(encoding="utf-8")
        assert log == f"{row['run_id']}: the mission with the task {row['Task']} is over\n"


@pytest.mark.long
def test_the_rooms_are_visited_one_after_the_other_and_one_without_network(executed: Callable[[str], Path]) -> None:
    table = table_of(executed("two_rooms"))
    assert_full("two_rooms", table)
    assert [row["Room"] for row in table] == ["laboratory"] * 3 + ["corridor"] * 2
    assert ("corridor", "Network") not in {(row["Room"], row["Task"]) for row in table}


@pytest.mark.long
def test_the_study_of_offloading_asks_waits_warms_up_and_fetches(
    robot_runner: Callable[..., Answer], tmp_path: Path
) -> None:
    """A person in another terminal, which is this process, answers each step; everything else goes by itself."""
    folder = tmp_path / "offloading"
    settings = [*SETTINGS["offloading"][0], f"results_output_path={tmp_path}", f"log={tmp_path / 'detections.log'}"]
    words = [word for setting in settings for word in ("--set", setting)]
    study = subprocess.Popen(
        [PROGRAM, str(EXAMPLES / "offloading.py"), *words],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        cwd=tmp_path,
    )
    answered = []
    deadline = time.monotonic() + 200
    try:
        while study.poll() is None and time.monotonic() < deadline:
            status = robot_runner("status", folder, "--json")
            if status.code == 0 and (waiting := status.json["waiting_for"]) is not None:
                answered.append(waiting["next_run"])
                robot_runner("continue", folder, "--answer", "Light=300")
            time.sleep(1)  # looking costs more of the processor than the study
    finally:
        study.kill()
        said = study.communicate()[0]
    assert study.returncode == 0, said
    table = table_of(folder)
    assert [row["run_id"] for row in table] == ["w_1", "r_1", "r_2", "r_3", "r_4", "w_2", "r_5", "r_6", "r_7", "r_8"]
    assert {row["status"] for row in table} == {"Done"}
    assert list(dict.fromkeys(answered)) == ["w_1", "w_2"], "once for each placement"
    assert [row["Light"] for row in table] == ["300.0", "", "", "", "", "300.0", "", "", "", ""]
    assert all(int(row["Detections"]) > 0 for row in table)
    energy = {row["Placement"]: float(row["Energy"]) for row in table}
    assert energy["Computation"] > energy["Network"]
    assert [len(list((folder / "runs" / row["run_id"] / "base").rglob("detections.log"))) for row in table] == [1] * 10
