"""The configs of the pages on missions are checked as a user would; the one that needs no real robot is executed."""

from __future__ import annotations

import csv
import re
from pathlib import Path

import pytest

from robot_runner.cli.main import main

DOCS = Path(__file__).parents[2] / "docs"


def _config(page: str, folder: Path) -> Path:
    """Write the config of a page into a folder."""
    blocks = re.findall(r"```python\n(.*?)```", (DOCS / page).read_text(encoding="utf-8"), re.DOTALL)
    path = folder / "config.py"
    path.write_text(next(block for block in blocks if "class RobotRunnerConfig" in block), encoding="utf-8")
    return path


@pytest.mark.parametrize("page", ["your-nav2-robot.md", "your-arm.md", "two-robots-at-once.md"])
def test_the_config_of_a_page_is_well_formed(page: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code = main(["check", str(_config(page, tmp_path)), "--set", "robot=simulated"])
    said = capsys.readouterr()
    assert code == 0, said.out + said.err


@pytest.mark.long
@pytest.mark.filterwarnings("ignore:.*multi-threaded:DeprecationWarning")
def test_two_robots_at_once_are_executed_as_the_page_says(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = [str(_config("two-robots-at-once.md", tmp_path)), "--plain", "--only", "r_1", "--only", "r_2"]
    assert main(["run", *words, "--set", f"results_output_path={tmp_path}"]) == 0, capsys.readouterr().out
    with (tmp_path / "convoy" / "run_table.csv").open(encoding="utf-8", newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["status"] == "Done"]
    assert {"alice.Distance", "bob.Duration", "bob.FinalError", "alice.Leg1"} <= set(rows[0])
    for row in rows:
        assert float(row["alice.Distance"]) == pytest.approx(2.0, abs=0.1)
    assert (tmp_path / "convoy" / "runs" / "r_1" / "Together" / "alice" / "trajectory.csv").exists()
