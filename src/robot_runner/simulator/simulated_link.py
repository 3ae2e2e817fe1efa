"""The link to the embedded robot: its topics and services, without ROS."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

from robot_runner.core.errors import LinkError, did_you_mean
from robot_runner.core.links.robot import Encoding, GraphEndpoint, Message, Qos, RawMessage
from robot_runner.ros.graph_link import GraphLink
from robot_runner.ros.graph_transport import ClosedBy, Lane, Reception, already_offered, check_type, wrong_service_type
from robot_runner.ros.shapes import Field, Shape, plain_type
from robot_runner.simulator.simulated_actions import SimulatedActions
from robot_runner.simulator.simulated_clock import STEP_NS

if TYPE_CHECKING:
    import threading

    from robot_runner.ros.type_catalogue import TypeCatalogue
    from robot_runner.simulator.sensors import PublishedTopic
    from robot_runner.simulator.simulated_turtlebot3 import SimulatedRobot, Simulation

_STEP = STEP_NS / 1e9
#: The resolution of a simulated clock, s.
_LEAST = 1e-9
_NODE = "turtlebot3_node"
#: The fix if no message came, as the robot always publishes all of its topics.
_SILENT = "Look at the condition, or give a longer timeout."

# The types of the embedded robot's commands and services are known without any ROS package.
_VECTOR = Shape("geometry_msgs/Vector3", tuple(Field(axis, "float64") for axis in "xyz"))
_MESSAGES: Mapping[str, Shape] = MappingProxyType(
    {"geometry_msgs/Twist": Shape("geometry_msgs/Twist", (Field("linear", _VECTOR), Field("angular", _VECTOR)))}
)
_TRIGGERED = (Field("success", "bool"), Field("message", "string"))
_REQUESTS: Mapping[str, Shape] = MappingProxyType({"std_srvs/Trigger": Shape("std_srvs/Trigger")})
_RESPONSES: Mapping[str, Shape] = MappingProxyType({"std_srvs/Trigger": Shape("std_srvs/Trigger", _TRIGGERED)})


class SimulatedRobotLink(GraphLink):
    """A link to one robot of a simulation; callbacks are called during sleeps on the simulation's clock.

    Names and fields are checked against the robot's interface, so that a misspelt one is an error, and not a robot
    that does not move. Its raw messages are those of ROS 2, which need the `rosbags` package. A task that was started
    over this link is stopped when the link is closed.

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
        super().__init__(lambda: SimulatedTransport(simulation, namespace), namespace, is_simulated=True)


class SimulatedTypes:
    """The types of the embedded robot, and those of ROS 2, which need the `rosbags` package.

    Each method raises a `LinkError` for an unknown type, and if the package is needed but not installed.
    """

    def shape(self, message_type: str) -> Shape:
        """Return the fields of a message type.

        Example:
            >>> SimulatedTypes().shape("geometry_msgs/Twist").names
            ('linear', 'angular')
        """
        return _MESSAGES.get(plain_type(message_type)) or _standard_types().shape(message_type)

    def request(self, service_type: str) -> Shape:
        """Return the fields of a service type's request."""
        return _REQUESTS.get(plain_type(service_type)) or _standard_types().request(service_type)

    def response(self, service_type: str) -> Shape:
        """Return the fields of a service type's response."""
        return _RESPONSES.get(plain_type(service_type)) or _standard_types().response(service_type)

    def definition(self, message_type: str) -> str:
        """Return the text of a type's definition, followed by those of the types in it."""
        return _standard_types().definition(message_type)


