"""The profilers of the earlier tools do what they did: on real programs where there are any, else on faithful ones."""

from __future__ import annotations

import json
import math
import os
import plistlib
import stat
import sys
import threading
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import TYPE_CHECKING, Any, NoReturn

import pytest
from tests.legacy.earlier_configs import ROBOT, RUNNER, problems
from tests.meters.test_watts_up_pro import PtyMeter
from tests.waiting import PATIENCE

from robot_runner.core.config.preparation import prepare
from robot_runner.core.errors import LinkError, PluginError
from robot_runner.core.execution.resumption import Resumption
from robot_runner.core.links.kinds import FoundRobot
from robot_runner.core.plugin import Circumstances
from robot_runner.core.storage.table_schema import read_schema
from robot_runner.legacy.profilers import pico, programs
from robot_runner.legacy.profilers.command_line import EnergiBridge, PowerJoular, PowerLetrics, PowerMetrics, Ps
from robot_runner.legacy.profilers.data_source import DeviceSource, ParameterDict
from robot_runner.legacy.profilers.nvidia import (
    NvidiaML,
    NVML_Dynamic_Query,
    NVML_Enable_State,
    NVML_Field,
    NVML_IDs,
    NVML_Sample,
)
from robot_runner.legacy.profilers.profiler_catalogue import PLUGINS, plugin_of
from robot_runner.legacy.profilers.programs import Program, SelfMeasure, read_table
from robot_runner.legacy.profilers.robot_plugins import BasicTurtleBot3, INA219Profiler, NetworkProfiler

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.legacy.earlier_configs import Executed

#: Its log is there once it heeds a request to stop.
ENERGIBRIDGE = """\
summary=; output=/dev/stdout
while [ "$1" != -- ]; do
    case "$1" in --summary) summary=1;; -o) output=$2; shift;; esac
    shift
done
shift
say() { [ -z "$summary" ] || echo "Energy consumption in joules: 5.5 for 2.0 sec of execution."; exit 0; }
"$@" & child=$!
trap 'kill $child; say' TERM
printf 'Delta,Time,PACKAGE_ENERGY (J),USED_MEMORY\\n200,1000,10.0,7\\n200,3000,15.5,9\\n' > "$output"
wait $child
say
"""

POWERJOULAR = """\
while [ $# -gt 0 ]; do case "$1" in -f) file=$2; shift;; -p) pid=$2; shift;; esac; shift; done
for each in "$file" ${pid:+"$file-$pid.csv"}; do
    printf 'Date,CPU Utilization,Total Power,CPU Power\\n2026-01-01 10:00:00,0.25,12.5,10.5\\n' > "$each"
done
exec sleep 60
"""


@pytest.fixture
def program(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str, str], Path]:
    """Return what puts a program on the PATH."""
    folder = tmp_path / "bin"
    folder.mkdir()
    monkeypatch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")

    def put(name: str, script: str) -> Path:
        path = folder / name
        path.write_text(f"#!/bin/sh\n{script}", encoding="utf-8")
        path.chmod(path.stat().st_mode | stat.S_IXUSR)
        return path

    return put


def wait_for(path: Path) -> None:
    for _ in range(12_000):
        if path.exists() and path.read_text():
            return
        os.sched_yield()
        __import__("time").sleep(0.005)
    raise AssertionError(f"{path} was never written")


def test_every_plugin_of_the_table_can_be_imported_by_every_name() -> None:
    for plugin in PLUGINS:
        for home in plugin.names.values():
            module, _, attribute = home.partition(":")
            assert hasattr(__import__(module, fromlist=[attribute]), attribute)


def test_old_paths_lead_to_the_same_plugin() -> None:
    assert plugin_of("Plugins.CodecarbonWrapper") is plugin_of("Plugins.Profilers.CodecarbonWrapper")
    assert plugin_of("plugins.Profilers.INA219Profiler") is plugin_of("Plugins.Profilers.INA219Profiler")
    assert plugin_of("Plugins.Systems.BasicTurtleBot3") is plugin_of("Plugins.Systems.TurtleBot3.BasicTurtleBot3")


def test_parameters_are_known_under_each_spelling() -> None:
    parameters = ParameterDict({("-o", "--output"): str, "-a": None})
    assert parameters["--output"] is parameters["-o"] is str
    assert "-a" in parameters
    assert "-b" not in parameters
    with pytest.raises(KeyError):
        parameters["-b"]


def test_ps_writes_rows_without_a_heading(program: Callable[[str, str], Path], tmp_path: Path) -> None:
    program("ps", 'echo "  1.5   0.25"\n')
    meter = Ps(sleep_interval=0.01, out_file=tmp_path / "ps one.csv", target_pid=[os.getpid()])
    meter.start()
    wait_for(meter.logfile)
    meter.stop()
    log = meter.parse_log(meter.logfile, ["cpu", "mem"])
    assert (log["cpu"][0], log["mem"][0]) == (1.5, 0.25)
    assert f"-p {os.getpid()}" in meter._format_cmd()


