"""What the analysis makes of an experiment that was extended, and of runs that only warm up."""

from __future__ import annotations

import json
import time
from datetime import datetime

import pytest
from tests.analysis.report.agreement import disagreements
from tests.conftest import TABLE, written_config

from robot_runner import AnalysisPlan, Hypothesis
from robot_runner.analysis import analyse, load_results
from robot_runner.analysis.figures.style import FigureFormat
from robot_runner.analysis.journal_frames import read_history
from robot_runner.analysis.report.material import Material
from robot_runner.analysis.report.outcome_section import attempt_spans
from robot_runner.analysis.report.writing import ReportFormat, write_report
from robot_runner.cli.extension import ExtensionRequest, extend_experiment
from robot_runner.core.config.preparation import prepare, prepare_or_refuse
from robot_runner.core.design.extended_design import Additions, NewFactor
from robot_runner.core.execution.notices import SilentObserver
from robot_runner.core.execution.orchestrator import execute_experiment
from robot_runner.core.storage.journal import Journal

MEASURING = """
def launch_mission(self, context):
    context.combination["Task"]
    (context.raw_data_folder / "samples.csv").write_text("time_s,power_W\\n0.0,1.0\\n1.0,2.0\\n")

def populate_run_data(self, context):
    return {"Energy": 1000.0 if context.is_warm_up else 10.0 + context.run_number}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    table = TABLE.replace("repetitions=2", 'repetitions=3, warm_up=WarmUp(1, per="Task")')
    config = written_config(tmp_path_factory.mktemp("study"), MEASURING, table=table)
    execute_experiment(prepare_or_refuse(config), SilentObserver())
    added = Additions(4, factors={"Floor": NewFactor("carpet", ("wood",))})
    extend_experiment(prepare(config, is_for_here=False).experiment, ExtensionRequest(added=added, seed=2))
    return execute_experiment(prepare_or_refuse(config), SilentObserver()).folder


@pytest.mark.long
def test_warm_up_runs_are_left_out_everywhere_unless_they_are_asked_for(folder):
    results = load_results(folder)
    assert results.warm_ups == ("w_1", "w_2", "w_3", "w_4")
    assert len(results.runs) == len(results.done) == 16
    assert results.runs["Energy"].max() < 100
    assert not results.runs["warm_up"].any()
    for frame in (results.attempts, results.published, results.events(), results.quality, results.samples("config")):
        assert not frame["run_id"].astype("str").str.startswith("w_").any()
    everything = load_results(folder, with_warm_ups=True)
    assert everything.warm_ups == results.warm_ups
    assert len(everything.runs) == 20
    assert list(everything.runs.loc[everything.runs["warm_up"], "Energy"]) == [1000.0] * 4
    assert len(everything.samples("config", runs=["w_1"])) == 2


def test_workers_of_runs_that_only_warm_up_are_left_out_with_these(tmp_path):
    with Journal(tmp_path / "journal.jsonl") as journal:
        for run in ("w_1", "r_1"):
            journal.append("attempt_started", run=run, attempt=1, place="node1", slot=0)
    history = read_history(tmp_path / "journal.jsonl")
    assert history.without({"w_1"}).attempts.attrs["workers"] == {"r_1": "node1"}
    assert history.attempts.attrs["workers"] == {"w_1": "node1", "r_1": "node1"}


SET_BEFORE_THE_THIRD_RUN = """
def before_run(self, context):
    import time
    if context.run_id == "r_3":
        real = time.clock_gettime
        time.clock_gettime = lambda clock: real(clock) + 3600.0 * (clock == time.CLOCK_REALTIME)
        from robot_runner.core.storage import journal
        from datetime import datetime, timedelta
        class Later(datetime):
            @classmethod
            def now(cls, zone=None):
                return datetime.now(zone) + timedelta(hours=1)
        journal.datetime = Later
