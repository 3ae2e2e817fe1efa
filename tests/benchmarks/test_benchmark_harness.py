"""`python -m benchmarks` executes what was asked for, and nothing else."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
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


@pytest.mark.long
def test_a_figure_is_judged_by_its_bounds_and_by_the_products_own_tests() -> None:
    from benchmarks.null_designs import NullDesign
    from benchmarks.statistics import _false_positives

    design = NullDesign((3, 2), 5)
    held = _false_positives(design, np.random.default_rng(1), 1000)
    assert held.holds
    assert held.row.ratio == "holds"
    assert held.row.bound == "3.5 to 6.5 %"
    missed = _false_positives(replace(design, bounds=(20.0, 30.0), why="a joke"), np.random.default_rng(1), 1000)
    assert not missed.holds
    assert (missed.row.ratio, missed.row.bound) == ("DOES NOT HOLD", "20 to 30 %: a joke")


@pytest.mark.long
def test_the_packing_that_is_measured_packs_all_files_of_a_sound_experiment(tmp_path: Path) -> None:
    from benchmarks.packing import make_folder, packed

    from robot_runner.replication.opening import open_package

    folder = make_folder(tmp_path / "packing", 1_000, runs=3)
    assert packed(folder, tmp_path / "packed.zip") > 0
    with open_package(tmp_path / "packed.zip") as package:
        assert [package.sizes[f"runs/r_{number}/Meter/samples.csv"] for number in (1, 2, 3)] == [1_000] * 3
