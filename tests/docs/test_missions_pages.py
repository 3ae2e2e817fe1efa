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
    assert "warning: factor" not in said.out + said.err


@pytest.mark.long
def test_the_turtlebot3s_experiment_is_rehearsed_as_its_page_says(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = _config("your-turtlebot3.md", tmp_path)
    text = re.sub(r"(Ina219|PsUtil)\(.*\)", r"\1()", config.read_text(encoding="utf-8"))
    config.write_text(text, encoding="utf-8")
    words = [*("--set", "robot=simulated", "--set", f"results_output_path={tmp_path}"), "--set", "operation_type=AUTO"]
    assert main([str(config), "--plain", "--only", "r_1", *words]) == 0, capsys.readouterr().err
    with (tmp_path / "basic_experiment" / "run_table.csv").open(encoding="utf-8", newline="") as file:
        row = next(row for row in csv.DictReader(file) if row["status"] == "Done")
    assert all(float(row[measure]) for measure in ("CPU", "Memory", "Energy", "PoseError"))
    with next((tmp_path / "basic_experiment").rglob("trajectory.csv")).open(encoding="utf-8", newline="") as file:
        ahead = max(float(row["x_m"]) for row in csv.DictReader(file))
    said = re.search(r"it drives (\S+) m ahead", (DOCS / "your-turtlebot3.md").read_text(encoding="utf-8"))
    assert said is not None
    assert float(said[1]) == pytest.approx(ahead, abs=0.05)


@pytest.mark.long
def test_a_study_whose_run_failed_goes_on_as_its_page_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    config = _config("why-did-my-run-fail.md", tmp_path)
    assert main([str(config), "--plain"]) == 1
    config.write_text(config.read_text(encoding="utf-8").replace('{"hall": 3}', '{"hall": 3, "attic": 1}'), "utf-8")
    assert main([str(config), "--plain"]) == 2
    assert "--accept-changes" in capsys.readouterr().err
    assert main([str(config), "--plain", "--accept-changes"]) == 0
    kept = [tmp_path / "experiments" / "maps" / place / "config.py" for place in ("config", "earlier_configs/1")]
    assert ["attic" in path.read_text(encoding="utf-8").partition("class")[0] for path in kept] == [True, False]


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
