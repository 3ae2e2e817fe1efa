"""A robot of anybody's, by its MJCF: what is in the model can be driven and heard; what cannot be is said."""

from __future__ import annotations

import math
from contextlib import nullcontext

import mujoco
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
    with pytest.raises(LinkError, match="'elbo' is not a joint") as raised:
        link.publish("joint_commands", "sensor_msgs/JointState", {"name": ["elbo"], "position": [1.0]})
    assert "elbow" in raised.value.fix
    with pytest.raises(LinkError, match="driven by its velocity, and none is given"):
        link.publish("joint_commands", "sensor_msgs/JointState", {"name": ["elbow"], "position": [1.0]})


def test_a_command_with_a_fault_moves_no_joint(simulate):
    simulation, link = simulate(ARM)
    for wrong, problem in (
        ({"position": [0.8]}, "position has 1 value for 0 names"),
        ({"name": ["shoulder"], "position": [0.8, 0.1]}, "position has 2 values for 1 name"),
        ({"name": ["shoulder", "elbo"], "position": [0.8, 0.1]}, "'elbo' is not a joint"),
    ):
        with pytest.raises(LinkError, match=problem):
            link.publish("joint_commands", "sensor_msgs/JointState", wrong)
    assert last(simulation, link, "joint_states")["position"][0] == pytest.approx(0.0, abs=0.01)


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
        (ROVER, {"left": "lef_wheel", "right": "right_wheel"}, "left='lef_wheel' is not a joint"),
        (ROVER.replace('pos="0 -0.15 0"', 'pos="0 0.15 0"'), {}, "are 0 m apart"),
        (ROVER, {"mass": "5", "floor_slope": "20"}, "floor_slope and mass would have no effect"),
        *(
            (
                ROVER.replace("<worldbody>", f'<option timestep="{step}"/><worldbody>', 1),
                {},
                "the time step of the model is",
            )
            for step in ("0", "nan", "-0.002", "1e-12")
        ),
    ],
)
def test_a_model_that_cannot_be_driven_is_a_finding(tmp_path, text, options, problem):
    path = tmp_path / "robot.xml"
    path.write_text(text, "utf-8")
    name = "simulated:" + ",".join(f"{key}={value}" for key, value in {"model": path, **options}.items())
    (finding,) = link_findings(name)
    assert problem in finding.problem
    assert finding.fix
    assert finding.is_error
    (missing,) = link_findings(f"simulated:model={tmp_path / 'none.xml'}")
    assert "no such model" in missing.problem
    assert link_findings(f"simulated:model={path},scan_maximum=8") == [] or text != ROVER
    (vain,) = link_findings("simulated:left=a")
    assert "no model is named" in vain.problem


def last(simulation, link, topic, *, after=2.0):
    heard = []
    subscription = link.subscribe(topic, link.topics()[f"/{topic}"], heard.append)
    simulation.clock.sleep(after)
    subscription.close()
    return heard[-1]


@pytest.mark.parametrize(
    ("was", "instead"),
    [
        ('joint name="right_wheel" axis="0 1 0"', 'joint name="right_wheel" axis="0 -1 0"'),
        ('axis="0 1 0"', 'axis="0 -1 0"'),
        ('kv="1"/>', 'kv="0.1" gear="3"/>'),
        ('<velocity joint="left_wheel" kv="1"/>', '<intvelocity joint="left_wheel" kp="20" actrange="-99 99"/>'),
    ],
)
def test_axes_and_gears_of_wheels_change_nothing_about_how_a_model_drives(simulate, was, instead):
    simulation, link = simulate(ROVER.replace(was, instead))
    link.publish("cmd_vel", TWIST, {"linear": {"x": 0.3}})
    truth = last(simulation, link, "ground_truth")
    assert truth["pose"]["pose"]["position"]["x"] == pytest.approx(0.6, abs=0.06)
    odom = last(simulation, link, "odom", after=0.1)
    assert odom["pose"]["pose"]["position"]["x"] == pytest.approx(0.63, abs=0.06)


def test_what_drives_a_joint_over_a_gear_takes_what_is_meant_at_the_joint(simulate):
    geared = '<position joint="shoulder" kp="2" gear="4"/><motor joint="elbow" gear="50"/>'
    simulation, link = simulate(ARM[: ARM.index("<position")] + geared + "</actuator></mujoco>")
    named = {"name": ["shoulder", "elbow"]}
    link.publish("joint_commands", "sensor_msgs/JointState", {**named, "position": [0.8, 0.0], "effort": [0.0, 0.5]})
    state = last(simulation, link, "joint_states", after=3.0)
    assert state["position"][0] == pytest.approx(0.8, abs=0.1)
    assert state["velocity"][1] == pytest.approx(0.5, abs=0.1)  # 0.5 N m against a damping of 1 N m s/rad


