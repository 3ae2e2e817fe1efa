"""Experiment Runner's WattsUpPro: reads the meter for some seconds, and writes a line for each record."""

from __future__ import annotations

import time
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robot_runner.core.errors import LinkError
from robot_runner.core.links.connect import open_serial_line
from robot_runner.core.links.serial_line import port_problem
from robot_runner.legacy.session import active_context

if TYPE_CHECKING:
    from collections.abc import Iterator

    from robot_runner.core.links.serial_line import SerialLine

__all__ = ["WattsUpPro"]

#: Source: Electronic Educational Devices, Watts up? PRO communications protocol (2009).
_LOG_TO_LINE = "#L,W,3,{mode},,{interval:d};"
_RECORD = "#d"
_POLL_S = 0.05


class WattsUpPro:
    """A Watts up? PRO on a serial port."""

    EXTERNAL_MODE = "E"
    INTERNAL_MODE = "I"
    TCPIP_MODE = "T"
    FULLHANDLING = 2

    def __init__(self, port: str | None = None, interval: float = 1.0) -> None:
        """Look for the port.

        Raises:
            LinkError: there is no such port, or it cannot be opened.
        """
        self.port = port or "/dev/ttyUSB0"
        problem = port_problem(self.port)
        if problem is not None:
            raise problem
        self.interval = interval
        self.logfile: Any = None
        self.t: list[float] = []
        self.power: list[float] = []
        self.potential: list[float] = []
        self.current: list[float] = []

    def mode(self, runmode: str) -> None:
        """Have the meter log to the line (`E`) or into itself (`I`)."""
        line = self._line()
        line.write(_LOG_TO_LINE.format(mode=runmode, interval=int(self.interval)).encode())
        if runmode == self.INTERNAL_MODE:
            line.write(f"#O,W,1,{self.FULLHANDLING};".encode())

    def log(self, timeout: float, logfile: str | Path | None = None) -> None:
        """Read for `timeout` seconds; a line of the log holds time, second, W, V and A."""
        self.logfile = logfile
        self.mode(self.EXTERNAL_MODE)
        lines = []
        second = 0.0
        for watts, volts, amperes in self._records(timeout):
            self.t.append(second)
            self.power.append(watts)
            self.potential.append(volts)
            self.current.append(amperes)
            lines.append(f"{datetime.now()} {second:.0f} {watts:3.1f} {volts:3.1f} {amperes:5.3f}\n")  # noqa: DTZ005 - its format
            second += self.interval
        if logfile is not None:
            Path(logfile).write_text("".join(lines), encoding="ascii")

    def _records(self, seconds: float) -> Iterator[tuple[float, float, float]]:
        line, rest = self._line(), ""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            for chunk in line.drain():
                *records, rest = (rest + chunk.data.decode("ascii", errors="replace")).split(";")
                for record in records:
                    fields = record.strip().split(",")
                    if fields[0] == _RECORD and all(field.strip().isdigit() for field in fields[3:6]):
                        yield int(fields[3]) / 10, int(fields[4]) / 10, int(fields[5]) / 1000
            time.sleep(_POLL_S)

    def _line(self) -> SerialLine:
        context = active_context()
        if context is None:
            raise LinkError(
                "the meter can be read only while a run is executed",
                where="WattsUpPro",
                fix="Read it in start_measurement or interact.",
            )
        return open_serial_line(context, self.port)
