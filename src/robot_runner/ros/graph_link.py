"""The one link to a robot on a graph: names, messages, subscriptions and the last stop, over any transport."""

from __future__ import annotations

import logging
import threading
from contextlib import ExitStack, closing
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from robot_runner.core.errors import LinkError
from robot_runner.core.events.unhandled import raised_in_thread
from robot_runner.core.links.robot import Qos
from robot_runner.ros.graph_links import full_name, namespace_prefix
from robot_runner.ros.graph_transport import check_type
from robot_runner.ros.sent_velocities import note_velocity
from robot_runner.ros.shapes import completed, plain_type
from robot_runner.ros.watchdog import VELOCITY_COMMANDS, planar, velocity_of

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from robot_runner.core.links.robot import Encoding, GraphEndpoint, Message, RawMessage, Subscription
    from robot_runner.ros.graph_transport import Reception, TopicPublisher, TopicSubscription, Transport
    from robot_runner.ros.parameter_access import ParameterServer
    from robot_runner.ros.shapes import Shape

__all__ = ["FirstMessage", "GraphLink"]

_logger = logging.getLogger(__name__)

#: How long the last command, to stand still, may take to reach the robot, s: a robot two hops of Wi-Fi away takes it
#: within tenths, and a run must not hang on one that is switched off.
_STOPPING_SECONDS = 2.0
#: What `topics` says where neither the graph nor a subscription of this link tells the type.
_UNKNOWN_TYPE = "*"


@dataclass(frozen=True, slots=True)
class _Advertised:
    """A topic that this link publishes with one QoS."""

    message_type: str
    shape: Shape
    publisher: TopicPublisher


class _Opened:
    """A subscription or an offer of the link, until it is closed."""

    def __init__(self, name: str, type_name: str, forget: Callable[[_Opened], None]) -> None:
        self.name = name
        self.type_name = type_name
        self.is_open = True
        self.inner: Any = None
        self.fault_count = 0
        self.has_failed_run = False
        self._forget = forget

    def close(self) -> None:
        """Receive no more; closing twice does nothing."""
        if self.is_open:
            self.is_open = False
            self._forget(self)
            self.inner.close()


class FirstMessage:
    """Keeps the first message that satisfies a condition, or what the condition raised.

    Args:
        condition: None for any message.
        timeout: how long it is waited for, s; for the error.

    Attributes:
        is_over: set once there is one, or the condition raised.
    """

    def __init__(self, condition: Callable[[Message], bool] | None, timeout: float) -> None:
        self.is_over = threading.Event()
        self._condition = condition
        self._timeout = timeout
        self._found: Message | None = None
        self._fault: Exception | None = None

    def take(self, message: Message) -> None:
        """Look at one message."""
        if self.is_over.is_set():
            return
        try:
            if self._condition is None or self._condition(message):
                self._found = message
                self.is_over.set()
        except Exception as fault:  # noqa: BLE001 - it is raised to the caller whose condition this is
            self._fault = fault
            self.is_over.set()

    def result(self, topic: str, explain: Callable[[], str]) -> Message:
        """Return the message.

        Raises:
            LinkError: there was none in time; `explain` says what to do.
            Exception: what the condition raised.
        """
        if self._fault is not None:
            raise self._fault
        if self._found is None:
            what = "no message" if self._condition is None else "no message that satisfies the condition"
            fix = explain() or "Look whether the topic's node is alive, or give a longer timeout."
            raise LinkError(f"{what} came within {self._timeout:g} s", where=topic, fix=fix)
        return self._found


