"""A description is read with its slips named."""

from __future__ import annotations

import pytest

from robot_runner.analysis.importing.description import (
    Aggregation,
    ImportDescription,
    SamplesDescription,
    description_text,
    parse_recipe,
    read_description,
)
from robot_runner.core.errors import AnalysisError, StorageError

WHOLE = """
name = "Rover"
table = "runs.csv"
run_folder = "raw/{run_id}"
origin = "measured"
guess = false
decimal = ","
[columns]
run_id = "id"
block = "robot"
factors = ["task"]
measures = "energy"
ignore = ["note"]
[units]
energy = "mWh"
[[samples]]
file = "power.csv"
time = "t"
time_unit = "ms"
[samples.units]
p = "mW"
[recompute]
energy = "integral(power.csv:p)"
"""


def read(tmp_path, text):
    path = tmp_path / "description.toml"
    path.write_text(text, "utf-8")
    return read_description(path)


def test_everything_that_can_be_said(tmp_path):
    assert read(tmp_path, WHOLE) == ImportDescription(
        name="Rover",
        table="runs.csv",
        run_folder="raw/{run_id}",
        origin="measured",
        guess=False,
        decimal=",",
        run_id="id",
        block="robot",
        factors=("task",),
        measures=("energy",),
        ignore=("note",),
        units={"energy": "mWh"},
        samples=(SamplesDescription("power.csv", time="t", time_unit="ms", units={"p": "mW"}),),
        recipes=(parse_recipe("energy=integral(power.csv:p)"),),
    )


def test_a_description_that_was_written_says_the_same(tmp_path):
    whole = read(tmp_path, WHOLE)
    assert read(tmp_path, description_text(whole)) == whole


def test_the_command_line_counts_more(tmp_path):
    said = ImportDescription(
        name="Other",
        units={"cpu": "%"},
        samples=(SamplesDescription("power.csv", time="T"), SamplesDescription("cpu.csv")),
        recipes=(parse_recipe("energy=mean_times_duration(power.csv:p)"),),
    )
    both = read(tmp_path, WHOLE).with_options(said)
    assert (both.name, both.table, both.guess) == ("Other", "runs.csv", False)
    assert both.units == {"energy": "mWh", "cpu": "%"}
    assert both.samples[0] == SamplesDescription("power.csv", time="T", time_unit="ms", units={"p": "mW"})
    assert [recipe.how for recipe in both.recipes] == [Aggregation.ENERGY_PT]


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("name = ", "the file is not TOML"),
        pytest.param(f"name = {'9' * 5000}", "the file is not TOML", id="5000 digits"),
        pytest.param(f"name = {'[' * 3000}", "the file is not TOML", id="deep brackets"),
        ("nmae = 'x'", "there is no entry nmae"),
        ("name = 3", "name is 3"),
        ("columns = 3", "columns is 3"),
        ("[columns]\nfactor = ['a']", "there is no entry columns.factor"),
        ("[columns]\nfactors = [1]", r"factors is \[1\]"),
        ("[units]\na = 'mWatt'", "'mWatt' is not a unit that is known"),
        ("[[samples]]\ntime = 't'", "samples names no file"),
        ("[[samples]]\nfile = 'a'\ntime_unit = 'weeks'", "times cannot be in 'weeks'"),
        ("[recompute]\na = 'integrl(b:c)'", "there is no way 'integrl'"),
        ("[recompute]\na = 'integral(b)'", "names no column"),
        ("[recompute]\na = 'b'", "is not a recipe"),
        ("origin = 'guessed'", "origin is 'guessed'"),
        ("decimal = ';'", "decimal is ';'"),
    ],
)
def test_slips_are_named(tmp_path, text, problem):
    with pytest.raises(AnalysisError, match=problem) as refused:
        read(tmp_path, text)
    assert refused.value.where


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(StorageError):
        read_description(tmp_path / "none.toml")
