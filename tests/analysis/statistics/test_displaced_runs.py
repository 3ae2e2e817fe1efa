"""Runs that were executed out of the order of their design are left out, and it is said: real executions that fail."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from tests.conftest import HEAD
from tests.core.execution.conftest import execute_in

from robot_runner.analysis import analyse, load_results
from robot_runner.analysis.report.writing import ReportFormat, write_report
from robot_runner.analysis.statistics.disclosed import Reason

if TYPE_CHECKING:
    from pathlib import Path

DESIGNS = f"from robot_runner.designs import Crossover, SplitPlot\n{HEAD}"
BODY = """
on_failure = FailurePolicy.CONTINUE
def populate_run_data(self, context):
    flag = Path(__file__).parent / f"{context.run_id} failed"
    if context.run_id in FAILING and not flag.exists():
        flag.touch()
        raise RuntimeError("the battery fell off")
    held = {"a": 0.0, "b": 3.0, "c": 5.0}.get(context.combination.get("Task"), 0.0)
    return {"Energy": held + (context.run_number * 37 % 23) / 10}
"""
CROSSOVER = """
    def create_run_table(self):
        factors = [Factor("Robot", list("ABCDEF")), Factor("Period", [1, 2, 3]), Factor("Task", list("abc"))]
        return RunTableModel(factors, data_columns=["Energy"], design=Crossover("Robot", "Period"))
"""
SPLIT_PLOT = """
    def create_run_table(self):
        factors = [Factor("Plot", [1, 2, 3, 4]), Factor("Floor", ["wood", "carpet"]), Factor("Task", list("abc"))]
        return RunTableModel(factors, data_columns=["Energy"], design=SplitPlot("Floor", "Plot"))
"""


def executed_twice(folder: Path, table: str, failing: list[str]) -> Path:
    body = BODY.replace("FAILING", repr(failing))
    first = execute_in(folder, body, head=DESIGNS, table=table)
    assert {row["run_id"] for row in first.table if row["status"] == "Failed"} == set(failing)
    again = execute_in(folder, body, head=DESIGNS, table=table)
    assert {row["status"] for row in again.table} == {"Done"}
    return again.folder


@pytest.mark.long
def test_a_period_that_is_made_up_for_later_is_not_analysed(tmp_path: Path) -> None:
    # Robot A has runs 1 to 3: the second fails, and is executed again after the third; robot B's last one in its place.
    folder = executed_twice(tmp_path, CROSSOVER, ["r_2", "r_6"])
    results = load_results(folder)
    statistics = analyse(results)
    energy = statistics.measure("Energy")
    assert [(each.run_id, each.reason, each.why) for each in energy.left_out] == [
        ("r_2", Reason.DISPLACED, "executed after Period 3 of Robot A had begun")
    ]
    assert energy.overall.n == 17
    (effect,) = energy.test.effects
    # The other runs of robot A do not tell how it responds to the tasks.
    assert (
        "Not each Robot has all combinations, so these runs are left out of the tests: r_1, r_3." in energy.test.notes
    )
    assert effect.degrees_of_freedom == (2, 15 - 1 - 4 - 2 - 2 - 2)
    told = " ".join(statistics.warnings)
    assert "1 run was executed out of the order that the design holds" in told
    assert "1 run followed an attempt that failed" in told
    assert "r_3 after r_2" in told
    (standing,) = statistics.standings
    assert standing.conclusion.startswith("With the 1 run that is left out of Energy (r_2), the effect of Task")
    report = write_report(results, ReportFormat.MARKDOWN, output=tmp_path / "report", figures=()).document.read_text()
    assert "The design does not hold for all runs" in report
    assert "executed after Period 3 of Robot A had begun" in report


@pytest.mark.long
def test_a_run_of_a_whole_plot_that_is_gone_is_not_analysed(tmp_path: Path) -> None:
    # Plot 2 has runs 4 to 6: one of them fails, and its floor is another when it is executed again.
    results = load_results(executed_twice(tmp_path, SPLIT_PLOT, ["r_5", "r_12"]))
    energy = analyse(results).measure("Energy")
    assert [(each.run_id, each.why) for each in energy.left_out] == [
        ("r_5", "executed after Plot 4 had begun"),
        ("r_12", "executed after Plot 2 had begun"),
    ]
    assert energy.test is not None
