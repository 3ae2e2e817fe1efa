"""A steered robot: odometry, wheels, tasks of its computer, and the heartbeat for its watchdog."""

from __future__ import annotations

import logging
import threading
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import replace
from enum import Enum
from typing import Self

from robot_runner.core.errors import LinkError
from robot_runner.core.events.context import Clock, RobotRunnerContext
from robot_runner.core.events.early_end import raised_in_thread
from robot_runner.core.events.measure import MeasureValue
from robot_runner.core.links.commanded_topics import TWISTS
from robot_runner.core.links.connect import connect_robot, is_simulation, robot_namespace
from robot_runner.core.links.graph_names import GraphNeed, full_name, missing
from robot_runner.core.links.robot import RobotLink
from robot_runner.core.plugin import Circumstances
from robot_runner.measuring.live_samples import LiveSamples
from robot_runner.measuring.parameter_checks import check_numbers
from robot_runner.ros.graph_look import offer_findings
from robot_runner.ros.graph_transport import LONGEST_DISCOVERY
from robot_runner.ros.robot_system import RobotSystem
from robot_runner.ros.sole_control import SoleControl
from robot_runner.ros.turtlebot3.motion import COMMAND_TOPIC, MAXIMUM_SPEED, MAXIMUM_TURN_RATE, Pilot, Wheels
from robot_runner.ros.turtlebot3.odometry import ODOMETRY, POSE_TOPIC, Odometer, Trajectory
from robot_runner.ros.watchdog import HEARTBEAT_TOPIC, HEARTBEAT_TYPE

#: The watchdog waits for 0.4 s: three beats may be lost on the air.
_PERIOD = 0.1
#: How long the thread may take to end, s: publishing does not wait for subscribers.
_PATIENCE = 2.0
#: How often missing services are looked for, s.
_LOOK = 0.1

_logger = logging.getLogger(__name__)


class Heartbeat:
    """Publishes heartbeats from a thread of the run's process until it is ended.

    When the process dies or the link is lost, the heartbeats cease, and the robot's watchdog stops the robot.

    The embedded robot lives in the run's own process and needs none.

    Example:
        >>> from robot_runner.testing import FakeClock, FakeRobotLink
        >>> link = FakeRobotLink(FakeClock())
        >>> heartbeat = Heartbeat(link)
        >>> heartbeat.end()
        >>> heartbeat.say_farewell()
        >>> link.publications[-1].message
        {'data': 0}
    """

    def __init__(self, link: RobotLink) -> None:
        self._link = link
        self._is_over = threading.Event()
        self._thread: threading.Thread | None = None
        if not link.is_simulated:
            self._thread = threading.Thread(target=self._beat, name="heartbeat", daemon=True)
            self._thread.start()

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """End, with a farewell if nothing was raised, as the robot was made safe then."""
        self.end()
        if kind is None:
            self.say_farewell()

    def end(self) -> None:
        """End the heartbeats; ending twice does nothing. Without a farewell the watchdog stops the robot."""
        self._is_over.set()
        if self._thread is not None:
            self._thread.join(_PATIENCE)

    def say_farewell(self) -> None:
        """Tell the watchdog that the run has left the robot standing still; raise a `LinkError` if that fails."""
        if self._thread is not None:
            self._link.publish(HEARTBEAT_TOPIC, HEARTBEAT_TYPE, {"data": 0})

    def _beat(self) -> None:
        count = 0
        while not self._is_over.is_set():
            count += 1
            try:
                self._link.publish(HEARTBEAT_TOPIC, HEARTBEAT_TYPE, {"data": count})
            except LinkError as error:
                if not raised_in_thread(error, "the heartbeat"):
                    _logger.warning("the heartbeat ends, so the robot's watchdog stops it: %s", error)
                return
            self._is_over.wait(_PERIOD)


class Task(Enum):
    """The work of the robot's computer in a task phase (paper, section II.C); the value names its services."""

    COMPUTATION = "computation"
    VIDEO = "video"
    NETWORK = "network"

    @classmethod
    def named(cls, treatment: object) -> Task | None:
        """Return the task that a treatment names, ignoring case, or None.

        Example:
            >>> Task.named("Video")
            <Task.VIDEO: 'video'>
        """
        name = str(treatment).casefold()
        return next((task for task in cls if task.value == name), None)


