"""A run table that people made or edited is read as they meant it, or refused with every problem that it has."""

from __future__ import annotations

import csv
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest

from robot_runner.core.design.factor import Factor
from robot_runner.core.design.run_table_model import RunTableModel
from robot_runner.core.errors import StorageError
from robot_runner.core.storage import run_table_reading
from robot_runner.core.storage.cells import RunStatus
from robot_runner.core.storage.run_table_reading import LARGEST, read_run_table
from robot_runner.core.storage.run_table_rows import RunTableRows, table_text, write_run_table
from robot_runner.core.storage.table_columns import EARLIER_SPELLING, FactorColumn, TableLayout

if TYPE_CHECKING:
    from pathlib import Path

TASK = Factor("Task", ["Video", "Network"])
SPEED = Factor("Speed", [0.1, 1, True, None])
LAYOUT = TableLayout.of_model(RunTableModel([TASK, SPEED]), ["CPU", "Energy"])


def read(folder: Path, text: str | bytes, layout: TableLayout = LAYOUT) -> RunTableRows:
    path = folder / "run_table.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_run_table(path, layout)


def findings_of(folder: Path, text: str | bytes, layout: TableLayout = LAYOUT) -> list[str]:
    with pytest.raises(StorageError) as caught:
        read(folder, text, layout)
    return [str(finding).replace(f"{folder}/", "") for finding in caught.value.findings]


def warnings_of(rows: RunTableRows, folder: Path) -> list[str]:
    return [str(finding).replace(f"{folder}/", "") for finding in rows.warnings]


def test_the_factors_alone_are_enough(tmp_path: Path) -> None:
    rows = read(tmp_path, "Task,Speed\nVideo,0.1\nNetwork,1\nVideo,1\n")
    assert [rows.run_id(place) for place in range(3)] == ["r_1", "r_2", "r_3"]
    assert rows.count(RunStatus.TODO) == 3
    assert [tuple(rows.combination(place).values()) for place in range(3)] == [
        ("Video", 0.1),
        ("Network", 1),
        ("Video", 1),
    ]
    assert rows.row(0)["Energy"] is None
    assert rows.row(0)["start_run_at"] is None
    assert rows.warnings == ()


def test_columns_may_stand_in_any_order_and_under_the_papers_headings(tmp_path: Path) -> None:
    rows = read(tmp_path, "Energy,Speed,Status,Task,ID\n877,0.1,Done,Video,r_1\n,1,-,Network,r_2\n")
    assert rows.status(0) is RunStatus.DONE
    assert rows.row(0)["Energy"] == 877
    assert rows.index_of("r_2") == 1


def test_a_heading_id_beside_run_id_is_the_users_own(tmp_path: Path) -> None:
    rows = read(tmp_path, "run_id,Task,Speed,ID\nr_1,Video,1,abc\n")
    assert rows.layout.extras == ("ID",)
    assert rows.row(0)["ID"] == "abc"


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
@pytest.mark.parametrize("mark", [b"", b"\xef\xbb\xbf"], ids=["plain", "with a mark"])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"], ids=["unix", "windows", "old mac"])
def test_what_spreadsheets_write_is_read(tmp_path: Path, delimiter: str, mark: bytes, end: str) -> None:
    lines = [["run_id", "Task", "Speed"], ["a1", "Video", "0.1"], ["a2", "Network", "TRUE"]]
    rows = read(tmp_path, mark + end.join(delimiter.join(line) for line in lines).encode())
    assert [dict(rows.combination(place)) for place in range(2)] == [
        {"Task": "Video", "Speed": 0.1},
        {"Task": "Network", "Speed": True},
    ]
    assert rows.index_of("a2") == 1
    assert rows.warnings == ()


def test_decimal_commas_are_read_between_semicolons(tmp_path: Path) -> None:
    layout = TableLayout.of_model(RunTableModel([SPEED]), ["Energy"], {"Energy": "number"})
    rows = read(tmp_path, "run_id;Speed;Energy\nr_1;0,1;877,5\n", layout)
    assert (rows.row(0)["Speed"], rows.row(0)["Energy"]) == (0.1, 877.5)


