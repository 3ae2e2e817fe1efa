"""The meter that records on an SD card, whose file with the samples of a run is copied after the mission."""

from __future__ import annotations

from array import array
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from robot_runner.core.errors import LinkError
from robot_runner.core.events.context import Clock
from robot_runner.core.events.window import Window
from robot_runner.measuring.serial_line import Chunk
from robot_runner.meters.ina219.frames import FIRST_SENSOR, FrameDecoder, Hello
from robot_runner.meters.ina219.registers import Evaluation, evaluate_registers
from robot_runner.meters.ina219.sample_stream import SampleStream

_BLOCK = 512
_HELLO_BEGINS, _HELLO_SIZE = b"\xa5\x5a\x12\x0c", 20
#: The device writes its first hello within this time after it was switched on, µs.
_BEGINNING = 1_000_000


@dataclass(frozen=True, slots=True)
class CardRecording:
    """The recording of the meter from one power-on to the next.

    Attributes:
        stream: the samples.

    Example:
        >>> from pathlib import Path
        >>> from robot_runner.plugins.profilers import read_card
        >>> from tempfile import TemporaryDirectory
        >>> hello = "a55a 120c 0000 00000000 c800 a0860100 cf1c 0b0d"
        >>> data = bytes.fromhex(hello + "a55a 1108 0100 88130000 f217 e260 15df").ljust(512, bytes(1))
        >>> with TemporaryDirectory() as folder:
        ...     file = Path(folder) / "INA219.BIN"
        ...     _ = file.write_bytes(data)
        ...     [len(recording.times) for recording in read_card(file)]
        [1]
    """

    stream: SampleStream

    @property
    def times(self) -> array[float]:
        """The time of each sample, s since the first stamp, by the device's clock."""
        lag = self.stream.lag
        return array("d", (stamp - lag for stamp in self.stream.device_seconds)) if lag else self.stream.device_seconds

    @property
    def marked(self) -> tuple[Window, ...]:
        """The time spans in which the mark was on; one that never ended reaches to the last sample."""
        spans: list[Window] = []
        begun: float | None = None
        for mark in self.stream.marks:
            if mark.is_on and begun is None:
                begun = mark.seconds
            elif not mark.is_on and begun is not None:
                spans.append(Window(begun, mark.seconds))
                begun = None
        if begun is not None and len(self.stream):
            spans.append(Window(begun, max(begun, self.times[-1])))
        return tuple(spans)

    def evaluate(
        self, window: Window | None = None, *, shunt_ohm: float | None = None, rate_hz: float | None = None
    ) -> Evaluation:
        """Return energy, mean power and quality of a time span; None takes the whole recording.

        Raises:
            LinkError: the recording has no samples.
        """
        if not len(self.stream):
            raise LinkError("the recording has no samples", where="INA219 card", fix="Look at the sensor's wires.")
        whole = window or Window(self.times[0], self.times[-1])
        return evaluate_registers(self.stream, self.times, whole, shunt_ohm=shunt_ohm, rate_hz=rate_hz)


def read_card(path: Path | str, *, address: int = FIRST_SENSOR) -> list[CardRecording]:
    """Return the recordings of a file copied from the meter's card, oldest first.

    Args:
        path: of the file.
        address: of the sensor on the meter's bus, if it has several; by default the first one.

    Raises:
        LinkError: the file cannot be read, or contains no recording.
    """
    file = Path(path)
    try:
        data = file.read_bytes()
    except OSError as error:
        problem = f"the recording cannot be read: {error.strerror or error}"
        raise LinkError(problem, where=str(file), fix="Name the file copied from the card.") from error
    streams = [_stream_of(recorded, address) for recorded in _recordings(data)]
    found = [CardRecording(stream) for stream in streams if len(stream) or stream.hello]
    if not found:
        fix = "Copy INA219.BIN again, and see that the lamp at D5 was lit."
        raise LinkError("the file holds no recording", where=str(file), fix=fix)
    return found


def _recordings(data: bytes) -> Iterator[bytes]:
    """Yield the recordings, each from the block of a power-on; the end of the file is all zeros."""
    begins = [at for at in range(0, len(data), _BLOCK) if _is_beginning(data[at : at + _BLOCK])]
    begins = begins if begins and begins[0] == 0 else [0, *begins]
    for begin, end in zip(begins, [*begins[1:], len(data)], strict=True):
        yield data[begin:end]


def _is_beginning(block: bytes) -> bool:
    if not block.startswith(_HELLO_BEGINS):
        return False
    frames = FrameDecoder().feed(block[:_HELLO_SIZE])
    return any(isinstance(one, Hello) and one.next_sequence == 0 and one.microseconds < _BEGINNING for one in frames)


