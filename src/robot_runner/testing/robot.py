"""Robot links that tests script: one that only records, and one behind which a robot drives."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from robot_runner.errors import LinkError, did_you_mean

if TYPE_CHECKING:
    from robot_runner.events.clock import Clock
    from robot_runner.links.robot import Message
    from robot_runner.testing.clock import FakeClock

__all__ = ["FakeRobotLink", "FakeTurtlebot3Link", "Publication", "ServiceCall"]

_TWIST = "geometry_msgs/Twist"
#: What a service answers: a response, an error to raise, or a function from the request to a response.
Answer = Mapping[str, Any] | Exception | Callable[[Mapping[str, Any]], Mapping[str, Any]]


@dataclass(frozen=True, slots=True)
class Publication:
    """A message that was published to a robot, and when."""

    time: float
    topic: str
    message_type: str
    message: Message


@dataclass(frozen=True, slots=True)
class ServiceCall:
    """A service of a robot that was called, and when."""

    time: float
    service: str
    service_type: str
    request: Message


class _Listener:
    def __init__(self, callback: Callable[[Message], None]) -> None:
        self.callback = callback
        self.is_closed = False

    def close(self) -> None:
        self.is_closed = True


class FakeRobotLink:
    """A `RobotLink` that records what it is told and says what the test has it say.

    Attributes:
        publications: what was published, oldest first.
        calls: the services that were called, oldest first.
        is_closed: whether it was closed.
        fault: raised by whatever is asked of the link, once it is set.

    Example:
        >>> from robot_runner.testing import FakeClock, FakeRobotLink
        >>> link = FakeRobotLink(FakeClock(), services={"lamp/on": {"success": True}})
        >>> heard = []
        >>> subscription = link.subscribe("battery_state", "sensor_msgs/BatteryState", heard.append)
        >>> link.deliver("battery_state", {"voltage": 11.1})
        >>> heard, link.call("lamp/on", "std_srvs/Trigger")
        ([{'voltage': 11.1}], {'success': True})
    """

    def __init__(
        self, clock: Clock, *, services: Mapping[str, Answer] | None = None, is_simulated: bool = False
    ) -> None:
        self.publications: list[Publication] = []
        self.calls: list[ServiceCall] = []
        self.is_closed = False
        self.fault: LinkError | None = None
        self._clock = clock
        self._services = dict(services or {})
        self._is_simulated = is_simulated
        self._listeners: defaultdict[str, list[_Listener]] = defaultdict(list)

    @property
    def is_simulated(self) -> bool:
        """What it was made with."""
        return self._is_simulated

    @property
    def stands_still(self) -> bool:
        """Whether the last velocity command on each topic was one to stand still, or none was given."""
        last = {each.topic: each.message for each in self.publications if each.message_type == _TWIST}
        return not any(map(_moves, last.values()))

    @property
    def topics_heard(self) -> set[str]:
        """The topics that somebody is subscribed to."""
        return {topic for topic, listeners in self._listeners.items() if not all(each.is_closed for each in listeners)}

    def publish(self, topic: str, message_type: str, message: Message) -> None:
        """Record the message.

        Raises:
            LinkError: the link was closed, or the fault that was set.
        """
        self._check()
        self.publications.append(Publication(self._clock.now(), topic, message_type, message))

    def subscribe(self, topic: str, message_type: str, callback: Callable[[Message], None]) -> _Listener:
        """Have `callback` called with what is delivered on the topic.

        Raises:
            LinkError: the link was closed, or the fault that was set.
        """
        del message_type
        self._check()
        listener = _Listener(callback)
        self._listeners[topic].append(listener)
        return listener

    def deliver(self, topic: str, message: Message) -> None:
        """Hand a message to whoever subscribed to the topic."""
        for listener in list(self._listeners[topic]):
            if not listener.is_closed:
                listener.callback(message)

    def call(self, service: str, service_type: str, request: Message | None = None, *, timeout: float = 5.0) -> Message:
        """Record the call and answer as scripted.

        Raises:
            LinkError: no answer was scripted for the service, the link was closed, or the fault that was set.
        """
        del timeout
        self._check()
        self.calls.append(ServiceCall(self._clock.now(), service, service_type, request or {}))
        if service not in self._services:
            raise LinkError(
                f"there is no service {service!r}", where="FakeRobotLink", fix=did_you_mean(service, self._services)
            )
        answer = self._services[service]
        if isinstance(answer, Exception):
            raise answer
        return answer(request or {}) if callable(answer) else answer

    def close(self) -> None:
        """Hear and say no more; closing twice does nothing."""
        self.is_closed = True
        self._listeners.clear()

    def _check(self) -> None:
        if self.fault is not None:
            raise self.fault
        if self.is_closed:
            raise LinkError("the link was closed", where="FakeRobotLink", fix="Use it before the run ends.")


class FakeTurtlebot3Link(FakeRobotLink):
    """A link to an ideal robot: it moves exactly as `cmd_vel` says and tells of it on `odom`, 30 times a second.

    The services of the three tasks answer; `working_on` is the task that is going on.

    Attributes:
        x: where it is, m.
        y: where it is, m.
        heading: where it looks, rad.
        odometry_ends_at: the time from which on its odometry is silent, s.
        slip: what of each movement does not happen, as a share from 0 to 1.

    Example:
        >>> from robot_runner.testing import FakeClock
        >>> clock = FakeClock()
        >>> robot = FakeTurtlebot3Link(clock)
        >>> robot.publish("cmd_vel", "geometry_msgs/Twist", {"linear": {"x": 0.1}})
        >>> clock.sleep(3.0)
        >>> round(robot.x, 3), robot.stands_still
        (0.3, False)
    """

    def __init__(self, clock: FakeClock, *, slip: float = 0.0, is_simulated: bool = False) -> None:
        super().__init__(clock, services=self._task_services(), is_simulated=is_simulated)
        self.x = self.y = self.heading = 0.0
        self.slip = slip
        self.odometry_ends_at = math.inf
        self.working_on: str | None = None
        self._speed = self._rate = 0.0
        self._moved_until = clock.now()
        clock.every(1 / 30, self._tell)

    def publish(self, topic: str, message_type: str, message: Message) -> None:
        """Record the message; a velocity command holds until the next."""
        super().publish(topic, message_type, message)
        if topic == "cmd_vel":
            self._move()
            self._speed = float(message.get("linear", {}).get("x", 0.0)) * (1.0 - self.slip)
            self._rate = float(message.get("angular", {}).get("z", 0.0)) * (1.0 - self.slip)

    def _task_services(self) -> dict[str, Answer]:
        services: dict[str, Answer] = {"task/stop": self._working_on(None)}
        for task in ("computation", "video", "network"):
            services[f"task/{task}/start"] = self._working_on(task)
            services[f"task/{task}/stop"] = self._working_on(None)
        return services

    def _working_on(self, task: str | None) -> Callable[[Message], Message]:
        def answer(request: Message) -> Message:
            del request
            self.working_on = task
            return {"success": True, "message": ""}

        return answer

    def _move(self) -> None:
        """Move as was last commanded until now: along a circle, or straight on where it does not turn."""
        seconds, self._moved_until = self._clock.now() - self._moved_until, self._clock.now()
        half = self._rate * seconds / 2
        chord = self._speed * seconds * (math.sin(half) / half if half else 1.0)
        self.x += chord * math.cos(self.heading + half)
        self.y += chord * math.sin(self.heading + half)
        self.heading += 2 * half

    def _tell(self) -> None:
        self._move()
        if self._clock.now() < self.odometry_ends_at:
            self.deliver("odom", _odometry(self._clock.now(), self.x, self.y, self.heading))


def _odometry(time: float, x: float, y: float, heading: float) -> Message:
    turn = {"x": 0.0, "y": 0.0, "z": math.sin(heading / 2), "w": math.cos(heading / 2)}
    seconds = int(time)
    return {
        "header": {"stamp": {"sec": seconds, "nanosec": int((time - seconds) * 1e9)}, "frame_id": "odom"},
        "child_frame_id": "base_footprint",
        "pose": {"pose": {"position": {"x": x, "y": y, "z": 0.0}, "orientation": turn}},
    }


def _moves(twist: Message) -> bool:
    return any(component for part in ("linear", "angular") for component in twist.get(part, {}).values())
