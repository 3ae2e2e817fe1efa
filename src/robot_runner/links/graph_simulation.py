"""Opens a graph, puts the embedded robot on it, and takes it away again."""

from __future__ import annotations

from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

from robot_runner.errors import LinkError, did_you_mean
from robot_runner.events.clock import SystemClock
from robot_runner.links.graph_links import GRAPH_LINKS, open_graph_link
from robot_runner.links.robot_name import RobotName

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from robot_runner.links.graph_robot import GraphRobot

__all__ = ["GraphSimulation", "SimulatedPlace", "check_pace", "on_graph"]

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

    Example:
        >>> SimulatedPlace(link="dds:domain=7", namespace="/alice").real_time_factor
        1.0
    """

    link: str
    namespace: str = ""
    seed: int = 1
    real_time_factor: float = 1.0
    is_clock: bool = False


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
            f"the real-time factor is {place.real_time_factor:g}, and nobody on the graph is told the time",
            where="the simulated robot",
            fix="Publish it as well: --use-sim-time.",
        )


@contextmanager
def on_graph(place: SimulatedPlace) -> Iterator[GraphSimulation]:
    """Put the embedded robot on a graph for as long as the context lasts.

    Raises:
        LinkError: the graph cannot be reached, somebody offers such a robot there, or a package is missing.
    """
    check_pace(place)
    name = RobotName.parse(place.link)
    if name.link not in GRAPH_LINKS:
        fix = did_you_mean(name.link, GRAPH_LINKS)
        raise LinkError(f"no robot can be put on {name.link!r}", where="the simulated robot", fix=fix)
    from robot_runner.links.graph_robot import GraphRobot  # noqa: PLC0415  # they import MuJoCo
    from robot_runner.links.meter_terminal import MeterTerminal  # noqa: PLC0415
    from robot_runner.simulator.simulation import Simulation  # noqa: PLC0415

    with ExitStack() as closing:
        simulation = Simulation(place.seed)
        closing.callback(simulation.close)
        meter = MeterTerminal(simulation, namespace=place.namespace)
        closing.callback(meter.close)
        link = open_graph_link(name, SystemClock(), place.namespace)
        closing.callback(link.close)
        robot = GraphRobot(
            link,
            simulation,
            namespace=place.namespace,
            is_clock=place.is_clock,
            real_time_factor=place.real_time_factor,
            meter=meter,
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
    from robot_runner.links.ros1.opening import master_of  # noqa: PLC0415  # only where it is asked for

    master = master_of(name.options)
    before = master.parameter(_USE_SIM_TIME)
    master.set_parameter(_USE_SIM_TIME, value=True)
    try:
        yield
    finally:
        master.set_parameter(_USE_SIM_TIME, value=bool(before))
