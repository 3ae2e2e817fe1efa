"""Experiment Runner's PicoCM3: a PicoLog CM3 current logger, through its maker's library."""

from __future__ import annotations

import ctypes
import ctypes.util
import math
import time
from collections.abc import Callable, Mapping
from datetime import datetime
from enum import Enum
from functools import cache
from pathlib import Path
from typing import Any

from robot_runner.core.errors import LinkError, PluginError

# Source of functions and numbers: Pico Technology, PicoLog CM3 Programmer's Guide.
_CHANNELS = 3
_USB = 1
_NO_SAMPLES = 0x25
_WARM_UP_S = 5.0


CM3DataTypes = Enum(
    "CM3DataTypes",
    {
        "PLCM3_OFF": 0,
        "PLCM3_1_MILLIVOLT": 1,
        "PLCM3_10_MILLIVOLTS": 2,
        "PLCM3_100_MILLIVOLTS": 3,
        "PLCM3_VOLTAGE": 4,
    },
)
CM3Channels = Enum("CM3Channels", {"PLCM3_CHANNEL_1": 1, "PLCM3_CHANNEL_2": 2, "PLCM3_CHANNEL_3": 3})
CM3MainsTypes = Enum("CM3MainsTypes", {"PLCM3_MAINS_50HZ": 0, "PLCM3_MAINS_60HZ": 1})

#: The factor of a reading, and the resulting unit, by the channel's data type.
_SCALES = {0: (0.0, ""), 1: (1e-3, "A"), 2: (1e-3, "A"), 3: (1.0, "mA"), 4: (1e-3, "mV")}


class PicoCM3:
    """Reads the three channels of a logger every `sample_frequency` milliseconds."""

    def __init__(
        self,
        sample_frequency: int | None = None,
        mains_setting: int | None = None,
        channel_settings: Mapping[int, int] | None = None,
    ) -> None:
        """Find the library and the device.

        Raises:
            PluginError: the library is not installed.
            LinkError: no device is connected.
        """
        self.handle: Any = None
        self.sample_frequency = 1000 if sample_frequency is None else sample_frequency
        self.mains_setting = 0 if mains_setting is None else mains_setting
        self.channel_settings = dict(channel_settings or {1: 1, 2: 0, 3: 0})
        self.logfile: Any = None
        _library()
        if not self.enumerate_devices():
            raise LinkError("no PicoLog CM3 is connected", where="PicoCM3", fix="Connect it over USB.")

    def __del__(self) -> None:
        if getattr(self, "handle", None):
            self.close_device()

    def enumerate_devices(self) -> str:
        """Return the serial numbers of the connected devices."""
        details, length = ctypes.create_string_buffer(255), ctypes.c_uint32(255)
        _call("PLCM3Enumerate", details, ctypes.byref(length), ctypes.c_uint32(_USB))
        return details.value.decode()

    def open_device(self, dev: str | None = None, verbose: bool = True) -> Any:
        """Open a device, and let it warm up.

        Raises:
            LinkError: the device refuses.
        """
        del verbose
        self.handle = ctypes.c_int16()
        serial = None if dev is None else ctypes.create_string_buffer(dev.encode())
        _call("PLCM3OpenUnit", ctypes.byref(self.handle), serial)
        self.mode()
        time.sleep(_WARM_UP_S)
        return self.handle

    def mode(self) -> None:
        """Apply the settings of the channels and of the mains.

        Raises:
            PluginError: a setting is invalid.
            LinkError: the device refuses.
        """
        settings = self.channel_settings
        if set(settings) != set(range(1, _CHANNELS + 1)) or not set(settings.values()) <= set(_SCALES):
            fix = "Give each of the channels 1 to 3 one of CM3DataTypes."
            raise PluginError(f"the channels' settings are {settings}", where="PicoCM3", fix=fix)
        for channel, setting in settings.items():
            _call("PLCM3SetChannel", self.handle, ctypes.c_uint32(channel), ctypes.c_uint32(setting))
        _call("PLCM3SetMains", self.handle, ctypes.c_uint16(self.mains_setting))

    def log(
        self,
        logfile: str | Path | None = None,
        dev: Any = None,
        timeout: float = 60,
        finished_fn: Callable[[], bool] | None = None,
    ) -> dict[str, list[tuple[float, str]]]:
        """Read for `timeout` seconds, or while `finished_fn` returns True; write and return the readings."""
        del dev
        self.logfile = logfile
        deadline = time.monotonic() + timeout
        read: dict[str, list[tuple[float, str]]] = {}
        while finished_fn() if finished_fn is not None else time.monotonic() < deadline:
            now = datetime.now().isoformat(" ", "seconds")  # noqa: DTZ005 - its format
            read[now] = [self._channel(channel) for channel in range(1, _CHANNELS + 1)]
            time.sleep(self.sample_frequency / 1000)
        if logfile is not None:
            lines = [f"{at},{','.join(f'{value:.2f} {unit}' for value, unit in row)}\n" for at, row in read.items()]
            Path(logfile).write_text("".join(lines), encoding="ascii")
        return read

    def close_device(self) -> None:
        """Release the device."""
        if self.handle:
            handle, self.handle = self.handle, None
            _call("PLCM3CloseUnit", handle)

    @staticmethod
    def parse_log(logfile: str | Path) -> dict[str, list[Any]]:
        """Return the contents of a log: times, and the values of each channel."""
        rows = [line.strip().split(",") for line in Path(logfile).read_text(encoding="ascii").splitlines() if line]
        values = {
            f"channel_{channel}": [float(row[channel].partition(" ")[0]) for row in rows]
            for channel in range(1, _CHANNELS + 1)
        }
        return {"timestamp": [row[0] for row in rows], **values}

    def apply_scaling(self, value: int, channel_mode: int) -> tuple[float, str]:
        """Return the number and the unit of a raw reading."""
        scale, unit = _SCALES[channel_mode]
        return value * scale, unit

    def _channel(self, channel: int) -> tuple[float, str]:
        raw = ctypes.c_uint32()
        status = _library().PLCM3GetValue(self.handle, ctypes.c_uint32(channel), ctypes.byref(raw))
        if status == _NO_SAMPLES:
            return math.nan, ""
        _check("PLCM3GetValue", status)
        return self.apply_scaling(raw.value, self.channel_settings[channel])


@cache
def _library() -> Any:
    name = ctypes.util.find_library("plcm3")
    if name is None:
        fix = "Install Pico Technology's drivers, or put them on LD_LIBRARY_PATH."
        raise PluginError("the library plcm3 of PicoLog is not installed", where="PicoCM3", fix=fix)
    return ctypes.CDLL(name)


def _call(function: str, *arguments: Any) -> None:
    _check(function, getattr(_library(), function)(*arguments))


def _check(function: str, status: int) -> None:
    if status:
        fix = "Look at the device and its cable."
        raise LinkError(f"{function} answered with status {status:#x}", where="PicoCM3", fix=fix)
