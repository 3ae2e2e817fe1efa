"""Each value of a run is traced to where it comes from, from the folder alone."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from tests.analysis.experiment_folders import two_tasks
from tests.analysis.importing.foreign_folder import make_earlier_folder
from tests.replication.small_experiment import CHANGING, CONFIG, changed_between_its_runs, own_modules

from robot_runner.analysis.importing.adoption import adopt
from robot_runner.analysis.importing.description import ImportDescription
from robot_runner.analysis.importing.understanding import understand
from robot_runner.core.config.preparation import prepare
from robot_runner.core.errors import StorageError
from robot_runner.core.execution.notices import SilentObserver
from robot_runner.core.execution.orchestrator import execute_experiment
from robot_runner.core.execution.resumption import Resumption
from robot_runner.core.storage.journal import Journal
from robot_runner.core.storage.manifest import read_manifest, write_manifest
from robot_runner.replication.config_lines import ConfigLines
from robot_runner.replication.explanation import explain_run


def _facts(folder, run, name):
    value = explain_run(folder, run, [name]).values[0]
    return value, dict(value.facts)


def _line(text):
    return next(place for place, line in enumerate(CONFIG.splitlines(), start=1) if text in line)


def test_a_value_of_a_plugin(experiment):
    value, facts = _facts(experiment, "r_2", "Energy")
    assert (value.role, value.unit) == ("measure", "J")
    assert facts["Origin"] == "simulated, not measured"
    assert facts["Plugin"].startswith("Ina219 (robot-runner ")
    assert facts["Raw data"].startswith("runs/r_2/Ina219/quality.json (")
    assert "integral of power" in facts["Aggregation"]
    assert facts["Config"].startswith(f"config/small.py:{_line('Ina219()')}  ")
    assert facts["Published"] == "in attempt 1 (journal.jsonl)"


@pytest.mark.parametrize("status", ["failed", "interrupted"])
def test_how_an_earlier_attempt_ended_is_told(tmp_path, status):
    folder = two_tasks(tmp_path / "e", [1.0], [2.0]).root
    reason = "start_run of Meter: the cable is out"
    journal, records = folder / "journal.jsonl", (folder / "journal.jsonl").read_text("utf-8")
    journal.unlink()
    ended = {"seconds": 0.1, "is_last": True, "stamps": {}, "measures": {}, "failure": reason, "status": status}
    with Journal(journal) as begun:
        begun.append("attempt_started", run="r_1", attempt=1)
        begun.append("attempt_finished", run="r_1", attempt=1, **ended)
    with journal.open("a", encoding="utf-8") as file:
        file.write(records)
    assert ("Attempt 1", f"{status}: {reason}") in explain_run(folder, "r_1", []).facts


def test_a_value_of_a_callback(experiment):
    _, facts = _facts(experiment, "r_2", "Phases")
    assert facts["From"] == "the config"
    assert facts["Config"].startswith(f"config/small.py:{_line('def populate_run_data')}  ")


def test_a_value_that_has_no_column(experiment):
    value, facts = _facts(experiment, "r_1", "MeanPower")
    assert value.value > 0
    assert facts["Plugin"].startswith("Ina219 (")


def test_a_factor_and_a_repetition(experiment):
    _, facts = _facts(experiment, "r_1", "Task")
    assert facts["Treatments"] == "Video, Network"
    assert facts["Config"].startswith(f"config/small.py:{_line('Factor(')}  ")
    assert _facts(experiment, "r_1", "Repetition")[1]["Treatments"] == "1 to 2"


def test_a_time_stamp(experiment):
    _, facts = _facts(experiment, "r_1", "launch_mission_at")
    assert facts["Event"].startswith("launch_mission, emitted in the run's own process")
    assert facts["Run's clock"].endswith("s (simulated time)")
    assert facts["Config"].startswith(f"config/small.py:{_line('def launch_mission')}  ")
    assert "orchestrator" in _facts(experiment, "r_1", "before_run_at")[1]["Event"]


def test_what_holds_for_the_whole_run(experiment):
    explanation = explain_run(experiment, "r_1")
    facts = dict(explanation.facts)
    assert facts["Place"].startswith("run 1 of 4, randomised from seed ")
    assert facts["Attempt"].startswith("1, 20")
    assert facts["Robot"] == "simulated"
    assert "Python 3." in facts["Host"]
    assert "Energy" in {each.name for each in explanation.values}


def test_a_value_that_was_edited_by_hand_is_told_from_what_was_published(experiment, tmp_path):
    folder = Path(shutil.copytree(experiment, tmp_path / "edited"))
    value, _ = _facts(folder, "r_1", "Energy")
    table = folder / "run_table.csv"
    table.write_text(table.read_text("utf-8").replace(repr(value.value), "1.0", 1), encoding="utf-8")
    edited, facts = _facts(folder, "r_1", "Energy")
    assert edited.value == 1.0
    assert f"the journal has {value.value!r}" in facts["Edited"]


def test_where_the_journal_has_no_end_of_a_run_the_quality_of_its_values_is_not_known(experiment, tmp_path):
    copy = tmp_path / "copy"
    shutil.copytree(experiment, copy)
    (copy / "journal.jsonl").unlink()
    assert _facts(copy, "r_2", "Energy")[1]["Quality"].startswith("not known: the journal has no end of this run")


def test_of_a_run_that_the_table_had_as_done_nothing_is_said_of_who_executed_it_where_and_when(tmp_path):
    config, folder = tmp_path / "changing.py", tmp_path / "results" / "changing"
    config.write_text(CHANGING, encoding="utf-8")
    folder.mkdir(parents=True)
    (folder / "run_table.csv").write_text("run_id,status,Task,Score\nold,Done,Video,7.5\nnew,-,Network,\n", "utf-8")
    with own_modules():
        execute_experiment(prepare(config).experiment, SilentObserver())
    shared = dict(explain_run(folder, "old").facts)
    assert set(shared) == {"Status", "Place", "Executed"}
    assert shared["Executed"] == "not here: the run table had it as done, and where and by what is not known"
    value, facts = _facts(folder, "old", "Score")
    assert (value.value, set(facts)) == (7.5, {"From"})
    assert _facts(folder, "new", "Score")[1]["Published"] == "in attempt 1 (journal.jsonl)"
    assert "Host" in dict(explain_run(folder, "new").facts)


def test_a_folder_without_config_is_explained_as_far_as_it_goes(tmp_path):
    two_tasks(tmp_path / "made", (1.0, 2.0), (3.0, 4.0), name="made")
    value, facts = _facts(tmp_path / "made", "r_1", "Energy")
    assert value.value == 1.0
    assert "Config" not in facts


@pytest.mark.long
def test_of_an_imported_run_nothing_is_said_of_who_executed_it_where_and_when(tmp_path):
    earlier = make_earlier_folder(tmp_path / "earlier")
    adopt(understand(earlier, ImportDescription()), tmp_path / "ours")
    facts = dict(explain_run(tmp_path / "ours", "run_1").facts)
    assert set(facts) == {"Status", "Place", "Imported"}
    assert facts["Place"] == "run 2 of 4, in the order of run_table.csv"
    assert facts["Imported"].endswith("from run_table.csv of earlier: where and by what it was executed is not known")
    assert _facts(tmp_path / "ours", "run_1", "task")[1]["From"] == "run_table.csv, which was imported"
    _, of_measure = _facts(tmp_path / "ours", "run_1", "energy_J")
    assert of_measure["From"] == "`robot-runner import`"
    assert {"Plugin", "Published"}.isdisjoint(of_measure)
    assert of_measure["Quality"] == "not known: it was imported without any"


@pytest.mark.long
def test_a_column_that_import_took_for_no_measure_is_not_told_to_be_added_by_hand(tmp_path):
    (tmp_path / "theirs").mkdir()
    (tmp_path / "theirs" / "t.csv").write_text(
        "run_id,Task,Energy,Time,Ok\nr1,a,5,4.5,True\nr2,b,,3.5,False\nr3,a,9,2.5,True\nr4,b,1,1.5,False\n", "utf-8"
    )
    adopt(understand(tmp_path / "theirs", ImportDescription()), tmp_path / "ours")
    _, facts = _facts(tmp_path / "ours", "r1", "Ok")
    assert facts["From"] == "t.csv, which was imported, or a column that somebody added to run_table.csv by hand"
    assert _facts(tmp_path / "ours", "r2", "Energy")[1]["Quality"].startswith("missing")


def test_a_column_that_somebody_added_by_hand_is_told_as_that_and_as_no_measure(tmp_path):
    two_tasks(tmp_path / "made", (1.0, 2.0), (3.0, 4.0), name="made")
    table = tmp_path / "made" / "run_table.csv"
    header, *rows = table.read_text("utf-8").splitlines()
    table.write_text("\n".join([f"{header},Note", *(f"{row},it rained" for row in rows), ""]), encoding="utf-8")
    value, facts = _facts(tmp_path / "made", "r_1", "Note")
    assert (value.role, value.value) == ("extra", "it rained")
    assert facts == {"From": "a column that somebody added to run_table.csv by hand"}


def test_an_empty_treatment_is_not_told_to_be_missing(tmp_path):
    two_tasks(tmp_path / "made", (1.0, 2.0), (3.0, 4.0), name="made")
    table = tmp_path / "made" / "run_table.csv"
    table.write_text(table.read_text("utf-8").replace("Video", ""), encoding="utf-8")
    value, _ = _facts(tmp_path / "made", "r_1", "Task")
    assert (value.role, value.value) == ("factor", "")


@pytest.mark.parametrize(("run", "name", "near"), [("r_11", "Energy", "'r_1'"), ("r_1", "Enrgy", "'Energy'")])
def test_what_is_not_there_is_named_with_the_nearest(experiment, run, name, near):
    with pytest.raises(StorageError) as refused:
        explain_run(experiment, run, [name])
    assert near in refused.value.fix


HELPER = """\
class Meter:
    def before_run(self, context): ...
    def populate_run_data(self, context):
        return {"Energy": 1.0}
    def create_run_table(self): ...