@pytest.mark.skipif(not hasattr(mujoco.MjModel, "actuator_ctrlnum"), reason="actuators take one value each")
def test_an_actuator_that_takes_several_values_moves_none_of_the_others(simulate):
    # Since MuJoCo 4 a DC motor may take a position and a speed: what it is given counts among the values of all.
    motor = '<dcmotor joint="shoulder" motorconst="1" resistance="1" input="pos vel" controller="10 0 5"/>'
    simulation, link = simulate(f'{ARM[: ARM.index("<position")]}{motor}<motor joint="elbow"/></actuator></mujoco>')
    link.publish("joint_commands", "sensor_msgs/JointState", {"name": ["elbow"], "effort": [0.5]})
    state = last(simulation, link, "joint_states", after=3.0)
    assert state["velocity"][1] == pytest.approx(0.5, abs=0.1)
    with pytest.raises(LinkError, match="'shoulder' is not a joint of the model that is driven"):
        link.publish("joint_commands", "sensor_msgs/JointState", {"name": ["shoulder"], "effort": [0.5]})


def test_a_muscle_takes_no_position_whatever_its_numbers_are(simulate):
    muscle = '<muscle joint="elbow" lengthrange="-3 3"/>'
    _, link = simulate(f"{ARM[: ARM.index('<position')]}{muscle}</actuator></mujoco>")
    with pytest.raises(LinkError, match="'elbow' is driven by its effort, and none is given"):
        link.publish("joint_commands", "sensor_msgs/JointState", {"name": ["elbow"], "position": [0.5]})


def test_the_ground_truth_is_the_pose_and_the_motion_of_the_robot_itself(simulate):
    ball = '<body pos="-3 -3 0.1"><freejoint/><geom type="sphere" size="0.1"/></body><body name="base"'
    simulation, link = simulate(ROVER.replace('<body name="base"', ball))
    link.publish("cmd_vel", TWIST, {"angular": {"z": 0.5}})
    simulation.clock.sleep(2.0)
    link.publish("cmd_vel", TWIST, {"linear": {"x": 0.3}, "angular": {"z": 0.5}})
    truth = last(simulation, link, "ground_truth")
    twist = truth["twist"]["twist"]
    assert twist["linear"]["x"] == pytest.approx(0.3, abs=0.03)
    assert twist["linear"]["y"] == pytest.approx(0.0, abs=0.03)
    assert twist["angular"]["z"] == pytest.approx(0.5, abs=0.05)
    assert 0 < truth["pose"]["pose"]["position"]["x"] < 1


def test_the_orientation_of_an_inertial_sensor_is_that_of_where_it_is_mounted(simulate):
    sensors = '<sensor><gyro site="hand"/><accelerometer site="hand"/></sensor></mujoco>'
    on_the_arm = ARM.replace('<joint name="elbow"', '<site name="hand" euler="90 0 0"/><joint name="elbow"')
    simulation, link = simulate(on_the_arm.replace("</mujoco>", sensors))
    imu = last(simulation, link, "imu", after=0.1)
    assert imu["linear_acceleration"]["y"] == pytest.approx(9.81, abs=0.5)
    assert imu["orientation"]["x"] == pytest.approx(math.sqrt(0.5), abs=0.01)
    assert imu["orientation"]["w"] == pytest.approx(math.sqrt(0.5), abs=0.01)


def test_physics_that_diverges_is_said_and_leaves_no_log_in_the_working_directory(
    simulate, tmp_path, monkeypatch, caplog
):
    monkeypatch.chdir(tmp_path)
    unstable = ROVER.replace(' integrator="implicitfast"', "").replace('kv="1"', 'kv="1000"')
    simulation, link = simulate(unstable)
    link.publish("cmd_vel", TWIST, {"linear": {"x": 0.3}})
    with pytest.raises(LinkError, match="diverged"):
        last(simulation, link, "odom", after=5.0)
    assert "unstable" in caplog.text
    assert not (tmp_path / "MUJOCO_LOG.TXT").exists()


