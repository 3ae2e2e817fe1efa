"""Bad input is refused with a place and a fix, by `check` as by `run`, and nothing on disk is touched."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Callable

CLASS = "class RobotRunnerConfig:"
FACTORS = 'Factor("Task", ["Video", "Network"])'


def table(arguments: str) -> str:
    return f"    def create_run_table(self):\n        return RunTableModel({arguments})\n"


#: What is wrong: keywords for `write_config`, and what is said of it.
BAD = {
    "two factors of one name": ({"table": table(f"[{FACTORS}, {FACTORS}]")}, "'Task' is given twice"),
    "two columns of one name": ({"table": table(f"[{FACTORS}], data_columns=['E', 'E']")}, "'E' is given twice"),
    "a column named like a factor": ({"table": table(f"[{FACTORS}], data_columns=['Task']")}, "name of a factor"),
    "no factors": ({"table": table("[]")}, "there are none"),
    "duplicate treatments": ({"table": table('[Factor("Task", ["Video", "Video"])]')}, "'Video' is given twice"),
    "a reserved name": ({"table": table('[Factor("Status", [1, 2])]')}, "has a column of that name already"),
    "a misspelt attribute": ({"body": "time_betwen_runs_in_ms = 5"}, "Did you mean 'time_between_runs_in_ms'?"),
    "a misspelt callback": ({"body": "def lunch_mission(self, context): ..."}, "Did you mean 'launch_mission'?"),
    "a wrong type": ({"body": "time_between_runs_in_ms = True"}, "the value is True, of type bool"),
    "a wrong choice": ({"body": "operation_type = 'semi'"}, "the value is 'semi', of type str"),
    "a callback that takes too much": ({"body": "def stop_run(self, a, b): ..."}, "cannot be called with a context"),
    "a callback without self": ({"body": "def stop_run(context): ..."}, "Write def stop_run(self, context)."),
    "a callback without any parameter": ({"body": "def stop_run(): ..."}, "Write def stop_run(self, context)."),
    "a lambda without self": ({"body": "before_run = lambda: print('x')"}, "before_run has no self"),
    "a run table without self": (
        {"table": "    def create_run_table():\n        return RunTableModel([])\n"},
        "Write self as its first parameter: def create_run_table(self).",
    ),
    "a results path below a file": ({"body": "results_output_path = Path(__file__)"}, "is not a folder"),
    "an unknown robot": ({"body": "robot = 'simulatd'"}, "Did you mean 'simulated'?"),
    "an error while loading": ({"body": "half = 1 / 0"}, "the config raised ZeroDivisionError while it was loaded"),
    "an exit while loading": ({"head": f"raise SystemExit(0)\n{CLASS}"}, "the config raised SystemExit"),
    "a module that is not there": ({"head": f"import nowhere_at_all\n{CLASS}"}, "Install the package"),
    "no Python": ({"head": "class RobotRunnerConfig(:", "table": ""}, "the file is not Python"),
    "no config class": ({"head": "class RobotRunerConfig:", "body": "x = 1", "table": ""}, "Rename the class"),
    "a class of any name that derives from nothing": (
        {"head": "class Study:", "body": "x = 1", "table": ""},
        "Rename the class Study to RobotRunnerConfig, or derive it: class Study(ExperimentConfig).",
    ),
    "a class that derives from one of another file": (
        {"head": "from lab import Study\nclass Mine(Study):", "body": "x = 1", "table": ""},
        "Rename the class Mine to RobotRunnerConfig.",
    ),
    "no run table": ({"table": ""}, "create_run_table"),
    "a run table that is none": (
        {"table": "    def create_run_table(self):\n        return 5\n"},
        "create_run_table returned 5",
    ),
}


def everything_in(folder: Path) -> dict[str, bytes | None]:
    return {str(path): path.read_bytes() if path.is_file() else None for path in sorted(folder.rglob("*"))}


def assert_refused(robot_runner: Callable, folder: Path, words: list[object], said: str) -> None:
    before = everything_in(folder)
    answer = robot_runner(*words)
    told = answer.out + answer.err
    assert answer.code == 2, told
    assert said in told
    errors = [line for line in told.splitlines() if line.startswith("error: ")]
    fixes = [line for line in told.splitlines() if line.startswith("  fix: ")]
    assert errors
    assert all(line.count(": ") >= 2 for line in errors), "each error has a place"
    assert len(fixes) >= len(errors), "each error has a fix"
    assert "Traceback" not in told
    assert everything_in(folder) == before


@pytest.mark.parametrize("command", ["check", "run"])
@pytest.mark.parametrize("what", BAD)
def test_it_is_refused(
    robot_runner: Callable, write_config: Callable[..., Path], tmp_path: Path, command: str, what: str
) -> None:
    settings, said = BAD[what]
    config = write_config(**settings)
    assert_refused(robot_runner, tmp_path, [command, config.name], said)


@pytest.mark.parametrize("command", ["check", "run", "plan", "status", "continue"])
def test_a_file_that_does_not_exist_is_refused(robot_runner: Callable, tmp_path: Path, command: str) -> None:
    (tmp_path / "experiment.py").write_text("", encoding="utf-8")
    assert_refused(robot_runner, tmp_path, [command, "experimnt.py"], "Did you mean experiment.py?")


@pytest.mark.parametrize("command", ["status", "report", "compare"])
def test_what_is_no_experiment_is_not_proposed_in_place_of_one(
    robot_runner: Callable, tmp_path: Path, command: str
) -> None:
    for name in ("plots", "notes", "lab/hall", "study"):
        (tmp_path / name).mkdir(parents=True)
    for name in ("lab/hall", "study"):
        (tmp_path / name / "manifest.json").write_text("{}")
    (tmp_path / "out.txt").write_text("")
    words = [command, "plts", *(["nots"] if command == "compare" else [])]
    told = robot_runner(*words).err
    assert told.count("fix: Choose one of: 'lab', 'study'.") == len(words) - 1
    assert "Did you mean 'study'?" in robot_runner(command, *["stduy"] * (len(words) - 1)).err
    for name in ("lab/hall", "study"):
        (tmp_path / name / "manifest.json").unlink()
    assert "fix: Name the folder of an experiment, or its config file." in robot_runner(*words).err


@pytest.mark.parametrize("command", ["check", "run", "plan"])
def test_setting_what_is_not_there_is_refused(
    robot_runner: Callable, write_config: Callable[..., Path], tmp_path: Path, command: str
) -> None:
    write_config()
    words = [command, "config.py", "--set", "robt=simulated", "--set", "attempts=many"]
    before = everything_in(tmp_path)
    answer = robot_runner(*words)
    assert answer.code == 2
    told = answer.out + answer.err
    assert "there is no static parameter 'robt'" in told
    assert "Did you mean 'robot'?" in told
    assert "'many' cannot be read" in told
    assert everything_in(tmp_path) == before


def test_a_setting_that_cannot_be_is_told_where_it_stands(robot_runner: Callable, write_config: Callable) -> None:
    write_config()
    assert "--set workers=foo: the value is " in robot_runner("check", "config.py", "--set", "workers=foo").out


def test_a_setting_beside_the_option_that_stands_for_it_is_refused(
    robot_runner: Callable, write_config: Callable[..., Path], tmp_path: Path
) -> None:
    write_config()
    for words in (["run"], ["queue", "add"]):
        words += ["config.py", "--set", "workers=2", "--workers", "3"]
        assert_refused(robot_runner, tmp_path, words, "--set workers is given, too")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
@pytest.mark.parametrize("command", ["check", "run"])
def test_an_unwritable_results_folder_is_refused(
    robot_runner: Callable, write_config: Callable[..., Path], tmp_path: Path, command: str
) -> None:
    (tmp_path / "locked").mkdir(mode=0o500)
    write_config("results_output_path = Path('locked')")
    assert_refused(robot_runner, tmp_path, [command, "config.py"], "cannot be written")


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="there is no /proc")
def test_a_results_folder_that_cannot_be_made_is_refused(
    robot_runner: Callable, write_config: Callable[..., Path], tmp_path: Path
) -> None:
    write_config("results_output_path = Path('/proc/nowhere')")  # not even by root
    assert_refused(robot_runner, tmp_path, ["run", "config.py"], "/proc")


def test_modules_beside_a_config_leave_no_byte_code(
    robot_runner: Callable, write_config: Callable[..., Path], tmp_path: Path
) -> None:
    (tmp_path / "neighbour_of_config.py").write_text("FACTOR = 1\n", encoding="utf-8")
    write_config("from neighbour_of_config import FACTOR\nattempts = 'three'")
    assert_refused(robot_runner, tmp_path, ["run", "config.py"], "the value is 'three', of type str")
