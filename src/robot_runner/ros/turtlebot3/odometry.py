"""The pose of the robot by its odometry, and its way during a mission."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from robot_runner.core.errors import Finding, LinkError
from robot_runner.core.events.context import Clock
from robot_runner.core.links.robot import Message
from robot_runner.measuring.quality import Column, write_samples
from robot_runner.ros.shapes import nanoseconds_of
from robot_runner.ros.transforms import yaw_of

if TYPE_CHECKING:
    from robot_runner.measuring.live_samples import LiveSamples

#: The topic of the robot's odometry.
POSE_TOPIC = "odom"
ODOMETRY = "nav_msgs/Odometry"
#: How often it is checked whether the first pose has arrived, s.
_POLL = 0.02
#: How fast a pose may change, m/s: what a TurtleBot3 can do, five times over; odometry comes in bursts where a network
#: has to send again, so that the stamps of the robot count, not their arrival.
_FASTEST = 5 * 0.26
#: A change that is too small to be a jump, m: more than five messages of a robot at top speed may be lost for it.
_ROOM = 0.1
#: A robot that tells its speed is not faster than this many times the greatest that it told, if that is more than the
#: noise of a filter, m/s.
_MOST_TOLD, _LEAST_TOLD = 5.0, 0.01
#: Steps of a way that are more than noise, m.
_COARSE = 0.05
#: A way may be longer than its coarse one by this share and so many m before it is said to be noise.
_NOISE_SHARE, _NOISE_ROOM = 0.2, 0.2
#: Nor does a robot go to and fro in so short a time, s, that its way is so many times what it is from moment to moment.
_MOMENT, _MOST_TIMES = 0.5, 2.0
#: A clock that is set, or a message that is overtaken, steps back now and then; two robots on one topic do always.
_MOST_STEPS_BACK = 5
#: Why a pose cannot be used, and the fix.
_NO_NUMBER = (
    "the odometry reported a pose that is not a number (NaN or infinite)",
    "Look at the node that publishes it, such as a filter that has diverged, and start it again.",
)
_NO_DIRECTION = (
    "the odometry has no direction: its orientation is zero in x, y, z and w",
    "Have the node that publishes it fill in the orientation of the pose, and not its position alone.",
)


def wrapped(angle: float) -> float:
    """Return the same direction as an angle from -pi to pi."""
    return math.remainder(angle, math.tau)


@dataclass(frozen=True, slots=True)
class Pose:
    """A place on the floor, m, and a direction, rad anticlockwise from the x axis, in the frame of the odometry."""

    x: float
    y: float
    heading: float

    def distance_to(self, other: Pose) -> float:
        """Return how far the other place is, m.

        Example:
            >>> Pose(0.0, 0.0, 0.0).distance_to(Pose(3.0, 4.0, 1.0))
            5.0
        """
        return math.hypot(other.x - self.x, other.y - self.y)

    def ahead(self, metres: float) -> Pose:
        """Return the pose so far straight ahead."""
        x = self.x + metres * math.cos(self.heading)
        return Pose(x, self.y + metres * math.sin(self.heading), self.heading)

    def turned(self, angle: float) -> Pose:
        """Return the pose turned on the spot by an angle in rad."""
        return Pose(self.x, self.y, self.heading + angle)


class Unseen(NamedTuple):
    """The longest time without a position of the robot, though it changed.

    `seconds` is by the stamps or the arrivals, whichever is less; `step` is the distance of the positions before and
    after, m.
    """

    seconds: float = 0.0
    step: float = 0.0

    def after(self, seconds: float, step: float) -> Unseen:
        """Return the longer of this and a later gap; a gap in which the robot stood still does not count.

        Example:
            >>> Unseen(1.0, 0.2).after(3.0, 0.4).after(9.0, 0.01)
            Unseen(seconds=3.0, step=0.4)
        """
        return Unseen(seconds, step) if step >= _COARSE and seconds > self.seconds else self


class Jump(NamedTuple):
    """A change of the robot's place from one message to the next: its length, m, and how long it took at most, s."""

    step: float = 0.0
    seconds: float = 0.0

    @property
    def speed(self) -> float:
        """How fast a robot must be for it, m/s; 0 if it is too small to be a jump.

        Example:
            >>> Jump(1.1, 0.5).speed, Jump(0.1, 0.0).speed, Jump(0.2, 0.0).speed
            (2.0, 0.0, inf)
        """
        return 0.0 if self.step <= _ROOM else (self.step - _ROOM) / self.seconds if self.seconds > 0 else math.inf


class CoarseLengths(NamedTuple):
    """The length of a way, measured coarsely, m: by steps of 5 cm, and by positions each half second."""

    by_steps: float = 0.0
    by_moments: float = 0.0


