"""The links to the embedded robot keep what the protocols promise."""

from __future__ import annotations

import pytest

from robot_runner.core.errors import LinkError
from robot_runner.core.links.robot import RobotLink, Subscription
from robot_runner.measuring.host import HostLink, UtilisationSample, UtilisationSampler
from robot_runner.measuring.serial_line import Chunk, SerialLine
from robot_runner.simulator.onboard import Task
from robot_runner.simulator.simulated_devices import SimulatedHost, SimulatedSerialLine
from robot_runner.simulator.simulated_link import SimulatedRobotLink
from robot_runner.simulator.simulated_turtlebot3 import Simulation

TWIST = "geometry_msgs/Twist"
TRIGGER = "std_srvs/Trigger"
FORWARD = {"linear": {"x": 0.2}}


@pytest.fixture
def simulation():
    return Simulation(seed=1)


@pytest.fixture
def robot(simulation):
    return simulation.turtlebot3()


@pytest.fixture
def link(simulation):
    return SimulatedRobotLink(simulation)


@pytest.fixture
def line(simulation):
    return SimulatedSerialLine(simulation)


@pytest.fixture
def host(simulation):
    return SimulatedHost(simulation)


def test_they_are_what_the_protocols_ask_for(link, line, host):
    assert isinstance(link, RobotLink)
    assert isinstance(line, SerialLine)
    assert isinstance(host, HostLink)
    assert isinstance(host.sample_utilisation(10), UtilisationSampler)
    assert isinstance(link.subscribe("odom", "nav_msgs/Odometry", print), Subscription)


def test_they_say_that_they_are_simulated(link, line, host):
    assert link.is_simulated
    assert line.is_simulated
    assert host.is_simulated


# --- robot ---


def test_a_published_velocity_drives_the_robot(simulation, robot, link):
    link.publish("cmd_vel", TWIST, FORWARD)
    simulation.clock.sleep(5)
    assert robot.pose.x > 0.9


def test_callbacks_are_called_while_the_clock_is_slept_on(simulation, link):
    heard = []
    link.subscribe("odom", "nav_msgs/Odometry", heard.append)
    assert heard == []
    simulation.clock.sleep(1)
    assert len(heard) == 30


def test_a_wait_ends_with_the_message_that_it_is_for(simulation, link):
    begun = simulation.clock.now()
    link.wait_for("odom", "nav_msgs/Odometry", timeout=60.0)
    assert simulation.clock.now() - begun < 1.0  # odometry comes 30 times a second


def test_a_callback_may_command_the_robot(simulation, robot, link):
    def stop_at_half_a_metre(message):
        if message["pose"]["pose"]["position"]["x"] >= 0.5:
            link.publish("cmd_vel", TWIST, {})

    link.subscribe("odom", "nav_msgs/Odometry", stop_at_half_a_metre)
    link.publish("cmd_vel", TWIST, FORWARD)
    simulation.clock.sleep(10)
    assert robot.pose.x == pytest.approx(0.52, abs=0.02)


def test_commands_are_heard_as_on_a_graph(simulation, link):
    heard, raw = [], []
    subscription = link.subscribe("cmd_vel", TWIST, lambda message: heard.append(message["linear"]["x"]))
    SimulatedRobotLink(simulation).subscribe_raw("cmd_vel", TWIST, raw.append)
    link.publish("cmd_vel", TWIST, FORWARD)
    assert heard == []
    simulation.clock.sleep(0.1)
    assert (heard, len(raw[0].data)) == ([0.2], 4 + 6 * 8)
    subscription.close()
    link.publish("cmd_vel", TWIST, {})
    simulation.clock.sleep(0.1)
    assert (heard, len(raw)) == ([0.2], 2)


def test_an_ended_subscription_is_silent(simulation, link):
    heard = []
    subscription = link.subscribe("imu", "sensor_msgs/Imu", heard.append)
    simulation.clock.sleep(0.1)
    subscription.close()
    subscription.close()
    simulation.clock.sleep(0.1)
    assert len(heard) == 20


