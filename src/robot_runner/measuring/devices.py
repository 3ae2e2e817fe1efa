"""Opens the serial lines to meters and the links to computers of a run, each once."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Protocol, runtime_checkable

from robot_runner.core.errors import LinkError
from robot_runner.core.events.context import RobotRunnerContext
from robot_runner.core.events.resources import Resources
from robot_runner.core.links.connect import SIMULATED, is_simulated, robot_namespace, run_robot
from robot_runner.core.links.declared_host import LOCAL
from robot_runner.core.links.kinds import link_key
from robot_runner.core.links.robot_name import RobotName
from robot_runner.measuring.host import HostLink
from robot_runner.measuring.measured_machine import machine_clock
from robot_runner.measuring.serial_line import SerialLine, SerialPort
from robot_runner.measuring.ssh_host import SshHost

_NAME_IT = (
    "Name the port or the host in the plugin, as in Ina219(port='/dev/ttyUSB0') or PsUtil(host='pi@robot'). "
    f"Or: --set robot={SIMULATED}."
)


@runtime_checkable
class BringsDevices(Protocol):
    """A kind of link whose robots have a power meter and an on-board computer of their own, as a simulated one."""

    def open_serial_line(self, name: RobotName, *, resources: Resources, seed: int, namespace: str) -> SerialLine:
        """Open the serial line of the robot's power meter."""

    def open_host(self, name: RobotName, *, resources: Resources, seed: int, namespace: str) -> HostLink:
        """Open a link to the robot's on-board computer."""


def open_serial_line(
    context: RobotRunnerContext, port: str | None, *, namespace: str = "", baud: int = 115200
) -> SerialLine:
    """Return the serial line at this port; it is opened once and closed with the run.

    Args:
        context: the run's.
        port: a device file, or a URL of pyserial's; None is the power meter of a simulated robot, which has no other.
        namespace: of the robot whose power meter it is, where no port is named.
        baud: bits a second, where a port is named.

    Raises:
        LinkError: no port is named and the run has no simulated robot, one was named on a simulated robot, or it cannot
            be opened.
    """
    if port is not None and not is_simulated(context.robot):
        return context.resources.open(f"port {port}", lambda: SerialPort(port, context.clock, baud=baud))
    devices, name = _own_devices(context)
    if port is not None:
        problem = f"a simulated robot has no serial port {port!r}"
        fix = "Leave the serial port out: it is the robot's own."
        raise LinkError(problem, where=f"robot = {context.robot!r}", fix=fix)
    within = robot_namespace(context, namespace)
    opener = partial(
        devices.open_serial_line, name, resources=context.resources, seed=context.run_seed, namespace=within
    )
    return context.resources.open(link_key("serial", namespace), opener)


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
        namespace: of the robot whose on-board computer it is, where no host is named.
        ssh_config: a file to use instead of the user's ssh config.
        form: how it is sampled over ssh: `python3`, `sh` or `ps`; None takes the best one that works there.

    Raises:
        LinkError: no host is named and the run has no simulated robot, or the name cannot be that of a host.
    """
    if host is not None:
        return _named_host(context, host, ssh_config, form)
    devices, name = _own_devices(context)
    within = robot_namespace(context, namespace)
    opener = partial(devices.open_host, name, resources=context.resources, seed=context.run_seed, namespace=within)
    return context.resources.open(link_key("host", namespace), opener)


def _named_host(context: RobotRunnerContext, host: str, config: Path | None, form: str | None) -> HostLink:
    clock = machine_clock(context)

    def opener() -> HostLink:
        if host == LOCAL:
            from robot_runner.measuring.local_host import LocalHost  # noqa: PLC0415  # only where it is asked for

            return LocalHost(clock)

        return SshHost(host, clock, config=config, form=form)

    return context.resources.open(f"computer {host} {config} {form}", opener)


def _own_devices(context: RobotRunnerContext) -> tuple[BringsDevices, RobotName]:
    """Return the kind of link that opens a simulated robot's own devices, and the robot's name."""
    kind, name = run_robot(context)
    if isinstance(kind, BringsDevices):
        return kind, name
    problem = f"robot is {context.robot!r}, which is not simulated, and what measures it is not named"
    raise LinkError(problem, where="robot", fix=_NAME_IT)
