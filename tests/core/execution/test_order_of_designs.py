"""What a design says of order is what happens, with several runs in flight and after a failure, too."""

from __future__ import annotations

from collections import Counter
from datetime import datetime
from itertools import groupby, pairwise
from typing import TYPE_CHECKING, Any

import pytest
from tests.conftest import HEAD

from robot_runner.cli.extension import ExtensionRequest, extend_experiment
from robot_runner.core.config.preparation import prepare, prepare_or_refuse
from robot_runner.core.design.extended_design import Additions
from robot_runner.core.errors import DesignError
from robot_runner.core.execution.notices import FindingsNoticed

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

DESIGNS = f"from robot_runner.designs import Crossover, SplitPlot\n{HEAD}"
CROSSOVER = """
    def create_run_table(self):
        factors = [Factor("Robot", ["A", "B", "C", "D"]), Factor("Period", [1, 2, 3, 4]), Factor("Task", list("abcd"))]
        design = Crossover("Robot", "Period", washout_in_s=0.2)
        return RunTableModel(factors, shuffle=True, data_columns=["Energy"], design=design)
"""
SPLIT_PLOT = """
    def create_run_table(self):
        factors = [Factor("Plot", [1, 2, 3, 4]), Factor("Floor", ["wood", "carpet"]), Factor("Speed", [1, 2, 3])]
        return RunTableModel(factors, shuffle=True, data_columns=["Energy"], design=SplitPlot("Floor", "Plot"))
"""
BODY = """
claims = []
on_failure = FailurePolicy.STOP
def launch_mission(self, context):
    import time
    time.sleep(0.05 * (1 + context.run_seed % 3))
    context.combination["Task" if "Task" in context.combination else "Speed"]
def populate_run_data(self, context):
    flag = Path(__file__).parent / "failed"
    if context.run_number == 7 and not flag.exists():
        flag.touch()
        raise RuntimeError("the battery fell off")
    return {"Energy": 1.0}
"""


def moments(executed: Any, factor: str) -> dict[str, list[tuple[float, float, Any]]]:
    """Return when each attempt began and ended (s) and its treatments, by the treatment of a factor, as they began."""
    begun, found = {}, []
    for record in executed.journal("attempt_started", "attempt_finished"):
        at = datetime.fromisoformat(record["at"]).timestamp()
        if record["kind"] == "attempt_started":
            begun[record["run"]] = (at, record["combination"])
        else:
            start, combination = begun.pop(record["run"])
            found.append((start, at, combination))
    found.sort(key=lambda each: (each[2][factor], each[0]))
    return {name: list(mine) for name, mine in groupby(found, key=lambda each: each[2][factor])}


@pytest.mark.long
def test_units_of_a_crossover_go_on_side_by_side_each_in_its_periods_with_its_rests(
    execute: Callable[..., Any],
) -> None:
    first = execute(BODY, head=DESIGNS, table=CROSSOVER, workers=3)
    planned = [(row["run_id"], row["Robot"], row["Period"], row["Task"]) for row in first.table]
    assert first.finished.failed
    done = execute(BODY, head=DESIGNS, table=CROSSOVER, workers=4)
    assert {row["status"] for row in done.table} == {"Done"}
    assert [(row["run_id"], row["Robot"], row["Period"], row["Task"]) for row in done.table] == planned
    by_unit = moments(done, "Robot")
    assert len(by_unit) == 4
    for attempts in by_unit.values():
        periods = [int(each[2]["Period"]) for each in attempts]
        assert periods == sorted(periods), "in their order, a failed one again before the next"
        for (_, ended, one), (begins, _, other) in pairwise(attempts):
            assert begins >= ended
            assert begins >= ended + 0.2 or one["Period"] == other["Period"], "the washout"
    every = [each for attempts in by_unit.values() for each in attempts]
    assert max(sum(begun <= at < ended for begun, ended, _ in every) for at, _, _ in every) >= 2
    told = [each.findings for each in done.notices if isinstance(each, FindingsNoticed)]
    assert not any("looked at" in str(finding) for findings in told for finding in findings), "a period is not applied"


