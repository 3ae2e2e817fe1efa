from __future__ import annotations

import importlib.util
import json
import os
import posix
import resource
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from robot_runner.cli.main import main

if TYPE_CHECKING:
    from collections.abc import Callable

pytestmark = pytest.mark.filterwarnings("ignore:.*multi-threaded:DeprecationWarning")


@pytest.mark.long
def test_what_is_written_can_be_executed_as_it_is(robot_runner: Callable, tmp_path: Path) -> None:
    texts = []
    for words, name, quoted in (
        ([], "experiment.py", "experiment.py"),
        (["my study.py"], "my study.py", "'my study.py'"),
    ):
        answer = robot_runner("new", *words)
        assert answer.code == 0
        assert f"{name} is written: 6 runs" in answer.out
        assert f"robot-runner check {quoted}" in answer.out
        text = (tmp_path / name).read_text("utf-8")
        assert f"robot-runner check {quoted} " in text
        texts.append(text.replace(quoted, "FILE"))
    assert texts[0] == texts[1], "so that one of them is executed for both"
    executed = robot_runner("my study.py")
    assert executed.code == 0
    assert "All 6 runs are done" in executed.out
    assert "  ! " not in executed.out, "nothing looks odd"
    assert "EnergyPerMeter " in executed.out
    assert (tmp_path / "experiments" / "my_experiment" / "runs" / "r_1" / "log.txt").exists()


def test_what_an_environment_lacks_to_execute_it_is_told(
    robot_runner: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    answer = robot_runner("new")
    assert (answer.code, (tmp_path / "experiment.py").exists()) == (0, True)
    assert "6 runs on the embedded robot. It cannot be executed here yet:" in answer.out
    assert "pip install 'robot-runner[sim]'" in answer.err


def test_nothing_is_left_of_a_file_for_which_the_disk_has_no_room(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    unlimited = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, unlimited[1]))  # as on a full disk
    try:
        assert main(["new"]) == 2
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, unlimited)
    said = capsys.readouterr().err
    assert "error: experiment.py: the file cannot be written: File too large" in said
    assert "fix: Raise the limit of a file's size" in said
    assert list(tmp_path.iterdir()) == []


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # of files that the interruption closes
@pytest.mark.parametrize("words", [[], ["--plugin", "profiler"]])
def test_wherever_it_is_interrupted_nothing_is_there_or_all_of_it(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, words: list[str]
) -> None:
    def written(at: int, folder: Path) -> dict[str, str]:
        folder.mkdir()
        monkeypatch.chdir(folder)
        calls = iter(range(1, at))

        def call_or_interrupt(_frame: object, event: str, function: object) -> None:
            is_writing = getattr(function, "__name__", "") in {"open", "mkdir", "write", "fsync", "close", "unlink"}
            if event == "c_return" and is_writing and next(calls, None) is None:
                sys.setprofile(None)
                raise KeyboardInterrupt

        sys.setprofile(call_or_interrupt)
        try:
            main(["new", *words])
        finally:
            sys.setprofile(None)
        return {str(file.relative_to(folder)): file.read_text("utf-8") for file in folder.rglob("*") if file.is_file()}

    monkeypatch.setattr(os, "fsync", posix.fsync)  # the true one, whose return is one of those
    whole = written(1000, tmp_path / "whole")
    outcomes = [written(at, tmp_path / str(at)) for at in range(1, 40)]
    assert all(outcome in ({}, whole) for outcome in outcomes)
    assert {} in outcomes
    assert whole in outcomes


def test_an_existing_file_is_never_overwritten(robot_runner: Callable, tmp_path: Path) -> None:
    (tmp_path / "experiment.py").write_text("mine", encoding="utf-8")
    answer = robot_runner("new")
    assert answer.code == 2
    assert "error: experiment.py: there is a file of this name already" in answer.err
    assert "fix: Choose another name" in answer.err
    assert (tmp_path / "experiment.py").read_text(encoding="utf-8") == "mine"


@pytest.mark.parametrize(
    ("name", "problem"),
    [
        ("nowhere/experiment.py", "the file cannot be written"),
        ("experiment.txt", "a config is a Python file"),
        (".", "Name it experiment.py."),
    ],
)
def test_a_name_that_cannot_be_is_refused(robot_runner: Callable, tmp_path: Path, name: str, problem: str) -> None:
    answer = robot_runner("new", name)
    assert answer.code == 2
    assert problem in answer.err
    assert list(tmp_path.iterdir()) == []


