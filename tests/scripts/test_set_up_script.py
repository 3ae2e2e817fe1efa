"""The set-up that every make target does first says what is wrong and what to do, and leaves nothing behind."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TOOLS = ("sh", "cat", "cksum", "dirname", "flock", "grep", "id", "mkdir", "rm", "sed")


@pytest.fixture
def clone(tmp_path: Path) -> Path:
    """A folder with the set-up script, and a `bin` that holds the system's tools but no Python."""
    (tmp_path / "scripts").mkdir()
    (tmp_path / "bin").mkdir()
    shutil.copy(ROOT / "scripts" / "set_up.sh", tmp_path / "scripts")
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
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
