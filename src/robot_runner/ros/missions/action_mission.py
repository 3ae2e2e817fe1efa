"""The mission that is a goal of an action: navigation, an arm's trajectory, a plan that is executed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack, closing, nullcontext, suppress
from enum import StrEnum
from typing import TYPE_CHECKING, Any, ClassVar

from robot_runner.core.errors import GoalRejectedError, LinkError, PluginError, did_you_mean
from robot_runner.core.events.context import RobotRunnerContext
from robot_runner.core.events.measure import Measure, MeasureValue
from robot_runner.core.links.commanded_topics import TWISTS
from robot_runner.core.links.connect import connect_robot, is_simulation, robot_namespace
from robot_runner.core.links.goal_cancelling import cancel_all_goals
from robot_runner.core.links.goals import ActionResult, GoalStatus
from robot_runner.core.links.graph_names import GraphNeed, field_of, full_name
from robot_runner.core.links.robot import Goal, RobotLink
from robot_runner.core.words import listed
from robot_runner.measuring.parameter_checks import check_numbers
from robot_runner.ros.missions.goal_measures import FeedbackMeasures, ResultMeasures
from robot_runner.ros.missions.way_measures import WayMeasures
from robot_runner.ros.robot_system import RobotSystem
from robot_runner.ros.shapes import plain_type
from robot_runner.ros.turtlebot3.motion import Wheels
from robot_runner.ros.turtlebot3.steered_robot import Heartbeat

if TYPE_CHECKING:
    from robot_runner.core.plugin import Circumstances

#: How often it is checked whether the goal is over, s.
_LOOK = 0.02
#: How often it is checked whether the server is still there, s.
_LOOK_FOR_SERVER = 1.0
#: How long the result may take once the goal is over, s.
_RESULT_SECONDS = 5.0


class _Failure(StrEnum):
    FAIL = "fail"
    MEASURE = "measure"


_TIMED_OUT = "timed out"
_MEASURES = (
    Measure("Duration", "s", "From the goal's acceptance until it was over, on the run's clock."),
    Measure("Success", "", "Whether the goal was reached."),
    Measure("Outcome", "", "What became of the goal: succeeded, aborted, canceled, rejected or timed out."),
)


class ActionMission(RobotSystem):
    """Sends a goal to an action server and waits until it is over; cancels the goal when the mission breaks off.

    Args:
        action: the name of the action, relative to the robot's namespace unless it begins with `/`.
        action_type: its ROS type, such as `nav2_msgs/NavigateToPose`.
        goal: its fields; `treatment(...)` may stand for any of them, and what is left out has its ROS default.
        result: measures that are fields of the result, by name: `{"ErrorCode": "error_code"}`; a `Measure` in place of
            the name gives its unit. Times and durations are in s.
        feedback: measures of the feedback: `"count"`, or how and which field: `("last", "number_of_recoveries")`.
        timeout_s: how long the goal may take, s of the run's clock; it is cancelled then.
        failure: what to do where a goal is rejected, aborted, cancelled by others or late: `fail` fails the run,
            `measure` records it as a measure, as in a study of the success rate.
        success: fields of the result with the values that they have in a success, where the status alone is not enough:
            `{"error_code": 0}`.
        odometry: topic of `nav_msgs/Odometry` for the measure `PathLength`; None for none.
        path_frames: the same from transforms instead of odometry: the frame in which the robot moves, and the robot's
            own, such as `("map", "base_link")`.
        tf_topic: the topic of the transforms for `path_frames`; `tf` for a robot that publishes them in its namespace
            (`/alice/tf`), as Nav2 does where it is started for several robots.
        scan: topic of `sensor_msgs/LaserScan` for the measure `ClosestObstacle`; None for none.
        stop_topic: topic of the robot's velocity commands, on which zero is commanded when the mission breaks off, as
            the server may be unable to; None for none.
        connect_timeout_s: how long the server may take to be found and to accept the goal, s.
        cancel_timeout_s: how long a goal may take to end once it was cancelled, s.
        name: tells several instances apart; the class's name if left out.
        namespace: the robot's ROS namespace, such as `/alice`.

    Raises:
        PluginError: a parameter is not valid.

    Example:
        >>> mission = ActionMission(
        ...     "navigate_to_pose",
        ...     "nav2_msgs/NavigateToPose",
        ...     {"pose": {"header": {"frame_id": "map"}, "pose": {"position": {"x": 1.5}, "orientation": {"w": 1.0}}}},
        ...     feedback={"Recoveries": ("last", "number_of_recoveries")},
        ...     odometry="odom",
        ... )
        >>> [measure.name for measure in mission.measures]
        ['Duration', 'Success', 'Outcome', 'Recoveries', 'PathLength']
    """

    #: The measures of every goal; an instance has those of its result, its feedback and its way, too.
    measures: Sequence[Measure] = _MEASURES
    needs: ClassVar[str] = "A robot with an action server, or robot='simulated' with a node that offers one."
    does: ClassVar[str] = "sends goals to a robot"
    for_example: ClassVar[str] = "ros2"
    #: The topics and actions that it commands, for `Together`.
    commands: Sequence[str] = ()

    def __init__(  # noqa: PLR0913 - one keyword for each thing in which missions differ
        self,
        action: str,
        action_type: str,
        goal: Mapping[str, Any] | None = None,
        *,
        result: Mapping[str | Measure, str] | None = None,
        feedback: Mapping[str | Measure, Any] | None = None,
        timeout_s: float = 60.0,
        failure: str = "fail",
        success: Mapping[str, Any] | None = None,
        odometry: str | None = None,
        path_frames: Sequence[str] | None = None,
        tf_topic: str = "/tf",
        scan: str | None = None,
        stop_topic: str | None = None,
        connect_timeout_s: float = 5.0,
        cancel_timeout_s: float = 5.0,
        name: str | None = None,
        namespace: str = "",
    ) -> None:
        super().__init__(name=name)
        for parameter, mapping in (("goal", goal), ("success", success)):
            if mapping is not None and not isinstance(mapping, Mapping):
                fix = "Give a mapping by field: {'pose': {'pose': {'position': {'x': 1.0}}}}."
                raise PluginError(f"{parameter} is {mapping!r}", where=self.name, fix=fix)
        check_numbers(self.name, timeout_s=timeout_s, connect_timeout_s=connect_timeout_s)
        check_numbers(self.name, cancel_timeout_s=cancel_timeout_s)
        if failure not in set(_Failure):
            fix = did_you_mean(str(failure), list(_Failure)) or "Say 'fail' or 'measure'."
            raise PluginError(f"failure is {failure!r}", where=self.name, fix=fix)
        self.action, self.action_type, self.goal = action, action_type, goal or {}
        self.timeout_s, self.failure, self.success = float(timeout_s), _Failure(failure), dict(success or {})
        self.connect_timeout_s, self.cancel_timeout_s = float(connect_timeout_s), float(cancel_timeout_s)
        self.stop_topic = stop_topic
        self.namespace = namespace
        self.commands = (action,)
        self._of_result = ResultMeasures(result, where=self.name)
        self._of_feedback = FeedbackMeasures(feedback, where=self.name)
        self._of_way = WayMeasures(odometry, scan, path_frames, where=self.name, tf_topic=tf_topic)
        self.measures = (*_MEASURES, *self._of_result.measures, *self._of_feedback.measures, *self._of_way.measures)
        self._check_names()
        self._link: RobotLink | None = None
        self._goal: Goal | None = None
        self._accepted_at: float | None = None
        self._values: dict[str, MeasureValue] | None = None
        self._is_simulated = False
        self._heartbeat: Heartbeat | None = None
        self._wheels: Wheels | None = None

    def _check_names(self) -> None:
        names = [measure.name for measure in self.measures]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            fix = f"Call it otherwise than {listed(name for name in dict.fromkeys(names))}."
            raise PluginError(f"two of its measures are named {twice[0]!r}", where=self.name, fix=fix)

    def required_graph(self, circumstances: Circumstances) -> Iterable[GraphNeed]:
        """Return the action and the given topics."""
        del circumstances
        fix = "Start the node that offers it, or correct its name or the plugin's namespace."
        yield GraphNeed.action(self.action, plain_type(self.action_type), fix=fix, goals=[self.goal])
        yield from self._of_way.required()
        if self.stop_topic is not None:
            fix = "Start the robot's bringup, or leave stop_topic out."
            yield GraphNeed.subscribed(self.stop_topic, *sorted(TWISTS), fix=fix)

    def start_run(self, context: RobotRunnerContext) -> None:
        """Connect, and check that the messages for measures of the way arrive."""
        self._goal = self._values = self._wheels = None
        self._of_feedback.begin()
        self._link = connect_robot(context, namespace=self.namespace)
        if self.stop_topic is not None:
            self._heartbeat = Heartbeat(self._link)
            namespace = robot_namespace(context, self.namespace)
            self._wheels = Wheels(self._link, namespace=namespace, topic=self.stop_topic)
            with suppress(LinkError):  # so that the graph need not be asked when the robot is to stop
                self._wheels.get_ready(awaits=False)
        self._of_way.begin(self._link, context, timeout=self.connect_timeout_s)

    def launch_mission(self, context: RobotRunnerContext) -> None:
        """Send the goal and wait until it is over.

        Raises:
            LinkError: there is no such server, or it is gone; or the goal failed, if that fails the run; or it could
                not be cancelled.
        """
        link = self.started(self._link)
        self._accepted_at = None
        self._of_way.begin_mission()
        outcome, ended = self._executed(link, context)
        lasted = None if self._accepted_at is None else context.clock.now() - self._accepted_at
        values: dict[str, MeasureValue] = {"Duration": lasted, "Outcome": outcome}
        result, is_reached = None if ended is None else ended.result, outcome == GoalStatus.SUCCEEDED
        values |= self._of_result.values(result, is_reached=is_reached)
        values.update(self._of_feedback.values())
        values.update(self._of_way.end_mission(context))
        reason = self._reason_of_failure(outcome, ended)
        self._values = {**values, "Success": not reason}
        if reason and self.failure is _Failure.FAIL:
            fix = "Look at the log of its server; where the rate of success is what you study, say failure='measure'."
            raise LinkError(reason, where=self._where, fix=fix)

    def stop_run(self, context: RobotRunnerContext) -> None:
        """Close the link; a goal that is not over is cancelled."""
        heartbeat, self._heartbeat = self._heartbeat, None
        with closing(self._of_way), heartbeat or nullcontext():
            self._cancel()
        if self._link is not None and self._values is not None:
            self._is_simulated = is_simulation(self._link, robot_namespace(context, self.namespace))

    def populate_run_data(self, context: RobotRunnerContext) -> None:
        """Publish the measures; no values where the mission did not take place."""
        values = None if self._values is None else [self._values.get(measure.name) for measure in self.measures]
        self.publish_values(context, values, is_simulated=self._is_simulated)

    def make_safe(self, context: RobotRunnerContext) -> None:
        """Cancel the goal, also in a process that did not send it, and command zero where a stop topic is named."""
        link = connect_robot(context, namespace=self.namespace)
        namespace = robot_namespace(context, self.namespace)
        with ExitStack() as each:  # all steps are done, also after one has failed
            wheels = self._wheels
            if wheels is None and self.stop_topic is not None:
                wheels = Wheels(link, namespace=namespace, topic=self.stop_topic)
            if wheels is not None:
                each.callback(wheels.command, 0.0, 0.0)
            if self._goal is not None:
                each.callback(self._cancel)
            elif not link.is_simulated:
                name, timeout = full_name(namespace, self.action), self.cancel_timeout_s
                each.callback(cancel_all_goals, link, name, timeout=timeout)
            if wheels is not None:  # at first, and again when the goal is over
                wheels.command(0.0, 0.0)

    @property
    def _where(self) -> str:
        return f"{self.name}, action {self.action}"

    def _executed(self, link: RobotLink, context: RobotRunnerContext) -> tuple[str, ActionResult | None]:
        try:
            self._goal = goal = link.send_goal(
                self.action,
                self.action_type,
                self.goal,
                on_feedback=self._of_feedback.take,
                timeout=self.connect_timeout_s,
            )
        except GoalRejectedError as error:
            if self.failure is _Failure.FAIL:
                raise
            context.warn(error.problem, fix=error.fix)
            return GoalStatus.REJECTED.value, None
        self._accepted_at = context.clock.now()  # finding the server may have taken seconds
        try:
            is_over = self._await_end(goal, link, context)
        except BaseException as fault:
            try:
                self._cancel()
            except LinkError as error:  # which does not hide the first exception
                fault.add_note(f"The goal could not be cancelled: {error}")
            raise
        if not is_over:
            self._cancel()
            return _TIMED_OUT, None
        ended = goal.result(timeout=_RESULT_SECONDS)
        self._goal = None
        return ended.status.value, ended

    def _await_end(self, goal: Goal, link: RobotLink, context: RobotRunnerContext) -> bool:
        """Wait until a goal is over; return False if it takes too long, raise a `LinkError` if its server is gone."""
        clock = context.clock
        deadline, look_at = clock.now() + self.timeout_s, clock.now() + _LOOK_FOR_SERVER
        name = full_name(robot_namespace(context, self.namespace), self.action)
        is_listed, told = _is_listed(link, name), 0
        while not goal.status.is_over:
            if goal.fault is not None:
                raise goal.fault
            now = clock.now()
            if now >= deadline:
                return False
            if is_listed and now >= look_at:
                look_at, is_silent = now + _LOOK_FOR_SERVER, told == self._of_feedback.count
                told = self._of_feedback.count
                # A server that has told feedback is there: asking takes time, in which the goal may end.
                if is_silent and not _is_listed(link, name, unless_told=True) and not goal.status.is_over:
                    fix = "Look at the log of its node, and start it again."
                    raise LinkError("the action server is gone, and the goal is not over", where=self._where, fix=fix)
            clock.sleep(min(_LOOK, deadline - now))
        return True

    def _reason_of_failure(self, outcome: str, ended: ActionResult | None) -> str:
        """Return why the goal is not a success; an empty text if it is one."""
        if outcome == _TIMED_OUT:
            return f"the goal was not over within {self.timeout_s:g} s, and was cancelled"
        if outcome != GoalStatus.SUCCEEDED:
            said = f": {ended.text}" if ended is not None and ended.text else ""
            return f"the goal was {outcome}{said}"
        for field, expected in self.success.items():
            found = field_of(ended.result if ended is not None else {}, field, where=self._where)
            if found != expected:
                return f"{field} of the result is {found!r}, where {expected!r} means success"
        return ""

    def _cancel(self) -> None:
        goal, self._goal = self._goal, None
        if goal is not None and not goal.status.is_over:
            goal.cancel(timeout=self.cancel_timeout_s)


def _is_listed(link: RobotLink, full_name: str, *, unless_told: bool = False) -> bool:
    """Whether an action is on the graph; `unless_told` where that cannot be asked, as of a rosapi that is busy."""
    try:
        return full_name in link.actions()
    except LinkError:
        return unless_told
