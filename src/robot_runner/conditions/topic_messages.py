"""Conditions of a robot's messages: one that satisfies a predicate, or a field or battery beyond a limit."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from robot_runner.conditions.bounds import Bound, Quantity, Reading
from robot_runner.conditions.computer_state import ComputerBattery
from robot_runner.conditions.computers import ComputerName
from robot_runner.conditions.graph_presence import check_robot_named, check_type_named, checked_name
from robot_runner.core.design.numeric_range import is_number
from robot_runner.core.errors import ConditionError, Finding, LinkError
from robot_runner.core.events.condition import Condition, Look, LookAgain
from robot_runner.core.events.context import RobotRunnerContext
from robot_runner.core.links.connect import connect_robot, is_simulated, robot_namespace
from robot_runner.core.links.graph_names import field_of, full_name
from robot_runner.core.links.robot import Message
from robot_runner.core.words import one_line

_BATTERY_STATE = "sensor_msgs/BatteryState"
_PERCENT = 100.0
#: The largest charge that is believed, as a share: robots that compute it from the voltage exceed 1 when just charged.
_MOST_SHARE = 1.5
#: How old a message of a battery may be, s: boards publish it at least once a second.
_BATTERY_WITHIN = 10.0
#: A topic on which so many messages came has fallen silent where none has come for so long, s, and for so many times
#: the longest time between two. Others may tell of changes only.
_REGULAR, _SILENT, _PAUSES = 20, 10.0, 10
#: How often subscribing is tried again, s.
_AGAIN = 0.5


def message_on(
    topic: str, message_type: str, predicate: Callable[[Message], bool] | None = None, *, namespace: str = ""
) -> Condition:
    """Return the condition that a message came that satisfies a predicate.

    It holds at a look where such a message came since the look before; where none came, as at the look before.

    Args:
        topic: its name, relative to the robot's namespace unless it begins with `/`.
        message_type: its ROS type, such as `nav_msgs/Odometry`.
        predicate: takes a message as a mapping; left out, any message will do.
        namespace: which robot, where there are several.

    Raises:
        ConditionError: the predicate cannot be called, or it cannot be a type.
        LinkError: it cannot be the name of a topic.

    Example:
        >>> print(message_on("odom", "nav_msgs/Odometry", lambda odom: odom["pose"]["pose"]["position"]["x"] > 2))
        a message on /odom satisfies the predicate
    """
    if predicate is not None and not callable(predicate):
        fix = "Give what takes a message: lambda message: message['data']."
        raise ConditionError(f"{predicate!r} is not a predicate", where=topic, fix=fix)
    return _MessageOn(topic, message_type, predicate, namespace)


def topic_above(
    topic: str, message_type: str, field: str, limit: float, *, namespace: str = "", within_s: float = math.inf
) -> Condition:
    """Return the condition that a field of a topic's newest message is above a limit.

    Args:
        topic: its name, relative to the robot's namespace unless it begins with `/`.
        message_type: its ROS type, such as `sensor_msgs/LaserScan`.
        field: the path to a number, such as `pose.pose.position.x` or `ranges.0`.
        limit: in the field's unit.
        namespace: which robot, where there are several.
        within_s: how old the newest message may be, s of the run's clock; left out, any age, unless the topic has
            fallen silent: after 20 messages or more for 10 s, and for ten times the longest time between two.

    Raises:
        ConditionError: the limit is not a finite number, `within_s` is not positive, or it cannot be a type or a field.
        LinkError: it cannot be the name of a topic.

    Example:
        >>> print(topic_above("battery_state", "sensor_msgs/BatteryState", "voltage", 11.1))
        voltage of /battery_state is above 11.1
    """
    return Bound(_TopicField(topic, message_type, field, namespace, within_s), limit, is_below=False)


def topic_below(
    topic: str, message_type: str, field: str, limit: float, *, namespace: str = "", within_s: float = math.inf
) -> Condition:
    """Return the condition that a field of a topic's newest message is below a limit; as `topic_above`."""
    return Bound(_TopicField(topic, message_type, field, namespace, within_s), limit, is_below=True)


