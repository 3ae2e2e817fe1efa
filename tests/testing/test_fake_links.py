from __future__ import annotations

import math

import pytest

from robot_runner.core.errors import LinkError, MeasureError
from robot_runner.core.events.context import SystemClock
from robot_runner.core.events.measure import Measure
from robot_runner.core.links.connect import connect_robot
from robot_runner.core.links.robot import RobotLink, Subscription
from robot_runner.measuring.devices import connect_host, open_serial_line
from robot_runner.measuring.host import HostLink, UtilisationSampler
from robot_runner.measuring.local_host import LocalHost
from robot_runner.measuring.serial_line import SerialLine
from robot_runner.plugins import Profiler
from robot_runner.testing import (
    Chunk,
    FakeClock,
    FakeHostLink,
    FakeLinks,
    FakeRobotLink,
    FakeSerialLine,
    FakeTurtlebot3Link,
    context_for,
    make_context,
)

TWIST = "geometry_msgs/Twist"
TRIGGER = "std_srvs/Trigger"


class Scale(Profiler):
    measures = (Measure("Mass", "kg", "Mass of the robot."),)


@pytest.fixture
def clock():
    return FakeClock()


def test_fakes_keep_to_the_protocols_of_the_links(clock):
    assert isinstance(FakeRobotLink(clock), RobotLink)
    assert isinstance(FakeRobotLink(clock).subscribe("odom", "nav_msgs/Odometry", print), Subscription)
    assert isinstance(FakeSerialLine(clock), SerialLine)
    assert isinstance(FakeHostLink(clock), HostLink)
    assert isinstance(FakeHostLink(clock).sample_utilisation(1.0), UtilisationSampler)


@pytest.mark.parametrize("make", [LocalHost, FakeHostLink])
def test_the_first_sample_of_a_computer_has_no_cpu_as_there_is_none_before(make):
    clock = SystemClock()
    sampler = make(clock).sample_utilisation(100.0)
    clock.sleep(0.05)
    first = sampler.stop()[0]
    assert (first.cpu, first.memory is None) == (None, False)


@pytest.mark.parametrize("make", [FakeRobotLink, FakeTurtlebot3Link, FakeSerialLine, FakeHostLink])
@pytest.mark.parametrize("is_simulated", [True, False])
def test_a_fake_says_what_it_was_told_about_being_simulated(clock, make, is_simulated):
    assert make(clock, is_simulated=is_simulated).is_simulated is is_simulated


@pytest.mark.parametrize("namespace", ["", "/alice"])
def test_plugins_are_handed_the_fakes_as_if_they_were_real(tmp_path, clock, namespace):
    robot, serial, host = FakeRobotLink(clock), FakeSerialLine(clock), FakeHostLink(clock)
    links = FakeLinks(robot=robot, serial=serial, host=host, namespace=namespace)
    context = make_context(tmp_path, links=links, clock=clock)
    assert connect_robot(context, namespace=namespace) is robot
    assert open_serial_line(context, None, namespace=namespace) is serial
    assert connect_host(context, None, namespace=namespace) is host
    context.resources.close()
    assert robot.is_closed
    assert serial.is_closed
    assert host.is_closed


def test_fakes_stand_in_for_whatever_port_or_computer_a_plugin_names(tmp_path, clock):
    serial, host = FakeSerialLine(clock), FakeHostLink(clock)
    context = make_context(tmp_path, robot=None, links=FakeLinks(serial=serial, host=host), clock=clock)
    assert open_serial_line(context, "/dev/no-such-port", baud=9600) is serial
    assert connect_host(context, "pi@robot", form="sh") is host
    context.resources.close()
    assert serial.is_closed
    assert host.is_closed


@pytest.mark.parametrize("message_type", [TWIST, "no_such_msgs/Type"])
def test_raw_messages_of_a_closed_robot_are_refused_for_that_whatever_their_type(clock, message_type):
    link = FakeRobotLink(clock)
    link.close()
    with pytest.raises(LinkError, match="the link was closed"):
        link.subscribe_raw("cmd_vel", message_type, print)


