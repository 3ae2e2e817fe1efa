"""Opens a graph, puts the embedded robot on it, and takes it away again."""

from __future__ import annotations

import logging
import threading
import time
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from robot_runner.core.errors import LinkError, did_you_mean
from robot_runner.core.events.context import SystemClock
from robot_runner.core.links.connect import SIMULATION_TOPIC
from robot_runner.core.links.robot import Qos, RobotName
from robot_runner.ros.graph_links import GRAPH_LINKS
from robot_runner.ros.watchdog import HEARTBEAT_TOPIC, HEARTBEAT_TYPE, RELEASE_SERVICE, RELEASE_TYPE, Watchdog
from robot_runner.simulator.simulated_turtlebot3 import COMMAND_TOPICS, SERVICES

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from robot_runner.core.links.robot import Message, RobotLink
    from robot_runner.simulator.simulated_devices import MeterTerminal
    from robot_runner.simulator.simulated_turtlebot3 import Simulation

__all__ = ["GraphRobot", "GraphSimulation", "SimulatedPlace", "check_pace", "on_graph"]


#: How far the simulation moves on between two looks at the real world, simulated s.
_TICK = 0.01
#: How far, real s, it may be behind before it gives up to catch up.
_LONGEST_LAG = 0.25
_SECOND_NS = 1_000_000_000
#: It comes with tf2, which the smallest installations of ROS 2 lack.
_TRANSFORM_TYPE = "tf2_msgs/TFMessage"
#: Best effort, as of the robot's own drivers; all else is reliable.
_QOS = {"scan": Qos.SENSOR_DATA, "imu": Qos.SENSOR_DATA}

_logger = logging.getLogger(__name__)


