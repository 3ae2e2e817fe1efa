"""Movement in a closed loop on the odometry: along a line and on the spot, over a given time."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from robot_runner.core.errors import LinkError
from robot_runner.core.events.context import Clock
from robot_runner.core.links.commanded_topics import TWISTS, commanded_type
from robot_runner.core.links.graph_names import full_name
from robot_runner.core.links.robot import Advertiser, RobotLink
from robot_runner.ros.graph_transport import is_simulated_time
from robot_runner.ros.turtlebot3.odometry import Odometer, Pose, wrapped
from robot_runner.ros.watchdog import TWIST, velocity_command

#: The topic of the robot's velocity commands.
COMMAND_TOPIC = "cmd_vel"


class Wheels:
    """Commands a robot's velocity: as `TwistStamped` where its graph uses that, otherwise as `Twist`.

    A TurtleBot3 subscribes `Twist` up to ROS 2 Humble, and `TwistStamped` by default from Jazzy on. A robot that cannot
    be reached, or subscribes neither type, is a `LinkError`.

    Example:
        >>> from robot_runner.testing import FakeClock, FakeRobotLink
        >>> link = FakeRobotLink(FakeClock())
        >>> link.known_topics = {"cmd_vel": "geometry_msgs/TwistStamped"}
        >>> Wheels(link).command(0.2, 0.0)
        >>> link.publications[-1].message["twist"]["linear"]["x"]
        0.2
    """

    def __init__(self, link: RobotLink, *, namespace: str = "", topic: str = COMMAND_TOPIC) -> None:
        self._link = link
        self._own_topic = topic
        self._topic = full_name(namespace, topic)
        self._type: str | None = None

    def command(self, speed: float, rate: float) -> None:
        """Move ahead at `speed` in m/s and turn at `rate` in rad/s until the next command."""
        is_known, message_type = self._type is not None, self._type or self._subscribed_type()
        try:
            self._link.publish(self._own_topic, message_type, velocity_command(message_type, speed, rate))
        except LinkError:  # on a graph that was just joined, the robot may have been discovered meanwhile
            if is_known or (told := self._subscribed_type()) == message_type:
                raise
            self._link.publish(self._own_topic, told, velocity_command(told, speed, rate))

    def get_ready(self, *, awaits: bool = True) -> None:
        """Wait for the subscriber of commands: its discovery may take seconds, which must not be measured.

        Unless it `awaits`, it does not wait for a subscriber that nobody has seen yet, and whose type is not known.
        """
        message_type = self._type or self._subscribed_type()
        if isinstance(self._link, Advertiser) and (awaits or self._type is not None):
            self._link.advertise(self._own_topic, message_type)

    def _subscribed_type(self) -> str:
        known = commanded_type(self._topic)
        try:
            listening = [each for each in self._link.subscribers(self._topic) if each.may_be_others]
        except LinkError:  # rosapi may have ended, and a robot that was commanded is to be stopped all the same
            if known is None:
                raise
            return known
        subscribed = TWISTS.intersection(each.message_type for each in listening)
        # Of both, the one that every robot takes. A topic that was commanded keeps its type, whatever subscribes now.
        self._type = min(subscribed) if subscribed else known
        # Where it is another type, publishing says so; where there is none yet, it is asked for again next time.
        return self._type or TWIST


#: Burger, from ROBOTIS' e-manual (https://emanual.robotis.com/docs/en/platform/turtlebot3/features/): m/s and rad/s.
MAXIMUM_SPEED = 0.22
MAXIMUM_TURN_RATE = 2.84
#: Commands a second: the Burger's own odometry comes at about 30 Hz.
_CONTROL_PERIOD = 0.05
_LONGEST_RAMP = 1.0  # s from standing to cruising
#: The last moments of a movement, s, in which the robot only corrects its error.
_LONGEST_SETTLING = 0.5
#: Shorter sleeps are left out, s: clocks round.
TICK = 0.001
#: Gains, 1/s. A loop of this kind with a delay of T swings where gain x T exceeds 1/e; odometry, commands and motors
#: together take about 0.15 s.
_ALONG_GAIN = 2.0
_HEADING_GAIN = 2.0
#: How long a robot may be behind its way before it counts as blocked, s: a busy laptop makes it late by tenths.
_LONGEST_LAG = 5.0
#: How far ahead on its line the robot looks to get back to it, m.
_LOOK_AHEAD = 0.4


@dataclass(frozen=True, slots=True)
class Ramp:
    """A way from 0 to `way`: speeding up evenly, cruising, slowing down evenly, and a moment to settle.

    Attributes:
        way: m or rad; may be negative.
        seconds: how long it all takes, s.

    Example:
        >>> ramp = Ramp(way=8.5, seconds=10.0)
        >>> ramp.cruise, ramp.at(0.5), ramp.at(9.5)
        (1.0, (0.125, 0.5), (8.5, 0.0))
    """

    way: float
    seconds: float

    @classmethod
    def cruising(cls, speed: float, seconds: float) -> Ramp:
        """Return the ramp of this duration whose cruising speed is `speed`."""
        return cls(speed * (_moving_time(seconds) - _rise_time(seconds)), seconds)

    @classmethod
    def covering(cls, way: float, speed: float) -> Ramp:
        """Return the ramp over this way whose cruising speed is `speed`: the shorter the way, the shorter its parts.

        Example:
            >>> round(abs(Ramp.covering(-1.5, 0.2).cruise), 6)
            0.2
        """
        cruising = abs(way) / speed
        for begins_at, lost, share in _RAMP_PARTS:
            seconds = (cruising + lost) / share
            if seconds >= begins_at:
                return cls(way, seconds)
        raise ValueError(f"no ramp covers {way!r} at {speed!r}")

    @property
    def cruise(self) -> float:
        """The speed between speeding up and slowing down."""
        return self.way / (_moving_time(self.seconds) - _rise_time(self.seconds))

    def at(self, time: float) -> tuple[float, float]:
        """Return how far the way has got after so many seconds, and the speed there."""
        rise, cruise, left = _rise_time(self.seconds), self.cruise, _moving_time(self.seconds) - time
        if time <= 0:
            return 0.0, 0.0
        if left <= 0:
            return self.way, 0.0
        if time < rise:
            return cruise * time * time / (2 * rise), cruise * time / rise
        if left < rise:
            return self.way - cruise * left * left / (2 * rise), cruise * left / rise
        return cruise * (time - rise / 2), cruise


#: Of a ramp that lasts so long or longer (s): what is lost (s), and the share of its duration that its way at cruising
#: speed takes with that. It follows from `_rise_time` and `_moving_time`: way = cruise x (moving - rise).
_RAMP_PARTS = (
    (5.0, _LONGEST_RAMP + _LONGEST_SETTLING, 1.0),
    (4.0, _LONGEST_RAMP, 0.9),
    (0.0, 0.0, 0.65),
)


def _rise_time(seconds: float) -> float:
    return min(_LONGEST_RAMP, seconds / 4)


def _moving_time(seconds: float) -> float:
    return seconds - min(_LONGEST_SETTLING, seconds / 10)


@dataclass(slots=True)
class Pilot:
    """Moves one robot. Callers must call `stop` in the end, in any case.

    Methods raise a `LinkError` if the odometry fell silent, or the robot cannot be reached or does not move. The limits
    are the greatest commands, m/s and rad/s; `where` is the plugin, for errors.
    """

    wheels: Wheels
    odometer: Odometer
    clock: Clock
    where: str
    limits: tuple[float, float]

    def drive(self, start: Pose, ramp: Ramp, begun: float) -> None:
        """Drive straight from `start` along its heading; `begun` is when the way began on the run's clock.

        The line is the requested one, not that on which the robot happens to stand: errors of earlier phases are
        corrected on the way.
        """

        def steer(time: float) -> tuple[float, float]:
            pose, (way, speed) = self.odometer.pose(), ramp.at(time)
            along, across = _beside(start, pose)
            self._check_moving(way - along, ramp, f"{along:.2f} m", f"{way:.2f} m")
            heading = start.heading - math.atan2(across, _LOOK_AHEAD)
            return speed + _ALONG_GAIN * (way - along), _HEADING_GAIN * wrapped(heading - pose.heading)

        self._follow(steer, begun, ramp.seconds)

    def turn(self, start: Pose, ramp: Ramp, begun: float) -> None:
        """Turn on the spot, from the heading of `start` by the way of `ramp` in rad."""

        def steer(time: float) -> tuple[float, float]:
            pose, (way, rate) = self.odometer.pose(), ramp.at(time)
            left = wrapped(start.heading + way - pose.heading)
            self._check_moving(abs(left), ramp, f"{way - left:.2f} rad", f"{way:.2f} rad")
            return 0.0, rate + _HEADING_GAIN * left

        self._follow(steer, begun, ramp.seconds)

    def stop(self) -> None:
        """Command zero; raise a `LinkError` if the robot cannot be reached."""
        self.wheels.command(0.0, 0.0)

    def _check_moving(self, lag: float, ramp: Ramp, covered: str, due: str) -> None:
        # A simulation's time may go by much faster than messages do.
        if lag > _LONGEST_LAG * abs(ramp.cruise) and not is_simulated_time(self.clock):
            problem = f"the robot does not move as it is commanded: it covered {covered} where {due} are due"
            fix = "Check whether its way is free, its motors are on, and its driver obeys the commands."
            raise LinkError(problem, where=self.where, fix=fix)

    def _follow(self, steer: Callable[[float], tuple[float, float]], begun: float, seconds: float) -> None:
        fastest, quickest = self.limits
        while (left := begun + seconds - self.clock.now()) > TICK:
            speed, rate = steer(seconds - left)
            self.wheels.command(_limited(speed, fastest), _limited(rate, quickest))
            self.clock.sleep(min(_CONTROL_PERIOD, left))
        self.stop()


def _beside(start: Pose, pose: Pose) -> tuple[float, float]:
    """Return how far along the line ahead of `start` a pose is, and how far to the left of it, m."""
    east, north = pose.x - start.x, pose.y - start.y
    cos, sin = math.cos(start.heading), math.sin(start.heading)
    return east * cos + north * sin, north * cos - east * sin


def _limited(value: float, limit: float) -> float:
    return max(-limit, min(limit, value))
