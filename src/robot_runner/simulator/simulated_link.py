"""The link to the embedded robot: its topics and services, without ROS."""

from __future__ import annotations

from contextlib import ExitStack
from types import MappingProxyType
from typing import TYPE_CHECKING

from robot_runner.core.errors import LinkError, did_you_mean
from robot_runner.core.links.robot import Encoding, Qos, RawMessage
from robot_runner.ros.graph_links import full_name
from robot_runner.ros.shapes import Field, Shape, completed, plain_type
from robot_runner.simulator.simulated_clock import STEP_NS
from robot_runner.simulator.simulated_turtlebot3 import COMMAND_TOPICS, SERVICES

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from robot_runner.core.links.robot import Message, Subscription
    from robot_runner.ros.type_catalogue import TypeCatalogue
    from robot_runner.simulator.simulated_turtlebot3 import SimulatedTurtlebot3, Simulation

__all__ = ["SimulatedRobotLink", "message_shape", "request_shape", "response_shape", "standard_types"]


# The types that the embedded robot takes and answers with: known without any ROS package.

_VECTOR = Shape("geometry_msgs/Vector3", tuple(Field(axis, "float64") for axis in "xyz"))
_MESSAGES: Mapping[str, Shape] = MappingProxyType(
    {
        "geometry_msgs/Twist": Shape("geometry_msgs/Twist", (Field("linear", _VECTOR), Field("angular", _VECTOR))),
        "std_msgs/Empty": Shape("std_msgs/Empty"),
    }
)
_TRIGGERED = (Field("success", "bool"), Field("message", "string"))
_REQUESTS: Mapping[str, Shape] = MappingProxyType({"std_srvs/Trigger": Shape("std_srvs/Trigger")})
_RESPONSES: Mapping[str, Shape] = MappingProxyType({"std_srvs/Trigger": Shape("std_srvs/Trigger", _TRIGGERED)})


def message_shape(message_type: str) -> Shape:
    """Return what a message type is made of.

    Raises:
        LinkError: there is no such type, or it takes `rosbags` to know it.

    Example:
        >>> message_shape("geometry_msgs/Twist").names
        ('linear', 'angular')
    """
    return _MESSAGES.get(plain_type(message_type)) or standard_types().shape(message_type)


def request_shape(service_type: str) -> Shape:
    """Return what the request of a service type is made of.

    Raises:
        LinkError: as `message_shape`.
    """
    return _REQUESTS.get(plain_type(service_type)) or standard_types().request(service_type)


def response_shape(service_type: str) -> Shape:
    """Return what the response of a service type is made of.

    Raises:
        LinkError: as `message_shape`.
    """
    return _RESPONSES.get(plain_type(service_type)) or standard_types().response(service_type)


def standard_types() -> TypeCatalogue:
    """Return the types of ROS 2, as which the embedded robot's messages are laid out.

    Raises:
        LinkError: `rosbags`, which knows them, is not installed.
    """
    from robot_runner.ros.type_catalogue import TypeCatalogue  # noqa: PLC0415  # only for types that are not above

    return TypeCatalogue.of(2)


_STEP = STEP_NS / 1e9
_NODE = "turtlebot3_node"