class GraphRobot:
    """One robot of a simulation on a graph: its topics and services, its transform, its watchdog, and its clock.

    Args:
        link: to the graph, in the robot's namespace; it stays the caller's to close.
        simulation: whose robot of this namespace it is.
        namespace: of the robot.
        is_clock: whether the simulation's time is published on `/clock` and is what stamps show; if not, they show this
            machine's wall clock.
        real_time_factor: simulated seconds a real second.
        meter: its power meter on a terminal, if it has one.
        has_watchdog: whether it stops once the run that drives it has fallen silent.

    Attributes:
        lags: how often it could not keep up with its pace.

    Raises:
        LinkError: the graph cannot be reached, or such a robot is offered there already.

    Example:
        >>> from robot_runner.simulator.simulated_turtlebot3 import Simulation
        >>> robot = GraphRobot(link, Simulation(seed=1), namespace="/alice")  # doctest: +SKIP
        >>> robot.live(seconds=10.0)  # doctest: +SKIP
        >>> robot.close()  # doctest: +SKIP
    """

    def __init__(
        self,
        link: RobotLink,
        simulation: Simulation,
        *,
        namespace: str = "",
        is_clock: bool = False,
        real_time_factor: float = 1.0,
        meter: MeterTerminal | None = None,
        has_watchdog: bool = True,
    ) -> None:
        self._link = link
        self._clock = simulation.clock
        self._robot = simulation.turtlebot3(namespace)
        self._is_clock = is_clock
        self._factor = real_time_factor
        self._meter = meter
        self._has_transform = _is_known(link, _TRANSFORM_TYPE)
        self._watchdog = Watchdog() if has_watchdog else Watchdog(heartbeat_timeout=0.0)
        self._lock = threading.Lock()  # callbacks come from threads of the link; the simulation has one at a time
        self._closing = ExitStack()
        self.lags = 0
        with ExitStack() as undoing:
            undoing.callback(self.close)
            self._offer()
            self._subscribe()
            self._publish_from_now_on()
            undoing.pop_all()

    @property
    def now(self) -> float:
        """How long it has lived, simulated s."""
        return self._clock.now()

    def live(self, *, seconds: float | None = None, is_over: Callable[[], bool] = lambda: False) -> None:
        """Live for so many simulated seconds, or until `is_over`, at the pace that was asked for.

        Raises:
            LinkError: the graph cannot be reached any more.
        """
        end = None if seconds is None else self.now + seconds
        begun, begun_at = time.monotonic(), self.now
        while not is_over() and (end is None or self.now < end):
            with self._lock:
                self._tick()
            ahead = (self.now - begun_at) / self._factor - (time.monotonic() - begun)
            if ahead > 0:
                time.sleep(ahead)
            elif ahead < -_LONGEST_LAG:  # a machine that is too slow, or was suspended
                begun, begun_at = time.monotonic(), self.now
                self.lags += 1

    def close(self) -> None:
        """End all offers and subscriptions; closing twice does nothing."""
        self._closing.close()

    def _tick(self) -> None:
        if self._watchdog.must_stop(time.monotonic()):
            self._robot.drive(0.0, 0.0)
        self._clock.sleep(_TICK)
        if self._is_clock:
            self._link.publish("/clock", "rosgraph_msgs/Clock", {"clock": self._stamp()})
        if self._meter is not None:
            self._meter.exchange()

    def _offer(self) -> None:
        for name, service_type in SERVICES.items():
            self._keep(self._link.offer(name, service_type, partial(self._call, name)))
        self._keep(self._link.offer(RELEASE_SERVICE, RELEASE_TYPE, self._release))

    def _subscribe(self) -> None:
        for topic, message_type in COMMAND_TOPICS.items():
            self._keep(self._link.subscribe(topic, message_type, self._drive))
        self._keep(self._link.subscribe(HEARTBEAT_TOPIC, HEARTBEAT_TYPE, self._take_heartbeat))

    def _publish_from_now_on(self) -> None:
        self._link.publish(SIMULATION_TOPIC, "std_msgs/String", {"data": "turtlebot3"}, qos=Qos.TRANSIENT_LOCAL)
        for name, topic in self._robot.topics.items():
            publish = partial(self._publish, name, topic.message_type, _QOS.get(name, Qos.DEFAULT))
            self._keep(topic.listen(publish))

    def _keep(self, subscription: Any) -> None:
        self._closing.callback(subscription.close)

    def _publish(self, name: str, message_type: str, qos: Qos, message: dict[str, Any]) -> None:
        stamped = {**message, "header": {**message["header"], "stamp": self._stamp()}}
        self._link.publish(name, message_type, stamped, qos=qos)
        if name == "odom" and self._has_transform:
            self._link.publish("tf", _TRANSFORM_TYPE, {"transforms": [_transform(stamped)]})

    def _stamp(self) -> dict[str, int]:
        seconds, nanoseconds = divmod(self._clock.now_ns if self._is_clock else time.time_ns(), _SECOND_NS)
        return {"sec": seconds, "nanosec": nanoseconds}

    def _drive(self, message: Message) -> None:
        speed, rate = float(message["linear"]["x"]), float(message["angular"]["z"])
        with self._lock:
            self._watchdog.hear_command(is_moving=bool(speed or rate), now=time.monotonic())
            self._robot.drive(speed, rate)

    def _take_heartbeat(self, message: Message) -> None:
        with self._lock:
            self._watchdog.hear_heartbeat(message["data"], time.monotonic())

    def _call(self, name: str, request: Message) -> Message:
        del request
        with self._lock:
            return self._robot.call(name)

    def _release(self, request: Message) -> Message:
        del request
        with self._lock:
            self._watchdog.release()
        return {"success": True, "message": "the robot may be moved until the next heartbeat"}


def _is_known(link: RobotLink, message_type: str) -> bool:
    try:
        link.definition(message_type)
    except LinkError as error:
        _logger.warning("the robot says nothing on tf: %s", error)
        return False
    return True


def _transform(odometry: Message) -> Message:
    """Return the transform that an odometry message implies."""
    pose = odometry["pose"]["pose"]
    return {
        "header": odometry["header"],
        "child_frame_id": odometry["child_frame_id"],
        "transform": {"translation": pose["position"], "rotation": pose["orientation"]},
    }


