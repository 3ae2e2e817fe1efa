"""Opens a link over ROS 1, and says what stands in its way; nothing of ROS is loaded before."""

from __future__ import annotations

import importlib.util
import logging
from contextlib import ExitStack
from functools import partial
from typing import TYPE_CHECKING, Any

from robot_runner.core.errors import Finding, LinkError, did_you_mean, nearest
from robot_runner.core.links.robot import Encoding, Qos
from robot_runner.ros.graph_links import full_name, missing, namespace_prefix
from robot_runner.ros.listening import first_message, guarded
from robot_runner.ros.ros1.master import Master
from robot_runner.ros.ros1.node import REGISTERING_SECONDS, join_graph, rospy_missing, within
from robot_runner.ros.ros1.service_client import call_service, service_type
from robot_runner.ros.ros1.topics import (
    Publisher,
    Subscriber,
    as_mapping,
    as_message,
    message_class,
    service_class,
    shape_of,
)
from robot_runner.ros.shapes import completed, plain_type
from robot_runner.ros.watchdog import VELOCITY_COMMANDS

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from robot_runner.core.events.context import Clock
    from robot_runner.core.links.robot import Message, RawMessage, RobotLink, RobotName, Subscription

__all__ = ["Ros1Link", "findings", "follows_graph_clock", "master_of", "open_ros1_link"]


# The link to a robot on a ROS 1 graph.

_logger = logging.getLogger(__name__)

#: How long the last command, to stand still, may take to leave, s.
_STOPPING_SECONDS = 2.0
#: How long each service may take to say of which type it is, s.
_PROBING_SECONDS = 0.5
_START = "Start the node that offers it."


