"""Experiment Runner's NvidiaML: queries NVIDIA's management library, and writes the answers as JSON."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar

from robot_runner.core.errors import PluginError
from robot_runner.legacy.profilers.data_source import DeviceSource
from robot_runner.legacy.stand_ins.machinery import OutputProcedure

# Static and dynamic queries, by the name of the library's function, `nvmlDeviceGet<name>`.
_STATIC = (
    "Name UUID Serial Index Architecture NumGpuCores VbiosVersion Brand NumFans MemoryInfo BusType BoardId Attributes "
    "BoardPartNumber MinMaxFanSpeed ComputeMode PersistenceMode PowerManagementMode EnforcedPowerLimit "
    "PowerManagementLimit PowerManagementDefaultLimit PowerManagementLimitConstraints MaxCustomerBoostClock "
    "PowerSource TargetFanSpeed TemperatureThreshold SupportedPerformanceStates MaxClockInfo MinMaxClockOfPState"
)
_DYNAMIC = "PowerUsage TotalEnergyConsumption Temperature FanSpeed_v2 UtilizationRates PerformanceState ClockInfo"
_WORD = re.compile(r"[A-Z](?:[a-z]+|[A-Z]*(?=[A-Z]|$))")


def library() -> Any:
    """Return NVIDIA's library.

    Raises:
        PluginError: its package is not installed.
    """
    try:
        return import_module("pynvml")
    except ModuleNotFoundError as error:
        fix = "Install it: pip install 'robot-runner[nvml]'."
        raise PluginError("NvidiaML needs nvidia-ml-py", where="NvidiaML", fix=fix) from error


class NVML_Query(Enum):  # noqa: N801 - the name that configs import
    """The base class of both kinds of queries."""


NVML_IDs = Enum("NVML_IDs", {"NVML_ID_INDEX": 0, "NVML_ID_SERIAL": 1, "NVML_ID_UUID": 2})


def _queries(name: str, functions: str) -> type[Enum]:
    """Return an enumeration of queries: `PowerUsage` is NVML_POWER_USAGE."""
    members = [
        ("NVML_" + "_".join(word.upper() for word in _WORD.findall(function.partition("_")[0])), function)
        for function in functions.split()
    ]
    kind: Any = NVML_Query
    made: type[Enum] = kind(name, members)
    return made


NVML_Static_Query: Any = _queries("NVML_Static_Query", _STATIC)
NVML_Dynamic_Query: Any = _queries("NVML_Dynamic_Query", _DYNAMIC)


@dataclass(frozen=True, slots=True)
class _Constant:
    """A constant of NVIDIA's library.

    Attributes:
        name: its name in a log: without the prefix, in lower case.
    """

    name: str
    value: Any

    def __repr__(self) -> str:
        return self.name


class _Constants:
    """The constants of NVIDIA's library with a prefix, which are looked up when they are used."""

    def __init__(self, prefix: str) -> None:
        self._prefix = prefix

    def __getattr__(self, name: str) -> _Constant:
        if name.startswith("__"):
            raise AttributeError(name)
        constant = _Constant(name.removeprefix(self._prefix).lower(), getattr(library(), name))
        setattr(self, name, constant)
        return constant


NVML_Field = _Constants("NVML_FI_DEV_")
NVML_Sample = _Constants("NVML_")
NVML_Clock = _Constants("NVML_CLOCK_")
NVML_PowerSource = _Constants("NVML_POWER_SOURCE_")
NVML_Arch = _Constants("NVML_DEVICE_ARCH_")
NVML_TempThreshold = _Constants("NVML_TEMPERATURE_THRESHOLD_")
NVML_API_Restriction = _Constants("NVML_RESTRICTED_API_SET_")
NVML_Enable_State = _Constants("NVML_FEATURE_")
NVML_Compute_Mode = _Constants("NVML_COMPUTEMODE_")
NVML_GPU_Operation_Mode = _Constants("NVML_GOM_")


