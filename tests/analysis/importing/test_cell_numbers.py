"""Numbers are read in whichever way people write them, and what is not clear is asked."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from robot_runner.analysis.importing.foreign_table import read_foreign_table
from robot_runner.analysis.importing.units import plain_cells

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.parametrize(
    ("cells", "plain", "words"),
    [
        (["1.5", "2"], ["1.5", "2"], ""),
        (["1,5", "2,25", "nan", ""], ["1.5", "2.25", "nan", ""], "decimal commas"),
        (["1,234.5", "2,345.25"], ["1234.5", "2345.25"], "commas between thousands"),
        (["1.234,5", "2.345.678,25"], ["1234.5", "2345678.25"], "points between thousands"),
        (["1 234,5", "12"], ["1234.5", "12"], "blanks between thousands"),
        (["1\u202f234.5", "-2\u00a0000"], ["1234.5", "-2000"], "blanks between thousands"),
        (["1'234.5", "12"], ["1234.5", "12"], "apostrophes between thousands"),
        (["1,5e3", "2,0E-2"], ["1.5e3", "2.0E-2"], "decimal commas"),
        (["22.01%", "21.5 %", "-"], ["22.01", "21.5", "-"], "the unit % behind each"),
        (["529,94mJ", "810,5mJ"], ["529.94", "810.5"], "decimal commas, the unit mJ behind each"),
        (["1.5 kJ", "2 J"], ["1.5 kJ", "2 J"], ""),
        (["video", "1,5"], ["video", "1,5"], ""),
        (["97,79", "95,23", "fehlt"], ["97.79", "95.23", "fehlt"], "decimal commas"),
        (["1,5 J", "2,25 J", "#DIV/0!"], ["1.5", "2.25", "#DIV/0!"], "decimal commas, the unit J behind each"),
        (["1,5", "2,5", "0 (stuck)"], ["1.5", "2.5", "0 (stuck)"], "decimal commas"),
        (["1;2", "3;4"], ["1;2", "3;4"], ""),
        (["0,125", "0,250"], ["0.125", "0.250"], "decimal commas"),
        ([], [], ""),
    ],
)
def test_numbers_are_written_plainly(cells, plain, words):
    found = plain_cells(cells, decimal=None, has_decimal_commas=False)
    assert (list(found.cells), found.words, found.doubt) == (plain, words, "")


@pytest.mark.parametrize(
    ("decimal", "plain", "doubt"),
    [
        (None, ["1.234", "12.5"], ""),
        (",", ["1.234", "12.5"], ""),
    ],
)
def test_one_clear_number_settles_a_column(decimal, plain, doubt):
    found = plain_cells(["1,234", "12,5"], decimal=decimal, has_decimal_commas=False)
    assert (list(found.cells), found.doubt) == (plain, doubt)


def test_what_can_be_read_in_two_ways_is_doubted():
    found = plain_cells(["1,234", "5,678"], decimal=None, has_decimal_commas=False)
    assert found.doubt == "1,234 may be 1.234 or 1234"


@pytest.mark.parametrize(("decimal", "plain"), [(".", ["1234", "5678"]), (",", ["1.234", "5.678"])])
def test_the_decimal_sign_settles_it(decimal, plain):
    found = plain_cells(["1,234", "5,678"], decimal=decimal, has_decimal_commas=False)
    assert (list(found.cells), found.doubt) == (plain, "")


def test_points_may_group_thousands_where_others_have_decimal_commas():
    found = plain_cells(["1.234", "12"], decimal=None, has_decimal_commas=True)
    assert found.doubt == "1.234 may be 1234 or 1.234"
    assert list(plain_cells(["1.5", "12"], decimal=None, has_decimal_commas=True).cells) == ["1.5", "12"]


@pytest.mark.parametrize(("decimal", "plain"), [(",", ["1000", "990"]), (".", ["1.000", "990"])])
def test_the_decimal_sign_settles_what_points_mean(decimal: str, plain: list[str]) -> None:
    found = plain_cells(["1.000", "990"], decimal=decimal, has_decimal_commas=True)
    assert (list(found.cells), found.doubt) == (plain, "")


def test_one_column_with_decimal_commas_puts_the_points_of_others_in_doubt(tmp_path: Path) -> None:
    path = tmp_path / "run_table.csv"
    path.write_text('Task,Energy,Packets\nVideo,"870,5",1.000\nNetwork,"831,2",990\n', encoding="utf-8")
    assert read_foreign_table(path).doubts == {"Packets": "1.000 may be 1000 or 1.000"}
    assert read_foreign_table(path, decimal=",").column("Packets") == ("1000", "990")


@pytest.mark.parametrize(
    ("rows", "doubts"),
    [
        ("Video;873.900;5\nNetwork;1.904.300;6\n", {}),
        ("Video;873.900;5\nNetwork;904.300;6\n", {"Energy": "873.900 may be 873900 or 873.900"}),
        ("Video;873.900;0.5\nNetwork;904.300;0.6\n", {}),
        ("Video;873.900;5.25\nNetwork;904.300;6.5\n", {}),
        ("Video;0.900;5\nNetwork;0.300;6\n", {}),
        ("Video;873900;5\nNetwork;904300;6\n", {}),
    ],
)
def test_points_may_group_thousands_where_cells_are_separated_by_semicolons(
    rows: str, doubts: dict[str, str], tmp_path: Path
) -> None:
    path = tmp_path / "run_table.csv"
    path.write_text(f"Task;Energy;Load\n{rows}", encoding="utf-8")
    assert read_foreign_table(path).doubts == doubts
    for decimal in ".,":
        assert not read_foreign_table(path, decimal=decimal).doubts
