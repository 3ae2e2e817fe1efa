"""`python -m benchmarks` executes what was asked for, and nothing else."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pytest

ROOT = Path(__file__).parents[2]


def _benchmarks(*names: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "benchmarks", *names]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60, check=False)


def test_an_unknown_benchmark_is_refused_and_the_known_ones_are_listed() -> None:
    answer = _benchmarks("cli_stat")
    assert answer.returncode == 2
    assert "no benchmark 'cli_stat'" in answer.stderr
    assert "cli_start" in answer.stderr


def test_a_table_shows_each_figure_beside_its_floor(
    capsys: pytest.CaptureFixture[str],
) -> None:
    from benchmarks.table import Row, print_table

    print_table("Start", [Row("help", "68 ms", "14 ms", "4.9", "7"), Row("memory", "12 MB")])
    lines = [line.split() for line in capsys.readouterr().out.splitlines() if line.strip(" ─")]
    assert lines[0] == ["Start"]
    assert lines[-2:] == [["help", "68", "ms", "14", "ms", "4.9", "7"], ["memory", "12", "MB"]]
