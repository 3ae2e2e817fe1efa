from __future__ import annotations

import json
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import pytest

from robot_runner.core.config.preparation import prepare_or_refuse
from robot_runner.core.errors import MeasureError
from robot_runner.core.events.measure import Measure
from robot_runner.core.execution.notices import SilentObserver
from robot_runner.core.execution.orchestrator import execute_experiment
from robot_runner.core.execution.resumption import Resumption

if TYPE_CHECKING:
    from pathlib import Path

Execute = Callable[..., Any]

DOUBTING = """
run_process = RunProcess.IN_PROCESS

def populate_run_data(self, context):
    if context.combination["Task"] == "Video":
        context.doubt("the sensor was hot: 81 degC", measures=["Energy"])
    return {"Energy": None if context.repetition == 2 else 7.5}
"""

LIMITED = """\
    def create_run_table(self):
        return RunTableModel(
            [Factor("Task", ["Video", "Network"])],
            data_columns=[Measure("Energy", "J", "Energy.", low=0.0, high=10.0)],
        )
"""
HEAD = """\
from pathlib import Path
from robot_runner import *
from robot_runner.plugins import Measure


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    results_output_path = Path("results")
"""
#: A meter that publishes nothing, and prints in the first run.
SILENT = HEAD.replace(
    "import Measure\n",
    """import Measure, Profiler
class Meter(Profiler):
    measures = (Measure("Power", "W", "Power."),)
    def stop_measurement(self, context):
        if context.run_number == 1: print("no sensor")
""",
)
ABOVE = "the value, 11 J, is above 10 J, the largest that is plausible"
#: Out of its limits at the first attempt of the first run, missing at the second.
UNSTEADY = """
run_process = RunProcess.IN_PROCESS

def populate_run_data(self, context):
    if context.combination["Task"] == "Network":
        return {"Energy": 7.5}
    return {"Energy": {1: 11.0, 2: None}.get(context.attempt, 8.0)}
"""


def doubts_of(folder: Path, column: str = "Energy") -> dict[str, list[str]]:
    fields = json.loads((folder / "run_table.schema.json").read_text(encoding="utf-8"))["fields"]
    found: dict[str, list[str]] = next(field for field in fields if field["name"] == column).get(
        "robot_runner:doubts", {}
    )
    return found


def test_a_doubt_stands_beside_the_value_in_journal_and_schema(execute: Execute) -> None:
    executed = execute(DOUBTING)
    hot = ["the sensor was hot: 81 degC"]
    ends = {end["run"]: end["measures"]["Energy"] for end in executed.journal("attempt_finished")}
    assert ends["r_1"]["doubts"] == hot
    assert "doubts" not in ends["r_2"]
    assert doubts_of(executed.folder) == {"r_1": hot, "r_3": hot}


def test_the_run_table_tells_the_quality_on_request(execute: Execute) -> None:
    executed = execute(DOUBTING, quality_columns=True)
    table = executed.table
    assert list(executed.notices[0].columns) == ["Energy"]
    assert [row["Energy.quality"] for row in table] == [
        "doubtful: the sensor was hot: 81 degC",
        "good",
        "missing: the sensor was hot: 81 degC",
        "missing",
    ]


@pytest.mark.long
def test_doubts_outlast_a_resumption_and_go_with_the_attempt_that_they_were_about(execute: Execute) -> None:
    executed = execute(DOUBTING)
    experiment = prepare_or_refuse(executed.config)
    execute_experiment(experiment, SilentObserver(), resumption=Resumption(only=("r_1",)))
    assert set(doubts_of(executed.folder)) == {"r_1", "r_3"}
    executed.config.write_text(executed.config.read_text(encoding="utf-8").replace("81", "25"), encoding="utf-8")
    experiment = prepare_or_refuse(executed.config)
    again = Resumption(redo=("r_1",), accept_changes=True)
    execute_experiment(experiment, SilentObserver(), resumption=again)
    assert doubts_of(executed.folder) == {
        "r_1": ["the sensor was hot: 25 degC"],
        "r_3": ["the sensor was hot: 81 degC"],
    }


def test_a_doubt_that_names_a_file_which_is_not_in_utf_8_is_kept_as_text(execute: Execute) -> None:
    body = """
    quality_columns = True
    def populate_run_data(self, context):
        context.doubt("nothing came of caf\\udce9.csv", fix="Look at caf\\udce9.csv.", measures=["Energy"])
        return {"Energy": None}
    """
    table = '    def create_run_table(self): return RunTableModel([Factor("N", [1])], data_columns=["Energy"])'
    executed = execute(body, table=table)
    reason = "nothing came of caf\\udce9.csv"
    assert executed.table[0]["Energy.quality"] == f"missing: {reason}"
    assert doubts_of(executed.folder) == {"r_1": [reason]}


@pytest.mark.parametrize("policy", ["keep", "fail"])
def test_why_a_value_that_nobody_published_is_missing_is_told(execute: Execute, policy: str) -> None:
    body = """
    quality_columns = True
    operation_type = OperationType.SEMI
    run_process = RunProcess.IN_PROCESS
    def before_experiment(self): return True
    def start_run(self, context): context.doubt("the sensor was silent")
    def continue_experiment(self, context): return True
    """
    executed = execute(body, on_bad_value=policy)
    assert {row["Energy.quality"] for row in executed.table} == {"missing: the sensor was silent"}
    if policy == "fail":
        assert all(each.endswith("Energy has no value: the sensor was silent") for each in executed.finished.failures)


