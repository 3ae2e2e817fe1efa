from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from robot_runner.core.storage.lock import ExperimentLock

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


def test_it_says_what_is_fine(robot_runner: Callable, write_config: Callable[..., Path]) -> None:
    write_config()
    answer = robot_runner("check", "config.py", "--set", "attempts=3")
    assert answer.code == 0
    assert answer.err == ""
    lines = [line.split(maxsplit=1) for line in answer.out.splitlines()]
    facts = {line[0]: line[1] for line in lines[1:]}
    assert lines[0] == ["config.py", "can be executed."]
    assert facts == {
        "Experiment": "trial",
        "Runs": "4 runs: Task (2) x 2 repetitions",
        "Order": "as written",
        "Plugins": "none",
        "Measures": "Energy",
        "Robot": "none",
        "Mode": "AUTO",
        "Results": "results/trial",
        "Set": "attempts=3",
    }


def test_columns_of_qualities_are_told_as_one(robot_runner: Callable, write_config: Callable[..., Path]) -> None:
    write_config()
    for command in ("check", "plan"):
        answer = robot_runner(command, "config.py", "--set", "quality_columns=true")
        (line,) = [line for line in answer.out.splitlines() if line.split()[:1] == ["Measures"]]
        assert line.split(maxsplit=1)[1] == "Energy; each with its quality"


def test_all_findings_are_told_and_errors_come_first(robot_runner: Callable, write_config: Callable[..., Path]) -> None:
    table = """\
    def create_run_table(self):
        idle = [{"Task": "Video"}, {"Task": "Video"}]
        return RunTableModel([Factor("Task", ["Video", "Network"])], exclude_combinations=idle)
    """
    write_config("attempts = 0\ngrace_in_s = 'long'", table=table)
    answer = robot_runner("check", "config.py")
    assert answer.code == 2
    severities = [line.partition(":")[0] for line in answer.out.splitlines() if not line.startswith(" ")]
    assert severities == ["error", "error", "warning", "config.py is refused"]
    assert answer.out.endswith("config.py is refused: 2 errors, 1 warning.\n")


def test_a_warning_does_not_refuse(robot_runner: Callable, write_config: Callable[..., Path]) -> None:
    table = """\
    def create_run_table(self):
        idle = [{"Task": "Video"}, {"Task": "Video"}]
        return RunTableModel([Factor("Task", ["Video", "Network"])], exclude_combinations=idle)
    """
    write_config(table=table)
    answer = robot_runner("check", "config.py")
    assert answer.code == 0
    assert "config.py can be executed, with 1 warning." in answer.out
    assert "1 run: Task (2), 1 combination excluded" in answer.out


def test_json_holds_everything(robot_runner: Callable, write_config: Callable[..., Path], tmp_path: Path) -> None:
    write_config("print('while it was loaded')\nrobot = None")
    answer = robot_runner("check", "config.py", "--json", "--set", "operation_type=semi")
    assert answer.code == 0
    assert "while it was loaded" in answer.err
    assert answer.json == {
        "config": "config.py",
        "is_executable": True,
        "findings": [],
        "experiment": {
            "name": "trial",
            "folder": str(tmp_path / "results" / "trial"),
            "robot": None,
            "operation_type": "semi",
            "plugins": [],
            "measures": [{"name": "Energy", "unit": "", "owner": "config"}],
            "set": {"operation_type": "semi"},
            "repeat_until": None,
            "run_count": 4,
            "factors": {"Task": ["Video", "Network"]},
            "repetitions": 2,
            "order": {"is_randomised": False, "blocks": None, "seed": 1},
        },
    }


def test_json_of_a_refused_config_has_its_findings(robot_runner: Callable, write_config: Callable[..., Path]) -> None:
    write_config("attempts = 0")
    answer = robot_runner("check", "config.py", "--json")
    assert answer.code == 2
    assert answer.json["is_executable"] is False
    assert answer.json["experiment"] is None
    assert answer.json["findings"] == [
        {
            "severity": "error",
            "where": "config.py, RobotRunnerConfig.attempts",
            "problem": "the value is 0, of type int",
            "fix": "It must be a whole number, 1 or more.",
        }
    ]


