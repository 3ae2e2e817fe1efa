"""A robot of anybody's, by its MJCF: what is in the model can be driven and heard; what cannot be is said."""

from __future__ import annotations

import math

import pytest

from robot_runner.core.errors import LinkError
from robot_runner.core.links.connect import link_findings
from robot_runner.simulator.embedded_robot import simulation_options
from robot_runner.simulator.simulated_devices import SimulatedHost
from robot_runner.simulator.simulated_link import SimulatedRobotLink

ROVER = """
<mujoco>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <geom type="plane" size="0 0 1"/>
    <geom type="box" pos="2 0 0.5" size="0.1 1 0.5"/>
    <body name="base" pos="0 0 0.1">
      <freejoint/>
      <inertial pos="-0.05 0 0" mass="2" diaginertia="0.02 0.02 0.02"/>
      <geom type="box" size="0.15 0.1 0.05" contype="0" conaffinity="0"/>
      <geom type="sphere" size="0.02" pos="-0.13 0 -0.08" friction="0.001" condim="1" priority="1"/>
      <site name="lidar" pos="0 0 0.15"/>
      <site name="imu"/>
      <camera name="front" pos="0.15 0 0.1" xyaxes="0 -1 0 0 0 1" fovy="60"/>
      <body pos="0 0.15 0">
        <joint name="left_wheel" axis="0 1 0"/>
        <geom type="sphere" size="0.1" mass="0.1"/>
      </body>
      <body pos="0 -0.15 0">
        <joint name="right_wheel" axis="0 1 0"/>
        <geom type="sphere" size="0.1" mass="0.1"/>
      </body>
    </body>
  </worldbody>
  <actuator><velocity joint="left_wheel" kv="1"/><velocity joint="right_wheel" kv="1"/></actuator>
  <sensor><gyro site="imu"/><accelerometer site="imu"/></sensor>
</mujoco>
"""
ARM = """
<mujoco>
  <worldbody>
    <body>
      <joint name="shoulder" axis="0 0 1" damping="1"/>
      <geom type="capsule" size="0.02" fromto="0 0 0 0.3 0 0"/>
      <body pos="0.3 0 0">
        <joint name="elbow" axis="0 0 1" damping="1"/>
        <geom type="capsule" size="0.02" fromto="0 0 0 0.3 0 0"/>
      </body>
    </body>
  </worldbody>
  <actuator><position joint="shoulder" kp="20"/><velocity joint="elbow" kv="5"/></actuator>
</mujoco>
"""
TWIST = "geometry_msgs/Twist"


@pytest.fixture
def simulate(tmp_path):
    begun = []

    def make(text, **options):
        path = tmp_path / "robot.xml"
        path.write_text(text, "utf-8")
        begun.append(simulation_options({"model": str(path), **options}).simulation(seed=1))
        return begun[-1], SimulatedRobotLink(begun[-1])

    yield make
    for each in begun:
        each.close()


def test_a_model_with_two_wheels_drives_as_it_is_commanded(simulate):
    simulation, link = simulate(ROVER, scan_deviation="0")
    assert set(link.topics()) >= {
        *("/joint_states", "/odom", "/ground_truth", "/scan", "/imu", "/cmd_vel", "/joint_commands")
    }
    heard = {topic: [] for topic in ("odom", "ground_truth", "scan", "imu")}
    for topic, messages in heard.items():
        link.subscribe(topic, link.topics()[f"/{topic}"], messages.append)
    link.publish("cmd_vel", TWIST, {"linear": {"x": 0.3}})
    simulation.clock.sleep(3.0)
    by_wheels, truly = (heard[topic][-1]["pose"]["pose"]["position"]["x"] for topic in ("odom", "ground_truth"))
    assert truly == pytest.approx(0.9, abs=0.05)
    assert by_wheels == pytest.approx(truly, abs=0.02)
    assert heard["scan"][-1]["ranges"][0] == pytest.approx(1.9 - truly, abs=0.05)
    assert heard["scan"][-1]["ranges"][180] == math.inf
    assert heard["imu"][-1]["linear_acceleration"]["z"] == pytest.approx(9.81, abs=0.3)
    link.publish("cmd_vel", TWIST, {"angular": {"z": 0.5}})
    simulation.clock.sleep(2.0)
    assert heard["odom"][-1]["twist"]["twist"]["angular"]["z"] == pytest.approx(0.5, abs=0.05)
    simulation.robot().put_back()
    simulation.clock.sleep(0.1)
    assert heard["ground_truth"][-1]["pose"]["pose"]["position"]["x"] == pytest.approx(0.0, abs=0.02)
    assert heard["odom"][-1]["pose"]["pose"]["position"]["x"] == pytest.approx(0.0, abs=0.02)


