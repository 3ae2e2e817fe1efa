"""A robot link behind which an ideal robot drives."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

from robot_runner.core.links.graph_names import full_name
from robot_runner.core.links.robot import Message, Qos
from robot_runner.ros.shapes import plain_type
from robot_runner.ros.watchdog import velocity_of
from robot_runner.testing.fake_robot import Answer, FakeRobotLink

if TYPE_CHECKING:
    from robot_runner.testing.fake_run import FakeClock


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
        self.known_topics = {"cmd_vel": "geometry_msgs/Twist", "odom": "nav_msgs/Odometry"}
        self.x = self.y = self.heading = 0.0
        self.slip = slip
        self.odometry_ends_at = math.inf
        self.working_on: str | None = None
        self._speed = self._rate = 0.0
        self._moved_until = clock.now()
        clock.every(1 / 30, self._tell)

    def publish(self, topic: str, message_type: str, message: Message, *, qos: Qos = Qos.DEFAULT) -> None:
        """Record the message; a velocity command holds until the next."""
        super().publish(topic, message_type, message, qos=qos)
        if full_name("", topic) == "/cmd_vel":
            self._move()
            twist = velocity_of(plain_type(message_type), message)
            self._speed = float(twist.get("linear", {}).get("x", 0.0)) * (1.0 - self.slip)
            self._rate = float(twist.get("angular", {}).get("z", 0.0)) * (1.0 - self.slip)

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