@pytest.mark.parametrize(
    ("kilobytes", "problem"),  # MuJoCo before 4 takes the model with 20, and leaves out contacts
    [(60, "some had no effect"), (20, "does not take the model|some had no effect"), (1000, None)],
)
def test_contacts_for_which_there_is_no_memory_are_not_left_out_in_silence(simulate, kilobytes, problem):
    boxes = "".join(
        f'<body pos="{3 + each / 20} 3 0.05"><freejoint/><geom type="box" size="0.1 0.1 0.1"/></body>'
        for each in range(10)
    )
    crowded = ROVER.replace("<worldbody>", f'<size memory="{kilobytes}K"/><worldbody>{boxes}')
    with pytest.raises(LinkError, match=problem) if problem else nullcontext():
        simulation, link = simulate(crowded)
        last(simulation, link, "odom", after=0.1)


@pytest.mark.parametrize("value", [math.nan, 1e12])
def test_a_command_that_is_no_number_or_too_large_for_the_physics_is_refused(simulate, value):
    simulation, link = simulate(ROVER)
    link.publish("cmd_vel", TWIST, {"linear": {"x": 0.3}})
    simulation.clock.sleep(1.0)
    robot = simulation.robot()
    with pytest.raises(LinkError, match=r"'left_wheel' would be driven by"):
        robot.command("cmd_vel", {"linear": {"x": value}, "angular": {"z": 0.0}})
    with pytest.raises(LinkError, match=r"'right_wheel' would be driven by"):
        robot.command("joint_commands", {"name": ["right_wheel"], "position": [], "velocity": [value], "effort": []})
    assert last(simulation, link, "odom", after=0.5)["twist"]["twist"]["linear"]["x"] == pytest.approx(0.3, abs=0.03)


def test_a_model_starts_where_its_room_says(simulate, tmp_path):
    room = tmp_path / "room.toml"
    room.write_text("[[robot]]\nat = [1.0, 2.0]\nyaw = 1.5707963", "utf-8")
    simulation, link = simulate(ROVER, room=str(room))
    link.publish("cmd_vel", TWIST, {"linear": {"x": 0.3}})
    for _ in range(2):
        begun = last(simulation, link, "ground_truth", after=0.05)["pose"]["pose"]["position"]
        assert (begun["x"], begun["y"]) == pytest.approx((1.0, 2.0), abs=0.03)
        link.publish("cmd_vel", TWIST, {"linear": {"x": 0.3}})
        driven = last(simulation, link, "ground_truth")["pose"]["pose"]["position"]
        assert (driven["x"], driven["y"]) == pytest.approx((1.0, 2.6), abs=0.06)
        simulation.robot().put_back()


def test_the_radius_of_an_ellipsoid_is_not_its_width(simulate):
    flat = ROVER.replace('type="sphere" size="0.1"', 'type="ellipsoid" size="0.1 0.02 0.1"')
    thin = ROVER.replace('type="sphere" size="0.1"', 'type="ellipsoid" euler="0 0 90" size="0.02 0.1 0.1"')
    speeds = []
    for model in (flat, thin):
        simulation, link = simulate(model)
        link.publish("cmd_vel", TWIST, {"linear": {"x": 0.3}})
        speeds.append(last(simulation, link, "odom")["twist"]["twist"]["linear"]["x"])
        assert last(simulation, link, "joint_states", after=0.1)["velocity"][0] == pytest.approx(3.0, abs=0.2)
    assert speeds == pytest.approx([0.3, 0.3], abs=0.03)


def test_a_scanner_sees_past_the_parts_of_its_own_robot(simulate):
    mast = '<body pos="0.3 0 0.15"><geom type="box" size="0.02 0.02 0.1" mass="0.01"/></body><site name="lidar"'
    simulation, link = simulate(ROVER.replace('<site name="lidar"', mast), scan_deviation="0")
    scan = last(simulation, link, "scan", after=0.5)
    assert scan["ranges"][0] == pytest.approx(1.9, abs=0.02)


def test_a_scanner_that_stands_in_the_world_sees_what_stands_there(simulate, tmp_path):
    room = tmp_path / "room.toml"
    room.write_text("[[cylinder]]\nat = [1.0, 0.0]\nradius = 0.1", "utf-8")
    fixed = ARM.replace("<worldbody>", '<worldbody><site name="scan" pos="0 0 0.3"/>')
    simulation, link = simulate(fixed, room=str(room), scan_deviation="0")
    assert last(simulation, link, "scan", after=0.5)["ranges"][0] == pytest.approx(0.9, abs=0.01)
