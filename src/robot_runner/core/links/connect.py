"""By what a simulated robot on a real graph is told from a real one, so that its values are labelled."""

from __future__ import annotations

import importlib.util
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING

from robot_runner.core.errors import Finding, LinkError, nearest
from robot_runner.core.events.context import SystemClock
from robot_runner.core.links.host import LOCAL
from robot_runner.core.links.robot import RobotName, simulation_options
from robot_runner.ros.graph_clock import GraphClock
from robot_runner.ros.graph_links import GRAPH_LINKS, follows_graph_clock, full_name, graph_findings, open_graph_link
from robot_runner.ros.ros_environment import AUTO, found_robot

if TYPE_CHECKING:
    from pathlib import Path

    from robot_runner.core.events.context import Clock, Resources, RobotRunnerContext
    from robot_runner.core.links.host import HostLink
    from robot_runner.core.links.robot import RobotLink
    from robot_runner.core.links.serial_line import SerialLine
    from robot_runner.simulator.simulated_turtlebot3 import Simulation

__all__ = [
    "ROBOT_LINKS",
    "SIMULATED",
    "SIMULATION_TOPIC",
    "connect_host",
    "connect_robot",
    "is_simulated",
    "is_simulation",
    "link_findings",
    "lives_by_simulation",
    "open_clock",
    "open_serial_line",
]


# Opens the links of a run by the name of its robot, and says which names there are.

SIMULATED = "simulated"

#: How a robot can be reached, by the name that a config gives in `robot`.
ROBOT_LINKS = MappingProxyType(
    {
        SIMULATED: "the embedded TurtleBot3 Burger: a physics simulation with a clock of its own",
        **{name: link.description for name, link in GRAPH_LINKS.items()},
        AUTO: "what is found: a ROS that is sourced, a ROS 1 master, a rosbridge, ROS 2 over DDS; never the simulation",
    }
)

_SIMULATOR_PACKAGES = ("mujoco", "numpy")
_INSTALL = "Install the simulator: pip install 'robot-runner[sim]'."
_SIMULATE = "Execute it on the embedded robot: --set robot=simulated."
_NAME_IT = (
    "Name the port or the host in the plugin, as in Ina219(port='/dev/ttyUSB0') or PsUtil(host='pi@robot'). "
    "Or: --set robot=simulated."
)


def link_findings(robot: str | None) -> list[Finding]:
    """Return what stands in the way of reaching this robot; nothing is opened by asking.

    Example:
        >>> [finding.problem for finding in link_findings("simulatd")]
        ["robot is 'simulatd', which is no link of this version"]
    """
    if robot is None:
        return []
    try:
        name = _known(robot)
        return _simulator_findings(name) if name.link == SIMULATED else graph_findings(name)
    except LinkError as error:
        return [error.as_finding()]


def is_simulated(robot: str | None) -> bool:
    """Whether a robot of this name is the embedded one, whatever its options.

    Example:
        >>> is_simulated("simulated:task_power_factor=1.1")
        True
    """
    return robot is not None and robot.partition(":")[0].strip() == SIMULATED


def lives_by_simulation(context: RobotRunnerContext) -> bool:
    """Whether the run's clock is that of a simulation: of the embedded robot, or of one on a graph."""
    return is_simulated(context.robot) or isinstance(context.clock, GraphClock)


def open_clock(robot: str | None, resources: Resources, seed: int) -> Clock:
    """Return the clock of a run: the simulation's, the graph's where that lives by one of its own, else this machine's.

    Args:
        robot: how the robot is reached, or None where the experiment has none; an option such as
            `simulated:initial_charge=40` sets a figure of `Turtlebot3Parameters`.
        resources: the run's, with which the simulation is closed.
        seed: the run's seed.

    Raises:
        LinkError: there is no link of this name, the simulator is not installed, or the graph does not tell the time.
    """
    if robot is None:
        return SystemClock()
    name = _known(robot)
    if name.link == SIMULATED:
        return _simulation(resources, seed, name).clock
    return (
        resources.open("graph clock", partial(_graph_clock, name, resources))
        if follows_graph_clock(name)
        else SystemClock()
    )