class SimulatedRobotLink:
    """A link to one robot of a simulation; callbacks are called while the simulation's clock is slept on.

    Names and fields are checked against what the robot offers, so that a misspelt one is an error here and
    not a robot that stands still. Its raw messages are those of ROS 2, which take the `rosbags` package.

    Example:
        >>> from robot_runner.simulator.simulated_turtlebot3 import Simulation
        >>> simulation = Simulation(seed=1)
        >>> link = SimulatedRobotLink(simulation)
        >>> link.publish("cmd_vel", "geometry_msgs/Twist", {"linear": {"x": 0.2}})
        >>> moved = link.wait_for("odom", "nav_msgs/Odometry", lambda odom: odom["pose"]["pose"]["position"]["x"] > 0.5)
        >>> link.call("task/video/start", "std_srvs/Trigger")
        {'success': True, 'message': 'video started'}
        >>> link.close()
        >>> simulation.close()
    """

    def __init__(self, simulation: Simulation, *, namespace: str = "") -> None:
        self._simulation = simulation
        self._robot: SimulatedTurtlebot3 = simulation.turtlebot3(namespace)
        self._subscriptions = ExitStack()
        self._has_driven = False
        self._has_started_task = False
        self._is_closed = False

    @property
    def is_simulated(self) -> bool:
        """Always true."""
        return True

    @property
    def encoding(self) -> Encoding:
        """Always that of ROS 2."""
        return Encoding.CDR

    def publish(self, topic: str, message_type: str, message: Message, *, qos: Qos = Qos.DEFAULT) -> None:
        """Publish a velocity command, the only thing that the robot hears; it keeps to it until the next.

        Raises:
            LinkError: topic, type or a field is not one that the robot hears, or the link was closed.
        """
        del qos
        name = self._name(topic, COMMAND_TOPICS, kind="topic that the robot hears")
        _check_type(name, message_type, COMMAND_TOPICS[name])
        twist = completed(message_shape(message_type), message, where=name)
        self._has_driven = True
        self._robot.drive(twist["linear"]["x"], twist["angular"]["z"])

    def subscribe(
        self, topic: str, message_type: str, callback: Callable[[Message], None], *, qos: Qos | None = None
    ) -> Subscription:
        """Have `callback` called with each message of the topic, at the rate of the real robot.

        Raises:
            LinkError: the robot does not publish such a topic, or of another type, or the link was closed.
        """
        del qos
        name = self._name(topic, self._robot.topics, kind="topic that the robot publishes")
        published = self._robot.topics[name]
        _check_type(name, message_type, published.message_type)
        subscription = published.listen(callback)
        self._subscriptions.callback(subscription.close)
        return subscription

    def subscribe_raw(
        self, topic: str, message_type: str, callback: Callable[[RawMessage], None], *, qos: Qos | None = None
    ) -> Subscription:
        """Have `callback` called with the bytes of each message of the topic, as ROS 2 lays them out.

        Raises:
            LinkError: as `subscribe`, or `rosbags` is not installed.
        """
        types, clock = standard_types(), self._simulation.clock

        def hear(message: Message) -> None:
            callback(RawMessage(types.serialise(message_type, message, Encoding.CDR), clock.now_ns))

        return self.subscribe(topic, message_type, hear, qos=qos)

    def wait_for(
        self,
        topic: str,
        message_type: str,
        condition: Callable[[Message], bool] | None = None,
        *,
        timeout: float = 5.0,
    ) -> Message:
        """Let the simulation's time go by until a message satisfies the condition (None: any), and return it.

        Raises:
            LinkError: none came within `timeout` simulated seconds, or as `subscribe`.
        """
        found: list[Message] = []

        def hear(message: Message) -> None:
            if not found and (condition is None or condition(message)):
                found.append(message)

        clock = self._simulation.clock
        deadline = clock.now() + timeout
        subscription = self.subscribe(topic, message_type, hear)
        try:
            while not found and clock.now() < deadline:
                clock.sleep(min(_STEP, deadline - clock.now()))
        finally:
            subscription.close()
        if not found:
            problem = f"no message that satisfies the condition came within {timeout:g} s"
            raise LinkError(problem, where=topic, fix="Look at the condition, or give a longer timeout.")
        return found[0]

    def call(self, service: str, service_type: str, request: Message | None = None, *, timeout: float = 5.0) -> Message:
        """Call a service of the robot, or an offered one; it answers at once, so `timeout` never runs out.

        Raises:
            LinkError: there is no such service, it has another type or other fields, or the link was closed.
        """
        del timeout
        self._check_open()
        offered = self._simulation.offers.get(full_name(self._robot.namespace, service))
        if offered is not None:
            return self._call_offered(service, service_type, request or {}, *offered)
        name = self._name(service, SERVICES, kind="service of the robot")
        _check_type(name, service_type, SERVICES[name])
        completed(request_shape(service_type), request or {}, where=name)
        response = self._robot.call(name)
        self._has_started_task |= bool(name.endswith("/start") and response["success"])
        return response

    def offer(self, service: str, service_type: str, answer: Callable[[Message], Message]) -> Subscription:
        """Offer a service to all who are connected to the simulation, until it is closed.

        Raises:
            LinkError: there is no such type, a service of this name is there already, or the link was closed.
        """
        self._check_open()
        request_shape(service_type)
        name = full_name(self._robot.namespace, service)
        if name in self.services():
            fix = "Choose another name, or close the other offer."
            raise LinkError(f"there is a service {name!r} already", where=self._where, fix=fix)
        self._simulation.offers[name] = (plain_type(service_type), answer)
        offer = _Offer(self._simulation, name)
        self._subscriptions.callback(offer.close)
        return offer

    def topics(self) -> Mapping[str, str]:
        """Return the type of each topic of each robot of the simulation."""
        types: dict[str, str] = {}
        for namespace, robot in self._simulation.robots.items():
            types |= {f"{namespace}/{name}": topic.message_type for name, topic in robot.topics.items()}
            types |= {f"{namespace}/{name}": message_type for name, message_type in COMMAND_TOPICS.items()}
        return types

    def services(self) -> Mapping[str, str]:
        """Return the type of each service of each robot of the simulation, and of what is offered to them."""
        own = {
            f"{namespace}/{name}": service_type
            for namespace in self._simulation.robots
            for name, service_type in SERVICES.items()
        }
        return own | {name: service_type for name, (service_type, _) in self._simulation.offers.items()}

    def nodes(self) -> Sequence[str]:
        """Return one node for each robot of the simulation."""
        return sorted(f"{namespace}/{_NODE}" for namespace in self._simulation.robots)

    def definition(self, message_type: str) -> str:
        """Return the text of a type's definition.

        Raises:
            LinkError: there is no such type, or `rosbags` is not installed.
        """
        return standard_types().definition(message_type)

    def close(self) -> None:
        """Stop the robot if it was driven and its task if one was started here; end all subscriptions and offers."""
        if self._is_closed:
            return
        self._is_closed = True
        self._subscriptions.close()
        if self._has_driven:
            self._robot.drive(0.0, 0.0)
        if self._has_started_task:
            self._robot.call("task/stop")

    @property
    def _where(self) -> str:
        return f"the simulated robot {self._robot.namespace}".rstrip()

    def _call_offered(
        self, service: str, service_type: str, request: Message, true: str, answer: Callable[[Message], Message]
    ) -> Message:
        _check_type(service, service_type, true)
        response = answer(completed(request_shape(true), request, where=service))
        return completed(response_shape(true), response, where=f"the answer of {service}")

    def _check_open(self) -> None:
        if self._is_closed:
            raise LinkError("the link was closed", where=self._where, fix="Use it before the run ends.")

    def _name(self, given: str, known: Mapping[str, object], *, kind: str) -> str:
        """Return the name within the robot's namespace."""
        self._check_open()
        prefix = f"{self._robot.namespace}/" if given.startswith("/") else ""
        name = given.removeprefix(prefix)
        if prefix + name == given and name in known:
            return name
        candidates = [prefix + one for one in known]
        raise LinkError(f"{given!r} is no {kind}", where=self._where, fix=did_you_mean(given, candidates))


class _Offer:
    """A service that is offered to a simulation."""

    def __init__(self, simulation: Simulation, name: str) -> None:
        self._simulation = simulation
        self._name = name
        self._is_closed = False

    def close(self) -> None:
        if not self._is_closed:
            self._is_closed = True
            self._simulation.offers.pop(self._name, None)


def _check_type(name: str, given: str, true: str) -> None:
    if plain_type(given) != true:
        raise LinkError(f"it is of type {true}, not {given!r}", where=name, fix=f"Name the type {true!r}.")
