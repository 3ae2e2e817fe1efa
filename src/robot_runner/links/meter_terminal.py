"""The power meter of an embedded robot on a pseudo-terminal, where it is opened as a serial port is."""

from __future__ import annotations

import os
import select
import tempfile
import tty
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from robot_runner.links.serial import SIMULATED_PORT
from robot_runner.links.simulated import SimulatedSerialLine

if TYPE_CHECKING:
    from robot_runner.simulator.simulation import Simulation

__all__ = ["MeterTerminal"]

_READ_SIZE = 4096


class MeterTerminal:
    """A pseudo-terminal behind which the meter is switched on whenever somebody opens it, as an Arduino is reset.

    What nobody reads in time is lost, as on a serial line.

    Args:
        simulation: whose robot's meter it is.
        namespace: of that robot.

    Attributes:
        port: where to open it; its name tells who opens it that the meter is simulated.

    Example:
        >>> from robot_runner.simulator.simulation import Simulation
        >>> terminal = MeterTerminal(Simulation(seed=1))
        >>> terminal.port.name
        'simulated-ina219'
        >>> terminal.close()
    """

    def __init__(self, simulation: Simulation, *, namespace: str = "") -> None:
        self._simulation = simulation
        self._namespace = namespace
        self._line: SimulatedSerialLine | None = None
        self._folder = tempfile.TemporaryDirectory(prefix="robot-runner-")
        self._device, port = os.openpty()
        tty.setraw(port)
        self.port = Path(self._folder.name) / SIMULATED_PORT
        self.port.symlink_to(os.ttyname(port))
        os.close(port)  # from now on the device hears a hang-up while nobody has the port open
        os.set_blocking(self._device, False)
        self._hang_up = select.poll()
        self._hang_up.register(self._device, 0)

    def exchange(self) -> None:
        """Hand over what the meter has sent by now, and hear what was sent to it."""
        if self._hang_up.poll(0):
            self._line = None
            return
        if self._line is None:
            self._line = SimulatedSerialLine(self._simulation, namespace=self._namespace)
        with suppress(OSError):  # there is nothing to read, or it was closed just now
            self._line.write(os.read(self._device, _READ_SIZE))
        with suppress(OSError):  # nobody has read what came before
            for chunk in self._line.drain():
                os.write(self._device, chunk.data)

    def close(self) -> None:
        """Take the port away; closing twice does nothing."""
        if self._device >= 0:
            os.close(self._device)
            self._device = -1
            self._folder.cleanup()