def test_a_service_answers_with_its_response(link, robot):
    assert link.call("task/video/start", TRIGGER) == {"success": True, "message": "video started"}
    assert robot.running_task is Task.VIDEO
    assert link.call("task/network/start", TRIGGER, {})["success"] is False
    assert link.call("/task/video/stop", TRIGGER, timeout=1.0)["success"] is True


@pytest.mark.parametrize(
    ("attempt", "problem", "fix"),
    [
        (lambda link: link.publish("cmd_vell", TWIST, FORWARD), "'/cmd_vell'", "'/cmd_vel'"),
        (lambda link: link.publish("/cmdvel", TWIST, FORWARD), "'/cmdvel'", "'/cmd_vel'"),
        (lambda link: link.publish("odom", "nav_msgs/Odometry", {}), "'/odom'", "'/cmd_vel'"),
        (lambda link: link.publish("cmd_vel", "geometry_msgs/Twists", {}), "geometry_msgs/Twists", f"'{TWIST}'"),
        (lambda link: link.publish("cmd_vel", TWIST, {"linaer": {"x": 1}}), "'linaer'", "'linear'"),
        (lambda link: link.subscribe("odometry", "nav_msgs/Odometry", print), "'/odometry'", "'/odom'"),
        (lambda link: link.subscribe("odom", "nav_msgs/Odom", print), "nav_msgs/Odom", "'nav_msgs/Odometry'"),
        (lambda link: link.subscribe("cmd_vell", TWIST, print), "'/cmd_vell'", "Choose one of"),
        (lambda link: link.call("task/vidio/start", TRIGGER), "'/task/vidio/start'", "'/task/video/start'"),
        (lambda link: link.call("task/stop", "std_srvs/Empty"), "std_srvs/Empty", f"'{TRIGGER}'"),
        (lambda link: link.call("task/stop", TRIGGER, {"now": True}), "'now'", "empty mapping"),
    ],
)
def test_a_misspelt_name_is_refused_with_the_nearest(link, robot, attempt, problem, fix):
    with pytest.raises(LinkError) as caught:
        attempt(link)
    assert problem in caught.value.problem
    assert fix in caught.value.fix
    assert caught.value.where
    assert not robot.is_moving


def test_a_refused_message_leaves_the_robot_as_it_was(simulation, link, robot):
    link.publish("cmd_vel", TWIST, FORWARD)
    with pytest.raises(LinkError):
        link.publish("cmd_vel", TWIST, {"linear": {"x": float("nan")}})
    simulation.clock.sleep(1)
    assert robot.is_moving


def test_names_are_relative_to_the_namespace_unless_they_begin_with_a_slash(simulation):
    alice = SimulatedRobotLink(simulation, namespace="alice")
    alice.publish("/alice/cmd_vel", TWIST, FORWARD)
    assert alice.call("task/video/start", TRIGGER)["success"]
    simulation.clock.sleep(1)
    assert simulation.turtlebot3("alice").is_moving
    assert not simulation.turtlebot3("bob").is_moving
    for absolute in ("/cmd_vel", "/bob/cmd_vel"):
        with pytest.raises(LinkError, match=absolute) as caught:
            alice.publish(absolute, TWIST, FORWARD)
        assert "/alice/cmd_vel" in caught.value.fix
        assert "/alice" in caught.value.where


@pytest.mark.long
def test_what_another_robot_of_the_simulation_publishes_is_heard_by_its_full_name(simulation, link):
    bob = SimulatedRobotLink(simulation, namespace="bob")
    bob.publish("cmd_vel", TWIST, FORWARD)
    moved = link.wait_for("/bob/odom", "nav_msgs/Odometry", lambda odom: odom["pose"]["pose"]["position"]["x"] > 0.1)
    assert moved["header"]["frame_id"]
    assert bob.wait_for("/odom", "nav_msgs/Odometry")["pose"]["pose"]["position"]["x"] < 0.1
    for name, message_type in link.topics().items():
        if "cmd_vel" not in name:
            link.subscribe(name, message_type, lambda _: None)


def test_closing_stops_the_robot_and_its_task(simulation, link, robot):
    link.publish("cmd_vel", TWIST, FORWARD)
    link.call("task/video/start", TRIGGER)
    simulation.clock.sleep(1)
    link.close()
    assert robot.running_task is None
    simulation.clock.sleep(1)
    assert not robot.is_moving