def test_a_device_on_a_serial_line_answers_what_it_is_sent(clock):
    replies = {b"P": b"12.5", b"V": b"12.0"}
    line = FakeSerialLine(clock, [Chunk(0.0, b"hello"), Chunk(3.0, b"bye")], answer=lambda sent: replies.get(sent, b""))
    clock.sleep(1.0)
    line.write(b"P")
    line.write(b"?")
    assert line.drain() == [Chunk(0.0, b"hello"), Chunk(1.0, b"12.5")]
    clock.sleep(4.0)
    line.write(b"V")
    assert line.drain() == [Chunk(3.0, b"bye"), Chunk(5.0, b"12.0")]
    assert line.written == b"P?V"


def test_without_fakes_a_context_has_the_simulated_robot(tmp_path):
    context = make_context(tmp_path)
    assert connect_robot(context).is_simulated
    context.clock.sleep(0.5)
    assert context.clock.now() == 0.5
    context.resources.close()


def test_a_context_has_the_gate_of_a_real_run(tmp_path):
    context = make_context(tmp_path, Scale(), robot=None)
    context.publish("Mass", 1.0)
    with pytest.raises(MeasureError, match="was not declared") as raised:
        context.publish("Mas", 1.0)
    assert "'Mass'" in raised.value.fix
    with pytest.raises(MeasureError, match="not a finite number"):
        context.publish("Mass", math.nan)
    assert context.broker.values == {"Mass": 1.0}
    assert [kind for kind, _ in context.broker.records] == ["measure", "refused", "refused"]


def test_two_plugins_with_one_measure_publish_under_their_names(tmp_path):
    left, right = Scale(name="left"), Scale(name="right")
    context = make_context(tmp_path, left, right, robot=None)
    context.publish("Mass", 1.0)
    context_for(right, context).publish("Mass", 2.0)
    assert dict(context.measures) == {"left.Mass": 1.0, "right.Mass": 2.0}
    assert context_for(right, context).raw_data_folder == tmp_path / "runs" / "r_1" / "right"


def test_a_robot_link_records_what_it_is_told(clock):
    link = FakeRobotLink(clock, services={"lamp/on": {"success": True}})
    clock.sleep(2.0)
    link.publish("cmd_vel", TWIST, {"linear": {"x": 0.1}})
    assert link.call("lamp/on", TRIGGER) == {"success": True}
    assert [(each.time, each.topic) for each in link.publications] == [(2.0, "cmd_vel")]
    assert [each.service for each in link.calls] == ["lamp/on"]


def test_a_robot_link_knows_whether_the_robot_was_told_to_stand_still(clock):
    link = FakeRobotLink(clock)
    assert link.stands_still
    link.publish("cmd_vel", TWIST, {"angular": {"z": 0.5}})
    assert not link.stands_still
    link.publish("cmd_vel", TWIST, {})
    assert link.stands_still


def test_a_service_answers_by_function_or_by_error(clock):
    link = FakeRobotLink(
        clock, services={"add": lambda request: {"sum": request["a"] + 1}, "mute": LinkError("silent")}
    )
    assert link.call("add", "test/Add", {"a": 2}) == {"sum": 3}
    with pytest.raises(LinkError, match="silent"):
        link.call("mute", TRIGGER)
    with pytest.raises(LinkError, match="no service 'ad'") as raised:
        link.call("ad", TRIGGER)
    assert raised.value.fix == "Did you mean 'add'?"


def test_a_subscription_that_was_closed_hears_no_more(clock):
    link, heard = FakeRobotLink(clock), []
    subscription = link.subscribe("odom", "nav_msgs/Odometry", heard.append)
    link.deliver("odom", {"number": 1})
    subscription.close()
    link.deliver("odom", {"number": 2})
    assert heard == [{"number": 1}]


