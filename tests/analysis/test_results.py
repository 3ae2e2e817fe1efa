"""Results are read from the folder alone: typed, partial, and while the experiment is executed."""

from __future__ import annotations

import json
import pickle
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest
from tests.analysis.experiment_folders import two_tasks
from tests.analysis.made_experiment import make_experiment, write_phases, write_samples

from robot_runner.analysis import analyse, compare, load_results
from robot_runner.core.design.analysis_plan import AnalysisPlan
from robot_runner.core.design.factor import Factor
from robot_runner.core.design.hypothesis import Hypothesis
from robot_runner.core.errors import AnalysisError, StorageError
from robot_runner.core.storage.journal import Journal

HOLDING = """
import sys
from pathlib import Path
from robot_runner.core.storage.lock import ExperimentLock
with ExperimentLock(Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


def test_factors_are_ordered_as_the_config_has_them(tmp_path):
    folder = make_experiment(tmp_path / "e", [Factor("Task", ["Video", "Network", "Idle"])])
    task = load_results(folder.root).runs["Task"]
    assert list(task.cat.categories) == ["Video", "Network", "Idle"]
    assert task.cat.ordered


def test_treatments_keep_their_type(tmp_path):
    factors = [Factor("Speed", [0.2, 0.1]), Factor("Light", [True, False]), Factor("Level", [3, 1])]
    runs = load_results(make_experiment(tmp_path / "e", factors, repetitions=1).root).runs
    assert list(runs["Speed"].cat.categories) == [0.2, 0.1]
    assert list(runs["Light"].cat.categories) == [True, False]
    assert (runs["Level"] == 3).sum() == 4


def test_whole_numbers_beside_fractions_are_the_treatments_that_plan_and_table_name(tmp_path):
    hypothesis = Hypothesis("One is less.", measure="Energy", factors="Speed", contrast={1: 1, 2: -1})
    plan = AnalysisPlan(measures=["Energy"], hypotheses=[hypothesis]).as_mapping()
    made = make_experiment(
        tmp_path / "e",
        [Factor("Speed", [0.5, 1, 2])],
        lambda treatments, repetition: {"Energy": 10.0 * float(treatments["Speed"]) + 0.1 * repetition},
        analysis=plan,
    )
    write_samples(made, "r_2", "time_s,power_W\n10.0,7.5\n")
    results = load_results(made.root)
    assert list(map(str, results.runs["Speed"].cat.categories)) == ["0.5", "1", "2"]
    assert results.runs["Speed"].astype("float64").unique().tolist() == [0.5, 1.0, 2.0]
    assert analyse(results).hypotheses[0].is_supported
    for treatment in (1, 1.0, "1"):
        assert results.lazy_samples(treatments={"Speed": treatment}).frame()["run_id"].tolist() == ["r_2"]


def test_treatments_that_are_one_number_are_told_apart_by_their_texts(tmp_path):
    runs = load_results(make_experiment(tmp_path / "e", [Factor("Gain", [1, 1.0])]).root).runs
    assert list(runs["Gain"].cat.categories) == ["1", "1.0"]


@pytest.mark.parametrize(
    ("treatments", "was", "rewritten"),
    [
        (["0.5", 1e5, None], "0.5", "0.50"),
        ([0.5, 1e5, None], "100000.0", "1.00E+05"),
        ([0.5, 1e5, None], "None", ""),
        (["1.10", "007"], "1.10", "1.1"),
        (["1.10", "007"], "007", "7.0"),
    ],
)
def test_a_treatment_that_a_spreadsheet_wrote_in_another_way_is_no_other_one(tmp_path, treatments, was, rewritten):
    folder = make_experiment(tmp_path / "e", [Factor("Gain", treatments)])
    before = load_results(folder.root).runs["Gain"]
    table = folder.run_table.read_text("utf-8")
    folder.run_table.write_text(table.replace(f",{was},1", f",{rewritten},1", 1), encoding="utf-8")
    assert folder.run_table.read_text("utf-8") != table
    now = load_results(folder.root).runs["Gain"]
    assert list(now.cat.categories) == list(before.cat.categories)
    assert now.tolist() == before.tolist()


def test_an_empty_cell_of_a_factor_with_a_treatment_none_that_is_a_word_is_no_treatment(tmp_path):
    folder = make_experiment(tmp_path / "e", [Factor("Gpu", ["none", "cuda"])])
    table = folder.run_table.read_text("utf-8")
    folder.run_table.write_text(table.replace(",cuda,1", ",,1", 1), encoding="utf-8")
    gpu = load_results(folder.root).runs["Gpu"].tolist()
    assert (gpu.count(""), gpu.count("none"), gpu.count("cuda")) == (1, 3, 2)


def test_a_treatment_that_the_manifest_names_twice_is_one(tmp_path):
    folder = make_experiment(tmp_path / "e", [Factor("Gain", ["1.10", "007"])])
    manifest = json.loads(folder.manifest.read_text("utf-8"))
    manifest["design"]["factors"]["Gain"] = ["1.10", "1.10", "007"]
    folder.manifest.write_text(json.dumps(manifest), encoding="utf-8")
    table = folder.run_table.read_text("utf-8")
    folder.run_table.write_text(table.replace(",007,1", ",7,1", 1), encoding="utf-8")
    gain = load_results(folder.root).runs["Gain"]
    assert list(gain.cat.categories) == ["1.10", "007"]
    assert gain.tolist().count("007") == 3


def test_measures_have_types_and_units(tmp_path):
    measured = {"Energy": 877.5, "Count": 3, "Reached": True, "Note": "a, b"}
    folder = make_experiment(
        tmp_path / "e", values=lambda t, r: measured, measures=list(measured), units={"Energy": "J"}
    )
    results = load_results(folder.root)
    types = {name: str(kind) for name, kind in results.runs[list(measured)].dtypes.items()}
    assert types == {"Energy": "float64", "Count": "Int64", "Reached": "boolean", "Note": "str"}
    assert results.runs.attrs["units"] == {"Energy": "J"}
    assert results.label("Energy") == "Energy (J)"
    assert results.label("Count") == "Count"


def test_a_name_that_has_its_unit_gets_no_second_one(tmp_path):
    names = {"Energy (J)": "J", "Power [W]": "W", "Time": "s"}
    folder = make_experiment(
        tmp_path / "e", values=lambda t, r: dict.fromkeys(names, 1.0), measures=list(names), units=names
    )
    results = load_results(folder.root)
    assert [results.label(name) for name in names] == ["Energy (J)", "Power [W]", "Time (s)"]


def test_a_missing_value_is_missing(tmp_path):
    folder = make_experiment(tmp_path / "e", values=lambda t, r: {"Energy": None if r == 2 else 1.0})
    energy = load_results(folder.root).runs["Energy"]
    assert energy.isna().sum() == 2


def test_time_stamps_are_moments_in_utc(tmp_path):
    runs = load_results(make_experiment(tmp_path / "e").root).runs
    assert runs["start_measurement_at"][1] == pd.Timestamp("2026-01-31T12:00:01Z")
    assert runs["continue_at"].isna().all()


def test_columns_have_the_same_types_whether_anything_is_in_them_or_not(tmp_path):
    results = load_results(make_experiment(tmp_path / "e").root)
    stamps = [name for name in results.runs if name.endswith("_at")]
    assert {str(results.runs[name].dtype) for name in stamps} == {"datetime64[us, UTC]"}
    assert results.excluded.empty
    assert results.odd.empty
    assert results.attempts["failure"].isna().all()
    for frame in (results.runs, results.attempts, results.odd, results.excluded, results.events(), results.phases()):
        assert not [name for name, kind in frame.dtypes.items() if kind.name == "object"]


def test_results_can_be_given_to_another_process(tmp_path):
    results = load_results(make_experiment(tmp_path / "e").root)
    assert pickle.loads(pickle.dumps(results)).runs.equals(results.runs)  # noqa: S301 - our own


def test_what_a_notebook_shows_of_an_analysis_is_a_line(tmp_path):
    folder = make_experiment(tmp_path / "e").root
    assert repr(analyse(load_results(folder))) == "<ExperimentStatistics of Energy>"
    assert repr(compare(folder, folder)).startswith("<Comparison of ")
    assert "Energy identical" in repr(compare(folder, folder))


def test_a_factor_that_counts_repetitions_is_no_factor(tmp_path):
    factors = [Factor("Task", ["Video", "Network"]), Factor("Repetition", range(1, 4))]
    results = load_results(make_experiment(tmp_path / "e", factors, repetitions=1).root)
    assert (results.factors, results.repetition) == (("Task",), "Repetition")


def test_runs_to_do_are_there_and_not_among_the_done(tmp_path):
    folder = make_experiment(tmp_path / "e", values=lambda t, r: {"Energy": 1.0} if r == 1 else None)
    results = load_results(folder.root)
    assert (len(results.runs), len(results.done)) == (6, 2)


def test_what_the_journal_knows_better_counts(tmp_path):
    folder = make_experiment(tmp_path / "e", values=lambda t, r: None)
    ended = {"status": "done", "seconds": 1.0, "stamps": {}, "failure": None}
    energy = {"Energy": {"value": 42.0, "owner": "Meter", "origin": "measured"}}
    with Journal(folder.journal) as journal:
        journal.append("attempt_started", run="r_2", attempt=1)
        journal.append("attempt_finished", run="r_2", attempt=1, measures=energy, **ended)
    done = load_results(folder.root).done
    assert list(done["run_id"]) == ["r_2"]
    assert done["Energy"][0] == 42.0


def test_done_runs_of_which_the_journal_has_no_end_are_told(tmp_path):
    folder = two_tasks(tmp_path / "e", [1.0], [2.0], manifest={"design": {"source": "config"}})
    journal = folder.files.journal
    assert load_results(folder.root).findings == ()
    journal.unlink()
    (finding,) = load_results(folder.root).findings
    assert finding.where == str(journal)
    assert "are done in the run table, and the journal has no end of them" in finding.problem


def test_it_is_told_whether_somebody_executes_it(tmp_path):
    folder = make_experiment(tmp_path / "e")
    assert not load_results(folder.root).is_running
    command = [sys.executable, "-c", HOLDING, str(folder.lock)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as holder:
        assert holder.stdout.readline()
        assert load_results(folder.root).is_running
        holder.communicate(timeout=30)


@pytest.mark.parametrize("name", ["run_table.csv", "run_table.schema.json"])
def test_results_of_which_a_file_is_lost_are_refused_with_how_it_comes_back(tmp_path, name):
    """Without its schema, a report had no measure of the config's, and called none simulated."""
    folder = make_experiment(tmp_path / "e")
    (folder.root / name).unlink()
    with pytest.raises(StorageError, match=f"{name} is missing") as refused:
        _ = load_results(folder.root).done
    assert "Execute the experiment once more" in refused.value.fix


