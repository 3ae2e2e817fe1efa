"""What this process commands a robot by, so that a standby can stop it there: topics of velocities, and actions."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import NamedTuple

from robot_runner.core.errors import LinkError
from robot_runner.core.links.robot import Advertiser, Message, Qos, RobotLink
from robot_runner.core.words import enumerated

#: The types of a velocity in all directions.
TWISTS = frozenset({"geometry_msgs/Twist", "geometry_msgs/TwistStamped"})
#: A robot carries out a command of these types until the next one; an empty message, all zero, stops it.
VELOCITIES = TWISTS | {"ackermann_msgs/AckermannDrive", "ackermann_msgs/AckermannDriveStamped"}
#: The type of the request that cancels the goals of an action; an empty one cancels all (`goal_cancelling`).
CANCELLING = "action_msgs/CancelGoal"
#: What an empty message or request stops.
STOPPED_BY_EMPTY = VELOCITIES | {CANCELLING}
#: In the problem of a finding or a failure: the robot could not be stopped, so that no further run begins.
MAY_BE_MOVING = "THE ROBOT MAY BE MOVING"
#: The reason why an experiment was stopped then (`stopped_by`).
MOVING_ROBOT = "a robot that may be moving"
#: The fix.
STOP_BY_HAND = (
    "Stop it by hand, and start the experiment again: it resumes. A watchdog on the robot stops it when the laptop "
    "falls silent."
)
#: For how long and how often zero is commanded, s: a subscriber may be discovered late, on Fast DDS up to 3.2 s after
#: this process has joined, and one message may be lost.
_TELLING, _PERIOD = 4.0, 0.1
#: For how long if a subscriber is not reached by then, s: on a busy machine, ROS 1 has taken more than 4 s.
_REACHING = 10.0


class Commanded(NamedTuple):
    """A topic on which velocities are commanded, or an action to which goals are sent.

    Attributes:
        topic: of the velocities, or the action; by its full name.
        message_type: of the velocities; `CANCELLING` for an action.
        graph: how its graph is reached, such as `dds:domain=7`; empty for that of the run's robot.
    """

    topic: str
    message_type: str
    graph: str = ""


_listeners: list[Callable[[Commanded], object]] = []
#: The type of each topic on which this process commands a robot, by the topic's full name.
_types: dict[str, str] = {}


def hear_commanded(listener: Callable[[Commanded], object]) -> None:
    """Call `listener` with each topic or action before the first velocity is commanded, or the first goal sent."""
    _listeners.append(listener)


def tell_commanded(topic: str, message_type: str, graph: str | None = "") -> None:
    """Tell the listeners that a robot will be commanded by a topic or an action, with the fields of `Commanded`.

    Without a graph they are not told: a robot that is simulated in this process ends with it.

    Example:
        >>> hear_commanded(print)
        >>> tell_commanded("/alice/cmd_vel", "geometry_msgs/Twist", "ros1")
        Commanded(topic='/alice/cmd_vel', message_type='geometry_msgs/Twist', graph='ros1')
        >>> _listeners.clear()
    """
    _types[topic] = message_type
    if graph is not None:
        for listener in _listeners:
            listener(Commanded(topic, message_type, graph))


def commanded_type(topic: str) -> str | None:
    """Return the type by which this process commanded a robot on a topic, by its full name; None where it did not."""
    return _types.get(topic)


def keep_commanding_zero(link: RobotLink, commanded: Sequence[tuple[str, str]]) -> list[str]:
    """Command zero on topics (name and type) of one graph for some seconds, and until every subscriber is reached.

    On a topic without a subscriber, one is awaited for as long: it may have to be discovered.

    Returns:
        the topics without a subscriber.

    Raises:
        LinkError: a subscriber of a topic, or the robot, is not reached. A failure at one topic is raised after the
            others are done; a failure at all of them immediately.
    """
    began = time.monotonic()
    while True:
        time.sleep(_PERIOD)
        seconds = time.monotonic() - began
        empty: list[str] = []
        missed: list[str] = []
        faults: dict[str, Exception] = {}
        for topic, message_type in commanded:
            try:
                # First: that takes up to a second, in which one that takes nothing may come to count as gone.
                is_reached = seconds >= _TELLING and _reaches(link, topic, message_type)
                if seconds >= _TELLING and not any(each.may_be_others for each in link.subscribers(topic)):
                    empty.append(topic)
                elif seconds >= _TELLING and not is_reached:
                    missed.append(topic)
            except Exception as error:  # noqa: BLE001 - raised below
                faults.setdefault(topic, error)
            try:  # once more where it is reached: what was told before is lost
                link.publish(topic, message_type, {})
            except Exception as error:  # noqa: BLE001 - raised below
                faults.setdefault(topic, error)
        is_over = seconds > _REACHING or (seconds >= _TELLING and not (empty or missed))
        if faults and (is_over or len(faults) == len(commanded)):
            raise next(iter(faults.values()))
        if missed and seconds > _REACHING:
            raise _not_reached(link, missed[0], seconds)
        if is_over:
            return empty


def command_for_certain(link: RobotLink, topic: str, message_type: str, message: Message) -> None:
    """Publish a single command, again and again until every subscriber is reached.

    A new publisher waits for its subscribers, but on a busy machine not long enough.

    Raises:
        LinkError: a subscriber is not reached, or the robot cannot be.
    """
    await_subscribers(link, topic, message_type, lambda: link.publish(topic, message_type, message))


def await_subscribers(
    link: RobotLink,
    topic: str,
    message_type: str,
    meanwhile: Callable[[], object] = lambda: None,
    *,
    qos: Qos = Qos.DEFAULT,
) -> None:
    """Return once every subscriber of a topic is reached; `meanwhile` is called after each look.

    Raises:
        LinkError: a subscriber is not reached, or the robot cannot be.
    """
    began = time.monotonic()
    while True:
        is_reached = _reaches(link, topic, message_type, qos)
        meanwhile()  # those that are reached must not wait for the others
        if is_reached:
            return
        if (seconds := time.monotonic() - began) > _REACHING:
            raise _not_reached(link, topic, seconds)
        time.sleep(_PERIOD)  # some links tell at once that it is not


def _not_reached(link: RobotLink, topic: str, seconds: float) -> LinkError:
    """Return the error, with all subscribers: it may be another one, as of a laptop that was switched off."""
    names = ""
    with suppress(LinkError):
        names = enumerated(each.node for each in link.subscribers(topic) if not each.is_own)
    problem = f"the robot's subscription is not reached within {seconds:.0f} s{names and f' (subscribers: {names})'}"
    return LinkError(problem, where=topic, fix="See that it stands still.")


def _reaches(link: RobotLink, topic: str, message_type: str, qos: Qos = Qos.DEFAULT) -> bool:
    return not isinstance(link, Advertiser) or link.advertise(topic, message_type, qos=qos)
