from __future__ import annotations

import csv
import json
from array import array

import pytest

from robot_runner.core.events.window import Window
from robot_runner.measuring.quality import Column, quality_of, write_quality, write_samples


def test_columns_come_back_as_they_were_written(tmp_path):
    path = tmp_path / "samples.csv"
    write_samples(path, [Column("time_s", array("d", [0.005, 0.01])), Column("raw", array("h", [-3, 7]), "%d")])
    with path.open(newline="") as file:
        assert list(csv.reader(file)) == [["time_s", "raw"], ["0.005000", "-3"], ["0.010000", "7"]]


def test_names_in_any_language_come_back(tmp_path):
    write_samples(tmp_path / "samples.csv", [Column("cpu_grüner_percent", [1.0]), Column("raw_\udcff", [2.0])])
    lines = (tmp_path / "samples.csv").read_text(encoding="utf-8").splitlines()
    assert lines == ["cpu_grüner_percent,raw_\\udcff", "1.000000,2.000000"]  # the last one was no UTF-8


def test_no_samples_leave_the_heading(tmp_path):
    write_samples(tmp_path / "samples.csv", [Column("time_s", [])])
    assert (tmp_path / "samples.csv").read_text() == "time_s\n"


def test_columns_of_unequal_length_are_refused(tmp_path):
    with pytest.raises(ValueError, match="shorter"):
        write_samples(tmp_path / "samples.csv", [Column("a", [1.0, 2.0]), Column("b", [1.0])])


def test_quality_and_details_stand_in_one_object(tmp_path):
    window = Window(1.0, 2.0)
    write_quality(tmp_path / "quality.json", quality_of([1.5], window, 1.0), window, {"rate_hz": 1.0})
    facts = json.loads((tmp_path / "quality.json").read_text())
    assert facts["window"] == {"start": 1.0, "end": 2.0}
    assert facts["samples"]["got"] == 1
    assert facts["rate_hz"] == 1.0


def test_a_missing_value_leaves_its_cell_empty(tmp_path):
    write_samples(tmp_path / "samples.csv", [Column("time_s", [0.0, 1.0]), Column("cpu_percent", [None, 12.5], "%.1f")])
    assert (tmp_path / "samples.csv").read_text() == "time_s,cpu_percent\n0.000000,\n1.000000,12.5\n"