class CoarseWay:
    """A way, measured coarsely so that noise adds little.

    Example:
        >>> way = CoarseWay()
        >>> for time, x in enumerate((0.0, 0.01, -0.01, 0.01, 0.06)):
        ...     way.take(time / 10, (x, 0.0, 0.0))
        >>> way.lengths
        CoarseLengths(by_steps=0.06, by_moments=0.06)
    """

    def __init__(self) -> None:
        self._by_steps = self._by_moments = 0.0
        self._step_from: Sequence[float] | None = None
        self._moment = 0.0
        self._moment_from: Sequence[float] = ()
        self._place: Sequence[float] = ()

    @property
    def lengths(self) -> CoarseLengths:
        """How long it has been so far."""
        since = math.dist(self._moment_from, self._place) if self._place else 0.0
        return CoarseLengths(self._by_steps, self._by_moments + since)

    def take(self, time: float, place: Sequence[float]) -> None:
        """Add the position, m, at a time, s."""
        if self._step_from is None:
            self._step_from, self._moment, self._moment_from = place, time, place
        if (step := math.dist(self._step_from, place)) >= _COARSE:
            self._by_steps, self._step_from = self._by_steps + step, place
        if not 0 <= time - self._moment < _MOMENT:
            self._by_moments += math.dist(self._moment_from, place)
            self._moment, self._moment_from = time, place
        self._place = place


def noise_finding(where: str, length: float, before: CoarseLengths, after: CoarseLengths) -> Finding | None:
    """Return a finding of a plugin if much of a way is noise, otherwise None.

    The length is in m; `before` and `after` are by `CoarseWay`, when the way began and ended.

    Example:
        >>> noise_finding("Go", 4.1, CoarseLengths(1.0, 1.0), CoarseLengths(5.0, 5.0)) is None
        True
    """
    by_steps, by_moments = (end - begin for begin, end in zip(before, after, strict=True))
    if (noise := length - by_steps) > _NOISE_ROOM + _NOISE_SHARE * by_steps:
        problem = f"{noise:.2f} m are made of small steps to and fro: without them the way is {by_steps:.2f} m"
    elif length > _NOISE_ROOM + _MOST_TIMES * by_moments:
        told = f"by two places a second the way is {by_moments:.2f} m"
        problem = f"{length:.2f} m are made of steps to and fro: {told}"
    else:
        return None
    fix = "Take a source without noise, such as the odometry of wheels, or do without this value."
    return Finding.warning(where, problem, fix)


