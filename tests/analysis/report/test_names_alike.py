"""Treatments, measures and sampled files whose names read alike are not taken for each other."""

from __future__ import annotations

import csv
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from tests.analysis.experiment_folders import two_tasks
from tests.analysis.made_experiment import make_experiment

from robot_runner.analysis import analyse, compare, load_results
from robot_runner.analysis.report.blocks import Part
from robot_runner.analysis.report.document import report_document
from robot_runner.analysis.report.material import Material
from robot_runner.analysis.report.rendering import files_of_tables
from robot_runner.core.design.factor import Factor

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from robot_runner.analysis.report.blocks import Document

#: Joined by a stroke, "x" with "y / z" reads as "x / y" with "z" does.
ALIKE = [Factor("A", ["x", "x / y"]), Factor("B", ["y / z", "z"])]
MEANS = {("x", "y / z"): 10.0, ("x", "z"): 110.0, ("x / y", "y / z"): 0.0, ("x / y", "z"): 100.0}


def alike(folder: Path) -> Path:
    noise = np.random.default_rng(5).normal(size=(4, 5))

    def values(treatments: dict[str, Any], repetition: int) -> dict[str, Any]:
        of = (treatments["A"], treatments["B"])
        return {"E": MEANS[of] + float(noise[list(MEANS).index(of), repetition - 1])}

    return make_experiment(folder, ALIKE, values, repetitions=5, measures=("E",)).root


def document(root: Path) -> Document:
    results = load_results(root)
    return report_document(Material(results, analyse(results)), made="")


def test_combinations_that_read_alike_have_their_own_means(tmp_path: Path) -> None:
    made = document(alike(tmp_path / "made"))
    labels = ["x / “y / z”", "x / z", "“x / y” / “y / z”", "“x / y” / z"]
    [means] = [each for each in made.tables if each.name == "means"]
    assert [column.name for column in means.columns][1:] == labels
    [row] = means.rows
    assert [cell.value for cell in row[1:]] == pytest.approx(list(MEANS.values()), abs=2)
    [described] = [each for each in made.tables if each.name == "describe E"]
    assert [(row[0].text, row[1].value) for row in described.rows] == [(label, 5) for label in labels]


def test_an_empty_treatment_is_not_taken_for_all_runs(tmp_path: Path) -> None:
    flags = [Factor("Flags", ["", "--fast"])]
    made = document(
        make_experiment(
            tmp_path / "made", flags, lambda _treatments, repetition: {"E": repetition}, measures=("E",)
        ).root
    )
    tables = {each.name: each for each in made.tables}
    assert [row[0].text for row in tables["describe E by Flags"].rows] == ["“”", "--fast"]
    assert [column.name for column in tables["means"].columns] == ["Measure", "“”", "--fast"]
    assert tables["factors"].rows[0][1].text == "“”, --fast"


def test_combinations_that_read_alike_are_drawn_apart(tmp_path: Path) -> None:
    figures = {each.name: each for each in document(alike(tmp_path / "made")).figures}
    assert figures["distribution E by A / B"].alternative.count("n = 5") == len(MEANS)
    [axes] = figures["interaction E A B"].draw().axes
    ends = [line.get_ydata() for line in axes.get_lines() if line.get_marker() not in {"None", ""}]
    assert sorted(float(value) for each in ends for value in each) == pytest.approx(sorted(MEANS.values()), abs=2)


def test_combinations_that_read_alike_are_compared_each_with_itself(tmp_path: Path) -> None:
    found = compare(alike(tmp_path / "one"), alike(tmp_path / "other")).measure("E")
    assert len({each.label for each in found.differences}) == len(MEANS)
    assert found.agreement is not None
    assert sum(map(len, found.agreement.pairs.values())) == 5 * len(MEANS)


@pytest.mark.long
def test_a_measure_that_is_called_like_the_table_of_another_has_files_of_its_own(tmp_path: Path) -> None:
    names = ("Energy", "Energy by Task", "Energy Task", "Energy by Task / Map")
    made = document(
        make_experiment(
            tmp_path / "made",
            [Factor("Task", ["a", "b"]), Factor("Map", ["c", "d"])],
            lambda treatments, repetition: {
                name: float(place * 100 + repetition**2 + (treatments["Task"] == "a"))
                for place, name in enumerate(names)
            },
            measures=names,
            repetitions=4,
        ).root
    )
    for blocks in (made.tables, made.figures):
        assert len({each.name for each in blocks}) == len(blocks)
    files = files_of_tables(made)
    assert len({each.name for each in files.values()}) == len(made.tables)
    for table in made.tables:
        rows = list(csv.reader(files[table.name].csv.splitlines()))
        assert rows[0] == [column.name for column in table.for_programs.columns]


def sampled(root: Path, write: Callable[[Any], None]) -> Document:
    folder = two_tasks(root, (1.0, 2.0, 3.0), (4.0, 5.0, 6.0))
    write(folder)
    return document(folder.root)


@pytest.mark.long
def test_files_of_one_plugin_with_columns_of_one_name_are_drawn_and_named_apart(tmp_path: Path) -> None:
    def write(folder: Any) -> None:
        for name, level in (("left.csv", 3), ("right.csv", 9)):
            rows = [f"{t / 10},{level}" for t in range(100)]
            folder.write_samples("Motors", name, "time_s,power_W", lambda _, rows=rows: rows)
            way = [f"{t / 10},{t},{level}" for t in range(10)]
            folder.write_samples("Robot", f"way_{name}", "time_s,x_m,y_m", lambda _, way=way: way)

    made = sampled(tmp_path / "trial", write)
    names = [each.name for each in made.figures]
    assert len(set(names)) == len(names)
    charts = {each.caption.partition(":")[0]: each for each in made.charts}
    assert {"Power of Motors/left.csv (W)", "Power of Motors/right.csv (W)"} <= charts.keys()
    assert len({each.name for each in made.charts}) == len(made.charts)
    titles = [each.title for each in made.blocks() if isinstance(each, Part)]
    assert "Power of Motors/left.csv over the mission" in titles
    drawn = {
        each.name: each.draw().axes[0].get_lines()[0].get_ydata()[0] for each in made.figures if "means" in each.name
    }
    assert sorted(drawn.values()) == [3, 9]
    assert "Robot/way_left.csv" in next(each.caption for each in made.figures if each.name.startswith("trajectory"))


def test_power_of_two_plugins_is_told_apart(tmp_path: Path) -> None:
    def write(folder: Any) -> None:
        for plugin in ("Ina219", "Plug"):
            folder.write_samples(plugin, "samples.csv", "time_s,power_W", lambda _: ["0,1", "1,2"])

    titles = [each.title for each in sampled(tmp_path / "trial", write).blocks() if isinstance(each, Part)]
    assert {"Power of Ina219 over the mission", "Power of Plug over the mission"} <= {*titles}
