"""Experiment Runner's WattsUpPro: reads the meter for some time, and writes a line for each record."""

from __future__ import annotations

from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

from robot_runner.legacy.session import current_run
from robot_runner.measuring.devices import open_serial_line
from robot_runner.measuring.serial_line import port_problem
from robot_runner.meters.watts_up_pro import Recording

#: Source: Electronic Educational Devices, Watts up? PRO communications protocol (2009).
_LOG_TO_LINE = "#L,W,3,{mode},,{interval:d};"


class WattsUpPro:
    """A Watts up? PRO on a serial port."""

    EXTERNAL_MODE = "E"
    INTERNAL_MODE = "I"
    TCPIP_MODE = "T"
    FULLHANDLING = 2

    def __init__(self, port: str | None = None, interval: float = 1.0) -> None:
        """Check the port.

        Raises:
            LinkError: the port does not exist, or cannot be opened.
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
        """Make the meter log to the serial line (`E`) or to its internal memory (`I`)."""
        line = self._recording().line
        line.write(_LOG_TO_LINE.format(mode=runmode, interval=int(self.interval)).encode())
        if runmode == self.INTERNAL_MODE:
            line.write(f"#O,W,1,{self.FULLHANDLING};".encode())

    def log(self, timeout: float, logfile: str | Path | None = None) -> None:
        """Read for `timeout` seconds; each line of the log has time, second, W, V and A."""
        self.logfile = logfile
        self.mode(self.EXTERNAL_MODE)
        recording, clock = self._recording(), current_run("WattsUpPro").clock
        begun, start = datetime.now(), clock.now()  # noqa: DTZ005 - its format
        recording.wait(lambda: False, clock, timeout)
        lines = []
        meanwhile = [each for each in recording.samples if each.time >= start]  # the recording may be older
        for place, sample in enumerate(meanwhile):
            second = place * float(self.interval)
            self.t.append(second)
            self.power.append(sample.watts)
            self.potential.append(sample.volts)
            self.current.append(sample.amperes)
            at = begun + timedelta(seconds=sample.time - start)
            lines.append(f"{at} {second:.0f} {sample.watts:3.1f} {sample.volts:3.1f} {sample.amperes:5.3f}\n")
        if logfile is not None:
            Path(logfile).write_text("".join(lines), encoding="ascii")

    def _recording(self) -> Recording:
        return Recording(open_serial_line(current_run("WattsUpPro"), self.port))