class SimulatedTransport:
    """The primitives of a link that commands a robot of a simulation, whose robots and offers are one graph."""

    has_threads = False
    encoding = Encoding.CDR

    def __init__(self, simulation: Simulation, namespace: str) -> None:
        self.types = SimulatedTypes()
        self.actions = SimulatedActions(simulation.clock, simulation.actions, self.types)
        self._simulation = simulation
        self._robot: SimulatedRobot = simulation.robot(namespace)
        self._has_started_task = False
        self._commands: dict[str, _CommandPublisher] = {}

    def advertise(self, topic: str, message_type: str, qos: Qos) -> _CommandPublisher:
        """Return a publisher of one of the robot's command topics; it subscribes to no others."""
        del qos
        known = self._robot.command_topics
        name = self._own_name(topic, known, kind="topic that the robot subscribes")
        check_type(topic, message_type, [known[name]])
        return self._commands.setdefault(name, _CommandPublisher(self._robot, name, self._simulation))

    def subscribe(
        self, topic: str, message_type: str, receive: Callable[[Reception], None], *, qos: Qos | None, lane: Lane
    ) -> ClosedBy:
        """Call `receive` with each message, at the rate of the real robot, during sleeps on the clock.

        Commands can be subscribed to, too, as on a graph, so that they can be recorded.
        """
        del qos, lane
        published, clock, types = self._published().get(topic), self._simulation.clock, self.topics()
        if topic not in types:
            raise self._unknown(topic, self._robot.topics, kind="topic that the robot publishes")
        check_type(topic, message_type, [types[topic]])

        def listener(message: Message) -> None:
            receive(_Reception(message_type, message, clock.now_ns))

        if published is not None:
            return ClosedBy(published.listen(listener).close, _SILENT)
        subscribers, key = self._simulation.command_subscribers.setdefault(topic, {}), object()
        subscribers[key] = listener
        return ClosedBy(partial(subscribers.pop, key, None), _SILENT)  # the simulation may have been closed before

    def call(self, service: str, service_type: str, request: Message, timeout: float) -> Message:
        """Call a service of the robot, or an offered one; it answers at once, so `timeout` never runs out."""
        del timeout
        if (offered := self._simulation.offers.get(service)) is not None:
            true, answer = offered
            _check_service_type(service, service_type, true)
            return answer(request)
        name = self._own_name(service, self._robot.services, kind="service of the robot")
        _check_service_type(service, service_type, self._robot.services[name])
        response = self._robot.call(name)
        self._has_started_task |= bool(name.endswith("/start") and response["success"])
        return response

    def serve(self, service: str, service_type: str, answer: Callable[[Message], Message]) -> ClosedBy:
        """Offer a service to all links of the simulation."""
        if service in self.services():
            raise already_offered(service, "the simulation")
        self._simulation.offers[service] = (service_type, answer)
        return ClosedBy(partial(self._simulation.offers.pop, service, None))

    def topics(self) -> Mapping[str, str]:
        """Return the type of each topic of each robot of the simulation."""
        types = {name: topic.message_type for name, topic in self._published().items()}
        for namespace, robot in self._simulation.robots.items():
            types |= {f"{namespace}/{name}": message_type for name, message_type in robot.command_topics.items()}
        return types

    def services(self) -> Mapping[str, str]:
        """Return the type of each service of each robot of the simulation, and of other offered services."""
        own = {
            f"{namespace}/{name}": service_type
            for namespace, robot in self._simulation.robots.items()
            for name, service_type in robot.services.items()
        }
        return own | {name: service_type for name, (service_type, _) in self._simulation.offers.items()}

    def nodes(self) -> Sequence[str]:
        """Return one node for each robot of the simulation."""
        return [f"{namespace}/{_NODE}" for namespace in self._simulation.robots]

    def publishers(self, topic: str) -> Sequence[GraphEndpoint]:
        """Return the robot that publishes a topic."""
        return self._robots_of(topic, lambda robot: {name: each.message_type for name, each in robot.topics.items()})

    def subscribers(self, topic: str) -> Sequence[GraphEndpoint]:
        """Return the robot that subscribes to a topic."""
        return self._robots_of(topic, lambda robot: robot.command_topics)

    def _robots_of(self, topic: str, types_of: Callable[[SimulatedRobot], Mapping[str, str]]) -> list[GraphEndpoint]:
        return [
            GraphEndpoint(f"{namespace}/{_NODE}", message_type)
            for namespace, robot in self._simulation.robots.items()
            for name, message_type in types_of(robot).items()
            if f"{namespace}/{name}" == topic
        ]

    def wait(self, event: threading.Event, seconds: float) -> None:
        """Sleep on the simulation's clock until the event is set, for `seconds` at most."""
        clock = self._simulation.clock
        deadline = clock.now() + seconds
        while not event.is_set() and clock.now() < deadline:
            # The rest may round to zero, in which no message would ever come.
            clock.sleep(max(_LEAST, min(_STEP, deadline - clock.now())))

    def close(self) -> None:
        """Stop the robot's task, if one was started here.

        Raises:
            LinkError: the motors were switched off while the robot was driven over this link, if not reported yet.
        """
        if self._has_started_task:
            self._robot.call("task/stop")
        for each in self._commands.values():
            each.check_motors()

    def _published(self) -> dict[str, PublishedTopic]:
        """Return the topics of all robots, by full name: as on a graph, any node can subscribe to them."""
        robots = self._simulation.robots.items()
        return {f"{namespace}/{name}": topic for namespace, robot in robots for name, topic in robot.topics.items()}

    def _own_name(self, given: str, known: Iterable[str], *, kind: str) -> str:
        prefix = f"{self._robot.namespace}/"
        name = given.removeprefix(prefix)
        if prefix + name == given and name in known:
            return name
        raise self._unknown(given, known, kind=kind)

    def _unknown(self, given: str, known: Iterable[str], *, kind: str) -> LinkError:
        candidates = [f"{self._robot.namespace}/{one}" for one in known]
        where = f"the simulated robot {self._robot.namespace}".rstrip()
        return LinkError(f"{given!r} is not a {kind}", where=where, fix=did_you_mean(given, candidates))