"""


@pytest.mark.long
def test_a_clock_that_was_set_between_runs_leaves_no_gap_where_others_have_warmed_up(tmp_path, monkeypatch):
    monkeypatch.setattr("time.clock_gettime", time.clock_gettime)  # what the experiment changes is put back
    monkeypatch.setattr("robot_runner.core.storage.journal.datetime", datetime)
    table = TABLE.replace("repetitions=2", 'repetitions=2, warm_up=WarmUp(1, per="Task")')
    config = written_config(tmp_path, MEASURING + SET_BEFORE_THE_THIRD_RUN, table=table)
    results = load_results(execute_experiment(prepare_or_refuse(config), SilentObserver()).folder)
    began = results.attempts["started_at"]
    assert (began.iloc[-1] - began.iloc[0]).total_seconds() > 3600.0
    spans = attempt_spans(Material(results, analyse(results)))
    assert [span.run_id for span in spans] == ["r_1", "r_2", "r_3", "r_4"]
    assert spans[-1].end < 1800.0


def test_the_batch_is_a_column_with_a_role_and_no_factor(folder):
    results = load_results(folder)
    assert results.batch == "batch"
    assert results.columns["batch"].role.value == "batch"
    assert str(results.runs["batch"].dtype) == "Int64"
    assert results.runs["batch"].value_counts().to_dict() == {1: 6, 2: 10}
    assert results.factors == ("Task", "Floor")
    assert results.measures == ("Energy",)
    assert list(results.runs["Floor"].cat.categories) == ["carpet", "wood"]
    assert results.runs.loc[results.runs["batch"] == 1, "Floor"].unique().tolist() == ["carpet"]


@pytest.mark.long
def test_the_report_accounts_for_batches_and_warm_up_runs(folder, tmp_path):
    write_report(folder, ReportFormat.MARKDOWN, output=tmp_path, figures=[FigureFormat.SVG])
    write_report(folder, ReportFormat.JSON, output=tmp_path)
    text = (tmp_path / "report.md").read_text(encoding="utf-8").replace("\\_", "_")
    assert "w_1, w_2, w_3, w_4: executed and kept, not analysed" in text
    assert "10 runs (r_7 to r_16), added on 20" in text
    assert "; randomised from seed 2" in text
    assert "The experiment was extended" in text
    assert "Where runs were added as the first had shown nothing, chance shows something in 8 %" in text
    assert "Its 2 batches, of 6 and 10 runs, were executed at other times" in text
    assert "Floor is confounded with time" in text
    assert "runs before count as carpet, which nobody set" in text
    told = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))
    assert told["design"]["warm_ups"] == ["w_1", "w_2", "w_3", "w_4"]
    assert [batch["batch"] for batch in told["design"]["batches"]] == [1, 2]
    assert "treatments are compared within batches 1 and 2, which may differ as a whole" in text
    assert disagreements(told) == []
    assert len(told["runs"]) == 16


#: The later session is colder by far more than the tasks differ.
SHIFTED = """
def populate_run_data(self, context):
    is_later = context.run_number > 10
    task = {"Video": 3.0, "Network": 0.0, "Idle": 0.0}[context.combination["Task"]]
    return {"Energy": 20.0 + task - 12.0 * is_later + 0.1 * (context.run_number * 7 % 5)}
"""


def extended(folder, added):
    config = written_config(folder, SHIFTED, table=TABLE.replace("repetitions=2", "repetitions=5"))
    execute_experiment(prepare_or_refuse(config), SilentObserver())
    extend_experiment(prepare(config, is_for_here=False).experiment, ExtensionRequest(added=added, seed=2))
    root = execute_experiment(prepare_or_refuse(config), SilentObserver()).folder
    written = write_report(root, ReportFormat.JSON, output=folder / "out")
    found = json.loads(written.document.read_text(encoding="utf-8"))
    assert disagreements(found) == []
    (measure,) = found["statistics"]["measures"]
    return measure


@pytest.mark.long
def test_an_effect_is_found_although_the_later_batch_is_shifted_by_more(tmp_path):
    measure = extended(tmp_path, Additions(10))
    (effect,) = measure["test"]["effects"]
    assert effect["is_significant"]
    assert measure["test"]["spread"] < 1
    (pair,) = measure["post_hoc"][0]["comparisons"]
    assert pair["difference"] == pytest.approx(3.0, abs=0.2)


@pytest.mark.long
def test_a_treatment_that_only_the_later_batch_has_is_not_compared_in_silence(tmp_path):
    measure = extended(tmp_path, Additions(treatments={"Task": ("Idle",)}))
    (effect,) = measure["test"]["effects"]
    assert effect["is_significant"]
    assert [pair["second"] for pair in measure["post_hoc"][0]["comparisons"]] == ["Network"]
    missing = [each["why"] for each in measure["not_computed"] if each["what"] == "comparisons with Idle"]
    assert len(missing) == 1
    assert "cannot be told apart from what changed between batches" in missing[0]


@pytest.mark.long
def test_a_planned_factor_that_differs_only_between_batches_has_no_verdict(tmp_path):
    hypotheses = [
        Hypothesis("The floor matters.", measure="Energy", factors="Floor"),
        Hypothesis("Wood costs more.", measure="Energy", factors="Floor", contrast={"wood": 1, "carpet": -1}),
        Hypothesis("The task matters.", measure="Energy", factors="Task"),
    ]
    plan = AnalysisPlan(measures=["Energy"], hypotheses=hypotheses)
    table = TABLE.replace("repetitions=2", "repetitions=5")
    config = written_config(tmp_path, SHIFTED, table=table)
    execute_experiment(prepare_or_refuse(config), SilentObserver())
    added = Additions(factors={"Floor": NewFactor("carpet", ("wood",))})
    extend_experiment(prepare(config, is_for_here=False).experiment, ExtensionRequest(added=added, seed=2))
    root = execute_experiment(prepare_or_refuse(config), SilentObserver()).folder
    manifest = json.loads((root / "manifest.json").read_text(encoding="utf-8"))
    manifest["analysis"] = plan.as_mapping()
    (root / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")
    statistics = analyse(load_results(root))
    measure = statistics.measure("Energy")
    assert [(each.factors, each.is_significant) for each in measure.test.effects] == [(("Task",), True)]
    assert [each.is_supported for each in statistics.hypotheses] == [None, None, True]
    assert any("Floor differs only between batches" in each.why for each in measure.not_computed)
