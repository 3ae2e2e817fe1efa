"""What a serial line can do, whether a device or a simulated one is at its other end."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

__all__ = ["SIMULATED_PORT", "Chunk", "SerialLine"]

#: The name of the link to a port at whose other end is a simulated meter; it tells who opens it so.
SIMULATED_PORT = "simulated-ina219"


@dataclass(frozen=True, slots=True)
class Chunk:
    """Bytes that came together, and when: seconds on the run's clock."""

    received_at: float
    data: bytes


@runtime_checkable
class SerialLine(Protocol):
    """A serial line that keeps what arrives until it is drained, so that no sample is lost to a slow reader."""

    @property
    def is_simulated(self) -> bool:
        """Whether a simulated device is at the other end."""
        ...

    def drain(self) -> list[Chunk]:
        """Return, oldest first, everything that arrived since the last call, without waiting.

        Raises:
            LinkError: the line was lost (a device that was unplugged), and what arrived before was returned.
        """
        ...

    def write(self, data: bytes) -> None:
        """Send bytes to the device.

        Raises:
            LinkError: the line was lost.
        """
        ...

    def close(self) -> None:
        """Close the line; closing twice does nothing."""
        ...
