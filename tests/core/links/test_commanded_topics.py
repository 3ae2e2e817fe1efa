"""Commanding zero on topics whose subscribers may have to be discovered."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from robot_runner.core.errors import LinkError
from robot_runner.core.links import commanded_topics
from robot_runner.core.links.commanded_topics import keep_commanding_zero
from robot_runner.core.links.robot import GraphEndpoint, Qos
from robot_runner.testing import FakeClock

TOPIC, TWIST = "/cmd_vel", "geometry_msgs/Twist"


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> FakeClock:
    """What is slept is all the time that goes by, however busy the machine is."""
    clock = FakeClock()
    monkeypatch.setattr(commanded_topics, "time", SimpleNamespace(monotonic=clock.now, sleep=clock.sleep))
    return clock


class Told:
    """A robot that is discovered after a while, and hears nothing before."""

    def __init__(self, clock: FakeClock, seconds: float) -> None:
        self._clock, self._discovered_at = clock, clock.now() + seconds
        self.heard = 0

    @property
    def _is_discovered(self) -> bool:
        return self._clock.now() >= self._discovered_at

    def publish(self, topic: str, message_type: str, message: object) -> None:
        self.heard += self._is_discovered

    def advertise(self, topic: str, message_type: str, *, qos: Qos) -> bool:
        return True  # as there is nobody who would miss it

    def subscribers(self, topic: str) -> list[GraphEndpoint]:
        return [GraphEndpoint("/base", TWIST)] if self._is_discovered else [GraphEndpoint("/us", TWIST, is_own=True)]


@pytest.mark.parametrize(("discovered", "empty"), [(9.0, []), (3600.0, [TOPIC])])
def test_a_robot_that_is_not_discovered_yet_is_waited_for(
    clock: FakeClock, discovered: float, empty: list[str]
) -> None:
    robot = Told(clock, discovered)
    assert keep_commanding_zero(robot, [(TOPIC, TWIST)]) == empty
    assert (robot.heard > 0) is (not empty)


class Client(Told):
    """A robot that is a client of the rosbridge's server to which we are connected, too."""

    def subscribers(self, topic: str) -> list[GraphEndpoint]:
        return [GraphEndpoint("/rosbridge_websocket", TWIST, is_own=True, is_shared=True)]


def test_a_robot_behind_the_server_of_our_own_link_is_no_robot_that_is_gone(clock: FakeClock) -> None:
    assert keep_commanding_zero(Client(clock, 0.0), [(TOPIC, TWIST)]) == []
    assert clock.now() < commanded_topics._REACHING


class CutOff(Told):
    """A robot that takes nothing any more, and counts as gone after a while: nobody is missed then."""

    def advertise(self, topic: str, message_type: str, *, qos: Qos) -> bool:
        self._clock.sleep(1.0)
        return self._clock.now() >= self._discovered_at

    def subscribers(self, topic: str) -> list[GraphEndpoint]:
        return [] if self._clock.now() >= self._discovered_at else [GraphEndpoint("/base", TWIST)]


def test_a_robot_that_comes_to_count_as_gone_while_it_is_looked_for_is_told_to_be_gone(clock: FakeClock) -> None:
    assert keep_commanding_zero(CutOff(clock, 6.0), [(TOPIC, TWIST)]) == [TOPIC]


def test_where_a_robot_is_not_reached_all_subscribers_are_named_as_it_may_be_another_one(clock: FakeClock) -> None:
    with pytest.raises(LinkError, match=r"subscription is not reached within 1\d s \(subscribers: /base\)"):
        keep_commanding_zero(CutOff(clock, 3600.0), [(TOPIC, TWIST)])


class Halved:
    """Two robots, of which one cannot be told anything."""

    def __init__(self, fails_at: str, fault: Exception) -> None:
        self._fails_at, self._fault = fails_at, fault
        self.heard: list[str] = []

    def _maybe_fail(self, what: str, topic: str) -> None:
        if what in self._fails_at and topic == "/alice/cmd_vel":
            raise self._fault

    def publish(self, topic: str, message_type: str, message: object) -> None:
        self._maybe_fail("publish", topic)
        self.heard.append(topic)

    def advertise(self, topic: str, message_type: str, *, qos: Qos) -> bool:
        self._maybe_fail("advertise", topic)
        return True

    def subscribers(self, topic: str) -> list[GraphEndpoint]:
        self._maybe_fail("subscribers", topic)
        return [GraphEndpoint("/base", TWIST)]


@pytest.mark.parametrize("fault", [LinkError("it is gone", where="/alice"), RuntimeError("context is not valid")])
@pytest.mark.parametrize("fails_at", ["publish", "advertise", "subscribers", "publish and subscribers"])
def test_a_robot_that_cannot_be_told_keeps_no_other_from_being_told_to_the_end(
    clock: FakeClock, fails_at: str, fault: Exception
) -> None:
    robots = Halved(fails_at, fault)
    with pytest.raises(type(fault), match=str(fault.args[0])):
        keep_commanding_zero(robots, [("/alice/cmd_vel", TWIST), ("/bob/cmd_vel", TWIST)])  # type: ignore[arg-type]
    assert clock.now() >= commanded_topics._TELLING
    assert robots.heard.count("/bob/cmd_vel") > 2
    if "publish" not in fails_at:
        assert robots.heard.count("/alice/cmd_vel") > 2


def test_who_can_tell_no_robot_anything_is_told_at_once(clock: FakeClock) -> None:
    with pytest.raises(LinkError, match="it is gone"):
        keep_commanding_zero(Halved("publish", LinkError("it is gone")), [("/alice/cmd_vel", TWIST)])  # type: ignore[arg-type]
    assert clock.now() < commanded_topics._TELLING
