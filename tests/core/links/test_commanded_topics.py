"""Commanding zero on topics whose subscribers may have to be discovered."""

from __future__ import annotations

import time

import pytest

from robot_runner.core.errors import LinkError
from robot_runner.core.links import commanded_topics
from robot_runner.core.links.commanded_topics import keep_commanding_zero
from robot_runner.core.links.robot import GraphEndpoint

TOPIC, TWIST = "/cmd_vel", "geometry_msgs/Twist"


class Told:
    """A robot that is discovered after a while, and hears nothing before."""

    def __init__(self, seconds: float) -> None:
        self._discovered_at = time.monotonic() + seconds
        self.heard = 0

    @property
    def _is_discovered(self) -> bool:
        return time.monotonic() >= self._discovered_at

    def publish(self, topic: str, message_type: str, message: object) -> None:
        self.heard += self._is_discovered

    def advertise(self, topic: str, message_type: str) -> bool:
        return True  # as there is nobody who would miss it

    def subscribers(self, topic: str) -> list[GraphEndpoint]:
        return [GraphEndpoint("/base", TWIST)] if self._is_discovered else [GraphEndpoint("/us", TWIST, is_own=True)]


@pytest.mark.parametrize(("discovered", "patience", "empty"), [(0.5, 60.0, []), (3600.0, 0.5, [TOPIC])])
def test_a_robot_that_is_not_discovered_yet_is_waited_for(
    monkeypatch: pytest.MonkeyPatch, discovered: float, patience: float, empty: list[str]
) -> None:
    monkeypatch.setattr(commanded_topics, "_TELLING", 0.1)
    monkeypatch.setattr(commanded_topics, "_REACHING", patience)
    robot = Told(discovered)
    assert keep_commanding_zero(robot, [(TOPIC, TWIST)]) == empty
    assert (robot.heard > 0) is (not empty)


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

    def advertise(self, topic: str, message_type: str) -> bool:
        self._maybe_fail("advertise", topic)
        return True

    def subscribers(self, topic: str) -> list[GraphEndpoint]:
        self._maybe_fail("subscribers", topic)
        return [GraphEndpoint("/base", TWIST)]


@pytest.mark.parametrize("fault", [LinkError("it is gone", where="/alice"), RuntimeError("context is not valid")])
@pytest.mark.parametrize("fails_at", ["publish", "advertise", "subscribers", "publish and subscribers"])
def test_a_robot_that_cannot_be_told_keeps_no_other_from_being_told_to_the_end(
    monkeypatch: pytest.MonkeyPatch, fails_at: str, fault: Exception
) -> None:
    monkeypatch.setattr(commanded_topics, "_TELLING", 0.5)
    monkeypatch.setattr(commanded_topics, "_REACHING", 0.6)
    robots = Halved(fails_at, fault)
    with pytest.raises(type(fault), match=str(fault.args[0])):
        keep_commanding_zero(robots, [("/alice/cmd_vel", TWIST), ("/bob/cmd_vel", TWIST)])  # type: ignore[arg-type]
    assert robots.heard.count("/bob/cmd_vel") > 2
    if "publish" not in fails_at:
        assert robots.heard.count("/alice/cmd_vel") > 2


def test_who_can_tell_no_robot_anything_is_told_at_once() -> None:
    began = time.monotonic()
    with pytest.raises(LinkError, match="it is gone"):
        keep_commanding_zero(Halved("publish", LinkError("it is gone")), [("/alice/cmd_vel", TWIST)])  # type: ignore[arg-type]
    assert time.monotonic() - began < commanded_topics._TELLING