def test_a_table_from_a_spreadsheet_is_read(tmp_path):
    folder = make_experiment(tmp_path / "e", values=lambda t, r: {"Energy": 0.5})
    text = folder.run_table.read_text("utf-8").replace(",", ";").replace("0.5", "0,5")
    folder.run_table.write_text(f"\ufeff\n{text}", "utf-8")
    assert load_results(folder.root).done["Energy"].tolist() == [0.5] * 6


def test_a_users_own_column_is_typed_by_its_looks(tmp_path):
    folder = make_experiment(tmp_path / "e", repetitions=1)
    lines = folder.run_table.read_text("utf-8").splitlines()
    folder.run_table.write_text("\n".join([f"{lines[0]},Room", f"{lines[1]},21.5", f"{lines[2]},22"]) + "\n", "utf-8")
    assert load_results(folder.root).runs["Room"].tolist() == [21.5, 22.0]


def test_events_are_timed_from_the_start_of_measurement(tmp_path):
    events = load_results(make_experiment(tmp_path / "e").root).events(["r_1"])
    since = dict(zip(events["event"], events["since_start_s"], strict=True))
    assert (since["start_measurement"], since["stop_measurement"]) == (0.0, 10.0)
    assert np.isnan(since["before_run"])


def test_only_the_last_attempt_has_events(tmp_path):
    folder = make_experiment(tmp_path / "e", repetitions=1)
    with Journal(folder.journal) as journal:
        journal.append("attempt_started", run="r_1", attempt=2)
        journal.append("event", run="r_1", attempt=2, event="start_measurement", clock=3.0)
    results = load_results(folder.root)
    assert results.events(["r_1"])["clock_s"].tolist() == [3.0]
    assert results.attempts.set_index(["run_id", "attempt"])["status"]["r_1", 2] == "unfinished"