@pytest.mark.long
def test_a_unit_rests_before_a_run_of_an_earlier_period_that_is_made_up_for(execute: Callable[..., Any]) -> None:
    """It had failed in the session before, in which the unit has had its other period since."""
    body = BODY.replace("FailurePolicy.STOP", "FailurePolicy.CONTINUE").replace("run_number == 7", "run_number == 1")
    table = CROSSOVER.replace('["A", "B", "C", "D"]', '["A", "B"]').replace("[1, 2, 3, 4]", "[1, 2]")
    table = table.replace('list("abcd")', 'list("ab")').replace("0.2", "1.0")
    assert execute(body, head=DESIGNS, table=table, workers=2).finished.failed == ("r_1",)
    done = execute(body, head=DESIGNS, table=table, workers=2)
    assert done.finished.done_count == 4
    unit = done.table[0]["Robot"]
    (_, _, first), (_, ended, second), (begins, _, third) = moments(done, "Robot")[unit]
    assert [first["Period"], second["Period"], third["Period"]] == ["1", "2", "1"]
    assert begins >= ended + 1.0


@pytest.mark.long
def test_no_whole_plot_begins_before_the_one_before_it_is_over(execute: Callable[..., Any]) -> None:
    execute(BODY, head=DESIGNS, table=SPLIT_PLOT, workers=3)
    done = execute(BODY, head=DESIGNS, table=SPLIT_PLOT, workers=3)
    assert {row["status"] for row in done.table} == {"Done"}
    plots = list(moments(done, "Plot").values())
    for one, other in pairwise(plots):
        assert max(ended for _, ended, _ in one) <= min(begun for begun, _, _ in other)
    assert any(other[0] < one[1] for plot in plots for one, other in pairwise(plot)), "side by side within a whole plot"
    floors = [row["Floor"] for row in done.table]
    assert sum(one != other for one, other in pairwise(floors)) <= 3


@pytest.mark.long
def test_units_and_squares_are_added_by_the_same_design_and_what_was_planned_stays(
    execute: Callable[..., Any], tmp_path: Path
) -> None:
    (tmp_path / "failed").touch()
    first = execute(BODY, head=DESIGNS, table=CROSSOVER.replace("washout_in_s=0.2", ""), workers=4)
    planned = [row["Task"] for row in first.table]
    experiment = prepare_or_refuse(first.config)
    with pytest.raises(DesignError) as refused:
        extend_experiment(experiment, ExtensionRequest(added=Additions(repetitions=2)))
    assert "Add units: treatments of Robot" in str(refused.value)
    with pytest.raises(DesignError, match="7 units, and 4 treatments take 4 sequences"):
        extend_experiment(experiment, ExtensionRequest(added=Additions(treatments={"Robot": ["E", "F", "G"]})))
    extend_experiment(experiment, ExtensionRequest(added=Additions(treatments={"Robot": ["E", "F", "G", "H"]})))
    done = execute(BODY, head=DESIGNS, table=CROSSOVER.replace("washout_in_s=0.2", ""), workers=4)
    assert [row["Task"] for row in done.table[:16]] == planned
    assert {row["status"] for row in done.table} == {"Done"}
    by_unit = {name: list(rows) for name, rows in groupby(done.table, key=lambda row: row["Robot"])}
    assert list(by_unit) == list("ABCDEFGH")
    follows = Counter(pair for rows in by_unit.values() for pair in pairwise(row["Task"] for row in rows))
    assert set(follows.values()) == {2}
    assert len(follows) == 12


def test_a_design_that_decides_order_is_not_repeated_until_precise(write_config: Callable[..., Path]) -> None:
    body = BODY + 'repeat_until = Precision("Energy", half_width="5 %", at_most=9)'
    findings = prepare(write_config(body, head=DESIGNS, table=SPLIT_PLOT)).findings
    assert any("repeat_until" in each.where and "the design decides on the runs" in each.problem for each in findings)