_TRIGGER = "std_srvs/Trigger"
_TASK_NODE = "Start the robot's task node, which is in the repository's robot/ folder."


def required_services(task: Task) -> Iterator[GraphNeed]:
    """Yield the services that a robot must offer for a task."""
    for name in (f"task/{task.value}/start", f"task/{task.value}/stop", "task/stop"):
        yield GraphNeed.service(name, _TRIGGER, fix=_TASK_NODE)


class TaskServices:
    """Calls `task/<task>/start`, `task/<task>/stop` and `task/stop`, which stops any task.

    Each raises a `LinkError` where the robot cannot be reached, has no such service, or refuses.
    """

    def __init__(self, link: RobotLink, namespace: str = "") -> None:
        self._link = link
        self._namespace = namespace

    def check(self, task: Task, clock: Clock, *, where: str) -> None:
        """Check that the robot offers the services of a task, before it has driven to where the task begins."""
        needs = [replace(need, name=full_name(self._namespace, need.name)) for need in required_services(task)]
        deadline = clock.now() + LONGEST_DISCOVERY
        while True:
            offered = self._link.services()
            found = [finding for need in needs for finding in offer_findings("service", offered, need, where)]
            if not found:
                return
            if clock.now() >= deadline:
                raise LinkError.of_findings(found)
            clock.sleep(_LOOK)

    def start(self, task: Task) -> None:
        """Start a task."""
        self._call(f"task/{task.value}/start")

    def stop(self, task: Task) -> None:
        """Stop a running task."""
        self._call(f"task/{task.value}/stop")

    def stop_all(self) -> str:
        """Stop any running task, and return the robot's answer; if none was running, that is not a fault."""
        return str(self._link.call("task/stop", _TRIGGER).get("message", ""))

    def _call(self, service: str) -> None:
        response = self._link.call(service, _TRIGGER)
        if not response.get("success", False):
            problem = f"the robot refused: {response.get('message') or 'no reason given'}"
            raise LinkError(problem, where=f"service {service}", fix="Look at the log of the task's node on the robot.")


#: How long the graph may take to list the robot's subscription of commands, once its odometry arrives, s.
_LISTING_SECONDS = 3.0
_LOOK_PERIOD = 0.1


class Robot:
    """One connected robot: its odometry, and its commands, of which `limits` are the greatest, m/s and rad/s.

    Each method raises a `LinkError` if the robot cannot be reached any more. With `has_tasks` its computer offers the
    services of tasks, which are stopped with the robot. `control` checks that no other node commands it or publishes
    its pose; `where` is the plugin, for errors.
    """

    def __init__(  # noqa: PLR0913 - one keyword for each thing in which robots differ
        self,
        link: RobotLink,
        odometer: Odometer,
        clock: Clock,
        *,
        namespace: str = "",
        where: str = "robot",
        command_topic: str = COMMAND_TOPIC,
        pose_topic: str = POSE_TOPIC,
        limits: tuple[float, float] = (MAXIMUM_SPEED, MAXIMUM_TURN_RATE),
        has_tasks: bool = True,
    ) -> None:
        self._link = link
        self._namespace = namespace
        self._clock = clock
        self._command_topic = full_name(namespace, command_topic)
        self.odometer = odometer
        self._wheels = Wheels(link, namespace=namespace, topic=command_topic)
        self.pilot = Pilot(self._wheels, odometer, clock, where, limits)
        self.control = SoleControl(
            link, namespace=namespace, pose_topic=pose_topic, command_topic=command_topic, where=where
        )
        self.tasks = TaskServices(link, namespace)
        self._has_tasks = has_tasks
        self._subscription = link.subscribe(pose_topic, ODOMETRY, odometer.take, is_prompt=True)
        self._heartbeat = Heartbeat(link)

    def is_simulated(self) -> bool:
        """Whether the robot is simulated; to be read after the mission, which it would make longer."""
        return is_simulation(self._link, self._namespace)

    def check_commands_subscribed(self, *, where: str) -> None:
        """Check that velocity commands have a connected subscriber of either type, before the mission begins."""
        topic, deadline = self._command_topic, self._clock.now() + _LISTING_SECONDS
        # The topic alone says nothing: others may publish it, also before the robot's subscription is discovered.
        while not any(each.may_be_others for each in self._link.subscribers(topic)):
            if self._clock.now() >= deadline:
                fix = "Start the robot's bringup, or correct its namespace."
                if topic in (topics := self._link.topics()):
                    raise LinkError(f"no node subscribes {topic!r}", where=where, fix=fix)
                raise missing("topic", topic, topics, where=where, fix=fix)
            self._clock.sleep(_LOOK_PERIOD)
        self._wheels.get_ready()

    def make_safe(self) -> None:
        """Stop the wheels, and the tasks even if the wheels cannot be reached."""
        with ExitStack() as stopping:
            if self._has_tasks:
                stopping.callback(self.tasks.stop_all)
            stopping.callback(self.pilot.stop)

    def close(self) -> None:
        """Make it safe and end its subscription; closing twice does no harm.

        A robot that could not be made safe gets no farewell, so that its watchdog stops it.
        """
        with closing(self._subscription), self._heartbeat:
            try:
                self.control.end()
            finally:
                self.make_safe()


