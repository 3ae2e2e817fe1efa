"""Results of a table that was corrected, or saved, by hand: each value has the doubts about itself."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import pytest
from tests.conftest import TABLE
from tests.core.execution.conftest import Executed, execute_in
from tests.core.execution.test_table_recovery import COUNTING, edited, resume, text_of

from robot_runner.analysis import load_results
from robot_runner.core.execution.experiment_status import read_status
from robot_runner.core.execution.resumption import TableChoice
from robot_runner.replication.explanation import explain_run

if TYPE_CHECKING:
    from pathlib import Path

Execute = Callable[..., Executed]

DOUBTED = """
run_process = RunProcess.IN_PROCESS
quality_columns = True

def populate_run_data(self, context):
    if context.run_number < 4: context.doubt("a loose wire", measures=["Energy"])
    return {"Energy": 20 + context.run_number}
"""


@pytest.fixture
def execute(tmp_path: Path) -> Callable[..., Executed]:
    return partial(execute_in, tmp_path)


@pytest.mark.parametrize("digits", [15, 10], ids=["R and LibreOffice", "Excel"])
def test_a_number_that_was_rounded_as_the_table_was_saved_is_no_change_and_keeps_its_doubts(
    execute: Execute, digits: int
) -> None:
    executed = execute(DOUBTED.replace("20 + context.run_number", "20 + context.run_number / 3"))
    path = executed.folder / "run_table.csv"
    before = text_of(path)
    values = [repr(20 + number / 3) for number in range(1, 5)]
    for value in values:
        edited(executed, value, f"{float(value):.{digits}g}")
    assert text_of(path) != before
    assert load_results(executed.folder).findings == ()
    resume(executed)
    assert text_of(path) == before
    for value in values[1:]:
        edited(executed, value, f"{float(value):.{digits}g}")
    edited(executed, values[0], "25.5")  # and one was corrected
    resume(executed, table=TableChoice.FILE)
    assert [row["Energy"] for row in executed.table] == ["25.5", *values[1:]]
    assert [each["run"] for each in executed.journal("deviation") if each["column"] == "Energy"] == ["r_1"]
    assert list(load_results(executed.folder).quality["quality"]) == ["good", "doubtful", "doubtful", "good"]


def test_a_value_of_a_table_written_by_hand_that_is_not_plausible_is_doubtful(
    execute: Execute, write_config: Any
) -> None:
    table = TABLE.replace('"Energy"', 'Measure("Energy", "J", "Energy drawn.", low=0.0)')
    path = write_config(COUNTING, table=table).parent / "results" / "trial" / "run_table.csv"
    path.parent.mkdir(parents=True)
    path.write_text("Task,Repetition,status,Energy\nNetwork,1,Done,-5\nVideo,1,Done,5\nVideo,2,-,\n", encoding="utf-8")
    executed = execute(COUNTING, table=table)
    below = "the value, -5 J, is below 0 J, the least that is plausible"
    for lost in ("", "run_table.schema.json"):
        if lost:
            (executed.folder / lost).unlink()
            resume(executed)
        assert list(load_results(executed.folder).quality["reasons"]) == [below, "", ""]
    resume(executed, redo=("r_1",))
    assert list(load_results(executed.folder).quality["reasons"]) == ["", "", ""]


def test_a_value_corrected_by_hand_has_the_doubts_about_itself_and_not_those_about_the_earlier_one(
    execute: Execute,
) -> None:
    energy = 'Measure("Energy", "J", "Energy drawn.", low=0.0, high=100.0)'
    executed = execute(DOUBTED, table=TABLE.replace('"Energy"', energy))
    for was, is_now in (
        ("Video,1,21", "Video,1,31"),
        ("Network,1,22", "Network,1,-32"),
        ("Network,2,24", "Network,2,"),
    ):
        edited(executed, was, is_now)
    resume(executed, table=TableChoice.FILE)
    below = "the value, -32 J, is below 0 J, the least that is plausible"
    told = [
        ("31", "good"),
        ("-32", f"doubtful: {below}"),
        ("23", "doubtful: a loose wire"),
        ("", "missing"),
    ]
    ends = {each["run"]: each["measures"]["Energy"] for each in executed.journal("attempt_finished")}
    assert ends["r_1"] == {"value": 31, "owner": "config", "origin": "entered by hand"}
    assert ends["r_2"] == {"value": -32, "owner": "config", "origin": "entered by hand", "doubts": [below]}
    assert ends["r_4"] == {"value": None, "owner": "config", "origin": "measured"}
    for lost in ("", "run_table.schema.json", "run_table.csv"):
        if lost:
            (executed.folder / lost).unlink()
        resume(executed)
        assert [(row["Energy"], row["Energy.quality"]) for row in executed.table] == told
        results = load_results(executed.folder)
        quality = results.quality
        assert results.columns["Energy"].origin == "measured", "the others were"
        assert list(quality["quality"]) == ["good", "doubtful", "doubtful", "missing"]
        assert list(quality["reasons"]) == ["", below, "a loose wire", ""]
        assert read_status(executed.folder).bad_values["Energy"] == {"doubtful": ["r_2", "r_3"], "missing": ["r_4"]}
    assert [each["was"] for each in executed.journal("deviation") if each["column"] == "Energy"] == ["21", "22", "24"]
    explained = dict(explain_run(executed.folder, "r_1", ["Energy"]).values[0].facts)
    assert (explained["Origin"], explained["Quality"], explained.get("Doubt")) == ("entered by hand", "good", None)
