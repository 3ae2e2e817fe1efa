"""Links to the embedded robot: its topics and services, its power meter's serial line, its on-board computer."""

from __future__ import annotations

from contextlib import ExitStack
from typing import TYPE_CHECKING

from robot_runner.errors import LinkError, did_you_mean
from robot_runner.links.host import UtilisationSample
from robot_runner.links.messages import completed
from robot_runner.links.serial import Chunk
from robot_runner.simulator.clock import STEPS_PER_SECOND
from robot_runner.simulator.turtlebot3 import COMMAND_TOPICS, SERVICES

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from robot_runner.links.robot import Message, Subscription
    from robot_runner.simulator.clock import SimulatedClock
    from robot_runner.simulator.simulation import Simulation
    from robot_runner.simulator.turtlebot3 import SimulatedTurtlebot3

__all__ = ["SimulatedHost", "SimulatedRobotLink", "SimulatedSerialLine", "SimulatedUtilisationSampler"]

_SECOND_NS = 1_000_000_000
_HIGHEST_RATE = STEPS_PER_SECOND


class SimulatedRobotLink:
    """A link to one robot of a simulation; callbacks are called while the simulation's clock is slept on.

    Names and fields are checked against what the robot offers, so that a misspelt one is an error here and
    not a robot that stands still.

    Example:
        >>> from robot_runner.simulator.simulation import Simulation
        >>> simulation = Simulation(seed=1)
        >>> link = SimulatedRobotLink(simulation)
        >>> link.publish("cmd_vel", "geometry_msgs/Twist", {"linear": {"x": 0.2}})
        >>> link.call("task/video/start", "std_srvs/Trigger")
        {'success': True, 'message': 'video started'}
        >>> link.close()
        >>> simulation.close()
    """

    def __init__(self, simulation: Simulation, *, namespace: str = "") -> None:
        self._robot: SimulatedTurtlebot3 = simulation.turtlebot3(namespace)
        self._subscriptions = ExitStack()
        self._has_driven = False
        self._has_started_task = False
        self._is_closed = False

    @property
    def is_simulated(self) -> bool:
        """Always true."""
        return True

    def publish(self, topic: str, message_type: str, message: Message) -> None:
        """Publish a velocity command, the only thing that the robot hears; it keeps to it until the next.

        Raises:
            LinkError: topic, type or a field is not one that the robot hears, or the link was closed.
        """
        name = self._name(topic, COMMAND_TOPICS, kind="topic that the robot hears")
        _check_type(name, message_type, COMMAND_TOPICS[name])
        twist = completed(message_type, message, where=name)
        self._has_driven = True
        self._robot.drive(twist["linear"]["x"], twist["angular"]["z"])

    def subscribe(self, topic: str, message_type: str, callback: Callable[[Message], None]) -> Subscription:
        """Have `callback` called with each message of the topic, at the rate of the real robot.

        Raises:
            LinkError: the robot does not publish such a topic, or of another type, or the link was closed.
        """
        name = self._name(topic, self._robot.topics, kind="topic that the robot publishes")
        published = self._robot.topics[name]
        _check_type(name, message_type, published.message_type)
        subscription = published.listen(callback)
        self._subscriptions.callback(subscription.close)
        return subscription

    def call(self, service: str, service_type: str, request: Message | None = None, *, timeout: float = 5.0) -> Message:
        """Call a service of the robot; it answers at once, so `timeout` never runs out.

        Raises:
            LinkError: there is no such service, it has another type or other fields, or the link was closed.
        """
        del timeout
        name = self._name(service, SERVICES, kind="service of the robot")
        _check_type(name, service_type, SERVICES[name])
        completed(service_type, request or {}, where=name)
        response = self._robot.call(name)
        self._has_started_task |= bool(name.endswith("/start") and response["success"])
        return response

    def close(self) -> None:
        """Stop the robot if it was driven and its task if one was started here; end all subscriptions."""
        if self._is_closed:
            return
        self._is_closed = True
        self._subscriptions.close()
        if self._has_driven:
            self._robot.drive(0.0, 0.0)
        if self._has_started_task:
            self._robot.call("task/stop")

    def _name(self, given: str, known: Mapping[str, object], *, kind: str) -> str:
        """Return the name within the robot's namespace."""
        where = f"the simulated robot {self._robot.namespace}".rstrip()
        if self._is_closed:
            raise LinkError("the link was closed", where=where, fix="Use it before the run ends.")
        prefix = f"{self._robot.namespace}/" if given.startswith("/") else ""
        name = given.removeprefix(prefix)
        if prefix + name == given and name in known:
            return name
        candidates = [prefix + one for one in known]
        raise LinkError(f"{given!r} is no {kind}", where=where, fix=did_you_mean(given, candidates))