class Base:
    def before_run(self, context): ...
    def start_run(self, context):
        context.publish("Early", 1.0)
"""
BASED = """\
from a_helper import Base


class RobotRunnerConfig(Base):
    plugins = [
        PsUtil(name="second"),
        PsUtil(treatment("Version")),
    ]
    def create_run_table(self):
        return RunTableModel([Factor("Task", TASKS), Factor.revisions("Version", ".", TAGS)], data_columns=MEASURES)
    def populate_run_data(self, context):
        return {"Energy": 2.0}
"""


@pytest.fixture
def lines(tmp_path):
    """Return the lines of a config whose local module, earlier in the alphabet, has methods of the same names."""
    (tmp_path / "config").mkdir()
    (tmp_path / "config" / "a_helper.py").write_text(HELPER, encoding="utf-8")
    (tmp_path / "config" / "config.py").write_text(BASED, encoding="utf-8")
    return ConfigLines(tmp_path, tmp_path / "config", {"file": "config.py", "class": "RobotRunnerConfig"})


def test_the_line_of_a_callback_is_that_of_the_config_or_of_its_base_class(lines):
    assert lines.of_method("populate_run_data").startswith("config/config.py:11  ")
    assert lines.of_method("create_run_table").startswith("config/config.py:9  ")
    assert lines.of_method("before_run").startswith("config/a_helper.py:9  ")
    assert lines.of_method("stop_run") == ""


def test_the_line_of_a_measure_is_in_the_method_that_yields_it(lines):
    assert lines.of_measure("Energy").startswith("config/config.py:11  ")
    assert lines.of_measure("Early").startswith("config/a_helper.py:10  ")


def test_the_line_of_a_measure_that_no_method_names_is_in_the_function_that_does(tmp_path):
    (tmp_path / "config").mkdir()
    (tmp_path / "config" / "laps.py").write_text(
        "def names():\n    return ['Laps']\n\n\ndef count(context):\n    context.publish('Laps', 3)\n", encoding="utf-8"
    )
    code = BASED.replace("return {", "laps.count(context); return {").replace(
        "from a_helper", "import laps\nfrom a_helper"
    )
    (tmp_path / "config" / "config.py").write_text(code, encoding="utf-8")
    lines = ConfigLines(tmp_path, tmp_path / "config", {"file": "config.py", "class": "RobotRunnerConfig"})
    assert lines.of_measure("Laps") == "config/laps.py:5  def count(context):"
    assert lines.of_measure("of_a_computed_name").startswith("config/config.py:12  def populate_run_data")


def test_the_line_of_a_factor_is_the_one_that_makes_it(lines):
    assert lines.of_factor("Version") == lines.of_factor("Task")
    assert lines.of_factor("Task").startswith("config/config.py:10  ")


def test_the_line_of_a_plugin_is_not_that_of_another_of_its_kind(lines):
    assert lines.of_plugin("second", "PsUtil").startswith("config/config.py:6  ")
    assert lines.of_plugin("PsUtil", "PsUtil").startswith("config/config.py:7  ")


def test_a_config_that_is_its_own_base_or_nested_beyond_measure_is_explained_all_the_same(tmp_path):
    (tmp_path / "config").mkdir()
    circle = "class A(B): ...\nclass B(A):\n    def start_run(self): ...\n"
    (tmp_path / "config" / "a.py").write_text(circle, encoding="utf-8")
    (tmp_path / "config" / "b.py").write_text(f"x = {'-' * 100_000}1\n", encoding="utf-8")
    found = ConfigLines(tmp_path, tmp_path / "config", {"file": "a.py", "class": "A"})
    assert found.of_method("start_run").startswith("config/a.py:3  ")


def test_the_machine_of_a_worker_is_told_of_each_run_there_as_it_was_then(tmp_path):
    """It is told with the first run at a worker, and again with the first one after that has joined anew."""
    folder = two_tasks(tmp_path / "made", (1.0, 2.0), (3.0, 4.0), name="made")
    with Journal(folder.files.journal) as journal:
        for run, place, cores in (("r_1", "pi", 4), ("r_2", "nuc", 8), ("r_3", "pi", None), ("r_4", "pi", 2)):
            journal.append("attempt_started", run=run, attempt=2, place=place, slot=0)
            if cores:
                journal.append("machine", run=run, attempt=2, place=place, host={"processor": "A", "cores": cores})
        journal.append("excluded", run="r_1", reason="a cable was loose")
    told = [dict(explain_run(folder.root, run).facts)["Host"].split(", directed")[0] for run in ("r_1", "r_2", "r_3")]
    assert told == [
        "worker pi of a cluster (A, 4 cores)",
        "worker nuc of a cluster (A, 8 cores)",
        "worker pi of a cluster (A, 4 cores)",
    ]
    assert "A, 2 cores" in dict(explain_run(folder.root, "r_4").facts)["Host"]


@pytest.mark.parametrize(
    ("where", "manifest", "robot", "host"),
    [
        (
            {"place": "left", "slot": 2},
            {"robots": {"left": "ros2", "right": "simulated"}},
            "left: ros2",
            "Linux, Python",
        ),
        ({"place": "pi-3", "slot": 0}, {}, "ros1", "worker pi-3 of a cluster, directed from Linux, Python"),
        ({}, {}, "ros1", "Linux, Python"),
    ],
)
def test_robot_and_host_are_those_that_executed_the_run(tmp_path, where, manifest, robot, host):
    folder = two_tasks(tmp_path / "made", (1.0,), (3.0,), name="made", manifest=manifest)
    with Journal(folder.files.journal) as journal:
        journal.append("attempt_started", run="r_1", attempt=2, **where)
    facts = dict(explain_run(folder.root, "r_1").facts)
    assert facts["Robot"] == robot
    assert facts["Host"].startswith(host)


@pytest.mark.parametrize(
    ("given", "place", "robot"),
    [
        ({"robot['left']": "ros2://b", "robot['right']": "ros2://c"}, {"place": "left"}, "left: ros2://b"),
        ({"robot['left']": "ros2://b", "robot['right']": "ros2://c"}, {"place": "right"}, "right: ros2://c"),
        ({"robot": "ros2://d"}, {}, "ros2://d"),
    ],
)
def test_the_robot_is_reached_as_in_the_execution_in_which_the_run_was_executed(tmp_path, given, place, robot):
    first = {"started_at": "2000-01-01T00:00:00.000Z", "given": {"robot['left']": "ros2://a"}}
    manifest = {
        "executions": [first, {"started_at": "2000-01-02T00:00:00.000Z", "given": given}],
        "robot": "ros2://a",
        "robots": {"left": "ros2://a"},
    }
    folder = two_tasks(tmp_path / "made", (1.0,), (3.0,), name="made", manifest=manifest)
    with Journal(folder.files.journal) as journal:
        journal.append("attempt_started", run="r_1", attempt=2, **place)
    assert dict(explain_run(folder.root, "r_1").facts)["Robot"] == robot


@pytest.mark.parametrize(
    ("design", "order"),
    [
        ({"facts": {"decides": "once these are done"}}, "as results decided"),
        ({"facts": {}}, "in the order of the config"),
        ({"facts": {"decides": "once these are done"}, "shuffle": True}, "randomised from seed 7"),
    ],
)
def test_runs_that_results_decided_on_are_not_in_the_order_of_the_config(tmp_path, design, order):
    folder = two_tasks(tmp_path / "made", (1.0,), (3.0,), name="made", manifest={"design": design, "seed": 7})
    assert dict(explain_run(folder.root, "r_1").facts)["Place"] == f"run 1 of 2, {order}"


def test_an_event_that_was_not_emitted_is_said_to_be_none(experiment):
    assert _facts(experiment, "r_1", "continue_at")[1]["Event"] == "continue, not emitted in this run"


def test_the_host_is_that_of_the_execution_in_which_the_run_was_executed(tmp_path):
    manifest = {
        "executions": [
            {"started_at": "2000-01-01T00:00:00.000Z"},
            {
                "started_at": "2000-01-02T00:00:00.000Z",
                "changed": {"python": {"was": "3.11.7", "is": "3.13.1"}, "processor": {"was": None, "is": "Cortex"}},
            },
        ],
        "host": {"processor": None, "system": "Linux"},
    }
    folder = two_tasks(tmp_path / "made", (1.0,), (3.0,), name="made", manifest=manifest)
    with Journal(folder.files.journal) as journal:
        journal.append("attempt_started", run="r_1", attempt=2)
    assert dict(explain_run(folder.root, "r_1").facts)["Host"] == "Cortex Linux, Python 3.13.1"


@pytest.fixture
def changed(tmp_path):
    return changed_between_its_runs(tmp_path)


def test_the_line_is_that_of_the_config_that_executed_the_run(changed):
    value, facts = _facts(changed, "r_1", "Score")
    assert (value.value, facts["Config"]) == (
        1.0,
        "earlier_configs/1/changing.py:12  def populate_run_data(self, context):",
    )
    assert _facts(changed, "r_1", "Task")[1]["Config"].startswith("earlier_configs/1/changing.py:10  ")
    value, facts = _facts(changed, "r_2", "Score")
    assert (value.value, facts["Config"]) == (2.0, "config/changing.py:13  def populate_run_data(self, context):")


def test_where_nothing_tells_which_config_executed_a_run_no_line_is_named(changed):
    manifest = read_manifest(changed / "manifest.json")
    for execution in manifest["executions"]:
        del execution["config_number"]  # as of an earlier version
    write_manifest(changed / "manifest.json", manifest)
    explained = explain_run(changed, "r_1", ["Score"])
    assert "Config" not in dict(explained.values[0].facts)
    assert dict(explained.facts)["Config"] == (
        "changed between two executions, and it is not recorded which of config/ and earlier_configs/ executed the run"
    )


def test_a_plugin_that_was_added_later_is_told_with_its_class_and_its_line(tmp_path):
    config = tmp_path / "changing.py"
    config.write_text(CHANGING, encoding="utf-8")
    with own_modules():
        execute_experiment(prepare(config).experiment, SilentObserver(), resumption=Resumption(only=("r_1",)))
    added = """\
from robot_runner.plugins import Measure, Profiler


class Odometer(Profiler):
    measures = (Measure("Laps", "1"),)

    def populate_run_data(self, context):
        context.publish("Laps", 3)


"""
    table = CHANGING.replace("    run_process", '    plugins = [Odometer(name="wheel")]\n    run_process')
    config.write_text(f"{added}{table}", encoding="utf-8")
    with own_modules():
        execute_experiment(prepare(config).experiment, SilentObserver(), resumption=Resumption(accept_changes=True))
    _, facts = _facts(tmp_path / "results" / "changing", "r_2", "Laps")
    assert facts["Plugin"] == "wheel, Odometer"
    assert facts["Config"] == 'config/changing.py:17  plugins = [Odometer(name="wheel")]'


def test_of_a_plugin_that_is_not_known_no_line_is_named(lines):
    assert lines.of_plugin("wheel", "") == ""
