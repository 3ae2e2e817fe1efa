"""The checklist of ACM's badges says of each line what is so."""

from __future__ import annotations

import shutil
from dataclasses import replace

from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.run_table_reading import read_run_table
from robot_runner.core.storage.run_table_rows import write_run_table
from robot_runner.core.storage.table_columns import ColumnDescription, ColumnRole, TableLayout
from robot_runner.core.storage.table_schema import EXCLUSION, read_schema, write_schema
from robot_runner.replication.badges import State, badges_of


def test_an_excluded_run_that_was_not_done_is_not_told_as_done(experiment, tmp_path):
    files = ExperimentFolder.found_at(shutil.copytree(experiment, tmp_path / "small"))
    columns = read_schema(files.schema)
    layout = replace(TableLayout.of_schema(columns), has_exclusions=True)
    rows = read_run_table(files.run_table, layout)
    rows.clear("r_2")
    rows.exclude("r_2", "the door was open")
    write_schema(files.schema, [*columns[:2], EXCLUSION, *columns[2:]])
    write_run_table(files.run_table, rows)
    name, lines = badges_of(files.root)
    (line,) = [each for each in lines if each.what == "Complete: all runs"]
    assert (name, line.fact) == ("small", "3 of 3 runs are done. Excluded: 1 run.")


def test_texts_and_answers_of_yes_and_no_are_described_without_a_unit(experiment, tmp_path):
    files = ExperimentFolder.found_at(shutil.copytree(experiment, tmp_path / "small"))
    columns = [
        replace(each, unit=each.unit or "J", description="It.") if each.role is ColumnRole.MEASURE else each
        for each in read_schema(files.schema)
    ]

    def described(name, **facts):
        write_schema(files.schema, [*columns, ColumnDescription(name=name, role=ColumnRole.MEASURE, **facts)])
        (line,) = [each for each in badges_of(files.root)[1] if each.what == "Each measure is described"]
        return line

    for kind in ("string", "boolean"):
        assert described("Outcome", type=kind, description="What became of it.").state is State.MET
    assert described("Outcome", type="string").fact == "Without a meaning, or a unit: Outcome."
    assert described("Nodes", type="integer", description="How many.").state is State.NOT_MET
    assert described("Nodes", type="integer", description="How many.", unit="1").state is State.MET
