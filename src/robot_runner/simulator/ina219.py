"""The power meter: an INA219 on the battery's lead, and the microcontroller that sends its registers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from robot_runner.simulator.clock import STEP_NS
from robot_runner.simulator.ina219_frames import HELLO_SIZE, SAMPLE_SIZE, hello_frame, sample_frames

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    import numpy.typing as npt

    from robot_runner.simulator.clock import SimulatedClock
    from robot_runner.simulator.parameters import Turtlebot3Parameters
    from robot_runner.simulator.supply import PowerSupply

__all__ = ["CONFIGURATION", "Arrival", "Ina219Meter"]

#: The sensor's configuration register: 16 V, ±320 mV, two conversions averaged, continuous (SBOS448G, table 4).
CONFIGURATION = 0x1CCF

_SHUNT_LSB = 10e-6  # V (SBOS448G, shunt voltage register)
_SHUNT_LIMIT = 32000  # PGA ÷8: ±320 mV
_BUS_LSB = 4e-3  # V (SBOS448G, bus voltage register)
_BUS_LIMIT = 4000  # 16 V range
_CONVERSION_READY = 0b10

_SECOND_NS = 1_000_000_000
_BYTE_NS = 10 * _SECOND_NS // 115200  # 8 data bits, a start and a stop bit
_USB_PACKET = 64  # a USB adapter hands over at most so many bytes at once
_HELLO_REQUEST = b"?"
_SEQUENCES = 2**16  # hellos go by the number as it is sent, which wraps


@dataclass(frozen=True, slots=True)
class Arrival:
    """Bytes that came out of the line together, and when the last of them did (ns)."""

    time_ns: int
    data: bytes


class Ina219Meter:
    """The device, switched on when it is made: opening the port of an Arduino resets it.

    Args:
        clock: the simulation's clock.
        supply: the currents and voltages that the sensor sees.
        reach: brings `supply` up to a step of the simulation's grid.
        noise: the noise of the sensor's converters.
    """

    def __init__(
        self,
        parameters: Turtlebot3Parameters,
        clock: SimulatedClock,
        supply: PowerSupply,
        *,
        reach: Callable[[int], None],
        noise: np.random.Generator,
    ) -> None:
        self._parameters = parameters
        self._clock = clock
        self._supply = supply
        self._reach = reach
        self._noise = noise
        self._rate = parameters.meter_rate
        self._switched_on_ns = clock.now_ns
        self._next = 0  # the number of the next sample
        self._hello_before = 0  # the sample before which a hello is due beyond the regular ones

    def write(self, data: bytes) -> None:
        """Take bytes from the host: a `?` asks for a hello before the next sample."""
        if _HELLO_REQUEST in data:
            on_for_ns = self._clock.now_ns - self._switched_on_ns
            self._hello_before = on_for_ns * self._rate // _SECOND_NS + 1

    def arrived(self) -> list[Arrival]:
        """Return what has come out of the line by now and was not returned before, oldest first."""
        count = self._count_arrived()
        if count == 0:
            return []
        numbers = np.arange(self._next, self._next + count)
        frames, ends = self._stream(numbers)
        self._next += count
        return list(_packets(frames, ends))

    def _count_arrived(self) -> int:
        # A sample counts once its frame, and a hello before it, are through the line.
        line_ns = (SAMPLE_SIZE + HELLO_SIZE) * _BYTE_NS
        since_ns = self._clock.now_ns - self._switched_on_ns - line_ns
        due = since_ns * self._rate // _SECOND_NS + 1 if since_ns >= 0 else 0
        return max(0, due - self._next)

    def _stream(self, numbers: npt.NDArray[np.int64]) -> tuple[bytes, list[tuple[int, int]]]:
        """Return the bytes of these samples and of the hellos between them, with (end, arrival in ns) of each frame."""
        due_ns = numbers * _SECOND_NS // self._rate
        samples = self._sample(numbers, due_ns)
        pieces: list[bytes] = []
        ends: list[tuple[int, int]] = []
        position = 0
        for index, number in enumerate(numbers.tolist()):
            sent_ns = self._switched_on_ns + int(due_ns[index])
            if number % _SEQUENCES % self._rate == 0 or number == self._hello_before:
                pieces.append(self._hello(number, int(due_ns[index])))
                sent_ns += HELLO_SIZE * _BYTE_NS
                position += HELLO_SIZE
                ends.append((position, sent_ns))
            pieces.append(samples[index * SAMPLE_SIZE : (index + 1) * SAMPLE_SIZE])
            position += SAMPLE_SIZE
            ends.append((position, sent_ns + SAMPLE_SIZE * _BYTE_NS))
        return b"".join(pieces), ends

    def _sample(self, numbers: npt.NDArray[np.int64], due_ns: npt.NDArray[np.int64]) -> bytes:
        steps = (self._switched_on_ns + due_ns) // STEP_NS
        self._reach(int(steps[-1]))
        noise = self._noise.standard_normal((len(numbers), 2))
        shunt = (
            self._supply.current[steps] * self._parameters.meter_shunt
            + self._parameters.meter_shunt_deviation * noise[:, 0]
        )
        bus = self._supply.bus_voltage(steps) + self._parameters.meter_bus_deviation * noise[:, 1]
        return sample_frames(
            sequences=numbers,
            times=due_ns // 1000,
            shunts=_register(shunt / _SHUNT_LSB, -_SHUNT_LIMIT, _SHUNT_LIMIT),
            buses=(_register(bus / _BUS_LSB, 0, _BUS_LIMIT) << 3) | _CONVERSION_READY,
        )

    def _hello(self, number: int, due_ns: int) -> bytes:
        return hello_frame(
            sequence=number,
            time=due_ns // 1000,
            rate=self._rate,
            shunt=round(self._parameters.meter_shunt * 1e6),
            configuration=CONFIGURATION,
        )


def _register(values: npt.NDArray[np.float64], low: int, high: int) -> npt.NDArray[np.int64]:
    return np.clip(np.rint(values), low, high).astype(np.int64)


def _packets(data: bytes, ends: list[tuple[int, int]]) -> Iterator[Arrival]:
    frame = 0
    for start in range(0, len(data), _USB_PACKET):
        end = min(start + _USB_PACKET, len(data))
        while ends[frame][0] < end:
            frame += 1
        yield Arrival(ends[frame][1], data[start:end])