@pytest.mark.parametrize("line", ["sep=;", "SEP=,", "sep=\t", '"sep=;"', "sep=,,", "sep=;,,,", '"sep=,",,'])
def test_a_first_line_for_excel_is_told_to_be_deleted(tmp_path: Path, line: str) -> None:
    """The report's scripts in R and Python read the same file, and would take it for the headings."""
    (told,) = findings_of(tmp_path, f"{line}\nTask;Energy\nVideo;1\n")
    fix = "Delete this line: other programs read it as the headings."
    assert told == f"run_table.csv: the line {line.strip()!r} above the headings is for Excel alone → {fix}"


def test_headings_that_r_spells_are_understood(tmp_path: Path) -> None:
    """As `read.csv` makes them, unless `check.names = FALSE` is said; the spellings are those of `make.names`."""
    spelt = {"Light level": "Light.level", "2nd run": "X2nd.run", "Energy (J)": "Energy..J.", "größe": "größe"}
    spelt |= {"cpu %": "cpu..", "_a": "X_a", ".5x": "X.5x", ".ok": ".ok", "a-b": "a.b", "R²": "R."}
    factors, measures = ["Light level", "2nd run"], [*spelt][2:]
    model = RunTableModel([Factor(name, [0, 1]) for name in factors])
    layout = TableLayout.of_model(model, measures, dict.fromkeys(measures, "number"))
    text = ",".join(["run_id", *spelt.values(), "my.note"]) + "\n" + ",".join(["r_1", *"0103456789", "x"]) + "\n"
    rows = read(tmp_path, text, layout)
    assert dict(rows.combination(0)) == {"Light level": 0, "2nd run": 1}
    assert [rows.row(0)[name] for name in measures] == [0, 3, 4, 5, 6, 7, 8, 9]
    assert rows.layout.extras == ("my.note",)


def test_headings_that_r_spells_alike_are_told_apart_by_its_numbers(tmp_path: Path) -> None:
    """In the order of the file, and first those that R leaves as they are; `make.names(unique = TRUE)` spells them."""
    measures = ["Energy (J)", "Energy [J]", "CPU %", "CPU #", "x y", "x-y", "x.y.1", "a b", "a.b"]
    measures += ["TRUE", "if", "% cpu"]
    spelt = ["Energy..J.", "Energy..J..1", "CPU..", "CPU...1", "x.y", "x.y.2", "x.y.1", "a.b.1", "a.b"]
    spelt += ["TRUE.", "if.", "X..cpu"]
    layout = TableLayout.of_model(RunTableModel([SPEED]), measures, dict.fromkeys(measures, "number"))
    cells = map(str, range(len(measures)))
    rows = read(tmp_path, f"run_id,Speed,{','.join(spelt)}\nr_1,0.1,{','.join(cells)}\n", layout)
    assert [rows.row(0)[name] for name in measures] == [*range(len(measures))]
    assert rows.layout.extras == ()
    earlier = TableLayout.of_model(RunTableModel([SPEED]), ["CPU %"], {"CPU %": "number"}, EARLIER_SPELLING)
    rows = read(tmp_path, "X__run_id,X__done,Speed,CPU..\nr_1,DONE,0.1,5\n", earlier)
    assert (rows.run_id(0), rows.status(0), rows.row(0)["CPU %"]) == ("r_1", RunStatus.DONE, 5)


def test_a_heading_that_is_a_column_of_its_own_is_no_other_ones_spelling(tmp_path: Path) -> None:
    layout = TableLayout.of_model(RunTableModel([SPEED]), ["a b", "a.b"], {"a b": "number", "a.b": "number"})
    rows = read(tmp_path, "run_id,Speed,a.b\nr_1,0.1,2\n", layout)
    assert (rows.row(0)["a b"], rows.row(0)["a.b"]) == (None, 2)
    rows = read(tmp_path, "run_id,Speed,a b,a.b\nr_1,0.1,1,2\n", layout)
    assert (rows.row(0)["a b"], rows.row(0)["a.b"]) == (1, 2)
    layout = TableLayout.of_model(RunTableModel([SPEED]), ["a b"], {"a b": "number"})
    rows = read(tmp_path, "run_id,Speed,a b,a.b\nr_1,0.1,1,2\n", layout)
    assert (rows.row(0)["a b"], rows.layout.extras) == (1, ("a.b",))


def test_blank_lines_and_trailing_commas_are_no_runs(tmp_path: Path) -> None:
    rows = read(tmp_path, "\nTask,Speed,,\n\nVideo,1,,\n,,,\nNetwork,1\n\n")
    assert len(rows) == 2