def test_closing_leaves_alone_what_another_link_started(simulation, link, robot):
    other = SimulatedRobotLink(simulation)
    other.publish("cmd_vel", TWIST, FORWARD)
    other.call("task/video/start", TRIGGER)
    assert link.call("task/network/start", TRIGGER)["success"] is False
    link.close()
    simulation.clock.sleep(1)
    assert robot.is_moving
    assert robot.running_task is Task.VIDEO


def test_closing_ends_all_subscriptions(simulation, link):
    heard = []
    link.subscribe("odom", "nav_msgs/Odometry", heard.append)
    link.subscribe("scan", "sensor_msgs/LaserScan", heard.append)
    link.close()
    link.close()
    simulation.clock.sleep(1)
    assert heard == []


def test_a_closed_link_is_of_no_use(link):
    link.close()
    for attempt in (
        lambda: link.publish("cmd_vel", TWIST, FORWARD),
        lambda: link.subscribe("odom", "nav_msgs/Odometry", print),
        lambda: link.call("task/stop", TRIGGER),
    ):
        with pytest.raises(LinkError, match="closed"):
            attempt()


def test_a_callback_that_fails_is_heard_by_who_slept(simulation, link):
    link.subscribe("odom", "nav_msgs/Odometry", lambda message: message["no such field"])
    with pytest.raises(KeyError):
        simulation.clock.sleep(1)


# --- serial line ---


def test_the_line_keeps_everything_until_it_is_drained(simulation, line):
    simulation.clock.sleep(3)
    chunks = line.drain()
    assert all(isinstance(chunk, Chunk) for chunk in chunks)
    assert sum(len(chunk.data) for chunk in chunks) == 600 * 16 + 3 * 20
    assert line.drain() == []


def test_chunks_are_stamped_with_the_simulation_s_time_in_order(simulation):
    simulation.clock.sleep(7)
    line = SimulatedSerialLine(simulation)
    simulation.clock.sleep(1)
    stamps = [chunk.received_at for chunk in line.drain()]
    assert stamps == sorted(stamps)
    assert 7 < stamps[0] < 7.02
    assert 7.98 < stamps[-1] <= 8


def test_what_is_written_reaches_the_device(simulation, line):
    simulation.clock.sleep(0.1)
    line.drain()
    line.write(b"?")
    simulation.clock.sleep(0.1)
    assert b"\xa5\x5a\x12" in b"".join(chunk.data for chunk in line.drain())


def test_a_closed_line_is_of_no_use(line):
    line.close()
    line.close()
    with pytest.raises(LinkError, match="closed"):
        line.drain()
    with pytest.raises(LinkError, match="closed"):
        line.write(b"?")


# --- host ---


def test_the_on_board_computer_is_sampled_at_the_rate(simulation, host):
    simulation.clock.sleep(3)
    sampler = host.sample_utilisation(10)
    simulation.clock.sleep(5)
    samples = sampler.stop()
    assert all(isinstance(sample, UtilisationSample) for sample in samples)
    assert [sample.time for sample in samples] == pytest.approx([3.1 + 0.1 * number for number in range(50)])
    assert all(0 <= sample.cpu <= 100 and 0 <= sample.memory <= 100 for sample in samples)


def test_stopping_a_sampler_again_returns_the_same(simulation, host):
    sampler = host.sample_utilisation(10)
    simulation.clock.sleep(1)
    samples = sampler.stop()
    simulation.clock.sleep(1)
    assert sampler.stop() == samples
    assert len(samples) == 10


def test_closing_the_host_ends_its_samplers(simulation, host):
    sampler = host.sample_utilisation(10)
    simulation.clock.sleep(1)
    host.close()
    host.close()
    simulation.clock.sleep(1)
    assert len(sampler.stop()) == 10
    with pytest.raises(LinkError, match="closed"):
        host.sample_utilisation(10)


@pytest.mark.parametrize("rate", [0, -1, 201, float("nan")])
def test_a_rate_that_cannot_be_is_refused(host, rate):
    with pytest.raises(LinkError, match="rate"):
        host.sample_utilisation(rate)
