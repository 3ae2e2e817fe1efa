"""What executes the tests forgets no file, tells of each test that fails, and keeps the processes small."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import warnings
from collections import Counter
from pathlib import Path

import pytest
from scripts.execute_tests import Answer, Batch, batches_of, main, ros2_batches_of

ROOT = Path(__file__).parents[2]
PASSES, FAILS = "def test_it() -> None:\n    assert True\n", "def test_it() -> None:\n    assert 1 == 2, 'no'\n"
NEVER = "import pytest\n\n\n@pytest.mark.soak\ndef test_it() -> None:\n    raise AssertionError\n"
FOR_ROS2 = """\
import os
from pathlib import Path

import pytest


def note(name):
    with Path("executed").open("a") as file:
        file.write(f"{name} {os.environ.get('HAS_RCLPY')}\\n")


@pytest.mark.ros2
def test_it():
    note("test_it")


@pytest.mark.ros2
@pytest.mark.soak
def test_for_long():
    raise AssertionError


def test_another():
    note("test_another")
"""
#: It takes part in what one of two processes makes, and the other finds.
SHARES = """\
import os
from pathlib import Path

from made_once import made_once


def test_it(tmp_path_factory):
    made = made_once(tmp_path_factory, "thing", lambda folder: (folder / "maker").write_text(str(os.getpid())))
    with Path("makers").open("a") as file:
        file.write(f"{(made / 'maker').read_text()} {os.getpid()}\\n")
"""


def write_tests(folder: Path, files: dict[str, str]) -> None:
    for name, text in files.items():
        path = folder / "tests" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    (folder / "pytest.ini").write_text(
        "[pytest]\nmarkers =\n soak\n ros2\naddopts = --import-mode=importlib\npythonpath = .\n"
    )


def execute(folder: Path, *words: str, by: tuple[str, ...] = ()) -> subprocess.CompletedProcess[str]:
    command = [*by, sys.executable, str(ROOT / "scripts" / "execute_tests.py"), "--processes", "2", *words]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120, check=False)


def test_each_test_file_is_in_one_batch_and_no_batch_has_files_of_two_rooms() -> None:
    batches = batches_of(ROOT / "tests")
    count = Counter(file for batch in batches for file in batch.files)
    assert set(count) == set((ROOT / "tests").rglob("test_*.py"))
    assert set(count.values()) == {1}
    assert all(len({file.relative_to(ROOT).parts[1] for file in batch.files}) == 1 for batch in batches)
    assert len({batch.name for batch in batches}) == len(batches)
    assert [batch.weight for batch in batches] == sorted((batch.weight for batch in batches), reverse=True)
    rooms = [batch.files[0].relative_to(ROOT).parts[1] for batch in batches]
    assert max(rooms.index(room) for room in ("firmware", "hostile", "page", "process")) < rooms.index("core")


def test_no_test_of_executions_imports_the_analysis() -> None:
    """A process that has imported it is five times as large, and each run of an experiment forks it twice."""
    large = re.compile(r"^(from|import) (matplotlib|pandas|scipy|robot_runner\.analysis)\b", re.MULTILINE)
    folders = [ROOT / "tests" / name for name in ("cli", "core/execution", "legacy", "notebook", "process", "subjects")]
    files = [file for folder in folders for file in folder.rglob("*.py")]
    assert len(files) > 100
    assert [file.name for file in files if large.search(file.read_text(encoding="utf-8"))] == []


def test_what_pytest_cannot_remove_of_earlier_sessions_fails_nothing() -> None:
    """Several processes of tests clear the same folders as they end, and a test's process may still write there."""
    what = "(rm_rf) error removing /tmp/garbage\n<class 'OSError'>: [Errno 39] Directory not empty: '/tmp/garbage'"
    warnings.warn(pytest.PytestWarning(what), stacklevel=1)


@pytest.mark.long
def test_what_fails_is_shown_and_the_rest_is_executed_and_counted(tmp_path: Path) -> None:
    write_tests(tmp_path, {"room/test_a.py": PASSES, "hall/test_b.py": FAILS, "shed/test_c.py": NEVER})
    answer = execute(tmp_path, "-m", "not soak")
    assert answer.returncode == 1, answer.stdout
    assert "ok      tests/room: 1 passed" in answer.stdout
    assert "FAILED  tests/hall: 1 failed" in answer.stdout
    assert "AssertionError: no" in answer.stdout
    assert "ok      tests/shed: 1 deselected" in answer.stdout
    assert len(re.findall(r"^  (?:ok    |FAILED)  tests/\w+: .*, from \d+ to \d+ s$", answer.stdout, re.MULTILINE)) == 3
    assert re.search(r"^\d+ s of processor time, \d+% of what was there$", answer.stdout, re.MULTILINE)
    assert re.fullmatch(r"1 failed, 1 passed, 1 deselected in \d+\.\d\ds", answer.stdout.splitlines()[-1])


