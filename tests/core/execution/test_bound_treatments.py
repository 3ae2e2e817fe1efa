"""Treatments that reach the plugins that they are bound to, in each kind of process, and those that reach nobody."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from tests.long_cases import soak_but

from robot_runner.core.config.preparation import prepare_or_refuse
from robot_runner.core.errors import ExecutionError
from robot_runner.core.execution.notices import AttemptFinished, FindingsNoticed, SilentObserver
from robot_runner.core.execution.orchestrator import execute_experiment
from robot_runner.core.execution.resumption import Resumption

Execute = Callable[..., Any]
Write = Callable[..., Path]

#: Some 0.15 and 0.6 m on the simulated robot.
HEAD = """\
from robot_runner import *
from robot_runner.plugins import Measure, PluginError, Profiler
from robot_runner.plugins.systems import BasicTurtlebot3

SHORT = dict(task="Video", sleep_s=0.2, drive_s=2, task_s=0.2, rotate_s=4)


class Meter(Profiler):
    measures = (Measure("Used", "Hz", "The rate that it was built with."),)

    def __init__(self, rate, *, name=None):
        super().__init__(name=name)
        if rate == 99:
            raise PluginError("no such rate", where="Meter", fix="Take another.")
        self.rate = rate

    def start_run(self, context):
        self.seen = self.rate

    def populate_run_data(self, context):
        context.publish("Used", self.seen)


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    results_output_path = "results"
"""
SPEEDS = """
    def create_run_table(self):
        return RunTableModel([Factor("Speed", [0.05, 0.2])])
"""
RATES = """
    def create_run_table(self):
        return RunTableModel([Factor("Rate", [1.0, 2.0, 3.0])])
"""
#: For runs that are an interpreter each.
TWO_RATES = RATES.replace(", 3.0", "")
BOUND = "plugins = [Meter(treatment('Rate'))]"
SET = """
robot = "simulated"

def __init__(self):
    self.turtle = BasicTurtlebot3(**SHORT)
    self.plugins = [self.turtle]

def before_run(self, context):
    self.turtle.speed = context.combination["Speed"]
