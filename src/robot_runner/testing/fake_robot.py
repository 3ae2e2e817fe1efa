"""A scripted robot link, which records publications, calls and goals."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from robot_runner.core.errors import GoalRejectedError, LinkError, did_you_mean
from robot_runner.core.events.context import Clock
from robot_runner.core.links.commanded_topics import VELOCITIES
from robot_runner.core.links.goals import GoalStatus
from robot_runner.core.links.graph_names import full_name
from robot_runner.core.links.robot import Encoding, GoalExecution, GraphEndpoint, Message, Qos, RawMessage
from robot_runner.ros.action_calls import missing_action
from robot_runner.ros.first_message import FirstMessage
from robot_runner.ros.shapes import completed, plain_type
from robot_runner.ros.watchdog import velocity_of
from robot_runner.testing.fake_actions import FakeAction, FakeGoal

if TYPE_CHECKING:
    from robot_runner.ros.type_catalogue import TypeCatalogue

_WHERE = "FakeRobotLink"
_NODE = "/fake_robot"
_ANY_TYPE = "*"
_DELIVER = "Deliver one while the clock is slept on: clock.at(1.0, lambda: link.deliver(...))."
#: The step of the clock between two checks of a wait, s.
_POLL = 0.01
#: The script of a service: a response, an error to raise, or a function from the request to a response.
Answer = Mapping[str, Any] | Exception | Callable[[Mapping[str, Any]], Mapping[str, Any]]


@dataclass(frozen=True, slots=True)
class Publication:
    """A message that was published to a robot, and when."""

    time: float
    topic: str
    message_type: str
    message: Message
    qos: Qos = Qos.DEFAULT


@dataclass(frozen=True, slots=True)
class ServiceCall:
    """A service of a robot that was called, and when."""

    time: float
    service: str
    service_type: str
    request: Message


class _Subscription:
    """A subscription of the fake link, until it is closed."""

    def __init__(self, message_type: str, callback: Callable[[Message], None]) -> None:
        self.message_type = message_type
        self.callback = callback
        self.is_closed = False

    def close(self) -> None:
        """End the subscription; closing twice does nothing."""
        self.is_closed = True


def _offer(offered: dict[str, Any], name: str) -> ExitStack:
    """Return the offer of a service or action; closing it ends the offer, closing twice does nothing."""
    offer = ExitStack()
    offer.callback(offered.pop, name)
    return offer


class FakeRobotLink:
    """A `RobotLink` that records operations and answers as a test scripts.

    Names are used as given; messages are not checked against their types. Raw messages are those of ROS 2. Each
    operation on the robot, which `definition` and `deliver` are not, raises the fault that is set, and a `LinkError`
    once the link is closed.

    Attributes:
        publications: what was published, oldest first.
        calls: the services that were called, oldest first.
        goals: the goals that were sent, oldest first.
        is_simulated: as given.
        encoding: that of ROS 2.
        is_closed: whether it was closed.
        fault: if set, every operation raises it.
        known_topics: the types of topics that other nodes publish or subscribe, by name.
        known_publishers: other publishers of a topic, by name; one node where left out and the topic exists.
        known_subscribers: other subscribers of a topic; likewise.

    Example:
        >>> from robot_runner.testing import FakeClock, FakeRobotLink
        >>> link = FakeRobotLink(FakeClock(), services={"lamp/on": {"success": True}})
        >>> received = []
        >>> subscription = link.subscribe("battery_state", "sensor_msgs/BatteryState", received.append)
        >>> link.deliver("battery_state", {"voltage": 11.1})
        >>> received, link.call("lamp/on", "std_srvs/Trigger")
        ([{'voltage': 11.1}], {'success': True})
    """

    encoding = Encoding.CDR

    def __init__(
        self,
        clock: Clock,
        *,
        services: Mapping[str, Answer] | None = None,
        actions: Mapping[str, FakeAction] | None = None,
        is_simulated: bool = False,
    ) -> None:
        self.publications: list[Publication] = []
        self.calls: list[ServiceCall] = []
        self.goals: list[FakeGoal] = []
        self.is_closed = False
        self.fault: LinkError | None = None
        self._clock = clock
        self.known_topics: dict[str, str] = {}
        self.known_publishers: dict[str, list[GraphEndpoint]] = {}
        self.known_subscribers: dict[str, list[GraphEndpoint]] = {}
        self._services = dict(services or {})
        self._actions = dict(actions or {})
        self._executes: dict[str, Callable[[GoalExecution], Message]] = {}
        self._accepts: dict[str, Callable[[Message], bool] | None] = {}
        self._service_types: dict[str, str] = {}
        self.is_simulated = is_simulated
        self._advertised: dict[str, str] = {}
        self._subscriptions: defaultdict[str, list[_Subscription]] = defaultdict(list)

    @property
    def stands_still(self) -> bool:
        """Whether the last velocity command on each topic was zero, or there was none."""
        commands = [(each, plain_type(each.message_type)) for each in self.publications]
        last = {
            full_name("", each.topic): velocity_of(kind, each.message) for each, kind in commands if kind in VELOCITIES
        }
        return not any(map(_moves, last.values()))

    @property
    def topics_heard(self) -> set[str]:
        """The topics with an open subscription."""
        return {
            topic
            for topic, subscriptions in self._subscriptions.items()
            if not all(each.is_closed for each in subscriptions)
        }

    def publish(self, topic: str, message_type: str, message: Message, *, qos: Qos = Qos.DEFAULT) -> None:
        """Record the message."""
        self._check()
        self.publications.append(Publication(self._clock.now(), topic, message_type, message, qos))

    def advertise(self, topic: str, message_type: str, *, qos: Qos = Qos.DEFAULT, is_commanded: bool = True) -> bool:
        """Add the topic to the graph; all its subscribers count as connected."""
        del qos, is_commanded
        self._check()
        self._advertised[topic] = message_type
        return True

    def subscribe(
        self,
        topic: str,
        message_type: str,
        callback: Callable[[Message], None],
        *,
        qos: Qos | None = None,
        is_prompt: bool = False,
    ) -> _Subscription:
        """Call `callback` with each message that is delivered on the topic."""
        del qos, is_prompt
        self._check()
        subscription = _Subscription(message_type, callback)
        self._subscriptions[topic].append(subscription)
        return subscription

    def subscribe_raw(
        self, topic: str, message_type: str, callback: Callable[[RawMessage], None], *, qos: Qos | None = None
    ) -> _Subscription:
        """Call `callback` with the bytes of each message that is delivered on the topic, completed by its type.

        Raises:
            LinkError: also where there is no such type.
        """
        self._check()
        types = _standard_types()
        shape = types.shape(message_type)

        def receive(message: Message) -> None:
            data = types.serialise(message_type, completed(shape, message, where=topic), Encoding.CDR)
            callback(RawMessage(data, round(self._clock.now() * 1e9)))

        return self.subscribe(topic, message_type, receive, qos=qos)

    def wait_for(
        self, topic: str, message_type: str, condition: Callable[[Message], bool] | None = None, *, timeout: float = 5.0
    ) -> Message:
        """Move the clock on until a delivered message satisfies the condition (None: any message).

        Raises:
            LinkError: also where none does within `timeout` s of the clock.
        """
        first = FirstMessage(condition, timeout)
        subscription, deadline = self.subscribe(topic, message_type, first.take), self._clock.now() + timeout
        try:
            while not first.is_over.is_set() and self._clock.now() < deadline:
                self._clock.sleep(_POLL)
        finally:
            subscription.close()
        return first.result(topic, lambda: _DELIVER)

    def deliver(self, topic: str, message: Message) -> None:
        """Deliver a message to all subscriptions of the topic."""
        for subscription in list(self._subscriptions[topic]):
            if not subscription.is_closed:
                subscription.callback(message)

    def call(self, service: str, service_type: str, request: Message | None = None, *, timeout: float = 5.0) -> Message:
        """Record the call and answer as scripted; without a script for the service, a `LinkError` names the nearest."""
        del timeout
        self._check()
        self.calls.append(ServiceCall(self._clock.now(), service, service_type, request or {}))
        if service not in self._services:
            fix = did_you_mean(service, self._services)
            raise LinkError(f"there is no service {service!r}", where=_WHERE, fix=fix)
        answer = self._services[service]
        if isinstance(answer, Exception):
            raise answer
        return answer(request or {}) if callable(answer) else answer

    def offer(self, service: str, service_type: str, answer: Callable[[Message], Message]) -> ExitStack:
        """Let a function answer `call` until the offer is closed; a `LinkError` if the service exists already."""
        self._check()
        if service in self._services:
            raise LinkError(f"there is a service {service!r} already", where=_WHERE, fix="Choose another name.")
        self._services[service] = answer
        self._service_types[service] = plain_type(service_type)
        return _offer(self._services, service)

    def send_goal(
        self,
        action: str,
        action_type: str,
        goal: Message | None = None,
        *,
        on_feedback: Callable[[Message], None] | None = None,
        timeout: float = 5.0,
    ) -> FakeGoal:
        """Record the goal, which proceeds as scripted.

        Raises:
            LinkError: also where the action was not scripted, has another type, or rejects the goal.
        """
        del timeout
        self._check()
        script = self._actions.get(action)
        if script is None or plain_type(script.action_type) not in {_ANY_TYPE, plain_type(action_type)}:
            raise missing_action(action, action_type, {name: each.action_type for name, each in self._actions.items()})
        accept = self._accepts.get(action)
        if script.status is GoalStatus.REJECTED or not (accept is None or accept(goal or {})):
            raise GoalRejectedError("the action server rejects the goal", where=action, fix="Send another.")
        sent = action, action_type, goal or {}
        self.goals.append(FakeGoal(self._clock, script, sent, on_feedback, self._executes.get(action)))
        return self.goals[-1]

    def offer_action(
        self,
        action: str,
        action_type: str,
        execute: Callable[[GoalExecution], Message],
        *,
        accept: Callable[[Message], bool] | None = None,
    ) -> ExitStack:
        """Let a function execute goals, each when it is first waited for, until the offer is closed; as `offer`."""
        self._check()
        if action in self._actions:
            raise LinkError(f"there is an action {action!r} already", where=_WHERE, fix="Choose another name.")
        self._actions[action] = FakeAction(action_type=action_type)
        self._executes[action], self._accepts[action] = execute, accept
        return _offer(self._actions, action)

    def actions(self) -> dict[str, str]:
        """Return the types of the actions; `*` for one that a test scripted without a type."""
        self._check()
        return {full_name("", name): script.action_type for name, script in self._actions.items()}

    def topics(self) -> dict[str, str]:
        """Return the types of the topics that are published and subscribed here, and of `known_topics`."""
        self._check()
        types = dict(self.known_topics)
        types |= {
            topic: subscriptions[-1].message_type
            for topic, subscriptions in self._subscriptions.items()
            if subscriptions
        }
        types |= self._advertised
        types |= {each.topic: each.message_type for each in self.publications}
        return {full_name("", topic): plain_type(message_type) for topic, message_type in types.items()}

    def services(self) -> dict[str, str]:
        """Return the types of the services; `*` for one that a test scripted."""
        self._check()
        return {full_name("", name): self._service_types.get(name, _ANY_TYPE) for name in self._services}

    def nodes(self) -> list[str]:
        """Return one node."""
        self._check()
        return [_NODE]

    def publishers(self, topic: str) -> list[GraphEndpoint]:
        """Return this link if it published, and `known_publishers`, or else one node where the topic exists."""
        self._check()
        name = full_name("", topic)
        types = self._advertised | {each.topic: each.message_type for each in self.publications}
        own = [message_type for each, message_type in types.items() if full_name("", each) == name]
        is_here = name in self.topics() and (not own or topic in self.known_topics)
        default = [GraphEndpoint(_NODE, self.topics()[name])] if is_here else []
        others = self.known_publishers.get(topic, default)
        return [*others, *([GraphEndpoint("/robot_runner", plain_type(own[-1]), is_own=True)] if own else [])]

    def subscribers(self, topic: str) -> list[GraphEndpoint]:
        """Return `known_subscribers`, or else one node where the topic exists."""
        self._check()
        name = full_name("", topic)
        default = [GraphEndpoint(_NODE, self.topics()[name])] if name in self.topics() else []
        return list(self.known_subscribers.get(topic, default))

    def definition(self, message_type: str) -> str:
        """Return the text of a type's definition in ROS 2; a `LinkError` if there is no such type."""
        return _standard_types().definition(message_type)

    def close(self) -> None:
        """Cancel the goals that are not over and end all subscriptions; closing twice does nothing."""
        if not self.is_closed:
            for goal in self.goals:
                with suppress(LinkError):
                    goal.cancel()
        self.is_closed = True
        self._subscriptions.clear()

    def _check(self) -> None:
        if self.fault is not None:
            raise self.fault
        if self.is_closed:
            raise LinkError("the link was closed", where=_WHERE, fix="Use it before the run ends.")


def _standard_types() -> TypeCatalogue:
    from robot_runner.ros.type_catalogue import TypeCatalogue  # noqa: PLC0415  # it takes rosbags

    return TypeCatalogue.of(2)


def _moves(command: Message) -> bool:
    parts = [each for name, each in command.items() if name != "header"]
    return any(_moves(each) if isinstance(each, Mapping) else each for each in parts)
