"""Measures of a robot's way that no action reports: its length, and the distance of the closest obstacle."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from robot_runner.core.errors import Finding, LinkError, PluginError
from robot_runner.core.events.context import Clock, RobotRunnerContext
from robot_runner.core.events.measure import Measure
from robot_runner.core.links.graph_names import GraphNeed
from robot_runner.core.links.robot import Message, RobotLink
from robot_runner.ros.sole_control import sole_publisher_findings
from robot_runner.ros.transform_buffer import TransformBuffer
from robot_runner.ros.turtlebot3.odometry import (
    ODOMETRY,
    CoarseLengths,
    CoarseWay,
    Jump,
    Odometer,
    Unseen,
    noise_finding,
)

if TYPE_CHECKING:
    from robot_runner.ros.transforms import Transform

PATH_LENGTH = Measure("PathLength", "m", "Way covered during the mission, by odometry.", low=0.0)
CLOSEST_OBSTACLE = Measure("ClosestObstacle", "m", "The shortest range of the laser scanner during the mission.")
_SCAN, _TRANSFORMS = "sensor_msgs/LaserScan", "tf2_msgs/TFMessage"
_FIX = "Check whether the robot publishes it, or leave the parameter out."
_FIX_SILENCE = "Look at the network, and whether what publishes it kept up: `ros2 topic hz` or `rostopic hz`."
_PAIR = 2
#: For how long the robot's position may be missing, s, before its way is doubted.
_SILENCE = 2.0
#: How far stamps may go back, s, as messages overtake each other; a reset of a simulator sets them back by more.
_SET_BACK = 1.0
#: No robot is faster, m/s, also one that does not tell its speed: the odometry was reset, or the robot was placed
#: elsewhere in a simulation.
_FASTEST = 100.0


class WayMeasures:
    """Follows odometry or transforms, and laser scans, during a mission, as requested: None of a topic leaves it out.

    `frames` are, instead of odometry, the one in which the robot moves, and the robot's own: `("map", "base_link")`.
    `measures` are those that `end_mission` returns; `where` is the plugin, for errors.

    Raises:
        PluginError: the frames are not a pair of names, or both odometry and frames are given.
    """

    def __init__(
        self, odometry: str | None, scan: str | None, frames: Sequence[str] | None, *, where: str, tf_topic: str = "/tf"
    ) -> None:
        if frames is not None and (isinstance(frames, str) or len(frames) != _PAIR or not all(map(_is_name, frames))):
            fix = "Name the frame that stands still and the robot's: ('map', 'base_link')."
            raise PluginError(f"path_frames is {frames!r}", where=where, fix=fix)
        if frames is not None and odometry is not None:
            problem = "the path cannot come from odometry and from transforms at the same time"
            raise PluginError(problem, where=where, fix="Leave out odometry or path_frames.")
        self._odometry, self._scan, self._frames = odometry, scan, frames
        self._where, self._tf_topic = where, tf_topic
        path = [] if odometry is None and frames is None else [PATH_LENGTH]
        if frames is not None:
            path = [replace(PATH_LENGTH, description=f"Way of {frames[1]} in {frames[0]} during the mission, by tf.")]
        self.measures: Sequence[Measure] = (*path, *([CLOSEST_OBSTACLE] if scan else []))
        self._way: Odometer | _WayOfFrame | None = None
        self._way_before: float | None = None
        self._coarse_before = CoarseLengths()
        self._closest: float | None = None
        self._scans = self._too_near = 0
        self._clock: Clock | None = None
        self._scanned_at = self._longest_pause = 0.0
        self._rivals: Callable[[], Iterable[Finding]] = tuple
        self._closing = ExitStack()

    def required(self) -> Iterable[GraphNeed]:
        """Return the needed topics."""
        if self._odometry is not None:
            yield GraphNeed.published(self._odometry, ODOMETRY, is_sole=True, fix=_FIX)
        if self._frames is not None:
            yield GraphNeed.published(self._tf_topic, _TRANSFORMS, fix=f"{_FIX} On which topic, tf_topic says.")
        if self._scan is not None:
            yield GraphNeed.published(self._scan, _SCAN, fix=_FIX)

    def begin(self, link: RobotLink, context: RobotRunnerContext, *, timeout: float) -> None:
        """Subscribe, and wait for the robot's position; raise a `LinkError` if it is not known within `timeout` (s)."""
        self._closing.close()
        self._clock = context.clock
        self._way_before = self._closest = None
        if self._odometry is not None:
            odometer = Odometer(
                context.clock, timeout=_SILENCE, where=self._where, fastest=_FASTEST, needs_heading=False
            )
            self._closing.callback(link.subscribe(self._odometry, ODOMETRY, odometer.take, is_prompt=True).close)
            odometer.wait(timeout)
            self._way = odometer
            self._rivals = partial(sole_publisher_findings, link, self._odometry, self._where)
        if self._frames is not None:
            self._way = _WayOfFrame(self._tf_topic, *self._frames)
            self._way.begin(link, self._closing, context.clock, timeout)
        if self._scan is not None:
            self._closing.callback(link.subscribe(self._scan, _SCAN, self._take_scan, is_prompt=True).close)

    def begin_mission(self) -> None:
        """Measure from now on."""
        self._closest, self._scans, self._too_near = None, 0, 0
        self._scanned_at, self._longest_pause = 0.0 if self._clock is None else self._clock.now(), 0.0
        if self._way is not None:
            self._way_before, self._way.set_back, self._way.unseen = self._way.travelled, 0.0, Unseen()
            self._coarse_before = self._way.coarse.lengths
        if isinstance(self._way, Odometer):
            self._way.jump = Jump()

    def end_mission(self, context: RobotRunnerContext) -> dict[str, float | None]:
        """Return the values since `begin_mission`; a value that is not known is doubted."""
        values: dict[str, float | None] = {}
        if self._way is not None and self._way_before is not None:
            values[PATH_LENGTH.name] = length = self._way.travelled - self._way_before
            try:
                self._way.pose()
                doubts = [*self._rivals()]  # messages of two sources in turn add up to any length
            except LinkError as error:
                doubts = [error.as_finding()]
            if self._way.set_back > _SET_BACK:
                problem = (
                    f"the time of what tells the robot's place went back by {self._way.set_back:.1f} s during the "
                    "mission: whatever lies between the places before and after counts as its way"
                )
                doubts.append(Finding.warning(self._where, problem, "See that nothing resets it while a run goes on."))
            if (unseen := self._way.unseen).seconds > _SILENCE:
                problem = (
                    f"the robot's place was not reported for {unseen.seconds:.1f} s, in which it changed by "
                    f"{unseen.step:.2f} m: whatever the way was between counts as a straight line"
                )
                doubts.append(Finding.warning(self._where, problem, _FIX_SILENCE))
            noise = noise_finding(self._where, length, self._coarse_before, self._way.coarse.lengths)
            doubts += [] if noise is None else [noise]
            doubts += self._way.findings if isinstance(self._way, _WayOfFrame) else []
            for each in doubts:
                context.doubt(each.problem, fix=each.fix, measures=[PATH_LENGTH.name])
        if self._scan is not None:
            values[CLOSEST_OBSTACLE.name] = self._closest
            if not self._scans:
                problem = f"no laser scan came on {self._scan!r} during the mission"
                context.doubt(problem, fix=_FIX, measures=[CLOSEST_OBSTACLE.name])
            elif (pause := max(self._longest_pause, context.clock.now() - self._scanned_at)) > _SILENCE:
                problem = f"no laser scan came on {self._scan!r} for {pause:.1f} s of the mission"
                context.doubt(problem, fix=_FIX_SILENCE, measures=[CLOSEST_OBSTACLE.name])
            if self._too_near:
                problem = f"{self._too_near} of {self._scans} laser scans saw something too near to measure"
                fix = "Take the closest obstacle of this run to be nearer than the scanner's least range (range_min)."
                context.doubt(problem, fix=fix, measures=[CLOSEST_OBSTACLE.name])
        return values

    def close(self) -> None:
        """End the subscriptions; closing twice does nothing."""
        self._closing.close()

    def _take_scan(self, message: Message) -> None:
        self._scans += 1
        if self._clock is not None:
            now = self._clock.now()
            self._longest_pause, self._scanned_at = max(self._longest_pause, now - self._scanned_at), now
        near, far = message["range_min"], message["range_max"]
        # Ranges beyond the bounds say nothing, except that -inf is an object too near (REP 117); NaN compares as False.
        self._too_near += -math.inf in message["ranges"]
        # A scanner may have no greatest or no least range: inf and 0 mean that nothing was seen, also then.
        seen = min((each for each in message["ranges"] if near <= each <= far and 0 < each < math.inf), default=None)
        if seen is not None and (self._closest is None or seen < self._closest):
            self._closest = float(seen)