def test_cells_may_be_written_as_people_write(tmp_path: Path) -> None:
    rows = read(tmp_path, " Task , Speed\n video ,1.0\nNETWORK,true\nVideo,1e-1\nVideo,none\n")
    assert [tuple(rows.combination(place).values()) for place in range(4)] == [
        ("Video", 1),
        ("Network", True),
        ("Video", 0.1),
        ("Video", None),
    ]
    assert type(rows.combination(0)["Speed"]) is int
    assert rows.warnings == ()


def test_a_users_own_columns_are_kept_at_the_end(tmp_path: Path) -> None:
    rows = read(tmp_path, "Remark,Task,Speed,Energy,Weather\nlate,Video,1,5,\n,Network,1,6,007\n")
    assert rows.layout.columns[-4:] == ("CPU", "Energy", "Remark", "Weather")
    assert (rows.row(0)["Remark"], rows.row(0)["Weather"]) == ("late", None)
    assert rows.row(1)["Weather"] == "007"


def test_a_value_that_is_no_treatment_is_kept_with_a_warning(tmp_path: Path) -> None:
    rows = read(tmp_path, "Task,Speed\nVidoe,1\nVideo,2.5\nVidoe,1\nVideo,\n")
    assert [tuple(rows.combination(place).values()) for place in range(4)] == [
        ("Vidoe", 1),
        ("Video", 2.5),
        ("Vidoe", 1),
        ("Video", None),
    ]
    assert warnings_of(rows, tmp_path) == [
        "run_table.csv, line 2, column 'Task': 'Vidoe' is not a treatment of factor 'Task' → Did you mean 'Video'?",
        (
            "run_table.csv, line 3, column 'Speed': '2.5' is not a treatment of factor 'Speed' → "
            "Choose one of: 0.1, 1, True, None."
        ),
        "run_table.csv, line 5, column 'Speed': the cell is empty → Choose one of: 0.1, 1, True, None.",
    ]


@pytest.mark.parametrize("missing", ["NA", "NaN", "nan"], ids=["R", "pandas", "numpy"])
def test_what_other_programs_write_for_a_missing_number_or_time_stamp_is_missing(tmp_path: Path, missing: str) -> None:
    types = {"Energy": "number", "Lost": "boolean", "Room": "string"}
    layout = TableLayout((FactorColumn("Task", TASK),), ("Energy", "Lost", "Room"), types=types)
    text = "Task,start_run_at,Energy,Lost,Room\nVideo,2026-01-31T12:00:00.250Z,5.5,TRUE,lab\n"
    rows = read(tmp_path, f"{text}Video,{missing},{missing},{missing},{missing}\n", layout)
    assert [rows.row(1)[name] for name in ("start_run_at", "Energy", "Lost", "Room")] == [None, None, None, missing]
    assert warnings_of(rows, tmp_path) == []


def test_a_measure_or_time_stamp_of_another_kind_is_kept_with_a_warning(tmp_path: Path) -> None:
    layout = TableLayout(
        (FactorColumn("Task", TASK),), ("Energy", "Lost"), types={"Energy": "number", "Lost": "boolean"}
    )
    rows = read(tmp_path, "Task,start_run_at,Energy,Lost\nVideo,31.1.2026,n/a,yes\nVideo,,5,FALSE\n", layout)
    assert [rows.row(0)[name] for name in ("start_run_at", "Energy", "Lost")] == ["31.1.2026", "n/a", "yes"]
    assert [rows.row(1)[name] for name in ("start_run_at", "Energy", "Lost")] == [None, 5, False]
    assert warnings_of(rows, tmp_path) == [
        (
            "run_table.csv, line 2, column 'start_run_at': '31.1.2026' is not a time stamp → "
            "Write it as in 2026-01-31T12:00:00.250Z."
        ),
        (
            "run_table.csv, line 2, column 'Energy': 'n/a' is not a number, as the column's other values → "
            "Correct the cell, or leave it empty where there is no value."
        ),
        (
            "run_table.csv, line 2, column 'Lost': 'yes' is not a boolean, as the column's other values → "
            "Correct the cell, or leave it empty where there is no value."
        ),
    ]


def test_repetitions_may_be_uneven_and_are_counted_where_they_are_not_written(tmp_path: Path) -> None:
    layout = TableLayout.of_model(RunTableModel([TASK], repetitions=2), [])
    written = read(tmp_path, "Task,Repetition\nVideo,1\nVideo,2.0\nVideo,7\n", layout)
    assert [written.repetition(place) for place in range(3)] == [1, 2, 7]
    counted = read(tmp_path, "Task\nVideo\nNetwork\nVideo\n", layout)
    assert [counted.repetition(place) for place in range(3)] == [1, 1, 2]


