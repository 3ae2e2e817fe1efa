"""NVIDIA's driver library as the real nvidia-ml-py calls it, through ctypes; `install` puts it in place."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

SUCCESS, INVALID_ARGUMENT, NOT_SUPPORTED, DRIVER_NOT_LOADED, GPU_IS_LOST = 0, 2, 3, 9, 15


@dataclass
class FakeGpu:
    """What a GPU says; energy in mJ grows by its power from `offset` on, if it `counts`, or else `millijoules`."""

    watts: float | Callable[[float], float] = 50.0
    utilisation: int = 40
    memory_used: int = 2 << 30
    memory_total: int = 8 << 30
    has_counter: bool = True
    has_power: bool = True
    counts: bool = True
    offset: int = 5_000_000
    is_lost: bool = False
    millijoules: Callable[[float], float] | None = None


class FakeNvidiaDriver:
    """The functions of libnvidia-ml that are asked for; each returns NVML's error code."""

    def __init__(self, clock, gpus, *, init_error=SUCCESS) -> None:
        self.clock = clock
        self.gpus = gpus
        self.init_error = init_error
        self.open_count = 0
        self._handles = {}
        self._keep = []

    def nvmlInitWithFlags(self, flags):  # noqa: N802 - NVIDIA's name
        if self.init_error == SUCCESS:
            self.open_count += 1
        return self.init_error

    def nvmlShutdown(self):  # noqa: N802
        self.open_count -= 1
        return SUCCESS

    def nvmlDeviceGetCount_v2(self, number):  # noqa: N802
        number._obj.value = len(self.gpus)
        return SUCCESS

    def nvmlDeviceGetHandleByIndex_v2(self, index, handle):  # noqa: N802
        if index.value >= len(self.gpus):
            return INVALID_ARGUMENT
        self._keep.append(handle._obj)  # so that no other handle gets its identity
        self._handles[id(handle._obj)] = self.gpus[index.value]
        return SUCCESS

    def nvmlDeviceGetName(self, handle, name, size):  # noqa: N802
        name.value = b"NVIDIA Fake"
        return SUCCESS

    def nvmlDeviceGetPowerUsage(self, handle, milliwatts):  # noqa: N802
        gpu = self._handles[id(handle)]
        if gpu.is_lost:
            return GPU_IS_LOST
        if not gpu.has_power:
            return NOT_SUPPORTED
        milliwatts._obj.value = round(1000 * self._watts(gpu))
        return SUCCESS

    def nvmlDeviceGetTotalEnergyConsumption(self, handle, millijoules):  # noqa: N802
        gpu = self._handles[id(handle)]
        if not gpu.has_counter:
            return NOT_SUPPORTED
        told = gpu.millijoules or (lambda time: gpu.offset + gpu.counts * 1000 * self._watts(gpu) * time)
        millijoules._obj.value = round(told(self.clock.now()))
        return SUCCESS

    def nvmlDeviceGetUtilizationRates(self, handle, rates):  # noqa: N802
        rates._obj.gpu = self._handles[id(handle)].utilisation
        return SUCCESS

    def nvmlDeviceGetMemoryInfo(self, handle, memory):  # noqa: N802
        gpu = self._handles[id(handle)]
        memory._obj.total, memory._obj.used = gpu.memory_total, gpu.memory_used
        return SUCCESS

    def _watts(self, gpu) -> float:
        return gpu.watts(self.clock.now()) if callable(gpu.watts) else gpu.watts


def install(driver: FakeNvidiaDriver, monkeypatch) -> FakeNvidiaDriver:
    """Have nvidia-ml-py call this driver in place of the library that NVIDIA's driver brings."""
    import pynvml

    monkeypatch.setattr(pynvml, "nvmlLib", driver)
    monkeypatch.setattr(pynvml, "_nvmlGetFunctionPointer_cache", {})
    return driver
