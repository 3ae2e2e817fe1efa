"""The watch in real runs: beside a real process that is busy, on this machine and over a real sshd."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from tests.meters.machine.computer_copy import ComputerCopy
from tests.waiting import wait_until

from robot_runner.core.config.preparation import prepare
from robot_runner.core.errors import PluginError
from robot_runner.core.events.context import SystemClock
from robot_runner.core.execution.notices import SilentObserver
from robot_runner.core.execution.orchestrator import execute_experiment
from robot_runner.meters.machine import machine_watch, others_load
from robot_runner.meters.machine.watched_plugins import watch_machines
from robot_runner.plugins.profilers import MachineWatch, PsUtil, Rapl
from robot_runner.testing import ProfilerContract, make_context, rehearse

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from tests.core.links.ssh_server import SshServer

    from robot_runner.core.events.context import RobotRunnerContext

pytestmark = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="Linux's /proc is not there")

#: Says at its end how much CPU time it has used itself: a truth that does not come from /proc.
BURN = """\
import sys, time
while time.process_time() < float(sys.argv[1]):
    pass
print(time.process_time(), flush=True)
input()
"""


class TestMachineWatch(ProfilerContract):
    robot = None
    is_repeatable = False

    @pytest.fixture(autouse=True)
    def _copy(self, tmp_path_factory: pytest.TempPathFactory) -> None:
        self.root = tmp_path_factory.mktemp("computer")
        ComputerCopy(self.root)

    def make_plugin(self) -> MachineWatch:
        return MachineWatch(root=self.root)


@contextmanager
def burning(cpu_seconds: float) -> Iterator[subprocess.Popen[str]]:
    words = [sys.executable, "-c", BURN, str(cpu_seconds)]
    process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def watched(folder: Path, watch: MachineWatch, mission: Callable[[], object]) -> RobotRunnerContext:
    context = make_context(folder, watch, robot=None, clock=SystemClock())
    try:
        rehearse(context, watch, mission=mission)
    finally:
        context.resources.close()
    return context


def facts(context: RobotRunnerContext, host: str = "localhost") -> dict[str, Any]:
    found: dict[str, Any] = json.loads((context.raw_data_folder / f"{host}.json").read_text(encoding="utf-8"))
    return found


def as_others(watch: MachineWatch) -> MachineWatch:
    """Take what this test starts for processes of others: the orchestrator is somebody else."""
    watch._orchestrator = 2**22 + 1
    return watch


@pytest.mark.long
def test_a_busy_process_of_others_is_named_with_the_time_that_it_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(others_load, "_LOOKED_AT", 1000)  # a machine that executes tests has many that are busier
    watch = as_others(MachineWatch())
    context = make_context(tmp_path, watch, robot=None, clock=SystemClock())
    used: dict[int, float] = {}

    def mission() -> None:
        with burning(1.0) as process:
            assert process.stdout is not None
            used[process.pid] = float(process.stdout.readline())
            watch.stop_measurement(context)  # while the process is still there

    rehearse(context, watch, mission=mission)
    found = facts(context)
    share = next(each for each in found["others"] if each["pid"] in used)
    seconds = share["percent_of_a_core"] / 100 * found["seconds"]
    assert seconds == pytest.approx(used[share["pid"]], abs=0.06)  # ticks, and its start
    assert any("took" in finding.problem for finding in context.broker.findings)


@pytest.mark.long
def test_what_the_experiment_starts_is_not_of_others(tmp_path: Path) -> None:
    pids: list[int] = []
    watch = MachineWatch(load=1e6)
    context = make_context(tmp_path, watch, robot=None, clock=SystemClock())

    def mission() -> None:
        with burning(0.5) as process:
            assert process.stdout is not None
            process.stdout.readline()
            pids.append(process.pid)
            watch.stop_measurement(context)

    rehearse(context, watch, mission=mission)
    found = facts(context)
    assert pids[0] not in {each["pid"] for each in found["others"]}
    assert found["percent_of_a_core"]["experiment"] / 100 * found["seconds"] > 0.4


def test_a_computer_that_tells_nothing_is_passed_over_in_silence(tmp_path: Path) -> None:
    (empty := tmp_path / "empty").mkdir()
    context = watched(tmp_path / "results", MachineWatch(root=empty), lambda: time.sleep(0.01))
    assert context.broker.findings == ()
    assert facts(context)["percent_of_a_core"]["busy"] is None


def test_the_last_look_is_compared_with_the_first(tmp_path: Path) -> None:
    copy = ComputerCopy(tmp_path / "computer")
    copy.process(7, "chromium", ticks=100)

    def mission() -> None:
        time.sleep(0.2)
        copy.process(7, "chromium", ticks=160)
        copy.write("sys/devices/system/cpu/cpu0/thermal_throttle/core_throttle_count", 9)

    context = watched(tmp_path / "results", MachineWatch(root=copy.root), mission)
    said = [finding.problem for finding in context.broker.findings]
    assert len(said) == 1
    assert said[0].startswith("another process (chromium, pid 7) took ")
    assert "throttled for heat 8 times during r_1 (the hottest zone had 62 °C)" in said[0]


@pytest.mark.long
def test_a_measure_of_the_computer_is_doubted_and_others_are_not(
    tmp_path: Path, write_config: Callable[..., Path]
) -> None:
    copy = ComputerCopy(tmp_path / "computer")
    copy.process(7, "chromium", ticks=100)
    config = write_config(
        f"""
    plugins = [MachineWatch(name="watch", hosts=[], root={str(copy.root)!r}), PsUtil(host="localhost"), Constant()]

    def launch_mission(self, context):
        time.sleep(0.2)
        stat = Path({str(copy.root / "proc/7/stat")!r})
        stat.write_text(stat.read_text().replace(" 96 4 ", " 196 4 "))