class _CommandPublisher:
    """Commands the robot, which executes a command until the next one, or until its battery is too low."""

    def __init__(self, robot: SimulatedRobot, topic: str, simulation: Simulation) -> None:
        self._robot = robot
        self._topic = topic
        self._simulation = simulation
        self._is_driving = False

    def publish(self, message: Message) -> None:
        if self._topic != "cmd_vel" or message["linear"]["x"] or message["angular"]["z"]:
            self._is_driving = True
            self.check_motors()
        elif self._robot.cut_off is None:
            self._is_driving = False
        self._robot.command(self._topic, message)
        subscribers = self._simulation.command_subscribers.get(f"{self._robot.namespace}/{self._topic}", {})
        for key in subscribers:
            self._simulation.clock.after(0.0, partial(_tell, subscribers, key, message))

    def reach(self) -> bool:
        """Return at once, as the robot always receives."""
        return True

    def is_heard(self) -> bool:
        """Return True: the robot always receives."""
        return True

    def flush(self, seconds: float) -> None:
        """Do nothing, as commands are executed at once."""

    def close(self) -> None:
        """Do nothing, as the publisher holds no resources."""

    def check_motors(self) -> None:
        """Raise a `LinkError`, once, if the motors of a robot that is driven over this link were switched off."""
        cut_off, was_driving = self._robot.cut_off, self._is_driving
        if cut_off is None or not was_driving:
            return
        self._is_driving = False
        raise LinkError(
            f"the simulated robot's battery fell to {cut_off.voltage:.3f} V at {cut_off.time:.0f} s, below its "
            f"cut-off of {self._robot.parameters.cut_off_voltage:g} V: its motors are switched off",
            where=f"the simulated robot {self._robot.namespace}".rstrip(),
            fix="Give it more initial_charge, or a shorter mission.",
        )


class _Reception(NamedTuple):
    """A message of the simulation; its bytes are made only for subscribers that need them."""

    message_type: str
    content: Message
    received_ns: int

    def message(self) -> Message:
        return self.content

    def raw(self) -> RawMessage:
        data = _standard_types().serialise(self.message_type, self.content, Encoding.CDR)
        return RawMessage(data, self.received_ns)


def _tell(subscribers: Mapping[object, Callable[[Message], None]], key: object, message: Message) -> None:
    if key in subscribers:  # otherwise it was closed meanwhile
        subscribers[key](message)


def _check_service_type(service: str, given: str, true: str) -> None:
    if given != true:
        raise wrong_service_type(service, true, given)


def _standard_types() -> TypeCatalogue:
    """Return the types of ROS 2, in which the embedded robot's messages are serialised; they need `rosbags`."""
    from robot_runner.ros.type_catalogue import TypeCatalogue  # noqa: PLC0415  # only for types that are not above

    return TypeCatalogue.of(2)
