"""`run_table.schema.json` says of each column what it holds, in words that other tools know."""

from __future__ import annotations

import json
import warnings
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest

from robot_runner.core.design.factor import Factor
from robot_runner.core.design.run_table_model import RunTableModel
from robot_runner.core.errors import StorageError
from robot_runner.core.storage.cells import RunStatus
from robot_runner.core.storage.run_table_rows import RunTableRows, write_run_table
from robot_runner.core.storage.table_columns import ColumnDescription, ColumnRole, TableLayout
from robot_runner.core.storage.table_schema import describe_columns, read_schema, type_of_values, write_schema

if TYPE_CHECKING:
    from pathlib import Path

ENERGY = ColumnDescription(
    name="Energy",
    role=ColumnRole.MEASURE,
    type="number",
    title="Energy",
    description="Drawn from the battery.",
    unit="J",
    owner="Ina219",
    origin="simulated",
    findings=("r_3: 12 samples were lost",),
)


def full_rows() -> RunTableRows:
    model = RunTableModel(
        [Factor("Task", ["a,b", 'c"d', "e\nf"]), Factor("Speed", [0.1, 2]), Factor("Lidar", [True, False])],
        repetitions=2,
    )
    rows = RunTableRows.of_plan(
        model.plan(), TableLayout.of_model(model, ["Energy", "Samples", "Lost", "Note", "Never"])
    )
    stamps = dict.fromkeys(rows.layout.stamps, "2026-01-31T12:00:00.250Z")
    measures: dict[str, Any] = {"Energy": 877.5, "Samples": 12, "Lost": True, "Note": "ok"}
    rows.record("r_1", status=RunStatus.DONE, stamps=stamps, measures=measures)
    rows.record("r_2", status=RunStatus.FAILED, measures={"Energy": 1e-7, "Samples": None})
    return rows


def test_a_description_comes_back_as_it_was(tmp_path: Path) -> None:
    bare = ColumnDescription(name="run_id", role=ColumnRole.PROGRESS, type="string")
    write_schema(tmp_path / "schema.json", [bare, ENERGY])
    assert read_schema(tmp_path / "schema.json") == (bare, ENERGY)


def test_a_finding_that_holds_a_picture_leaves_a_schema_that_can_be_read(tmp_path: Path) -> None:
    long = replace(ENERGY, findings=("x" * 9_000_000,), doubts={"r_1": ("y" * 9_000_000,)})
    write_schema(tmp_path / "schema.json", [long])
    [read] = read_schema(tmp_path / "schema.json")
    assert read.findings == ("x" * 10_000 + "… (8,990,000 more characters)",)
    assert read.doubts == {"r_1": ("y" * 10_000 + "… (8,990,000 more characters)",)}


def test_a_study_whose_every_run_is_doubtful_leaves_a_schema_that_can_be_read(tmp_path: Path) -> None:
    runs = [f"r_{number}" for number in range(1, 2001)]
    reason = "the meter was silent for a while: " + "z" * 1_000
    doubts = dict.fromkeys(runs, (reason,))
    doubted = replace(ENERGY, findings=tuple(f"{run_id}: {reason}" for run_id in runs), doubts=doubts)
    good = replace(ENERGY, name="CPU", findings=())
    columns = [good, *(replace(doubted, name=f"Energy {number}") for number in range(10))]
    write_schema(tmp_path / "schema.json", columns)
    fields = json.loads((tmp_path / "schema.json").read_text(encoding="utf-8"))["fields"]
    assert "robot_runner:left_out" not in fields[0]
    for column, field, read in zip(columns[1:], fields[1:], read_schema(tmp_path / "schema.json")[1:], strict=True):
        told = len(read.findings), len(read.doubts)
        assert min(told) > 100
        assert read.findings == column.findings[: told[0]]
        assert list(read.doubts.items()) == list(doubts.items())[: told[1]]
        assert field["robot_runner:left_out"] == 2 * len(runs) - sum(told)


def test_the_file_is_a_table_schema_with_our_own_keys_beside(tmp_path: Path) -> None:
    write_schema(tmp_path / "schema.json", [ENERGY])
    schema = json.loads((tmp_path / "schema.json").read_text(encoding="utf-8"))
    assert schema["missingValues"] == [""]
    assert schema["primaryKey"] == ["run_id"]
    assert schema["fields"] == [
        {
            "name": "Energy",
            "type": "number",
            "title": "Energy",
            "description": "Drawn from the battery.",
            "unit": "J",
            "robot_runner:role": "measure",
            "robot_runner:owner": "Ina219",
            "robot_runner:origin": "simulated",
            "robot_runner:findings": ["r_3: 12 samples were lost"],
        }
    ]


