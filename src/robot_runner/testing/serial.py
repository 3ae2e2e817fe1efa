"""A serial line whose bytes a test writes beforehand."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robot_runner.errors import LinkError

if TYPE_CHECKING:
    from collections.abc import Iterable

    from robot_runner.events.clock import Clock
    from robot_runner.links.serial import Chunk

__all__ = ["FakeSerialLine"]


class FakeSerialLine:
    """A `SerialLine` on which scripted bytes arrive when their time has come.

    Args:
        clock: the run's.
        chunks: what arrives; the times are those of the clock.
        lost_at: when the line is lost, s; once what arrived before was taken it raises.
        is_simulated: whether it says that a simulated device is at its other end.

    Attributes:
        written: the bytes that were sent to the device.
        is_closed: whether it was closed.

    Example:
        >>> from robot_runner.links.serial import Chunk
        >>> from robot_runner.testing import FakeClock, FakeSerialLine
        >>> clock = FakeClock()
        >>> line = FakeSerialLine(clock, [Chunk(1.0, b"hello")])
        >>> line.drain()
        []
        >>> clock.sleep(1.0)
        >>> line.drain()
        [Chunk(received_at=1.0, data=b'hello')]
    """

    def __init__(
        self,
        clock: Clock,
        chunks: Iterable[Chunk] = (),
        *,
        lost_at: float | None = None,
        is_simulated: bool = False,
    ) -> None:
        self.written = bytearray()
        self.is_closed = False
        self._clock = clock
        self._coming = sorted(chunks, key=lambda chunk: chunk.received_at)
        self._lost_at = lost_at
        self._is_simulated = is_simulated

    @property
    def is_simulated(self) -> bool:
        """What it was made with."""
        return self._is_simulated

    def drain(self) -> list[Chunk]:
        """Return what has arrived since the last call.

        Raises:
            LinkError: the line was closed, or lost and drained.
        """
        now = self._clock.now() if self._lost_at is None else min(self._clock.now(), self._lost_at)
        arrived = [chunk for chunk in self._coming if chunk.received_at <= now]
        if self.is_closed or not arrived:
            self._check()
        self._coming = self._coming[len(arrived) :]
        return arrived

    def write(self, data: bytes) -> None:
        """Note what is sent.

        Raises:
            LinkError: the line was closed or lost.
        """
        self._check()
        self.written += data

    def close(self) -> None:
        """Close the line; closing twice does nothing."""
        self.is_closed = True

    def _check(self) -> None:
        is_lost = self._lost_at is not None and self._clock.now() >= self._lost_at
        if self.is_closed or is_lost:
            problem = "the line was closed" if self.is_closed else "the device was unplugged"
            raise LinkError(problem, where="FakeSerialLine", fix="Plug it in again.")