def test_powerjoular_writes_its_log_and_that_of_a_process(program: Callable[[str, str], Path], tmp_path: Path) -> None:
    program("powerjoular", POWERJOULAR)
    meter = PowerJoular(target_pid=7, out_file=tmp_path / "joular.csv")
    meter.start()
    wait_for(Path(meter.target_logfile))
    meter.stop()
    assert list(meter.parse_log(meter.logfile)["CPU Power"].values()) == [10.5]
    assert list(meter.parse_log(meter.target_logfile)["CPU Utilization"].values()) == [0.25]


def test_a_program_that_cannot_be_started_leaves_no_file_open(tmp_path: Path) -> None:
    before = len(list(Path("/dev/fd").iterdir()))
    with pytest.raises(PluginError, match="cannot be started"):
        Program([str(tmp_path / "missing")], name="missing")
    assert len(list(Path("/dev/fd").iterdir())) == before


def test_energibridge_measures_a_program_and_keeps_its_summary(
    program: Callable[[str, str], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("robot_runner.legacy.profilers.data_source.geteuid", lambda: 0)  # root needs no sudo
    program("energibridge", ENERGIBRIDGE)
    meter = EnergiBridge(target_program="sleep 0.01", out_file=tmp_path / "eb.csv")
    meter.start()
    meter.stop(wait=True)
    log, summary = meter.parse_log(meter.logfile, meter.summary_logfile)
    assert summary == {"total_joules": 5.5, "runtime_seconds": 2.0}
    assert max(log["USED_MEMORY"].values()) == 9


def test_a_log_may_stand_in_a_folder_with_a_blank(program: Callable[[str, str], Path], tmp_path: Path) -> None:
    program("sudo", 'exec "$@"\n')
    program("energibridge", ENERGIBRIDGE)
    (tmp_path / "my study").mkdir()
    meter = EnergiBridge(target_program="true", out_file=tmp_path / "my study" / "eb.csv")
    meter.start()
    meter.stop(wait=True)
    assert meter.parse_log(meter.logfile)["Time"] == {0: 1000, 1: 3000}


def test_energibridge_is_stopped_while_it_waits(program: Callable[[str, str], Path], tmp_path: Path) -> None:
    program("sudo", 'exec "$@"\n')
    program("energibridge", ENERGIBRIDGE)
    meter = EnergiBridge(out_file=tmp_path / "eb.csv")
    meter.start()
    wait_for(meter.logfile)
    assert "joules: 5.5" in meter.stop()


def test_a_summary_that_is_missing_is_computed_from_the_log(
    program: Callable[[str, str], Path], tmp_path: Path
) -> None:
    program("sudo", 'exec "$@"\n')
    program("energibridge", ENERGIBRIDGE.replace('[ -z "$summary" ] ||', "false &&"))
    meter = EnergiBridge(target_program="true", out_file=tmp_path / "eb.csv")
    meter.start()
    meter.stop(wait=True)
    assert meter.summary_logfile.read_text() == "Energy consumption in joules: 5.5 for 2.0 sec of execution"


def test_a_summary_of_a_counter_that_began_anew_keeps_its_sign(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("Time\n1\n")
    (tmp_path / "summary.txt").write_text("Energy consumption in joules: -12.5 for 2.0 sec of execution.")
    _, summary = EnergiBridge.parse_log(tmp_path / "log.csv", tmp_path / "summary.txt")
    assert summary == {"total_joules": -12.5, "runtime_seconds": 2.0}


@pytest.mark.parametrize(
    ("log", "joules"),
    [
        ("Delta,Time,CPU_ENERGY (J)\n200,1000,10.0\n200,3000,15.5\n", 5.5),
        ("Delta,Time,SYSTEM_POWER (Watts)\n200,1000,4.0\n200,3000,2.75\n", 5.5),
        ("Delta,Time,PACKAGE_ENERGY (J)\n200,1000,65534.0\n200,3000,3.5\n", 5.5),
        ("Delta,Time,USED_MEMORY\n200,1000,7\n200,3000,9\n", None),
    ],
    ids=["of AMD", "of Apple", "begun at 0 again", "no energy"],
)
def test_a_computed_summary_has_the_energy_of_any_processor_and_none_where_the_log_has_none(
    log: str, joules: float | None, program: Callable[[str, str], Path], tmp_path: Path
) -> None:
    program("energibridge", ENERGIBRIDGE)
    meter = EnergiBridge(out_file=tmp_path / "eb.csv")
    meter.logfile.write_text(log)
    (tmp_path / "summary.txt").write_text(meter.generate_summary())
    _, summary = meter.parse_log(meter.logfile, tmp_path / "summary.txt")
    assert summary == {
        "total_joules": pytest.approx(math.nan if joules is None else joules, nan_ok=True),
        "runtime_seconds": 2.0,
    }


def test_a_program_that_is_not_there_is_named() -> None:
    with pytest.raises(PluginError, match="the program powerjoular is not there"):
        PowerJoular()


def test_a_program_that_fails_at_once_says_why(
    program: Callable[[str, str], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(programs, "_STARTING_S", PATIENCE)  # a busy machine takes longer than usual to start it
    program("powerjoular", "echo 'no RAPL here' >&2; exit 3\n")
    with pytest.raises(LinkError, match="ended at once with exit code 3: no RAPL here"):
        PowerJoular(out_file=tmp_path / "x.csv").start()


@pytest.mark.parametrize("kind", [PowerMetrics, PowerLetrics])
def test_property_lists_are_read_one_after_another(kind: Any, tmp_path: Path) -> None:
    samples = [{"processor": {"cpu_power": power, "packages": []}, "timestamp": power} for power in (3, 4)]
    head = b"one\ntwo\n" if kind is PowerLetrics else b""
    (tmp_path / "log.plist").write_bytes(head + b"\0".join(plistlib.dumps(sample) for sample in samples))
    read = kind.parse_log(tmp_path / "log.plist")
    assert [each["processor"]["cpu_power"] for each in read] == [3, 4]
    assert PowerMetrics.parse_plist_power(read)[1] == {"processor": {"cpu_power": 4}, "timestamp": 4}


def test_a_profiler_of_another_system_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("platform.system", lambda: "Linux")
    with pytest.raises(PluginError, match="powermetrics measures on Darwin, and this is Linux"):
        PowerMetrics()


def test_a_log_is_read_with_types(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("a, b\n1,x\n2.5,y\n")
    assert read_table(tmp_path / "log.csv") == {"a": {0: 1, 1: 2.5}, "b": {0: "x", 1: "y"}}


def test_what_lacks_in_a_log_is_nan_as_in_the_earlier_tool(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("Time,CPU,DRAM\n1,,2.5\n2,0.5")  # ended while it wrote
    log = read_table(tmp_path / "log.csv")
    assert log["Time"] == {0: 1, 1: 2}
    assert math.isnan(log["CPU"][0])
    assert math.isnan(sum(log["DRAM"].values()))


class _Thermometer(DeviceSource):
    def __init__(self) -> None:
        super().__init__()
        self.sample_frequency = 1

    def log(self) -> None:
        super().log()
        self.stop_thread.wait()
        self.thread_queue.put([21.5])


def test_a_device_is_read_in_a_thread_until_it_is_stopped() -> None:
    device = _Thermometer()
    device.start()
    assert device.stop() == [21.5]
    assert device.stop() is None


def test_a_device_that_is_stopped_before_its_thread_has_begun_delivers(monkeypatch: pytest.MonkeyPatch) -> None:
    device, is_stopped = _Thermometer(), threading.Event()
    begun = DeviceSource.log
    monkeypatch.setattr(DeviceSource, "log", lambda self: (is_stopped.wait(), begun(self)))
    monkeypatch.setattr(device.stop_thread, "set", lambda: (threading.Event.set(device.stop_thread), is_stopped.set()))
    device.start()
    assert device.stop() == [21.5]


def test_a_device_is_read_by_its_own_thread_alone() -> None:
    with pytest.raises(PluginError, match="log was called"):
        _Thermometer().log()


#: Later than any test, us since 1970.
LATER = 1 << 60


@pytest.fixture
def gpu(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """Stand in for NVIDIA's library: one GPU that draws 31 W."""
    nvml = ModuleType("pynvml")

    class NVMLError(Exception):
        pass

    class Utilisation:
        _fields_ = (("gpu", int), ("memory", int))
        gpu, memory = 40, 10

    value = SimpleNamespace(nvmlReturn=0, valueType=1, value=SimpleNamespace(ullVal=77))
    kept = [SimpleNamespace(timeStamp=at, sampleValue=SimpleNamespace(uiVal=60)) for at in (5, LATER)]
    nvml.__dict__.update(
        NVMLError=NVMLError,
        NVML_SUCCESS=0,
        NVML_VALUE_TYPE_DOUBLE=0,
        NVML_VALUE_TYPE_UNSIGNED_LONG_LONG=1,
        NVML_VALUE_TYPE_UNSIGNED_INT=2,
        NVML_VALUE_TYPE_UNSIGNED_LONG=3,
        NVML_VALUE_TYPE_SIGNED_LONG_LONG=4,
        NVML_FI_DEV_TOTAL_ENERGY_CONSUMPTION=83,
        NVML_ENC_UTILIZATION_SAMPLES=3,
        nvmlInit=lambda: None,
        nvmlShutdown=lambda: None,
        nvmlDeviceGetCount=lambda: 1,
        nvmlDeviceGetHandleByIndex=lambda index: f"gpu {index}",
        nvmlDeviceGetName=lambda handle: f"name of {handle}",
        nvmlDeviceGetPowerUsage=lambda handle: 31_000,
        nvmlDeviceGetUtilizationRates=lambda handle: Utilisation(),
        nvmlDeviceGetFieldValues=lambda handle, fields: [value],
        nvmlDeviceGetSamples=lambda handle, kind, since: (2, [each for each in kept if each.timeStamp > since]),
    )
    monkeypatch.setitem(sys.modules, "pynvml", nvml)
    return nvml


def test_nvidia_writes_queries_fields_and_samples(gpu: ModuleType, tmp_path: Path) -> None:
    meter = NvidiaML(
        sample_frequency=1,
        out_file=tmp_path / "gpu.json",
        fields=[NVML_Field.NVML_FI_DEV_TOTAL_ENERGY_CONSUMPTION],
        samples=[NVML_Sample.NVML_ENC_UTILIZATION_SAMPLES],
    )
    meter.open_device(0, NVML_IDs.NVML_ID_INDEX)
    meter.start()
    read = meter.stop()
    log = meter.parse_log(tmp_path / "gpu.json", remove_errors=True)
    assert log["NVML_POWER_USAGE"][0][1] == 31_000
    assert log["NVML_UTILIZATION_RATES"][0][1] == {"gpu": 40, "memory": 10}
    assert log["total_energy_consumption"][0][1] == 77
    assert log["enc_utilization_samples"] == [(LATER, 60)]  # the driver has kept some from before the start
    assert len(read["NVML_POWER_USAGE"]) == len(log["NVML_POWER_USAGE"])
    assert meter.list_devices()[0]["Name"] == "name of gpu 0"
    assert NVML_Dynamic_Query.NVML_POWER_USAGE.value == "PowerUsage"


def test_nvidia_is_set_with_its_constants(gpu: ModuleType) -> None:
    told: list[tuple[object, ...]] = []
    gpu.__dict__.update(
        NVML_FEATURE_ENABLED=1,
        nvmlDeviceSetPersistenceMode=lambda *given: told.append(given),
        nvmlDeviceSetPowerManagementLimit=lambda *given: told.append(given),
    )
    settings = {"PersistenceMode": (NVML_Enable_State.NVML_FEATURE_ENABLED,), "PowerManagementLimit": (200_000,)}
    NvidiaML(settings=settings).open_device(0)
    assert told == [("gpu 0", 1), ("gpu 0", 200_000)]
    with pytest.raises(PluginError, match="the GPU refuses EccMode"):
        NvidiaML(settings={"EccMode": (NVML_Enable_State.NVML_FEATURE_ENABLED,)}).open_device(0)


def test_nvidia_reads_signed_fields(gpu: ModuleType) -> None:
    margin = SimpleNamespace(ullVal=(1 << 32) - 7, siVal=-7)
    field = SimpleNamespace(nvmlReturn=0, valueType=5, value=margin)
    gpu.__dict__.update(
        NVML_VALUE_TYPE_SIGNED_INT=5,
        NVML_FI_DEV_TEMPERATURE_SHUTDOWN_TLIMIT=193,
        nvmlDeviceGetFieldValues=lambda handle, fields: [field],
    )
    meter = NvidiaML()
    meter.set_measurements(fields=[NVML_Field.NVML_FI_DEV_TEMPERATURE_SHUTDOWN_TLIMIT])
    meter.open_device(0)
    read = meter.measure()
    assert read["temperature_shutdown_tlimit"][1] == -7
    assert read["NVML_POWER_USAGE"][1] == 31_000


def test_nvidia_without_its_package_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pynvml", None)
    with pytest.raises(PluginError, match="NvidiaML needs nvidia-ml-py"):
        NvidiaML()


def test_the_current_logger_writes_its_channels(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    settings = []

    class Library:
        def PLCM3SetChannel(self, handle: Any, channel: Any, setting: Any) -> int:  # noqa: N802 - the library's name
            settings.append((channel.value, setting.value))
            return 0

        def PLCM3SetMains(self, handle: Any, is_of_60_hertz: Any) -> int:  # noqa: N802 - the library's name
            settings.append(("60 Hz", is_of_60_hertz.value))
            return 0

        def PLCM3Enumerate(self, details: Any, length: Any, kind: Any) -> int:  # noqa: N802 - the library's name
            details.value = b"CM3 01"
            return 0

        def PLCM3GetValue(self, handle: Any, channel: Any, value: Any) -> int:  # noqa: N802 - the library's name
            value._obj.value = 2500
            return 0

        def __getattr__(self, name: str) -> Any:
            return lambda *_: 0

    monkeypatch.setattr(pico, "_library", Library)
    monkeypatch.setattr(pico, "_WARM_UP_S", 0)
    meter = pico.PicoCM3(sample_frequency=0)
    meter.open_device()
    readings = iter([True, False])
    meter.log(logfile=tmp_path / "cm3.log", finished_fn=lambda: next(readings))
    assert meter.parse_log(tmp_path / "cm3.log")["channel_1"] == [2.5]
    meter.close_device()
    assert settings == [(1, 1), (2, 0), (3, 0), ("60 Hz", 0)], "as in the earlier tool: one channel, at 50 Hz"


def test_a_current_that_the_logger_has_not_measured_yet_is_no_number(monkeypatch: pytest.MonkeyPatch) -> None:
    class Library:
        def __getattr__(self, name: str) -> Any:
            return lambda *_: 0x25 if name == "PLCM3GetValue" else 0

    monkeypatch.setattr(pico, "_library", Library)
    monkeypatch.setattr(pico.PicoCM3, "enumerate_devices", lambda self: "CM3 01")
    readings = iter([True, False])
    (row,) = pico.PicoCM3(sample_frequency=0).log(finished_fn=lambda: next(readings)).values()
    assert [math.isnan(value) for value, _ in row] == [True] * 3


def test_the_card_of_a_power_meter_is_copied_into_the_run(tmp_path: Path) -> None:
    card = tmp_path / "DATA.TXT"
    card.write_text("1,2\n3,4\n")
    meter = INA219Profiler(str(card))
    assert meter.halt_and_collect_measures_from_sd_card_and_return_data() == [["1", "2"], ["3", "4"]]
    (tmp_path / "run_0").mkdir()
    meter.move_data_file_to_run_folder(SimpleNamespace(run_dir=tmp_path / "run_0"), "energy.txt")
    assert (tmp_path / "run_0" / "energy.txt").read_text() == card.read_text()


def test_a_card_that_still_holds_the_file_of_another_run_is_noticed(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    card = tmp_path / "DATA.TXT"
    meter = INA219Profiler(card)
    for run, cells in (("run_0", "1,2"), ("run_1", "3,4"), ("run_2", "3,4")):
        card.write_text(cells)
        (tmp_path / run).mkdir()
        meter.move_data_file_to_run_folder(SimpleNamespace(run_dir=tmp_path / run), "energy.txt")
    problem = f"{card} holds what it held in run_1: the energy of this run may not be in it"
    assert caplog.messages == [f"{problem} Read the card again after each run, and delete its file."]


def test_packets_between_two_addresses_are_captured(program: Callable[[str, str], Path], tmp_path: Path) -> None:
    program("tshark", f'echo "$@" > "{tmp_path}/asked"\nexec sleep 60\n')
    meter = NetworkProfiler()
    meter.start_sniffing_to_file_between_robot_and_remotepc(
        context=SimpleNamespace(run_dir=tmp_path),
        network_interface="lo",
        robot_ip_addr="10.0.0.1",
        remotepc_ip_addr="10.0.0.2",
        output_file_name="dump.pcap",
    )
    wait_for(tmp_path / "asked")
    meter.stop_sniffing()
    asked = (tmp_path / "asked").read_text().strip()
    assert asked == f"-q -i lo -f host 10.0.0.1 and host 10.0.0.2 -w {tmp_path}/dump.pcap"


UNTIL_IT_MEASURES = """
def interact(self, context):
    log, deadline = context.run_dir / "eb.csv", time.monotonic() + 60
    while not (log.is_file() and log.read_text()) and time.monotonic() < deadline:
        time.sleep(0.01)
"""


def test_self_measure_fills_its_column(
    config: Callable[..., Path], execute: Callable[..., Executed], program: Callable[[str, str], Path]
) -> None:
    binary = program("energibridge", ENERGIBRIDGE)
    head = (
        RUNNER.replace("from pathlib", "import time\nfrom pathlib")
        + f"    self_measure = True\n    self_measure_bin = {str(binary)!r}\n    self_measure_logfile = 'eb.csv'\n"
    )
    executed = execute(config(UNTIL_IT_MEASURES, head=head), Resumption(only=("run_0_repetition_0",)))
    assert executed.text.splitlines()[:2] == [
        "__run_id,__done,size,language,seconds,self-measure",
        "run_0_repetition_0,DONE,10,c,,5.5",
    ]
    assert (executed.folder / "run_0_repetition_0" / "eb.csv").read_text().startswith("Delta,Time")


def test_self_measure_without_its_program_is_refused(config: Callable[..., Path]) -> None:
    (problem,) = problems(prepare(config(head=RUNNER + "    self_measure = True\n    self_measure_bin = '/no/such'\n")))
    assert problem == (
        "self_measure_bin: there is no program '/no/such' → Install EnergiBridge and name its path, or write "
        "self_measure = False."
    )
    assert list(SelfMeasure(binary=sys.executable).check(Circumstances())) == []


WALL_SOCKET = """
def start_run(self, context):
    self.meter = WattsUpPro({port!r})

def interact(self, context):
    log, deadline = context.run_dir / "watts.log", time.monotonic() + 60
    while not self.meter.power and time.monotonic() < deadline:
        self.meter.log(0.2)
    time.sleep(0.2)
    while not (log.exists() and log.read_text()) and time.monotonic() < deadline:
        self.begun = datetime.now()
        self.meter.log(0.2, log)

def populate_run_data(self, context):
    (context.run_dir / "begun").write_text(str(self.begun))
    return {{"seconds": sum(self.meter.power) / len(self.meter.power)}}
"""


def test_a_log_of_the_meter_at_the_wall_has_only_what_came_meanwhile(
    config: Callable[..., Path], execute: Callable[..., Executed]
) -> None:
    pytest.importorskip("serial", reason="pyserial is not installed")
    meter, imports = PtyMeter(), "from Plugins.Profilers.WattsUpPro import WattsUpPro\nfrom datetime import datetime\n"
    head = RUNNER.replace("from pathlib", f"{imports}import time\nfrom pathlib")
    try:
        executed = execute(
            config(WALL_SOCKET.format(port=meter.port), head=head), Resumption(only=("run_0_repetition_0",))
        )
    finally:
        meter.close()
    assert executed.by_id["run_0_repetition_0"]["seconds"] == "42.0"
    assert meter.heard.startswith(b"#L,W,3,E,,1;")
    folder = executed.folder / "run_0_repetition_0"
    first, *_ = (folder / "watts.log").read_text().splitlines()
    assert first.endswith(" 0 42.0 230.0 0.183")
    assert first > (folder / "begun").read_text()


@pytest.fixture
def codecarbon(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """Stand in for CodeCarbon's library: what it estimates is written where it writes it."""
    library = ModuleType("codecarbon")

    class Tracker:
        def __init__(self, **settings: Any) -> None:
            self._output_dir, self._output_file = settings["output_dir"], "emissions.csv"
            self.settings = settings

        def start(self) -> None:
            Path(self._output_dir, "settings.json").write_text(json.dumps(self.settings))

        def stop(self) -> float:
            Path(self._output_dir, self._output_file).write_text("emissions,energy_consumed\n0.25,0.5\n")
            return 0.25

    library.__dict__.update(OfflineEmissionsTracker=Tracker, EmissionsTracker=Tracker)
    library.__spec__ = SimpleNamespace(name="codecarbon")  # type: ignore[assignment]
    monkeypatch.setitem(sys.modules, "codecarbon", library)
    return library


CODECARBON_METHODS = """
{table}def create_run_table_model(self):
    self.run_table_model = RunTableModel([FactorModel("n", [1, 2])], data_columns=["own"])
    return self.run_table_model

{start}def start_measurement(self, context): ...
{stop}def stop_measurement(self, context): ...
{populate}def populate_run_data(self, context): return {{"own": context.execute_run["n"]}}
"""
IMPORTS = (
    "from Plugins.Profilers import CodecarbonWrapper\n"
    "from Plugins.Profilers.CodecarbonWrapper import DataColumns as Columns\nfrom pathlib"
)


def test_codecarbon_decorates_a_class(
    config: Callable[..., Path], execute: Callable[..., Executed], codecarbon: ModuleType
) -> None:
    head = RUNNER.replace("from pathlib", IMPORTS).replace(
        "class RunnerConfig",
        "@CodecarbonWrapper.emission_tracker(data_columns=[Columns.EMISSIONS, Columns.ENERGY_CONSUMED], "
        "country_iso_code='NLD')\nclass RunnerConfig",
    )
    executed = execute(config(CODECARBON_METHODS.format(table="", start="", stop="", populate=""), head=head, table=""))
    assert executed.text == (
        "__run_id,__done,n,own,codecarbon__emissions,codecarbon__energy_consumed\n"
        "run_0_repetition_0,DONE,1,1,0.25,0.5\n"
        "run_1_repetition_0,DONE,2,2,0.25,0.5\n"
    )
    origins = {column.name: column.origin for column in read_schema(executed.folder / "run_table.schema.json")}
    assert origins["own"] == "measured"
    assert origins["codecarbon__emissions"] == origins["codecarbon__energy_consumed"] == "estimated"
    settings = json.loads((executed.folder / "run_0_repetition_0" / "settings.json").read_text())
    assert (settings["country_iso_code"], settings["project_name"]) == ("NLD", "sorting")


def test_what_codecarbon_wrote_of_a_run_before_is_not_taken_for_this_one_s(
    config: Callable[..., Path], execute: Callable[..., Executed], codecarbon: ModuleType, tmp_path: Path
) -> None:
    codecarbon.OfflineEmissionsTracker.stop = lambda self: None
    (tmp_path / "emissions.csv").write_text("emissions,energy_consumed\n0.25,0.5\n")
    settings = f"country_iso_code='NLD', output_dir={str(tmp_path)!r}"
    head = RUNNER.replace("from pathlib", IMPORTS).replace(
        "class RunnerConfig", f"@CodecarbonWrapper.emission_tracker({settings})\nclass RunnerConfig"
    )
    executed = execute(config(CODECARBON_METHODS.format(table="", start="", stop="", populate=""), head=head, table=""))
    assert [row["codecarbon__emissions"] for row in executed.table] == ["", ""]


def test_codecarbon_that_could_not_measure_leaves_cells_empty_and_says_so(
    config: Callable[..., Path], execute: Callable[..., Executed], codecarbon: ModuleType
) -> None:
    codecarbon.OfflineEmissionsTracker.stop = lambda self: None
    head = RUNNER.replace("from pathlib", IMPORTS).replace(
        "class RunnerConfig", "@CodecarbonWrapper.emission_tracker(country_iso_code='NLD')\nclass RunnerConfig"
    )
    executed = execute(config(CODECARBON_METHODS.format(table="", start="", stop="", populate=""), head=head, table=""))
    assert [row["codecarbon__emissions"] for row in executed.table] == ["", ""]
    assert executed.finished.done_count == 2
    assert any("CodeCarbon measured nothing" in warning for warning in executed.warnings)


def test_codecarbon_decorates_methods(
    config: Callable[..., Path], execute: Callable[..., Executed], codecarbon: ModuleType
) -> None:
    methods = CODECARBON_METHODS.format(
        table="@CodecarbonWrapper.add_data_columns([Columns.EMISSIONS])\n",
        start="@CodecarbonWrapper.start_emission_tracker(online=True)\n",
        stop="@CodecarbonWrapper.stop_emission_tracker\n",
        populate="@CodecarbonWrapper.populate_data_columns\n",
    )
    executed = execute(config(methods, head=RUNNER.replace("from pathlib", IMPORTS), table=""))
    assert [row["codecarbon__emissions"] for row in executed.table] == ["0.25", "0.25"]


FIRST_TABLE = """\
def create_run_table(self):
    self.run_table_model = RunTableModel([FactorModel("n", [1, 2])], data_columns=["own"])
    return self.run_table_model.generate_experiment_run_table()
"""


def test_codecarbon_s_first_version_has_a_column_of_its_own(
    config: Callable[..., Path], execute: Callable[..., Executed], codecarbon: ModuleType
) -> None:
    methods = CODECARBON_METHODS.format(
        table="@CodecarbonWrapper.add_co2_data_column\n",
        start="@CodecarbonWrapper.start_emission_tracker(country_iso_code='NLD')\n",
        stop="@CodecarbonWrapper.stop_emission_tracker\n",
        populate="@CodecarbonWrapper.populate_co2_data\n",
    )
    executed = execute(config(methods, head=RUNNER.replace("from pathlib", IMPORTS), table=""))
    assert executed.text == (
        "__run_id,__done,n,own,__co2_emissions\nrun_0_repetition_0,DONE,1,1,0.25\nrun_1_repetition_0,DONE,2,2,0.25\n"
    )


def test_codecarbon_s_second_version_made_the_table_itself_and_knew_powers(
    config: Callable[..., Path], execute: Callable[..., Executed], codecarbon: ModuleType
) -> None:
    codecarbon.OfflineEmissionsTracker.stop = lambda self: Path(self._output_dir, self._output_file).write_text(
        "emissions,cpu_power\n0.25,12.5\n"
    )
    given = "data_columns=[Columns.CPU_POWER], country_iso_code='NLD'"
    head = RUNNER.replace("from pathlib", IMPORTS).replace(
        "class RunnerConfig", f"@CodecarbonWrapper.emission_tracker({given})\nclass RunnerConfig"
    )
    methods = CODECARBON_METHODS.format(table="", start="", stop="", populate="")
    _, table, others = methods.partition("def start_measurement")
    executed = execute(config(FIRST_TABLE + table + others, head=head, table=""))
    assert [row["codecarbon__cpu_power"] for row in executed.table] == ["12.5", "12.5"]


@pytest.mark.parametrize(
    ("imported", "used", "problem"),
    [
        ("PowerJoular", "PowerJoular(target_pid=1)", "PowerJoular needs the program powerjoular, which is not here"),
        ("EnergiBridge", "EnergiBridge()", "EnergiBridge needs the program energibridge, which is not here"),
        ("PicoCM3", "PicoCM3()", "PicoCM3 needs the library plcm3, which is not here"),
    ],
)
def test_what_a_profiler_lacks_is_told_before_anything_is_executed(
    config: Callable[..., Path], imported: str, used: str, problem: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", "/nowhere")
    head = RUNNER.replace("from pathlib", f"from Plugins.Profilers.{imported} import {imported}\nfrom pathlib")
    (found,) = problems(prepare(config(f"def start_measurement(self, context): self.meter = {used}", head=head)))
    assert problem in found
    assert ":7: " in found


def test_a_profiler_that_is_imported_and_not_used_need_not_be_there(
    config: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", "/nowhere")
    head = RUNNER.replace("from pathlib", "from Plugins.Profilers.PowerJoular import PowerJoular\nfrom pathlib")
    assert prepare(config("meter: PowerJoular = None", head=head)).experiment is not None


MINI_MISSION = """
def start_run(self, context):
    self.turtlebot3.start_run_mini_mission_real_world(context)
    self.subscriber = TopicSubscriber()
    self.poses = []
    self.topic = self.subscriber.subscribe_to_topic(
        "/odom", type("Odometry", (), {"_type": "nav_msgs/Odometry"}), self.on_odometry
    )
def on_odometry(self, message): self.poses.append(message.pose.pose.position.x)
def start_measurement(self, context): self.turtlebot3.start_measurement_mission()
def launch_mission(self, context): self.turtlebot3.launch_mini_mission_real_world(context)
def stop_measurement(self, context): self.turtlebot3.stop_measurement_mission()
def stop_run(self, context):
    self.subscriber.unregister_from_single_subscription(self.topic)
    self.turtlebot3.stop_run_mission()
def populate_run_data(self, context):
    row = context.run_variation
    lines = (context.run_dir / "metrics.txt").read_text().split()
    row["avg_cpu"] = sum(float(line.split(",")[0]) for line in lines) / len(lines)
    row["reach"] = max(self.poses)
    row["levels"] = len({line.split(",")[2] for line in lines})
    return row
"""


@pytest.mark.long
def test_the_mini_mission_is_executed_on_the_embedded_robot(
    config: Callable[..., Path], execute: Callable[..., Executed], monkeypatch: pytest.MonkeyPatch
) -> None:
    def nothing() -> NoReturn:
        raise LinkError("robot is 'auto', and no robot is found", where="robot", fix="Switch it on.")

    head = (
        ROBOT.replace(
            "from pathlib",
            "from Plugins.Systems.TurtleBot3.BasicTurtleBot3 import BasicTurtleBot3\n"
            "from Plugins.Systems.TopicSubscriber import TopicSubscriber\nfrom pathlib",
        ).replace("version: int = None", "version: int = any")
        + "    turtlebot3 = BasicTurtleBot3()\n"
    )
    table = """\
    def create_run_table(self):
        columns = ["avg_cpu", "reach", "levels"]
        table = RunTableModel([FactorModel("mission_task", ["networking"])], data_columns=columns)
        table.create_experiment_run_table()
        return table.get_experiment_run_table()
"""
    path = config(MINI_MISSION, head=head, table=table)
    monkeypatch.setattr("robot_runner.ros.ros_environment.found_robot", nothing)
    assert any("no robot is found → Switch it on." in each for each in problems(prepare(path)))
    found = FoundRobot("simulated", "it is what this test has")
    monkeypatch.setattr("robot_runner.ros.ros_environment.found_robot", lambda: found)
    experiment = prepare(path).experiment
    assert experiment is not None
    assert experiment.parameters.robot == "simulated"
    executed = execute(path, robot="simulated")
    assert executed.finished.failures == ()
    row = executed.table[0]
    assert 0 < float(row["avg_cpu"]) < 100
    assert 1.5 < float(row["reach"]) < 2.5
    assert int(row["levels"]) > 2, "the level of the battery at the end stands beside each sample"


def test_a_sample_has_the_level_of_the_battery_that_was_heard_last_and_none_where_nothing_was() -> None:
    robot = BasicTurtleBot3()
    robot._battery = [(1.0, 0.8), (2.0, 0.7)]
    assert [robot._level_at(time_s) for time_s in (0.5, 1.5, 9.0)] == [pytest.approx(math.nan, nan_ok=True), 0.8, 0.7]
