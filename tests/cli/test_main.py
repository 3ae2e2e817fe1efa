from __future__ import annotations

import os
import runpy
import shutil
import subprocess
import sys
from importlib.metadata import version
from typing import TYPE_CHECKING

import pytest

import robot_runner as robot_runner_package
from robot_runner.cli.commands import installed_commands
from robot_runner.cli.main import main

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

pytestmark = pytest.mark.filterwarnings("ignore:.*multi-threaded:DeprecationWarning")


def test_ctrl_c_while_the_program_is_imported_shows_no_traceback(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """As in a queue that has just begun an experiment."""

    class Interrupting:
        def find_spec(self, name: str, *_: object) -> None:
            if name == "robot_runner.cli.main":
                raise KeyboardInterrupt

    monkeypatch.delitem(sys.modules, "robot_runner.cli.main")
    monkeypatch.setattr(sys, "meta_path", [Interrupting(), *sys.meta_path])
    with pytest.raises(SystemExit) as ended:
        runpy.run_module("robot_runner", run_name="__main__")
    assert ended.value.code == 130
    assert capfd.readouterr().err == "interrupted\n"


@pytest.mark.parametrize("words", [[], ["-h"], ["--help"], ["help"]])
def test_help_names_every_command(robot_runner: Callable, words: list[str]) -> None:
    answer = robot_runner(*words)
    assert answer.code == 0
    assert all(f"  {name} " in answer.out for name in installed_commands())
    assert answer.err == ""


@pytest.mark.long
def test_the_exit_code_is_that_of_the_experiment_also_where_the_program_was_removed_meanwhile(tmp_path: Path) -> None:
    config, package = tmp_path / "study.py", tmp_path / "site" / "robot_runner"
    # Bytecode that another process is writing now has a name of its own, and may be gone before it is copied.
    shutil.copytree(*robot_runner_package.__path__, package, ignore=shutil.ignore_patterns("*.pyc.*"))
    config.write_text(
        f"""import shutil
from robot_runner import *

class RobotRunnerConfig(ExperimentConfig):
    experiment_name, results_output_path = "study", {str(tmp_path)!r}
    def create_run_table(self): return RunTableModel([Factor("Speed", [1, 2])])
    def launch_mission(self, context): shutil.rmtree({str(package)!r}, ignore_errors=context.combination["Speed"])
"""
    )
    ended = subprocess.run(
        [sys.executable, "-P", "-m", "robot_runner", str(config)],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(package.parent)},
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )
    assert "All 2 runs are done" in ended.stdout
    assert (ended.returncode, ended.stderr) == (0, "")


@pytest.mark.long
def test_python_that_a_relative_entry_of_path_has_found_is_found_from_each_folder(tmp_path: Path) -> None:
    config, told = tmp_path / "study.py", tmp_path / "told"
    config.write_text(f"import sys\nclass RobotRunnerConfig:\n    open({str(told)!r}, 'w').write(sys.executable)\n")
    folder, python = os.path.split(sys.executable)
    subprocess.run(
        [python, "-m", "robot_runner", "check", str(config)],
        executable=os.path.relpath(sys.executable, tmp_path),
        cwd=tmp_path,
        env={**os.environ, "PATH": os.path.relpath(folder, tmp_path)},
        stdout=subprocess.DEVNULL,
        check=False,
    )
    assert told.read_text() == sys.executable


@pytest.mark.parametrize("command", installed_commands())
@pytest.mark.parametrize("words", [["{}", "--help"], ["help", "{}"]])
def test_every_command_has_help_of_its_own(robot_runner: Callable, command: str, words: list[str]) -> None:
    answer = robot_runner(*(word.format(command) for word in words))
    assert answer.code == 0
    assert f"usage: robot-runner {command}" in answer.out
    assert "--debug" in answer.out


