"""Measures of a robot's way that no action tells: how long it was, and how near the closest obstacle came."""

from __future__ import annotations

import math
from contextlib import ExitStack
from typing import TYPE_CHECKING

from robot_runner.core.errors import LinkError
from robot_runner.core.events.measure import Measure
from robot_runner.core.links.graph_needs import GraphNeed
from robot_runner.ros.turtlebot3.odometry import ODOMETRY, Odometer

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from robot_runner.core.events.context import RobotRunnerContext
    from robot_runner.core.links.robot import Message, RobotLink

__all__ = ["WayMeasures"]

PATH_LENGTH = Measure("PathLength", "m", "Way covered during the mission, by odometry.", low=0.0)
CLOSEST_OBSTACLE = Measure("ClosestObstacle", "m", "The shortest range of the laser scanner during the mission.")
_SCAN = "sensor_msgs/LaserScan"
_FIX = "Look whether the robot publishes it, or leave the parameter out."


class WayMeasures:
    """Follows odometry and laser scans during a mission, as far as they are asked for.

    Args:
        odometry: topic of `nav_msgs/Odometry`, or None.
        scan: topic of `sensor_msgs/LaserScan`, or None.
        where: the plugin, for errors.

    Attributes:
        measures: what it yields.
    """

    def __init__(self, odometry: str | None, scan: str | None, *, where: str) -> None:
        self._odometry, self._scan = odometry, scan
        self._where = where
        self.measures: Sequence[Measure] = (
            *([PATH_LENGTH] if odometry else []),
            *([CLOSEST_OBSTACLE] if scan else []),
        )
        self._odometer: Odometer | None = None
        self._way_before: float | None = None
        self._closest: float | None = None
        self._scans = 0
        self._closing = ExitStack()

    def required(self) -> Iterable[GraphNeed]:
        """Return the topics that are followed."""
        if self._odometry is not None:
            yield GraphNeed.published(self._odometry, ODOMETRY, fix=_FIX)
        if self._scan is not None:
            yield GraphNeed.published(self._scan, _SCAN, fix=_FIX)

    def begin(self, link: RobotLink, context: RobotRunnerContext, *, timeout: float) -> None:
        """Subscribe, and wait for the first odometry, s.

        Raises:
            LinkError: none came.
        """
        self._closing.close()
        self._way_before = self._closest = None
        if self._odometry is not None:
            # However fast the robot is: what it could drive is its own affair here.
            odometer = Odometer(context.clock, timeout=math.inf, where=self._where, fastest=math.inf)
            self._closing.callback(link.subscribe(self._odometry, ODOMETRY, odometer.take).close)
            odometer.wait(timeout)
            self._odometer = odometer
        if self._scan is not None:
            self._closing.callback(link.subscribe(self._scan, _SCAN, self._take_scan).close)

    def begin_mission(self) -> None:
        """Measure from now on."""
        self._closest, self._scans = None, 0
        if self._odometer is not None:
            self._way_before = self._odometer.travelled

    def end_mission(self, context: RobotRunnerContext) -> dict[str, float | None]:
        """Return what was measured since `begin_mission`; a value that is not known is doubted."""
        values: dict[str, float | None] = {}
        if self._odometer is not None and self._way_before is not None:
            values[PATH_LENGTH.name] = self._odometer.travelled - self._way_before
            try:
                self._odometer.pose()
            except LinkError as error:
                context.doubt(error.problem, fix=error.fix, measures=[PATH_LENGTH.name])
        if self._scan is not None:
            values[CLOSEST_OBSTACLE.name] = self._closest
            if not self._scans:
                problem = f"no laser scan came on {self._scan!r} during the mission"
                context.doubt(problem, fix=_FIX, measures=[CLOSEST_OBSTACLE.name])
        return values

    def close(self) -> None:
        """Follow no more; closing twice does nothing."""
        self._closing.close()

    def _take_scan(self, message: Message) -> None:
        self._scans += 1
        near, far = message["range_min"], message["range_max"]
        # Beyond its bounds a range says nothing (REP 117); NaN compares as False.
        seen = min((each for each in message["ranges"] if near <= each <= far), default=None)
        if seen is not None and (self._closest is None or seen < self._closest):
            self._closest = float(seen)
