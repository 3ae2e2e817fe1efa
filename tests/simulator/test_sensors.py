"""The messages that the robot publishes."""

from __future__ import annotations

import math

import numpy as np
import pytest

from robot_runner.simulator.rooms import ARENA, Room, Wall, ray_distances
from robot_runner.simulator.simulated_turtlebot3 import Simulation
from robot_runner.simulator.turtlebot3_parameters import Turtlebot3Parameters

#: The fields of each type, as the ROS definitions have them.
FIELDS = {
    "nav_msgs/Odometry": {"header", "child_frame_id", "pose", "twist"},
    "sensor_msgs/Imu": {
        "header",
        "orientation",
        "orientation_covariance",
        "angular_velocity",
        "angular_velocity_covariance",
        "linear_acceleration",
        "linear_acceleration_covariance",
    },
    "sensor_msgs/LaserScan": {
        "header",
        "angle_min",
        "angle_max",
        "angle_increment",
        "time_increment",
        "scan_time",
        "range_min",
        "range_max",
        "ranges",
        "intensities",
    },
    "sensor_msgs/BatteryState": {
        "header",
        "voltage",
        "temperature",
        "current",
        "charge",
        "capacity",
        "design_capacity",
        "percentage",
        "power_supply_status",
        "power_supply_health",
        "power_supply_technology",
        "present",
        "cell_voltage",
        "cell_temperature",
        "location",
        "serial_number",
    },
    "sensor_msgs/JointState": {"header", "name", "position", "velocity", "effort"},
}
TOPICS = ("odom", "imu", "scan", "battery_state", "joint_states")


def heard(topic, *, seconds=1.0, seed=1, drive=(0.0, 0.0), parameters=None):
    simulation = Simulation(seed, parameters=parameters)
    robot = simulation.turtlebot3()
    robot.drive(*drive)
    messages = []
    robot.topics[topic].listen(messages.append)
    simulation.clock.sleep(seconds)
    return messages


def plain(value):
    if isinstance(value, dict):
        return all(isinstance(key, str) and plain(one) for key, one in value.items())
    if isinstance(value, list):
        return all(map(plain, value))
    return type(value) in {bool, int, float, str}


@pytest.mark.parametrize("topic", TOPICS)
def test_a_message_has_all_fields_of_its_type_and_plain_values(topic):
    robot = Simulation(seed=1).turtlebot3()
    message = heard(topic)[0]
    assert set(message) == FIELDS[robot.topics[topic].message_type]
    assert set(message["header"]) == {"stamp", "frame_id"}
    assert plain(message)


@pytest.mark.parametrize(
    ("topic", "rate"), [("odom", 30), ("imu", 200), ("scan", 5), ("battery_state", 30), ("joint_states", 30)]
)
def test_a_topic_comes_at_its_rate_and_stamped_with_the_simulation_s_time(topic, rate):
    messages = heard(topic, seconds=2.0)
    stamps = [one["header"]["stamp"]["sec"] + one["header"]["stamp"]["nanosec"] / 1e9 for one in messages]
    assert len(messages) == 2 * rate
    assert stamps[-1] == 2.0
    assert np.diff(stamps) == pytest.approx(1 / rate, abs=0.005)


@pytest.mark.parametrize("topic", TOPICS)
def test_the_same_seed_gives_the_same_messages(topic):
    assert repr(heard(topic, seed=5, drive=(0.1, 0.3))) == repr(heard(topic, seed=5, drive=(0.1, 0.3)))


@pytest.mark.parametrize("topic", TOPICS)
def test_another_seed_gives_other_messages(topic):
    assert repr(heard(topic, seed=5, drive=(0.1, 0.3))) != repr(heard(topic, seed=6, drive=(0.1, 0.3)))


def test_odometry_says_where_the_robot_is_and_how_fast():
    message = heard("odom", seconds=5.0, drive=(0.2, 0.0))[-1]
    assert message["pose"]["pose"]["position"]["x"] == pytest.approx(1.0 - 0.02, abs=0.01)
    assert message["pose"]["pose"]["orientation"]["w"] == pytest.approx(1.0, abs=0.001)
    assert message["twist"]["twist"]["linear"]["x"] == pytest.approx(0.2, abs=0.005)
    assert len(message["pose"]["covariance"]) == len(message["twist"]["covariance"]) == 36


def test_an_imu_feels_turning_and_gravity():
    messages = heard("imu", seconds=5.0, drive=(0.0, 1.0))[400:]
    turning = [message["angular_velocity"]["z"] for message in messages]
    assert np.mean(turning) == pytest.approx(1.0, abs=0.01)
    assert np.std(turning) == pytest.approx(0.0017, rel=0.3)
    assert np.mean([message["linear_acceleration"]["z"] for message in messages]) == pytest.approx(9.81, abs=0.05)


