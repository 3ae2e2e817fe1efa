"""What is left on disk for a config of an earlier tool, and what the tool itself had left there."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest
from frictionless import Resource
from tests.legacy.earlier_configs import ROBOT, RUNNER, planned

from robot_runner.core.config.preparation import prepare
from robot_runner.core.design.columns import RUN_ID
from robot_runner.core.errors import ExecutionError, RobotRunnerError
from robot_runner.core.execution.experiment_status import read_status
from robot_runner.core.execution.resumption import Resumption
from robot_runner.core.storage.cells import RunStatus
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.run_table_reading import read_run_table
from robot_runner.core.storage.table_columns import TableLayout
from robot_runner.core.storage.table_schema import read_schema

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from tests.legacy.earlier_configs import Executed

MEASURED = "def populate_run_data(self, context): return {'seconds': context.execute_run['size'] / 4}"
FAILING = """
def interact(self, context):
    if context.execute_run["language"] == "py":
        raise RuntimeError("no interpreter")
def populate_run_data(self, context): return {"seconds": 1.5}
"""


@pytest.mark.long
def test_the_table_is_written_as_the_earlier_tools_wrote_it(
    config: Callable[..., Path], execute: Callable[..., Executed]
) -> None:
    assert execute(config(MEASURED)).text == (
        "__run_id,__done,size,language,seconds\n"
        "run_0_repetition_0,DONE,10,c,2.5\n"
        "run_1_repetition_0,DONE,10,py,2.5\n"
        "run_2_repetition_0,DONE,20,c,5.0\n"
        "run_3_repetition_0,DONE,20,py,5.0\n"
        "run_0_repetition_1,DONE,10,c,2.5\n"
        "run_1_repetition_1,DONE,10,py,2.5\n"
        "run_2_repetition_1,DONE,20,c,5.0\n"
        "run_3_repetition_1,DONE,20,py,5.0\n"
    )


@pytest.mark.long
def test_a_run_has_its_folder_in_the_experiments_own(
    config: Callable[..., Path], execute: Callable[..., Executed]
) -> None:
    executed = execute(config("def interact(self, context): (context.run_dir / 'power.csv').touch()"))
    assert sorted(path.parent.name for path in executed.folder.glob("*/power.csv")) == sorted(executed.by_id)
    assert not (executed.folder / "runs").exists()


@pytest.mark.long
def test_a_run_that_failed_is_to_do_and_status_knows_that_it_failed(
    config: Callable[..., Path], execute: Callable[..., Executed]
) -> None:
    executed = execute(config(FAILING))
    assert [row["__done"] for row in executed.table] == ["DONE", "TODO"] * 4
    status = read_status(executed.folder)
    assert (status.done, status.failed, status.todo) == (4, 4, 0)
    assert "no interpreter" in status.failures[0]


@pytest.mark.long
def test_readers_find_names_roles_and_types(config: Callable[..., Path], execute: Callable[..., Executed]) -> None:
    folder = execute(config(MEASURED)).folder
    schema = read_schema(folder / "run_table.schema.json")
    rows = read_run_table(folder / "run_table.csv", TableLayout.of_schema(schema))
    assert rows.row(0) == {
        RUN_ID: "run_0_repetition_0",
        "status": RunStatus.DONE,
        "size": 10,
        "language": "c",
        "seconds": 2.5,
    }


@pytest.mark.long
def test_the_schema_describes_the_file_as_it_is(config: Callable[..., Path], execute: Callable[..., Executed]) -> None:
    folder = execute(config(MEASURED)).folder
    schema = json.loads((folder / "run_table.schema.json").read_text())
    assert schema["primaryKey"] == ["__run_id"]
    report = Resource(path="run_table.csv", basepath=str(folder), schema="run_table.schema.json").validate()
    assert report.valid, report.to_summary()


def test_columns_that_would_clash_with_ours_keep_their_headings(
    config: Callable[..., Path], execute: Callable[..., Executed]
) -> None:
    table = """\
    def create_run_table_model(self):
        self.run_table_model = RunTableModel(
            [FactorModel("attempt", [1]), FactorModel(" padded ", ["x"])], data_columns=["status", "run_id"]
        )
        return self.run_table_model

    def populate_run_data(self, context):
        assert context.execute_run["attempt"] == 1 and context.execute_run[" padded "] == "x"
        return {"status": "fine", "run_id": 7}
