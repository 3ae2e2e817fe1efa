"""What is exported for spreadsheets means the same in all of them; the tables themselves are left as they are."""

from __future__ import annotations

import openpyxl
import pytest
from tests.analysis.made_experiment import make_experiment

from robot_runner.analysis.exporting import write_workbook
from robot_runner.core.design.factor import Factor
from robot_runner.core.errors import StorageError

FORMULAS = [
    "=1+1",
    '=HYPERLINK("http://example.org","here")',
    "+cmd|' /C calc'!A0",
    "-2+3",
    "@SUM(1,1)",
    "\uff1d1+1",
    "-",
]


def cells_of(path):
    """Return what openpyxl finds in the cells of a workbook: numbers, texts, None where there is nothing."""
    rows = list(openpyxl.load_workbook(path).active.iter_rows())
    assert not [cell for row in rows for cell in row if cell.data_type not in {"n", "s", "inlineStr"}]  # a formula
    return [[cell.value for cell in row] for row in rows]


def written(tmp_path, rows, **settings):
    write_workbook(rows, tmp_path / "table.xlsx", **settings)
    return cells_of(tmp_path / "table.xlsx")


def test_a_formula_is_a_text(tmp_path):
    assert written(tmp_path, [["Task"], *([each] for each in FORMULAS)]) == [["Task"], *([each] for each in FORMULAS)]


@pytest.mark.parametrize(
    "text", ["0.125", "-1.5", "-0.875", "1e-07", "4996803012878.671", "0", "870.0", "9007199254740992"]
)
def test_a_number_is_a_number_whose_decimal_sign_no_language_changes(tmp_path, text):
    # In a CSV file, a German spreadsheet takes 0.125 for 125, and 12.5 for a day in May.
    assert written(tmp_path, [["Energy"], [text]]) == [["Energy"], [float(text)]]


@pytest.mark.parametrize(
    "text", ["1.10", "007", "9007199254740993", "1e400", "2026-11-22T16:16:25Z", "Video", "a=b", " 1"]
)
def test_what_a_number_would_not_show_as_it_is_stays_a_text(tmp_path, text):
    assert written(tmp_path, [["Version"], [text]]) == [["Version"], [text]]


def test_of_a_column_of_numbers_each_number_is_one_however_it_is_written(tmp_path):
    rows = [["run_id", "Energy", "Version"], ["r_1", "1.10", "1.10"], ["r_2", "+3", "+3"], ["r_3", "", ""]]
    assert written(tmp_path, rows, numeric={"Energy"}) == [
        ["run_id", "Energy", "Version"],
        ["r_1", 1.1, "1.10"],
        ["r_2", 3.0, "+3"],
        ["r_3", None, None],
    ]


def test_signs_that_xml_has_no_place_for_are_written_as_spreadsheets_read_them(tmp_path):
    [[heading], [text]] = written(tmp_path, [['<b> & "q"'], ["a\x07b_x0041_ \r\n c"]])
    assert heading == '<b> & "q"'
    assert text == "a_x0007_b_x005F_x0041_ _x000D_\n c"


def test_a_row_that_is_longer_than_the_headings_keeps_its_cells(tmp_path):
    assert written(tmp_path, [["Task"], ["Video", "0.5", "note"]])[1] == ["Video", 0.5, "note"]


def test_a_text_that_is_longer_than_a_cell_holds_is_cut_and_says_so(tmp_path):
    [[note]] = written(tmp_path, [[40_000 * "é"]])
    assert len(note) == 32_767
    assert note.endswith("é…")


def test_a_table_of_more_rows_than_a_sheet_holds_is_refused_once_all_else_is_exported(
    tmp_path, robot_runner, monkeypatch
):
    made = make_experiment(tmp_path / "made")
    monkeypatch.setattr("robot_runner.analysis.exporting._MOST_ROWS", 1)
    answer = robot_runner("export", made.root, "--to", tmp_path / "out", "--spreadsheets")
    assert answer.code == 2
    assert "the table has 7 rows, and a workbook holds 1" in answer.err
    assert "without --spreadsheets" in answer.err
    assert (tmp_path / "out" / "datapackage.json").exists()


def test_a_table_of_more_columns_than_a_sheet_holds_is_refused(tmp_path):
    assert written(tmp_path, [[f"c{number}" for number in range(16_384)]])[0][-1] == "c16383"
    with pytest.raises(StorageError, match="the table has 16,385 columns, and a workbook holds 16,384"):
        written(tmp_path, [["Task"] * 16_385])


def test_the_same_table_is_the_same_bytes(tmp_path):
    for name in ("one", "other"):
        write_workbook([["Task"], ["Video"]], tmp_path / name)
    assert (tmp_path / "one").read_bytes() == (tmp_path / "other").read_bytes()


def test_the_command_writes_workbooks_and_changes_no_table(tmp_path, robot_runner):
    made = make_experiment(
        tmp_path / "made",
        [Factor("Task", ["=1+1", "Video"]), Factor("Offset", [-1.5, 2.0])],
        lambda treatments, repetition: {"Energy": -870.125},
        measures=["Energy"],
        units={"Energy": "J"},
    )
    (made.root / "report" / "tables").mkdir(parents=True)
    (made.root / "report" / "tables" / "means.csv").write_text("Task,Mean\r\n@x,-3.125\r\n", encoding="utf-8")
    before = made.run_table.read_bytes()
    answer = robot_runner("export", made.root, "--to", tmp_path / "out", "--spreadsheets")
    assert answer.code == 0, answer.err
    assert "Spreadsheets" in answer.out
    assert made.run_table.read_bytes() == before == (tmp_path / "out" / "run_table.csv").read_bytes()
    heading, *rows = cells_of(tmp_path / "out" / "spreadsheets" / "run_table.xlsx")
    columns = dict(zip(heading, zip(*rows, strict=True), strict=True))
    assert set(columns["Task"]) == {"=1+1", "Video"}
    assert set(columns["Offset"]) == {-1.5, 2.0}
    assert set(columns["Energy"]) == {-870.125}
    assert cells_of(tmp_path / "out" / "spreadsheets" / "means.xlsx") == [["Task", "Mean"], ["@x", -3.125]]
    assert robot_runner("export", made.root, "--to", tmp_path / "plain").code == 0
    assert not (tmp_path / "plain" / "spreadsheets").exists()
