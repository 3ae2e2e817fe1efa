"""Commanding zero on topics whose subscribers may have to be discovered."""

from __future__ import annotations

import time

import pytest

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