""",
        head=CONSTANT,
    )
    preparation = prepare(config)
    assert preparation.experiment is not None, preparation.findings
    finished = execute_experiment(preparation.experiment, SilentObserver())
    assert finished.failed_count == 0
    records = [json.loads(line) for line in preparation.experiment.folder.journal.read_text().splitlines()]
    doubts = [each for each in records if each["kind"] == "finding"]
    assert {each["owner"] for each in doubts} == {"PsUtil"}
    # On a busy machine, samples are late as well.
    watched = [each for each in doubts if "chromium, pid 7" in each["problem"]]
    assert [each["measures"] for each in watched] == [["CPU", "Memory"]]


CONSTANT = """\
import time
from pathlib import Path

from robot_runner import ExperimentConfig, Factor, RunTableModel
from robot_runner.plugins import Measure, Profiler
from robot_runner.plugins.profilers import MachineWatch, PsUtil


class Constant(Profiler):
    measures = (Measure("One", "1", "The number one."),)

    def populate_run_data(self, context):
        context.publish("One", 1)


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "watched"
    results_output_path = Path(__file__).parent
"""


def test_watching_begins_where_a_profiler_measures_a_computer_and_ends_with_one_parameter() -> None:
    class Wanted:
        watch_machines = True

    class Unwanted:
        watch_machines = False

    measuring = [PsUtil(host="localhost"), Rapl()]
    (watch,) = watch_machines(Wanted(), measuring)  # type: ignore[arg-type]
    assert watch.name == "machine"
    assert list(watch_machines(Unwanted(), measuring)) == []  # type: ignore[arg-type]
    assert list(watch_machines(Wanted(), [])) == []  # type: ignore[arg-type]
    assert list(watch_machines(Wanted(), [PsUtil()])) == []  # type: ignore[arg-type]  # a simulated computer
    assert list(watch_machines(Wanted(), [*measuring, MachineWatch()])) == []  # type: ignore[arg-type]  # listed already
    (renamed,) = watch_machines(Wanted(), [Rapl(name="Machine")])  # type: ignore[arg-type]
    assert renamed.name == "machine-2"


def test_parameters_that_cannot_be_are_refused() -> None:
    with pytest.raises(PluginError, match="load is 0"):
        MachineWatch(load=0)
    with pytest.raises(PluginError, match="hosts is 'pi@robot'"):
        MachineWatch(hosts="pi@robot")


@pytest.mark.long
@pytest.mark.parametrize("form", ["python3", "sh"])
def test_a_computer_over_ssh_is_watched_as_well(
    tmp_path: Path, server: SshServer, form: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(others_load, "_LOOKED_AT", 1000)  # as above
    watch = MachineWatch(hosts=())
    watch.attach([PsUtil(name="MachineWatch", host="robot", ssh_config=server.config, form=form)])
    context = make_context(tmp_path, watch, robot=None, clock=SystemClock())
    pids: list[int] = []

    def mission() -> None:
        with burning(1.0) as process:
            assert process.stdout is not None
            process.stdout.readline()
            pids.append(process.pid)
            watch.stop_run(context)  # the last look over ssh is taken there

    try:
        rehearse(context, watch, mission=mission)
    finally:
        context.resources.close()
    found = facts(context, "robot")
    assert found["percent_of_a_core"]["busy"] > 0
    share = next(each for each in found["others"] if each["pid"] == pids[0])
    assert share["percent_of_a_core"] / 100 * found["seconds"] == pytest.approx(1.0, abs=0.1)


def test_a_computer_that_cannot_be_reached_costs_the_watch_and_not_the_run(tmp_path: Path, server: SshServer) -> None:
    watch = MachineWatch(hosts=())
    watch.attach([PsUtil(host="nobody-is-here", ssh_config=server.config)])
    context = watched(tmp_path, watch, lambda: None)
    assert context.broker.findings[0].problem.startswith("nobody-is-here cannot be watched")


def test_looking_costs_less_than_a_thousandth_of_a_core_in_a_mission_of_a_minute(tmp_path: Path) -> None:
    watch = MachineWatch(load=1e6)
    context = make_context(tmp_path, watch, robot=None, clock=SystemClock())
    before = time.process_time()
    rehearse(context, watch)
    spent = time.process_time() - before
    processes = sum(1 for path in Path("/proc").iterdir() if path.name.isdigit())
    assert spent < 0.06 * max(1.0, processes / 200)


def test_a_moment_of_under_voltage_of_a_raspberry_pi_is_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Its kernel takes the firmware's flags back after two seconds: a look every five seconds would miss them.
    monkeypatch.setattr(machine_watch, "_PERIOD", 1e6)
    monkeypatch.setattr(machine_watch, "_PERIOD_OF_FLAGS", 0.01)
    copy, file = ComputerCopy(tmp_path), "sys/devices/platform/soc/soc:firmware/get_throttled"
    copy.write(file, "0")
    watch = MachineWatch(root=tmp_path)

    def has_looked() -> bool:
        return any(each.firmware_flags for each in watch._watched[0]._poller._readings)

    def mission() -> None:
        copy.write(file, "50000")
        wait_until(has_looked)
        copy.write(file, "0")

    context = watched(tmp_path / "run", watch, mission)
    told = [finding.problem for finding in context.broker.findings]
    assert any("the firmware reported under-voltage and throttling" in problem for problem in told)
