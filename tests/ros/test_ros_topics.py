"""Topics measured as they are heard."""

from __future__ import annotations

import csv
import json
import time

import pytest

from robot_runner.core.errors import PluginError
from robot_runner.core.events.measure import Origin
from robot_runner.core.events.window import Window
from robot_runner.core.links.robot import Encoding
from robot_runner.core.plugin import Circumstances
from robot_runner.ros.ros_topics import RosTopics
from robot_runner.ros.topic_statistics import HeaderReader, ReceivedTopic, missed
from robot_runner.testing import FakeClock, FakeLinks, FakeRobotLink, ProfilerContract, make_context, rehearse


class TestRosTopicsOnTheSimulatedRobot(ProfilerContract):
    def make_plugin(self):
        return RosTopics({"odom": None, "battery_state": None})


class TestRosTopicsOfAScriptedRobot(ProfilerContract):
    def make_plugin(self):
        return RosTopics({"odom": 20.0})

    def make_links(self, clock):
        return FakeLinks(robot=_odometry(clock, lambda _: True))


def _odometry(clock, is_sent, *, age=0.02, is_simulated=False):
    """Return a robot that sends odometry at 20 Hz, `age` s old when it arrives."""
    robot = FakeRobotLink(clock, is_simulated=is_simulated)
    robot.known_topics["odom"] = "nav_msgs/Odometry"

    def send():
        stamp = round((clock.now() - age) * 1e9)
        if is_sent(clock.now()):
            robot.deliver("odom", {"header": {"stamp": {"sec": stamp // 10**9, "nanosec": stamp % 10**9}}})

    clock.every(0.05, send)
    return robot


@pytest.fixture
def measure(tmp_path):
    def execute(plugin, is_sent=lambda _: True, *, seconds=10.0, **how):
        clock = FakeClock(50.0)
        robot = _odometry(clock, is_sent, **how)
        context = make_context(tmp_path, plugin, links=FakeLinks(robot=robot), clock=clock)
        rehearse(context, plugin, mission=lambda: clock.sleep(seconds))
        return context

    return execute


def test_rate_bandwidth_age_and_jitter_are_those_of_the_measured_window(measure):
    context = measure(RosTopics({"odom": 20.0}))
    values = context.measures
    assert values["OdomRate"] == pytest.approx(20.0, rel=0.01)
    assert values["OdomBandwidth"] == pytest.approx(20.0 * 704, rel=0.05)
    assert values["OdomAge"] == pytest.approx(0.02)
    assert values["OdomMaxAge"] == pytest.approx(0.02)
    assert values["OdomJitter"] == pytest.approx(0.0, abs=1e-6)
    assert not context.broker.findings


def test_what_is_lost_is_not_known_in_ros_2(measure):
    context = measure(RosTopics(["odom"], losses=True))
    assert context.measures["OdomDropped"] is None
    (finding,) = context.broker.findings
    assert "nothing numbers the messages" in finding.problem


def test_that_several_publishers_number_the_messages_is_said_where_losses_are_not_known():
    topic = ReceivedTopic("Odom", None)
    for place, number in enumerate((5, 5, 6, 7, 7, 8, 8)):
        topic.times.append(0.1 * place)
        topic.ages.append(0.0)
        topic.sequence.append(number)
    assert "several publishers number the messages" in topic.loss_doubt(Window(-0.1, 0.65))


def test_losses_between_two_windows_belong_to_one_of_them_and_those_that_may_come_later_to_none():
    topic = ReceivedTopic("Odom", None)
    for number in (1, 2, 3, 7, 8, 9, 10, 11, 12, 13):
        topic.times.append(number * 0.1)
        topic.ages.append(0.01)
        topic.sizes.append(100)
        topic.sequence.append(number)
    windows = Window(0.0, 0.5), Window(0.5, 1.35)
    assert [topic.over(window).dropped(window) for window in windows] == [0, 3]
    late = Window(0.5, 3.0)
    assert (topic.over(late).dropped(late), topic.over(late).underway(late)) == (None, 17)


def test_a_topic_that_falls_silent_is_warned_of(measure):
    context = measure(RosTopics({"odom": 20.0}), lambda now: now < 55.0)
    assert context.measures["OdomRate"] == pytest.approx(10.0, rel=0.02)
    assert any("topic odom" in each.problem and "largest gap" in each.problem for each in context.broker.findings)


def test_a_topic_that_nobody_publishes_yields_no_value_and_a_warning(measure):
    context = measure(RosTopics({"scan": 5.0}, patience=1.0))
    assert set(context.measures.values()) == {None}
    assert any("the topic is not published within 1 s" in each.problem for each in context.broker.findings)


def test_a_topic_that_is_only_subscribed_and_has_no_type_yet_is_one_that_nobody_publishes(tmp_path):
    clock = FakeClock()
    link = FakeRobotLink(clock)
    link.known_topics = {"scan": "*"}  # as `rostopic echo /scan` subscribes it
    plugin = RosTopics(["scan"], patience=0.5)
    context = make_context(tmp_path, plugin, links=FakeLinks(robot=link), clock=clock)
    assert rehearse(context, plugin)["ScanRate"] is None
    assert "topic scan: the topic is not published within 0.5 s" in context.broker.findings[0].problem


def test_of_a_silent_topic_beside_one_that_is_heard_no_value_is_said_to_have_a_wrong_name(measure):
    """What was lost is computed, too, and was taken for a slip where it is not asked for."""
    context = measure(RosTopics({"odom": 20.0, "scan": None}))
    assert context.measures["OdomRate"] == pytest.approx(20.0, rel=0.01)
    (finding,) = context.broker.findings
    assert "scan" in finding.problem
    assert "is no measure" not in finding.problem


def test_stamps_of_the_future_yield_no_age_and_a_warning_about_clocks(measure):
    context = measure(RosTopics({"odom": 20.0}), age=-0.5)
    assert context.measures["OdomAge"] is None
    assert context.measures["OdomRate"] == pytest.approx(20.0, rel=0.01)
    (finding,) = context.broker.findings
    assert "0.500 s after it arrived" in finding.problem
    assert "chrony" in finding.fix


def test_stamps_of_a_simulation_s_time_or_a_recording_yield_no_age_and_a_warning_about_it_alone(measure):
    context = measure(RosTopics({"odom": 20.0}), age=20_000 * 86_400.0)
    assert (context.measures["OdomAge"], context.measures["OdomMaxAge"]) == (None, None)
    assert context.measures["OdomRate"] == pytest.approx(20.0, rel=0.01)
    (finding,) = context.broker.findings
    assert "topic odom: a message was stamped 20000.0 days before it arrived" in finding.problem


def test_a_clock_that_is_behind_or_a_recording_of_today_yields_no_age_and_a_warning_about_clocks(measure):
    """A clock that was ahead gave itself away; that of a robot without one of its own made ages of hours."""
    context = measure(RosTopics({"odom": 20.0}), age=4000.0)
    assert (context.measures["OdomAge"], context.measures["OdomMaxAge"]) == (None, None)
    assert context.measures["OdomRate"] == pytest.approx(20.0, rel=0.01)
    (finding,) = context.broker.findings
    assert "topic odom: all messages were stamped at least 4,000 s before they arrived" in finding.problem
    assert "chrony" in finding.fix


def test_messages_that_are_late_by_seconds_are_no_matter_of_clocks(measure):
    context = measure(RosTopics({"odom": 20.0}), age=20.0)
    assert context.measures["OdomAge"] == pytest.approx(20.0, abs=0.01)
    assert not context.broker.findings


def test_ages_are_doubtful_and_they_alone_where_this_machine_s_clock_was_set_meanwhile(measure, monkeypatch):
    real, set_by = time.clock_gettime, [0.0]
    monkeypatch.setattr(time, "clock_gettime", lambda clock: real(clock) + set_by[0] * (clock == time.CLOCK_REALTIME))

    def is_sent(now):
        set_by[0] = 3600.0 if now > 55.0 else 0.0
        return True

    context = measure(RosTopics({"odom": 20.0}), is_sent)
    (doubt,) = [fields for kind, fields in context.broker.records if kind == "finding"]
    assert "topic odom: this machine's clock was set by +3,600.0 s" in doubt["problem"]
    assert doubt["measures"] == ["OdomAge", "OdomMaxAge"]


def test_messages_without_a_stamp_have_no_age_and_that_is_said(tmp_path):
    clock, plugin = FakeClock(50.0), RosTopics(["cmd_vel"], losses=False)
    robot = FakeRobotLink(clock)
    robot.known_topics["cmd_vel"] = "geometry_msgs/Twist"
    clock.every(0.05, lambda: robot.deliver("cmd_vel", {}))
    context = make_context(tmp_path, plugin, links=FakeLinks(robot=robot), clock=clock)
    rehearse(context, plugin, mission=lambda: clock.sleep(10.0))
    assert context.measures["CmdVelRate"] == pytest.approx(20.0, rel=0.01)
    assert (context.measures["CmdVelAge"], context.measures["CmdVelMaxAge"]) == (None, None)
    assert [finding.problem for finding in context.broker.findings] == [
        "topic cmd_vel: its messages carry no stamp, so ages are not known"
    ]


def test_what_was_lost_is_known_whatever_time_the_stamps_are_of():
    topic = ReceivedTopic("Odom", None)
    for number in (1, 2, 4, 5):
        topic.times.append(number * 0.1)
        topic.ages.append(1.7e9)
        topic.sizes.append(100)
        topic.sequence.append(number)
    assert topic.over(Window(0.0, 0.5)).dropped(Window(0.0, 0.5)) == 1


@pytest.mark.parametrize(("is_simulated", "origin"), [(True, Origin.SIMULATED), (False, Origin.MEASURED)])
def test_values_say_where_they_come_from(measure, is_simulated, origin):
    context = measure(RosTopics(), is_simulated=is_simulated)
    assert {published.origin for published in context.broker.measures.values()} == {origin}


def test_a_simulation_whose_sign_is_seen_while_it_is_measured_is_one(tmp_path):
    clock = FakeClock(50.0)
    robot = _odometry(clock, lambda _: True)
    clock.at(55.0, lambda: robot.known_topics.update({"/clock": "rosgraph_msgs/Clock"}))
    plugin = RosTopics()
    context = make_context(tmp_path, plugin, links=FakeLinks(robot=robot), clock=clock)
    rehearse(context, plugin, mission=lambda: clock.sleep(10.0))
    assert {published.origin for published in context.broker.measures.values()} == {Origin.SIMULATED}


def test_each_message_and_the_quality_are_kept(measure):
    context = measure(RosTopics({"odom": 20.0}), seconds=1.0)
    with (context.raw_data_folder / "Odom.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) in {20, 21}
    assert float(rows[0]["age_s"]) == pytest.approx(0.02, abs=1e-5)
    facts = json.loads((context.raw_data_folder / "quality.json").read_text())
    assert facts["topics"]["odom"]["got"] == len(rows)


def test_the_topics_of_the_simulated_robot_have_the_rates_of_the_real_one(tmp_path):
    plugin = RosTopics({"odom": 30.0, "battery_state": None})
    context = make_context(tmp_path, plugin)
    measures = rehearse(context, plugin, mission=lambda: context.clock.sleep(5.0))
    context.resources.close()
    assert measures["OdomRate"] == pytest.approx(30.0, rel=0.05)
    assert measures["OdomAge"] == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize(
    ("sequence", "lost"),
    [
        ([1, 2, 3], 0),
        ([1, 2, 5], 2),
        ([2**32 - 2, 2**32 - 1, 1], 1),
        ([10, 11, 0, 1, 2], 0),
        ([0, 0, 0], None),
        ([7], None),
        ([], None),
        ([5, 900, 6, 901, 7, 902], None),
        ([5, 5, 6, 7, 7, 8, 8], None),  # of two publishers in step, one has lost its 6
        ([5, 6, 6, 7, 8, 8, 9], None),
    ],
)
def test_losses_are_the_gaps_of_a_publisher_s_numbers(sequence, lost):
    assert missed(sequence) == lost


def test_the_header_of_ros_1_has_a_number_and_that_of_ros_2_none():
    ros1 = HeaderReader("# odometry\nHeader header\n", Encoding.ROS1)
    assert ros1.read(bytes([7, 0, 0, 0, 2, 0, 0, 0, 5, 0, 0, 0])) == (2_000_000_005, 7)
    ros2 = HeaderReader("uint8 X=1\nstd_msgs/Header header\n", Encoding.CDR)
    assert ros2.read(bytes([0, 1, 0, 0, 2, 0, 0, 0, 5, 0, 0, 0])) == (2_000_000_005, None)
    assert ros2.read(bytes([0, 0, 0, 0, 0, 0, 0, 2, 0, 0, 0, 5])) == (2_000_000_005, None)


def test_a_message_without_header_or_stamp_has_no_age():
    assert HeaderReader("string data\n", Encoding.CDR).read(bytes(40)) == (None, None)
    assert HeaderReader("std_msgs/Header header\n", Encoding.CDR).read(bytes([0, 1, 0, 0, *bytes(12)])) == (None, None)


@pytest.mark.parametrize("first", ["string<=8 name", "uint8[<=8] data", "string name 'a=b'"])
def test_a_field_with_a_bound_or_a_default_is_no_constant_before_a_header(first):
    reader = HeaderReader(f"uint8 MODE = 1\n{first}\nstd_msgs/Header header\n", Encoding.CDR)
    assert not reader.has_header
    assert reader.read(bytes([0, 1, 0, 0, 5, 0, 0, 0, *b"hall\0\0\0\0"])) == (None, None)


@pytest.mark.parametrize(
    ("topics", "problem"),
    [
        ({}, "topics is"),
        ("odom", "topics is 'odom'"),
        ({"odom": 0.0}, "rate is 0.0"),
        (["odom", "/odom"], "two topics would have the columns of 'Odom'"),
        (["od om"], "'od om' cannot be the name of a topic"),
    ],
)
def test_topics_that_cannot_be_are_refused(topics, problem):
    with pytest.raises(PluginError, match=problem):
        RosTopics(topics)


def test_the_rate_is_shown_while_the_topic_is_heard(tmp_path, monkeypatch):
    monkeypatch.setattr("robot_runner.measuring.live_samples._EVERY", 0.0)
    clock, plugin = FakeClock(50.0), RosTopics({"odom": 20.0})
    context = make_context(tmp_path, plugin, links=FakeLinks(robot=_odometry(clock, lambda _: True)), clock=clock)
    shown = context.raw_data_folder / ".Odom.csv.live"
    seen = []

    def mission():
        clock.sleep(5.0)
        seen.extend(csv.DictReader(shown.read_text(encoding="utf-8").splitlines()))

    rehearse(context, plugin, mission=mission)
    assert len(seen) > 90
    assert [float(row["rate_Hz"]) for row in seen[2:]] == [pytest.approx(20.0)] * (len(seen) - 2)
    assert not shown.exists()


def test_without_rosbags_the_check_refuses_to_subscribe_topics_of_the_simulated_robot(monkeypatch):
    assert list(RosTopics({"odom": None}).check(Circumstances("simulated"))) == []
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    (finding,) = RosTopics({"odom": None}).check(Circumstances("simulated"))
    assert finding.is_error
    assert finding.problem == "rosbags, which serialises the simulated robot's messages, cannot be imported"
    assert finding.fix == "Install it: pip install 'robot-runner[bag]'."
