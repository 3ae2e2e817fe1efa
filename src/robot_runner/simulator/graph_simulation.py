"""Offers the embedded robot on a graph, with services that reset and pause it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from functools import partial

from robot_runner.core.errors import LinkError, did_you_mean
from robot_runner.core.events.context import SystemClock
from robot_runner.core.links.connect import resolved_robot
from robot_runner.core.links.graph_names import namespace_prefix
from robot_runner.core.links.robot import Message, RobotLink
from robot_runner.core.links.robot_name import RobotName
from robot_runner.ros.graph_links import GRAPH_LINKS
from robot_runner.ros.shapes import stamp_of
from robot_runner.simulator.graph_robot import GraphRobot, SimulatedPlace
from robot_runner.simulator.modelled_robot import RobotModel
from robot_runner.simulator.room_file import read_room
from robot_runner.simulator.rooms import DEFAULT_ROOM, Room
from robot_runner.simulator.simulated_turtlebot3 import Simulation

#: How far the simulation advances between two checks of the real time and the graph, simulated s.
_TICK = 0.01
#: If it is behind by more than this, real s, it does not try to catch up.
_LONGEST_LAG = 0.25
#: The period of checking for subscribers of the cameras, in ticks: once a simulated second.
_CAMERA_TICKS = 100
_SERVICE_TYPE = "std_srvs/Empty"


class GraphSimulation:
    """A simulation on a graph: its robots, its time, and services that reset and pause it.

    The services are those of Gazebo classic: `reset_simulation` (restarts time, battery and odometry, with the noise of
    another seed, so that the next run differs), `reset_world` (puts the robots back to their starts while time goes
    on), `pause_physics` and `unpause_physics`, all of std_srvs/Empty.

    There is a link for each robot, by namespace; the caller closes them. The services are offered over the first.
    `make` makes a simulation from a seed; with `has_meter` each robot's power meter is opened on a terminal.

    Attributes:
        robots: its robots, by namespace.
        lags: how often it could not keep up with its pace.
        is_paused: whether its time is stopped.

    Raises:
        LinkError: a graph cannot be reached, or there is such a robot already.

    Example:
        >>> from robot_runner.simulator.simulated_turtlebot3 import Simulation
        >>> graph = GraphSimulation({"": link}, Simulation, SimulatedPlace(link="dds"))  # doctest: +SKIP
        >>> graph.live(seconds=10.0)  # doctest: +SKIP
        >>> graph.close()  # doctest: +SKIP
    """

    def __init__(
        self,
        links: Mapping[str, RobotLink],
        make: Callable[[int], Simulation],
        place: SimulatedPlace,
        *,
        has_meter: bool = False,
    ) -> None:
        self._make = make
        self._place = place
        self._seed = place.seed
        self._simulation = make(place.seed)
        self._link = next(iter(links.values()))
        self._lock = threading.RLock()  # callbacks come from threads of the links; the simulation has one at a time
        self._is_reset = False
        self._ticks = 0
        self._closing = ExitStack()
        self.robots: dict[str, GraphRobot] = {}
        self.lags = 0
        self.is_paused = False
        with ExitStack() as undoing:
            undoing.callback(self.close)
            self._closing.callback(lambda: self._simulation.close())  # noqa: PLW0108 - a reset replaces it
            for namespace, link in links.items():
                robot = GraphRobot(
                    link, self._simulation, place, namespace=namespace, lock=self._lock, has_meter=has_meter
                )
                self.robots[namespace] = robot
                self._closing.callback(robot.close)
            self._offer()
            undoing.pop_all()

    @property
    def now(self) -> float:
        """The time since the last reset, simulated s."""
        return self._simulation.clock.now()

    def live(self, *, seconds: float | None = None, is_over: Callable[[], bool] = lambda: False) -> None:
        """Advance by `seconds` of simulated time, or until `is_over()`, at the real-time factor of the settings."""
        end = None if seconds is None else self.now + seconds
        begun, begun_at = time.monotonic(), self.now
        while not is_over() and (end is None or self.now < end):
            with self._lock:
                is_moving_on = not self.is_paused
                if is_moving_on:
                    self._tick()
                is_moving_on, self._is_reset = is_moving_on and not self._is_reset, False
            ahead = (self.now - begun_at) / self._place.real_time_factor - (time.monotonic() - begun)
            if not is_moving_on:
                time.sleep(_TICK)
                begun, begun_at = time.monotonic(), self.now
            elif ahead > 0:
                time.sleep(ahead)
            elif ahead < -_LONGEST_LAG:  # the machine is too slow, or was suspended
                begun, begun_at = time.monotonic(), self.now
                self.lags += 1

    def reset(self) -> None:
        """Restart at time 0, with a full battery and the noise of the next seed."""
        with self._lock:
            self._seed += 1
            earlier, self._simulation = self._simulation, self._make(self._seed)
            for robot in self.robots.values():
                robot.enter(self._simulation)
            earlier.close()
            self._is_reset = True

    def put_back(self) -> None:
        """Stop all robots, and put them back to their starts; time and batteries go on."""
        with self._lock:
            for robot in self.robots.values():
                robot.put_back()

    def pause(self, *, is_paused: bool) -> None:
        """Stop its time, or let it go on."""
        with self._lock:
            self.is_paused = is_paused

    def close(self) -> None:
        """End all offers and subscriptions; closing twice does nothing."""
        self._closing.close()

    def _offer(self) -> None:
        services: dict[str, Callable[[], None]] = {
            "reset_simulation": self.reset,
            "reset_world": self.put_back,
            "pause_physics": partial(self.pause, is_paused=True),
            "unpause_physics": partial(self.pause, is_paused=False),
        }
        for name, act in services.items():
            self._closing.callback(self._link.offer(name, _SERVICE_TYPE, partial(_answered, act)).close)

    def _tick(self) -> None:
        for robot in self.robots.values():
            robot.watch()
        self._simulation.clock.sleep(_TICK)
        if self._place.is_clock:
            clock = {"clock": stamp_of(self._simulation.clock.now_ns)}
            self._link.publish("/clock", "rosgraph_msgs/Clock", clock)
        self._ticks += 1
        for robot in self.robots.values():
            if self._ticks % _CAMERA_TICKS == 0:
                robot.watch_camera()
            if robot.meter is not None:
                robot.meter.exchange()


def _answered(act: Callable[[], None], request: Message) -> Message:
    del request
    act()
    return {}


_USE_SIM_TIME = "/use_sim_time"


def check_pace(place: SimulatedPlace) -> None:
    """Raise a `LinkError` if the graph cannot follow the robot's time, which has another pace."""
    if not 0 < place.real_time_factor < float("inf"):
        problem = f"the real-time factor is {place.real_time_factor:g}, which no clock can keep"
        raise LinkError(problem, where="the simulated robot", fix="Give 1 for real time, 2 for twice as fast.")
    if place.real_time_factor != 1.0 and not place.is_clock:
        problem = f"the real-time factor is {place.real_time_factor:g}, and the graph is not told the time"
        raise LinkError(problem, where="the simulated robot", fix="Publish it as well: --use-sim-time.")


