"""The power meter: an INA219 in the battery's lead, and the microcontroller that sends its registers."""

from __future__ import annotations

import binascii
import struct
from collections.abc import Callable
from itertools import chain

import numpy as np
import numpy.typing as npt

from robot_runner.measuring.serial_line import Chunk
from robot_runner.simulator.simulated_clock import STEP_NS, SimulatedClock
from robot_runner.simulator.supply import PowerSupply
from robot_runner.simulator.turtlebot3_parameters import Floats, Integers, NumberedNoise, Turtlebot3Parameters

SAMPLE_SIZE = 16
HELLO_SIZE = 20

_SYNC = b"\xa5\x5a"
_SAMPLE = 0x11
_HELLO = 0x12
_HEAD_SIZE = 6
_CHECKSUM_SIZE = 2
_CHECKSUM_START = 0xFFFF

_SAMPLE_LAYOUT = np.dtype(
    [
        ("sync", "S2"),
        ("type", "u1"),
        ("length", "u1"),
        ("sequence", "<u2"),
        ("time", "<u4"),
        ("shunt", "<i2"),
        ("bus", "<u2"),
        ("checksum", "<u2"),
    ]
)

# The checksum's table, by its high byte: CRC-16 with polynomial 0x1021, most significant bit first.
_CHECKSUM_STEPS = np.array([binascii.crc_hqx(bytes([high]), 0) for high in range(256)], dtype=np.uint16)


def hello_frame(*, sequence: int, time: int, rate: int, shunt: int, configuration: int) -> bytes:
    """Return a hello frame.

    Args:
        sequence: the number of the next sample; its lower 16 bits are sent.
        time: the device's clock in µs; its lower 32 bits are sent.
        rate: samples a second.
        shunt: the shunt's resistance in µΩ.
        configuration: the sensor's configuration register.

    Example:
        >>> hello_frame(sequence=0, time=0, rate=200, shunt=100_000, configuration=0x1CCF).hex()
        'a55a120c000000000000c800a0860100cf1c0b0d'
    """
    payload = struct.pack("<IHIH", time % 2**32, rate, shunt, configuration)
    checked = struct.pack("<BBH", _HELLO, len(payload), sequence % 2**16) + payload
    return _SYNC + checked + struct.pack("<H", binascii.crc_hqx(checked, _CHECKSUM_START))


def sample_frames(*, sequences: Integers, times: Integers, shunts: Integers, buses: Integers) -> bytes:
    """Return many sample frames, one after the other, `SAMPLE_SIZE` bytes each.

    Args:
        sequences: the samples' numbers; their lower 16 bits are sent.
        times: the device's clock in µs; their lower 32 bits are sent.
        shunts: the shunt voltage register, -32768..32767.
        buses: the bus voltage register, 0..65535.
    """
    frames = np.zeros(len(sequences), dtype=_SAMPLE_LAYOUT)
    frames["sync"] = _SYNC
    frames["type"] = _SAMPLE
    frames["length"] = SAMPLE_SIZE - _HEAD_SIZE - _CHECKSUM_SIZE
    frames["sequence"] = sequences % 2**16
    frames["time"] = times % 2**32
    frames["shunt"] = shunts
    frames["bus"] = buses
    checked = frames.view(np.uint8).reshape(-1, SAMPLE_SIZE)[:, len(_SYNC) : -_CHECKSUM_SIZE]
    frames["checksum"] = _checksums(checked)
    return frames.tobytes()


def _checksums(rows: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint16]:
    checksums = np.full(len(rows), _CHECKSUM_START, dtype=np.uint16)
    for column in rows.T:
        checksums = (checksums << 8) ^ _CHECKSUM_STEPS[(checksums >> 8) ^ column]
    return checksums


#: The sensor's configuration register: 16 V, ±320 mV, two conversions averaged, continuous (SBOS448G, table 4).
CONFIGURATION = 0x1CCF

_SHUNT_LSB = 10e-6  # V (SBOS448G, shunt voltage register)
_SHUNT_LIMIT = 32000  # PGA ÷8: ±320 mV
_BUS_LSB = 4e-3  # V (SBOS448G, bus voltage register)
_BUS_LIMIT = 4000  # 16 V range
_CONVERSION_READY = 0b10

