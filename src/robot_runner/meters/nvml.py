"""The profiler of GPUs through NVIDIA's management library."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from numbers import Integral
from typing import TYPE_CHECKING, Any, ClassVar

from robot_runner.core.errors import Finding, PluginError
from robot_runner.core.events.context import RobotRunnerContext
from robot_runner.core.events.measure import Measure, Over
from robot_runner.measuring.measured_machine import simulation_findings
from robot_runner.measuring.parameter_checks import check_list
from robot_runner.measuring.quality import Column, sufficient
from robot_runner.measuring.series import Series, cut, energy, growth, mean
from robot_runner.meters.counters import fall_count
from robot_runner.meters.electrical_readings import (
    OFF_SHARE,
    STEP_ERRORS,
    seldom_renewed,
    standstills,
    step_error,
    stepped,
)
from robot_runner.meters.polled import PolledProfiler, known_series, trial_findings

if TYPE_CHECKING:
    from robot_runner.core.plugin import Circumstances
    from robot_runner.measuring.periodic import Sampling

_INSTALL = "Install it: pip install 'robot-runner[nvml]'."
_DRIVER = "Install NVIDIA's driver, and see that `nvidia-smi` works."
_MILLI = 1e-3
#: How long a GPU's energy counter may be behind, s, and the averaging time of the power of newer GPUs, s (NVML's
#: reference manual, nvmlDeviceGetPowerUsage).
_RENEWED, _AVERAGED = 0.1, 1.0


@dataclass(frozen=True, slots=True)
class GpuReading:
    """A reading of one GPU; None for what it does not support.

    Attributes:
        power: W; on most GPUs an average over the last second (NVML's reference manual, nvmlDeviceGetPowerUsage).
        joules: energy since the driver was loaded, J; from Volta on.
        utilisation: share of the last sample period in which a kernel was executing, 0..100 %.
        memory: share of its memory in use, 0..100 %.
    """

    power: float | None
    joules: float | None
    utilisation: float | None
    memory: float | None


class _Gpus:
    """The initialised library, and the GPUs to read."""

    def __init__(self, indices: Sequence[int] | None) -> None:
        try:
            self._library: Any = import_module("pynvml")
        except ModuleNotFoundError as error:
            raise PluginError("nvidia-ml-py is not installed", where="Nvml", fix=_INSTALL) from error
        try:
            self._library.nvmlInit()
        except self._library.NVMLError as error:
            raise PluginError(f"NVIDIA's driver does not answer: {error}", where="Nvml", fix=_DRIVER) from error
        try:
            self.handles = [self._library.nvmlDeviceGetHandleByIndex(index) for index in self._chosen(indices)]
            self.names = [str(self._library.nvmlDeviceGetName(handle)) for handle in self.handles]
        except Exception:
            self.close()
            raise

    def _chosen(self, indices: Sequence[int] | None) -> Sequence[int]:
        count = self._library.nvmlDeviceGetCount()
        missing = [index for index in indices or () if index >= count]
        if missing or not count:
            problem = (
                f"there is no GPU {missing[0]}; there are {count}, counted from 0" if missing else "there is no GPU"
            )
            raise PluginError(problem, where="Nvml", fix="Choose GPUs that `nvidia-smi -L` lists.")
        return range(count) if indices is None else indices

    def read(self) -> tuple[GpuReading, ...]:
        return tuple(self._read(handle) for handle in self.handles)

    def _read(self, handle: Any) -> GpuReading:
        nvml = self._library
        power = self._asked(nvml.nvmlDeviceGetPowerUsage, handle)
        counter = self._asked(nvml.nvmlDeviceGetTotalEnergyConsumption, handle)
        rates = self._asked(nvml.nvmlDeviceGetUtilizationRates, handle)
        memory = self._asked(nvml.nvmlDeviceGetMemoryInfo, handle)
        return GpuReading(
            power=None if power is None else power * _MILLI,
            joules=None if counter is None else counter * _MILLI,
            utilisation=None if rates is None else float(rates.gpu),
            memory=None if memory is None else 100.0 * memory.used / memory.total,
        )

    def _asked(self, question: Callable[[Any], Any], handle: Any) -> Any:
        try:
            return question(handle)
        except self._library.NVMLError as error:
            if error.value == self._library.NVML_ERROR_NOT_SUPPORTED:
                return None
            raise

    def close(self) -> None:
        self._library.nvmlShutdown()


class Nvml(PolledProfiler[tuple[GpuReading, ...]]):
    """Measures power, energy, utilisation and memory of NVIDIA GPUs of this machine, through NVML.

    Energy is taken from the GPU's own counter if it has one; else it is the integral of its power.

    Args:
        name: distinguishes several instances; None for the class's name.
        gpus: numbers of GPUs, as in `nvidia-smi -L`; None for all.
        rate_hz: readings a second, Hz; GPUs update their values 10 to 50 times a second.

    Raises:
        PluginError: gpus is empty or holds anything but whole numbers from 0, or the rate is not positive.

    Example:
        >>> Nvml(gpus=[0]).measures[2].name
        'GPU'
    """

    measures: Sequence[Measure] = (
        Measure(
            "Energy",
            "J",
            "Energy of the GPUs over the measured window, by their counters or their power.",
            over=Over.SUM,
        ),
        Measure("MeanPower", "W", "Energy divided by the duration of the measured window.", over=Over.MEAN),
        Measure("GPU", "%", "GPU utilisation, mean over the GPUs and the measured window.", over=Over.MEAN),
        Measure(
            "GPUMemory", "%", "Memory of the GPUs in use, mean over the GPUs and the measured window.", over=Over.MEAN
        ),
    )
    needs: ClassVar[str] = "An NVIDIA GPU with its driver, and robot-runner[nvml]."
    bytes_per_run: int = 70_000  # 10 readings a second of 70 bytes for one GPU and a mission of 95 s

    def __init__(self, *, name: str | None = None, gpus: Sequence[int] | None = None, rate_hz: float = 10.0) -> None:
        super().__init__(name=name, rate_hz=rate_hz)
        check_list(self.name, gpus=() if gpus is None else gpus)
        chosen = None if gpus is None else tuple(gpus)
        if chosen is not None and not (chosen and all(map(_is_index, chosen))):
            fix = "Give whole numbers from 0, or leave gpus out for all."
            raise PluginError(f"gpus is {list(chosen)!r}", where=self.name, fix=fix)
        self.gpus = None if chosen is None else tuple(dict.fromkeys(chosen))
        self._names: list[str] = []

    def check(self, circumstances: Circumstances) -> Iterable[Finding]:
        """Return errors: no library, no driver, or no such GPU."""
        return trial_findings(self, lambda: _Gpus(self.gpus)) or simulation_findings(self.name, circumstances.robot)

    def open(self, context: RobotRunnerContext) -> _Gpus:
        """Return the GPUs; a `PluginError` says that the library, its driver or a GPU is missing."""
        del context
        gpus = _Gpus(self.gpus)
        self._names = gpus.names
        return gpus

    def columns(self, sampling: Sampling[tuple[GpuReading, ...]]) -> Sequence[Column]:
        """Return the values of each GPU."""
        picks = {"power_W": "power", "energy_J": "joules", "gpu_percent": "utilisation", "memory_percent": "memory"}
        return [
            Column(
                f"gpu{place}_{heading}", [getattr(reading[place], quantity) for reading in sampling.readings], "%.3f"
            )
            for place in range(len(self._names))
            for heading, quantity in picks.items()
        ]

    def values(self, sampling: Sampling[tuple[GpuReading, ...]]) -> Mapping[str, float | None]:
        """Return the sum of the GPUs' energies, and the means of their utilisations."""
        places = range(len(self._names))
        energies = [(self._counted(sampling, place), self._integral(sampling, place)) for place in places]
        joules = _total([counted or (counted if integral is None else integral) for counted, integral in energies])
        return {
            "Energy": joules,
            "MeanPower": None if joules is None else joules / sampling.window.duration,
            "GPU": _mean([self._mean(sampling, place, "utilisation") for place in places]),
            "GPUMemory": _mean([self._mean(sampling, place, "memory") for place in places]),
        }

    def doubts(self, sampling: Sampling[tuple[GpuReading, ...]]) -> Iterator[str]:
        """Yield doubts where counter or power may be off, or values cover only a part of the time."""
        within = sampling.within()
        for place, gpu in enumerate(self.gpus or range(len(self._names))):
            for quantity, word in _WORDS.items():
                told, count = len(_known(within, place, quantity)), len(within.readings)
                if 0 < told < count and not len(_series(sampling, place, quantity)):
                    yield f"the {word} of GPU {gpu} was reported in {told} of {count} readings only"
            if self._counted(sampling, place):
                yield from self._doubts_about_counter(sampling, place, gpu)
            else:
                yield from self._doubts_about_power(sampling, place, gpu)

    def _doubts_about_counter(self, sampling: Sampling[tuple[GpuReading, ...]], place: int, gpu: int) -> Iterator[str]:
        counted, integral = self._counted(sampling, place) or 0.0, self._integral(sampling, place)
        seconds = sampling.window.duration
        if seconds * OFF_SHARE < _RENEWED:
            off = min(100.0, 100 * _RENEWED / seconds)
            renewed = f"GPU {gpu} renews its energy counter every {_RENEWED} s or so: over {seconds:.3f} s"
            yield f"{renewed}, its energy may be off by {off:.0f} %"
        if integral is not None:
            power = _known(sampling.within(), place, "power")
            spread = max(power.values, default=0.0) - min(power.values, default=0.0)
            late = 2 * _RENEWED * integral / seconds + _AVERAGED * spread
            missed = STEP_ERRORS * step_error(power, sampling.window)
            if abs(counted - integral) > max(OFF_SHARE * (counted + integral) / 2, late + missed):
                rose = f"the energy counter of GPU {gpu} rose by {counted:.4g} J"
                yield f"{rose}, and its power amounts to {integral:.4g} J"

    def _doubts_about_power(self, sampling: Sampling[tuple[GpuReading, ...]], place: int, gpu: int) -> Iterator[str]:
        joules = self._integral(sampling, place)
        if joules is None:
            return
        if len(_series(sampling, place, "joules")):
            how = "was set back" if self._counted(sampling, place) is None else "stood still"
            yield f"the energy counter of GPU {gpu} {how}: its energy is the integral of its power"
        if not joules:
            yield f"GPU {gpu} reported a power of 0 W throughout"
        within = sampling.within()
        for doubt in (
            *seldom_renewed(_known(within, place, "power"), sampling),
            *stepped(_series(sampling, place, "power"), sampling, joules),
        ):
            yield doubt.format(of=f" of GPU {gpu}")
        # An idle GPU may draw the same power for a long time.
        busy = [each[place].power if each[place].utilisation else object() for each in within.readings]
        for standstill in standstills(within.times, busy, sampling):
            yield f"GPU {gpu} reported the same power {standstill}, while it computed: it may be stuck"

    def details(self) -> Mapping[str, Any]:
        """Return the names of the GPUs."""
        return {"gpus": self._names}

    def _integral(self, sampling: Sampling[tuple[GpuReading, ...]], place: int) -> float | None:
        # If the readings suffice, a gap at an edge is bridged like one inside: by the reading beside it.
        return energy(_series(sampling, place, "power"), sampling.window, reach=sampling.window.duration)

    def _counted(self, sampling: Sampling[tuple[GpuReading, ...]], place: int) -> float | None:
        """Return by how much the GPU's energy counter grew, J; None if there is none, or it was reset."""
        counter = _series(sampling, place, "joules")
        return None if fall_count(counter.values) else growth(counter, sampling.window)

    def _mean(self, sampling: Sampling[tuple[GpuReading, ...]], place: int, quantity: str) -> float | None:
        return mean(cut(_series(sampling, place, quantity), sampling.window))


#: The names of a reading's quantities in messages.
_WORDS = {"power": "power", "joules": "energy", "utilisation": "utilisation", "memory": "memory"}


def _is_index(value: object) -> bool:
    return isinstance(value, Integral) and not isinstance(value, bool) and int(value) >= 0


def _known(sampling: Sampling[tuple[GpuReading, ...]], place: int, quantity: str) -> Series:
    return known_series(sampling, lambda reading: getattr(reading[place], quantity))


def _series(sampling: Sampling[tuple[GpuReading, ...]], place: int, quantity: str) -> Series:
    """Return one quantity of a GPU if its values cover enough of the window, else an empty series."""
    return sufficient(_known(sampling, place, quantity), sampling.window, sampling.rate)


def _total(values: Sequence[float | None]) -> float | None:
    """Return the sum; None if one is missing, as the sum of the others would be taken for that of all."""
    known = [value for value in values if value is not None]
    return sum(known) if len(known) == len(values) else None


def _mean(values: Sequence[float | None]) -> float | None:
    total = _total(values)
    return None if total is None or not values else total / len(values)