def connect_robot(context: RobotRunnerContext, *, namespace: str = "") -> RobotLink:
    """Return the link to the run's robot of this namespace; it is opened once and closed with the run.

    Raises:
        LinkError: the run has no robot, or it cannot be reached.
    """
    name = _named(context.robot)
    if name.link != SIMULATED:
        return _graph_link(name, context.resources, context.clock, namespace)
    simulation = _simulation_of(context)

    def opener() -> RobotLink:
        from robot_runner.simulator.simulated_link import SimulatedRobotLink  # noqa: PLC0415  # it imports MuJoCo

        return SimulatedRobotLink(simulation, namespace=namespace)

    return context.resources.open(f"robot {_key(namespace)}", opener)


def open_serial_line(
    context: RobotRunnerContext, port: str | None, *, namespace: str = "", baud: int = 115200
) -> SerialLine:
    """Return the serial line at this port; it is opened once and closed with the run.

    Args:
        context: the run's.
        port: a device file, or a URL of pyserial's; None is the power meter of a simulated robot, which has no other.
        namespace: whose power meter it is, where no port is named.
        baud: bits a second, where a port is named.

    Raises:
        LinkError: no port is named and the run has no simulated robot, one was named on a simulated robot, or it cannot
            be opened.
    """
    if port is not None and not is_simulated(context.robot):
        return _port_line(context, port, baud)
    simulation = _simulation_of(context)
    _check_own("serial port", port)

    def opener() -> SerialLine:
        from robot_runner.simulator.simulated_devices import SimulatedSerialLine  # noqa: PLC0415  # it imports MuJoCo

        return SimulatedSerialLine(simulation, namespace=namespace)

    return context.resources.open(f"serial {_key(namespace)}", opener)


def _port_line(context: RobotRunnerContext, port: str, baud: int) -> SerialLine:
    def opener() -> SerialLine:
        from robot_runner.core.links.serial_line import SerialPort  # noqa: PLC0415  # only where it is asked for

        return SerialPort(port, context.clock, baud=baud)

    return context.resources.open(f"port {port}", opener)


def connect_host(
    context: RobotRunnerContext,
    host: str | None,
    *,
    namespace: str = "",
    ssh_config: Path | None = None,
    form: str | None = None,
) -> HostLink:
    """Return the link to this host; it is opened once and closed with the run.

    Args:
        context: the run's.
        host: a host's name: `localhost` is this machine, any other is reached by ssh (`pi@robot`); None is the on-board
            computer of the run's simulated robot.
        namespace: whose on-board computer it is, where no host is named.
        ssh_config: a file to take the place of the user's ssh config.
        form: how it is sampled over ssh: `python3`, `sh` or `ps`; left out, the best that it can do.

    Raises:
        LinkError: no host is named and the run has no simulated robot, or the name cannot be that of a host.
    """
    if host is not None:
        return _named_host(context, host, ssh_config, form)
    simulation = _simulation_of(context)

    def opener() -> HostLink:
        from robot_runner.simulator.simulated_devices import SimulatedHost  # noqa: PLC0415  # it imports MuJoCo

        return SimulatedHost(simulation, namespace=namespace)

    return context.resources.open(f"host {_key(namespace)}", opener)


def _named_host(context: RobotRunnerContext, host: str, config: Path | None, form: str | None) -> HostLink:
    # The clock of a simulation says nothing of a real computer.
    clock = SystemClock() if lives_by_simulation(context) else context.clock

    def opener() -> HostLink:
        if host == LOCAL:
            from robot_runner.core.links.local_host import LocalHost  # noqa: PLC0415  # only where it is asked for

            return LocalHost(clock)
        from robot_runner.core.links.ssh_host import SshHost  # noqa: PLC0415  # only where it is asked for

        return SshHost(host, clock, config=config, form=form)

    return context.resources.open(f"computer {host} {config} {form}", opener)


def _simulation_of(context: RobotRunnerContext) -> Simulation:
    return _simulation(context.resources, context.run_seed, _simulated(context.robot))