def battery_above(
    limit: float,
    *,
    host: str | None = None,
    topic: str = "battery_state",
    namespace: str = "",
    ssh_config: str | Path | None = None,
) -> Condition:
    """Return the condition that the charge of a battery is above a limit: the robot's, or a computer's.

    Args:
        limit: the state of charge, 0..100 %.
        host: a computer whose battery is meant: `localhost`, or as ssh takes it; left out, the robot's.
        topic: of the robot's battery (`sensor_msgs/BatteryState`).
        namespace: which robot, where there are several.
        ssh_config: a file to take the place of the user's ssh config.

    Raises:
        ConditionError: the limit is not a finite number.
        LinkError: the host or the topic cannot be named so.

    Example:
        >>> print(battery_above(40))
        the battery of the robot is above 40 %
    """
    return Bound(_battery(host, topic, namespace, ssh_config), limit, is_below=False)


def battery_below(
    limit: float,
    *,
    host: str | None = None,
    topic: str = "battery_state",
    namespace: str = "",
    ssh_config: str | Path | None = None,
) -> Condition:
    """Return the condition that the charge of a battery is below a limit; as `battery_above`."""
    return Bound(_battery(host, topic, namespace, ssh_config), limit, is_below=True)


def _battery(host: str | None, topic: str, namespace: str, ssh_config: str | Path | None) -> Quantity:
    if host is not None:
        return ComputerBattery(ComputerName.named(host, ssh_config))
    return _RobotBattery(topic, _BATTERY_STATE, "percentage", namespace, _BATTERY_WITHIN)


class _Listening:
    """A subscription for a condition, made as soon as possible, and ended with the watching.

    Args:
        of: whose topic it is.
        take: gets each message; it must not raise.

    Attributes:
        name: the topic's full name, within the namespace of the run's robot.
    """

    def __init__(
        self,
        of: _MessageOn | _TopicField,
        take: Callable[[Message], None],
        context: RobotRunnerContext,
        opened: ExitStack,
        *,
        is_prompt: bool = True,
    ) -> None:
        self._of, self._take, self._is_prompt = of, take, is_prompt
        self._context, self._opened = context, opened
        self.name = full_name(robot_namespace(context, of.namespace), of.topic)
        self._is_subscribed = False
        self._next = -math.inf
        self._problem = ""
        self.problem()

    def problem(self) -> str:
        """Subscribe unless that is done; return why it is not possible yet, or empty.

        Raises:
            LinkError: the robot is a simulated one, which will never have such a topic, or there is no robot.
        """
        now = self._context.clock.now()
        if self._is_subscribed or now < self._next:
            return self._problem
        self._next = now + _AGAIN
        try:
            link = connect_robot(self._context, namespace=self._of.namespace)
            wanted = self._of.topic, self._of.message_type, self._take
            self._opened.callback(link.subscribe(*wanted, is_prompt=self._is_prompt).close)
        except LinkError as error:
            if self._context.robot is None or is_simulated(self._context.robot):
                raise
            self._problem = error.problem
        else:
            self._is_subscribed, self._problem = True, ""
        return self._problem


@dataclass(frozen=True)
class _MessageOn(Condition):
    topic: str
    message_type: str
    predicate: Callable[[Message], bool] | None
    namespace: str

    def __post_init__(self) -> None:
        checked_name(self.topic, self.namespace)
        check_type_named(self.message_type, where=self.topic)

    def __str__(self) -> str:
        there = "came" if self.predicate is None else "satisfies the predicate"
        return f"a message on {full_name(self.namespace, self.topic)} {there}"

    def check(self, robot: str | None) -> Iterable[Finding]:
        return check_robot_named(str(self), robot)

    def watch(self, context: RobotRunnerContext, opened: ExitStack) -> LookAgain:
        seen = _Judged(self.predicate)
        is_prompt = self.predicate is None  # which may take long
        listening = _Listening(self, seen.take, context, opened, is_prompt=is_prompt)

        def look() -> Look:
            problem = listening.problem()
            holds, count = seen.since_last_look()
            return Look(holds, problem or f"{count} messages on {listening.name}", is_known=not problem)

        return look


