"""The device's side of the power meter's serial protocol (`docs/ina219-protocol.md`): registers to frames."""

from __future__ import annotations

import binascii
import struct
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import numpy.typing as npt

__all__ = ["HELLO_SIZE", "SAMPLE_SIZE", "hello_frame", "sample_frames"]

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

# What each value of the checksum's high byte turns into: CRC-16 with polynomial 0x1021, most significant bit first.
_CHECKSUM_STEPS = np.array([binascii.crc_hqx(bytes([high]), 0) for high in range(256)], dtype=np.uint16)


def hello_frame(*, sequence: int, time: int, rate: int, shunt: int, configuration: int) -> bytes:
    """Return a hello frame.

    Args:
        sequence: the number that the next sample will carry; of it the lower 16 bits are sent.
        time: the device's clock in µs; of it the lower 32 bits are sent.
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


def sample_frames(
    *,
    sequences: npt.NDArray[np.int64],
    times: npt.NDArray[np.int64],
    shunts: npt.NDArray[np.int64],
    buses: npt.NDArray[np.int64],
) -> bytes:
    """Return many sample frames, one after the other, `SAMPLE_SIZE` bytes each.

    Args:
        sequences: the samples' numbers; of each the lower 16 bits are sent.
        times: the device's clock in µs; of each the lower 32 bits are sent.
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