def _simulation(resources: Resources, seed: int, name: RobotName) -> Simulation:
    """Return the run's one simulation, whoever asks for it first."""

    def opener() -> Simulation:
        try:
            from robot_runner.simulator.simulated_turtlebot3 import Simulation  # noqa: PLC0415  # it imports MuJoCo
        except ModuleNotFoundError as error:
            raise _not_installed([error.name or "mujoco"]) from error
        options = simulation_options(name.options)
        return Simulation(seed, parameters=options.parameters, real_time_factor=options.real_time_factor)

    return resources.open("simulation", opener)


def _graph_link(name: RobotName, resources: Resources, clock: Clock, namespace: str) -> RobotLink:
    return resources.open(f"robot {_key(namespace)}", partial(open_graph_link, name, clock, namespace))


def _graph_clock(name: RobotName, resources: Resources) -> GraphClock:
    clock = GraphClock(_graph_link(name, resources, SystemClock(), ""))
    clock.start()
    return clock


def _simulated(robot: str | None) -> RobotName:
    name = _named(robot)
    if name.link != SIMULATED:
        raise LinkError(
            f"robot is {robot!r}, which is not simulated, and what measures it is not named",
            where="robot",
            fix=_NAME_IT,
        )
    return name


def _named(robot: str | None) -> RobotName:
    if robot is None:
        raise LinkError(
            "the experiment names no robot",
            where="robot",
            fix=f"Name one in the config: robot = {SIMULATED!r}. Or: --set robot={SIMULATED}.",
        )
    return _known(robot)


def _known(robot: str) -> RobotName:
    name = RobotName.parse(robot)
    if name.link not in ROBOT_LINKS or (name.address is not None and name.link != "rosbridge"):
        raise _unknown(robot)
    return RobotName.parse(found_robot().name) if name.link == AUTO else name


def _simulator_findings(name: RobotName) -> list[Finding]:
    missing = [package for package in _SIMULATOR_PACKAGES if importlib.util.find_spec(package) is None]
    if missing:
        return [_not_installed(missing).as_finding()]
    if name.options:
        simulation_options(name.options)
    return []


def _check_own(kind: str, name: str | None) -> None:
    if name is not None:
        raise LinkError(
            f"a simulated robot has no {kind} {name!r}",
            where=f"robot = {SIMULATED!r}",
            fix=f"Leave the {kind} out: it is the robot's own.",
        )


def _key(namespace: str) -> str:
    # With `robot`, `serial` or `host` before it, the key under which a run keeps the link; the fakes of
    # `robot_runner.testing` are put in place under the same keys.
    return namespace.strip("/") or "/"


def _unknown(robot: str) -> LinkError:
    near = nearest(robot.partition(":")[0], ROBOT_LINKS)
    return LinkError(
        f"robot is {robot!r}, which is no link of this version",
        where="robot",
        fix=f"Did you mean {near!r}?" if near else _SIMULATE,
    )


def _not_installed(missing: list[str]) -> LinkError:
    return LinkError(
        f"robot is {SIMULATED!r}, but {' and '.join(missing)} cannot be imported",
        where="robot",
        fix=_INSTALL,
    )


#: Published once, by who puts a simulated robot on a graph, in the robot's namespace.
SIMULATION_TOPIC = "robot_runner/simulation"
_CLOCK = "/clock"


def is_simulation(link: RobotLink, namespace: str = "") -> bool:
    """Whether there is a simulated robot behind a link: the embedded one, or one on a graph that shows a sign of it.

    The signs are the mark of `robot-runner simulate`, and a `/clock`: a graph with real robots needs none.

    Raises:
        LinkError: the graph cannot be reached.

    Example:
        >>> from robot_runner.testing import FakeClock, FakeRobotLink
        >>> is_simulation(FakeRobotLink(FakeClock(), is_simulated=True))
        True
    """
    if link.is_simulated:
        return True
    topics = link.topics()
    return _CLOCK in topics or full_name(namespace, SIMULATION_TOPIC) in topics