class SimulatedSerialLine:
    """The serial line of a robot's power meter, which is switched on when the line is opened.

    Bytes come in pieces of up to 64, as a USB adapter hands them over, stamped with the simulation's time.

    Example:
        >>> from robot_runner.simulator.simulation import Simulation
        >>> simulation = Simulation(seed=1)
        >>> line = SimulatedSerialLine(simulation)
        >>> simulation.clock.sleep(0.1)
        >>> line.drain()[0].data[:4].hex()
        'a55a120c'
        >>> line.close()
        >>> simulation.close()
    """

    def __init__(self, simulation: Simulation, *, namespace: str = "") -> None:
        self._meter = simulation.turtlebot3(namespace).open_power_meter()
        self._is_closed = False

    @property
    def is_simulated(self) -> bool:
        """Always true."""
        return True

    def drain(self) -> list[Chunk]:
        """Return, oldest first, everything that arrived since the last call.

        Raises:
            LinkError: the line was closed.
        """
        self._check_open()
        return [Chunk(arrival.time_ns / _SECOND_NS, arrival.data) for arrival in self._meter.arrived()]

    def write(self, data: bytes) -> None:
        """Send bytes to the meter.

        Raises:
            LinkError: the line was closed.
        """
        self._check_open()
        self._meter.write(data)

    def close(self) -> None:
        """Close the line; closing twice does nothing."""
        self._is_closed = True

    def _check_open(self) -> None:
        if self._is_closed:
            raise LinkError(
                "the line was closed",
                where="the simulated power meter",
                fix="Drain it before it is closed.",
            )


class SimulatedUtilisationSampler:
    """A sampler on the on-board computer of a robot, started when it is made."""

    def __init__(self, robot: SimulatedTurtlebot3, clock: SimulatedClock, rate: float) -> None:
        self._robot = robot
        self._clock = clock
        self._rate = rate
        self._started_ns = clock.now_ns
        self._samples: list[UtilisationSample] | None = None

    def stop(self) -> list[UtilisationSample]:
        """End sampling and return the samples, oldest first; a second call returns the same."""
        if self._samples is None:
            taken = self._robot.utilisation(start_ns=self._started_ns, stop_ns=self._clock.now_ns, rate=self._rate)
            self._samples = [UtilisationSample(one.time, one.cpu, one.memory) for one in taken]
        return list(self._samples)


class SimulatedHost:
    """The on-board computer of a robot of a simulation.

    Example:
        >>> from robot_runner.simulator.simulation import Simulation
        >>> simulation = Simulation(seed=1)
        >>> sampler = SimulatedHost(simulation).sample_utilisation(10)
        >>> simulation.clock.sleep(2.0)
        >>> len(sampler.stop())
        20
        >>> simulation.close()
    """

    def __init__(self, simulation: Simulation, *, namespace: str = "") -> None:
        self._robot = simulation.turtlebot3(namespace)
        self._clock = simulation.clock
        self._samplers = ExitStack()
        self._is_closed = False

    @property
    def is_simulated(self) -> bool:
        """Always true."""
        return True

    def sample_utilisation(self, rate: float) -> SimulatedUtilisationSampler:
        """Begin to sample CPU and memory utilisation `rate` times a second, 200 at most.

        Raises:
            LinkError: the rate is not one that the computer can be sampled at, or the link was closed.
        """
        if self._is_closed:
            raise LinkError(
                "the link was closed",
                where="the simulated on-board computer",
                fix="Use it before the run ends.",
            )
        if not 0 < rate <= _HIGHEST_RATE:
            raise LinkError(
                f"the sample rate is {rate!r} Hz",
                where="the simulated on-board computer",
                fix=f"Give a rate above 0 and up to {_HIGHEST_RATE} Hz.",
            )
        sampler = SimulatedUtilisationSampler(self._robot, self._clock, rate)
        self._samplers.callback(sampler.stop)
        return sampler

    def close(self) -> None:
        """End all samplers; closing twice does nothing."""
        self._is_closed = True
        self._samplers.close()


def _check_type(name: str, given: str, true: str) -> None:
    if given != true:
        raise LinkError(f"it is of type {true}, not {given!r}", where=name, fix=f"Name the type {true!r}.")