@contextmanager
def on_graph(place: SimulatedPlace) -> Iterator[GraphSimulation]:
    """Offer the embedded robot, or all robots of a room that names some, on a graph while the context lasts.

    Raises:
        LinkError: the graph cannot be reached, there is such a robot already, or a package is missing.
    """
    check_pace(place)
    link = RobotName.parse(place.link).link
    if link not in GRAPH_LINKS:
        fix = did_you_mean(link, GRAPH_LINKS)
        raise LinkError(f"no robot can be put on {link!r}", where="the simulated robot", fix=fix)
    _, name = resolved_robot(place.link)
    within = namespace_prefix(name.namespace)
    room = None if place.room is None else read_room(place.room).below(within)
    model = None if place.model is None else RobotModel(place.model, room)
    namespaces = _namespaces(place, room, within)
    with ExitStack() as closing:
        links = []
        for namespace in namespaces:
            links.append(GRAPH_LINKS[name.link].open(name, SystemClock(), namespace))
            closing.callback(links[-1].close)
        graph = GraphSimulation(
            dict(zip(namespaces, links, strict=True)),
            lambda seed: Simulation(seed, room=room or DEFAULT_ROOM, model=model),
            place,
            has_meter=model is None,
        )
        closing.callback(graph.close)
        if place.is_clock:
            closing.enter_context(_announced_clock(name))
        yield graph


def _namespaces(place: SimulatedPlace, room: Room | None, within: str) -> list[str]:
    """Return the full namespaces of the robots to offer; those of the room are full already."""
    if room is None or not room.robots or place.model is not None:
        return [f"{within}{namespace_prefix(place.namespace)}"]
    if place.namespace:
        problem = f"the namespace is {place.namespace!r}, and the room names its robots: {', '.join(room.robots)}"
        raise LinkError(problem, where="the simulated robot", fix="Leave --namespace out, or [[robot]] in the room.")
    return list(room.robots)


@contextmanager
def _announced_clock(name: RobotName) -> Iterator[None]:
    """Make new nodes of ROS 1 use `/clock` while the context lasts; in ROS 2 each node has its own parameter."""
    if name.link != "ros1":
        yield
        return
    from robot_runner.ros.link_opening import master_of  # noqa: PLC0415  # only where it is asked for

    master = master_of(name.options)
    before = master.parameter(_USE_SIM_TIME)
    master.set_parameter(_USE_SIM_TIME, value=True)
    try:
        yield
    finally:
        master.set_parameter(_USE_SIM_TIME, value=bool(before))