def test_without_its_config_a_table_goes_by_looks_and_types(tmp_path: Path) -> None:
    layout = TableLayout(
        (FactorColumn("Task"), FactorColumn("Speed")), ("Energy",), types={"Task": "string", "Speed": "number"}
    )
    rows = read(tmp_path, "Task,Speed,Energy\n1,0.5,\n2,1,877\n", layout)
    assert [dict(rows.combination(place)) for place in range(2)] == [
        {"Task": "1", "Speed": 0.5},
        {"Task": "2", "Speed": 1},
    ]
    assert rows.warnings == ()


@pytest.mark.parametrize(
    ("text", "findings"),
    [
        ("", ["run_table.csv: the run table has no runs → {empty}"]),
        ("Task,Speed\n", ["run_table.csv: the run table has no runs → {empty}"]),
        ("Tasks,Speed\nVideo,1\n", ["run_table.csv, line 1: the column of factor 'Task' is missing → Rename 'Tasks'."]),
        (
            "Speed\n1\n",
            ["run_table.csv, line 1: the column of factor 'Task' is missing → Add a column 'Task'."],
        ),
        (
            "Task,Speed,Task\nVideo,1,Video\n",
            ["run_table.csv, line 1, column 'Task': heading 'Task' is there twice → Rename or delete one."],
        ),
        (
            "ID,Run ID,Task,Speed\na,b,Video,1\n",
            ["run_table.csv, line 1, column 'run_id': heading 'run_id' is there twice → Rename or delete one."],
        ),
        (
            ",Task,Speed\n0,Video,1\n",
            ["run_table.csv, line 1: heading 1 is empty → Name the column, or delete it."],
        ),
        (
            "Task,Speed\nVideo\nVideo,1,late\nVideo,1\n",
            [
                "run_table.csv, line 2: the row has 1 cells, the heading has 2 → {cells}",
                "run_table.csv, line 3: the row has 3 cells, the heading has 2 → {cells}",
            ],
        ),
        (
            "Task,Speed,,\nVideo,1,,\nVideo,1,,late\nVideo,1,2,late\nVideo,1,2,late\nVideo,1,2,3,4\n",
            [
                "run_table.csv, line 3: column 4 has the value 'late', and its heading is empty → {unnamed}",
                "run_table.csv, line 4: column 3 has the value '2', and its heading is empty → {unnamed}",
                "run_table.csv, line 6: the row has 5 cells, the heading has 4 → {cells}",
            ],
        ),
        (
            "Task,Speed,\nVideo,1,2\n",
            ["run_table.csv, line 2: column 3 has the value '2', and its heading is empty → {unnamed}"],
        ),
        (
            "run_id,Task,Speed\nr_1,Video,1\nr_1,Video,1\nR_1,Video,1\n",
            [
                "run_table.csv, line 3, column 'run_id': run id 'r_1' is there twice → Give each run an id of its own.",
                "run_table.csv, line 4, column 'run_id': run id 'R_1' is there twice → Give each run an id of its own.",
            ],
        ),
        (
            "run_id,Task,Speed\na,Video,1\n,Video,1\n",
            [
                (
                    "run_table.csv, line 3, column 'run_id': the run has no id → "
                    "Give it an id, or leave the whole column empty: runs are numbered then."
                )
            ],
        ),
        (
            "run_id,Task,Speed\n../a,Video,1\na/b,Video,1\n.,Video,1\n",
            [
                "run_table.csv, line 2, column 'run_id': '../a' cannot name a run's folder → {folder}",
                "run_table.csv, line 3, column 'run_id': 'a/b' cannot name a run's folder → {folder}",
                "run_table.csv, line 4, column 'run_id': '.' cannot name a run's folder → {folder}",
            ],
        ),
        (
            "status,Task,Speed\nDnoe,Video,1\nok,Video,1\nDnoe,Video,1\n",
            [
                "run_table.csv, line 2, column 'status': 'Dnoe' is not a status → Did you mean 'Done'?",
                (
                    "run_table.csv, line 3, column 'status': 'ok' is not a status → "
                    "Choose one of: '-', 'Running', 'Done', 'Failed'."
                ),
                "run_table.csv, line 4, column 'status': 'Dnoe' is not a status → Did you mean 'Done'?",
            ],
        ),
        (
            'Task,Speed\n"Vid\neo",1\nVideo\n',
            [
                "run_table.csv, line 4: the row has 1 cells, the heading has 2 → {cells}",
                (
                    "run_table.csv, line 2, column 'Task': 'Vid\\neo' is not a treatment of factor 'Task' → "
                    "Did you mean 'Video'?"
                ),
            ],
        ),
        (
            'Task,Speed\nVideo,1\n"Video,1\nNetwork,1\n',
            [
                (
                    "run_table.csv, line 3: a cell is not quoted rightly from here on (unexpected end of data) → "
                    "Put the cell between double quotes, and double those inside it."
                )
            ],
        ),
        (
            'Task,Speed\nVideo,1\n"Video"x,1\n',
            [
                (
                    "run_table.csv, line 3: a cell is not quoted rightly from here on (',' expected after '\"') → "
                    "Put the cell between double quotes, and double those inside it."
                )
            ],
        ),
        (
            "Task,Speed\nVid\xe9o,1\n".encode("latin-1"),
            [
                (
                    "run_table.csv: the file is not UTF-8: 'utf-8' codec can't decode byte 0xe9 in position 14: "
                    "invalid continuation byte → Save it as CSV with the character set UTF-8."
                )
            ],
        ),
    ],
    ids=range(18),
)
def test_every_problem_is_named_with_its_line_and_column(
    tmp_path: Path, text: str | bytes, findings: list[str]
) -> None:
    shared = {
        "empty": "Add a line for each run, or delete the file: it is planned again then.",
        "cells": "Give it a cell under each heading; an empty one where there is no value.",
        "unnamed": "Write a name for it into the first line.",
        "folder": "Use letters, digits, '_', '-' and '.' (60 at most).",
    }
    assert findings_of(tmp_path, text) == [finding.format(**shared) for finding in findings]