def test_help_has_no_colours_of_pythons_own_which_a_terminal_would_be_shown_as_text(
    robot_runner: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("NO_COLOR", "PYTHON_COLORS"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("FORCE_COLOR", "1")  # as from Python 3.14 on in each terminal
    assert "[1;" not in robot_runner("check", "--help").out


def test_help_imports_nothing_that_takes_time() -> None:
    slow = ["rich", "argparse", "importlib.metadata", "logging", "dataclasses", "inspect", "json", "pathlib", "typing"]
    code = (
        "import sys; from robot_runner.cli.main import main; main(['--help']);"
        f"print([name for name in {slow} if name in sys.modules], file=sys.stderr)"
    )
    # -S: what site imports for an editable installation is not ours.
    path = "import sys; sys.path[:] = " + repr(sys.path) + ";"
    answer = subprocess.run([sys.executable, "-S", "-c", path + code], capture_output=True, text=True, check=True)
    assert answer.stderr.strip() == "[]"


@pytest.mark.long
def test_an_experiment_without_a_robot_starts_without_what_only_robots_and_meters_need(
    write_config: Callable[..., Path],
) -> None:
    heavy = {"xmlrpc", "robot_runner.ros.graph_addresses", "robot_runner.measuring.devices"}
    program = f"""
import sys
from pathlib import Path
from robot_runner.core.config.preparation import prepare_or_refuse
prepare_or_refuse(Path({str(write_config())!r}))
print(*sorted({heavy} & set(sys.modules)))
"""
    done = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True, timeout=60)
    assert done.stdout.strip() == ""


def test_the_version_is_that_of_the_package(robot_runner: Callable) -> None:
    answer = robot_runner("--version")
    assert (answer.code, answer.out) == (0, f"robot-runner {version('robot-runner')}\n")


@pytest.mark.parametrize(
    ("words", "problem", "fix"),
    [
        (["chek"], "robot-runner: there is no command 'chek'", "Did you mean 'check'?"),
        (["STATUS"], "there is no command 'STATUS'", "Did you mean 'status'?"),
        (["qqq"], "there is no command 'qqq'", "Choose one of: demo, new, check"),
        (
            ["config-create", "mine"],
            "'config-create' is a command of the earlier tools",
            "Write one with `robot-runner new",
        ),
        (["prepare"], "'prepare' is a command of the earlier tools", "Nothing has to be prepared."),
        (["--versoin"], "robot-runner: there is no option '--versoin'", "Did you mean '--version'?"),
        (["check", "c.py", "--jsn"], "robot-runner check: there is no option '--jsn'", "Did you mean '--json'?"),
        (["run", "c.py", "--sett=robot=simulated"], "there is no option '--sett'", "Did you mean '--set'?"),
        (["run", "--", "c.py", "--only"], "'--only' stands behind '--', where nothing is an option", "Leave '--' out"),
        (["--set", "robot=simulated", "c.py"], "'--set' stands before what it is for", "Put options behind"),
        (["--json", "check", "c.py"], "'--json' stands before what it is for", "Put options behind"),
        (["--verion", "run", "c.py"], "there is no option '--verion'", "Did you mean '--version'?"),
        (["version"], "there is no command 'version'", "Did you mean '--version'?"),
        (["c.py", "--set", "robot", "simulated"], "'simulated' is one word too many", "Write --set name=value without"),
        (["c.py", "--set=robot", "simulated"], "'simulated' is one word too many", "Write --set name=value without"),
        (["check", "a.py", "b.py", "--set", "c=1"], "'b.py' is one word too many", "See `robot-runner check --help`."),
        (["check", "--set", "c=1", "a.py", "b.py"], "'b.py' is one word too many", "See `robot-runner check --help`."),
        (["run"], "robot-runner run: CONFIG is missing", "See `robot-runner run --help`."),
        (["plan", "a.py", "b.py"], "'b.py' is one word too many", "See `robot-runner plan --help`."),
        (["check", "c.py", "--set"], "argument --set: expected one argument", "See `robot-runner check --help`."),
        (["check", "c.py", "--set", "robot"], "--set: 'robot' is not an assignment", "Write --set name=value"),
    ],
)
def test_words_that_are_not_understood_are_one_problem_with_a_fix(
    robot_runner: Callable, words: list[str], problem: str, fix: str
) -> None:
    answer = robot_runner(*words)
    assert answer.code == 2
    assert answer.out == ""
    first, second = answer.err.splitlines()
    assert first.startswith("error: ")
    assert problem in first
    assert second.startswith(f"  fix: {fix}")


def test_a_config_that_is_named_without_its_ending_is_told(robot_runner: Callable, write_config: Callable) -> None:
    answer = robot_runner(write_config(name="study.py").stem)
    assert (answer.code, answer.err.splitlines()[1]) == (2, "  fix: Did you mean 'study.py'?")


def test_a_config_file_alone_is_executed(robot_runner: Callable, write_config: Callable[..., Path]) -> None:
    config = write_config("def populate_run_data(self, context): return {'Energy': 1.5}")
    answer = robot_runner(config, "--set", "experiment_name=short")
    assert answer.code == 0
    assert "All 4 runs are done" in answer.out
    assert (config.parent / "results" / "short" / "run_table.csv").exists()


def test_a_file_that_is_not_there_is_taken_for_a_config(robot_runner: Callable) -> None:
    answer = robot_runner("nowhere/experiment.py")
    assert answer.code == 2
    assert "nowhere/experiment.py: there is no such file" in answer.err


@pytest.mark.parametrize("words", [[], ["check"], ["status"]])
def test_a_config_that_is_a_link_to_itself_is_refused(robot_runner: Callable, tmp_path: Path, words: list[str]) -> None:
    (link := tmp_path / "study.py").symlink_to(link)
    answer = robot_runner(*words, link)
    assert (answer.code, "Too many levels of symbolic links" in answer.out + answer.err) == (2, True)


def test_words_come_from_the_command_line_where_none_are_given(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["robot-runner", "--version"])
    assert main() == 0
    assert capsys.readouterr().out.startswith("robot-runner ")


@pytest.mark.parametrize("words", [["{}"], ["status", "{}"], ["status", "{}.py"], ["stop", "{}/x"], ["check", "{}"]])
def test_a_name_that_no_file_can_have_is_refused(robot_runner: Callable, words: list[str]) -> None:
    assert robot_runner(*(word.format("a" * 300) for word in words)).code == 2


def test_the_home_of_nobody_is_refused(robot_runner: Callable) -> None:
    answer = robot_runner("status", "~nobody-of-this-name/results")
    assert (answer.code, "there is no such file or folder" in answer.err) == (2, True)


WITHOUT_RIGHTS = ["setpriv", "--bounding-set", "-dac_override,-dac_read_search", "--inh-caps", "-all"]


@pytest.mark.long
@pytest.mark.skipif(os.geteuid() == 0 and not shutil.which("setpriv"), reason="root may look into everything")
@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["status"], "there is no experiment here, and none is named"),
        pytest.param(["status", "."], "there is no experiment here", marks=pytest.mark.soak),
        (["status", "locked"], "the folder cannot be read: Permission denied"),
        pytest.param(["status", "locked/x"], "the folder cannot be read: Permission denied", marks=pytest.mark.soak),
        (["stop", "locked/x.py"], "the file cannot be read: Permission denied"),
    ],
)
def test_a_folder_that_may_not_be_looked_into_is_no_fault_of_ours(
    program: str, tmp_path: Path, words: list[str], said: str
) -> None:
    (tmp_path / "locked").mkdir(mode=0)
    command = [*(WITHOUT_RIGHTS if os.geteuid() == 0 else []), program, *words]
    answer = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (answer.returncode, said in answer.stderr) == (2, True), answer.stderr