class _Judged:
    """The results of a predicate since the last look; messages may come in another thread."""

    def __init__(self, predicate: Callable[[Message], bool] | None) -> None:
        self._predicate = predicate
        self._lock = threading.Lock()
        self._count = 0
        self._is_new = self._any_held = self._held_last = False
        self._fault: Exception | None = None

    def take(self, message: Message) -> None:
        try:
            holds = self._predicate is None or bool(self._predicate(message))
        except Exception as error:  # noqa: BLE001 - the user's predicate; it is raised where the condition is awaited
            self._fault = self._fault or error
            return
        with self._lock:
            self._any_held = holds or (self._any_held and self._is_new)
            self._is_new, self._held_last = True, holds
            self._count += 1

    def since_last_look(self) -> tuple[bool, int]:
        """Return whether a message since the last look, or else the newest one, satisfied it; and how many came."""
        if self._fault is not None:
            raise self._fault
        with self._lock:
            holds = self._any_held if self._is_new else self._held_last
            self._is_new = False
            return holds, self._count


@dataclass(frozen=True)
class _TopicField(Quantity):
    topic: str
    message_type: str
    field: str
    namespace: str
    within_s: float

    def __post_init__(self) -> None:
        checked_name(self.topic, self.namespace)
        check_type_named(self.message_type, where=self.topic)
        if not isinstance(self.field, str) or not self.field:
            fix = "Name it with dots: 'pose.pose.position.x'."
            raise ConditionError(f"{self.field!r} is not a field", where=self.topic, fix=fix)
        if not is_number(self.within_s if self.within_s != math.inf else 0) or self.within_s <= 0:
            fix = "Give a number of seconds above 0, or leave it out."
            raise ConditionError(f"within_s is {self.within_s!r}", where=str(self), fix=fix)

    def __str__(self) -> str:
        return f"{self.field} of {full_name(self.namespace, self.topic)}"

    def check(self, robot: str | None) -> Iterable[Finding]:
        return check_robot_named(str(self), robot)

    def value_of(self, message: Message) -> Reading:
        """Return the field of a message; a `ConditionError` says that there is none, or that it is not a number."""
        return _number_at(message, self.field, str(self))

    def watch(self, context: RobotRunnerContext, opened: ExitStack) -> Callable[[], Reading]:
        clock = context.clock
        newest: list[tuple[float, Message]] = []
        count, longest = 0, 0.0

        def take(message: Message) -> None:
            nonlocal count, longest
            now = clock.now()
            count, longest = count + 1, max(longest, now - newest[0][0]) if newest else 0.0
            newest[:] = [(now, message)]

        listening = _Listening(self, take, context, opened)

        def read() -> Reading:
            problem = listening.problem()
            if not newest:
                return problem or f"no message on {listening.name} yet"
            at, message = newest[0]
            age = clock.now() - at
            silence = max(_SILENT, _PAUSES * longest) if count >= _REGULAR else math.inf
            if age > (self.within_s if self.within_s < math.inf else silence):
                return f"the newest message on {listening.name} is {age:.1f} s old"
            return self.value_of(message)

        return read


@dataclass(frozen=True)
class _RobotBattery(_TopicField):
    unit = "%"
    low, high = 0.0, _PERCENT

    def __str__(self) -> str:
        return f"the battery of the robot{f' {self.namespace}' if self.namespace else ''}"

    def value_of(self, message: Message) -> Reading:
        """Return the charge in %; boards without it publish NaN or a negative number, and some publish percents."""
        share = _number_at(message, self.field, str(self))
        if share > _MOST_SHARE:
            seen = f"the robot reports a {self.field} of {share:.6g}, and ROS has it from 0 to 1"
            return f"{seen}; topic_above and topic_below take it as it is"
        return _PERCENT * share if share >= 0 else "the robot does not report its charge"


def _number_at(message: Message, field: str, where: str) -> float:
    try:
        found = field_of(message, field, where=where)
    except LinkError as error:
        raise ConditionError(error.problem, where=where, fix=error.fix) from error
    if isinstance(found, bool | int | float):
        return float(found)
    shown = one_line(repr(found))[:60]
    raise ConditionError(f"the field {field!r} is not a number: {shown}", where=where, fix="Name a field that is one.")