class Odometer:
    """Takes `nav_msgs/Odometry` and holds the robot's pose and the way it has covered.

    The odometry may be silent for `timeout` (s); a change of the pose beyond `fastest` (m/s) is a jump; `where` is the
    plugin, for errors. If it `needs_heading`, the robot is steered by its direction, which must then be valid. Of any
    other robot, the velocity that it tells says as well how fast it is.

    Attributes:
        on_pose: called with each pose and its time on the clock; None for no call.
        travelled: the way covered since the first message, m.
        set_back: the most by which the stamps went back from one message to the next, s.
        unseen: the longest time without a message in which the place changed.
        coarse: the same way, measured coarsely.
        jump: the change of the place, from one message to the next, that was the quickest.
    """

    def __init__(
        self, clock: Clock, *, timeout: float, where: str, fastest: float = _FASTEST, needs_heading: bool = True
    ) -> None:
        self.on_pose: Callable[[float, Pose], None] | None = None
        self.set_back = 0.0
        self.unseen = Unseen()
        self.coarse = CoarseWay()
        self.jump = Jump()
        self._fastest = fastest
        self._needs_heading = needs_heading
        self._clock = clock
        self._timeout = timeout
        self._where = where
        self._pose: Pose | None = None
        self._received_at = clock.now()
        self.travelled = 0.0
        self._told_speed = 0.0
        self._height = 0.0
        self._lost: tuple[str, str] | None = None
        self._stamp = 0
        self._steps_back = 0

    def take(self, message: Message) -> None:
        """Take one message."""
        told = message["pose"]["pose"]
        pose, height = _pose_in(told), told["position"].get("z", 0.0)
        turned = told["orientation"].values() if self._needs_heading else ()
        if not all(map(math.isfinite, (pose.x, pose.y, height, *turned))):
            self._lost = _NO_NUMBER
        elif self._needs_heading and math.isnan(pose.heading):
            self._lost = _NO_DIRECTION
        if self._lost is not None:
            return
        stamp, now = nanoseconds_of(message["header"]["stamp"]), self._clock.now()
        if self._pose is not None:
            # The stamps count, as messages may come in bursts; or their arrival, where a robot sends none.
            seconds = max(later := (stamp - self._stamp) * 1e-9, now - self._received_at)
            step = math.hypot(self._pose.distance_to(pose), height - self._height)
            self.travelled += step
            self.set_back = max(self.set_back, -later)
            # After a pause of the network arrivals are far apart, where a clock was set stamps are.
            silence = now - self._received_at
            self.unseen = self.unseen.after(min(later, silence) if later > 0 else silence, step)
            self.jump = max(self.jump, Jump(step, seconds), key=lambda each: each.speed)
        if not self._needs_heading and (velocity := message.get("twist", {}).get("twist", {}).get("linear")):
            self._told_speed = max(self._told_speed, math.hypot(*velocity.values()))
        self.coarse.take(stamp * 1e-9 if stamp else now, (pose.x, pose.y, height))
        self._pose, self._height, self._received_at = pose, height, now
        self._steps_back += stamp < self._stamp
        self._stamp = stamp
        if self.on_pose is not None:
            self.on_pose(self._received_at, pose)

    @property
    def _fastest_possible(self) -> float:
        told = self._told_speed
        return self._fastest if told < _LEAST_TOLD else min(self._fastest, _MOST_TOLD * told)

    def pose(self) -> Pose:
        """Return the robot's pose.

        Raises:
            LinkError: the odometry has been silent for too long, jumped, or contains NaN or no direction, or two robots
                publish theirs on one topic.
        """
        if self._lost is not None:  # with NaN, the controller would command its limits
            problem, fix = self._lost
            raise LinkError(problem, where=self._where, fix=fix)
        if self.jump.speed > self._fastest_possible:
            raise LinkError(
                f"the odometry jumped by {self.jump.step:.2f} m within {self.jump.seconds:.2f} s, "
                "which the robot cannot drive",
                where=self._where,
                fix="See that one robot only publishes it, and that nothing sets it again while a run goes on.",
            )
        if self._steps_back > _MOST_STEPS_BACK:
            problem = f"the time stamps of the odometry went back {self._steps_back} times"
            fix = "See that one robot only publishes it: give each robot a namespace of its own."
            raise LinkError(problem, where=self._where, fix=fix)
        silence = self._clock.now() - self._received_at
        if self._pose is None:
            fix = "Check whether the robot is on and publishes 'odom' on this graph: in this namespace and ROS domain."
            raise LinkError(f"no odometry arrived for {silence:.1f} s", where=self._where, fix=fix)
        if silence > self._timeout:
            problem = f"no odometry arrived for {silence:.1f} s (at most {self._timeout:g} s are allowed)"
            fix = "Check whether the robot is on and its 'odom' topic is alive."
            raise LinkError(problem, where=self._where, fix=fix)
        return self._pose

    def wait(self, patience: float) -> Pose:
        """Return the robot's pose once it is known; raise a `LinkError` if it is not within `patience` seconds."""
        deadline = self._clock.now() + patience
        while self._pose is None and self._lost is None and self._clock.now() < deadline:
            self._clock.sleep(_POLL)
        return self.pose()


def _pose_in(pose: Message) -> Pose:
    position, turn = pose["position"], pose["orientation"]
    return Pose(position["x"], position["y"], yaw_of(turn["x"], turn["y"], turn["z"], turn["w"]))


#: Poses a second: at top speed they are 2 cm apart, finer than any figure of the way shows.
_RATE = 10.0


class Trajectory:
    """Records at most ten poses a second, and writes them when the mission is over.

    Example:
        >>> way = Trajectory()
        >>> for moment in (0.0, 0.03, 0.1):
        ...     way.add(moment, Pose(moment * 0.2, 0.0, 0.0))
        >>> len(way)
        2
    """

    def __init__(self, live: LiveSamples | None = None) -> None:
        self._live = live
        self._rows: list[tuple[float, float, float, float]] = []
        self._due = float("-inf")

    def __len__(self) -> int:
        return len(self._rows)

    def add(self, time: float, pose: Pose) -> None:
        """Add the pose at a time on the run's clock, s; leave it out if it is too soon after the last."""
        if time < self._due - 1e-9:  # clocks round
            return
        self._due = time + 1.0 / _RATE
        self._rows.append((time, pose.x, pose.y, pose.heading))
        if self._live is not None:
            self._live.show(lambda: _columns(self._rows[-1:]))

    def write(self, path: Path) -> None:
        """Write the poses, with times in s, positions in m and headings in rad."""
        write_samples(path, _columns(self._rows))
        if self._live is not None:
            self._live.close()


def _columns(rows: Sequence[tuple[float, float, float, float]]) -> list[Column]:
    columns = list(zip(*rows, strict=True)) or [()] * 4
    names = ("time_s", "x_m", "y_m", "heading_rad")
    return [Column(name, values, "%.4f") for name, values in zip(names, columns, strict=True)]
