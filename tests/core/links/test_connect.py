"""Links are opened by the name of the robot, once a run, and never silently on another robot."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

from robot_runner.core.errors import LinkError
from robot_runner.core.events.context import RobotRunnerContext, SystemClock
from robot_runner.core.events.resources import Resources
from robot_runner.core.links.connect import connect_robot, link_findings, open_clock
from robot_runner.core.links.kinds import installed_links, link_kind
from robot_runner.measuring.devices import connect_host, open_serial_line
from robot_runner.measuring.local_host import LocalHost
from robot_runner.measuring.ssh_host import SshHost
from robot_runner.simulator.simulated_clock import SimulatedClock


@pytest.fixture
def resources():
    opened = Resources()
    yield opened
    opened.close()


@pytest.fixture
def context(resources, tmp_path):
    return context_of("simulated", resources, tmp_path)


def context_of(robot, resources, folder=Path()):
    return RobotRunnerContext(
        experiment_name="test",
        experiment_folder=folder,
        robot=robot,
        run_id="r_1",
        run_number=1,
        run_count=1,
        attempt=1,
        combination={},
        repetition=1,
        run_seed=5,
        run_path=folder,
        clock=open_clock(robot if robot == "simulated" else None, resources, 5),
        resources=resources,
        owner="test",
        times=None,
        broker=None,
        hosts=None,
    )


CONNECTIONS = (
    connect_robot,
    lambda context: open_serial_line(context, None),
    lambda context: connect_host(context, None),
)


def test_without_a_robot_the_clock_is_the_machine_s(resources):
    assert isinstance(open_clock(None, resources, 1), SystemClock)


def test_a_simulated_robot_has_the_simulation_s_clock(resources):
    clock = open_clock("simulated", resources, 1)
    assert isinstance(clock, SimulatedClock)
    assert open_clock("simulated", resources, 1) is clock


def test_links_of_a_run_live_by_the_run_s_clock(context):
    heard = []
    connect_robot(context).subscribe("odom", "nav_msgs/Odometry", heard.append)
    line = open_serial_line(context, None)
    sampler = connect_host(context, None).sample_utilisation(10)
    context.clock.sleep(1)
    assert len(heard) == 30
    assert sum(len(chunk.data) for chunk in line.drain()) > 3000
    assert len(sampler.stop()) == 10


@pytest.mark.parametrize("connect", CONNECTIONS)
def test_a_link_is_opened_once_a_run(context, connect):
    assert connect(context) is connect(context)


def test_a_link_is_opened_once_a_namespace(context):
    assert connect_robot(context, namespace="alice") is connect_robot(context, namespace="/alice")
    assert connect_robot(context, namespace="alice") is not connect_robot(context, namespace="bob")
    assert open_serial_line(context, None, namespace="alice") is not open_serial_line(context, None)
    assert connect_host(context, None, namespace="alice") is not connect_host(context, None)


def test_the_seed_of_the_run_is_the_seed_of_the_simulation(tmp_path):
    def data(seed):
        opened = Resources()
        clock = open_clock("simulated", opened, seed)
        line = open_serial_line(context_of("simulated", opened, tmp_path), None)
        clock.sleep(0.5)
        data = b"".join(chunk.data for chunk in line.drain())
        opened.close()
        return data

    assert data(1) == data(1) != data(2)


def test_the_end_of_the_run_closes_its_links(context, resources):
    link = connect_robot(context)
    line = open_serial_line(context, None)
    resources.close()
    with pytest.raises(LinkError, match="closed"):
        link.publish("cmd_vel", "geometry_msgs/Twist", {})
    with pytest.raises(LinkError, match="closed"):
        line.drain()


@pytest.mark.parametrize("connect", CONNECTIONS)
def test_without_a_robot_there_is_no_link(resources, connect):
    with pytest.raises(LinkError, match="names no robot") as caught:
        connect(context_of(None, resources))
    assert "--set robot=simulated" in caught.value.fix


@pytest.mark.parametrize("connect", CONNECTIONS)
def test_the_simulator_is_never_a_silent_fallback(resources, connect):
    with pytest.raises(LinkError, match="'ros3'") as caught:
        connect(context_of("ros3", resources))
    assert "--set robot=simulated" in caught.value.fix or "'ros" in caught.value.fix
    with pytest.raises(LinkError, match="'ros3'"):
        open_clock("ros3", resources, 1)


@pytest.mark.parametrize("connect", CONNECTIONS[1:])
def test_a_real_robot_has_no_meter_or_computer_that_is_not_named(resources, connect):
    with pytest.raises(LinkError, match="'dds'") as caught:
        connect(context_of("dds", resources))
    assert "--set robot=simulated" in caught.value.fix
    assert "port=" in caught.value.fix
    assert "host=" in caught.value.fix


def test_a_simulated_robot_has_no_other_port_than_its_own(context):
    with pytest.raises(LinkError, match="/dev/ttyUSB0"):
        open_serial_line(context, "/dev/ttyUSB0")


def test_what_is_on_this_machine_has_nothing_in_its_way():
    assert link_findings(None) == link_findings("simulated") == []


def test_each_known_name_is_described_in_one_line():
    descriptions = {name: link_kind(name).description for name in installed_links()}
    assert "simulated" in descriptions
    assert all(text and "\n" not in text for text in descriptions.values())


@pytest.mark.parametrize(
    ("robot", "fix"),
    [
        ("Simulated", "'simulated'"),
        ("simulatd", "'simulated'"),
        ("rosbrigde", "'rosbridge'"),
        ("gazebo", "--set robot=simulated"),
        ("", "--set"),
    ],
)
def test_an_unknown_name_is_a_finding_with_a_way_out(robot, fix):
    [finding] = link_findings(robot)
    assert finding.is_error
    assert repr(robot) in finding.problem
    assert fix in finding.fix
    assert finding.where == "robot"


def test_a_simulator_that_is_not_installed_is_a_finding_that_names_the_extra(monkeypatch):
    find = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name, *rest: None if name == "mujoco" else find(name, *rest)
    )
    [finding] = link_findings("simulated")
    assert "mujoco" in finding.problem
    assert "pip install 'robot-runner[sim]'" in finding.fix


def test_a_simulator_that_is_not_installed_cannot_be_opened():
    program = (
        "import sys\n"
        "sys.modules['mujoco'] = None\n"
        "from robot_runner.core.errors import LinkError\n"
        "from robot_runner.core.events.resources import Resources\n"
        "from robot_runner.core.links.connect import open_clock\n"
        "try: open_clock('simulated', Resources(), 1)\n"
        "except LinkError as error: print(error)\n"
    )
    said = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
    assert "mujoco" in said
    assert "robot-runner[sim]" in said


def test_importing_the_door_to_the_links_imports_nothing_heavy():
    program = (
        "import sys, robot_runner.core.links.connect as connect\n"
        "assert connect.link_findings('simulated') == []\n"
        "heavy = ('mujoco', 'numpy', 'robot_runner.simulator.simulated_turtlebot3')\n"
        "print([name for name in heavy if name in sys.modules])"
    )
    answer = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60)
    assert answer.stdout.strip() == "[]"


def test_a_named_host_is_this_machine_or_one_that_ssh_reaches_and_is_opened_once(context):
    assert isinstance(connect_host(context, "localhost"), LocalHost)
    robot = connect_host(context, "pi@robot.local")
    assert isinstance(robot, SshHost)
    assert connect_host(context, "pi@robot.local") is robot
    assert connect_host(context, "pi@robot.local", form="sh") is not robot


def test_a_host_is_not_taken_for_a_simulated_robots_namespace(context):
    assert connect_host(context, "alice") is not connect_host(context, None, namespace="alice")


def test_a_host_whose_name_would_pass_for_an_option_is_refused(context):
    with pytest.raises(LinkError, match="-oProxyCommand"):
        connect_host(context, "-oProxyCommand=true")
