"""The system that resets a simulator between runs, checks the reset, and measures the real-time factor."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from typing import ClassVar

from robot_runner.core.errors import Finding, LinkError, PluginError, did_you_mean
from robot_runner.core.events.context import ExperimentContext, RobotRunnerContext
from robot_runner.core.events.measure import Measure
from robot_runner.core.links.connect import connect_robot, is_simulated, robot_namespace
from robot_runner.core.links.graph_names import GraphNeed
from robot_runner.core.links.robot import RobotLink
from robot_runner.core.plugin import Circumstances, System
from robot_runner.measuring.parameter_checks import check_numbers
from robot_runner.ros.graph_links import follows_graph_clock
from robot_runner.ros.robot_system import OfTheRobot
from robot_runner.ros.simulators.simulator_dialects import Demand, Spot, dialect_of
from robot_runner.ros.simulators.unpausing import guard_pauses, guard_pauses_no_more, unpause_from_elsewhere
from robot_runner.ros.simulators.watched_pose import WatchedPose, checked_spot
from robot_runner.ros.simulators.watched_time import CLOCK_TOPIC, WatchedTime

_RESETS = ("world", "simulation", "none")
#: The timeout for a simulator's first time, s: Gazebo publishes it at least ten times a second.
_FIRST_TIME = 2.0
_LOOK = 0.02


class Simulation(OfTheRobot, System):
    """Resets a simulator before each run, checks that robot and time were reset, and measures the real-time factor.

    The simulator is found on the robot's graph. If a run is to start it, list the subject that does before this system:
    `RosLaunch("my_sim", "world.launch.py", arguments={"world": treatment("World")})`. Between runs it is paused.
    List it before the systems that operate the robot, so that they find it reset.

    Args:
        simulator: its kind: `robot_runner` (robot-runner simulate), `gazebo_classic` (ROS 1), `gazebo_classic_ros2`,
            `gz`, `webots`, `isaac`, or `simulation_interfaces` for others that implement that.
        name: tells several simulators apart; the class's name if left out.
        namespace: the robot's, for its pose and for services in this namespace.
        world: for gz, the world's name; for the others, the prefix of their services.
        robot: the name of the robot's model in the simulator, needed to place it or to distinguish several.
        reset: `world` (poses; time goes on), `simulation` (time begins again, too) or `none`.
        start: the pose that the robot must have after a reset: x, y (m) and yaw (rad).
        is_placed: whether the robot is placed there after the reset, for a start that is not the world's own.
        pose_topic: the topic of the robot's pose.
        tolerance_m: how far from its start the robot may be, m.
        tolerance_rad: how far its heading may be off, rad.
        pauses: whether the simulator is paused between runs.
        lowest_real_time_factor: a run's values are doubtful if the factor is less in the slowest second of the mission;
            0 for never.
        timeout_s: how long each answer, and the reset, may take, s.

    Raises:
        PluginError: there is no such simulator, or it does not support what is requested.

    Example:
        >>> Simulation("gz", world="maze", reset="simulation").measures[0].name
        'RealTimeFactor'
    """

    measures: Sequence[Measure] = (
        Measure("RealTimeFactor", "1", "Simulated seconds a second of this machine, over the mission."),
        Measure("LowestRealTimeFactor", "1", "The same over the slowest second of the mission."),
        Measure("ResetDuration", "s", "From the request to reset until robot and time were seen to be reset."),
    )
    needs: ClassVar[str] = "A simulator on the robot's graph, with the services that reset it."

    def __init__(  # noqa: PLR0913 - one keyword for each thing that simulators differ in
        self,
        simulator: str = "robot_runner",
        *,
        name: str | None = None,
        namespace: str = "",
        world: str = "",
        robot: str = "",
        reset: str = "world",
        start: tuple[float, float, float] = (0.0, 0.0, 0.0),
        is_placed: bool = False,
        pose_topic: str = "odom",
        tolerance_m: float = 0.05,
        tolerance_rad: float = 0.1,
        pauses: bool = True,
        lowest_real_time_factor: float = 0.9,
        timeout_s: float = 10.0,
    ) -> None:
        super().__init__(name=name)
        self.namespace = namespace
        self.robot = robot
        self.reset = reset
        self.start: Spot = checked_spot(start)
        self.pose_topic = pose_topic
        self.tolerance_m, self.tolerance_rad = tolerance_m, tolerance_rad
        self.lowest_real_time_factor = lowest_real_time_factor
        self.timeout_s = timeout_s
        self._dialect = dialect_of(simulator, world)
        self._reset = self._reset_demand()
        self._place = self._placing(is_placed=is_placed)
        self.pauses = pauses and self._dialect.pause is not None
        check_numbers(self.name, tolerance_m=tolerance_m, tolerance_rad=tolerance_rad, timeout_s=timeout_s)
        check_numbers(self.name, may_be_zero=True, lowest_real_time_factor=lowest_real_time_factor)
        self._time: WatchedTime | None = None
        self._reset_duration: float | None = None
        self._closing = ExitStack()

    def check(self, circumstances: Circumstances) -> Iterable[Finding]:
        """Return findings: no robot; parameters without effect."""
        where = f"plugin {self.name}"
        if circumstances.robot is None:
            fix = "Name how its graph is reached: robot = 'ros2' (or ros1, dds, rosbridge)."
            yield Finding.error(where, "the simulator is on the robot's graph, and the experiment names no robot", fix)
        elif is_simulated(circumstances.robot):
            problem = "the embedded robot begins each run anew: nothing is reset, and its time has no pace of its own"
            fix = "Leave the plugin out, or reach a simulator on a graph: --set robot=dds."
            yield Finding.warning(where, problem, fix)
        for each in circumstances.before(self):
            if isinstance(each, System) and not each.starts_nodes and not isinstance(each, Simulation):
                problem = f"the simulator is reset once {each.name!r}, which is listed before it, has begun its run"
                yield Finding.warning(where, problem, f"List {self.name!r} before {each.name!r} in `plugins`.")

    def required_graph(self, circumstances: Circumstances) -> Iterable[GraphNeed]:
        """Return the topic of the pose, and the services whose names are known beforehand."""
        del circumstances
        if self._reset is not None:
            fix = "Name the topic that tells where the robot stands: pose_topic='odom'."
            yield GraphNeed.published(self.pose_topic, fix=fix)
        pausing = (self._dialect.pause, self._dialect.unpause) if self.pauses else ()
        for demand in (self._reset, self._place, *pausing):
            if demand is not None and len(demand.services) == 1:
                fix = f"Start what offers it: {self._dialect.hint}."
                yield GraphNeed.service(demand.services[0], demand.service_type, fix=fix)

    def before_run(self, context: RobotRunnerContext) -> None:
        """Unpause the simulator if the run follows its time: a run cannot begin while that stands still.

        Whichever process is killed from here on, a guardian process unpauses the simulator.
        """
        if self.pauses and follows_graph_clock(context.robot):
            self._unpause_from_elsewhere(context)
        unpause, robot = self._dialect.unpause, context.robot
        if self.pauses and unpause is not None and robot is not None and not is_simulated(robot):
            guard_pauses(robot, self.namespace, unpause, self.timeout_s, signs=self._signs)

    def after_experiment(self, context: ExperimentContext) -> None:
        """Leave the simulator unpaused, as it was found."""
        if self.pauses and context.robot is not None and not is_simulated(context.robot):
            self._unpause_from_elsewhere(context, self._signs)
            guard_pauses_no_more(context.robot, self.namespace)

    def start_run(self, context: RobotRunnerContext) -> None:
        """Reset the simulator, and check that it was reset.

        Raises:
            LinkError: it cannot be reset, or does not appear as reset in time; the message says what is seen instead.
        """
        self._reset_duration, self._time = None, None
        self._closing.close()
        link = connect_robot(context, namespace=self.namespace)
        if link.is_simulated:
            return
        namespace = robot_namespace(context, self.namespace)
        if CLOCK_TOPIC in link.topics():
            self._time = WatchedTime(link, lambda before, now: context.fail(_went_back(before, now)))
            self._closing.callback(self._time.close)
        self._demand(self._dialect.unpause, link, namespace)
        if self._reset is not None:
            self._reset_duration = self._reset_and_see(self._reset, link, namespace)

    def launch_mission(self, context: RobotRunnerContext) -> None:
        """Measure the simulator's time from here on."""
        del context
        if self._time is not None:
            self._time.begin()

    def stop_measurement(self, context: RobotRunnerContext) -> None:
        """End measuring the simulator's time."""
        del context
        if self._time is not None:
            self._time.end()

    def stop_run(self, context: RobotRunnerContext) -> None:
        """Pause the simulator until the next run."""
        self._closing.close()
        link = connect_robot(context, namespace=self.namespace)
        if self.pauses and not link.is_simulated:
            self._demand(self._dialect.pause, link, robot_namespace(context, self.namespace))

    def populate_run_data(self, context: RobotRunnerContext) -> None:
        """Publish the real-time factor, and doubt the run where it was too low."""
        measured = self._time
        context.publish("RealTimeFactor", None if measured is None else measured.factor)
        context.publish("LowestRealTimeFactor", None if measured is None else measured.slowest)
        context.publish("ResetDuration", self._reset_duration)
        if is_simulated(context.robot):
            return
        if measured is None or measured.factor is None:
            problem = f"nothing was published on {CLOCK_TOPIC}: how fast the simulator's time went is not known"
            context.warn(problem, fix="Have the simulator publish its time (robot-runner simulate: --use-sim-time).")
            return
        lowest = measured.factor if measured.slowest is None else min(measured.factor, measured.slowest)
        if lowest < self.lowest_real_time_factor:
            problem = (
                f"the simulator's real-time factor fell to {lowest:.2f} (below {self.lowest_real_time_factor:g}): what "
                "goes by real time, such as software under test, had more of it than on a real robot"
            )
            fix = "Give the simulator more of a machine, a simpler world, or let all nodes live by its time."
            context.broker.doubt_run(context.owner, problem, fix)

    def make_safe(self, context: RobotRunnerContext) -> None:
        """Unpause the simulator, also in a process that was not connected before."""
        link = connect_robot(context, namespace=self.namespace)
        if self.pauses and not link.is_simulated:
            self._demand(self._dialect.unpause, link, robot_namespace(context, self.namespace))

    @property
    def _signs(self) -> Sequence[str]:
        """The topics by which the simulator is known to exist: the subject that started it may have ended it."""
        return CLOCK_TOPIC, self.pose_topic

    def _reset_and_see(self, reset: Demand, link: RobotLink, namespace: str) -> float:
        with ExitStack() as closing:
            pose = WatchedPose(link, self.pose_topic, namespace=namespace, model=self.robot)
            closing.callback(pose.close)
            before = None if self._time is None else self._time.begin_reset(timeout=_FIRST_TIME)
            begun = time.monotonic()
            self._demand(reset, link, namespace)
            self._demand(self._dialect.unpause, link, namespace)  # some simulators are paused after a reset
            self._demand(self._place, link, namespace)
            pose.see(self.start, metres=self.tolerance_m, radians=self.tolerance_rad, timeout=self.timeout_s)
            if before is not None:
                self._see_time(before, begun + self.timeout_s)
            return time.monotonic() - begun

    def _see_time(self, before: float, deadline: float) -> None:
        """Check that time began again, or that it did not, as `reset` says."""
        while True:
            now = before if self._time is None else self._time.now() or 0.0
            # It may be past `before` again by now, if the simulator was just started or is fast.
            heard = None if self._time is None else self._time.earliest
            earliest = now if heard is None else heard
            if self.reset == "world" and earliest < before:
                problem = f"resetting the world took the simulator's time back from {before:.3f} s to {earliest:.3f} s"
                fix = "Say so, and see that all its nodes stand it: reset='simulation'."
                raise LinkError(problem, where="the simulator", fix=fix)
            if (now > before) if self.reset == "world" else (earliest < before):
                return
            if time.monotonic() > deadline:
                stood = "stands still" if now == before else "was not reset"
                problem = f"the simulator's time {stood}: {before:.3f} s before the reset, {now:.3f} s after it"
                fix = "Check whether it goes on; reset='world' leaves its time as it is."
                raise LinkError(problem, where=CLOCK_TOPIC, fix=fix)
            time.sleep(_LOOK)

    def _demand(self, demand: Demand | None, link: RobotLink, namespace: str) -> None:
        if demand is not None:
            demand.meet(link, namespace=namespace, timeout=self.timeout_s)

    def _unpause_from_elsewhere(self, context: ExperimentContext, signs: Sequence[str] = ()) -> None:
        demand, robot = self._dialect.unpause, context.robot
        if demand is not None and robot is not None:
            unpause_from_elsewhere(robot, self.namespace, demand, self.timeout_s, signs=signs)

    def _reset_demand(self) -> Demand | None:
        if self.reset not in _RESETS:
            fix = did_you_mean(str(self.reset), _RESETS)
            raise PluginError(f"reset is {self.reset!r}", where=self.name, fix=fix)
        offered = {"world": self._dialect.reset_world, "simulation": self._dialect.reset_simulation, "none": None}
        if self.reset != "none" and offered[self.reset] is None:
            fix = f"Say reset={'simulation' if self.reset == 'world' else 'world'!r}. Needed: {self._dialect.hint}."
            problem = f"{self._dialect.title} has no documented service for reset={self.reset!r}"
            raise PluginError(problem, where=self.name, fix=fix)
        return offered[self.reset]

    def _placing(self, *, is_placed: bool) -> Demand | None:
        if not is_placed:
            return None
        if self._dialect.place is None:
            fix = "Leave is_placed out, and let the world say where its robot starts."
            problem = f"{self._dialect.title} has no service known here to place a robot"
            raise PluginError(problem, where=self.name, fix=fix)
        if not self.robot:
            fix = "Name its model: robot='turtlebot3_burger'."
            raise PluginError("the robot is to be placed and not named", where=self.name, fix=fix)
        return self._dialect.place(self.robot, self.start)


def _went_back(before: float, now: float) -> str:
    return f"the simulator's time went back from {before:.3f} s to {now:.3f} s during the mission: it was reset"
