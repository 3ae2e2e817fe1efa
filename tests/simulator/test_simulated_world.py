"""The room and the robot's model of each run's treatments, in the embedded simulation."""

from __future__ import annotations

import hashlib
import json
from typing import TYPE_CHECKING, Any

import pytest
from tests.simulator.test_modelled_robot import ROVER

from robot_runner import Factor, RunTableModel
from robot_runner.core.config.plugin_checks import check_plugins
from robot_runner.core.config.preparation import prepare
from robot_runner.core.errors import LinkError
from robot_runner.core.links.connect import connect_robot
from robot_runner.core.treatments import bind
from robot_runner.plugins import Circumstances, treatment
from robot_runner.plugins.systems import BasicTurtlebot3, SimulatedWorld, Simulation
from robot_runner.testing import SystemContract, make_context, rehearse

if TYPE_CHECKING:
    from pathlib import Path

_NEAR = "[[cylinder]]\nat = [0.5, 0.0]\nradius = 0.1\n"
_FAR = "[[cylinder]]\nat = [1.5, 0.0]\nradius = 0.1\n"
_HEAD = """\
from pathlib import Path

from robot_runner import *
from robot_runner.plugins import Measure, System, connect_robot, treatment
from robot_runner.plugins.systems import SimulatedWorld


class Look(System):
    measures = (Measure("Ahead", "m", "How far the obstacle ahead is."),)

    def launch_mission(self, context):
        scan = connect_robot(context).wait_for("scan", "sensor_msgs/LaserScan", timeout=2.0)
        self.ahead = scan["ranges"][0]

    def populate_run_data(self, context):
        context.publish("Ahead", self.ahead)


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    results_output_path = "results"
    robot = "simulated:scan_deviation=0"
    plugins = [SimulatedWorld(treatment("Room"), folder=Path(__file__).parent / "rooms"), Look()]
"""
_TABLE = """\
    def create_run_table(self):
        return RunTableModel([Factor("Room", {rooms})], data_columns=["Ahead"], repetitions=2)
"""


@pytest.fixture
def rooms(tmp_path: Path) -> Path:
    """Return a folder of two rooms and a robot."""
    folder = tmp_path / "rooms"
    folder.mkdir()
    (folder / "near.toml").write_text(_NEAR)
    (folder / "far.toml").write_text(_FAR)
    (folder / "rover.xml").write_text(ROVER)
    return folder


class TestSimulatedWorld(SystemContract):
    """The usual world."""

    def make_plugin(self) -> SimulatedWorld:
        return SimulatedWorld()


@pytest.mark.long
def test_each_run_has_the_room_of_its_treatment(rooms: Path, write_config: Any, robot_runner: Any) -> None:
    config = write_config(head=_HEAD, table=_TABLE.format(rooms=["near.toml", "far.toml"]))
    answer = robot_runner("run", config)
    assert answer.code == 0, answer.out + answer.err
    lines = (config.parent / "results/trial/run_table.csv").read_text().splitlines()
    heading = lines[0].split(",")
    told = [
        (row[heading.index("Room")], float(row[heading.index("Ahead")])) for row in (x.split(",") for x in lines[1:])
    ]
    assert {(room, round(ahead, 1)) for room, ahead in told} == {("near.toml", 0.4), ("far.toml", 1.4)}
    journal = (config.parent / "results/trial/journal.jsonl").read_text()
    assert sum('"near.toml"' in line and "parameters" in line for line in journal.splitlines()) >= 2