_USE_SIM_TIME = "/use_sim_time"


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulatedPlace:
    """Where and how the embedded robot is to live.

    Attributes:
        link: to the graph, as `robot` in a config has it: `ros1`, `ros2`, `dds`, or `dds:domain=7`.
        namespace: of the robot: empty, or `/alice`.
        seed: of the simulation.
        real_time_factor: simulated seconds a real second.
        is_clock: whether its time is published on `/clock`.
        has_watchdog: whether it stops once the run that drives it has fallen silent.
        room: a file that describes where it lives; None for the usual room.

    Example:
        >>> SimulatedPlace(link="dds:domain=7", namespace="/alice").real_time_factor
        1.0
    """

    link: str
    namespace: str = ""
    seed: int = 1
    real_time_factor: float = 1.0
    is_clock: bool = False
    has_watchdog: bool = True
    room: Path | None = None


@dataclass(frozen=True, slots=True)
class GraphSimulation:
    """The robot on the graph.

    Attributes:
        robot: which must be let live.
        meter_port: where its power meter is opened.
    """

    robot: GraphRobot
    meter_port: Path


def check_pace(place: SimulatedPlace) -> None:
    """See that the graph can follow the robot's time.

    Raises:
        LinkError: its time goes by at another pace than that of the graph.
    """
    if not 0 < place.real_time_factor < float("inf"):
        raise LinkError(
            f"the real-time factor is {place.real_time_factor:g}, which no clock can keep",
            where="the simulated robot",
            fix="Give 1 for real time, 2 for twice as fast.",
        )
    if place.real_time_factor != 1.0 and not place.is_clock:
        raise LinkError(
            f"the real-time factor is {place.real_time_factor:g}, and the graph is not told the time",
            where="the simulated robot",
            fix="Publish it as well: --use-sim-time.",
        )


@contextmanager
def on_graph(place: SimulatedPlace) -> Iterator[GraphSimulation]:
    """Put the embedded robot on a graph for as long as the context lasts.

    Raises:
        LinkError: the graph cannot be reached, such a robot is offered there already, or a package is missing.
    """
    check_pace(place)
    name = RobotName.parse(place.link)
    if name.link not in GRAPH_LINKS:
        fix = did_you_mean(name.link, GRAPH_LINKS)
        raise LinkError(f"no robot can be put on {name.link!r}", where="the simulated robot", fix=fix)
    from robot_runner.simulator.room_file import read_room  # noqa: PLC0415
    from robot_runner.simulator.rooms import DEFAULT_ROOM  # noqa: PLC0415
    from robot_runner.simulator.simulated_devices import MeterTerminal  # noqa: PLC0415
    from robot_runner.simulator.simulated_turtlebot3 import Simulation  # noqa: PLC0415

    room = DEFAULT_ROOM if place.room is None else read_room(place.room)
    with ExitStack() as closing:
        simulation = Simulation(place.seed, room=room)
        closing.callback(simulation.close)
        meter = MeterTerminal(simulation, namespace=place.namespace)
        closing.callback(meter.close)
        link = GRAPH_LINKS[name.link].open(name, SystemClock(), place.namespace)
        closing.callback(link.close)
        robot = GraphRobot(
            link,
            simulation,
            namespace=place.namespace,
            is_clock=place.is_clock,
            real_time_factor=place.real_time_factor,
            meter=meter,
            has_watchdog=place.has_watchdog,
        )
        closing.callback(robot.close)
        if place.is_clock:
            closing.enter_context(_announced_clock(name))
        yield GraphSimulation(robot, meter.port)


@contextmanager
def _announced_clock(name: RobotName) -> Iterator[None]:
    """While it lasts, nodes of ROS 1 that start are told to live by `/clock`; those of ROS 2 are told one by one."""
    if name.link != "ros1":
        yield
        return
    from robot_runner.ros.ros1_link import master_of  # noqa: PLC0415  # only where it is asked for

    master = master_of(name.options)
    before = master.parameter(_USE_SIM_TIME)
    master.set_parameter(_USE_SIM_TIME, value=True)
    try:
        yield
    finally:
        master.set_parameter(_USE_SIM_TIME, value=bool(before))