"""


@pytest.mark.long
def test_setting_a_parameter_of_a_plugin_in_a_callback_is_refused_with_the_remedy(execute: Execute) -> None:
    executed = execute(SET, head=HEAD, table=SPEEDS)
    assert [row["status"] for row in executed.table] == ["Failed", "Failed"]
    (failure, _) = executed.finished.failures
    assert "speed is a parameter of BasicTurtlebot3: changing it has no effect once it is built" in failure
    assert "BasicTurtlebot3(speed=treatment('Speed'))" in failure
    assert executed.journal("attempt_finished")[0]["stamps"].keys() == {"before_run"}  # nothing moved


@pytest.mark.long
@pytest.mark.parametrize("process", soak_but({"FORK", "IN_PROCESS"}, ["FORK", "SPAWN", "IN_PROCESS"]))
def test_a_bound_speed_is_driven(execute: Execute, process: str) -> None:
    body = f"""
    robot = "simulated"
    run_process = RunProcess.{process}
    plugins = [BasicTurtlebot3(speed=treatment("Speed"), **SHORT)]
    """
    executed = execute(body, head=HEAD, table=SPEEDS)
    slow, fast = (float(row["Distance"]) for row in executed.table)
    assert slow == pytest.approx(0.15, rel=0.1)
    assert fast == pytest.approx(4 * slow, rel=0.05)
    assert not [each for each in executed.finished.findings if "looked at" in each.problem]


@pytest.mark.long
@pytest.mark.parametrize("process", soak_but({"SPAWN", "IN_PROCESS"}, ["FORK", "SPAWN", "IN_PROCESS"]))
def test_the_same_plugin_has_the_treatment_in_all_callbacks_of_a_run(execute: Execute, process: str) -> None:
    body = f"""
    run_process = RunProcess.{process}

    def __init__(self):
        self.meter = Meter(treatment("Rate"))
        self.plugins = [self.meter]
        EventSubscriptionController.subscribe_to_single_event(RobotRunnerEvents.LAUNCH_MISSION, self.drive)

    def before_run(self, context):
        print("before", context.run_id, self.meter.rate)

    def drive(self, context):
        assert self.meter.rate == context.combination["Rate"]
        assert self.meter.seen == self.meter.rate
    """
    executed = execute(body, head=HEAD, table=TWO_RATES)
    assert [row["status"] for row in executed.table] == ["Done"] * 2
    assert used(executed) == [1.0, 2.0]


def used(executed: Any) -> list[float]:
    return [float(row["Used"]) for row in executed.table]


def unread(executed: Any) -> list[str]:
    return [finding.problem for finding in executed.finished.findings if "looked at" in finding.problem]


def test_before_run_sees_the_plugin_of_its_run_and_what_it_changes_counts(execute: Execute) -> None:
    body = """
    def __init__(self):
        self.meter = Meter(treatment("Rate"))
        self.plugins = [self.meter]

    def before_run(self, context):
        assert self.meter.rate == context.combination["Rate"]
        self.meter.mark = self.meter.rate * 10

    def launch_mission(self, context):
        assert self.meter.mark == context.combination["Rate"] * 10
    """
    assert used(execute(body, head=HEAD, table=RATES)) == [1.0, 2.0, 3.0]


def test_each_record_says_which_value_each_parameter_had(execute: Execute) -> None:
    executed = execute(BOUND, head=HEAD, table=RATES)
    assert [(each["run"], each["owner"], each["parameters"]) for each in executed.journal("bound")] == [
        (f"r_{number}", "Meter", {"rate": {"factor": "Rate", "value": float(number)}}) for number in (1, 2, 3)
    ]
    manifest = json.loads((executed.folder / "manifest.json").read_text(encoding="utf-8"))
    assert [each["bound_parameters"] for each in manifest["plugins"]] == [{"rate": "Rate"}]
    assert manifest["design"]["factors"] == {"Rate": ["1.0", "2.0", "3.0"]}


@pytest.mark.long
def test_a_treatment_of_any_type_arrives_as_the_object_itself(execute: Execute) -> None:
    table = """
    def create_run_table(self):
        return RunTableModel([Factor("Ways", [(1, 2), ["a"]])])
    """
    body = """
    run_process = RunProcess.SPAWN

    class Own(Profiler):
        def __init__(self, ways):
            super().__init__()
            self.ways = ways

        def launch_mission(self, context):
            assert type(self.ways) is type(context.combination["Ways"]) and self.ways is context.combination["Ways"]

    plugins = [Own(treatment("Ways"))]
    """
    executed = execute(body, head=HEAD, table=table)
    assert [row["status"] for row in executed.table] == ["Done", "Done"], executed.finished.failures


# Run tables that were written by hand, and experiments that go on.


def by_hand(config: Path, rows: str) -> None:
    folder = config.parent / "results" / "trial"
    folder.mkdir(parents=True)
    (folder / "run_table.csv").write_text(rows, encoding="utf-8")


@pytest.mark.long
@pytest.mark.parametrize("process", ["FORK", "SPAWN"])
def test_treatments_of_a_table_written_by_hand_arrive(write_config: Write, process: str) -> None:
    config = write_config(f"run_process = RunProcess.{process}\n{BOUND}", head=HEAD, table=RATES)
    by_hand(config, "run_id,status,Rate,Used\nx,TODO,7.5,\ny,TODO,1.0,\n")
    finished = execute_experiment(prepare_or_refuse(config), SilentObserver())
    lines = finished.run_table.read_text(encoding="utf-8").splitlines()
    assert [line.rsplit(",", 1)[1] for line in lines[1:]] == ["7.5", "1.0"]


def test_those_that_the_plugin_does_not_take_are_refused_before_the_first_run(write_config: Write) -> None:
    body = f"{BOUND}\ndef before_experiment(self): open('begun', 'w')"
    config = write_config(body, head=HEAD, table=RATES)
    by_hand(config, "run_id,status,Rate,Used\nx,TODO,1.0,\ny,TODO,99.0,\n")
    with pytest.raises(ExecutionError) as caught:
        execute_experiment(prepare_or_refuse(config), SilentObserver())
    assert caught.value.problem == "with Rate = 99.0: no such rate"
    assert caught.value.where == "Meter(rate=treatment('Rate'))"
    assert not Path("begun").exists()


def test_a_plugin_that_refuses_its_treatment_only_now_fails_that_run(execute: Execute) -> None:
    body = """
    class Moody(Profiler):
        built = 0

        def __init__(self, rate):
            super().__init__()
            self.rate = rate
            type(self).built += 1
            if type(self).built > 7 and rate == 2.0:
                raise RuntimeError("not today")

        def start_run(self, context): pass

    plugins = [Moody(treatment("Rate"))]
    """
    executed = execute(body, head=HEAD, table=RATES)
    assert [row["status"] for row in executed.table] == ["Done", "Failed", "Done"]
    assert executed.finished.failures == ("r_2: Moody: RuntimeError: not today",)
    assert executed.journal("attempt_finished")[1]["stamps"] == {}


def test_an_experiment_that_goes_on_binds_what_is_left(write_config: Write, tmp_path: Path) -> None:
    body = f"""
    {BOUND}

    def start_run(self, context):
        if context.run_number == 2 and not Path({str(tmp_path / "again")!r}).exists():
            raise RuntimeError("first time")
    """
    config = write_config(body, head="from pathlib import Path\n" + HEAD, table=RATES)
    first = execute_experiment(prepare_or_refuse(config), SilentObserver())
    assert first.failed == ("r_2",)
    (tmp_path / "again").touch()
    again = execute_experiment(prepare_or_refuse(config), SilentObserver(), resumption=Resumption(redo=("r_3",)))
    lines = again.run_table.read_text(encoding="utf-8").splitlines()
    assert [line.rsplit(",", 1)[1] for line in lines[1:]] == ["1.0", "2.0", "3.0"]


# Factors that nobody reads.

UNREAD = "no callback and no plugin looked at Rate: its treatments may never have been applied"


def test_a_factor_that_nobody_looks_at_is_found_after_the_first_run_and_told_again_at_the_end(
    execute: Execute,
) -> None:
    executed = execute("def launch_mission(self, context): pass", head=HEAD, table=RATES)
    kinds = [type(notice) for notice in executed.notices]
    assert kinds.count(FindingsNoticed) == 1
    assert kinds.index(FindingsNoticed) == kinds.index(AttemptFinished) + 1
    (finding,) = executed.finished.findings
    assert (finding.where, finding.problem) == ("r_1, factor 'Rate'", UNREAD)
    assert "treatment('Rate')" in finding.fix
    assert "context.combination['Rate']" in finding.fix
    assert [each["readers"] for each in executed.journal("attempt_finished")] == [{}] * 3


#: Of a callback of the orchestrator, and of one of the run.
READ = "def {}(self, context): self.rate = context.combination['Rate']"


@pytest.mark.long
@pytest.mark.parametrize(
    ("process", "callback"),
    [
        *(("IN_PROCESS", READ.format(event)) for event in ("before_run", "launch_mission")),
        ("SPAWN", READ.format("launch_mission")),
        pytest.param("SPAWN", READ.format("before_run"), marks=pytest.mark.soak),
        ("FORK", READ.format("before_run")),
        ("FORK", "def before_run(self, context): self.command = ['drive', *map(str, context.combination.values())]"),
        ("FORK", "def launch_mission(self, context): print(f'now {context.combination}')"),
        (
            "FORK",
            "def launch_mission(self, context): subprocess.run(['true'], env={'R': str(context.combination['Rate'])})",
        ),
        ("FORK", "def launch_mission(self, context): helper(**context.combination)"),
        ("FORK", "def populate_run_data(self, context): context.combination.get('Rate')"),
    ],
)
def test_a_factor_that_a_callback_reads_anywhere_is_read(execute: Execute, callback: str, process: str) -> None:
    head = "import subprocess\ndef helper(Rate): pass\n" + HEAD
    body = f"run_process = RunProcess.{process}\n{callback}"
    executed = execute(body, head=head, table=TWO_RATES)
    assert unread(executed) == []
    assert [each["readers"] for each in executed.journal("attempt_finished")] == [{"Rate": ["config"]}] * 2


def test_who_read_what_is_put_together_from_both_processes(execute: Execute) -> None:
    table = """
    def create_run_table(self):
        return RunTableModel([Factor(name, [1.0, 2.0]) for name in ("Rate", "Early", "Late", "Nobody", "Repetition")])
    """
    body = f"""
    on_failure = FailurePolicy.STOP
    {BOUND}
    def before_run(self, context): context.combination["Early"]
    def stop_run(self, context): context.combination["Late"], context.combination["Early"]
    def populate_run_data(self, context): assert context.run_number < 3
    """
    executed = execute(body, head=HEAD, table=table)
    readers = executed.journal("attempt_finished")[0]["readers"]
    assert readers == {"Rate": ["Meter"], "Early": ["config"], "Late": ["config"]}
    assert [each.partition(" looked at ")[2].partition(":")[0] for each in unread(executed)] == ["Nobody"]


def test_what_a_later_run_reads_is_not_told_at_the_end(execute: Execute) -> None:
    table = """
    def create_run_table(self):
        return RunTableModel([Factor("Task", ["sleep", "drive"]), Factor("Rate", [1.0, 2.0])])
    """
    body = """
    def launch_mission(self, context):
        if context.combination["Task"] == "drive":
            print(context.combination["Rate"])
    """
    executed = execute(body, head=HEAD, table=table)
    (noticed,) = [notice for notice in executed.notices if isinstance(notice, FindingsNoticed)]
    assert [finding.problem for finding in noticed.findings] == [UNREAD]
    assert unread(executed) == []


def test_the_tool_itself_reads_nothing(execute: Execute) -> None:
    body = "operation_type = OperationType.AUTO\ndef start_run(self, context): context.warn('odd')"
    assert unread(execute(body, head=HEAD, table=RATES)) == [UNREAD]


def test_a_factor_with_one_treatment_and_an_empty_experiment_say_nothing(execute: Execute) -> None:
    one = RATES.replace("[1.0, 2.0, 3.0]", "[1.0]")
    assert unread(execute("def start_run(self): pass", head=HEAD, table=one)) == []


def test_runs_that_fail_say_nothing_of_factors(execute: Execute) -> None:
    assert unread(execute("def start_run(self): raise RuntimeError", head=HEAD, table=RATES)) == []


def test_a_config_of_an_earlier_tool_that_reads_its_row_has_nothing_said(tmp_path: Path) -> None:
    config = tmp_path / "RunnerConfig.py"
    config.write_text(
        """