def _stream_of(data: bytes, address: int) -> SampleStream:
    stream = SampleStream(has_arrivals=False, address=address)
    stream.take(Chunk(0.0, data[at : at + _BLOCK]) for at in range(0, len(data), _BLOCK))
    stream.finish()
    return stream


#: A file that is unchanged for this long has been copied, s.
_POLL = 1.0
#: How long copying may go on after `patience`, s: a file of 64 MB takes some seconds.
_LONGEST_COPY = 60.0
#: The marked span may differ from the run's measured time by this share without a doubt, and by this many s, as a hand
#: or an input pin may be late.
_DIFFERENCE, _REACTION = 0.05, 1.0

_MARK = "Pull the meter's input D4 to ground while the mission lasts, or evaluate the file with read_card."


class CardMeter:
    """Evaluates the newest time span with the mark on, from a file that is new since the beginning of the run.

    Args:
        file: the path of the copy, or of the file on the card in a card reader.
        clock: the run's.
        address: of the sensor on the meter's bus.
        patience: how long to wait for the file, s.
        shunt_ohm: resistance of the shunt, ohm; None takes the device's.
        rate_hz: nominal rate, Hz; None takes the device's.
    """

    has_samples_at_once = False

    def __init__(
        self,
        file: Path | str,
        clock: Clock,
        *,
        address: int = FIRST_SENSOR,
        patience: float = 0.0,
        shunt_ohm: float | None = None,
        rate_hz: float | None = None,
    ) -> None:
        self._file = Path(file).expanduser()
        self._clock = clock
        self._address = address
        self._patience = patience
        self._shunt_ohm = shunt_ohm
        self._rate_hz = rate_hz
        self._before = _state(self._file)
        self._start = clock.now()
        self._window: Window | None = None
        self._found: Evaluation | None = None  # over the marked span

    def begin(self) -> None:
        """Begin the window on the run's clock, which is only compared with that of the mark."""
        self._before = _state(self._file)
        self._start = self._clock.now()

    def end(self) -> None:
        """End the window on the run's clock; a second call does nothing."""
        if self._window is None:
            self._window = Window(self._start, self._clock.now())

    def evaluate(self, window: Window | None, part: Window | None = None) -> Evaluation:
        """Wait for the file and evaluate its newest marked span.

        The span is taken for the window; a part of the window has the same distance from the beginning in both.

        Raises:
            LinkError: the file did not come, contains no recording, or its newest recording has no mark.
        """
        if self._found is None:
            self._wait()
            newest = read_card(self._file, address=self._address)[-1]
            if not newest.marked:
                raise LinkError("the newest recording has no mark", where=str(self._file), fix=_MARK)
            self._found = newest.evaluate(newest.marked[-1], shunt_ohm=self._shunt_ohm, rate_hz=self._rate_hz)
        marked = self._found.window
        evaluation = self._found.over(_moved(part, window, marked)) if part and window else self._found
        details = {**evaluation.details, "clock": "the device's, from the recording's first sample"}
        doubts = (*evaluation.doubts, *self._doubts(marked, window or self._window))
        return replace(evaluation, doubts=doubts, details=details)

    def _wait(self) -> None:
        deadline = self._clock.now() + self._patience
        last = None
        while (state := _state(self._file)) != last or state is None:
            is_new = state not in {None, self._before}
            if self._clock.now() >= deadline + (_LONGEST_COPY if is_new else 0.0):
                late = "the new recording is still being written"
                problem = late if is_new else f"no new recording came within {self._patience:g} s"
                fix = "Copy INA219.BIN from the meter's card to it after each mission, or give card_patience_s more."
                raise LinkError(problem, where=str(self._file), fix=fix)
            last = state if is_new else None
            self._clock.sleep(_POLL)

    def _doubts(self, marked: Window, window: Window | None) -> tuple[str, ...]:
        if window is None:
            return ()
        lasted = window.duration
        if abs(marked.duration - lasted) <= _REACTION + _DIFFERENCE * lasted:
            return ()
        return (f"the mark lasted {marked.duration:.1f} s and the measurement {lasted:.1f} s: is it this run's?",)


def _moved(part: Window, window: Window, marked: Window) -> Window:
    shift = marked.start - window.start
    return Window(min(part.start + shift, marked.end), min(part.end + shift, marked.end))


def _state(file: Path) -> tuple[int, int, int] | None:
    """Return a value that changes when a file is replaced or written; None if there is no file."""
    try:
        found = file.stat()
    except OSError:
        return None
    return found.st_ino, found.st_size, found.st_mtime_ns