def _is_name(frame: object) -> bool:
    return isinstance(frame, str) and bool(frame)


class _WayOfFrame:
    """The way of one frame in another, from transforms.

    Attributes:
        travelled: the way so far, m; a correction of the position by localisation counts, too.
        set_back: the most by which the stamps went back from one position to the next, s.
        unseen: the longest time between two positions that differ.
        coarse: the same way, measured coarsely.
    """

    def __init__(self, topic: str, fixed: str, moving: str) -> None:
        self.travelled = self.set_back = 0.0
        self.unseen = Unseen()
        self.coarse = CoarseWay()
        self._topic, self._fixed, self._moving = topic, fixed, moving
        self._buffer = TransformBuffer()
        self._last: Transform | None = None
        self._clock: Clock | None = None
        self._told_at = 0.0

    def begin(self, link: RobotLink, opened: ExitStack, clock: Clock, timeout: float) -> None:
        """Follow the frame until `opened` is closed; raise a `LinkError` if it is not known within the timeout."""
        self._clock = clock
        self._buffer.subscribe(link, opened, topic=self._topic)
        opened.callback(link.subscribe(self._topic, _TRANSFORMS, self._take, is_prompt=True).close)
        self._buffer.wait_for(self._fixed, self._moving, clock, timeout=timeout)

    def pose(self) -> Transform:
        """Return the frame's position; raise a `LinkError` if it is no longer known."""
        silence = 0.0 if self._clock is None or self._last is None else self._clock.now() - self._told_at
        if silence > _SILENCE:
            problem = f"where {self._moving!r} is in {self._fixed!r} was not reported for {silence:.1f} s"
            raise LinkError(problem, where="tf", fix="Check whether localisation and odometry are alive.")
        return self._buffer.look_up(self._fixed, self._moving)

    @property
    def findings(self) -> Sequence[Finding]:
        """The faults of the transforms between both frames, except stamps that went back (`set_back`)."""
        try:
            between = self._buffer.between(self._fixed, self._moving)
        except LinkError:
            return ()
        told = [each for each in self._buffer.findings if "jump back" not in each.problem]
        return [each for each in told if any(repr(frame) in each.problem for frame in between)]

    def _take(self, message: Message) -> None:
        del message  # the buffer has it
        try:
            now = self._buffer.look_up(self._fixed, self._moving)
        except LinkError:  # this part of the tree is not known yet
            return
        if self._clock is not None and (self._last is None or now.time is None or now.time != self._last.time):
            self._told_at = self._clock.now()
        self.coarse.take(now.time or 0.0, now.translation)
        if self._last is not None:
            self.travelled += (step := math.dist(now.translation, self._last.translation))
            later = (now.time or 0.0) - (self._last.time or 0.0)
            self.set_back, self.unseen = max(self.set_back, -later), self.unseen.after(later, step)
        self._last = now
