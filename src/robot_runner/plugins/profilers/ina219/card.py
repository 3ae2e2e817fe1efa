"""Recordings that were copied from the meter's SD card (`docs/ina219-protocol.md`, "On a card")."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from robot_runner.errors import LinkError
from robot_runner.links.serial import Chunk
from robot_runner.plugins.profilers.ina219.frames import FrameDecoder, Hello
from robot_runner.plugins.profilers.ina219.registers import evaluate_registers
from robot_runner.plugins.profilers.ina219.stream import SampleStream
from robot_runner.plugins.sampling.window import Window

if TYPE_CHECKING:
    from array import array
    from collections.abc import Iterator

    from robot_runner.plugins.profilers.ina219.evaluation import Evaluation

__all__ = ["CardRecording", "read_card"]

_BLOCK = 512
_HELLO_BEGINS, _HELLO_SIZE = b"\xa5\x5a\x12\x0c", 20
#: The device says its first hello within this time after it was switched on, µs.
_BEGINNING = 1_000_000


@dataclass(frozen=True, slots=True)
class CardRecording:
    """What the meter recorded from one switching on to the next.

    Attributes:
        stream: the samples.

    Example:
        >>> import tempfile
        >>> from pathlib import Path
        >>> file = Path(tempfile.mkdtemp()) / "INA219.BIN"
        >>> hello = "a55a 120c 0000 00000000 c800 a0860100 cf1c 0b0d"
        >>> _ = file.write_bytes(bytes.fromhex(hello + "a55a 1108 0100 88130000 f217 e260 15df").ljust(512, bytes(1)))
        >>> [len(recording.times) for recording in read_card(file)]
        [1]
    """

    stream: SampleStream

    @property
    def times(self) -> array[float]:
        """When each sample was taken, s since the first one, by the device's clock."""
        return self.stream.device_seconds

    @property
    def marked(self) -> tuple[Window, ...]:
        """The spans of time in which the mark was on; one that never ended reaches to the last sample."""
        return tuple(self._marked())

    def evaluate(
        self, window: Window | None = None, *, shunt_ohm: float | None = None, rate_hz: float | None = None
    ) -> Evaluation:
        """Return energy, mean power and quality of a span of time, of the whole recording if left out.

        Raises:
            LinkError: the recording has no samples.
        """
        if not len(self.stream):
            raise LinkError("the recording has no samples", where="INA219 card", fix="Look at the sensor's wires.")
        whole = window or Window(self.times[0], self.times[-1])
        return evaluate_registers(self.stream, self.times, whole, shunt_ohm=shunt_ohm, rate_hz=rate_hz)

    def _marked(self) -> Iterator[Window]:
        begun: float | None = None
        for mark in self.stream.marks:
            if mark.is_on and begun is None:
                begun = mark.seconds
            elif not mark.is_on and begun is not None:
                yield Window(begun, mark.seconds)
                begun = None
        if begun is not None and len(self.stream):
            yield Window(begun, max(begun, self.times[-1]))


def read_card(path: Path | str) -> list[CardRecording]:
    """Return the recordings of a file copied from the meter's card, oldest first.

    Raises:
        LinkError: the file cannot be read, or holds no recording.
    """
    file = Path(path)
    try:
        data = file.read_bytes()
    except OSError as error:
        problem = f"it cannot be read: {error.strerror or error}"
        raise LinkError(problem, where=str(file), fix="Name the file copied from the card.") from error
    found = [CardRecording(stream) for stream in map(_stream_of, _recordings(data)) if len(stream) or stream.hello]
    if not found:
        fix = "Copy INA219.BIN again, and see that the lamp at D5 was lit."
        raise LinkError("it holds no recording", where=str(file), fix=fix)
    return found


def _recordings(data: bytes) -> Iterator[bytes]:
    """Cut the file at the blocks where the device was switched on; behind the last one it is all zeros."""
    begins = [at for at in range(0, len(data), _BLOCK) if _is_beginning(data[at : at + _BLOCK])]
    begins = begins if begins and begins[0] == 0 else [0, *begins]
    for begin, end in zip(begins, [*begins[1:], len(data)], strict=True):
        yield data[begin:end]


def _is_beginning(block: bytes) -> bool:
    if not block.startswith(_HELLO_BEGINS):
        return False
    frames = FrameDecoder().feed(block[:_HELLO_SIZE])
    return any(isinstance(one, Hello) and one.next_sequence == 0 and one.microseconds < _BEGINNING for one in frames)


def _stream_of(data: bytes) -> SampleStream:
    stream = SampleStream(has_arrivals=False)
    stream.take([Chunk(0.0, data)])
    stream.finish()
    return stream
