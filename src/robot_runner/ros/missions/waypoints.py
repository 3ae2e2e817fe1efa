"""The mission from waypoint to waypoint for a robot with velocity commands only, in a closed loop on its odometry."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, ClassVar

from robot_runner.core.errors import Finding, LinkError, PluginError
from robot_runner.core.events.context import RobotRunnerContext
from robot_runner.core.events.measure import Measure
from robot_runner.core.links.connect import connect_robot, is_simulated, robot_namespace
from robot_runner.measuring.parameter_checks import check_numbers
from robot_runner.ros.simulators.simulation_system import Simulation
from robot_runner.ros.turtlebot3.motion import COMMAND_TOPIC, Ramp
from robot_runner.ros.turtlebot3.odometry import POSE_TOPIC, Odometer, Pose, noise_finding, wrapped
from robot_runner.ros.turtlebot3.steered_robot import Robot, SteeredSystem

if TYPE_CHECKING:
    from robot_runner.core.plugin import Circumstances

#: Multiples of the cruising speed: the greatest command, so that errors can be corrected, and the speed beyond which a
#: change of the odometry counts as a jump.
_HEADROOM, _JUMPING = 1.25, 5.0
#: The least speed that counts as a jump, m/s: the odometry of a slow robot rounds, too.
_SLOWEST_JUMP = 1.3
#: Ways and turns below these are not driven, m and rad.
_NO_WAY, _NO_TURN = 0.005, 0.01
#: How often the robot tries to reach a waypoint.
_MOST_TRIES = 4
#: A robot whose pose changes by less than this in one period, m, rad and s, stands still; after so many periods it is
#: taken to, as an odometry with noise never stands still.
_STILL_WAY, _STILL_TURN, _STILL_PERIOD, _MOST_PERIODS = 0.001, 0.005, 0.2, 5
_SHORTEST = 2
#: Beyond a full turn, rad, a yaw is probably in degrees.
_MOST_YAW = math.tau + 1e-9


@dataclass(frozen=True, slots=True)
class _Waypoint:
    x: float
    y: float
    yaw: float | None


class Waypoints(SteeredSystem):
    """Drives from waypoint to waypoint: on the spot to face it, straight to it, and on the spot to the yaw there.

    At the last waypoint the robot comes to rest before its errors are taken. Each leg is a phase of the mission,
    `leg_1`, `leg_2` and so on, which the config's `phases` may name. The way is written to `trajectory.csv`.

    Args:
        waypoints: each `(x, y)` or `(x, y, yaw)` in m and rad; `treatment(...)` may stand for any number.
        name: tells several robots apart; the class's name if left out.
        namespace: the robot's ROS namespace, such as `/alice`.
        relative_to: `odom` for the frame of the odometry, `start` for the robot's pose when the mission begins.
        speed: the cruising speed, m/s.
        turn_rate: the same for a turn, rad/s.
        tolerance_m: the greatest distance from a waypoint, m.
        tolerance_rad: the greatest error of its yaw, rad.
        command_topic: of the robot's velocity commands: `Twist`, or `TwistStamped` where it subscribes that.
        odometry_topic: of its `nav_msgs/Odometry`.
        connect_timeout_s: how long to wait for the robot's first odometry, s.
        odometry_timeout_s: how long the odometry may be silent before the mission is broken off, s.
        sole_control: whether a run fails if another node commands the robot, or more than one publishes its odometry;
            if False, the run's values are doubtful then.

    Raises:
        PluginError: there is no waypoint, or a parameter is out of its range.

    Example:
        >>> [measure.name for measure in Waypoints([(1.0, 0.0), (0.0, 0.0, 0.0)]).measures]
        ['Duration', 'Distance', 'FinalError', 'FinalYawError', 'Leg1', 'Leg2']
    """

    #: The common measures; an instance has the duration of each leg, too, and no yaw error if no yaw is given.
    measures: Sequence[Measure] = (
        Measure("Duration", "s", "Duration of the mission on the run's clock."),
        Measure("Distance", "m", "Way covered during its whole mission, by odometry."),
        Measure("FinalError", "m", "How far from the last waypoint the robot ended, by odometry."),
        Measure("FinalYawError", "rad", "How far from the last waypoint's yaw it ended, where that has one."),
    )
    needs: ClassVar[str] = "A robot with odometry and velocity commands, or robot='simulated'."

    def __init__(  # noqa: PLR0913 - one keyword for each thing in which robots and studies differ
        self,
        waypoints: Sequence[Sequence[float]],
        *,
        name: str | None = None,
        namespace: str = "",
        relative_to: str = "odom",
        speed: float = 0.2,
        turn_rate: float = 1.0,
        tolerance_m: float = 0.05,
        tolerance_rad: float = 0.1,
        command_topic: str = COMMAND_TOPIC,
        odometry_topic: str = POSE_TOPIC,
        connect_timeout_s: float = 5.0,
        odometry_timeout_s: float = 1.0,
        sole_control: bool = True,
    ) -> None:
        super().__init__(
            name=name,
            namespace=namespace,
            connect_timeout_s=connect_timeout_s,
            odometry_timeout_s=odometry_timeout_s,
            sole_control=sole_control,
        )
        self.waypoints = _checked_waypoints(waypoints, self.name)
        if relative_to not in {"odom", "start"}:
            raise PluginError(f"relative_to is {relative_to!r}", where=self.name, fix="Say 'odom' or 'start'.")
        check_numbers(self.name, speed=speed, turn_rate=turn_rate, tolerance_m=tolerance_m, tolerance_rad=tolerance_rad)
        self.relative_to = relative_to
        self.speed, self.turn_rate = float(speed), float(turn_rate)
        self.tolerance_m, self.tolerance_rad = float(tolerance_m), float(tolerance_rad)
        self.command_topic, self.odometry_topic = command_topic, odometry_topic
        self.commands = (command_topic,)
        with_yaw = self.waypoints[-1].yaw is not None
        legs = (
            Measure(f"Leg{number}", "s", f"Duration of leg {number}: until waypoint {number} was reached.")
            for number in range(1, len(self.waypoints) + 1)
        )
        self.measures = (*type(self).measures[: None if with_yaw else -1], *legs)

    def check(self, circumstances: Circumstances) -> Iterable[Finding]:
        """Yield findings: no robot; a start that differs between runs; yaws that are probably in degrees."""
        yield from super().check(circumstances)
        for each in self.waypoints:
            if each.yaw is not None and abs(each.yaw) > _MOST_YAW:
                problem = f"the yaw {each.yaw:g} rad of a waypoint is more than a full turn"
                fix = f"Yaws are in rad: {each.yaw:g} degrees are {math.radians(each.yaw):.4g}."
                yield Finding.warning(f"plugin {self.name}", problem, fix)
        last = self.waypoints[-1]
        if math.hypot(last.x, last.y) > self.tolerance_m and self._is_left_where_it_ends(circumstances):
            problem = f"the way ends at ({last.x:g}, {last.y:g}), and from there the next run sets out"
            fix = (
                "Let it end where the first run sets out, mostly at (0, 0); or count from where the robot stands "
                "(relative_to='start'), and have it put back before each run."
            )
            yield Finding.warning(f"plugin {self.name}", problem, fix)

    def _is_left_where_it_ends(self, circumstances: Circumstances) -> bool:
        """Whether the robot is not put back between runs, and must not be, as the odometry would not notice."""
        robot = circumstances.robot
        is_reset = any(isinstance(each, Simulation) and each.reset != "none" for each in circumstances.plugins)
        return self.relative_to == "odom" and robot is not None and not (is_simulated(robot) or is_reset)

    def duration_s(self, combination: Mapping[str, Any]) -> float | None:
        """Return the duration of all legs, s; None where the start of the first is not known."""
        del combination
        if self.relative_to != "start":
            return None
        total, here, heading = 0.0, (0.0, 0.0), 0.0
        for each in self.waypoints:
            way, bearing = math.dist(here, (each.x, each.y)), math.atan2(each.y - here[1], each.x - here[0])
            if way > _NO_WAY:
                total += self._turning(wrapped(bearing - heading)) + Ramp.covering(way, self.speed).seconds
                heading = bearing
            if each.yaw is not None:
                total, heading = total + self._turning(wrapped(each.yaw - heading)), each.yaw
            here = (each.x, each.y)
        return total + _STILL_PERIOD

    def _turning(self, angle: float) -> float:
        return Ramp.covering(angle, self.turn_rate).seconds if abs(angle) > _NO_TURN else 0.0

    def launch_mission(self, context: RobotRunnerContext) -> None:
        """Drive from waypoint to waypoint; the robot is stopped in any case.

        Raises:
            LinkError: a waypoint was not reached, the odometry fell silent, or the robot does not move as commanded.
        """
        robot = self.started(self._robot)
        with self.keeping_way(robot, context), ExitStack() as stopping:
            stopping.callback(robot.pilot.stop)
            self._values = self._driven(robot, context)

    def reached(self, context: RobotRunnerContext) -> Robot:
        """Connect to the robot, subscribe its odometry, and return it."""
        fastest = max(_SLOWEST_JUMP, _JUMPING * self.speed)
        odometer = Odometer(context.clock, timeout=self.odometry_timeout_s, where=self.name, fastest=fastest)
        return Robot(
            connect_robot(context, namespace=self.namespace),
            odometer,
            context.clock,
            namespace=robot_namespace(context, self.namespace),
            where=self.name,
            command_topic=self.command_topic,
            pose_topic=self.odometry_topic,
            limits=(_HEADROOM * self.speed, _HEADROOM * self.turn_rate),
            has_tasks=False,
        )

    def _driven(self, robot: Robot, context: RobotRunnerContext) -> list[float]:
        clock, odometer = context.clock, robot.odometer
        start, way_before, legs = odometer.pose(), odometer.travelled, [clock.now()]
        coarse_before = odometer.coarse.lengths
        for number, waypoint in enumerate(self.waypoints, start=1):
            context.share(leg=number, leg_count=len(self.waypoints))
            with context.phase(f"leg_{number}"):
                target = _in_odometry(waypoint, start if self.relative_to == "start" else None)
                here = self._go_to(robot, target, number, context)
            legs.append(clock.now())
        error = math.dist((here.x, here.y), (target.x, target.y))
        yaw_error = [] if target.yaw is None else [abs(wrapped(here.heading - target.yaw))]
        seconds = [later - earlier for earlier, later in pairwise(legs)]
        way = odometer.travelled - way_before
        if noise := noise_finding(self.name, way, coarse_before, odometer.coarse.lengths):
            context.doubt(noise.problem, fix=noise.fix, measures=["Distance"])
        return [legs[-1] - legs[0], way, error, *yaw_error, *seconds]

    def _go_to(self, robot: Robot, target: _Waypoint, number: int, context: RobotRunnerContext) -> Pose:
        """Drive to a waypoint and return the pose there; at the last one the robot stands still."""
        is_last = number == len(self.waypoints)
        here = self._at_rest(robot, context) if is_last and number > 1 else robot.odometer.pose()
        for _ in range(_MOST_TRIES):
            way = math.dist((here.x, here.y), (target.x, target.y))
            if way > self.tolerance_m:
                bearing = math.atan2(target.y - here.y, target.x - here.x)
                self._turn(robot, bearing, context)
                line = Pose(here.x, here.y, bearing)
                robot.pilot.drive(line, Ramp.covering(way, self.speed), context.clock.now())
            elif target.yaw is None or abs(wrapped(target.yaw - here.heading)) <= self.tolerance_rad:
                return here
            else:
                self._turn(robot, target.yaw, context)
            here = self._at_rest(robot, context) if is_last else robot.odometer.pose()
        self._check_reached(here, target, number)
        return here

    def _at_rest(self, robot: Robot, context: RobotRunnerContext) -> Pose:
        """Return the pose of a robot that was stopped, once it has come to rest."""
        here = robot.odometer.pose()
        for _ in range(_MOST_PERIODS):
            context.clock.sleep(_STILL_PERIOD)
            before, here = here, robot.odometer.pose()
            if before.distance_to(here) < _STILL_WAY and abs(wrapped(here.heading - before.heading)) < _STILL_TURN:
                break
        return here

    def _turn(self, robot: Robot, heading: float, context: RobotRunnerContext) -> None:
        here = robot.odometer.pose()
        angle = wrapped(heading - here.heading)
        if abs(angle) > _NO_TURN:
            robot.pilot.turn(here, Ramp.covering(angle, self.turn_rate), context.clock.now())

    def _check_reached(self, here: Pose, target: _Waypoint, number: int) -> None:
        off = math.dist((here.x, here.y), (target.x, target.y))
        turned = 0.0 if target.yaw is None else abs(wrapped(target.yaw - here.heading))
        if off > self.tolerance_m or turned > self.tolerance_rad:
            problem = f"the robot is {off:.2f} m and {turned:.2f} rad off waypoint {number} after {_MOST_TRIES} tries"
            fix = "Check whether its way is free and its wheels grip, or give larger tolerances."
            raise LinkError(problem, where=self.name, fix=fix)


def _in_odometry(waypoint: _Waypoint, start: Pose | None) -> _Waypoint:
    """Return a waypoint in the frame of the odometry; `start` is the origin of its frame, None for the odometry's."""
    if start is None:
        return waypoint
    cos, sin = math.cos(start.heading), math.sin(start.heading)
    yaw = None if waypoint.yaw is None else waypoint.yaw + start.heading
    x, y = waypoint.x * cos - waypoint.y * sin, waypoint.x * sin + waypoint.y * cos
    return _Waypoint(start.x + x, start.y + y, yaw)


def _checked_waypoints(given: object, where: str) -> tuple[_Waypoint, ...]:
    fix = "Give a list of places in m, with the yaw there in rad if it matters: [(1.0, 0.0), (0.0, 0.0, 0.0)]."
    if isinstance(given, str) or not isinstance(given, Sequence) or not given:
        raise PluginError(f"waypoints is {given!r}", where=where, fix=fix)
    for each in given:
        is_place = isinstance(each, Sequence) and not isinstance(each, str) and len(each) in {_SHORTEST, _SHORTEST + 1}
        if not is_place or not all(_is_number(value) for value in each):
            raise PluginError(f"{each!r} is not a waypoint", where=where, fix=fix)
    return tuple(_Waypoint(float(x), float(y), float(yaw[0]) if yaw else None) for x, y, *yaw in given)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