def test_a_scan_agrees_with_the_walls():
    simulation = Simulation(seed=1, parameters=Turtlebot3Parameters(scan_deviation=0))
    scans = []
    robot = simulation.turtlebot3()
    robot.topics["scan"].listen(scans.append)
    simulation.clock.sleep(0.2)
    ranges = scans[0]["ranges"]
    # The scanner sits 32 mm behind the axle; the walls' inner sides are at 4.0, 2.0, -1.5 and -2.0 m.
    assert ranges[0] == math.inf  # 4.032 m away: out of range
    assert ranges[90] == pytest.approx(2.0, abs=0.002)
    assert ranges[180] == pytest.approx(1.5 - 0.032, abs=0.002)
    assert ranges[270] == pytest.approx(2.0, abs=0.002)
    assert ranges[310] == pytest.approx(1.05 / math.sin(math.radians(50)), abs=0.02)  # the pillar's near side
    assert len(ranges) == 360
    assert scans[0]["angle_increment"] * 360 == pytest.approx(2 * math.pi)


def test_a_scan_turns_with_the_robot():
    simulation = Simulation(seed=1, parameters=Turtlebot3Parameters(scan_deviation=0))
    robot = simulation.turtlebot3()
    scans = []
    robot.topics["scan"].listen(scans.append)
    robot.drive(0.1, 0.7)
    simulation.clock.sleep(3.0)
    pose = robot.pose
    x, y = pose.x - 0.032 * math.cos(pose.yaw), pose.y - 0.032 * math.sin(pose.yaw)
    angles = pose.yaw + np.radians(np.arange(360.0))
    true = ray_distances(ARENA, x, y, angles)
    expected = np.where(true <= 3.5, true, np.inf)
    assert scans[-1]["ranges"] == pytest.approx(expected.tolist(), abs=1e-6)


def test_a_scan_has_noise_in_proportion_to_the_distance():
    scans = np.array([message["ranges"] for message in heard("scan", seconds=40.0)])
    deviation = scans[:, 90].std() / scans[:, 90].mean()
    assert deviation == pytest.approx(0.012, rel=0.2)


def test_joint_states_name_both_wheels():
    message = heard("joint_states", seconds=3.0, drive=(0.1, 0.0))[-1]
    assert message["name"] == ["wheel_left_joint", "wheel_right_joint"]
    assert message["velocity"] == pytest.approx([0.1 / 0.033] * 2, rel=0.01)


def test_nothing_is_computed_for_topics_that_nobody_hears():
    simulation = Simulation(seed=1)
    robot = simulation.turtlebot3()
    robot.drive(0.2, 0.0)
    simulation.clock.sleep(20)
    assert robot._drive.steps == 0
    assert len(robot._supply.power) == 0


def test_only_what_is_heard_is_computed(monkeypatch):
    calls = []
    monkeypatch.setattr(
        "robot_runner.simulator.sensors.ray_distances",
        lambda walls, x, y, angles: calls.append(x) or ray_distances(walls, x, y, angles),
    )
    simulation = Simulation(seed=1)
    robot = simulation.turtlebot3()
    robot.topics["odom"].listen(lambda message: None)
    simulation.clock.sleep(2)
    assert calls == []
    listening = robot.topics["scan"].listen(lambda message: None)
    simulation.clock.sleep(1)
    assert len(calls) == 5
    listening.close()
    simulation.clock.sleep(1)
    assert len(calls) == 5


def test_what_is_too_near_to_be_measured_is_not_told_as_free_space():
    parameters = Turtlebot3Parameters(scan_deviation=0)
    simulation = Simulation(seed=1, parameters=parameters, room=Room((Wall(0.3, 0.0, 0.05, 1.0),)))
    robot = simulation.turtlebot3()
    robot.drive(0.2, 0.0)
    simulation.clock.sleep(5.0)
    ranges = robot.topics["scan"].latest()["ranges"]
    assert ranges[0] == -math.inf  # REP 117
    assert ranges[180] == math.inf
    assert min(each for each in ranges if each > -math.inf) >= 0.12


def test_the_imu_tells_the_same_whenever_somebody_subscribes_it():
    simulation, later = Simulation(seed=1), []
    robot = simulation.turtlebot3()
    robot.drive(0.1, 1.0)
    simulation.clock.sleep(0.5)
    robot.topics["imu"].listen(later.append)
    simulation.clock.sleep(0.5)
    assert later == heard("imu", drive=(0.1, 1.0))[100:]


def test_the_imu_tells_of_this_moment_without_a_subscriber():
    simulation = Simulation(seed=1)
    robot = simulation.turtlebot3()
    robot.drive(0.0, 1.0)
    simulation.clock.sleep(1.0)
    message = robot.topics["imu"].latest()
    assert message["linear_acceleration"]["z"] == pytest.approx(9.81, abs=0.3)
    assert message["angular_velocity"]["z"] == pytest.approx(1.0, abs=0.05)
