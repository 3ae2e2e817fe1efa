"""The system plugin that operates a TurtleBot3."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any, ClassVar

from robot_runner.core.errors import Finding, PluginError, did_you_mean
from robot_runner.core.events.context import RobotRunnerContext
from robot_runner.core.events.measure import Measure
from robot_runner.core.links.connect import connect_robot, robot_namespace
from robot_runner.core.links.graph_names import GraphNeed
from robot_runner.core.plugin import Circumstances
from robot_runner.core.treatments import factors_of
from robot_runner.ros.turtlebot3.mission import CircularMission, Performance, Performer, Phase, PhaseLog
from robot_runner.ros.turtlebot3.odometry import Odometer
from robot_runner.ros.turtlebot3.steered_robot import Robot, SteeredSystem, Task, TaskServices, required_services

_KNOWN_TASKS = tuple(task.value.capitalize() for task in Task)
#: How far from its beginning, m, a mission may end before the run is warned of.
_NEAR = 0.1
#: The share of the planned way by which the robot may miss it. Where more is lacking, it was blocked or its wheels
#: slipped; where more was covered, it was pushed. Of a short way `_NEAR` more may be covered: at each end a free robot
#: goes some 3 cm too far and back.
_AMISS = 0.1


class BasicTurtlebot3(SteeredSystem):
    """Executes the paper's circular mission on a TurtleBot3: 95 s of sleeping, driving and three times a task.

    The robot drives away and comes back, in a closed loop on its odometry, so that it need not be
    repositioned between runs. It is stopped at the end in any case.

    Args:
        name: tells several robots apart; the class's name if left out.
        namespace: the robot's ROS namespace, such as `/alice`.
        task_factor: the factor whose treatment names the task of a run; None if no factor does.
        task: the task of all runs, if no factor names it: Computation, Video or Network.
        sleep_s: each of the six sleeps, s.
        drive_s: the way out, and the way back, s.
        task_s: each of the three tasks, s.
        rotate_s: the turn by 180 degrees, s.
        speed: the cruising speed, m/s; at most 0.22.
        connect_timeout_s: how long to wait for the robot's first odometry, s.
        odometry_timeout_s: how long the odometry may be silent before the mission is broken off, s.
        sole_control: whether a run fails if another node commands the robot, or more than one publishes its odometry;
            if False, the run's values are doubtful then.

    Raises:
        PluginError: a parameter is out of its range.

    Example:
        >>> BasicTurtlebot3(task="Video", task_factor=None).measures[1]
        Measure(name='Distance', unit='m', description='Way covered during its whole mission, by odometry.')
    """

    measures: Sequence[Measure] = (
        Measure("Duration", "s", "Duration of the mission on the run's clock."),
        Measure("Distance", "m", "Way covered during its whole mission, by odometry."),
        Measure("PoseError", "m", "Distance between the first and the last position of the mission, by odometry."),
    )
    #: 23 s instead of 95: the way out is 0.6 m long, and the turn is still slower than the robot's limit.
    smoke_parameters: ClassVar[Mapping[str, float]] = MappingProxyType(
        {"sleep_s": 1.0, "drive_s": 3.0, "task_s": 2.0, "rotate_s": 5.0}
    )
    needs: ClassVar[str] = "A TurtleBot3 with odometry and the task services, or robot='simulated'."

    def __init__(  # noqa: PLR0913 - one keyword for each thing that a study may vary
        self,
        *,
        name: str | None = None,
        namespace: str = "",
        task_factor: str | None = "Task",
        task: str | None = None,
        sleep_s: float = 5.0,
        drive_s: float = 10.0,
        task_s: float = 10.0,
        rotate_s: float = 15.0,
        speed: float = 0.2,
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
        self.task_factor = task_factor
        self.task = task
        self.mission = CircularMission(sleep_s=sleep_s, drive_s=drive_s, task_s=task_s, rotate_s=rotate_s, speed=speed)
        self._performance: Performance | None = None

    def check(self, circumstances: Circumstances) -> Iterable[Finding]:
        """Return findings: there is no robot, or treatments are not tasks."""
        yield from super().check(circumstances)
        yield from self._check_namespace(circumstances)
        yield from self._check_tasks(circumstances)

    def required_graph(self, circumstances: Circumstances) -> Iterable[GraphNeed]:
        """Return the needs: odometry, velocity commands, and the services of the possible tasks."""
        yield from super().required_graph(circumstances)
        named = [self.task] if self.task is not None else circumstances.factors.get(self.task_factor or "", ())
        for task in dict.fromkeys(filter(None, map(Task.named, named))):
            yield from required_services(task)

    def duration_s(self, combination: Mapping[str, Any]) -> float:
        """Return the duration of the mission, s, as the sum of its phases: 95 with the defaults."""
        del combination
        return self.mission.seconds

    def check_ready(self, robot: Robot, context: RobotRunnerContext) -> None:
        """Check that the robot has the services of the run's task, and end a task that is still running."""
        robot.tasks.check(self._task_of(context), context.clock, where=self.name)
        self._end_left_task(robot.tasks, context)

    def _end_left_task(self, tasks: TaskServices, context: RobotRunnerContext) -> None:
        """Stop a task that was left running: it would be measured, and the robot would refuse the run's own."""
        told = tasks.stop_all()
        if any(told.startswith(f"{task.value} ") for task in Task):  # otherwise "nothing was running"
            context.warn(f"a task was still running on the robot: {told}", fix="Find out what left it running.")

    def launch_mission(self, context: RobotRunnerContext) -> None:
        """Execute the mission.

        Its phases are written to `phases.csv` and announced to the other plugins as they begin; its way is written to
        `trajectory.csv`. They are phases of the run, too, which the config's `phases` may name: `sleep`, `forward`,
        `task` and `rotate`.
        """
        task, robot = self._task_of(context), self.started(self._robot)

        def announce(number: int, phase: Phase) -> None:
            context.share(phase=phase.kind.value, phase_number=number, phase_count=len(self.mission.phases))

        self._performance = None
        phases = context.raw_data_folder / "phases.csv"
        with self.keeping_way(robot, context), phases.open("w", encoding="ascii", newline="") as file:
            performer = Performer(self.mission, task, robot, context.clock, PhaseLog(file))
            found = self._performance = performer.perform(announce, context.phase)
        self._values = found.duration, found.distance, found.pose_error

    def populate_run_data(self, context: RobotRunnerContext) -> None:
        """Publish duration, distance and pose error; no values where the mission did not take place."""
        if self._values is not None and self._performance is not None:
            for problem in _doubts(self._performance):
                context.warn(problem, fix="Check whether the robot's way is free, and reposition the robot.")
        super().populate_run_data(context)

    def reached(self, context: RobotRunnerContext) -> Robot:
        """Connect to the robot, subscribe its odometry, and return it."""
        link, namespace = connect_robot(context, namespace=self.namespace), robot_namespace(context, self.namespace)
        odometer = Odometer(context.clock, timeout=self.odometry_timeout_s, where=self.name)
        return Robot(link, odometer, context.clock, namespace=namespace, where=self.name)

    def _check_namespace(self, circumstances: Circumstances) -> Iterator[Finding]:
        own = self.namespace.strip("/")
        for other in circumstances.plugins:
            if other is self:
                return  # the later of the two yields the finding
            if isinstance(other, BasicTurtlebot3) and other.namespace.strip("/") == own:
                problem = f"the plugin operates the robot of the namespace '/{own}', and so does {other.name!r}"
                fix = f"Give each its robot's namespace, as in {type(self).__name__}(namespace='/alice')."
                yield Finding.error(f"plugin {self.name}", problem, fix)

    def _check_tasks(self, circumstances: Circumstances) -> Iterator[Finding]:
        where = f"plugin {self.name}"
        is_bound = "task" in factors_of(self)
        treatments = None if self.task_factor is None or is_bound else circumstances.factors.get(self.task_factor)
        if treatments is not None and self.task is not None:
            problem = f"task={self.task!r} is given, and the factor {self.task_factor!r} varies the task"
            fix = "Leave out task=..., or give task_factor=None if that factor means something else."
            yield Finding.error(where, problem, fix)
        elif treatments is None and self.task is None and (circumstances.has_run_table or self.task_factor is None):
            none = f"there is no factor {self.task_factor!r} that names the task"
            fix = f"Give task={_KNOWN_TASKS[0]!r} (or another task), or name the factor with task_factor=..."
            yield Finding.error(where, none if self.task_factor else "no task is given", fix)
        if self.task is not None:
            yield from _unknown_tasks(where, [self.task])
        yield from _unknown_tasks(f"factor {self.task_factor!r}", treatments or ())

    def _task_of(self, context: RobotRunnerContext) -> Task:
        factor = None if "task" in factors_of(self) else self.task_factor
        chosen = self.task if factor is None else context.combination.get(factor, self.task)
        task = None if chosen is None else Task.named(chosen)
        if task is None:
            fix = did_you_mean(str(chosen), _KNOWN_TASKS)
            raise PluginError(f"{chosen!r} is not a task of the robot", where=self.name, fix=fix)
        return task


def _unknown_tasks(where: str, treatments: Iterable[object]) -> Iterator[Finding]:
    for treatment in treatments:
        if Task.named(treatment) is None:
            problem = f"{treatment!r} is not a task of the robot"
            yield Finding.error(where, problem, did_you_mean(str(treatment), _KNOWN_TASKS))


def _doubts(performance: Performance) -> Iterator[str]:
    if performance.pose_error > _NEAR:
        yield f"the mission ended {performance.pose_error:.2f} m from where it began"
    planned = performance.planned_distance
    if not -_AMISS * planned <= performance.distance - planned <= max(_AMISS * planned, _NEAR):
        yield f"the robot covered {performance.distance:.2f} m of {planned:.2f} m"
