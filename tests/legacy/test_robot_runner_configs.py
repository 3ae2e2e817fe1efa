"""Every form that configs for Robot Runner had."""

from __future__ import annotations

import io
import sys
from typing import TYPE_CHECKING, Any

import pytest
from tests.legacy.earlier_configs import ROBOT, planned, problems

from robot_runner.core.config.parameters import OperationType
from robot_runner.core.config.preparation import prepare

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from tests.legacy.earlier_configs import Executed


def test_the_rows_of_the_model_are_the_runs(config: Callable[..., Path]) -> None:
    assert planned(prepare(config(head=ROBOT))) == [
        ("run_0", {"task": "scan", "speed": 0.1}),
        ("run_1", {"task": "scan", "speed": 0.2}),
        ("run_2", {"task": "map", "speed": 0.1}),
        ("run_3", {"task": "map", "speed": 0.2}),
    ]


def test_sets_of_values_exclude(config: Callable[..., Path]) -> None:
    table = """\
    def create_run_table(self):
        run_table = RunTableModel(
            factors=[FactorModel("task", ["scan", "map"]), FactorModel("run_number", range(1, 4))],
            exclude_variations=[{"map", 3}, {"scan", 1}],
        )
        run_table.create_experiment_run_table()
        return run_table.get_experiment_run_table()
"""
    assert [run for _, run in planned(prepare(config(head=ROBOT, table=table)))] == [
        {"task": "scan", "run_number": 2},
        {"task": "scan", "run_number": 3},
        {"task": "map", "run_number": 1},
        {"task": "map", "run_number": 2},
    ]


def test_a_treatment_given_twice_is_executed_twice(config: Callable[..., Path]) -> None:
    table = """\
    def create_run_table(self):
        run_table = RunTableModel([FactorModel("task", ["scan", "scan"])])
        run_table.create_experiment_run_table()
        return run_table.get_experiment_run_table()
"""
    assert planned(prepare(config(head=ROBOT, table=table))) == [
        ("run_0", {"task": "scan"}),
        ("run_1", {"task": "scan"}),
    ]


def test_rows_that_are_written_by_hand_are_the_runs(
    config: Callable[..., Path], execute: Callable[..., Executed]
) -> None:
    table = """\
    def create_run_table(self):
        from ProgressManager.RunTable.Models.RunProgress import RunProgress
        return [
            {"__run_id": f"trial_{n}", "__done": RunProgress.TODO, "distance": distance, "energy": " "}
            for n, distance in enumerate((5, 7, 5))
        ]

    def populate_run_data(self, context):
        row = context.run_variation
        row["energy"] = row["distance"] * 1.5
        return row
"""
    subscribe = "(RobotRunnerEvents.POPULATE_RUN_DATA, self.populate_run_data),"
    executed = execute(config(head=ROBOT, table=table, subscribe=subscribe))
    assert executed.text.splitlines() == [
        "__run_id,__done,distance,energy",
        "trial_0,DONE,5,7.5",
        "trial_1,DONE,7,10.5",
        "trial_2,DONE,5,7.5",
    ]


def test_the_whole_row_may_be_returned(config: Callable[..., Path], execute: Callable[..., Executed]) -> None:
    methods = """
    def populate_run_data(self, context):
        variation = context.run_variation
        variation["energy"] = variation["speed"] * 10
        return variation
    """
    executed = execute(config(methods, head=ROBOT))
    assert [row["energy"] for row in executed.table] == ["1.0", "2.0", "1.0", "2.0"]
    assert executed.warnings == []


def test_what_is_written_into_the_row_and_not_returned_counts_too(
    config: Callable[..., Path], execute: Callable[..., Executed]
) -> None:
    executed = execute(config("def launch_mission(self, context): context.run_variation['energy'] = 5", head=ROBOT))
    assert {row["energy"] for row in executed.table} == {"5"}