class SteeredSystem(RobotSystem):
    """A system that steers a robot in a closed loop on its odometry, and writes its way to `trajectory.csv`."""

    commands: Sequence[str] = (COMMAND_TOPIC,)
    odometry_topic: str = POSE_TOPIC

    def __init__(
        self,
        *,
        name: str | None,
        namespace: str,
        connect_timeout_s: float,
        odometry_timeout_s: float,
        sole_control: bool,
    ) -> None:
        super().__init__(name=name)
        check_numbers(self.name, connect_timeout_s=connect_timeout_s, odometry_timeout_s=odometry_timeout_s)
        self.namespace = namespace
        self.connect_timeout_s, self.odometry_timeout_s = connect_timeout_s, odometry_timeout_s
        self.sole_control = sole_control
        self._robot: Robot | None = None
        self._values: Sequence[MeasureValue] | None = None
        self._is_simulated = False

    def reached(self, context: RobotRunnerContext) -> Robot:
        """Connect to the robot, subscribe its odometry, and return it."""
        raise NotImplementedError

    def check_ready(self, robot: Robot, context: RobotRunnerContext) -> None:
        """Check whatever else the mission needs of the robot; nothing, if not overridden."""

    def required_graph(self, circumstances: Circumstances) -> Iterable[GraphNeed]:
        """Return the needs: odometry and velocity commands."""
        del circumstances
        fix = "Start the robot's bringup, or correct the plugin's namespace."
        yield GraphNeed.published(self.odometry_topic, ODOMETRY, is_sole=self.sole_control, fix=fix)
        for topic in self.commands:
            yield GraphNeed.subscribed(topic, *sorted(TWISTS), is_sole=self.sole_control, fix=fix)

    def start_run(self, context: RobotRunnerContext) -> None:
        """Connect, and check that the robot answers and that no other node commands it."""
        self._robot = self._values = None
        self._robot = robot = self.reached(context)
        robot.odometer.wait(self.connect_timeout_s)
        robot.check_commands_subscribed(where=self.name)
        self.check_ready(robot, context)
        robot.control.take(context, sole=self.sole_control)

    @contextmanager
    def keeping_way(self, robot: Robot, context: RobotRunnerContext) -> Iterator[None]:
        """Record the robot's way for a while, and write it afterwards."""
        path = context.raw_data_folder / "trajectory.csv"
        trajectory = Trajectory(LiveSamples(path))
        with ExitStack() as ending:
            ending.callback(trajectory.write, path)
            ending.callback(setattr, robot.odometer, "on_pose", None)
            robot.odometer.on_pose = trajectory.add
            yield

    def stop_run(self, context: RobotRunnerContext) -> None:
        """Stop the robot and leave it."""
        del context
        if self._robot is not None:
            self._robot.close()
            if self._values is not None:
                self._is_simulated = self._robot.is_simulated()

    def populate_run_data(self, context: RobotRunnerContext) -> None:
        """Publish the measures; no values where the mission did not take place."""
        self.publish_values(context, self._values, is_simulated=self._is_simulated)

    def make_safe(self, context: RobotRunnerContext) -> None:
        """Stop the robot, and its tasks, also in a process that has not been connected to it before."""
        link, namespace = connect_robot(context, namespace=self.namespace), robot_namespace(context, self.namespace)
        with ExitStack() as closing:
            closing.callback(lambda: self.reached(context).close())
            for topic in self.commands:  # before steps that have to query the graph first
                Wheels(link, namespace=namespace, topic=topic).command(0.0, 0.0)