"""
    path = config(table=table, subscribe="(RunnerEvents.POPULATE_RUN_DATA, self.populate_run_data),")
    executed = execute(path)
    assert executed.text == ("__run_id,__done,attempt, padded ,status,run_id\nrun_0_repetition_0,DONE,1,x,fine,7\n")
    assert execute(path).finished.done_count == 1
    schema = read_schema(executed.folder / "run_table.schema.json")
    rows = read_run_table(executed.folder / "run_table.csv", TableLayout.of_schema(schema))
    assert rows.row(0)["status_"] == "fine"


@pytest.mark.long
def test_an_experiment_goes_on_where_it_stopped(config: Callable[..., Path], execute: Callable[..., Executed]) -> None:
    path = config(FAILING)
    first = execute(path, Resumption(only=("run_0_repetition_0", "run_1_repetition_0")))
    assert [row["__done"] for row in first.table] == ["DONE"] + ["TODO"] * 7
    path.write_text(path.read_text().replace('"py"', '"none"'))
    second = execute(path, Resumption(accept_changes=True))
    assert {row["__done"] for row in second.table} == {"DONE"}
    assert second.finished.done_count == 8


@pytest.mark.parametrize("text", ["{", '{"format": 1}', '{"format": 1, "seed": "drawn"}'])
def test_a_manifest_from_which_no_seed_can_be_read_is_named(
    config: Callable[..., Path], execute: Callable[..., Executed], text: str
) -> None:
    path = config(MEASURED)
    folder = ExperimentFolder(path.parent / "experiments" / "sorting", runs_name="")
    folder.root.mkdir(parents=True)
    folder.manifest.write_text(text)
    with pytest.raises(RobotRunnerError) as refused:
        execute(path)
    assert str(folder.manifest) in str(refused.value)


def test_a_changed_treatment_is_told_cell_by_cell(
    config: Callable[..., Path], execute: Callable[..., Executed]
) -> None:
    path = config(MEASURED)
    execute(path, Resumption(only=("run_0_repetition_0",)))
    table = path.parent / "experiments" / "sorting" / "run_table.csv"
    table.write_text(table.read_text().replace("run_1_repetition_0,TODO,10", "run_1_repetition_0,TODO,20"))
    with pytest.raises(ExecutionError, match="run run_1_repetition_0, column 'size': the table has 20, the plan 10"):
        execute(path)


OLD_TABLE = """\
__run_id,__done,size,language,seconds
run_3_repetition_0,DONE,20,py,1.25
run_0_repetition_0,DONE,10,c,0.5
run_1_repetition_0,TODO,10,py, 
run_2_repetition_0,TODO,20,c, 
"""  # noqa: W291 - the blank is what the earlier tools left in a cell


def old_folder(path: Path, text: str = OLD_TABLE) -> Path:
    folder = path.parent / "experiments" / "sorting"
    (folder / "run_3_repetition_0").mkdir(parents=True)
    (folder / "run_3_repetition_0" / "raw.csv").write_text("1\n")
    (folder / "run_table.csv").write_text(text)
    (folder / "metadata.json").write_text('{"py/object": "ConfigValidator.Config.Models.Metadata.Metadata"}')
    return folder


def test_a_folder_of_the_earlier_tool_is_resumed(config: Callable[..., Path], execute: Callable[..., Executed]) -> None:
    table = """\
    def create_run_table_model(self):
        self.run_table_model = RunTableModel(
            [FactorModel("size", [10, 20]), FactorModel("language", ["c", "py"])],
            exclude_combinations=[],
            data_columns=["seconds"],
            shuffle=True,
        )
        return self.run_table_model