def test_the_joints_of_an_arm_take_what_their_actuators_take(simulate):
    simulation, link = simulate(ARM)
    assert set(link.topics()) == {"/joint_states", "/joint_commands"}
    states = []
    link.subscribe("joint_states", "sensor_msgs/JointState", states.append)
    commands = {"name": ["elbow", "shoulder"], "position": [0.0, 0.8], "velocity": [0.5, 0.0]}
    link.publish("joint_commands", "sensor_msgs/JointState", commands)
    simulation.clock.sleep(2.0)
    state = states[-1]
    assert state["name"] == ["shoulder", "elbow"]
    assert state["position"][0] == pytest.approx(0.8, abs=0.05)
    assert state["velocity"][1] > 0.2
    with pytest.raises(LinkError, match="'elbo' is no joint") as raised:
        link.publish("joint_commands", "sensor_msgs/JointState", {"name": ["elbo"], "position": [1.0]})
    assert "elbow" in raised.value.fix
    with pytest.raises(LinkError, match="driven by its velocity, and none is given"):
        link.publish("joint_commands", "sensor_msgs/JointState", {"name": ["elbow"], "position": [1.0]})


def test_obstacles_of_a_room_stand_around_a_model(simulate, tmp_path):
    room = tmp_path / "room.toml"
    room.write_text("[[cylinder]]\nat = [1.0, 0.0]\nradius = 0.1\n[[box]]\nat = [0, 2]\nsize = [1, 1]", "utf-8")
    simulation, link = simulate(ROVER, room=str(room), scan_deviation="0")
    scans = []
    link.subscribe("scan", "sensor_msgs/LaserScan", scans.append)
    simulation.clock.sleep(0.5)
    assert scans[-1]["ranges"][0] == pytest.approx(0.9, abs=0.02)
    assert scans[-1]["ranges"][90] == pytest.approx(1.5, abs=0.02)


def test_a_model_has_no_power_meter_and_no_computer(simulate):
    simulation, _ = simulate(ROVER)
    with pytest.raises(LinkError, match="no power meter and no on-board computer"):
        SimulatedHost(simulation)


@pytest.mark.parametrize(
    ("text", "options", "problem"),
    [
        ("<mujoco", {}, "MuJoCo does not take the model"),
        (ROVER[: ROVER.index("<actuator>")] + "</mujoco>", {}, "no actuator that drives"),
        (ROVER, {"left": "lef_wheel", "right": "right_wheel"}, "left='lef_wheel' is no joint"),
        (ROVER.replace('pos="0 -0.15 0"', 'pos="0 0.15 0"'), {}, "are 0 m apart"),
    ],
)
def test_a_model_that_cannot_be_driven_is_a_finding(tmp_path, text, options, problem):
    path = tmp_path / "robot.xml"
    path.write_text(text, "utf-8")
    name = "simulated:" + ",".join(f"{key}={value}" for key, value in {"model": path, **options}.items())
    (finding,) = link_findings(name)
    assert problem in finding.problem
    assert finding.fix
    (missing,) = link_findings(f"simulated:model={tmp_path / 'none.xml'}")
    assert "no such model" in missing.problem
    (vain,) = link_findings("simulated:left=a")
    assert "no model is named" in vain.problem