def test_the_new_config_is_clean_by_the_rules_of_the_house(robot_runner: Callable, tmp_path: Path) -> None:
    robot_runner("new")
    ruff = [sys.executable, "-m", "ruff", "check", "--isolated", "--select", "E,F,I,D,UP,B", "--ignore", "D203,D213"]
    command = [
        *ruff,
        "--line-length",
        "120",
        "--target-version",
        "py311",
        "--config",
        "lint.pydocstyle.convention='google'",
    ]
    answer = subprocess.run([*command, "experiment.py"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert answer.returncode == 0, answer.stdout


@pytest.mark.long
def test_a_command_works_as_it_is_printed_where_the_program_is_not_on_the_path(program: str, tmp_path: Path) -> None:
    anywhere = {**os.environ, "PATH": "/usr/bin:/bin"}
    told = subprocess.run([program, "new"], env=anywhere, cwd=tmp_path, capture_output=True, text=True, check=True)
    commands = dict(line.strip().split("  ", 1) for line in told.stdout.splitlines() if line.startswith("  "))
    for command in (commands["Check"], commands["Plan"]):
        subprocess.run(["sh", "-c", command.strip()], env=anywhere, cwd=tmp_path, capture_output=True, check=True)
    as_module = [sys.executable, "-m", "robot_runner", "new", "other.py"]
    told = subprocess.run(as_module, env=anywhere, cwd=tmp_path, capture_output=True, text=True, check=True)
    command = next(line for line in told.stdout.splitlines() if "Check" in line).partition("Check")[2].strip()
    subprocess.run(["sh", "-c", command], env=anywhere, cwd=tmp_path, capture_output=True, check=True)


@pytest.mark.long
def test_the_plugins_that_are_written_have_types_that_fit(robot_runner: Callable, tmp_path: Path) -> None:
    for kind in ("profiler", "system"):
        assert robot_runner("new", "--plugin", kind, str(tmp_path / f"lab_{kind}")).code == 0
    files = sorted(str(path) for path in tmp_path.glob("lab_*/lab_*.py"))
    assert len(files) == 2
    told = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", "--cache-dir", "cache", *files],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        timeout=200,
    )
    assert told.returncode == 0, told.stdout


@pytest.mark.long
def test_a_plugins_package_is_installed_found_by_its_name_tried_and_passes_its_own_tests(
    program: str, robot_runner: Callable, tmp_path: Path
) -> None:
    def call(*words: object, **more: str) -> str:
        environment = {**os.environ, **more}
        told = subprocess.run(
            [*map(str, words)], env=environment, cwd=tmp_path, capture_output=True, text=True, check=False
        )
        assert told.returncode == 0, told.stdout + told.stderr
        return told.stdout

    packages, site = [tmp_path / "lab-meter", tmp_path / "lab-robot"], tmp_path / "site"
    for kind, package, name in zip(("profiler", "system"), packages, ("LabMeter", "LabRobot"), strict=True):
        told = robot_runner("new", "--plugin", kind, package.name)
        assert f"the {kind} {name}, which works as it is" in told.out
    # Without hatchling here, pip builds in isolation and fetches it.
    isolation = ["--no-build-isolation", "--no-index"] if importlib.util.find_spec("hatchling") else []
    quiet = ["--quiet", "--disable-pip-version-check", "--no-input", "--no-deps"]
    call(sys.executable, "-m", "pip", "install", *isolation, *quiet, "--target", site, *packages)
    installed = {"PYTHONPATH": str(site)}
    listed = json.loads(call(program, "plugins", "--json", **installed))
    for kind, package, name, words, origin in (
        ("profiler", "lab-meter", "LabMeter", ("--seconds", "1"), "measured"),
        ("system", "lab-robot", "LabRobot", ("--set", "robot=simulated"), "simulated"),
    ):
        (found,) = [each for each in listed[f"{kind}s"] if each["name"] == name]
        assert (found["package"], found["findings"]) == (package, [])
        (measure,) = json.loads(call(program, "try", name, "--json", *words, **installed))["measures"].values()
        assert measure["value"] > 0
        assert measure["origin"] == origin
    tested = call(sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *packages, **installed)
    assert " passed" in tested
    rules = Path(__file__).parents[3] / "pyproject.toml"
    ignored = "D,S101,ANN,PLR6301,ARG,INP001,E501,I001,PLR2004"
    call(sys.executable, "-m", "ruff", "check", "--quiet", "--config", rules, "--extend-ignore", ignored, *packages)


def test_a_name_that_is_no_packages_is_refused_and_nothing_is_overwritten(
    robot_runner: Callable, tmp_path: Path
) -> None:
    refused = robot_runner("new", "--plugin", "profiler", "My Meter")
    assert refused.code == 2
    assert "Use lower-case letters" in refused.err
    (tmp_path / "my_robot").mkdir()
    there = robot_runner("new", "--plugin", "system")
    assert (there.code, "there is a file or folder of this name already" in there.err) == (2, True)
    assert list((tmp_path / "my_robot").iterdir()) == []
    assert robot_runner("new", "--plugin", "robot").code == 2


@pytest.mark.parametrize("name", ["class", "random", "lambda", "robots/json"])
def test_a_plugin_is_not_named_like_what_python_has_already(robot_runner: Callable, tmp_path: Path, name: str) -> None:
    refused = robot_runner("new", "--plugin", "profiler", name)
    assert refused.code == 2
    assert f"fix: Choose another name, such as my_{name.rpartition('/')[2]}." in refused.err
    assert list(tmp_path.iterdir()) == []
