"""The robot as a whole: services, truth, namespaces, determinism."""

from __future__ import annotations

import math

import pytest

from robot_runner.core.errors import LinkError
from robot_runner.simulator.onboard import Task
from robot_runner.simulator.simulated_turtlebot3 import SERVICES, Simulation
from robot_runner.simulator.turtlebot3_parameters import Turtlebot3Parameters


@pytest.fixture
def simulation():
    return Simulation(seed=1)


@pytest.fixture
def robot(simulation):
    return simulation.turtlebot3()


@pytest.mark.parametrize("task", list(Task))
def test_a_task_is_started_and_stopped(robot, task):
    assert robot.call(f"task/{task.value}/start") == {"success": True, "message": f"{task.value} started"}
    assert robot.running_task is task
    assert robot.call(f"task/{task.value}/stop") == {"success": True, "message": f"{task.value} stopped"}
    assert robot.running_task is None


def test_starting_a_task_while_one_runs_answers_no(robot):
    robot.call("task/video/start")
    assert robot.call("task/network/start") == {"success": False, "message": "video is running already"}
    assert robot.call("task/video/start")["success"] is False
    assert robot.running_task is Task.VIDEO


def test_stopping_another_task_than_the_running_one_answers_no(robot):
    robot.call("task/video/start")
    assert robot.call("task/network/stop") == {"success": False, "message": "network is not running"}
    assert robot.running_task is Task.VIDEO


def test_task_stop_stops_whatever_runs(robot):
    robot.call("task/network/start")
    assert robot.call("task/stop") == {"success": True, "message": "network stopped"}
    assert robot.call("task/stop") == {"success": True, "message": "nothing was running"}


def test_there_is_a_service_to_start_and_to_stop_each_task():
    assert len(SERVICES) == 2 * len(Task) + 1
    assert set(SERVICES.values()) == {"std_srvs/Trigger"}


def test_the_last_velocity_is_kept(simulation, robot):
    robot.drive(0.1, 0.0)
    simulation.clock.sleep(2)
    assert robot.is_moving
    simulation.clock.sleep(18)
    assert robot.is_moving
    assert robot.pose.x == pytest.approx(2.0, abs=0.02)
    robot.drive(0.0, 0.0)
    simulation.clock.sleep(1)
    assert not robot.is_moving


def test_robots_share_the_clock_and_nothing_else(simulation):
    alice, bob = simulation.turtlebot3("alice"), simulation.turtlebot3("/bob/")
    alice.drive(0.2, 0.0)
    simulation.clock.sleep(5)
    assert alice.pose.x > 0.9
    assert math.hypot(bob.pose.x, bob.pose.y) < 1e-4
    assert (alice.namespace, bob.namespace) == ("/alice", "/bob")
    assert alice.energy != bob.energy


def test_a_robot_does_not_depend_on_the_others():
    def energy(*namespaces):
        simulation = Simulation(seed=9)
        robots = [simulation.turtlebot3(namespace) for namespace in namespaces]
        simulation.clock.sleep(3)
        return robots[-1].energy

    assert energy("alice") == energy("bob", "", "alice")


def test_a_namespace_is_one_robot_however_it_is_written(simulation):
    assert simulation.turtlebot3("alice") is simulation.turtlebot3("/alice/")
    assert simulation.turtlebot3() is simulation.turtlebot3("/")


def journey(seed):
    simulation = Simulation(seed)
    robot = simulation.turtlebot3()
    meter = robot.open_power_meter()
    odometry = []
    robot.topics["odom"].listen(odometry.append)
    for linear, angular in ((0.2, 0.0), (0.0, 1.0), (0.1, -0.4), (0.0, 0.0)):
        robot.drive(linear, angular)
        simulation.clock.sleep(1.5)
    return robot.pose, odometry, [arrival.data for arrival in meter.arrived()]


def test_the_same_seed_is_the_same_run_byte_for_byte():
    assert journey(42) == journey(42)


def test_another_seed_is_another_run():
    pose, odometry, data = journey(42)
    other_pose, other_odometry, other_data = journey(43)
    assert pose != other_pose
    assert odometry != other_odometry
    assert data != other_data


def test_any_whole_number_is_a_seed():
    assert Simulation(-1).turtlebot3().energy != Simulation(2**80 + 1).turtlebot3().energy


def test_what_is_commanded_takes_effect_after_it_was_commanded():
    def energy(*, look):
        simulation = Simulation(seed=1)
        robot = simulation.turtlebot3()
        simulation.clock.sleep(1.0)
        if look:
            assert robot.energy > 0
        robot.call("task/video/start")
        robot.drive(0.2, 0.0)
        simulation.clock.sleep(1.0)
        return robot.energy

    assert energy(look=True) == energy(look=False)


def drive_for_three_seconds(simulation, robot):
    robot.drive(0.2, 0.1)
    simulation.clock.sleep(3.0)
    robot.drive(0.0, 0.0)


def test_physics_that_diverges_is_said():
    simulation = Simulation(seed=1, parameters=Turtlebot3Parameters(floor_friction=1e-9))  # in each release of MuJoCo
    robot = simulation.turtlebot3()
    with pytest.raises(LinkError, match="the physics of the simulated robot diverged"):
        drive_for_three_seconds(simulation, robot)


def test_a_velocity_that_is_no_number_is_refused(robot):
    with pytest.raises(LinkError, match="nan m/s"):
        robot.drive(math.nan, 0.0)
    with pytest.raises(LinkError, match="nan rad/s"):
        robot.drive(0.1, math.nan)
    robot.drive(math.inf, 0.0)  # as fast as it can


def test_a_closed_simulation_makes_no_robots(simulation):
    simulation.close()
    simulation.close()
    with pytest.raises(LinkError, match="closed"):
        simulation.turtlebot3()
    simulation.clock.sleep(1)
    assert simulation.clock.now() == 1.0
