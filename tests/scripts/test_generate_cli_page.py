"""The page of the command line is what the program says, and a page that is not is noticed."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from robot_runner.cli.commands import installed_commands

ROOT = Path(__file__).parents[2]
SCRIPT = Path("scripts") / "generate_cli_page.py"


def generate(root: Path, *words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(root / SCRIPT), *words]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


@pytest.mark.long
def test_the_page_in_the_repository_is_current() -> None:
    answer = generate(ROOT, "--check")
    assert answer.returncode == 0, answer.stdout


@pytest.mark.long
def test_a_page_that_is_not_current_fails_and_is_written_anew(tmp_path: Path) -> None:
    for folder in ("scripts", "docs"):
        (tmp_path / folder).mkdir()
    shutil.copy(ROOT / SCRIPT, tmp_path / SCRIPT)
    page = tmp_path / "docs" / "cli.md"
    assert generate(tmp_path, "--check").returncode == 1, "there is none"
    page.write_text("# Command line\n", encoding="utf-8")
    stale = generate(tmp_path, "--check")
    assert stale.returncode == 1
    assert "not current" in stale.stdout
    assert page.read_text(encoding="utf-8") == "# Command line\n", "--check writes nothing"
    assert generate(tmp_path).returncode == 0
    assert page.read_text(encoding="utf-8") == (ROOT / "docs" / "cli.md").read_text(encoding="utf-8")


def test_the_page_has_a_section_for_every_command_and_every_option() -> None:
    page = (ROOT / "docs" / "cli.md").read_text(encoding="utf-8")
    assert [line for line in page.splitlines() if line.startswith("## robot-runner ")] == [
        f"## robot-runner {command}" for command in installed_commands()
    ]
    assert "| `--set NAME=VALUE` | " in page
    assert "robot-runner new [FILE] [--plugin KIND] [--debug]" in page
    assert "%(" not in page, "a default that argparse was to fill in"
    blocks = re.findall(r"^```text\n(.*?)^```", page, re.MULTILINE | re.DOTALL)
    assert max(len(line) for block in blocks for line in block.splitlines()) <= 100, "wider than a page shows"


def test_an_option_is_shown_with_the_value_that_it_takes_and_in_brackets_only_where_it_may_be_left_out() -> None:
    page = (ROOT / "docs" / "cli.md").read_text(encoding="utf-8")
    assert "robot-runner exclude [EXPERIMENT] RUNS ... --reason TEXT [--set NAME=VALUE]" in page
    assert "[--turbo {on,off}]" in page
    assert "| `--licence LICENCE` | " in page
    assert "[--hashes, --no-hashes]" in page, "takes none"