def test_all_that_is_wrong_is_found_with_each_treatment_before_any_run(rooms: Path, write_config: Any) -> None:
    (rooms / "odd.toml").write_text("[[cylindr]]\nat = [1, 0]\n")
    table = _TABLE.format(rooms=["near.toml", "odd.toml", "none.toml"])
    odd, none = (str(each) for each in prepare(write_config(head=_HEAD, table=table)).findings if each.is_error)
    assert "with Room = odd.toml: [[cylindr]] is nothing that a room has → Did you mean 'cylinder'?" in odd
    assert "with Room = none.toml: there is no such room" in none
    head = _HEAD.replace('"simulated:scan_deviation=0"', f'"simulated:room={rooms}/far.toml"')
    found = prepare(write_config(head=head, table=_TABLE.format(rooms=["near.toml"]))).findings
    assert "the room is named by the plugin and by robot =" in str(found[0])
    (other,) = SimulatedWorld(rooms / "near.toml").check(Circumstances("dds"))
    assert "nothing is loaded there" in other.problem
    assert not other.is_error
    robot = "simulated:scan_maximum=8,mass=5,real_time_factor=1"
    assert not list(SimulatedWorld(rooms / "near.toml").check(Circumstances(robot)))
    (vain,) = SimulatedWorld(model=rooms / "rover.xml").check(Circumstances(robot))
    assert "mass would have no effect" in vain.problem
    assert not vain.is_error, "another treatment may be a TurtleBot3"


def test_it_is_read_before_the_run_and_before_the_robot_is_made(rooms: Path, tmp_path: Path) -> None:
    world = SimulatedWorld(treatment("Room"), treatment("Model"), folder=rooms)
    combination = {"Room": "near.toml", "Model": "rover.xml"}
    context = make_context(tmp_path, world, combination=combination)
    world.before_run(context)
    for each in rooms.iterdir():
        each.unlink()
    world.start_run(context)  # as in the process that was forked
    assert "/joint_states" in connect_robot(context).topics()
    with pytest.raises(LinkError, match="the robot was made before its room was loaded"):
        world.start_run(context)
    context.resources.close()
    world, robot = SimulatedWorld(rooms / "near.toml"), BasicTurtlebot3()
    wrong = [str(each) for each in world.check(Circumstances("simulated", plugins=(robot, world)))]
    assert "List 'SimulatedWorld' before 'BasicTurtlebot3'" in wrong[0]
    assert "there is no such room" in wrong[1]


@pytest.mark.parametrize(
    ("robot", "plugins"),
    [
        ("model={0}/rover.xml", [{"room": "near.toml"}]),
        ("room={0}/near.toml", [{"model": "rover.xml"}]),
        ("scan_deviation=0", [{"room": "near.toml"}, {"model": "rover.xml"}]),
    ],
)
def test_a_model_stands_in_the_room_that_somebody_else_names(
    rooms: Path, tmp_path: Path, robot: str, plugins: list[dict[str, str]]
) -> None:
    context = make_context(tmp_path, robot=f"simulated:{robot.format(rooms)}")
    for each in plugins:
        SimulatedWorld(**each, folder=rooms).start_run(context)
    scan = connect_robot(context).wait_for("scan", "sensor_msgs/LaserScan", timeout=2.0)
    assert scan["ranges"][0] == pytest.approx(0.4, abs=0.05)
    context.resources.close()


def test_a_simulator_with_bound_parameters_is_not_taken_for_the_last_of_all_plugins() -> None:
    simulation, robot = Simulation(tolerance_m=treatment("Tolerance")), BasicTurtlebot3()
    model = RunTableModel([Factor("Tolerance", [0.05, 0.1]), Factor("Task", ["Video"])])
    bind(simulation, {"Tolerance": 0.05})
    for plugins, is_late in (((simulation, robot), False), ((robot, simulation), True)):
        found = [each.problem for each in check_plugins(plugins, model, "dds")]
        assert any("which is listed before it" in each for each in found) == is_late, found


def test_without_a_room_a_run_is_the_same_to_the_last_digit(tmp_path: Path) -> None:
    digests = []
    for place, plugins in enumerate(([], [SimulatedWorld()])):
        robot = BasicTurtlebot3(drive_s=1.0, sleep_s=0.5, task_s=0.5, rotate_s=3.0, task="Video", task_factor=None)
        context = make_context(tmp_path / str(place), robot, run_seed=7)
        for each in plugins:
            each.start_run(context)
        values = rehearse(context, robot)
        context.resources.close()
        digests.append(hashlib.sha256(json.dumps(dict(values), sort_keys=True, default=str).encode()).hexdigest())
    assert digests[0] == digests[1]