def test_the_data_of_a_run_are_asked_for_before_it_is_stopped(
    config: Callable[..., Path], execute: Callable[..., Executed]
) -> None:
    methods = """
    def start_run(self, context): self.link = "open"
    def stop_measurement(self, context): print("stop_measurement")
    def stop_run(self, context):
        print("stop_run")
        self.link = "closed"
    def populate_run_data(self, context):
        print("populate_run_data")
        assert self.link == "open"
    """
    executed = execute(config(methods, head=ROBOT))
    assert executed.finished.failures == ()
    assert executed.log("run_0").split() == ["stop_measurement", "populate_run_data", "stop_run"]


def test_a_run_that_failed_is_stopped_and_not_asked_for_data(
    config: Callable[..., Path], execute: Callable[..., Executed]
) -> None:
    methods = """
    def launch_mission(self, context): raise ValueError("fell over")
    def stop_measurement(self, context): print("stop_measurement")
    def stop_run(self, context): print("stop_run")
    def populate_run_data(self, context): print("populate_run_data")
    """
    executed = execute(config(methods, head=ROBOT))
    assert executed.finished.failed_count == 4
    assert {row["__done"] for row in executed.table} == {"TODO"}
    assert "stop_measurement\nstop_run" in executed.log("run_0")
    assert "populate" not in executed.log("run_0")


def test_only_what_is_subscribed_is_called(config: Callable[..., Path], execute: Callable[..., Executed]) -> None:
    table = """\
    def create_run_table(self):
        run_table = RunTableModel([FactorModel("task", ["scan"])])
        run_table.create_experiment_run_table()
        return run_table.get_experiment_run_table()

    def before_experiment(self, context):
        raise AssertionError("nobody subscribed this")

    def drive(self, context):
        print("drive")
"""
    path = config(head=ROBOT, table=table, subscribe="(RobotRunnerEvents.LAUNCH_MISSION, self.drive),")
    executed = execute(path)
    assert executed.log("run_0") == "drive\n"
    assert any("nothing subscribes it to BEFORE_EXPERIMENT" in warning for warning in executed.warnings)


