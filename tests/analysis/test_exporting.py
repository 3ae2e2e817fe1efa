"""An export can be read and validated without Robot Runner."""

from __future__ import annotations

import pandas as pd
import pyarrow as pa
import pytest
from frictionless import validate
from pyarrow import parquet
from tests.analysis.made_experiment import make_experiment, write_phases, write_samples

from robot_runner.analysis import load_results
from robot_runner.core.design.factor import Factor
from robot_runner.core.errors import StorageError


@pytest.fixture
def folder(tmp_path):
    made = make_experiment(
        tmp_path / "made experiment",
        [Factor("Task", ["Video", 'Net,"work']), Factor("Speed", [0.1, 0.2])],
        lambda treatments, repetition: {"Energy": 870.0 + repetition, "Note": None},
        measures=["Energy", "Note"],
        units={"Energy": "J"},
    )
    for number in (1, 2):
        write_samples(made, f"r_{number}", f"time_s,power_W,count\n10.0,7.5,{number}\n10.5,8,{number / number:g}\n")
        write_phases(made, f"r_{number}", "number,phase,start_s,end_s\n1,sleep,10,11\n")
    return made


def test_the_data_package_validates(folder, tmp_path):
    files = load_results(folder.root).export(tmp_path / "out")
    report = validate(str(files[-1]))
    assert files[-1].name == "datapackage.json"
    assert report.valid, report.flatten(["type", "message"])
    assert {task.name for task in report.tasks} >= {"run_table.csv", "samples-meter.samples.parquet"}


def test_a_change_of_an_exported_file_is_noticed(folder, tmp_path):
    load_results(folder.root).export(tmp_path / "out")
    table = tmp_path / "out" / "run_table.csv"
    table.write_text(table.read_text("utf-8").replace("871.0", "999.0"), "utf-8")
    assert not validate(str(tmp_path / "out" / "datapackage.json")).valid


def test_the_run_table_and_its_schema_validate_where_they_are(folder, monkeypatch):
    monkeypatch.chdir(folder.root)
    report = validate(folder.run_table.name, schema=folder.schema.name)
    assert report.valid, report.flatten(["type", "message"])


def test_samples_come_back_from_parquet_as_they_were(folder, tmp_path):
    results = load_results(folder.root)
    results.export(tmp_path / "out")
    back = pd.read_parquet(tmp_path / "out" / "samples" / "Meter.samples.parquet")
    samples = results.samples()
    assert back["power_W"].tolist() == samples["power_W"].tolist()
    assert back["Task"].tolist() == samples["Task"].tolist()


def test_text_treatments_are_ordered_and_numbers_are_numbers(folder, tmp_path):
    load_results(folder.root).export(tmp_path / "out")
    schema = parquet.read_schema(tmp_path / "out" / "run_table.parquet")
    assert schema.field("Task").type == pa.dictionary(pa.int32(), pa.string(), ordered=True)
    assert schema.field("Speed").type == pa.float64()


def test_units_go_with_the_columns(folder, tmp_path):
    load_results(folder.root).export(tmp_path / "out")
    assert parquet.read_schema(tmp_path / "out" / "run_table.parquet").field("Energy").metadata[b"unit"] == b"J"
    samples = parquet.read_schema(tmp_path / "out" / "samples" / "Meter.samples.parquet")
    assert (samples.field("power_W").metadata[b"unit"], samples.field("count").metadata) == (b"W", None)


def test_a_column_that_is_fractional_in_a_late_run_is_fractional_in_all(folder, tmp_path, monkeypatch):
    monkeypatch.setattr("robot_runner.analysis.exporting._RUNS_AT_ONCE", 1)
    write_samples(folder, "r_2", "time_s,power_W,count\n10.0,7.5,2.5\n")
    load_results(folder.root).export(tmp_path / "out")
    assert pd.read_parquet(tmp_path / "out" / "samples" / "Meter.samples.parquet")["count"].tolist() == [1.0, 1.0, 2.5]


@pytest.mark.parametrize(
    ("cells", "back"),
    [
        (["", "on"], [None, "on"]),
        (["1", "on"], ["1", "on"]),
        (["on", "2.5"], ["on", "2.5"]),
        (["", "2026-01-31T12:00:00Z"], [pd.NaT, pd.Timestamp("2026-01-31T12:00:00")]),
        ([str(2**62 + 1), ""], [2.0**62, None]),
    ],
)
def test_a_column_that_is_of_another_type_in_a_late_run_has_one_that_holds_all(
    folder, tmp_path, monkeypatch, cells, back
):
    monkeypatch.setattr("robot_runner.analysis.exporting._RUNS_AT_ONCE", 1)
    for number, cell in enumerate(cells, start=1):
        write_samples(folder, f"r_{number}", f"time_s,state\n10.0,{cell}\n")
    load_results(folder.root).export(tmp_path / "out")
    found = pd.read_parquet(tmp_path / "out" / "samples" / "Meter.samples.parquet")["state"]
    assert [None if pd.isna(each) else each for each in found] == [None if pd.isna(each) else each for each in back]


def test_the_default_place_is_in_the_experiments_folder(folder):
    files = load_results(folder.root).export()
    assert files[-1] == folder.root.resolve() / "export" / "datapackage.json"


def test_exporting_again_replaces_the_earlier_export(folder):
    results = load_results(folder.root)
    assert results.export() == results.export()


def test_the_folder_of_an_experiment_is_not_exported_into(folder, tmp_path):
    other = make_experiment(tmp_path / "other", [Factor("Task", ["A"])], lambda _treatments, _repetition: {"Energy": 1})
    before = other.run_table.read_bytes()
    for target in (other, folder):
        with pytest.raises(StorageError, match=r"run_table\.csv that no export has written.*Name another folder"):
            load_results(folder.root).export(target.root)
    assert other.run_table.read_bytes() == before


def test_a_run_table_that_was_imported_from_a_folder_is_not_replaced_by_its_export(folder, tmp_path):
    original = tmp_path / "original" / "run_table.csv"
    original.parent.mkdir()
    original.write_text("id,energy\n1,2.0\n")
    with pytest.raises(StorageError, match="that no export has written"):
        load_results(folder.root).export(original.parent)
    assert original.read_text() == "id,energy\n1,2.0\n"


def test_a_partial_experiment_is_exported(tmp_path):
    made = make_experiment(tmp_path / "e", values=lambda treatments, repetition: None)
    files = load_results(made.root).export()
    assert validate(str(files[-1])).valid


def test_a_place_that_cannot_be_written_is_refused(folder, tmp_path):
    (tmp_path / "file").write_text("", "utf-8")
    with pytest.raises(StorageError, match="cannot be made"):
        load_results(folder.root).export(tmp_path / "file" / "out")