@pytest.mark.parametrize("break_it", [FakeRobotLink.close, lambda link: setattr(link, "fault", LinkError("no route"))])
def test_a_link_that_is_closed_or_faulty_raises(clock, break_it):
    link = FakeRobotLink(clock)
    break_it(link)
    for use in (
        lambda: link.publish("cmd_vel", TWIST, {}),
        lambda: link.call("task/stop", TRIGGER),
        lambda: link.subscribe("odom", "nav_msgs/Odometry", print),
    ):
        with pytest.raises(LinkError):
            use()


def test_the_ideal_robot_drives_a_circle(clock):
    robot = FakeTurtlebot3Link(clock)
    robot.publish("cmd_vel", TWIST, {"linear": {"x": 0.1}, "angular": {"z": 0.5}})
    clock.sleep(math.pi / 0.5)
    robot.publish("cmd_vel", TWIST, {})
    assert (robot.x, robot.y) == pytest.approx((0.0, 2 * 0.1 / 0.5), abs=1e-9)
    assert robot.heading == pytest.approx(math.pi)


def test_the_ideal_robot_tells_of_its_pose_30_times_a_second(clock):
    robot, heard = FakeTurtlebot3Link(clock), []
    robot.subscribe("odom", "nav_msgs/Odometry", heard.append)
    robot.publish("cmd_vel", TWIST, {"linear": {"x": 0.2}})
    robot.odometry_ends_at = 1.01
    clock.sleep(2.0)
    assert len(heard) == 30
    assert heard[-1]["pose"]["pose"]["position"]["x"] == pytest.approx(0.2)


def test_the_ideal_robot_tells_of_its_velocity_in_a_whole_message_as_a_real_one(clock):
    robot, heard = FakeTurtlebot3Link(clock, slip=0.5), []
    robot.subscribe("odom", "nav_msgs/Odometry", heard.append)
    robot.publish("cmd_vel", TWIST, {"linear": {"x": 0.2}, "angular": {"z": 1.0}})
    clock.sleep(0.1)
    assert heard[-1].keys() == {"header", "child_frame_id", "pose", "twist"}  # as in nav_msgs/Odometry
    assert [len(heard[-1][part]["covariance"]) for part in ("pose", "twist")] == [36, 36]
    told = heard[-1]["twist"]["twist"]
    assert (told["linear"], told["angular"]) == ({"x": 0.1, "y": 0.0, "z": 0.0}, {"x": 0.0, "y": 0.0, "z": 0.5})


def test_a_serial_line_delivers_what_has_arrived_once(clock):
    line = FakeSerialLine(clock, [Chunk(2.0, b"b"), Chunk(1.0, b"a"), Chunk(3.0, b"c")])
    clock.sleep(2.0)
    assert [chunk.data for chunk in line.drain()] == [b"a", b"b"]
    assert line.drain() == []
    line.write(b"?")
    assert line.written == b"?"


def test_a_serial_line_that_is_lost_or_closed_raises(clock):
    line = FakeSerialLine(clock, lost_at=1.0)
    line.drain()
    clock.sleep(1.0)
    with pytest.raises(LinkError, match="unplugged"):
        line.drain()
    line.close()
    with pytest.raises(LinkError, match="closed"):
        line.write(b"?")


def test_a_sampler_returns_the_same_samples_twice(clock):
    sampler = FakeHostLink(clock, cpu=lambda time: time, misses=lambda time: time == 1.0).sample_utilisation(1.0)
    clock.sleep(2.0)
    first = sampler.stop()
    clock.sleep(2.0)
    assert [(sample.time, sample.cpu) for sample in first] == [(0.0, None), (2.0, 2.0)]
    assert sampler.stop() == first


def test_a_closed_host_samples_nothing(clock):
    host = FakeHostLink(clock)
    host.close()
    with pytest.raises(LinkError, match="closed"):
        host.sample_utilisation(1.0)