@pytest.mark.parametrize("required", ["any", "None"])
def test_ros_may_be_any_or_none(config: Callable[..., Path], required: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ROS_VERSION", raising=False)
    head = ROBOT.replace("required_ros_version: int = None", f"required_ros_version: int = {required}")
    preparation = prepare(config(head=head))
    if required == "None":
        assert preparation.experiment is not None
    elif preparation.experiment is None:
        assert any("requires ROS" in problem for problem in problems(preparation))


def test_a_required_ros_that_is_missing_refuses_and_the_embedded_robot_needs_none(
    config: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("ROS_VERSION", "ROS_DISTRO"):
        monkeypatch.delenv(name, raising=False)
    head = ROBOT.replace("version: int = None", "version: int = 1").replace(
        "distro: str = None", 'distro: str = "melodic"'
    )
    path = config(head=head)
    assert any("melodic" in problem for problem in problems(prepare(path)))
    assert prepare(path, {"robot": "simulated"}).experiment is not None


def test_a_continue_callback_is_the_wait(config: Callable[..., Path], execute: Callable[..., Executed]) -> None:
    head = ROBOT.replace("OperationType.AUTO", "OperationType.SEMI")
    methods = """
    def before_experiment(self): self.answers = 0
    def swap_battery(self): self.answers += 1
    def populate_run_data(self, context): return {"energy": self.answers}
    """
    path = config(methods, head=head, subscribe="(RobotRunnerEvents.CONTINUE, self.swap_battery),")
    executed = execute(path)
    assert executed.experiment.parameters.operation_type is OperationType.SEMI
    assert [row["energy"] for row in executed.table] == ["0", "1", "2", "3"]


def test_semi_without_a_callback_waits_now_and_says_so(config: Callable[..., Path]) -> None:
    preparation = prepare(config(head=ROBOT.replace("OperationType.AUTO", "OperationType.SEMI")))
    assert any("nothing subscribes to CONTINUE" in str(finding) for finding in preparation.findings)


def test_what_before_run_prints_is_in_the_log_and_a_question_is_seen(
    config: Callable[..., Path],
    execute: Callable[..., Executed],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO("\n" * 4))
    methods = """
    def before_run(self):
        print("place the robot")
        input("ENTER to start ")
        print("off it goes")
    def launch_mission(self, context): print("mission")
    """
    executed = execute(config(methods, head=ROBOT))
    assert executed.log("run_2") == "place the robot\nENTER to start off it goes\nmission\n"
    shown = capsys.readouterr().out
    assert shown == "place the robot\nENTER to start " * 4


def test_results_begin_in_the_current_folder(
    config: Callable[..., Path], execute: Callable[..., Executed], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    head = ROBOT.replace('Path(__file__).parent / "results"', 'Path("./out")')
    assert execute(config(head=head)).folder == elsewhere / "out" / "patrol"


def test_a_name_that_names_a_folder_in_any_way_is_kept(
    config: Callable[..., Path], execute: Callable[..., Executed], tmp_path: Path
) -> None:
    executed = execute(config(head=ROBOT.replace('"patrol"', '"week 3/patrol: (b)"')))
    assert executed.folder == tmp_path / "results" / "week 3" / "patrol: (b)"
    assert executed.experiment.parameters.experiment_name == "patrol_ _b"


BACKBONE = """
from Backbone.Events.Models.RobotRunnerEvents import RobotRunnerEvents
from Backbone.Events.EventSubscriptionController import EventSubscriptionController
from Backbone.ExperimentOutput.Models.ExperimentModel import ExperimentModel
from Backbone.ExperimentOutput.Models.ExperimentFactorModel import ExperimentFactorModel
from Backbone.Config.Models.OperationType import OperationType
from multiprocessing import Event
from pathlib import Path

class RobotRunnerConfig:
    name = "first months"
    required_ros_version = None
    required_ros_distro = None
    operation_type = OperationType.AUTO
    run_duration_in_ms = 0
    time_between_runs_in_ms = 0
    results_output_path = Path(__file__).parent

    def __init__(self):
        EventSubscriptionController.subscribe_to_multiple_events([
            (RobotRunnerEvents.DURING_RUN, self.during_run),
            (RobotRunnerEvents.SIGNAL_SEMI_CONTINUE, self.signal),
        ])

    def create_run_table(self):
        model = ExperimentModel(treatments=[ExperimentFactorModel("task", ["scan", "map"])])
        model.create_experiment_run_table()
        return model.get_experiment_run_table()

    def during_run(self, context, run_completed_event: Event):
        print(context.run_variation["task"])
        run_completed_event.set()

    def signal(self): ...
"""


def test_configs_of_the_first_months_are_executed(write: Callable[..., Path], execute: Callable[..., Executed]) -> None:
    executed = execute(write(BACKBONE))
    assert [executed.log(f"run_{place}") for place in range(2)] == ["scan\n", "map\n"]


def test_static_parameters_can_be_set_from_outside(
    config: Callable[..., Path], execute: Callable[..., Executed]
) -> None:
    settings: dict[str, Any] = {"experiment_name": "other", "attempts": "2", "operation_type": "auto"}
    executed = execute(config(head=ROBOT), None, **settings)
    assert executed.folder.name == "other"
    assert executed.experiment.parameters.attempts == 2
    assert executed.experiment.overrides == settings


def test_an_attribute_that_is_called_like_one_of_our_parameters_means_something_else(
    config: Callable[..., Path],
) -> None:
    head = ROBOT + "    robot = object()\n    attempts = 'many'\n"
    preparation = prepare(config(head=head))
    assert preparation.experiment is not None
    assert preparation.experiment.parameters.robot is None