class NvidiaML(DeviceSource):
    """Reads a GPU every `sample_frequency` milliseconds: queries, fields, and the samples that the driver keeps."""

    source_name: ClassVar[Any] = "Nvidia Management Library"
    supported_platforms: ClassVar[Any] = ["Linux", "Windows"]

    def __init__(
        self,
        sample_frequency: int = 5000,
        out_file: Path | str | None = "nvml_out.json",
        queries: Sequence[Any] = (NVML_Dynamic_Query.NVML_UTILIZATION_RATES, NVML_Dynamic_Query.NVML_POWER_USAGE),
        fields: Sequence[Any] = (),
        samples: Sequence[Any] = (),
        settings: Mapping[str, tuple[Any, ...]] | None = None,
    ) -> None:
        super().__init__()
        library().nvmlInit()
        self.sample_frequency = sample_frequency
        self.logfile = out_file
        self.settings = dict(settings or {})
        self.device_config: dict[Any, Any] | None = None
        self.measurements = {"queries": list(queries), "fields": list(fields), "samples": list(samples)}
        self._latest: dict[str, int] = {}
        self._device: tuple[Any, Any] | None = None

    def set_measurements(
        self, samples: Sequence[Any] = (), fields: Sequence[Any] = (), queries: Sequence[Any] = ()
    ) -> None:
        """Choose the measurements; those left out are unchanged."""
        chosen = {"samples": samples, "fields": fields, "queries": queries}
        self.measurements |= {kind: list(names) for kind, names in chosen.items() if names}

    def list_devices(self, print_dev: bool = False) -> list[dict[str, Any]]:
        """Return the answers of each GPU to the static queries; `print_dev` prints them, too."""
        devices = []
        for index in range(library().nvmlDeviceGetCount()):
            handle = library().nvmlDeviceGetHandleByIndex(index)
            devices.append({query.value: self._ask(handle, query.value) for query in NVML_Static_Query})
        if print_dev:
            for device in devices:
                OutputProcedure.console_log_tabulate_dict(device)
        return devices

    def open_device(self, dev_id: str | int, id_type: Any = NVML_IDs.NVML_ID_INDEX) -> None:
        """Choose a GPU by index, serial number or UUID, and apply the settings.

        Raises:
            PluginError: there is no such GPU, or a setting is refused.
        """
        self._device = (dev_id, id_type)
        self.device_handle = self._handle()
        if self.settings:
            self.set_mode(self.settings)
        self.device_config = {query: self._ask(self.device_handle, query.value) for query in NVML_Static_Query}

    def close_device(self) -> None:
        """Release the GPU."""
        library().nvmlShutdown()
        self.device_config = self.device_handle = None

    def set_mode(self, settings: Mapping[str, tuple[Any, ...]]) -> None:
        """Change settings of the GPU, by the name of NVML's function.

        Raises:
            PluginError: a setting is refused.
        """
        for name, values in settings.items():
            plain = tuple(value.value if isinstance(value, Enum | _Constant) else value for value in values)
            try:
                getattr(library(), f"nvmlDeviceSet{name}")(self.device_handle, *plain)
            except (AttributeError, library().NVMLError) as error:
                fix = "Leave the setting out, or execute the experiment as root."
                raise PluginError(f"the GPU refuses {name} = {plain}: {error}", where="NvidiaML", fix=fix) from error

    def measure(self) -> dict[str, Any]:
        """Return one reading: the time (microseconds since 1970) and the value of each measurement."""
        now = time.time_ns() // 1000
        read: dict[str, Any] = {}
        for sample in self.measurements["samples"]:
            read[sample.name] = self._kept_by_driver(sample)
        for field in self.measurements["fields"]:
            read[field.name] = (now, self._field(field))
        for query in self.measurements["queries"]:
            read[query.name] = (now, self._ask(self.device_handle, query.value))
        return read

    def log(self) -> None:
        """Read until `stop_thread` is set, and write all readings."""
        super().log()
        library().nvmlInit()
        self.device_handle = self._handle()
        # The driver's buffer also has samples of the last seconds before.
        self._latest = {each.name: time.time_ns() // 1000 for each in self.measurements["samples"]}
        read: dict[str, list[Any]] = {each.name: [] for kind in self.measurements.values() for each in kind}
        while not self.stop_thread.is_set():
            for name, value in self.measure().items():
                if isinstance(value, list):
                    read[name] += value
                else:
                    read[name].append(value)
            self.stop_thread.wait(self.sample_frequency / 1000)
        if self.logfile:
            Path(self.logfile).write_text(json.dumps(read, default=str), encoding="utf-8")
        self.thread_queue.put(read)
        library().nvmlShutdown()

    @staticmethod
    def parse_log(logfile: Path | str, remove_errors: bool = False) -> dict[str, list[tuple[int, Any]]]:
        """Return the readings in a log; `remove_errors` leaves out errors of the library."""
        read = json.loads(Path(logfile).read_text(encoding="utf-8"))
        return {
            name: [(at, value) for at, value in values if not (remove_errors and str(value).startswith("error: "))]
            for name, values in read.items()
        }

    def _handle(self) -> Any:
        if self._device is None:
            raise PluginError("no GPU was chosen", where="NvidiaML", fix="Call open_device(0, NVML_IDs.NVML_ID_INDEX).")
        dev_id, id_type = self._device
        by = {NVML_IDs.NVML_ID_SERIAL: "Serial", NVML_IDs.NVML_ID_UUID: "UUID"}.get(id_type, "Index")
        try:
            return getattr(library(), f"nvmlDeviceGetHandleBy{by}")(int(dev_id) if by == "Index" else str(dev_id))
        except library().NVMLError as error:
            problem = f"there is no GPU with {by.lower()} {dev_id!r}: {error}"
            raise PluginError(problem, where="NvidiaML", fix="See `nvidia-smi -L`.") from error

    def _ask(self, handle: Any, name: str) -> Any:
        """Return the answer to a query, which may be an error of the library."""
        nvml = library()
        try:
            ask = getattr(nvml, f"nvmlDeviceGet{name}")
            if name == "Temperature":
                return ask(handle, nvml.NVML_TEMPERATURE_GPU)
            if name in {"FanSpeed_v2", "TargetFanSpeed"}:
                return {fan: ask(handle, fan) for fan in range(nvml.nvmlDeviceGetNumFans(handle))}
            if name in {"ClockInfo", "MaxClockInfo", "MaxCustomerBoostClock"}:
                clocks = {"graphics": nvml.NVML_CLOCK_GRAPHICS, "sm": nvml.NVML_CLOCK_SM, "mem": nvml.NVML_CLOCK_MEM}
                return {clock: ask(handle, number) for clock, number in clocks.items()}
            answer = ask(handle)
        except (nvml.NVMLError, AttributeError, TypeError) as error:
            return f"error: {error}"
        members = getattr(answer, "_fields_", None)
        return {member[0]: getattr(answer, member[0]) for member in members} if members else answer

    def _field(self, field: Any) -> Any:
        nvml = library()
        value = nvml.nvmlDeviceGetFieldValues(self.device_handle, [field.value])[0]
        if value.nvmlReturn != nvml.NVML_SUCCESS:
            return f"error: {nvml.NVMLError(value.nvmlReturn)}"
        return _unpacked(value.valueType, value.value)

    def _kept_by_driver(self, sample: Any) -> list[tuple[int, Any]]:
        nvml = library()
        try:
            kind, values = nvml.nvmlDeviceGetSamples(self.device_handle, sample.value, self._latest.get(sample.name, 0))
        except nvml.NVMLError:
            return []  # nothing new
        read = [(value.timeStamp, _unpacked(kind, value.sampleValue)) for value in values]
        self._latest[sample.name] = max((at for at, _ in read), default=self._latest.get(sample.name, 0))
        return read


#: The member of the library's union for each type of a value; older libraries lack some types.
_MEMBERS = {
    "DOUBLE": "dVal",
    "UNSIGNED_INT": "uiVal",
    "UNSIGNED_LONG": "ulVal",
    "UNSIGNED_LONG_LONG": "ullVal",
    "SIGNED_LONG_LONG": "sllVal",
    "SIGNED_INT": "siVal",
    "UNSIGNED_SHORT": "usVal",
}


def _unpacked(kind: int, value: Any) -> Any:
    nvml = library()
    members = {getattr(nvml, f"NVML_VALUE_TYPE_{name}", None): member for name, member in _MEMBERS.items()}
    return getattr(value, members.get(kind, "ullVal"))