def test_an_attempt_that_was_interrupted_is_unfinished(tmp_path):
    folder = make_experiment(tmp_path / "e", repetitions=1)
    ended = {"status": "interrupted", "seconds": 4.0, "stamps": {}, "failure": None, "measures": {}}
    with Journal(folder.journal) as journal:
        journal.append("attempt_started", run="r_1", attempt=2)
        journal.append("attempt_finished", run="r_1", attempt=2, **ended)
    last = load_results(folder.root).attempts.set_index(["run_id", "attempt"]).loc[("r_1", 2)]
    assert (last["status"], last["seconds"]) == ("unfinished", 4.0)


def test_published_measures_need_no_column(tmp_path):
    folder = make_experiment(tmp_path / "e", repetitions=1)
    more = {"Distance": {"value": 3.4, "owner": "Robot", "origin": "simulated"}}
    with Journal(folder.journal) as journal:
        journal.append("attempt_started", run="r_1", attempt=2)
        ended = {"status": "done", "seconds": 1.0, "stamps": {}, "failure": None}
        journal.append("attempt_finished", run="r_1", attempt=2, measures=more, **ended)
    published = load_results(folder.root).published.set_index(["run_id", "measure"])
    assert published.loc[("r_1", "Distance"), "value"] == 3.4


def test_phases_come_with_treatments_and_from_the_start_of_measurement(tmp_path):
    folder = make_experiment(tmp_path / "e", repetitions=1)
    write_phases(folder, "r_1", "number,phase,start_s,end_s,x_m\n1,sleep,10.5,12.5,0.1\n2,drive,12.5,20,")
    phases = load_results(folder.root).phases()
    assert phases["Task"].tolist() == ["Video", "Video"]
    assert phases["start_s"].tolist() == [0.5, 2.5]
    assert phases["x_m"].isna().tolist() == [False, True]


