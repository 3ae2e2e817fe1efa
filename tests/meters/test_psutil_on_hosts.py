"""PsUtil on this machine, and on board over a real sshd; skipped where psutil or OpenSSH's server is not installed."""

from __future__ import annotations

import csv
import json
from typing import TYPE_CHECKING

import pytest
from tests.measuring.busy_core import busy_core, needs_affinity, wait, wait_for_samples
from tests.meters.rehearsed import InRealTime

from robot_runner.core.config.preparation import prepare_or_refuse
from robot_runner.core.events.context import SystemClock
from robot_runner.core.events.measure import Origin
from robot_runner.core.execution.notices import SilentObserver
from robot_runner.core.execution.orchestrator import execute_experiment
from robot_runner.measuring.on_board_sampler import OnBoardSampler
from robot_runner.plugins.profilers import PsUtil
from robot_runner.testing import ProfilerContract, make_context, rehearse

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from tests.core.links.ssh_server import SshServer

    from robot_runner.core.events.context import RobotRunnerContext
    from robot_runner.core.events.measure import MeasureValue

psutil = pytest.importorskip("psutil", reason="psutil samples this machine: pip install 'robot-runner[psutil]'")


class TestPsUtilOnThisMachine(InRealTime, ProfilerContract):
    robot = None
    is_repeatable = False
    measuring_seconds = 0.2

    def make_plugin(self) -> PsUtil:
        return PsUtil(host="localhost", rate_hz=50.0, processes=["pid:1"], cores=[0])


def measured(folder: Path, plugin: PsUtil, seconds: float) -> RobotRunnerContext:
    context = make_context(folder, plugin, robot=None, clock=SystemClock())
    try:
        rehearse(context, plugin, mission=lambda: wait(seconds))
    finally:
        context.resources.close()
    return context


@pytest.mark.long
@needs_affinity
@pytest.mark.parametrize("where", ["here", "on board"])
def test_a_busy_core_reads_100_percent(tmp_path: Path, server: SshServer, where: str) -> None:
    with busy_core() as busy:
        place = {"host": "localhost"} if where == "here" else {"host": "robot", "ssh_config": server.config}
        measures: Mapping[str, MeasureValue] = {}
        # On a starved machine there may be no two readings within the window, and then rightly no value.
        for attempt in range(5):
            context = measured(tmp_path / str(attempt), PsUtil(cores=[busy.core], processes=[busy.pid], **place), 1.5)
            measures = context.measures
            if measures[f"CPU_core{busy.core}"] is not None:
                break
    assert measures[f"CPU_core{busy.core}"] == pytest.approx(100.0, abs=2.0)
    assert 0.0 < measures[f"CPU_{busy.pid}"] <= 100.0
    assert measures["CPU"] >= 100.0 / psutil.cpu_count() - 2.0
    assert {each.origin for each in context.broker.measures.values()} == {Origin.MEASURED}


def test_raw_samples_keep_the_robots_own_time_and_quality_its_clock(tmp_path: Path, server: SshServer) -> None:
    context = measured(tmp_path, PsUtil(host="robot", ssh_config=server.config, rate_hz=50.0), 0.5)
    with (context.raw_data_folder / "samples.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert rows[0]["cpu_percent"] == ""
    assert {"time_s", "cpu_core0_percent", "memory_percent", "host_time_s"} <= rows[0].keys()
    facts = json.loads((context.raw_data_folder / "quality.json").read_text())
    assert facts["clock"]["host"] == "robot"
    assert abs(facts["samples"]["clock_offset"]) < 0.1
    assert 0.0 < facts["samples"]["clock_uncertainty"] < 0.1
    assert 0.0 < facts["samples"]["cpu_seconds"] < 0.3
    assert facts["form"].startswith("a loop in Python")
    kinds = [kind for kind, _ in context.broker.records]
    assert kinds.count("clock") == 1


def test_a_lost_connection_is_reported_and_the_samples_are_kept(tmp_path: Path, server: SshServer) -> None:
    plugin = PsUtil(host="robot", ssh_config=server.config, rate_hz=50.0, is_streamed=True)
    context = make_context(tmp_path, plugin, robot=None, clock=SystemClock())

    def mission() -> None:
        assert isinstance(plugin._sampler, OnBoardSampler)
        wait_for_samples(10, plugin._sampler)
        server.cut()
        wait(0.5)

    rehearse(context, plugin, mission=mission)
    context.resources.close()
    problems = [finding.problem for finding in context.broker.findings]
    assert "the connection is lost" in problems[0]
    assert "samples that had arrived by then are kept" in problems[1]
    assert any("the largest gap" in problem for problem in problems)
    assert context.measures["CPU"] is None
    assert len((context.raw_data_folder / "samples.csv").read_text().splitlines()) >= 10


HEAD = """\
from robot_runner import *
from robot_runner.plugins.profilers import PsUtil


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    results_output_path = "results"
"""
CONFIG = """\
    robot = None
    probe = False
    plugins = [PsUtil(host="robot", ssh_config="{config}", rate_hz=50.0)]

    def launch_mission(self, context):
        context.clock.sleep(0.2)
"""
TABLE = """\
    def create_run_table(self):
        return RunTableModel([Factor("Task", ["Video", "Network"])], data_columns=["CPU"], seed=1)
"""


@pytest.mark.long
@pytest.mark.filterwarnings("ignore:.*multi-threaded:DeprecationWarning")
def test_an_experiment_keeps_the_clocks_of_its_hosts_in_the_manifest(
    write_config: Callable[..., Path], server: SshServer
) -> None:
    path = write_config(CONFIG.format(config=server.config), table=TABLE, head=HEAD)
    experiment = prepare_or_refuse(path)
    finished = execute_experiment(experiment, SilentObserver())
    assert finished.done_count == 2
    manifest = json.loads(experiment.folder.manifest.read_text())
    clock = manifest["clocks"]["robot"]
    assert clock["runs"] == 2
    assert abs(clock["largest_offset_s"]) < 0.1
    assert 0.0 < clock["largest_uncertainty_s"] < 0.1
    journal = [json.loads(line) for line in experiment.folder.journal.read_text().splitlines()]
    kept = [record for record in journal if record["kind"] == "clock"]
    assert [record["run"] for record in kept] == ["r_1", "r_2"]
    assert kept[0]["after"]["round_trip"] > 0.0