"""
    path = config("def populate_run_data(self, context): return {'seconds': context.run_nr}", table=table)
    folder = old_folder(path)
    executed = execute(path)
    assert executed.folder == folder
    assert executed.text == (
        "__run_id,__done,size,language,seconds\n"
        "run_3_repetition_0,DONE,20,py,1.25\n"
        "run_0_repetition_0,DONE,10,c,0.5\n"
        "run_1_repetition_0,DONE,10,py,3\n"
        "run_2_repetition_0,DONE,20,c,4\n"
    )
    assert (folder / "run_3_repetition_0" / "raw.csv").read_text() == "1\n"
    assert (folder / "metadata.json").exists()


def test_ids_of_an_older_version_are_kept_when_its_table_is_resumed(
    config: Callable[..., Path], execute: Callable[..., Executed]
) -> None:
    path = config("def populate_run_data(self, context): return {'seconds': 9}")
    old_folder(path, OLD_TABLE.replace("_repetition_0", ""))
    executed = execute(path)
    assert list(executed.by_id) == ["run_3", "run_0", "run_1", "run_2"]
    assert [row["seconds"] for row in executed.table] == ["1.25", "0.5", "9", "9"]


def test_what_an_attempt_of_the_earlier_tool_left_behind_is_put_away(
    config: Callable[..., Path], execute: Callable[..., Executed]
) -> None:
    path = config("def interact(self, context): assert list(context.run_dir.iterdir()) == []")
    folder = old_folder(path)
    (folder / "run_1_repetition_0").mkdir()
    (folder / "run_1_repetition_0" / "half.csv").touch()
    executed = execute(path)
    assert executed.finished.failures == ()
    assert list(folder.glob("earlier_attempts/run_1_repetition_0/*/half.csv")) != []


def test_a_table_of_the_earlier_tool_that_is_full_leaves_nothing_to_do(
    config: Callable[..., Path], execute: Callable[..., Executed]
) -> None:
    path = config("def start_run(self, context): raise AssertionError('executed again')")
    old_folder(path, OLD_TABLE.replace("TODO", "DONE").replace(", \n", ",3\n"))
    assert execute(path).finished.done_count == 4


@pytest.mark.long
@pytest.mark.parametrize("process", ["spawn", "in_process"])
def test_runs_may_be_executed_in_other_ways(
    config: Callable[..., Path], execute: Callable[..., Executed], process: str
) -> None:
    methods = """
    def start_run(self, context): self.doubled = context.execute_run["size"] * 2
    def populate_run_data(self, context):
        from ProgressManager.Output.OutputProcedure import OutputProcedure
        OutputProcedure.console_log("in its own process")
        return {"seconds": self.doubled}
    """
    executed = execute(
        config(methods), Resumption(only=("run_0_repetition_0", "run_2_repetition_1")), run_process=process
    )
    done = {run_id: row["seconds"] for run_id, row in executed.by_id.items() if row["__done"] == "DONE"}
    assert done == {"run_0_repetition_0": "20", "run_2_repetition_1": "40"}
    assert executed.log("run_2_repetition_1") == "in its own process\n"


@pytest.mark.long
def test_what_no_column_is_for_is_kept_aside_and_the_row_does_not_shift(
    config: Callable[..., Path], execute: Callable[..., Executed]
) -> None:
    executed = execute(config("def populate_run_data(self, context): return {'secnds': 3, 'seconds': 2}"))
    assert {row["seconds"] for row in executed.table} == {"2"}
    kept = ExperimentFolder.found_at(executed.folder).refused("run_0_repetition_0").read_text()
    assert json.loads(kept) == {"owner": "config", "name": "secnds", "value": "3"}
    assert any("'secnds' is not a data column" in each and "'seconds'" in each for each in executed.warnings)


@pytest.mark.long
def test_what_is_as_good_as_nothing_may_be_returned(
    config: Callable[..., Path], execute: Callable[..., Executed]
) -> None:
    methods = """
    def start_run(self, context): context.execute_run["seconds"] = 7
    def populate_run_data(self, context): return [False, "", [], 0, {}, None, (), 0.0][context.run_nr - 1]
    """
    executed = execute(config(methods))
    assert executed.finished.failures == ()
    assert [row["seconds"] for row in executed.table] == ["7"] * 8


#: What a callback returns, and what stands in its cell then.
CELLS = {
    "float('nan')": "",
    "float('inf')": "",
    "__import__('numpy').float32('nan')": "",
    "__import__('numpy').float32('-inf')": "",
    "__import__('numpy').datetime64('NaT', 's')": "",
    "__import__('decimal').Decimal('NaN')": "",
    "__import__('decimal').Decimal('Infinity')": "",
    "__import__('numpy').ma.masked": "",
    "[1, 2]": "[1, 2]",
    "True": "True",
    "' '": "",
    "None": "",
    "Path('x.csv')": "x.csv",
    "__import__('numpy').float64(0.5)": "0.5",
    "__import__('decimal').Decimal('1.10')": "1.10",
}


@pytest.mark.long
def test_a_cell_holds_what_can_be_held(config: Callable[..., Path], execute: Callable[..., Executed]) -> None:
    values = ", ".join(f"lambda: {value}" for value in CELLS)
    table = f"""\
    def create_run_table_model(self):
        self.run_table_model = RunTableModel([FactorModel("value", range({len(CELLS)}))], data_columns=["seconds"])
        return self.run_table_model
"""
    methods = f"def populate_run_data(self, context): return {{'seconds': [{values}][context.run_nr - 1]()}}"
    executed = execute(config(methods, table=table))
    assert executed.finished.failures == ()
    assert {value: row["seconds"] for value, row in zip(CELLS, executed.table, strict=True)} == CELLS


def test_a_changed_treatment_in_the_returned_row_is_told(
    config: Callable[..., Path], execute: Callable[..., Executed]
) -> None:
    methods = """
    def populate_run_data(self, context):
        row = context.run_variation
        row["task"] = "other"
        return row
    """
    executed = execute(config(methods, head=ROBOT))
    assert executed.table[0]["task"] == "scan"
    assert any("returned 'other' for the factor 'task'" in warning for warning in executed.warnings)


def test_planning_shows_an_old_table_as_it_stands(config: Callable[..., Path]) -> None:
    path = config()
    assert len(planned(prepare(path))) == 8
    assert RUNNER in path.read_text()
