"""The mission that publishes something until a condition holds, or for some time."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack, nullcontext
from typing import TYPE_CHECKING, Any, ClassVar

from robot_runner.core.errors import ConditionTimeout, Finding, PluginError
from robot_runner.core.events.condition import Condition, Look
from robot_runner.core.events.context import RobotRunnerContext
from robot_runner.core.events.measure import Measure
from robot_runner.core.links.commanded_topics import TWISTS, VELOCITIES, command_for_certain
from robot_runner.core.links.connect import connect_robot, is_simulation, robot_namespace
from robot_runner.core.links.graph_names import GraphNeed
from robot_runner.core.links.robot import Advertiser, Qos, RobotLink
from robot_runner.measuring.parameter_checks import check_numbers
from robot_runner.ros.robot_system import RobotSystem
from robot_runner.ros.shapes import plain_type
from robot_runner.ros.sole_control import SoleControl
from robot_runner.ros.turtlebot3.steered_robot import Heartbeat

if TYPE_CHECKING:
    from robot_runner.core.plugin import Circumstances

_PUT_BACK = "Have each run begin where the condition does not hold: put the robot back, or reset its odometry."
#: A condition that holds within so many seconds, and was not seen not to hold, may have held before the mission began.
_AT_ONCE = 0.5
#: Clocks round: a message that is due within so many seconds is sent now.
_TICK = 1e-6


class TopicMission(RobotSystem):
    """Publishes a message periodically until a condition holds or some time has passed, and a safe one afterwards.

    Args:
        topic: its name, relative to the robot's namespace unless it begins with `/`.
        message_type: its ROS type, such as `geometry_msgs/Twist`.
        publish: the message; `treatment(...)` may stand for any field, and what is left out has its ROS default.
        until: a condition, such as `topic_above(...)`, which has a `namespace` argument of its own; or a number of
            seconds.
        rate_hz: messages a second, 1/s; 0 for a single message.
        timeout_s: how long the condition may take, s of the run's clock; the run fails then. Where it is about what is
            outside of a simulation, such as a file, a simulated second takes a real one.
        afterwards: the safe message, published when the mission is over or breaks off, and by the standby when the run
            dies. Left out, it is zero after a velocity command (Twist or AckermannDrive, also stamped), and none after
            any other message.
        name: tells several instances apart; the class's name if left out.
        namespace: the robot's ROS namespace, such as `/alice`.
        sole_control: whether a run fails if another node publishes on the topic during it; if False, the run's values
            are doubtful then.

    Raises:
        PluginError: a parameter is out of its range.

    Example:
        >>> mission = TopicMission("cmd_vel", "geometry_msgs/Twist", {"linear": {"x": 0.1}}, until=2.0)
        >>> [measure.name for measure in mission.measures]
        ['Duration', 'Messages']
    """

    measures: Sequence[Measure] = (
        Measure("Duration", "s", "How long the mission published, on the run's clock."),
        Measure("Messages", "1", "How many messages it published until the condition held."),
    )
    #: The topics that it commands, for `Together`.
    commands: Sequence[str] = ()
    needs: ClassVar[str] = "A robot that subscribes the topic, or robot='simulated'."
    does: ClassVar[str] = "publishes to a robot"

    def __init__(  # noqa: PLR0913 - one keyword for each thing in which missions differ
        self,
        topic: str,
        message_type: str,
        publish: Mapping[str, Any],
        *,
        until: Condition | float,
        rate_hz: float = 10.0,
        timeout_s: float = 60.0,
        afterwards: Mapping[str, Any] | None = None,
        name: str | None = None,
        namespace: str = "",
        sole_control: bool = True,
    ) -> None:
        super().__init__(name=name)
        for parameter, message in (("publish", publish), ("afterwards", afterwards or {})):
            if not isinstance(message, Mapping):
                fix = "Give a mapping by the fields of the message: {'linear': {'x': 0.1}}."
                raise PluginError(f"{parameter} is {message!r}", where=self.name, fix=fix)
        seconds = {} if isinstance(until, Condition) else {"until": until}
        check_numbers(self.name, may_be_zero=True, rate_hz=rate_hz, timeout_s=timeout_s, **seconds)
        self.topic, self.message_type, self.publish = topic, message_type, publish
        self.until: Condition = until if isinstance(until, Condition) else _Elapsed(float(until))
        self.rate_hz, self.timeout_s = float(rate_hz), float(timeout_s)
        is_velocity = plain_type(message_type) in VELOCITIES
        self.afterwards = {} if afterwards is None and is_velocity else afterwards
        self.namespace = namespace
        self.sole_control = sole_control
        self.commands = (topic,)
        self._is_velocity = is_velocity
        self._link: RobotLink | None = None
        self._heartbeat: Heartbeat | None = None
        self._control: SoleControl | None = None
        self._is_simulated = False
        self._result: tuple[float, int] | None = None

    def check(self, circumstances: Circumstances) -> Iterable[Finding]:
        """Return findings: there is no robot, or those of the condition."""
        yield from super().check(circumstances)
        yield from self.until.check(circumstances.robot)

    def required_graph(self, circumstances: Circumstances) -> Iterable[GraphNeed]:
        """Return the need for a subscriber of the topic."""
        del circumstances
        fix = "Start the node that subscribes it, or correct its name or the plugin's namespace."
        messages = [self.publish, *([] if self.afterwards is None else [self.afterwards])]
        plain, is_sole = plain_type(self.message_type), self.sole_control
        yield GraphNeed.subscribed(self.topic, plain, is_sole=is_sole, fix=fix, messages=messages)

    def duration_s(self, combination: Mapping[str, Any]) -> float | None:
        """Return the duration, s, if it is fixed."""
        del combination
        return self.until.seconds if isinstance(self.until, _Elapsed) else None

    def start_run(self, context: RobotRunnerContext) -> None:
        """Connect, and check that no other node publishes on the topic."""
        self._result = None
        self._link = connect_robot(context, namespace=self.namespace)
        if self._is_velocity:
            self._heartbeat = Heartbeat(self._link)
        plain = plain_type(self.message_type)
        types = TWISTS if plain in TWISTS else {plain}
        namespace = robot_namespace(context, self.namespace)
        self._control = SoleControl(
            self._link, namespace=namespace, command_topic=self.topic, where=self.name, types=types
        )
        self._control.take(context, sole=self.sole_control)
        if isinstance(self._link, Advertiser):  # discovery may take seconds, which must not be measured
            self._link.advertise(self.topic, self.message_type)

    def launch_mission(self, context: RobotRunnerContext) -> None:
        """Publish until the condition holds; the safe message follows in any case.

        Raises:
            ConditionTimeout: it did not hold in time; the message says what was seen last.
            LinkError: the robot cannot be reached, or the message does not follow its definition.
        """
        link = self.started(self._link)
        begun = context.clock.now()
        with ExitStack() as opened, ExitStack() as leaving:
            leaving.callback(self._say_safe, link)
            count = self._publish_until(link, context, self.until.watch(context, opened))
        self._result = context.clock.now() - begun, count

    def stop_run(self, context: RobotRunnerContext) -> None:
        """Leave the robot in the safe state."""
        link, heartbeat, self._heartbeat = self._link, self._heartbeat, None
        if link is None:
            return
        with ExitStack() as closing:
            if self._control is not None:
                closing.callback(self._control.end)
            with heartbeat or nullcontext():
                self._say_safe(link)
        if self._result is not None:
            self.doubt_unreached(context, link, [(self.topic, self.message_type, Qos.DEFAULT)])
            self._is_simulated = is_simulation(link, robot_namespace(context, self.namespace))

    def populate_run_data(self, context: RobotRunnerContext) -> None:
        """Publish the measures; no values where the mission did not take place."""
        self.publish_values(context, self._result, is_simulated=self._is_simulated)

    def make_safe(self, context: RobotRunnerContext) -> None:
        """Publish the safe message, also in a process that has not been connected to the robot before."""
        if self.afterwards is not None:
            link = connect_robot(context, namespace=self.namespace)
            command_for_certain(link, self.topic, self.message_type, self.afterwards)

    def _say_safe(self, link: RobotLink) -> None:
        if self.afterwards is not None:
            link.publish(self.topic, self.message_type, self.afterwards)

    def _publish_until(self, link: RobotLink, context: RobotRunnerContext, look_again: Callable[[], Look]) -> int:
        clock, begun, due, count = context.clock, context.clock.now(), 0.0, 0
        was_awaited = isinstance(self.until, _Elapsed)
        while not (look := look_again()).holds:
            was_awaited = was_awaited or look.is_known
            elapsed = clock.now() - begun
            if not isinstance(self.until, _Elapsed) and elapsed >= self.timeout_s - _TICK:
                self._fail(look, context)
            if elapsed >= due - _TICK:
                link.publish(self.topic, self.message_type, self.publish)
                count += 1
                due = count / self.rate_hz if self.rate_hz else math.inf
                elapsed = clock.now() - begun
            self._sleep(max(_TICK, min(due - elapsed, self._patience(elapsed))), context)
        lasted = clock.now() - begun
        context.broker.note(context.owner, "waited", self._facts(look, lasted, holds=True))
        if not was_awaited and lasted < _AT_ONCE:
            problem = f"{self.until} {lasted:.1f} s after the mission began, and was not seen not to hold before"
            context.broker.doubt_run(context.owner, f"{problem}: {look.seen}", _PUT_BACK)
        return count

    def _sleep(self, seconds: float, context: RobotRunnerContext) -> None:
        """Sleep on the run's clock, and for at least as long in real time where the condition lives in that, too."""
        end = time.monotonic() + seconds
        context.clock.sleep(seconds)
        if self.until.clock(context) is not context.clock:
            time.sleep(max(0.0, end - time.monotonic()))

    def _patience(self, elapsed: float) -> float:
        """Return how long to sleep at most until the condition is checked again, s."""
        if isinstance(self.until, _Elapsed):
            return self.until.seconds - elapsed
        return min(self.until.every_s, self.timeout_s - elapsed)

    def _fail(self, look: Look, context: RobotRunnerContext) -> None:
        context.broker.note(context.owner, "waited", self._facts(look, self.timeout_s, holds=False))
        seen = f": {look.seen}" if look.seen else ""
        raise ConditionTimeout(
            f"after {self.timeout_s:g} s of publishing on {self.topic!r} it still did not hold that {self.until}{seen}",
            where=self.name,
            fix="Look at what is awaited, or allow it more time (timeout_s).",
        )

    def _facts(self, look: Look, seconds: float, *, holds: bool) -> dict[str, Any]:
        return {"condition": str(self.until), "seen": look.seen, "seconds": round(seconds, 3), "holds": holds}


class _Elapsed(Condition):
    """So many seconds have passed since the watch began."""

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds

    def __str__(self) -> str:
        return f"{self.seconds:g} s have gone by"

    def watch(self, context: RobotRunnerContext, opened: ExitStack) -> Callable[[], Look]:
        del opened
        clock, begun = context.clock, context.clock.now()
        return lambda: Look(clock.now() - begun >= self.seconds - _TICK)