class Ros1Link:
    """A link to one robot of a ROS 1 graph, over rospy; the process is one node, whatever the number of robots.

    Everything is heard as bytes and taken apart here, so that recording a topic and listening to it share a connection.

    Args:
        master: of the graph.
        namespace: the robot's.

    Raises:
        LinkError: there is no such master, or no rospy.

    Example:
        ```python
        link = Ros1Link(Master("http://robot:11311"), "/alice")
        link.publish("cmd_vel", "geometry_msgs/Twist", {"linear": {"x": 0.1}})
        link.close()  # the robot stands still
        ```
    """

    def __init__(self, master: Master, namespace: str = "") -> None:
        self._master = master
        self._namespace = namespace_prefix(namespace)
        self._rospy = join_graph(master)
        self._publishers: dict[tuple[str, Qos], Publisher] = {}
        self._heard: dict[str, str] = {}
        self._closing = ExitStack()
        self._is_closed = False

    @property
    def is_simulated(self) -> bool:
        """Never: a graph does not tell what is behind it; `robot_runner.core.links.connect` asks for signs."""
        return False

    @property
    def encoding(self) -> Encoding:
        """Always that of ROS 1."""
        return Encoding.ROS1

    def publish(self, topic: str, message_type: str, message: Message, *, qos: Qos = Qos.DEFAULT) -> None:
        """Publish one message; at first use of a topic, once those who hear it already are reached.

        Raises:
            LinkError: the message does not follow its definition, the topic carries another type, or the master does
                not answer.
        """
        name = self._name(topic)
        publisher = self._publishers.get((name, qos))
        if publisher is None:
            publisher = self._new_publisher(name, message_type, message, qos)
        elif publisher.message_type != plain_type(message_type):
            raise _another_type(name, publisher.message_type, message_type)
        publisher.publish(message)

    def subscribe(
        self, topic: str, message_type: str, callback: Callable[[Message], None], *, qos: Qos | None = None
    ) -> Subscription:
        """Have `callback` called with each message of the topic, from a thread of rospy's.

        Raises:
            LinkError: there is no such type, the topic carries another, or the master does not answer.
        """
        cls = message_class(message_type)

        def hear(raw: RawMessage) -> None:
            callback(as_mapping(cls().deserialize(raw.data)))

        return self.subscribe_raw(topic, message_type, hear, qos=qos)

    def subscribe_raw(
        self, topic: str, message_type: str, callback: Callable[[RawMessage], None], *, qos: Qos | None = None
    ) -> Subscription:
        """Have `callback` called with the bytes of each message of the topic, from a thread of rospy's.

        Raises:
            LinkError: as `subscribe`.
        """
        del qos  # a publisher of ROS 1 alone decides it
        name, cls = self._name(topic), message_class(message_type)
        self._check_type(name, cls._type, publishers_only=True)
        subscriber = Subscriber(self._rospy, name, cls, guarded(callback, name))
        self._heard[name] = cls._type
        self._closing.callback(subscriber.close)
        return subscriber

    def wait_for(
        self,
        topic: str,
        message_type: str,
        condition: Callable[[Message], bool] | None = None,
        *,
        timeout: float = 5.0,
    ) -> Message:
        """Return the first message from now on that satisfies the condition; `timeout` is in seconds of this machine.

        Raises:
            LinkError: none came in time, or as `subscribe`.
        """
        return first_message(
            partial(self.subscribe, topic, message_type),
            condition,
            timeout=timeout,
            where=self._name(topic),
            explain=partial(self._explain_silence, self._name(topic)),
        )

    def call(self, service: str, service_type: str, request: Message | None = None, *, timeout: float = 5.0) -> Message:
        """Call a service and return its response; `timeout` is in seconds of this machine.

        Raises:
            LinkError: there is no such service, it has another type or other fields, fails, or does not answer in time.
        """
        name, cls = self._name(service), service_class(service_type)
        asked = completed(shape_of(cls._request_class), request or {}, where=name)
        uri = self._master.service(name)
        if uri is None:
            known = self._master.state().services
            raise missing("service", name, known, where=f"ros1 {self._master.uri}", fix=_START)
        return as_mapping(call_service(name, uri, cls, as_message(cls._request_class, asked), timeout=timeout))

    def offer(self, service: str, service_type: str, answer: Callable[[Message], Message]) -> Subscription:
        """Offer a service until it is closed; `answer` is called from a thread of rospy's.

        Raises:
            LinkError: there is no such type, somebody offers a service of this name, or the master does not answer.
        """
        name, cls = self._name(service), service_class(service_type)
        self._check_free(name)

        def respond(request: Any) -> Any:
            response = completed(shape_of(cls._response_class), answer(as_mapping(request)), where=name)
            return as_message(cls._response_class, response)

        offered = within(
            REGISTERING_SECONDS,
            lambda: self._rospy.Service(name, cls, respond, error_handler=partial(_log_fault, name)),
            where=name,
            doing="registering the service",
        )
        offer = _Offer(name, offered)
        self._closing.callback(offer.close)
        return offer

    def topics(self) -> Mapping[str, str]:
        """Return the type of each topic that is published or heard; `*` where the master was not told."""
        self._check_open()
        state, types = self._master.state(), self._heard | self._master.topic_types()
        return {name: types.get(name, "*") for name in sorted({*state.publishers, *state.subscribers})}

    def services(self) -> Mapping[str, str]:
        """Return the type of each service, asked of the service itself; those that do not answer are left out."""
        self._check_open()
        found = {}
        for name in sorted(self._master.state().services):
            try:
                uri = self._master.service(name)
                found[name] = "" if uri is None else service_type(name, uri, timeout=_PROBING_SECONDS)
            except LinkError as error:
                _logger.info("%s", error)
        return {name: known for name, known in found.items() if known}

    def nodes(self) -> Sequence[str]:
        """Return the names of the nodes that publish, hear or offer something."""
        self._check_open()
        return self._master.state().nodes

    def definition(self, message_type: str) -> str:
        """Return the text of a type's definition, as rospy's messages carry it.

        Raises:
            LinkError: there is no such type.
        """
        cls = message_class(message_type)
        text: str = cls._full_text
        return text

    def close(self) -> None:
        """Stop the robot if it was driven; end all subscriptions and offers and leave; closing twice does nothing.

        Raises:
            LinkError: the robot does not take the command to stand still, or the master does not answer.
        """
        if self._is_closed:
            return
        self._is_closed = True
        with ExitStack() as closing:
            closing.callback(self._closing.close)
            for publisher in self._publishers.values():
                closing.callback(publisher.close)
                if publisher.message_type in VELOCITY_COMMANDS:
                    closing.callback(publisher.flush, _STOPPING_SECONDS)
                    closing.callback(publisher.publish, {})

    def _new_publisher(self, name: str, message_type: str, message: Message, qos: Qos) -> Publisher:
        cls = message_class(message_type)
        completed(shape_of(cls), message, where=name)  # before the graph hears of it
        self._check_type(name, cls._type)
        listeners = len(self._master.state().subscribers.get(name, ()))
        publisher = self._publishers[name, qos] = Publisher(self._rospy, name, cls, qos, listeners)
        return publisher

    def _check_type(self, name: str, wanted: str, *, publishers_only: bool = False) -> None:
        true = self._master.topic_types().get(name, wanted)
        if true == wanted:
            return
        state = self._master.state()  # the master remembers the types of topics that are no more
        if state.publishers.get(name) or (not publishers_only and state.subscribers.get(name)):
            raise _another_type(name, true, wanted)

    def _check_free(self, name: str) -> None:
        uri = self._master.service(name)
        if uri is None:
            return
        try:
            service_type(name, uri, timeout=_PROBING_SECONDS)
        except LinkError:
            return  # left behind by a node that died
        owners = ", ".join(self._master.state().services.get(name, ("another node",)))
        fix = "Choose another name, or end the other node."
        raise LinkError(f"{owners} offers the service {name!r} already", where=name, fix=fix)

    def _explain_silence(self, name: str) -> str:
        publishers = self._master.state().publishers
        if name in publishers:
            return f"Look whether {', '.join(publishers[name])}, which publishes it, is alive and reachable from here."
        near = nearest(name, publishers)
        return f"Nobody publishes {name!r}: " + (f"did you mean {near!r}?" if near else "start the node that does.")

    def _name(self, given: str) -> str:
        self._check_open()
        return full_name(self._namespace, given)

    def _check_open(self) -> None:
        if self._is_closed:
            where = f"ros1 {self._master.uri}"
            raise LinkError("the link was closed", where=where, fix="Use it before the run ends.")


