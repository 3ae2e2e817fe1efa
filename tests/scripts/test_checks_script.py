"""The one command that makes all checks takes every step, and fails when any of them did."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TOOLS = ("ruff", "mypy", "lint-imports", "python", "pytest", "shellcheck")
#: What tools do beside noting their call: the script that executes the tests is the real one, and calls pytest.
SUCCESS = {
    "python": '[ "$1" != scripts/execute_tests.py ] || exec .venv/bin/real-python "$@"',
    "pytest": "echo 1 passed in 1s",
}
#: `python -m pytest` finds this in the folder where it is called.
PYTEST = "import subprocess, sys\n\nsys.exit(subprocess.call(['.venv/bin/pytest', *sys.argv[1:]]))\n"


@pytest.fixture
def clone(tmp_path: Path) -> Path:
    """A folder with the script, and tools that note their calls and succeed."""
    tools = tmp_path / ".venv" / "bin"
    tools.mkdir(parents=True)
    (tmp_path / "scripts").mkdir()
    for script in ("checks.sh", "execute_tests.py"):
        shutil.copy(ROOT / "scripts" / script, tmp_path / "scripts")
    (tmp_path / "tests").mkdir()
    (tmp_path / "tests" / "test_nothing.py").touch()
    for tool in TOOLS:
        _write_tool(tmp_path, tool, SUCCESS.get(tool, "exit 0"))
    (tools / "real-python").symlink_to(sys.executable)
    (tmp_path / "pytest.py").write_text(PYTEST, encoding="utf-8")
    return tmp_path


def _write_tool(clone: Path, tool: str, script: str) -> None:
    program = clone / ".venv" / "bin" / tool
    program.write_text(f'#!/bin/sh\necho "{tool} $*" >>calls\n{script}\n', encoding="utf-8")
    program.chmod(0o755)


def _checks(clone: Path, which: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ["sh", "scripts/checks.sh", which], cwd=clone, capture_output=True, text=True, timeout=120, check=False
    )


def _tools_called(clone: Path) -> set[str]:
    return {line.split()[0] for line in (clone / "calls").read_text(encoding="utf-8").splitlines()}


def test_all_steps_are_taken(clone: Path) -> None:
    assert _checks(clone, "all").returncode == 0
    assert _tools_called(clone) == set(TOOLS)


def test_the_quick_checks_execute_no_tests(clone: Path) -> None:
    assert _checks(clone, "quick").returncode == 0
    assert _tools_called(clone) == {"ruff", "mypy", "lint-imports", "shellcheck"}


def test_types_are_checked_while_the_tests_are_executed(clone: Path) -> None:
    wait = "for _ in $(seq 1200); do [ -e {other} ] && echo 1 passed && exit 0; sleep 0.05; done; exit 1"
    for tool, other in (("pytest", "mypy"), ("mypy", "pytest")):
        _write_tool(clone, tool, f"touch begun-{tool}; {wait.format(other=f'begun-{other}')}")
    answer = _checks(clone, "all")
    assert answer.returncode == 0, answer.stdout
    assert "ok      types" in answer.stdout


@pytest.mark.parametrize("tool", TOOLS)
def test_any_step_that_fails_fails_the_whole_and_the_rest_is_still_done(clone: Path, tool: str) -> None:
    _write_tool(clone, tool, f"{SUCCESS.get(tool, ':')}\necho what went wrong; exit 1")
    answer = _checks(clone, "all")
    assert answer.returncode == 1
    assert "what went wrong" in answer.stdout
    assert answer.stdout.splitlines()[-1].startswith("Failed: ")
    assert _tools_called(clone) == set(TOOLS)
