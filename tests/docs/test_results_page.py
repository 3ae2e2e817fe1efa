"""The page of what is on disk names what may be there, and R reads the run table as the pages say."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from robot_runner.cli.main import main
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.record_shapes import RECORDS

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "results.md").read_text(encoding="utf-8")
STUDY = """
from robot_runner import ExperimentConfig, Factor, RunProcess, RunTableModel


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "basic_experiment"
    run_process = RunProcess.IN_PROCESS

    def create_run_table(self):
        tasks = Factor("Task", ["Computation", "Video", "Network"])
        return RunTableModel([tasks], repetitions=3, data_columns=["Energy"], warm_up=2)

    def populate_run_data(self, context):
        return {"Energy": len(context.combination["Task"]) + context.run_number / 10}
"""


def test_each_file_of_an_experiment_is_named() -> None:
    folder = ExperimentFolder(Path())
    members = (getattr(folder, name) for name in dir(folder) if not name.startswith("_"))
    names = {path.name for path in members if isinstance(path, Path)}
    assert {
        name for name in names if name and not re.search(rf"(^  |`){re.escape(name)}[/ `]", PAGE, re.MULTILINE)
    } == set()


def test_each_kind_of_record_is_named() -> None:
    table = PAGE.partition("| kind | says |")[2].partition("\n\n")[0]
    assert set(RECORDS) <= set(re.findall(r"`(\w+)`", table))


def saved_by_a_spreadsheet(table: str) -> str:
    """Return a run table as Excel saves it: truth values in capitals, which R reads as logical values."""
    return table.replace(",True", ",TRUE").replace(",False", ",FALSE")


@pytest.mark.long
@pytest.mark.skipif(shutil.which("Rscript") is None, reason="R is not installed (Debian: apt install r-base-core)")
@pytest.mark.parametrize("saved", [str, saved_by_a_spreadsheet])
def test_r_leaves_out_warm_up_runs_and_excluded_runs_as_the_page_says(
    saved: Callable[[str], str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("study.py").write_text(STUDY, encoding="utf-8")
    assert main(["study.py", "--plain"]) == 0
    assert main(["exclude", "study.py", "r_2", "--reason", "somebody leaned on the robot"]) == 0
    table = Path("experiments/basic_experiment/run_table.csv")
    table.write_text(saved(table.read_text(encoding="utf-8")), encoding="utf-8")
    block = re.search(r"^```r\n(.*?)^```", (DOCS / "analysis.md").read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    assert block is not None
    Path("read.R").write_text(block[1] + '\ncat("left:", runs$run_id)\n', encoding="utf-8")
    ended = subprocess.run(["Rscript", "--vanilla", "read.R"], capture_output=True, text=True, check=True, timeout=60)
    assert ended.stdout.splitlines()[-1] == "left: r_1 r_3 r_4 r_5 r_6 r_7 r_8 r_9"
