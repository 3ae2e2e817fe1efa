"""The set-up that every make target does first installs what is locked, or says what is wrong and what to do."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TOOLS = ("sh", "cat", "cksum", "cp", "dirname", "env", "flock", "grep", "id", "mkdir", "rm", "sed")
# A Python that makes an environment out of itself, and notes what its pip is asked to install.
WORKING = """\
case "$*" in
    "-m venv"*) mkdir -p .venv/bin && cp "$0" .venv/bin/python ;;
    "-m pip install"*) echo "$*" >>calls ;;
    *version*) echo 3.12 ;;
esac
"""


@pytest.fixture
def clone(tmp_path: Path) -> Path:
    """A folder with the set-up script, and a `bin` that holds the system's tools but no Python."""
    (tmp_path / "scripts").mkdir()
    (tmp_path / "bin").mkdir()
    shutil.copy(ROOT / "scripts" / "set_up.sh", tmp_path / "scripts")
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    shutil.copytree(ROOT / "requirements", tmp_path / "requirements")
    for tool in TOOLS:
        if found := shutil.which(tool):
            (tmp_path / "bin" / tool).symlink_to(found)
    return tmp_path


def _set_up(clone: Path, purpose: str = "demo", **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ["sh", "scripts/set_up.sh", purpose],
        cwd=clone,
        env={"PATH": str(clone / "bin"), **environment},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


def _python(clone: Path, name: str, script: str) -> None:
    program = clone / "bin" / name
    program.unlink(missing_ok=True)  # a link to the system's own program: writing through it would replace that
    program.write_text(f"#!/bin/sh\n{script}\n", encoding="utf-8")
    program.chmod(0o755)


def _installed(clone: Path) -> list[str]:
    """What pip was asked to install, call by call."""
    calls = (clone / "calls").read_text(encoding="utf-8").splitlines()
    return [call.partition("--progress-bar off ")[2] for call in calls]


PROJECT = "--no-index --no-deps --no-build-isolation --editable ."


@pytest.mark.parametrize("purpose", ["demo", "test"])
def test_what_is_locked_is_installed_and_nothing_else(clone: Path, purpose: str) -> None:
    _python(clone, "python3", WORKING)
    answer = _set_up(clone, purpose)
    assert answer.returncode == 0, answer.stderr
    assert _installed(clone) == [f"--no-deps --require-hashes --requirement requirements/{purpose}.txt", PROJECT]


@pytest.mark.parametrize(("purpose", "is_compiled"), [("demo", False), ("test", True)])
def test_what_is_installed_is_compiled_beforehand_for_the_tests_alone(
    clone: Path, purpose: str, is_compiled: bool
) -> None:
    _python(clone, "python3", WORKING)
    _set_up(clone, purpose)
    calls = (clone / "calls").read_text(encoding="utf-8").splitlines()
    assert {"--no-compile" not in call for call in calls} == {is_compiled}


def test_what_is_set_up_is_left_alone(clone: Path) -> None:
    _python(clone, "python3", WORKING)
    _set_up(clone, "test")
    before = _installed(clone)
    for purpose in ("test", "demo"):  # what the tests need includes what the demo needs
        assert (_set_up(clone, purpose).returncode, _set_up(clone, purpose).stderr) == (0, "")
    assert _installed(clone) == before


@pytest.mark.parametrize("changed", ["pyproject.toml", "requirements/demo.txt", "requirements/test.txt"])
def test_a_changed_lock_or_project_is_installed_anew(clone: Path, changed: str) -> None:
    _python(clone, "python3", WORKING)
    _set_up(clone)
    with (clone / changed).open("a", encoding="utf-8") as file:
        file.write("# changed\n")
    assert _set_up(clone).returncode == 0
    assert _installed(clone) == ["--no-deps --require-hashes --requirement requirements/demo.txt", PROJECT] * 2


def test_nothing_of_the_system_is_installed_where_that_is_not_wanted(clone: Path) -> None:
    _python(clone, "python3", 'case "$2" in *ensurepip*) exit 1 ;; *print*) echo 3.12 ;; esac')
    _python(clone, "id", "echo 0")
    _python(clone, "apt-get", "echo apt-get >>calls")
    answer = _set_up(clone, ROBOT_RUNNER_SYSTEM_PACKAGES="no")
    assert answer.returncode == 1
    assert "sudo apt install python3.12-venv" in answer.stderr
    assert not (clone / "calls").exists()


def test_without_a_python_it_says_how_to_get_one(clone: Path) -> None:
    answer = _set_up(clone)
    assert answer.returncode == 1
    assert "no Python 3.11 or newer was found" in answer.stderr
    assert "apt install python3" in answer.stderr
    assert not (clone / ".venv").exists()


def test_a_python_that_is_too_old_is_passed_over(clone: Path) -> None:
    _python(clone, "python3", "exit 1")
    assert "no Python 3.11 or newer was found" in _set_up(clone).stderr


def test_a_chosen_python_that_is_too_old_is_refused(clone: Path) -> None:
    _python(clone, "python3.9", "exit 1")
    answer = _set_up(clone, PYTHON="python3.9")
    assert answer.returncode == 1
    assert "PYTHON=python3.9 is not a Python 3.11 or newer" in answer.stderr


def test_a_missing_venv_module_is_named_by_its_package(clone: Path) -> None:
    _python(clone, "python3", 'case "$2" in *ensurepip*) exit 1 ;; *print*) echo 3.12 ;; esac')
    _python(clone, "id", "echo 1000")
    answer = _set_up(clone)
    assert answer.returncode == 1
    assert "sudo apt install python3.12-venv" in answer.stderr


def test_what_failed_is_shown_without_the_addresses_of_package_indexes(clone: Path) -> None:
    _python(clone, "python3", '[ "$1" = -m ] || exit 0; echo "no room left, says https://index.example/simple"; exit 1')
    answer = _set_up(clone)
    assert answer.returncode == 1
    assert "no room left" in answer.stderr
    assert "index.example" not in answer.stderr


def test_an_unknown_purpose_is_refused(clone: Path) -> None:
    answer = _set_up(clone, "everything")
    assert answer.returncode == 1
    assert "for demo or for test" in answer.stderr