class GraphLink:
    """A link to one robot of a graph; what differs between client libraries is the transport's.

    It owns the full names within the robot's namespace, the completion of messages by their types, all publishers,
    subscriptions and offers until they are closed in reverse order, the deadline of `wait_for`, and the last stop:
    where it published a velocity, it publishes zero before it leaves. A callback that raises does not end its
    subscription, and fails the run at once, whatever the transport. Where no run is going on, it is raised where the
    callback is called from or, on a transport with threads of its own, logged and raised by `close`.

    Args:
        connect: joins the graph.
        namespace: the robot's, such as `/alice`.
        is_simulated: whether there is a simulation behind it for certain.

    Attributes:
        namespace: what relative names are below: empty, or `/alice`.
        parameter_server: that of ROS 1's master; None in ROS 2, whose nodes have their parameters themselves.

    Raises:
        LinkError: the namespace cannot be one, or the graph cannot be joined.

    Example:
        ```python
        link = open_dds_link({"domain": "7"}, SystemClock(), "/alice")
        link.publish("cmd_vel", "geometry_msgs/Twist", {"linear": {"x": 0.1}})
        link.close()  # the robot stands still
        ```
    """

    def __init__(self, connect: Callable[[], Transport], namespace: str = "", *, is_simulated: bool = False) -> None:
        self.namespace = namespace_prefix(namespace)  # refused before anything is opened
        self._is_simulated = is_simulated
        self._lock = threading.RLock()
        self._advertised: dict[tuple[str, Qos], _Advertised] = {}
        self._opened: dict[_Opened, None] = {}  # in the order in which they were opened
        self._first_fault: tuple[str, Exception] | None = None
        self._is_closed = False
        self._transport = connect()
        self.parameter_server: ParameterServer | None = getattr(self._transport, "parameter_server", None)

    @property
    def is_simulated(self) -> bool:
        """Whether there is a simulation behind it for certain; `connect.is_simulation` asks a graph for its signs."""
        return self._is_simulated

    @property
    def encoding(self) -> Encoding:
        """How the bytes of raw messages are laid out."""
        return self._transport.encoding

    def publish(self, topic: str, message_type: str, message: Message, *, qos: Qos = Qos.DEFAULT) -> None:
        """Publish one message; at first use of a topic, once the subscribers that are there already are reached.

        Raises:
            LinkError: the message does not follow its definition, the topic carries another type, or the graph is lost.
        """
        name = self._name(topic)
        advertised = self._advertised.get((name, qos)) or self._advertise(name, message_type, message, qos)
        if advertised.message_type != message_type:
            check_type(name, message_type, [advertised.message_type])
        complete = completed(advertised.shape, message, where=name)
        if advertised.message_type in VELOCITY_COMMANDS:
            note_velocity(name, planar(velocity_of(advertised.message_type, complete)))
        advertised.publisher.publish(complete)

    def advertise(self, topic: str, message_type: str, *, qos: Qos = Qos.DEFAULT) -> None:
        """Return once the subscribers of a topic that are there already would receive what is published."""
        name = self._name(topic)
        check_type(name, message_type, [self._advertise(name, message_type, {}, qos).message_type])

    def subscribe(
        self, topic: str, message_type: str, callback: Callable[[Message], None], *, qos: Qos | None = None
    ) -> Subscription:
        """Have `callback` called with each message of the topic.

        Raises:
            LinkError: there is no such type, the topic carries another, or its publishers offer less than `qos`.
        """
        return self._subscribe(topic, message_type, lambda reception: callback(reception.message()), qos, is_raw=False)

    def subscribe_raw(
        self, topic: str, message_type: str, callback: Callable[[RawMessage], None], *, qos: Qos | None = None
    ) -> Subscription:
        """Have `callback` called with the bytes of each message of the topic; as `subscribe` in all else."""
        return self._subscribe(topic, message_type, lambda reception: callback(reception.raw()), qos, is_raw=True)

    def wait_for(
        self,
        topic: str,
        message_type: str,
        condition: Callable[[Message], bool] | None = None,
        *,
        timeout: float = 5.0,
    ) -> Message:
        """Return the first message from now on that satisfies the condition; `timeout` is in seconds.

        Raises:
            LinkError: none came in time, or as `subscribe`.
            Exception: what the condition raised.
        """
        first = FirstMessage(condition, timeout)
        take: Callable[[Reception], None] = lambda reception: first.take(reception.message())  # noqa: E731
        with closing(self._subscribe(topic, message_type, take, None, is_raw=False)) as subscription:
            self._transport.wait(first.is_over, timeout)
        return first.result(subscription.name, subscription.inner.explain)

    def call(self, service: str, service_type: str, request: Message | None = None, *, timeout: float = 5.0) -> Message:
        """Call a service and return its response; `timeout` is in seconds.

        Raises:
            LinkError: there is no such service, it has another type, fails or does not answer in time, or the request
                does not follow its definition.
        """
        name = self._name(service)
        complete = completed(self._transport.types.request(service_type), request or {}, where=name)
        return self._transport.call(name, plain_type(service_type), complete, timeout)

    def offer(self, service: str, service_type: str, answer: Callable[[Message], Message]) -> Subscription:
        """Offer a service until it is closed; `answer` may be called from a thread of the transport.

        Raises:
            LinkError: there is no such type, or a service of this name is offered already.
        """
        name, types = self._name(service), self._transport.types
        types.request(service_type)
        shape = types.response(service_type)

        def serve(opened: _Opened) -> Subscription:
            def respond(request: Message) -> Message:
                try:
                    return completed(shape, answer(request), where=f"the answer of {name}")
                except Exception as fault:
                    if not self._fails_run(opened, fault, "answer") and self._transport.has_threads:
                        _logger.exception("the service %s failed", name)
                    raise

            return self._transport.serve(name, plain_type(service_type), respond)

        return self._open(name, service_type, serve)

    def topics(self) -> Mapping[str, str]:
        """Return the type of each topic that is published or subscribed, by full name; `*` where nothing tells it."""
        self._check_open("the graph")
        own = {opened.name: plain_type(opened.type_name) for opened in list(self._opened)}
        return {name: told or own.get(name, _UNKNOWN_TYPE) for name, told in self._transport.topics().items()}

    def services(self) -> Mapping[str, str]:
        """Return the type of each service on the graph, by its full name."""
        self._check_open("the graph")
        return self._transport.services()

    def nodes(self) -> Sequence[str]:
        """Return the full names of the nodes on the graph, sorted."""
        self._check_open("the graph")
        return sorted(self._transport.nodes())

    def publishers(self, topic: str) -> Sequence[GraphEndpoint]:
        """Return who publishes a topic, this link included; nobody where there is no such topic."""
        return list(self._transport.publishers(self._name(topic)))

    def subscribers(self, topic: str) -> Sequence[GraphEndpoint]:
        """Return who subscribes a topic, this link included; nobody where there is no such topic."""
        return list(self._transport.subscribers(self._name(topic)))

    def definition(self, message_type: str) -> str:
        """Return the text of a type's definition, followed by the types that it is made of.

        Raises:
            LinkError: there is no such type, or nothing here has its text.
        """
        return self._transport.types.definition(message_type)

    def close(self) -> None:
        """Stop the robot if it was driven; end all subscriptions and offers and leave; closing twice does nothing.

        Raises:
            LinkError: the robot could not be told to stand still, a callback raised, or the graph cannot be left.
        """
        if self._is_closed:
            return
        self._is_closed = True
        with ExitStack() as stack:  # what was pushed last is done first, and all of it whatever fails
            stack.callback(self._raise_fault)
            stack.callback(self._transport.close)
            for opened in list(self._opened):
                stack.callback(opened.close)
            for advertised in self._advertised.values():
                stack.callback(advertised.publisher.close)
            for (topic, _), advertised in self._advertised.items():
                if advertised.message_type in VELOCITY_COMMANDS:
                    stack.callback(_stop, topic, advertised)

    def _name(self, given: str) -> str:
        name = full_name(self.namespace, given)
        self._check_open(name)
        return name

    def _check_open(self, where: str) -> None:
        if self._is_closed:
            raise LinkError("the link was closed", where=where, fix="Use it before the run ends.")

    def _advertise(self, name: str, message_type: str, message: Message, qos: Qos) -> _Advertised:
        plain = plain_type(message_type)
        with self._lock:
            known = self._advertised.get((name, qos))
            if known is None:
                shape = self._transport.types.shape(message_type)
                completed(shape, message, where=name)  # a wrong message is refused before the topic is on the graph
                known = _Advertised(plain, shape, self._transport.advertise(name, plain, qos))
                self._advertised[name, qos] = known
            return known

    def _subscribe(
        self,
        topic: str,
        message_type: str,
        deliver: Callable[[Reception], None],
        qos: Qos | None,
        *,
        is_raw: bool,
    ) -> _Opened:
        name, plain = self._name(topic), plain_type(message_type)

        def open_subscription(opened: _Opened) -> TopicSubscription:
            receive = self._receiver(opened, deliver)
            return self._transport.subscribe(name, plain, receive, qos=qos, is_raw=is_raw)

        return self._open(name, message_type, open_subscription)

    def _open(self, name: str, type_name: str, opener: Callable[[_Opened], Any]) -> _Opened:
        opened = _Opened(name, type_name, self._forget)
        opened.inner = opener(opened)
        with self._lock:
            self._opened[opened] = None
        return opened

    def _forget(self, opened: _Opened) -> None:
        with self._lock:
            self._opened.pop(opened, None)

    def _receiver(self, opened: _Opened, deliver: Callable[[Reception], None]) -> Callable[[Reception], None]:
        def receive(reception: Reception) -> None:
            if not opened.is_open:
                return
            try:
                deliver(reception)
            except Exception as fault:
                if self._fails_run(opened, fault, "callback"):
                    return
                if not self._transport.has_threads:
                    raise
                self._note_fault(opened, fault)

        return receive

    def _fails_run(self, opened: _Opened, fault: Exception, what: str) -> bool:
        """Fail the run, if there is one, for what a callback raised; once for each, not a hundred times a second."""
        opened.fault_count += 1
        # A callback that was at work while its subscription ended may trip over what its owner has closed.
        if not opened.is_open or self._is_closed:
            return False
        if opened.fault_count > 1:
            return opened.has_failed_run
        opened.has_failed_run = raised_in_thread(fault, f"the {what} of {opened.name}")
        return opened.has_failed_run

    def _note_fault(self, opened: _Opened, fault: Exception) -> None:
        # With its traceback once, not a hundred times a second.
        level = logging.ERROR if opened.fault_count == 1 else logging.DEBUG
        _logger.log(level, "the callback of %s raised", opened.name, exc_info=fault)
        if opened.is_open and not self._is_closed and self._first_fault is None:
            self._first_fault = opened.name, fault

    def _raise_fault(self) -> None:
        if self._first_fault is not None:
            name, fault = self._first_fault
            problem = f"a callback raised {type(fault).__name__}: {fault}"
            fix = "Mend the callback; the run's log has the traceback."
            raise LinkError(problem, where=name, fix=fix) from fault


def _stop(topic: str, advertised: _Advertised) -> None:
    """Command zero on a topic on which a velocity was published, and see that it is taken."""
    try:
        note_velocity(topic, (0.0, 0.0))
        advertised.publisher.publish(completed(advertised.shape, {}, where=topic))
        advertised.publisher.flush(_STOPPING_SECONDS)
    except LinkError as error:
        problem = f"the robot could not be told to stand still: {error.problem}"
        raise LinkError(problem, where=topic, fix=f"See that its watchdog stopped it. {error.fix}") from error