from EventManager.Models.RunnerEvents import RunnerEvents
from EventManager.EventSubscriptionController import EventSubscriptionController
from ConfigValidator.Config.Models.RunTableModel import RunTableModel
from ConfigValidator.Config.Models.FactorModel import FactorModel
from ConfigValidator.Config.Models.OperationType import OperationType
from pathlib import Path


class RunnerConfig:
    name = "earlier"
    results_output_path = Path(__file__).parent
    operation_type = OperationType.AUTO
    time_between_runs_in_ms = 0

    def __init__(self):
        EventSubscriptionController.subscribe_to_multiple_events([(RunnerEvents.START_RUN, self.start_run)])

    def create_run_table_model(self):
        return RunTableModel(factors=[FactorModel("example", ["a", "b"])])

    def start_run(self, context):
        print(context.run_variation["example"])
""",
        encoding="utf-8",
    )
    finished = execute_experiment(prepare_or_refuse(config), SilentObserver())
    assert finished.done_count == 2
    assert [each.problem for each in finished.findings if "looked at" in each.problem] == []


AFTER_RUNS = """
class After(Meter):
    def claims(self, robot):
        return ()

    def continue_experiment(self, context):
        context.publish("Used", self.rate)
        return True


class RobotRunnerConfig(RobotRunnerConfig):
    operation_type = OperationType.SEMI
    claims = []
"""


@pytest.mark.long
def test_what_a_plugin_does_after_a_run_is_done_with_its_treatments_though_others_have_begun(execute: Execute) -> None:
    body = 'plugins = [After(treatment("Rate"), name="Meter")]\ndef before_experiment(self): return True\n'
    body += "def populate_run_data(self, context): return {'Used': 0.0}\n"
    table = RATES.replace("1.0, 2.0, 3.0", "1.0, 2.0, 3.0, 4.0")
    executed = execute(body, head=HEAD + AFTER_RUNS, table=table, workers=2)
    last = {each["run"]: each["measures"]["Used"]["value"] for each in executed.journal("attempt_finished")}
    rates = {row["run_id"]: float(row["Rate"]) for row in executed.table}
    assert sum(map(bool, last.values())) == 2, "one after a run at each place that another follows there"
    assert {run: rates[run] for run, value in last.items() if value} == {run: v for run, v in last.items() if v}
