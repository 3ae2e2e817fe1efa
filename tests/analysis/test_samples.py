"""Raw samples of any or all runs become one tidy table."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.analysis.made_experiment import make_experiment, write_phases, write_samples

from robot_runner.analysis import load_results
from robot_runner.analysis.samples import GrowingColumn
from robot_runner.core.design.factor import Factor
from robot_runner.core.errors import AnalysisError
from robot_runner.core.storage.journal import Journal


@pytest.fixture
def folder(tmp_path):
    made = make_experiment(tmp_path / "e", repetitions=1)
    write_samples(made, "r_1", "time_s,power_W,count\n9.5,7.0,1\n10.0,8.0,2\n12.0,9.5,3\n")
    write_samples(made, "r_2", "time_s,power_W,count\n10.0,6.0,4\n")
    return made


def test_each_sample_knows_its_run_and_its_treatments(folder):
    samples = load_results(folder.root).samples()
    assert samples["run_id"].tolist() == ["r_1", "r_1", "r_1", "r_2"]
    assert samples["Task"].tolist() == ["Video", "Video", "Video", "Network"]
    assert samples["Task"].cat.ordered
    assert samples["power_W"].tolist() == [7.0, 8.0, 9.5, 6.0]


@pytest.mark.parametrize("name", ["phase", "power_W", "time_s"])
def test_a_factor_that_is_called_as_a_column_of_samples_or_phases_is_kept_beside_it(tmp_path, name):
    made = make_experiment(tmp_path / "e", [Factor(name, ["low", "high"])], repetitions=1)
    for run_id in ("r_1", "r_2"):
        write_samples(made, run_id, "time_s,power_W\n10.0,8.0\n12.0,9.5\n")
        write_phases(made, run_id, "number,phase,start_s,end_s\n1,drive,10.0,12.5")
    results = load_results(made.root)
    samples, aligned = results.samples(), results.aligned_samples({"Meter": "power_W"}, period=1.0).frame
    assert samples[f"{name} (factor)"].tolist() == ["low", "low", "high", "high"]
    assert (samples["phase"].tolist(), samples["power_W"].tolist()) == (["drive"] * 4, [8.0, 9.5] * 2)
    assert results.lazy_samples().reader().schema.names == list(samples.columns)
    assert aligned.columns.is_unique
    phases = results.phases()
    assert phases[f"{name} (factor)" if name == "phase" else name].tolist() == ["low", "high"]


@pytest.mark.parametrize(("name", "left_out"), [("phase", "with_phases"), ("in_window", "with_window")])
def test_a_factor_keeps_its_name_where_the_column_of_that_name_is_left_out(tmp_path, name, left_out):
    made = make_experiment(tmp_path / "e", [Factor(name, ["low", "high"])], repetitions=1)
    for run_id in ("r_1", "r_2"):
        write_samples(made, run_id, "time_s,power_W\n10.0,8.0\n")
    results = load_results(made.root)
    assert results.samples(**{left_out: False})[name].tolist() == ["low", "high"]
    assert results.samples()[f"{name} (factor)"].tolist() == ["low", "high"]
    assert {path.name for path in results.export(tmp_path / "export")} >= {"phases.parquet", "run_table.parquet"}


def test_times_count_from_the_start_of_measurement(folder):
    assert load_results(folder.root).samples()["time_s"].tolist() == [-0.5, 0.0, 2.0, 0.0]


def note_window(folder, run_id, start, end):
    noted = json.dumps({"window": {"start": start, "end": end}, "samples": None})
    (folder.run(run_id) / "Meter" / "quality.json").write_text(noted)


def test_samples_say_whether_they_lie_in_the_measured_window(folder):
    note_window(folder, "r_1", 9.8, 11.0)
    samples = load_results(folder.root).samples()
    assert samples["in_window"].tolist() == [False, True, False, True]  # that of r_2 is not known
    assert samples["time_s"].tolist() == pytest.approx([-0.3, 0.2, 2.2, 0.0])
    assert "in_window" not in load_results(folder.root).samples(with_window=False)


@pytest.mark.parametrize("noted", ["", "[]", "{}", '{"window": null}', '{"window": {"start": "x"}}'])
def test_a_note_that_tells_of_no_window_is_passed_over(folder, noted):
    (folder.run("r_1") / "Meter" / "quality.json").write_text(noted)
    assert load_results(folder.root).samples()["in_window"].all()


def test_the_window_of_the_journal_counts_where_the_plugin_notes_none(folder):
    with Journal(folder.journal) as journal:
        journal.append("window", run="r_1", attempt=1, start=9.9, end=11.9)
    samples = load_results(folder.root).samples()
    assert samples["in_window"].tolist() == [False, True, False, True]
    assert samples["time_s"].tolist() == pytest.approx([-0.4, 0.1, 2.1, 0.0])


def test_without_a_start_of_measurement_times_count_from_the_first_sample(folder):
    folder.journal.unlink()
    assert load_results(folder.root).samples()["time_s"].tolist() == [0.0, 0.5, 2.5, 0.0]


def test_runs_and_columns_can_be_chosen(folder):
    samples = load_results(folder.root).samples("Meter", runs=["r_2"], columns=["count"], with_factors=False)
    assert list(samples.columns) == ["run_id", "time_s", "in_window", "phase", "phase_number", "count"]
    assert samples["count"].tolist() == [4]


def test_runs_come_in_the_order_that_was_asked_for(folder):
    samples = load_results(folder.root).samples(runs=["r_2", "r_1"])
    assert samples["run_id"].tolist() == ["r_2", "r_1", "r_1", "r_1"]


def test_a_sample_falls_into_the_phase_that_begins_with_it(folder):
    write_phases(folder, "r_1", "number,phase,start_s,end_s\n1,sleep,10,12\n2,drive,12,20\n")
    samples = load_results(folder.root).samples(runs=["r_1"])
    assert samples["phase"].astype(object).where(samples["phase"].notna(), None).tolist() == [None, "sleep", "drive"]
    assert samples["phase_number"].tolist() == [0, 1, 2]


def test_a_sample_in_several_phases_at_once_is_of_the_one_that_began_last(folder):
    with Journal(folder.journal) as journal:
        for name, start, end in (("alice", 9.0, 20.0), ("bob", 9.8, 10.5)):
            journal.append("phase", run="r_1", attempt=1, name=name, start=start, end=end)
    results = load_results(folder.root)
    assert results.samples(runs=["r_1"])["phase"].tolist() == ["alice", "bob", "alice"]
    assert len(results.lazy_samples(runs=["r_1"], phases=["alice"]).frame()) == 3


def test_whole_numbers_stay_whole(folder):
    assert load_results(folder.root).samples()["count"].dtype == np.int64


def test_a_column_that_is_fractional_in_one_run_is_fractional_in_all(folder):
    write_samples(folder, "r_2", "time_s,power_W,count\n10.0,6.0,4.5\n")
    assert load_results(folder.root).samples()["count"].tolist() == [1.0, 2.0, 3.0, 4.5]


def test_a_missing_value_is_missing(folder):
    write_samples(folder, "r_2", "time_s,power_W,count\n10.0,,4\n")
    assert load_results(folder.root).samples()["power_W"].isna().tolist() == [False, False, False, True]


def test_a_column_that_a_run_lacks_is_missing_there(folder):
    write_samples(folder, "r_2", "time_s,power_W\n10.0,6.0\n")
    assert load_results(folder.root).samples()["count"].isna().tolist() == [False, False, False, True]


def test_text_becomes_categories(folder):
    write_samples(folder, "r_1", "time_s,protocol\n10.0,TCP\n10.1,UDP\n", name="packets.csv")
    write_samples(folder, "r_2", "time_s,protocol\n10.0,UDP\n10.1,\n", name="packets.csv")
    protocol = load_results(folder.root).samples("Meter", file="packets.csv")["protocol"]
    assert sorted(protocol.cat.categories) == ["TCP", "UDP"]
    assert protocol.isna().sum() == 1


def test_a_missing_number_is_missing_among_the_texts_of_other_runs(folder):
    write_samples(folder, "r_1", "time_s,state\n10.0,1\n12.0,\n")
    write_samples(folder, "r_2", "time_s,state\n10.0,on\n")
    state = load_results(folder.root).samples()["state"]
    assert list(state.cat.categories) == ["1", "on"]
    assert state.isna().tolist() == [False, True, False]


def test_a_row_that_is_cut_off_is_left_out_and_counted(folder):
    write_samples(folder, "r_2", "time_s,power_W,count\n10.0,6.0,4\n10.1,6\n10.2,6.5,5\n")
    samples = load_results(folder.root).samples(runs=["r_2"])
    assert len(samples) == 2
    assert samples.attrs["skipped_rows"] == {"r_2": 1}


def test_the_torn_last_line_of_a_run_that_is_executed_is_left_out(tmp_path):
    made = make_experiment(tmp_path / "e", values=lambda t, r: None, repetitions=1)
    write_samples(made, "r_1", "time_s,power_W\n10.0,6.0\n10.1,6.")
    assert load_results(made.root).samples()["power_W"].tolist() == [6.0]


def test_a_file_without_samples_yields_none(folder):
    write_samples(folder, "r_2", "time_s,power_W,count\n")
    assert load_results(folder.root).samples()["run_id"].tolist() == ["r_1"] * 3


def test_a_plugin_that_has_none_is_named(folder):
    with pytest.raises(AnalysisError, match="plugin 'Metre' has no raw samples") as refused:
        load_results(folder.root).samples("Metre")
    assert refused.value.fix == "Did you mean 'Meter'?"


def test_a_column_that_is_not_there_is_named(folder):
    with pytest.raises(AnalysisError, match="there is no column 'power'"):
        load_results(folder.root).samples(columns=["power"])


def test_which_file_is_meant_is_to_be_said(folder):
    write_samples(folder, "r_1", "time_s,cpu\n10,5\n", plugin="Host")
    with pytest.raises(AnalysisError, match=r"several files fit: Host/samples\.csv, Meter/samples\.csv"):
        load_results(folder.root).samples()


def test_an_experiment_without_samples_says_so(tmp_path):
    with pytest.raises(AnalysisError, match="there are no raw samples"):
        load_results(make_experiment(tmp_path / "e").root).samples()


def test_who_wrote_files_without_times_is_told_what_makes_them_samples(tmp_path):
    folder = make_experiment(tmp_path / "e")
    write_samples(folder, "r_1", "step,reward\n0,5\n", plugin="Learner")
    with pytest.raises(AnalysisError, match="there are no raw samples") as refused:
        load_results(folder.root).samples()
    assert "a column of times, time_s" in str(refused.value)


def grown(pieces, kind=None):
    column = GrowingColumn(expected=3)
    for piece in pieces:
        column.append(pa.chunked_array([pa.array(piece, kind)]))
    return column.values()


@pytest.mark.long
@given(st.lists(st.lists(st.floats(allow_nan=False, width=64) | st.none(), max_size=5), min_size=1, max_size=6))
def test_a_growing_column_holds_what_was_added(pieces):
    expected = [np.nan if value is None else value for piece in pieces for value in piece]
    np.testing.assert_array_equal(grown(pieces), np.array(expected, dtype=float))


@given(st.lists(st.lists(st.integers(-(2**60), 2**60), max_size=4), min_size=1, max_size=6))
def test_a_growing_column_of_whole_numbers_loses_none(pieces):
    assert grown(pieces, pa.int64()).tolist() == [value for piece in pieces for value in piece]


@pytest.mark.parametrize(
    ("pieces", "expected"),
    [
        ([[1, None], [2]], [1.0, None, 2.0]),
        ([[True], [2]], [1.0, 2.0]),
        ([[None], ["a", "b"], ["b"]], [None, "a", "b", "b"]),
        ([[1], ["a"]], ["1", "a"]),
        ([[None], [1], ["a"]], [None, "1", "a"]),
        ([[], [1]], [1]),
        ([[None, None], [None]], [None] * 3),
    ],
)
def test_a_growing_column_has_one_type(pieces, expected):
    column = pd.Series(grown(pieces))
    assert column.astype(object).where(column.notna(), None).tolist() == expected