def test_phases_that_the_journal_alone_has_are_phases_of_the_mission(tmp_path):
    folder = make_experiment(tmp_path / "e", repetitions=1)
    write_phases(folder, "r_1", "number,phase,start_s,end_s\n1,sleep,10.5,12.5\n2,drive,12.5,15")
    with Journal(folder.journal) as journal:
        journal.append("phase", run="r_1", attempt=1, name="drive", start=12.5, end=15.0)
        journal.append("phase", run="r_1", attempt=1, name="dock", start=16.0, end=17.0)
    phases = load_results(folder.root).phases()
    assert phases["phase"].tolist() == ["sleep", "drive", "dock"]
    assert phases["number"].tolist() == [1, 2, 3]
    assert phases["start_s"].tolist() == [0.5, 2.5, 6.0]
    assert phases["plugin"].isna().tolist() == [False, False, True]


def test_phases_of_attempts_that_were_repeated_are_left_out(tmp_path):
    folder = make_experiment(tmp_path / "e", repetitions=1)
    with Journal(folder.journal) as journal:
        journal.append("phase", run="r_1", attempt=1, name="drive", start=12.5, end=15.0)
        journal.append("attempt_started", run="r_1", attempt=2)
        journal.append("phase", run="r_1", attempt=2, name="drive", start=2.5, end=5.0)
    assert load_results(folder.root).phases()["phase"].tolist() == ["drive"]


def test_an_experiment_without_phases_has_an_empty_table_of_them(tmp_path):
    phases = load_results(make_experiment(tmp_path / "e").root).phases()
    assert (len(phases), "phase" in phases) == (0, True)


def test_a_file_of_phases_without_times_is_refused(tmp_path):
    folder = make_experiment(tmp_path / "e")
    write_phases(folder, "r_1", "number,phase\n1,sleep\n")
    with pytest.raises(AnalysisError, match="the file has no column 'start_s'"):
        load_results(folder.root).phases()


def test_a_folder_that_is_no_experiment_is_refused(tmp_path):
    with pytest.raises(StorageError, match="there is no experiment here"):
        load_results(tmp_path)


def test_a_bare_run_table_may_be_adopted(tmp_path):
    (tmp_path / "run_table.csv").write_text("__run_id,__done\nrun_0,DONE\n", "utf-8")
    with pytest.raises(StorageError, match="no manifest") as refused:
        load_results(tmp_path)
    assert "robot-runner import" in refused.value.fix


def test_a_run_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(AnalysisError, match="there is no run 'r_9'"):
        load_results(make_experiment(tmp_path / "e").root).events(["r_9"])


def test_the_plan_is_that_of_the_manifest(tmp_path):
    plain = {"measures": ["Energy"], "alpha": 0.01, "correction": "holm", "hypotheses": []}
    plan = load_results(make_experiment(tmp_path / "e", analysis=plain).root).plan
    assert (plan.measures, plan.alpha) == (("Energy",), 0.01)


@pytest.mark.parametrize("run_count", [1, 3])
def test_samples_of_any_plugin_are_found_by_their_times(tmp_path, run_count):
    folder = make_experiment(tmp_path / "e")
    for number in range(1, run_count + 1):
        write_samples(folder, f"r_{number}", "time_s,power_W\n10.0,7.5\n10.5,8\n")
        write_samples(folder, f"r_{number}", "a,b\n1,2\n", name="notes.csv")
    (file,) = load_results(folder.root).sample_files
    assert (file.label, file.columns, len(file.run_ids)) == ("Meter/samples.csv", ("power_W",), run_count)


@pytest.mark.parametrize("number", [2**63, 10**25])
def test_whole_numbers_beyond_64_bits_are_numbers(tmp_path, number):
    root = two_tasks(tmp_path / "trial", (number, number + 1), (2, 3)).root
    assert load_results(root).runs["Energy"].tolist() == [float(number), float(number + 1), 2.0, 3.0]


def test_what_a_user_does_to_a_frame_is_done_to_no_other(tmp_path):
    results = load_results(make_experiment(tmp_path / "e").root)
    for name, column in (("runs", "Energy"), ("attempts", "seconds"), ("published", "value"), ("odd", "problem")):
        frame = getattr(results, name)
        frame[column] = 7.0
        frame["mine"] = 1
        assert "mine" not in getattr(results, name)
        assert 7.0 not in set(getattr(results, name)[column])
