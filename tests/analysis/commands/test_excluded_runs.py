"""Excluded runs from the command line to the report, the package and the replication."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import pandas as pd
import pytest

from robot_runner.analysis import load_results
from robot_runner.replication.explanation import explain_run

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

pytestmark = pytest.mark.filterwarnings("ignore:.*multi-threaded:DeprecationWarning")

BODY = """
def populate_run_data(self, context):
    return {"Energy": context.run_number + (100 if context.run_number == 2 else 0)}
"""
TABLE = """\
    def create_run_table(self):
        factors = [Factor("Task", ["Video", "Network"])]
        return RunTableModel(factors, repetitions=4, data_columns=["Energy"], shuffle=True, seed=5)
"""
WHY = "somebody leaned on the robot"


@pytest.fixture
def folder(robot_runner: Callable, write_config: Callable[..., Path], tmp_path: Path) -> Path:
    write_config(BODY, table=TABLE)
    assert robot_runner("run", "config.py").code == 0
    return tmp_path / "results" / "trial"


def reported(robot_runner: Callable, folder: Path) -> Any:
    assert robot_runner("report", folder, "--format", "json", "--figures", "none").code == 0
    return json.loads((folder / "report" / "report.json").read_text(encoding="utf-8"))


@pytest.mark.long
def test_excluded_runs_are_told_everywhere_and_are_in_no_statistics(robot_runner: Callable, folder: Path) -> None:
    assert robot_runner("exclude", "config.py", "r_2").code == 2  # the reason is compulsory
    answer = robot_runner("exclude", folder, "r_2", "--reason", WHY)
    assert (answer.code, answer.err) == (0, "")
    assert answer.out == "1 run is excluded: r_2. `robot-runner include` undoes it.\n"

    assert f"Excluded  r_2: {WHY}" in robot_runner("status", "config.py").out
    assert robot_runner("plan", "config.py", "--json").json["excluded"] == {"r_2": WHY}
    assert f"{WHY} (20" in dict(explain_run(folder, "r_2").facts)["Excluded"]
    assert "Excluded  r_2 (`robot-runner explain RUN` says why)" in robot_runner("run", "config.py").out

    results = load_results(folder)
    assert len(results.runs) == len(results.done) == 7
    assert results.runs["Energy"].max() < 100
    assert "r_2" not in set(results.quality["run_id"]) | set(results.published["run_id"]) | set(
        results.events()["run_id"]
    )
    (excluded,) = results.excluded.to_dict("records")
    assert (excluded["run_id"], excluded["excluded"], excluded["Energy"]) == ("r_2", WHY, 102)
    assert excluded["excluded_at"].tzname() == "UTC"
    assert len(load_results(folder, with_excluded=True).done) == 8

    report = reported(robot_runner, folder)
    assert (len(report["runs"]), report["excluded"][0]["excluded"]) == (7, WHY)
    (threat,) = [each for each in report["threats"] if each["title"] == "1 run was excluded"]
    assert threat["text"].startswith("Somebody leaned on the robot. Not in the statistics: r_2 (20")
    assert robot_runner("report", folder, "--format", "md", "--figures", "none").code == 0
    assert "Excluded" in (folder / "report" / "report.md").read_text(encoding="utf-8")

    assert robot_runner("export", folder).code == 0
    exported = pd.read_parquet(folder / "export" / "run_table.parquet")
    assert exported.set_index("run_id")["excluded"].dropna().to_dict() == {"r_2": WHY}


@pytest.mark.long
def test_a_package_keeps_them_and_a_replication_executes_them_again(
    robot_runner: Callable, folder: Path, tmp_path: Path
) -> None:
    assert robot_runner("exclude", folder, "r_2", "--reason", WHY).code == 0
    assert robot_runner("pack", folder, "--no-hashes", "--to", tmp_path / "study.zip").code == 0
    assert robot_runner("verify", tmp_path / "study.zip").code == 0
    answer = robot_runner("replicate", tmp_path / "study.zip", "--to", tmp_path / "again", "--yes")
    assert answer.code == 0, answer.err
    tables = [path.read_text(encoding="utf-8") for path in (tmp_path / "again").rglob("run_table.csv")]
    assert sorted("excluded" in table for table in tables) == [False, True]  # the replication's, and the original's
    assert "dentical in all 7 runs" in answer.out


@pytest.mark.long
def test_an_order_that_was_chosen_is_told_as_it_was_executed(
    robot_runner: Callable, write_config: Callable[..., Path], tmp_path: Path
) -> None:
    write_config(BODY, table=TABLE)
    folder, chosen = tmp_path / "results" / "trial", ["--first", "r_5", "--skip", "Task=Network,Repetition=2"]
    answer = robot_runner("run", "config.py", "--only", "r_3", *chosen)
    assert (answer.code, "--only r_3: the run is also chosen by --skip" in answer.err) == (2, True)
    assert "7 of 8 runs done" in robot_runner("run", "config.py", *chosen).out
    assert robot_runner("run", "config.py").code == 0
    lines = (folder / "journal.jsonl").read_text(encoding="utf-8").splitlines()
    order = [each["run"] for each in map(json.loads, lines) if each["kind"] == "attempt_started"]
    assert order == ["r_5", "r_1", "r_2", "r_4", "r_6", "r_7", "r_8", "r_3"]

    told = "2 of the 8 runs that were executed came out of this order: r_5, r_3"
    assert f"randomised from seed 5; {told}" in " ".join(robot_runner("plan", "config.py").out.split())
    assert told in " ".join(robot_runner("status", "config.py").out.split())
    assert (
        dict(explain_run(folder, "r_5").facts)["Executed"]
        == "as number 1 of the 8 runs so far, out of the order of the run table"
    )
    assert "Executed" not in dict(explain_run(folder, "r_4").facts)
    manifest = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))
    recorded = {"skip": ["Task=Network,Repetition=2"], "first": ["r_5"]}
    assert [each.get("selection") for each in manifest["executions"]] == [recorded, None]
    report = reported(robot_runner, folder)
    assert told in report["design"]["order"]
    (text,) = [each["text"] for each in report["threats"] if "out of the order" in each["title"]]
    assert "Chosen: --skip Task=Network,Repetition=2, --first r_5." in text
