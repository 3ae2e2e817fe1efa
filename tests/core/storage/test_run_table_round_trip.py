"""What is written into `run_table.csv` comes back with its type, whatever it is, and no row ever shifts."""

from __future__ import annotations

import csv
import io
import tempfile
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_runner.core.design.factor import Factor
from robot_runner.core.design.run_table_model import RunTableModel
from robot_runner.core.storage.cells import RunStatus
from robot_runner.core.storage.run_table_reading import read_run_table
from robot_runner.core.storage.run_table_rows import RunTableRows, table_text, write_run_table
from robot_runner.core.storage.table_columns import TableLayout
from robot_runner.core.storage.table_schema import describe_columns, read_schema, write_schema


class Thing:
    """An object of a user's own, known by its text alone."""

    def __init__(self, text: str) -> None:
        self.text = text

    def __str__(self) -> str:
        return self.text


texts = st.text(st.characters(exclude_categories=["Cs"]), max_size=12) | st.sampled_from(
    [
        "1",
        "1.0",
        "True",
        "None",
        "",
        " ",
        "a,b",
        'a"b',
        "a\nb",
        "a\r\nb",
        "a\rb",
        "-",
        ";",
        "\ufeff",
        "\x00",
        "'",
        "日本",
    ]
)
plain = st.integers() | st.floats() | st.booleans() | st.none() | texts
treatments = plain | texts.map(Thing) | st.tuples(st.integers(), texts) | st.lists(st.integers(), max_size=2)
factors = st.lists(treatments, min_size=1, max_size=6, unique_by=str).map(lambda values: values)
measures = (
    st.integers(-(2**1000), 2**1000)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.booleans()
    | st.none()
    | texts
)


def through_the_file(rows: RunTableRows, layout: TableLayout) -> RunTableRows:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run_table.csv"
        write_run_table(path, rows)
        return read_run_table(path, layout)


def as_factor(values: list[Any]) -> list[Any]:
    """Leave out what a factor refuses: equal values of one type with other texts, as 0.0 and -0.0."""
    kept: list[Any] = []
    for value in values:
        is_new = not any(type(value) is type(other) and value == other for other in kept)
        kept += [value] if is_new else []
    return kept


@pytest.mark.long
@given(factors.map(as_factor), factors.map(as_factor), st.integers(1, 3), st.booleans())
def test_treatments_come_back_as_they_are(one: list[Any], other: list[Any], repetitions: int, shuffle: bool) -> None:
    model = RunTableModel([Factor("One", one), Factor("Other", other)], repetitions=repetitions, shuffle=shuffle)
    layout = TableLayout.of_model(model, ["Energy"])
    read = through_the_file(RunTableRows.of_plan(model.plan(), layout), layout)
    assert read.warnings == ()
    assert len(read) == len(model.plan())
    for place, run in enumerate(model.plan()):
        assert all(read.combination(place)[name] is value for name, value in run.combination.items())
        assert read.repetition(place) == run.repetition
        assert read.run_id(place) == run.run_id


@pytest.mark.long
@given(st.lists(st.tuples(measures, measures, st.sampled_from(RunStatus)), min_size=1, max_size=8))
def test_measures_and_statuses_come_back_as_they_are(records: list[tuple[Any, Any, RunStatus]]) -> None:
    model = RunTableModel([Factor("N", range(len(records)))])
    layout = TableLayout.of_model(model, ["A", "B"])
    rows = RunTableRows.of_plan(model.plan(), layout)
    for place, (one, other, status) in enumerate(records):
        rows.record(rows.run_id(place), status=status, measures={"A": one, "B": other})
    types = {column.name: column.type for column in describe_columns(rows)}
    read = through_the_file(rows, TableLayout.of_model(model, ["A", "B"], types))
    for place, (one, other, status) in enumerate(records):
        assert read.status(place) is status
        for name, value in (("A", one), ("B", other)):
            if types[name] != "any" or not isinstance(value, str):
                found = read.row(place)[name]
                assert type(found) is type(None if value == "" else value)
                assert found == (None if value == "" else value)
    assert [read.count(status) for status in RunStatus] == [rows.count(status) for status in RunStatus]


@given(st.lists(texts, min_size=1, max_size=5, unique=True), st.lists(measures, min_size=5, max_size=5))
def test_every_row_of_the_file_has_a_cell_for_each_heading(values: list[str], found: list[Any]) -> None:
    model = RunTableModel([Factor("Text", values)])
    rows = RunTableRows.of_plan(model.plan(), TableLayout.of_model(model, ["Energy"]))
    for place, value in zip(range(len(rows)), found, strict=False):
        rows.record(rows.run_id(place), measures={"Energy": value})
    lines = list(csv.DictReader(io.StringIO("".join(table_text(rows)), newline=""), strict=True))
    assert [line["Text"] for line in lines] == values
    assert all(None not in line and None not in line.values() for line in lines)


def test_a_second_reading_finds_what_the_first_one_kept(tmp_path: Path) -> None:
    layout = TableLayout.of_model(RunTableModel([Factor("Task", ["Video"])]), ["Energy"])
    path = tmp_path / "run_table.csv"
    path.write_text('Note,ID,Task,Energy\n"a,b",x,other,5\nc,y,Video,\n', encoding="utf-8")
    once = read_run_table(path, layout)
    write_run_table(path, once)
    assert list(read_run_table(path, layout)) == list(once)
    assert list(read_run_table(path, once.layout)) == list(once)


def test_the_folder_alone_is_enough_to_read_the_table_with_its_types(tmp_path: Path) -> None:
    model = RunTableModel([Factor("Task", ["1", "2"]), Factor("Speed", [0.5, 1])], repetitions=2)
    rows = RunTableRows.of_plan(model.plan(), TableLayout.of_model(model, ["Energy", "Note"]))
    rows.record("r_1", measures={"Energy": 1.0, "Note": "5"})
    write_run_table(tmp_path / "run_table.csv", rows)
    write_schema(tmp_path / "schema.json", describe_columns(rows))
    layout = TableLayout.of_schema(read_schema(tmp_path / "schema.json"))
    assert list(read_run_table(tmp_path / "run_table.csv", layout)) == list(rows)
    assert layout.columns == rows.layout.columns