def test_a_number_of_a_repetition_that_is_none_is_refused(tmp_path: Path) -> None:
    layout = TableLayout.of_model(RunTableModel([TASK], repetitions=2), [])
    fix = "Write which repetition it is: a whole number from 1."
    assert findings_of(tmp_path, "Task,Repetition\nVideo,0\nVideo,1\nVideo,\nVideo,1.5\n", layout) == [
        f"run_table.csv, line 2, column 'Repetition': '0' is not the number of a repetition → {fix}",
        f"run_table.csv, line 4, column 'Repetition': '' is not the number of a repetition → {fix}",
        f"run_table.csv, line 5, column 'Repetition': '1.5' is not the number of a repetition → {fix}",
    ]


def test_what_tells_how_a_run_was_planned_is_refused_where_it_is_nothing_of_that_kind(tmp_path: Path) -> None:
    layout = replace(LAYOUT, marks=("batch", "warm_up"))
    rows = read(tmp_path, "Task,Speed,batch,warm_up\nVideo,1,2,True\nVideo,1,,\n", layout)
    assert [(rows.row(place)["batch"], rows.row(place)["warm_up"]) for place in (0, 1)] == [(2, True), (1, False)]
    assert findings_of(tmp_path, "Task,Speed,batch,warm_up\nVideo,1,2,True\nVideo,1,b,7\n", layout) == [
        "run_table.csv, line 3, column 'batch': 'b' is not an integer → Write a whole number.",
        "run_table.csv, line 3, column 'warm_up': '7' is not a boolean → Write True or False.",
    ]


def test_problems_of_several_kinds_are_listed_together(tmp_path: Path) -> None:
    findings = findings_of(tmp_path, "run_id,status,Task,Speed,Speed\na,Dnoe,Video,1,1\na,-,Video\n")
    assert len(findings) == 3


def test_a_thousand_problems_are_not_all_listed(tmp_path: Path) -> None:
    findings = findings_of(tmp_path, "Task,Speed\n" + "Video\n" * 1000)
    assert len(findings) == 51
    assert "run_table.csv: there are 951 more of them" in findings


def test_lines_are_counted_across_chunks(tmp_path: Path) -> None:
    text = "run_id,Task,Speed\n" + "".join(f"r_{number},Video,1\n" for number in range(1, 1200)) + "r_7,Video,1\n"
    (finding,) = findings_of(tmp_path, text)
    assert finding.startswith("run_table.csv, line 1201, column 'run_id': run id 'r_7' is there twice")


