"""Commanding zero on topics whose subscribers may have to be discovered."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor, wait
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest

from robot_runner.core.errors import LinkError, SilentGraphError
from robot_runner.core.links import commanded_topics
from robot_runner.core.links.commanded_topics import keep_commanding_zero
from robot_runner.core.links.robot import GraphEndpoint, Qos
from robot_runner.testing import FakeClock

if TYPE_CHECKING:
    from collections.abc import Sequence

    from robot_runner.core.links.robot import RobotLink

TOPIC, TWIST = "/cmd_vel", "geometry_msgs/Twist"
NOBODY = "nobody subscribes to /cmd_vel any more"


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


@pytest.mark.parametrize(("discovered", "empty"), [(9.0, []), (3600.0, [NOBODY])])
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


class Silent(Told):
    """A robot behind a server that takes commands, while what would list its graph hangs."""

    def advertise(self, topic: str, message_type: str, *, qos: Qos) -> bool:
        return self._is_discovered

    def subscribers(self, topic: str) -> list[GraphEndpoint]:
        raise SilentGraphError("rosapi does not answer", where=topic)


def test_a_robot_that_takes_commands_is_told_although_its_graph_cannot_be_listed(clock: FakeClock) -> None:
    robot = Silent(clock, 0.0)
    said = "zero was published on /cmd_vel, but its subscribers are not known: rosapi does not answer"
    assert keep_commanding_zero(robot, [(TOPIC, TWIST)]) == [said]
    assert robot.heard > 2
    assert clock.now() > commanded_topics._REACHING, "it may answer again"
    with pytest.raises(LinkError, match="the robot's subscription is not reached within"):
        keep_commanding_zero(Silent(clock, 3600.0), [(TOPIC, TWIST)])


class CutOff(Told):
    """A robot that takes nothing any more, and counts as gone after a while: nobody is missed then."""

    def advertise(self, topic: str, message_type: str, *, qos: Qos) -> bool:
        self._clock.sleep(1.0)
        return self._clock.now() >= self._discovered_at

    def subscribers(self, topic: str) -> list[GraphEndpoint]:
        return [] if self._clock.now() >= self._discovered_at else [GraphEndpoint("/base", TWIST)]


def test_a_robot_that_comes_to_count_as_gone_while_it_is_looked_for_is_told_to_be_gone(clock: FakeClock) -> None:
    assert keep_commanding_zero(CutOff(clock, 6.0), [(TOPIC, TWIST)]) == [NOBODY]


def test_where_a_robot_is_not_reached_all_subscribers_are_named_as_it_may_be_another_one(clock: FakeClock) -> None:
    with pytest.raises(LinkError, match=r"subscription is not reached within 1\d s \(subscribers: /base\)"):
        keep_commanding_zero(CutOff(clock, 3600.0), [(TOPIC, TWIST)])


class Left(Told):
    """A graph that lists a dead process of ours as a subscriber, which acknowledges nothing, and perhaps a robot."""

    dead = "/robot_runner_4194304"  # no process has so high a number
    robots: Sequence[str] = ("/base",)

    def __init__(self, clock: FakeClock, anew: Told) -> None:
        super().__init__(clock, 0.0)
        self._anew, self.closed, self.joined = anew, 0, 0

    def advertise(self, topic: str, message_type: str, *, qos: Qos) -> bool:
        raise AssertionError("it is asked whether somebody is reached, which it cannot know")

    def subscribers(self, topic: str) -> list[GraphEndpoint]:
        return [GraphEndpoint(name, TWIST) for name in (self.dead, *self.robots)]

    def rejoined(self) -> RobotLink:
        self.joined += 1
        self._anew.close = self.note_closed  # type: ignore[attr-defined]
        return self._anew  # type: ignore[return-value]

    def note_closed(self) -> None:
        self.closed += 1


class AtOnce(ThreadPoolExecutor):
    """Does what is submitted before the next look at the clock, which stands still meanwhile."""

    def submit(self, todo: Any, /, *arguments: Any) -> Future[Any]:  # type: ignore[override]
        future = super().submit(todo, *arguments)
        wait([future])
        return future


@pytest.fixture
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(commanded_topics, "ThreadPoolExecutor", AtOnce)


def test_a_dead_run_that_is_listed_is_not_waited_for_and_who_joins_after_its_death_tells_who_is_reached(
    clock: FakeClock, at_once: None
) -> None:
    anew = Told(clock, 2.0)
    link = Left(clock, anew)
    assert keep_commanding_zero(link, [(TOPIC, TWIST)]) == []
    assert clock.now() < commanded_topics._REACHING
    assert (link.joined, link.closed) == (1, 1)
    assert min(link.heard, anew.heard) > 2, "both command until it is known"


def test_a_robot_that_is_not_found_beside_a_dead_run_is_not_reached(clock: FakeClock, at_once: None) -> None:
    with pytest.raises(LinkError, match="subscription is not reached within"):
        keep_commanding_zero(Left(clock, Told(clock, 3600.0)), [(TOPIC, TWIST)])


def test_a_dead_run_is_no_robot(clock: FakeClock, at_once: None) -> None:
    link = Left(clock, Told(clock, 3600.0))
    link.robots = ()
    assert keep_commanding_zero(link, [(TOPIC, TWIST)]) == [NOBODY]


class Remote(Told):
    """A simulated robot on another computer, whose process has a number that no process has here."""

    def subscribers(self, topic: str) -> list[GraphEndpoint]:
        return [GraphEndpoint(Left.dead, TWIST)]


def test_a_node_of_ours_on_another_computer_is_a_robot(clock: FakeClock, at_once: None) -> None:
    assert keep_commanding_zero(Remote(clock, 0.0), [(TOPIC, TWIST)]) == []
    link = Left(clock, Remote(clock, 0.0))
    link.robots = ()
    assert keep_commanding_zero(link, [(TOPIC, TWIST)]) == []


class Slow(Left):
    """Where the graph cannot be joined once more, it is asked itself."""

    def advertise(self, topic: str, message_type: str, *, qos: Qos) -> bool:
        return self._clock.now() > 6.0

    def rejoined(self) -> RobotLink:
        raise LinkError("the graph cannot be joined")


def test_where_nobody_can_join_after_a_death_the_link_is_asked_itself(clock: FakeClock, at_once: None) -> None:
    assert keep_commanding_zero(Slow(clock, Told(clock, 0.0)), [(TOPIC, TWIST)]) == []
    assert 6.0 < clock.now() < commanded_topics._REACHING


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
