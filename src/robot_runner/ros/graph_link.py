"""The link to a robot on a graph, over any transport: names, messages, subscriptions, and the stop at the end."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing, suppress
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar

from robot_runner.core.errors import LinkError
from robot_runner.core.events.early_end import raised_in_thread
from robot_runner.core.links.commanded_topics import tell_commanded
from robot_runner.core.links.graph_names import full_name, namespace_prefix
from robot_runner.core.links.robot import Goal, GoalExecution, GraphEndpoint, Message, Qos, RawMessage, Subscription
from robot_runner.ros.action_calls import LinkGoals
from robot_runner.ros.action_server import GoalServer
from robot_runner.ros.first_message import FirstMessage
from robot_runner.ros.graph_transport import (
    Lane,
    Reception,
    TopicSubscription,
    Transport,
    check_type,
    is_hidden,
    link_closed,
)
from robot_runner.ros.link_faults import as_link_error, do_all
from robot_runner.ros.opened_names import Advertised, Opened, driven_of, halt_all, stop_all
from robot_runner.ros.shapes import completed, plain_type

if TYPE_CHECKING:
    from robot_runner.ros.parameter_access import ParameterServer

_logger = logging.getLogger(__name__)

_Take = Callable[[Message], None]
_Received = TypeVar("_Received")
_Kept = TypeVar("_Kept", Advertised, Opened)

#: The timeout for cancelling goals and commanding robots to stand still, s: each that hangs takes some seconds.
_STOPPING_SECONDS = 20.0


class GraphLink:
    """A link to one robot of a graph, which `connect` joins; the transport below it hides how client libraries differ.

    The link resolves names within the robot's namespace, completes messages by their types, keeps the deadline of
    `wait_for`, and closes its publishers, subscriptions and offers in reverse order. Where it published a velocity, it
    publishes zero before it leaves. An exception in a callback does not end the subscription, and fails the run at
    once. Outside a run, it propagates to the caller of the callback or, on a transport with threads of its own, is
    logged and raised by `close`. The other exceptions of its methods are documented at the protocol,
    `core.links.robot.RobotLink`.

    Attributes:
        namespace: the prefix of relative names: empty, or `/alice`.
        graph: how the graph is reached (`dds:domain=7`); empty if not known; None where the robot is in this process.
        parameter_server: that of ROS 1's master; None in ROS 2, where each node holds its parameters.
        answers: whether a node that the graph lists is there; see `core.links.robot.AsksNodes`.
        encoding: of raw messages.
        is_simulated: whether the robot is known to be; `connect.is_simulation` looks for signs of that on the graph.

    Raises:
        LinkError: the namespace is not valid, or the graph cannot be joined.

    Example:
        ```python
        link = open_dds_link({"domain": "7"}, SystemClock(), "/alice")
        link.publish("cmd_vel", "geometry_msgs/Twist", {"linear": {"x": 0.1}})
        link.close()  # the robot stands still
        ```
    """

    def __init__(self, connect: Callable[[], Transport], namespace: str = "", *, is_simulated: bool = False) -> None:
        self.namespace = namespace_prefix(namespace)  # refused before anything is opened
        self.graph: str | None = None if is_simulated else ""
        self.is_simulated = is_simulated
        self._lock = threading.RLock()  # held while a topic is advertised, which may take seconds
        self._books = threading.Lock()  # held for a moment, over what is open and whether the link is
        self._advertised: dict[tuple[str, Qos], Advertised] = {}
        self._opened: dict[Opened, None] = {}  # in the order in which they were opened
        self._first_fault: tuple[str, Exception] | None = None
        self._is_closed = False
        self._closing_it: threading.Thread | None = None
        self._is_stopped = threading.Event()
        self._stop_all = stop_all
        self._transport = transport = connect()
        self.encoding = transport.encoding
        self._goals = LinkGoals(transport.actions, transport.wait, self._check_open, has_threads=transport.has_threads)
        self.parameter_server: ParameterServer | None = getattr(transport, "parameter_server", None)
        self.answers: Callable[[str], bool] = getattr(transport, "answers", lambda _node: True)
        if hasattr(transport, "rejoined"):
            self.rejoined = partial(self._rejoined, transport.rejoined)

    def publish(self, topic: str, message_type: str, message: Message, *, qos: Qos = Qos.DEFAULT) -> None:
        """Publish one message; at the first on a topic, wait until the existing subscribers are connected."""
        name = self._name(topic)
        advertised = self._advertised.get((name, qos)) or self._advertise(name, message_type, message, qos)
        self._command(name, qos, advertised)
        if advertised.message_type != message_type:
            check_type(name, message_type, [advertised.message_type])
        complete = completed(advertised.shape, message, where=name)
        with advertised.sending():
            self._check_open(name)  # another thread may have closed the link: nothing may follow the stop command
            try:
                advertised.send(name, complete)
            except Exception as error:
                if isinstance(error, LinkError) or not self._transport.has_threads:  # there, it may be a callback's
                    raise
                raise as_link_error(error, where=name, what="the message cannot be published") from error

    def advertise(self, topic: str, message_type: str, *, qos: Qos = Qos.DEFAULT, is_commanded: bool = True) -> bool:
        """Wait until the existing subscribers of a topic are connected, and return whether they are."""
        name = self._name(topic)
        advertised = self._advertise(name, message_type, {}, qos)
        if is_commanded:
            self._command(name, qos, advertised)
        check_type(name, message_type, [advertised.message_type])
        return advertised.publisher.reach()  # also subscribers since it was first advertised

    def is_heard(self, topic: str, qos: Qos = Qos.DEFAULT) -> bool:
        """Whether a message on a topic would reach a subscriber now; True where that is not known."""
        advertised = self._advertised.get((self._name(topic), qos))
        return advertised is None or advertised.publisher.is_heard()

    def subscribe(
        self, topic: str, message_type: str, callback: _Take, *, qos: Qos | None = None, is_prompt: bool = False
    ) -> Subscription:
        """Call `callback` with each message of the topic."""
        lane = Lane.PROMPT if is_prompt else Lane.CALLBACKS
        return self._subscribe(topic, message_type, lambda reception: callback(reception.message()), qos, lane)

    def subscribe_raw(
        self, topic: str, message_type: str, callback: Callable[[RawMessage], None], *, qos: Qos | None = None
    ) -> Subscription:
        """Call `callback` with the bytes of each message of the topic; otherwise as `subscribe`."""
        return self._subscribe(topic, message_type, lambda reception: callback(reception.raw()), qos, Lane.BYTES)

    def wait_for(
        self, topic: str, message_type: str, condition: Callable[[Message], bool] | None = None, *, timeout: float = 5.0
    ) -> Message:
        """Return the first message from now on that satisfies the condition; `timeout` is in seconds."""
        first = FirstMessage(condition, timeout)
        take: Callable[[Reception], None] = lambda reception: first.take(reception.message())  # noqa: E731
        with closing(self._subscribe(topic, message_type, take, None, Lane.CALLBACKS)) as subscription:
            self._transport.wait(first.is_over, timeout)
        return first.result(subscription.name, subscription.inner.explain)

    def call(self, service: str, service_type: str, request: Message | None = None, *, timeout: float = 5.0) -> Message:
        """Call a service and return its response; `timeout` is in seconds."""
        name = self._name(service)
        complete = completed(self._transport.types.request(service_type), request or {}, where=name)
        return self._transport.call(name, plain_type(service_type), complete, timeout)

    def offer(self, service: str, service_type: str, answer: Callable[[Message], Message]) -> Subscription:
        """Offer a service until it is closed; `answer` may be called from a thread of the transport."""
        name, types = self._name(service), self._transport.types
        types.request(service_type)
        shape = types.response(service_type)

        def serve(opened: Opened) -> Subscription:
            def respond(request: Message) -> Message:
                try:
                    return completed(shape, answer(request), where=f"the answer of {name}")
                except Exception as fault:
                    if not self._fails_run(opened, fault, "answer") and self._transport.has_threads:
                        _logger.exception("the service %s failed", name)
                    raise

            return self._transport.serve(name, plain_type(service_type), respond)

        return self._open(name, service_type, serve)

    def send_goal(
        self,
        action: str,
        action_type: str,
        goal: Message | None = None,
        *,
        on_feedback: Callable[[Message], None] | None = None,
        timeout: float = 5.0,
    ) -> Goal:
        """Send a goal to an action, and return it once it is accepted; `timeout` is in seconds."""
        name = self._name(action)
        take = self._receiver(Opened(name, action_type, lambda _: None), on_feedback or (lambda _: None))
        return self._goals.send(name, plain_type(action_type), goal or {}, take, timeout, self.graph)

    def offer_action(
        self,
        action: str,
        action_type: str,
        execute: Callable[[GoalExecution], Message],
        *,
        accept: Callable[[Message], bool] | None = None,
    ) -> Subscription:
        """Offer an action until it is closed; `execute` is called in a thread of its own for each goal."""
        name, plain, dialect = self._name(action), plain_type(action_type), self._transport.actions

        def serve(opened: Opened) -> Subscription:
            def note(fault: Exception) -> None:
                if not self._fails_run(opened, fault, "action"):
                    _logger.error("the action %s failed", name, exc_info=fault)

            return dialect.serve(name, plain, GoalServer(name, dialect.types(plain), execute, accept, note))

        return self._open(name, action_type, serve)

    def check_message(self, name: str, type_name: str, message: Message, *, is_goal: bool = False) -> None:
        """Raise a `LinkError` where a message of a topic, or a goal of an action, does not follow its definition."""
        plain, transport = plain_type(type_name), self._transport
        shape = transport.actions.types(plain).goal if is_goal else transport.types.shape(plain)
        completed(shape, message, where=self._name(name))

    def topics(self) -> Mapping[str, str]:
        """Return the type of each published or subscribed topic by full name; `*` where it is not known."""
        self._check_open("the graph")
        own = {opened.name: plain_type(opened.type_name) for opened in list(self._opened)}
        return {name: told or own.get(name, "*") for name, told in self._transport.topics().items()}

    def services(self) -> Mapping[str, str]:
        """Return the type of each service on the graph, by its full name."""
        self._check_open("the graph")
        return self._transport.services()

    def actions(self) -> Mapping[str, str]:
        """Return the type of each action that is offered on the graph, by its full name."""
        self._check_open("the graph")
        return self._transport.actions.actions()

    def nodes(self) -> Sequence[str]:
        """Return the full names of the nodes on the graph, sorted; hidden ones (`_daemon`) are left out, as in ROS."""
        self._check_open("the graph")
        return sorted(name for name in self._transport.nodes() if not is_hidden(name))

    def publishers(self, topic: str) -> Sequence[GraphEndpoint]:
        """Return the publishers of a topic, this link included; none where there is no such topic."""
        return list(self._transport.publishers(self._name(topic)))

    def subscribers(self, topic: str) -> Sequence[GraphEndpoint]:
        """Return the subscribers of a topic, this link included; none where there is no such topic."""
        return list(self._transport.subscribers(self._name(topic)))

    def definition(self, message_type: str) -> str:
        """Return the text of a type's definition, followed by those of the types of its fields."""
        return self._transport.types.definition(message_type)

    def halt(self) -> None:
        """Command zero wherever a velocity was commanded, and cancel goals; only `close` waits and reports failures."""
        halt_all(driven_of(dict(self._advertised)))
        if self._transport.has_threads:  # without threads, no robot moves while the program waits for another
            self._goals.ask_for_ends()

    def close(self) -> None:
        """Cancel the link's goals, stop the robot if it was driven, close what was opened, and leave the graph; once.

        Where another thread is closing the link, the main thread waits until the stop was commanded.
        """
        this = threading.current_thread()
        with self._books:
            was_closed, self._is_closed = self._is_closed, True
            self._closing_it = self._closing_it or this
            opened, advertised = list(self._opened), list(self._advertised.items())
        if was_closed:
            if this is threading.main_thread() and this is not self._closing_it:  # the process may end after this
                self._is_stopped.wait(_STOPPING_SECONDS)
            return
        do_all(
            [
                self._goals.close,  # before the stop: the execution of a goal may drive the robot
                partial(self._stop_all, driven_of(dict(advertised))),
                self._is_stopped.set,
                *(each.close for _, each in reversed(advertised)),
                *(each.close for each in reversed(opened)),
                self._transport.close,
                self._raise_fault,
            ]
        )

    def _rejoined(self, connect: Callable[[], Transport]) -> GraphLink:
        other = GraphLink(connect, self.namespace)
        other.graph, self._stop_all = self.graph, halt_all
        return other

    def _name(self, given: str) -> str:
        name = full_name(self.namespace, given)
        self._check_open(name)
        return name

    def _check_open(self, where: str) -> None:
        if self._is_closed:
            raise link_closed(where)

    def _keep(self, name: str, open_it: Callable[[], _Kept], note: Callable[[_Kept], object]) -> _Kept:
        """Open and register what is closed with the link; raise a `LinkError` if that was closed meanwhile."""
        try:
            opened = open_it()
        except Exception as error:  # the client library's error on a graph that was left does not help
            if isinstance(error, LinkError) or not self._is_closed:
                raise
            raise link_closed(name) from error
        with self._books:
            if not self._is_closed:
                note(opened)
                return opened
        with suppress(Exception):  # as above
            opened.close()
        raise link_closed(name)

    def _advertise(self, name: str, message_type: str, message: Message, qos: Qos) -> Advertised:
        plain = plain_type(message_type)
        with self._lock:
            known = self._advertised.get((name, qos))
            if known is None:
                shape = self._transport.types.shape(message_type)
                completed(shape, message, where=name)  # a wrong message is refused before the topic is on the graph
                advertise = partial(self._transport.advertise, name, plain, qos)
                note = partial(self._advertised.__setitem__, (name, qos))
                known = self._keep(name, lambda: Advertised(plain, shape, advertise()), note)
            return known

    def _command(self, name: str, qos: Qos, advertised: Advertised) -> None:
        """Tell the standby process that velocities are commanded on a topic, if its type has them.

        Where others have claimed the robot, the topic is left: nothing of ours is to come there, not even zero.
        """
        if advertised.is_commanded or not advertised.drives:
            return
        try:
            tell_commanded(name, advertised.message_type, self.graph)  # where that fails, nothing is published
        except LinkError:
            with self._books:
                if self._advertised.get((name, qos)) is advertised:  # another thread may have left it, and come back
                    del self._advertised[name, qos]
            with suppress(Exception):  # that it was refused is what its caller has to know
                advertised.close()
            raise
        advertised.is_commanded = True

    def _subscribe(
        self, topic: str, message_type: str, deliver: Callable[[Reception], None], qos: Qos | None, lane: Lane
    ) -> Opened:
        name, plain = self._name(topic), plain_type(message_type)

        def subscribed(opened: Opened) -> TopicSubscription:
            return self._transport.subscribe(name, plain, self._receiver(opened, deliver), qos=qos, lane=lane)

        return self._open(name, message_type, subscribed)

    def _open(self, name: str, type_name: str, opener: Callable[[Opened], Any]) -> Opened:
        def open_it() -> Opened:
            opened = Opened(name, type_name, self._forget)
            opened.inner = opener(opened)
            return opened

        return self._keep(name, open_it, self._opened.setdefault)

    def _forget(self, opened: Opened) -> None:
        with self._books:
            self._opened.pop(opened, None)

    def _receiver(self, opened: Opened, deliver: Callable[[_Received], None]) -> Callable[[_Received], None]:
        def receive(received: _Received) -> None:
            if not opened.is_open:
                return
            try:
                deliver(received)
            except Exception as fault:
                if self._fails_run(opened, fault, "callback"):
                    return
                if not self._transport.has_threads:
                    raise
                self._note_fault(opened, fault)

        return receive

    def _fails_run(self, opened: Opened, fault: Exception, what: str) -> bool:
        """Fail the run, if there is one, for a callback's exception, but only once for each subscription or offer."""
        opened.fault_count += 1
        # A callback that was running when its subscription ended may fail because its owner has closed something.
        if not opened.is_open or self._is_closed:
            return False
        if opened.fault_count == 1:
            opened.has_failed_run = raised_in_thread(fault, f"the {what} of {opened.name}")
        return opened.has_failed_run

    def _note_fault(self, opened: Opened, fault: Exception) -> None:
        level = logging.ERROR if opened.fault_count == 1 else logging.DEBUG  # not a hundred times a second
        _logger.log(level, "the callback of %s raised", opened.name, exc_info=fault)
        if opened.is_open and not self._is_closed and self._first_fault is None:
            self._first_fault = opened.name, fault

    def _raise_fault(self) -> None:
        if self._first_fault is not None:
            name, fault = self._first_fault
            fix = "Correct the callback; the run's log has the traceback."
            raise LinkError(f"a callback raised {type(fault).__name__}: {fault}", where=name, fix=fix) from fault
