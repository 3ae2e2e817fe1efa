"""What this process commands a robot by, so that a standby can stop it there: topics of velocities, and actions."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, closing, contextmanager, suppress
from contextvars import ContextVar
from typing import NamedTuple

from robot_runner.core.errors import LinkError, SilentGraphError
from robot_runner.core.links.graph_names import is_left_by_the_dead
from robot_runner.core.links.robot import Advertiser, Message, Qos, Rejoiner, RobotLink
from robot_runner.core.links.robot_claims import claim_commanded
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
#: The topics of `zero_first`, with their types.
_zero_first: ContextVar[Sequence[tuple[str, str]] | None] = ContextVar("zero first", default=None)


def hear_commanded(listener: Callable[[Commanded], object]) -> None:
    """Call `listener` with each topic or action before the first velocity is commanded, or the first goal sent."""
    _listeners.append(listener)


def tell_commanded(topic: str, message_type: str, graph: str | None = "") -> None:
    """Tell the listeners that a robot will be commanded by a topic or an action, with the fields of `Commanded`.

    Without a graph they are not told: a robot that is simulated in this process ends with it.

    Raises:
        LinkError: a callback is about to command a robot that another run, experiment or user has claimed.

    Example:
        >>> hear_commanded(print)
        >>> tell_commanded("/alice/cmd_vel", "geometry_msgs/Twist", "ros1")
        Commanded(topic='/alice/cmd_vel', message_type='geometry_msgs/Twist', graph='ros1')
        >>> _listeners.clear()
    """
    if graph is not None:
        claim_commanded(topic, graph)  # before a standby hears of it: it must not stop what somebody else has
        for listener in _listeners:
            listener(Commanded(topic, message_type, graph))
    _types[topic] = message_type


def commanded_type(topic: str) -> str | None:
    """Return the type by which this process commanded a robot on a topic, by its full name; None where it did not."""
    return _types.get(topic)


@contextmanager
def zero_first(topics: Sequence[tuple[str, str]]) -> Iterator[None]:
    """Have a link that is opened or used meanwhile command zero on topics (name and type) before it asks anything.

    What it asks afterwards, it does not wait long for, as goals are still to be cancelled.

    Example:
        >>> with zero_first([("/cmd_vel", "geometry_msgs/Twist")]):
        ...     topics_of_zero_first()
        [('/cmd_vel', 'geometry_msgs/Twist')]
        >>> topics_of_zero_first()
        ()
    """
    token = _zero_first.set(topics)
    try:
        yield
    finally:
        _zero_first.reset(token)


def topics_of_zero_first() -> Sequence[tuple[str, str]]:
    """Return the topics, with their types, on which zero is commanded first; none outside of `zero_first`."""
    return _zero_first.get() or ()


def is_zero_first() -> bool:
    """Whether `zero_first` is in force, though perhaps for no topic."""
    return _zero_first.get() is not None


def keep_commanding_zero(link: RobotLink, commanded: Sequence[tuple[str, str]]) -> list[str]:
    """Command zero on topics (name and type) of one graph for some seconds, and until every subscriber is reached.

    On a topic without a subscriber, one is awaited for as long: it may have to be discovered. Where a dead process of
    ours is listed as one, a participant that joins after its death commands as well, and tells who is reached. Return
    what remains doubtful: topics without a subscriber, and those whose subscribers the graph does not tell.

    Raises:
        LinkError: a subscriber of a topic, or the robot, is not reached. A failure at one topic is raised after the
            others are done; a failure at all of them immediately.
    """
    with zero_first(commanded), _rejoining(link, commanded) as links_now:
        began = time.monotonic()
        while True:
            time.sleep(_PERIOD)
            seconds = time.monotonic() - began
            links, is_known = links_now()
            reached: dict[str, bool | str] = {}
            faults: dict[str, Exception] = {}
            for topic, message_type in commanded:
                try:
                    if seconds >= _TELLING:
                        reached[topic] = _is_reached(links, topic, message_type, is_known=is_known)
                except Exception as error:  # noqa: BLE001 - raised below
                    faults.setdefault(topic, error)
                try:  # once more where it is reached: what was told before is lost
                    for each in links:
                        each.publish(topic, message_type, {})
                except Exception as error:  # noqa: BLE001 - raised below
                    faults.setdefault(topic, error)
            is_over = seconds > _REACHING or (seconds >= _TELLING and all(each is True for each in reached.values()))
            if faults and (is_over or len(faults) == len(commanded)):
                raise next(iter(faults.values()))
            missed = [topic for topic, is_reached in reached.items() if is_reached is False]
            if missed and seconds > _REACHING:
                raise _not_reached(link, missed[0], seconds)
            if is_over:
                return [doubt for doubt in reached.values() if isinstance(doubt, str)]


@contextmanager
def _rejoining(
    link: RobotLink, commanded: Sequence[tuple[str, str]]
) -> Iterator[Callable[[], tuple[list[RobotLink], bool]]]:
    """Yield what returns the links to command over, and whether the last one can tell yet who is reached.

    That is the link alone, until it lists a dead process as a subscriber: Fast DDS lists one that was killed for 20 s,
    and as it acknowledges nothing, it is not known meanwhile whether the others have taken a command.
    """
    with ExitStack() as opened:
        joining: list[Future[RobotLink]] = []

        def join(rejoiner: Rejoiner) -> RobotLink:
            other = opened.enter_context(closing(rejoiner.rejoined()))
            for topic, message_type in commanded:  # which waits until the subscribers are discovered
                _reaches(other, topic, message_type)
            return other

        def links_now() -> tuple[list[RobotLink], bool]:
            with suppress(Exception):  # commanding over the link raises it, too
                topics = () if joining else commanded
                listed = (each.node for topic, _ in topics for each in link.subscribers(topic))
                if isinstance(link, Rejoiner) and any(map(is_left_by_the_dead, listed)):
                    joining.append(opened.enter_context(ThreadPoolExecutor(1)).submit(join, link))
            if not (joining and joining[0].done()):
                return [link], not joining
            return [link] if joining[0].exception() else [link, joining[0].result()], True

        yield links_now


def _is_reached(links: Sequence[RobotLink], topic: str, message_type: str, *, is_known: bool) -> bool | str:
    """Return whether all that subscribe to a topic, by any link, are reached by the last, or why that is doubtful."""
    # First: that takes up to a second, in which one that takes nothing may come to count as gone.
    is_reached = is_known and _reaches(links[-1], topic, message_type)
    try:
        listed = [{each.node for each in link.subscribers(topic) if each.may_be_others} for link in links]
    except SilentGraphError as error:
        return is_reached and f"zero was published on {topic}, but its subscribers are not known: {error.problem}"
    alive = {node for node in listed[0] if not is_left_by_the_dead(node)}
    return is_reached and alive <= listed[-1] if alive or listed[-1] else f"nobody subscribes to {topic} any more"


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
