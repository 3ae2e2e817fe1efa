"""What stands in the way of the INA219, found before anything is executed."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from robot_runner.errors import Finding, LinkError
from robot_runner.events.clock import SystemClock
from robot_runner.links.connect import SIMULATED, is_simulated
from robot_runner.links.host import LOCAL
from robot_runner.links.serial_port import found_ports, port_problem
from robot_runner.links.ssh_command import ssh_findings
from robot_runner.plugins.profilers.ina219.sysfs import find_sensor

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["Way", "way_findings"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Way:
    """Which sensor a profiler reads, and how: by one of the three that is not None, else the simulated robot's.

    Attributes:
        port: the serial port of a meter.
        card: the file copied from a meter's card.
        sysfs: the folder of a kernel driver, or `auto`.
        host: the computer that has the driver.
        ssh_config: a file to take the place of the user's ssh config.
        namespace: whose simulated meter it is.

    Example:
        >>> Way(port="/dev/ttyUSB0").clashes_with(Way(port="/dev/ttyUSB0", namespace="/alice"))
        True
    """

    port: str | None = None
    card: str | None = None
    sysfs: str | None = None
    host: str = LOCAL
    ssh_config: Path | None = None
    namespace: str = ""

    @property
    def given(self) -> dict[str, str]:
        """The parameters that name a real sensor."""
        named = {"port": self.port, "card": self.card, "sysfs": self.sysfs}
        return {name: value for name, value in named.items() if value is not None}

    def clashes_with(self, other: Way) -> bool:
        """Whether both would take what one line, or one file, brings."""
        return self.sysfs is None and self._source == other._source

    @property
    def _source(self) -> tuple[str, str]:
        if self.port is not None:
            return "port", os.path.realpath(self.port)  # links such as those of /dev/serial/by-id lead to one device
        if self.card is not None:
            return "card", os.path.realpath(self.card)
        if self.sysfs is not None:
            return f"sysfs {self.host}", self.sysfs
        return "the meter of the simulated robot", self.namespace.strip("/")


def way_findings(where: str, way: Way, robot: str | None) -> Iterator[Finding]:
    """Yield what stands in the way of reading this sensor; nothing is opened by asking.

    Args:
        where: the plugin.
        way: to the sensor.
        robot: how the robot is reached, or None.
    """
    if is_simulated(robot):
        for name, value in way.given.items():
            problem = f"{name} is {value!r}, and a simulated robot has a power meter of its own"
            yield Finding.error(where, problem, f"Leave {name} out, or execute it on a real robot.")
    elif not way.given:
        yield Finding.error(where, "nothing says where the power meter is", _fix_without_way())
    elif way.port is not None:
        yield from _found(where, port_problem(way.port))
    elif way.card is not None:
        yield from _card_findings(where, Path(way.card).expanduser())
    elif way.sysfs is not None and way.host != LOCAL:
        yield from ssh_findings(where, way.host, config=way.ssh_config)
    elif way.sysfs is not None:
        yield from _sysfs_findings(where, way.sysfs)


def _fix_without_way() -> str:
    ports = found_ports()
    port = ports[-1] if ports else "/dev/ttyUSB0"
    return f"Name its serial port, as in Ina219(port={port!r}). Or: --set robot={SIMULATED}."


def _found(where: str, problem: LinkError | None) -> list[Finding]:
    return [] if problem is None else [replace(problem.as_finding(), where=where)]


def _card_findings(where: str, card: Path) -> list[Finding]:
    if card.is_dir():
        return [Finding.error(where, f"card is {str(card)!r}, a folder", "Name the file, such as INA219.BIN in it.")]
    return []


def _sysfs_findings(where: str, folder: str) -> list[Finding]:
    from robot_runner.links.local_host import LocalHost  # noqa: PLC0415  # only where it is asked for

    host = LocalHost(SystemClock())
    try:
        find_sensor(host, folder, where=where)
    except LinkError as error:
        return [error.as_finding()]
    finally:
        host.close()
    return []