def test_a_value_beyond_its_limits_is_kept_and_doubtful(execute: Execute) -> None:
    executed = execute(UNSTEADY, table=LIMITED, head=HEAD)
    assert [row["Energy"] for row in executed.table] == ["11.0", "7.5"]
    assert doubts_of(executed.folder) == {"r_1": [ABOVE]}
    schema = json.loads((executed.folder / "run_table.schema.json").read_text(encoding="utf-8"))
    [unit] = [field["unit"] for field in schema["fields"] if field["name"] == "Energy"]
    assert unit == "J"


def test_a_bad_value_is_tried_again_while_attempts_are_left(execute: Execute) -> None:
    executed = execute(UNSTEADY, table=LIMITED, head=HEAD, on_bad_value="try_again", attempts=3)
    assert [row["Energy"] for row in executed.table] == ["8.0", "7.5"]
    ends = [(end["run"], end["status"], end["failure"]) for end in executed.journal("attempt_finished")]
    assert ends == [
        ("r_1", "failed", f"populate_run_data of config: Energy: {ABOVE}"),
        ("r_1", "failed", "populate_run_data of config: Energy has no value"),
        ("r_1", "done", None),
        ("r_2", "done", None),
    ]


def test_the_last_attempt_s_bad_value_is_kept(execute: Execute) -> None:
    executed = execute(UNSTEADY, table=LIMITED, head=HEAD, on_bad_value="try_again")
    assert [row["status"] for row in executed.table] == ["Done", "Done"]
    assert list(doubts_of(executed.folder)) == ["r_1"]


def test_a_bad_value_fails_the_run_where_the_config_says_so(execute: Execute) -> None:
    executed = execute(UNSTEADY, table=LIMITED, head=HEAD, on_bad_value="fail", attempts=2)
    assert [row["status"] for row in executed.table] == ["Failed", "Done"]


def test_limits_that_leave_nothing_are_refused() -> None:
    with pytest.raises(MeasureError, match="no value can be plausible"):
        Measure("Energy", "J", low=2.0, high=1.0)


def test_a_measure_of_a_plugin_is_not_declared_again(execute: Execute) -> None:
    table = LIMITED.replace('Measure("Energy"', 'Measure("CPU"')
    body = "robot = 'simulated'\nplugins = [PsUtil()]"
    head = HEAD.replace("\n\n\nclass", "\nfrom robot_runner.plugins.profilers import PsUtil\n\n\nclass")
    with pytest.raises(Exception, match="is declared here, and by plugin PsUtil"):
        execute(body, table=table, head=head)


def test_what_is_advised_of_a_missing_value_can_be_done(execute: Execute) -> None:
    body = "probe = False\nplugins = [Meter()]\ndef populate_run_data(self): return {'Energy': 1.0}"
    executed = execute(body, head=SILENT, table=LIMITED.replace("data_columns=[", 'data_columns=["Power", '))
    advised = {each.where: each.fix for each in executed.finished.findings if each.problem == "Power has no value"}
    assert advised["r_1, Meter"] == "Look at the log of the run."
    assert advised["r_2, Meter"].startswith("Publish it in populate_run_data"), "it has no log"


def test_whose_value_is_missing_for_a_reason_is_not_told_to_give_one(execute: Execute) -> None:
    doubting = "context.doubt('no sensor')\n    def populate_run_data(self, context): context.publish('Power', None)"
    head = SILENT.replace('if context.run_number == 1: print("no sensor")', doubting)
    body = "probe = False\nplugins = [Meter()]\ndef populate_run_data(self): return {'Energy': 1.0}"
    executed = execute(body, head=head, table=LIMITED.replace("data_columns=[", 'data_columns=["Power", '))
    advised = [each.fix for each in executed.finished.findings if each.problem == "Power has no value"]
    assert advised == ["`robot-runner explain RUN` gives the reasons."] * 2


#: On a robot of a graph that is simulated, one plugin measures this machine, and one the robot.
ON_SIMULATED_GRAPH = HEAD.replace(
    "import Measure\n",
    """import Measure, Origin, Profiler
class Meter(Profiler):
    measures = (Measure("Power", "W", "Power."), Measure("Startup", "s", "Time to start a program here."))
    def populate_run_data(self, context):
        context.publish("Power", 5.0, origin=Origin.SIMULATED)
        context.publish("Startup", 1.0)
""",
)


def test_what_the_config_computes_beside_simulated_values_is_simulated(execute: Execute) -> None:
    body = """
plugins = [Meter()]
def populate_run_data(self, context):
    context.publish("Work", 10.0)
    return {"Energy": 2 * context.measures["Power"]}
"""
    table = LIMITED.replace("data_columns=[", 'data_columns=["Work", ')
    measures = execute(body, head=ON_SIMULATED_GRAPH, table=table).journal("attempt_finished")[0]["measures"]
    assert {name: each["origin"] for name, each in measures.items()} == {
        "Power": "simulated",
        "Startup": "measured",
        "Work": "simulated",
        "Energy": "simulated",
    }