class _Offer:
    """A service that is offered."""

    def __init__(self, name: str, service: Any) -> None:
        self._name = name
        self._service = service

    def close(self) -> None:
        service, self._service = self._service, None
        if service is not None:
            within(REGISTERING_SECONDS, service.shutdown, where=self._name, doing="withdrawing the service")


def _log_fault(name: str, fault: Exception, *_: object) -> None:
    _logger.error("the service %s failed", name, exc_info=fault)


def _another_type(name: str, true: str, wanted: str) -> LinkError:
    fix = f"Name the type {true!r}, or another topic."
    return LinkError(f"the topic carries {true}, not {wanted}", where=name, fix=fix)


_OPTIONS = ("master",)
#: How long a check waits for the master, s.
_CHECKING_SECONDS = 2.0


def findings(name: RobotName) -> list[Finding]:
    """Return what stands in the way of reaching a robot of this name over ROS 1; nothing is opened by asking."""
    if importlib.util.find_spec("rospy") is None:
        return [rospy_missing("rospy").as_finding()]
    try:
        master_of(name.options, timeout=_CHECKING_SECONDS).check()
    except LinkError as error:
        return [error.as_finding()]
    return []


def open_ros1_link(options: Mapping[str, str], clock: Clock, namespace: str = "") -> RobotLink:
    """Join the graph and return the link to the robot of this namespace.

    Args:
        options: `master`: its address; left out, what ROS_MASTER_URI says.
        clock: the run's; rospy itself needs none.
        namespace: the robot's, such as `/alice`.

    Raises:
        LinkError: there is no such option, no master, or no rospy.
    """
    del clock

    return Ros1Link(master_of(options), namespace)


def follows_graph_clock(options: Mapping[str, str]) -> bool:
    """Whether the nodes of the graph live by the time on `/clock`: its parameter `/use_sim_time`.

    Raises:
        LinkError: there is no such option, or no master.
    """
    return bool(master_of(options).parameter("/use_sim_time"))


def master_of(options: Mapping[str, str], *, timeout: float = 3.0) -> Master:
    """Return the master that the options name.

    Raises:
        LinkError: there is no such option, or it cannot be the address of a master.
    """
    for name in options:
        if name not in _OPTIONS:
            raise LinkError(f"ros1 has no option {name!r}", where="robot", fix=did_you_mean(name, _OPTIONS))
    return Master(options.get("master"), timeout=timeout)