_SECOND_NS = 1_000_000_000
_BYTE_NS = 10 * _SECOND_NS // 115200  # 8 data bits, a start and a stop bit
_HELLO_REQUEST = b"?"
_SEQUENCES = 2**16  # hellos depend on the number as it is sent, which wraps


class Ina219Meter:
    """The device, switched on by its constructor, as opening the port of an Arduino resets it.

    Its sample numbers and its clock begin at 0 then. Samples are taken at points of the simulation's grid, as power is
    known only there, with the noise of their moment: so no sample depends on when the port was opened. `reach` computes
    the supply up to a step of the grid.
    """

    def __init__(
        self,
        parameters: Turtlebot3Parameters,
        clock: SimulatedClock,
        supply: PowerSupply,
        *,
        reach: Callable[[int], None],
        noise: NumberedNoise,
    ) -> None:
        self._parameters = parameters
        self._clock = clock
        self._supply = supply
        self._reach = reach
        self._noise = noise
        self._rate = parameters.meter_rate
        self._first = -(-clock.now_ns * self._rate // _SECOND_NS)  # the first sample from now on
        self._first_ns = self._first * _SECOND_NS // self._rate
        self._next = 0  # the number of the next sample
        self._hello_before = 0  # the sample before which an additional hello is due

    def write(self, data: bytes) -> None:
        """Take bytes from the host: a `?` requests a hello before the next sample."""
        if _HELLO_REQUEST in data:
            self._hello_before = self._clock.now_ns * self._rate // _SECOND_NS + 1 - self._first

    def arrived(self) -> list[Chunk]:
        """Return the chunks that have arrived since the last call, oldest first.

        Bytes without a pause come in one chunk: an adapter such as the CH340 delivers them once the line is silent.
        """
        numbers = np.arange(self._next, self._next + self._count_arrived())
        if not len(numbers):
            return []
        self._next += len(numbers)
        due_ns = (self._first + numbers) * _SECOND_NS // self._rate
        samples = self._sample(numbers, due_ns)
        has_hello = (numbers % _SEQUENCES % self._rate == 0) | (numbers == self._hello_before)
        times = (due_ns + (SAMPLE_SIZE + HELLO_SIZE * has_hello) * _BYTE_NS) / _SECOND_NS
        pieces = chain.from_iterable(struct.iter_unpack(f"{SAMPLE_SIZE}s", samples))
        chunks = list(map(Chunk, times.tolist(), pieces))
        for index in has_hello.nonzero()[0].tolist():
            hello = self._hello(int(numbers[index]), int(due_ns[index]))
            chunks[index] = chunks[index]._replace(data=hello + chunks[index].data)
        return chunks

    def _count_arrived(self) -> int:
        # A sample counts once its frame, and a hello before it, are completely transmitted.
        line_ns = (SAMPLE_SIZE + HELLO_SIZE) * _BYTE_NS
        due = (self._clock.now_ns - line_ns) * self._rate // _SECOND_NS + 1 - self._first
        return max(0, due - self._next)

    def _sample(self, numbers: Integers, due_ns: Integers) -> bytes:
        steps = due_ns // STEP_NS
        self._reach(int(steps[-1]))
        noise = self._noise.at(self._first + numbers)
        shunt = (
            self._supply.current[steps] * self._parameters.meter_shunt
            + self._parameters.meter_shunt_deviation * noise[:, 0]
        )
        bus = self._supply.bus_voltage(steps) + self._parameters.meter_bus_deviation * noise[:, 1]
        return sample_frames(
            sequences=numbers,
            times=(due_ns - self._first_ns) // 1000,
            shunts=_register(shunt / _SHUNT_LSB, -_SHUNT_LIMIT, _SHUNT_LIMIT),
            buses=(_register(bus / _BUS_LSB, 0, _BUS_LIMIT) << 3) | _CONVERSION_READY,
        )

    def _hello(self, number: int, due_ns: int) -> bytes:
        return hello_frame(
            sequence=number,
            time=(due_ns - self._first_ns) // 1000,
            rate=self._rate,
            shunt=round(self._parameters.meter_shunt * 1e6),
            configuration=CONFIGURATION,
        )


def _register(values: Floats, low: int, high: int) -> Integers:
    return np.clip(np.rint(values), low, high).astype(np.int64)
