"""A serial line to a real device, through pyserial."""

from __future__ import annotations

import errno
import os
import stat
import threading
from collections import deque
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple, Protocol, runtime_checkable

from robot_runner.core.errors import LinkError, did_you_mean
from robot_runner.core.events.context import Clock

#: The name of a link to the port of a simulated meter: by it the meter is known to be simulated.
SIMULATED_PORT = "simulated-ina219"


class Chunk(NamedTuple):
    """Bytes that arrived together, and when, s on the run's clock (a tuple, as a run has 19,000 of them)."""

    received_at: float
    data: bytes


@runtime_checkable
class SerialLine(Protocol):
    """A serial line that keeps what arrives until it is drained, so that no sample is lost to a slow reader."""

    @property
    def is_simulated(self) -> bool:
        """Whether a simulated device is at the other end."""

    def drain(self) -> list[Chunk]:
        """Return, oldest first, everything that arrived since the last call, without waiting.

        Raises:
            LinkError: the line was lost (a device that was unplugged), and what arrived before was returned.
        """

    def write(self, data: bytes) -> None:
        """Send bytes to the device.

        Raises:
            LinkError: the line was lost.
        """

    def close(self) -> None:
        """Close the line; closing twice does nothing."""


DEFAULT_BAUD = 115200

#: How long the reader waits for a byte before it checks whether to stop, s.
_READ_TIMEOUT = 0.2
#: How long sending may take, s; a `?` takes 0.1 ms.
_WRITE_TIMEOUT = 1.0
#: How long the reader may take to end once the port was closed, s.
_PATIENCE = 2.0
#: What pyserial calls a port that is not a device file but something on the network, such as `rfc2217://host:4000`.
_URL = "://"

_INSTALL = "Install it: pip install 'robot-runner[serial]'."
_PERMIT = "Join the group that owns it (sudo usermod -aG dialout $USER on Debian), then log in again."
_SHARE = "End the other program that has it open (a serial monitor, a second experiment)."


def found_ports() -> list[str]:
    """Return the serial ports of this machine, and links to them by name; nothing where pyserial is not installed."""
    try:
        listing = import_module("serial.tools.list_ports")
    except ModuleNotFoundError:
        return []
    return sorted(port.device for port in listing.comports(include_links=True))


def port_problem(port: str) -> LinkError | None:
    """Return what prevents opening this port, or None; the port is not opened for that.

    Opening would reset an Arduino. For a port on the network (a URL of pyserial's) only pyserial itself is checked.

    Example:
        >>> port_problem("/dev/no-such-port").problem
        "there is no serial port '/dev/no-such-port'"
    """
    if _URL not in port and not Path(port).exists():
        return LinkError(f"there is no serial port {port!r}", where=f"serial port {port}", fix=_choice(port))
    try:
        import_module("serial")
    except ModuleNotFoundError:
        return LinkError("pyserial cannot be imported", where=f"serial port {port}", fix=_INSTALL)
    if _URL in port:
        return None
    if not stat.S_ISCHR(Path(port).stat().st_mode):
        return LinkError(f"{port!r} is not a serial port", where=f"serial port {port}", fix=_choice(port))
    if not os.access(port, os.R_OK | os.W_OK):
        return LinkError("the port may not be opened by this user", where=f"serial port {port}", fix=_PERMIT)
    return None


class SerialPort:
    """A serial line that is read by a thread of the run's process, which stamps what arrives on the run's clock.

    It is 8N1 without flow control, and opened exclusively.

    Args:
        port: a device file such as `/dev/ttyUSB0`, or a URL of pyserial's such as `rfc2217://robot.local:4000`.
        clock: the run's.
        baud: bits a second.

    Raises:
        LinkError: there is no such port, it may not be opened, another program has it, or pyserial is not installed.

    Example:
        >>> from robot_runner.core.events.context import SystemClock
        >>> line = SerialPort("loop://", SystemClock())
        >>> line.write(b"?")
        >>> line.close()
    """

    def __init__(self, port: str, clock: Clock, *, baud: int = DEFAULT_BAUD) -> None:
        self._port = port
        self._clock = clock
        self._chunks: deque[Chunk] = deque()
        self._failure: Exception | None = None
        self._is_closed = False
        self._device = _open(port, baud)
        self._reader = threading.Thread(target=self._keep_reading, name=f"reader of {port}", daemon=True)
        self._reader.start()

    @property
    def is_simulated(self) -> bool:
        """Whether it is the port of a simulated meter, by its name."""
        return Path(self._port).name == SIMULATED_PORT

    def drain(self) -> list[Chunk]:
        """Return, oldest first, everything that arrived since the last call, without waiting.

        Raises:
            LinkError: the line was closed, or it was lost and everything that arrived before was returned.
        """
        if self._is_closed:
            raise LinkError("the line was closed", where=self._where, fix="Drain it before it is closed.")
        failure = self._failure  # before the queue is read: then all that arrived before it is in the queue
        chunks = [self._chunks.popleft() for _ in range(len(self._chunks))]
        if failure is not None and not chunks:
            raise self._lost(failure)
        return chunks

    def write(self, data: bytes) -> None:
        """Send bytes to the device; a `LinkError` says that the line was closed or lost."""
        if self._is_closed:
            raise LinkError("the line was closed", where=self._where, fix="Write to it before it is closed.")
        try:
            self._device.write(data)
        except OSError as error:
            raise self._lost(error) from error

    def close(self) -> None:
        """Close the line; closing twice does nothing."""
        if self._is_closed:
            return
        self._is_closed = True
        cancel = getattr(self._device, "cancel_read", None)  # some kinds of port do not have it
        if cancel is not None:
            cancel()
        self._reader.join(_PATIENCE)
        self._device.close()

    @property
    def _where(self) -> str:
        return f"serial port {self._port}"

    def _keep_reading(self) -> None:
        try:
            while not self._is_closed:
                data = self._device.read(1)
                if data:
                    data += self._device.read(self._device.in_waiting)
                    self._chunks.append(Chunk(self._clock.now(), data))
        except (OSError, TypeError) as error:  # TypeError: pyserial's way of saying that the port was closed under it
            self._failure = error

    def _lost(self, failure: Exception) -> LinkError:
        there = _URL in self._port or Path(self._port).exists()
        problem = f"{self._port} was lost" if there else f"{self._port} is gone: its device was unplugged"
        lost = LinkError(problem, where=self._where, fix="Look at the cable, plug the device in, then repeat the run.")
        lost.__cause__ = failure
        return lost


def _open(port: str, baud: int) -> Any:
    problem = port_problem(port)
    if problem is not None:
        raise problem
    serial = import_module("serial")
    only_mine = {} if _URL in port else {"exclusive": True}
    try:
        return serial.serial_for_url(
            port, baudrate=baud, timeout=_READ_TIMEOUT, write_timeout=_WRITE_TIMEOUT, **only_mine
        )
    except (OSError, ValueError) as error:
        raise _refusal(port, error) from error


def _refusal(port: str, error: Exception) -> LinkError:
    where, number = f"serial port {port}", getattr(error, "errno", None)
    if number in {errno.EACCES, errno.EPERM}:
        return LinkError("the port may not be opened by this user", where=where, fix=_PERMIT)
    if number in {errno.EBUSY, errno.EAGAIN} or "exclusively lock" in str(error):
        return LinkError("another program has it open", where=where, fix=_SHARE)
    return LinkError(f"the port cannot be opened: {error}", where=where, fix=_choice(port))


def _choice(port: str) -> str:
    ports = found_ports()
    return did_you_mean(port, ports) if ports else "Plug the device in: no serial port was found on this machine."