def test_a_file_that_cannot_be_opened_is_named_with_a_fix(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match=r"run_table\.csv is missing → Execute the experiment once more"):
        read_run_table(tmp_path / "run_table.csv", LAYOUT)
    with pytest.raises(StorageError, match="the folder cannot be read: Is a directory → Move the folder"):
        read_run_table(tmp_path, LAYOUT)


def test_a_long_cell_is_read_whole(tmp_path: Path) -> None:
    text = "x" * 200_000
    rows = read(tmp_path, f"Task,Speed,Energy\nVideo,1,{text}\n")
    assert rows.row(0)["Energy"] == text


def test_a_first_line_longer_than_any_cell_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    longest = csv.field_size_limit(100_000)
    monkeypatch.setattr(run_table_reading, "_LONGEST_CELL", 100_000)
    try:
        findings = findings_of(tmp_path, "x" * 200_000)
    finally:
        csv.field_size_limit(longest)
    assert findings[0].startswith("run_table.csv, line 1: a cell is not quoted rightly from here on (field larger than")


def test_a_table_of_a_million_runs_with_every_stamp_may_be_read() -> None:
    model = RunTableModel([Factor("Load", range(990_000, 991_000))], data_columns=["CPU", "Energy"])
    rows = RunTableRows.of_plan(model.plan(), TableLayout.of_model(model, ["CPU", "Energy"]))
    stamps = dict.fromkeys(rows.layout.stamps, "2026-01-31T10:00:00.250Z")
    for number in range(1, len(rows) + 1):
        measures = {"CPU": 100 / 3, "Energy": 900 / 7}
        rows.record(f"r_{number}", status=RunStatus.DONE, stamps=stamps, measures=measures)
    assert sum(map(len, table_text(rows))) * 1000 < LARGEST


def test_a_table_edited_by_hand_can_be_recorded_in(tmp_path: Path) -> None:
    rows = read(tmp_path, "ID,Task,Speed\nsecond,Video,1\nfirst,Network,1\n")
    rows.record("first", status=RunStatus.DONE, measures={"Energy": 1.5})
    assert rows.row(1)["Energy"] == 1.5
    with pytest.raises(StorageError, match="there is no run 'r_1'"):
        rows.index_of("r_1")


def test_types_are_those_of_the_factors_whatever_the_cells_look_like(tmp_path: Path) -> None:
    layout = TableLayout.of_model(RunTableModel([Factor("Load", ["1", 2, "None"])]), [])
    values: list[Any] = [row["Load"] for row in read(tmp_path, "Load\n1\n2\nNone\n", layout)]
    assert values == ["1", 2, "None"]


def test_an_emptied_cell_stays_empty_where_none_is_a_treatment(tmp_path: Path) -> None:
    rows = read(tmp_path, "Task,Speed\nVideo,\nVideo,None\n")
    assert [row["Speed"] for row in rows] == [None, None]
    lines = "".join(table_text(rows)).splitlines()
    place = lines[0].split(",").index("Speed")
    assert [line.split(",")[place] for line in lines[1:]] == ["", "None"]


def test_a_cell_keeps_the_way_in_which_it_was_written_where_its_treatment_is_not_known(tmp_path: Path) -> None:
    layout = TableLayout((FactorColumn("Speed"),), stamps=(), types={"Speed": "number"})
    rows = read(tmp_path, "Speed\n+0.50\n0.5\n", layout)
    assert [row["Speed"] for row in rows] == [0.5, 0.5]
    assert "".join(table_text(rows)) == "run_id,status,Speed\nr_1,-,+0.50\nr_2,-,0.5\n"


def test_rows_that_are_as_planned_refer_to_the_plan(tmp_path: Path) -> None:
    model = RunTableModel([TASK], repetitions=2, shuffle=True, seed=1)
    layout = TableLayout.of_model(model, [])
    plan = model.plan()
    write_run_table(tmp_path / "run_table.csv", RunTableRows.of_plan(plan, layout))
    rows = read_run_table(tmp_path / "run_table.csv", layout, plan)
    assert all(one is other for one, other in zip(plan, rows.planned, strict=True))
    text = (tmp_path / "run_table.csv").read_text(encoding="utf-8").replace("Video", "Network")
    edited = read(tmp_path, text, layout)
    assert [row["Task"] for row in edited] == ["Network"] * 4