def test_columns_are_described_in_their_order_with_the_types_of_their_values() -> None:
    described = describe_columns(full_rows(), {"Energy": ENERGY})
    assert tuple(column.name for column in described) == full_rows().layout.columns
    assert {column.name: column.type for column in described if column.role is not ColumnRole.TIMESTAMP} == {
        "run_id": "string",
        "status": "string",
        "Task": "string",
        "Speed": "number",
        "Lidar": "boolean",
        "Repetition": "integer",
        "Energy": "number",
        "Samples": "integer",
        "Lost": "boolean",
        "Note": "string",
        "Never": "any",
    }
    assert {column.type for column in described if column.role is ColumnRole.TIMESTAMP} == {"datetime"}
    assert next(column for column in described if column.name == "Energy") == ENERGY
    assert next(column for column in described if column.name == "Repetition").role is ColumnRole.REPETITION


def test_a_time_stamp_that_is_none_makes_its_column_text() -> None:
    rows = full_rows()
    rows.record("r_2", stamps={"start_run_at": "noon"})
    types = {column.name: column.type for column in describe_columns(rows)}
    assert types["start_run_at"] == "string"
    assert types["stop_run_at"] == "datetime"


@pytest.mark.parametrize(
    ("values", "kind"),
    [
        ([], "any"),
        ([None], "any"),
        ([True, None], "boolean"),
        ([1, 2], "integer"),
        ([1, 2.5], "number"),
        ([2.5], "number"),
        (["a", "1"], "string"),
        ([object()], "string"),
        ([True, 1], "any"),
        (["a", 1], "any"),
        ([float("inf"), 1.0], "any"),
    ],
)
def test_a_type_is_named_only_where_it_fits_all_values(values: list[object], kind: str) -> None:
    assert type_of_values(values) == kind


def test_none_as_a_treatment_is_no_missing_value() -> None:
    model = RunTableModel([Factor("Limit", [1, None])])
    rows = RunTableRows.of_plan(model.plan(), TableLayout.of_model(model, []))
    assert next(column.type for column in describe_columns(rows) if column.name == "Limit") == "any"


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("{", "the file is not valid JSON: Expecting property name enclosed in double quotes"),
        ("[]", "it is a list, not a mapping"),
        ('{"fields": 5}', "fields is 5, not a list"),
        ('{"fields": [{"type": "number"}]}', "fields[0].name is missing"),
        ('{"fields": [{"name": "A", "unit": ["J"]}]}', "fields[0].unit is a list, not a text"),
        ('{"fields": [{"name": "A"}, {"name": "A"}]}', "two fields are for 'A'"),
        ('{"fields": [], "fields": []}', "the file is not valid JSON: the key 'fields' is there twice"),
        ("[" * 100_000, "its JSON is nested deeper than 64 levels"),
        ('{"fields": [{"name": "A", "robot_runner:role": "odd"}]}', "fields[0] has the unknown role 'odd'"),
    ],
)
def test_what_is_no_schema_is_refused(tmp_path: Path, text: str, problem: str) -> None:
    (tmp_path / "schema.json").write_text(text, encoding="utf-8")
    with pytest.raises(StorageError) as caught:
        read_schema(tmp_path / "schema.json")
    assert caught.value.problem.startswith(f"the file is not a schema of a run table: {problem}")
    assert caught.value.fix == "Restore it from a backup, or delete it: it is written again."


def test_a_schema_that_is_not_there_is_said_to_be_missing(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match=r"schema\.json is missing"):
        read_schema(tmp_path / "schema.json")


def test_a_schema_of_another_tool_is_read_with_all_columns_as_a_users_own(tmp_path: Path) -> None:
    (tmp_path / "schema.json").write_text('{"fields": [{"name": "A", "type": "number"}]}', encoding="utf-8")
    assert read_schema(tmp_path / "schema.json") == (ColumnDescription(name="A", role=ColumnRole.EXTRA, type="number"),)


@pytest.mark.long
def test_frictionless_finds_the_table_valid_and_its_faults(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the library's own
        import frictionless
    monkeypatch.chdir(tmp_path)  # it takes no absolute paths for safe
    rows = full_rows()
    write_run_table(tmp_path / "run_table.csv", rows)
    write_schema(tmp_path / "schema.json", describe_columns(rows, {"Energy": ENERGY}))

    def validate() -> Any:
        schema = frictionless.Schema.from_descriptor("schema.json")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return frictionless.Resource(path="run_table.csv", schema=schema).validate()

    report = validate()
    assert report.valid, report.to_summary()
    assert report.tasks[0].stats["rows"] == len(rows)
    table = (tmp_path / "run_table.csv").read_text(encoding="utf-8")
    (tmp_path / "run_table.csv").write_text(table.replace("877.5", "much"), encoding="utf-8")
    assert [error.type for task in validate().tasks for error in task.errors] == ["type-error"]