@pytest.fixture
def executed(robot_runner: Callable, write_config: Callable[..., Path]) -> Path:
    config = write_config("def populate_run_data(self, context): return {'Energy': 1.5}")
    assert robot_runner("run", "config.py").code == 0
    assert robot_runner("check", "config.py").code == 0, "which goes on where it was"
    return config


@pytest.mark.long
@pytest.mark.parametrize(
    ("was", "becomes"),
    [
        ('"Network"', '"Other"'),
        ("repetitions=2", "repetitions=3"),
        ("'Energy': 1.5", "'Energy': 1.6"),
    ],
)
def test_a_changed_config_is_refused_as_its_execution_is(
    robot_runner: Callable, executed: Path, was: str, becomes: str
) -> None:
    assert was in executed.read_text()
    executed.write_text(executed.read_text().replace(was, becomes))
    assert_refused_alike(robot_runner, executed)


@pytest.mark.long
@pytest.mark.parametrize("name", ["run_table.csv", "journal.jsonl", "manifest.json"])
def test_an_experiment_whose_files_were_changed_by_hand_is_refused_as_its_execution_is(
    robot_runner: Callable, executed: Path, name: str
) -> None:
    file = executed.parent / "results" / "trial" / name
    edited = {"run_table.csv": file.read_text().replace("1.5", "1.7"), "manifest.json": '{"format": 1}'}
    file.write_text(edited.get(name, "damaged\n"))
    assert_refused_alike(robot_runner, executed)


def assert_refused_alike(robot_runner: Callable, config: Path) -> None:
    """Assert that `check` has each error of an execution, and has changed nothing."""
    before = {path: path.read_bytes() for path in config.parent.rglob("*") if path.is_file()}
    checked = robot_runner("check", "config.py")
    assert before == {path: path.read_bytes() for path in config.parent.rglob("*") if path.is_file()}
    refused = robot_runner("run", "config.py")
    assert (checked.code, refused.code) == (2, 2)
    errors = [line for line in refused.err.splitlines() if line.startswith("error:")]
    assert errors
    assert errors == [line for line in checked.out.splitlines() if line.startswith("error:")]


def test_of_a_table_by_hand_the_strange_treatments_are_told_before_the_first_run(
    robot_runner: Callable, write_config: Callable[..., Path], tmp_path: Path
) -> None:
    write_config()
    write_by_hand(tmp_path, "run_id,Task\nfirst,Vidoe\nsecond,Network\n")
    answer = robot_runner("check", "config.py")
    assert (answer.code, answer.err) == (0, "")
    assert "run_table.csv, line 2, column 'Task': 'Vidoe' is not a treatment of factor 'Task'" in answer.out
    assert "config.py can be executed, with 1 warning." in answer.out
    assert ["Runs", "as", "in", "results/trial/run_table.csv,", "in", "its", "order"] in map(
        str.split, answer.out.splitlines()
    )
    assert "as written" not in answer.out
    assert not (tmp_path / "results" / "trial" / "journal.jsonl").exists()


@pytest.mark.long
def test_a_table_by_hand_with_which_a_plugin_cannot_be_built_is_refused_as_its_execution_is(
    robot_runner: Callable, write_config: Callable[..., Path], tmp_path: Path
) -> None:
    table = """\
    robot = "simulated"
    plugins = [BasicTurtlebot3(speed=treatment("Speed"), task="video")]

    def create_run_table(self):
        return RunTableModel([Factor("Speed", [0.1, 0.2])])
    """
    config = write_config(table=table)
    imports = "from robot_runner.plugins import treatment\nfrom robot_runner.plugins.systems import BasicTurtlebot3\n"
    config.write_text(imports + config.read_text())
    write_by_hand(tmp_path, "run_id,Speed\nfirst,0.1\nsecond,2.5\n")
    assert_refused_alike(robot_runner, config)


def write_by_hand(folder: Path, table: str) -> None:
    """Write the run table of an experiment that has not begun."""
    path = folder / "results" / "trial" / "run_table.csv"
    path.parent.mkdir(parents=True)
    path.write_text(table)


@pytest.mark.long
def test_of_an_experiment_that_is_being_executed_the_files_are_left_alone(
    robot_runner: Callable, executed: Path
) -> None:
    folder = executed.parent / "results" / "trial"
    with ExperimentLock(folder / ".lock"):
        (folder / "run_table.csv").write_text("half writ")
        assert robot_runner("check", "config.py").code == 0