@pytest.mark.long
@pytest.mark.parametrize(
    ("files", "words", "status"),
    [
        ({"room/test_a.py": PASSES}, (), 0),
        ({"room/test_a.py": "import no_such_module\n"}, (), 1),
        ({"room/test_a.py": "import os\n\n\ndef test_it():\n    os._exit(0)\n", "hall/test_b.py": PASSES}, (), 1),
        ({"room/test_a.py": NEVER}, ("-m", "not soak"), 1),
    ],
    ids=["all is well", "not importable", "ended by a test", "nothing executed"],
)
def test_only_tests_that_were_executed_and_passed_are_a_success(
    tmp_path: Path, files: dict[str, str], words: tuple[str, ...], status: int
) -> None:
    write_tests(tmp_path, files)
    assert execute(tmp_path, *words).returncode == status


def test_what_a_library_prints_while_python_ends_stands_behind_the_last_line_and_hides_it_not() -> None:
    output = "..  [100%]\n2 passed, 1 skipped in 0.03s\nThe following exception was never retrieved: 3 failed calls\n"
    answer = Answer(Batch("tests/room", ()), 0, output, (0.0, 1.0))
    assert (answer.is_good, answer.counts) == (True, {"passed": 2, "skipped": 1})
    assert answer.remarks == ["The following exception was never retrieved: 3 failed calls"]
    assert not Answer(Batch("tests/room", ()), 0, "..  [100%]\n", (0.0, 1.0)).is_good


@pytest.mark.long
def test_skipped_tests_are_told_with_their_reason(tmp_path: Path) -> None:
    skipped = "import pytest\n\n\ndef test_it():\n    pytest.skip('no robot here')\n"
    write_tests(tmp_path, {"room/test_a.py": PASSES, "room/test_b.py": skipped})
    answer = execute(tmp_path, "-ra")
    assert answer.returncode == 0
    assert "no robot here" in answer.stdout
    assert answer.stdout.splitlines()[-1].startswith("1 passed, 1 skipped in ")


@pytest.mark.long
def test_what_needs_rclpy_is_executed_by_the_python_that_has_it_and_nothing_else_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write_tests(tmp_path, {"room/test_a.py": FOR_ROS2, "room/test_b.py": PASSES, "hall/test_c.py": PASSES})
    python = tmp_path / "python"
    python.write_text(f'#!/bin/sh\nHAS_RCLPY=yes exec "{sys.executable}" "$@"\n')
    python.chmod(0o700)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("scripts.execute_tests._ROS2_PYTHON", python)
    monkeypatch.setattr(sys, "argv", ["execute_tests.py", "-m", "not soak", "--strict-markers"])
    assert main() == 0, capsys.readouterr().out
    said = capsys.readouterr().out
    assert "ok      tests/room (ROS 2): 1 passed, 2 deselected" in said
    assert "ok      tests/hall: 1 passed" in said
    assert sorted((tmp_path / "executed").read_text().splitlines()) == [
        "test_another None",
        "test_it None",
        "test_it yes",
    ]


def test_without_such_a_python_this_one_has_all_tests(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_tests(tmp_path, {"room/test_a.py": FOR_ROS2})
    monkeypatch.setattr("scripts.execute_tests._ROS2_PYTHON", tmp_path / "python")
    assert ros2_batches_of(tmp_path / "tests") == []
    (tmp_path / "python").touch()
    (batch,) = ros2_batches_of(tmp_path / "tests")
    assert [file.name for file in batch.files] == ["test_a.py"]


@pytest.mark.long
def test_what_is_made_once_is_made_by_one_process_for_all(tmp_path: Path) -> None:
    shutil.copy(ROOT / "tests" / "made_once.py", tmp_path)
    write_tests(tmp_path, {"room/test_a.py": SHARES, "hall/test_b.py": SHARES})
    answer = execute(tmp_path)
    assert answer.returncode == 0, answer.stdout
    makers, processes = zip(*(line.split() for line in (tmp_path / "makers").read_text().splitlines()), strict=True)
    assert len(set(processes)) == 2
    assert len(set(makers)) == 1


HEEDS = """\
import signal

import pytest


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP])
def test_it(number):
    assert signal.getsignal(number) is not signal.SIG_IGN
"""


@pytest.mark.long
def test_stop_signals_reach_what_tests_start_also_where_they_were_started_in_the_background(tmp_path: Path) -> None:
    write_tests(tmp_path, {"room/test_a.py": HEEDS})
    answer = execute(tmp_path, by=("sh", "-c", "trap '' INT HUP; exec \"$@\"", "sh"))
    assert answer.returncode == 0, answer.stdout
