from __future__ import annotations

import json
import subprocess
import sys
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.event_deadline import enforce_deadline_in

from robot_runner.core.execution import probe

Program = Callable[..., Any]

#: Opens a pseudo terminal, says its name, and talks like a device that is no power meter.
DEVICE = r"""
import os, random, sys, time, tty
board, host = os.openpty()
tty.setraw(host)
print(os.ttyname(host), flush=True)
chance = random.Random(1)
said = {
    "silent": lambda: b"",
    "random bytes": lambda: chance.randbytes(100),
    "a GPS receiver": lambda: b"$GPGGA,092750.000,5321.6802,N,00630.3372,W,1,8,1.03,61.7,M,55.2,M,,*76\r\n",
}[sys.argv[1]]
os.set_blocking(board, False)
while True:
    try:
        os.write(board, said())
    except BlockingIOError:  # nobody reads
        pass
    time.sleep(0.01)
"""
CONFIG = """\
from pathlib import Path
from robot_runner import *
from robot_runner.plugins.profilers import Ina219


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "metered"
    results_output_path = Path("results")
    attempts = 2
    plugins = [Ina219(port={port!r})]

    def launch_mission(self, context):
        Path("moved").touch()

    def create_run_table(self):
        return RunTableModel([Factor("Load", ["same"])], data_columns=["Energy"])
"""


@pytest.fixture(params=["silent", "random bytes", "a GPS receiver"])
def strange_port(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """The port of a device that is no power meter; nobody waits for a board to boot."""
    monkeypatch.setattr("robot_runner.meters.ina219.line_meter._PATIENCE", 0.3, raising=False)
    command = [sys.executable, "-c", DEVICE, request.param]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as device:
        assert device.stdout is not None
        yield device.stdout.readline().strip()
        device.kill()


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_meter_that_does_not_speak_refuses_the_experiment_before_the_robot_moves(
    robot_runner: Program, here: Path, strange_port: str
) -> None:
    (here / "study.py").write_text(CONFIG.format(port=strange_port), encoding="utf-8")
    result = robot_runner("study.py")
    assert result.code == 2, result
    assert "plugin Ina219: the probe got no value of Energy" in result.err
    assert "--no-probe" in result.err
    assert not (here / "moved").exists()


def test_trying_a_meter_that_does_not_speak_does_not_go_well(robot_runner: Program, strange_port: str) -> None:
    result = robot_runner("try", "Ina219", "--set", f"port={strange_port}", "--seconds", "0.5")
    assert result.code == 1
    assert "failed: the plugin measured nothing: no value of Energy, EnergyPt and MeanPower" in result.out


METERS = '''\
from pathlib import Path
import os, signal, time
from robot_runner import *
from robot_runner.plugins import Measure, Profiler, System

MAIN = os.getpid()


def told(what):
    with open("told.txt", "a") as file:
        file.write(what + "\\n")


class Meter(Profiler):
    probe_s = 0.05

    def __init__(self, name, value=1.0, doubt="", unit="W"):
        super().__init__(name=name)
        self.measures = (Measure(f"Power_{name}", unit, "Power."), Measure(f"Spare_{name}", "W", "Never there."))
        self.value, self.doubt = value, doubt

    def start_measurement(self, context):
        (context.raw_data_folder / "samples.csv").touch()
        told(f"{self.name} at {context.run_id} of {context.combination['Load']}: {context.raw_data_folder}")

    def launch_mission(self, context):
        told(f"{self.name}: mission")

    def populate_run_data(self, context):
        if self.doubt:
            context.doubt(self.doubt, fix="Look at it.")
        context.publish(self.measures[0].name, self.value)
        context.publish(self.measures[1].name, None)


class Broken(Meter):
    def start_measurement(self, context):
        raise OSError("no such device")


class Hanging(Meter):
    def start_measurement(self, context):
        time.sleep(60)


class Interrupting(Meter):
    def start_measurement(self, context):
        os.kill(MAIN, signal.SIGINT)
        time.sleep(60)


class Watch(Profiler):
    def start_measurement(self, context):
        told("watch")


class Early(Meter):
    """Sets something up that a probe does not."""

    def before_run(self, context):
        self.is_set_up = True

    def start_measurement(self, context):
        assert self.is_set_up


class Robot(System):
    def start_run(self, context):
        told("robot")


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "metered"
    results_output_path = Path("results")
    plugins = [{plugins}]
{settings}

    def before_experiment(self, context):
        told("before")

    def launch_mission(self, context):
        told("mission")

    def create_run_table(self):
        return RunTableModel([Factor("Load", ["heavy"])])
'''


@pytest.fixture
def study(here: Path) -> Callable[..., Path]:
    """Return what writes a config with these plugins."""

    def write(plugins: str, settings: str = "") -> Path:
        path = here / "study.py"
        config = METERS.replace("{plugins}", plugins).replace("{settings}", textwrap.indent(settings, "    "))
        path.write_text(config, encoding="utf-8")
        return path

    return write


def told(here: Path) -> list[str]:
    path = here / "told.txt"
    return path.read_text(encoding="utf-8").splitlines() if path.exists() else []


def probes(here: Path) -> list[dict[str, Any]]:
    journal = here / "results" / "metered" / "journal.jsonl"
    records = map(json.loads, journal.read_text(encoding="utf-8").splitlines())
    return [record for record in records if record["kind"] == "probe"]


def test_a_probe_comes_before_everything_else_and_calls_profilers_alone(
    robot_runner: Program, study: Callable[..., Path], here: Path
) -> None:
    study("Robot(), Meter('A'), Meter('B')")
    assert robot_runner("study.py").code == 0
    *probed, before = told(here)[:3]
    assert [line.partition(":")[0] for line in probed] == ["A at probe of heavy", "B at probe of heavy"]
    assert before == "before"
    folders = [Path(line.partition(": ")[2]) for line in probed]
    experiment = here / "results" / "metered"
    assert not any(folder.exists() or experiment / "runs" in folder.parents for folder in folders)
    assert not list(experiment.glob(".aside-*"))


@pytest.mark.parametrize(
    ("robot", "seconds"), [('"ros2://alice"', "500 ms"), ('Robots("ros2://alice", "ros2://bob")', "1.0 s")]
)
def test_a_plan_tells_how_long_the_probe_takes_beside_one_robot_after_another(
    robot_runner: Program, here: Path, robot: str, seconds: str
) -> None:
    (here / "study.py").write_text(f"""\
from robot_runner import ExperimentConfig, Factor, Robots, RunTableModel
from robot_runner.plugins.profilers import Ina219


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "metered"
    robot = {robot}
    plugins = [Ina219()]

    def duration_s(self, combination):
        return 60.0

    def create_run_table(self):
        return RunTableModel([Factor("Speed", [1, 2])], data_columns=["Energy"])
""")
    assert f"the probe of the profilers, {seconds}" in " ".join(robot_runner("plan", "study.py").out.split())


def test_what_a_probe_saw_is_in_the_journal_and_its_doubts_are_shown(
    robot_runner: Program, study: Callable[..., Path], here: Path
) -> None:
    study("Meter('A', doubt='the sensor is hot: 81 degC')")
    answer = robot_runner("study.py")
    assert answer.code == 0
    assert "the probe is doubtful: the sensor is hot: 81 degC" in " ".join(answer.out.split())
    [probe] = probes(here)
    seen = {
        "measures": {"Power_A": 1.0, "Spare_A": None},
        "reasons": ["the sensor is hot: 81 degC"],
        "failure": "",
    }
    assert probe["profilers"] == {"A": seen}


def test_all_profilers_that_do_not_measure_are_found_at_once(
    robot_runner: Program, study: Callable[..., Path], here: Path
) -> None:
    study("Broken('A'), Meter('B', None, 'nothing came'), Broken('C'), Meter('D')")
    answer = robot_runner("study.py")
    assert answer.code == 2
    assert "plugin A: the probe failed: start_measurement of A: OSError: no such device" in answer.err
    assert "plugin B: the probe got no value of Power_B and Spare_B: nothing came" in answer.err
    assert "plugin C: the probe failed" in answer.err
    assert "plugin D" not in answer.err
    assert "before" not in told(here)


def test_a_refused_experiment_can_be_mended_and_started(robot_runner: Program, study: Callable[..., Path]) -> None:
    study("Broken('A')")
    assert robot_runner("study.py").code == 2
    study("Meter('A')")
    assert robot_runner("study.py").code == 0


def test_a_profiler_that_hangs_is_ended(
    robot_runner: Program, study: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(probe, "_PATIENCE", 0.2)
    enforce_deadline_in("start_measurement", monkeypatch)
    study("Hanging('A'), Meter('B', None)", "grace_in_s = 1.0")
    answer = robot_runner("study.py")
    assert answer.code == 2
    assert "plugin A: the probe failed: start_measurement of A: the event took longer than" in answer.err
    assert "plugin B: the probe got no value" in answer.err


@pytest.mark.parametrize(
    ("words", "settings"),
    [(["--no-probe"], ""), (["--set", "probe=false"], ""), ([], "probe = False")],
    ids=["option", "set", "config"],
)
def test_one_can_go_without_a_probe(
    words: list[str], settings: str, robot_runner: Program, study: Callable[..., Path], here: Path
) -> None:
    study("Meter('A', None)", settings)
    assert robot_runner("study.py", *words).code == 0
    assert told(here)[0] == "before"
    assert probes(here) == []


def test_profilers_that_tell_nothing_before_the_mission_are_left_out(
    robot_runner: Program, study: Callable[..., Path], here: Path
) -> None:
    path = study("Early('A'), meter, Watch()")
    config = path.read_text(encoding="utf-8")
    unprobed = "meter = Meter('B')\nmeter.probe_s = None\n\n\nclass RobotRunner"
    path.write_text(config.replace("class RobotRunner", unprobed), encoding="utf-8")
    assert robot_runner("study.py").code == 0
    assert probes(here) == []


def test_a_probe_can_be_interrupted(robot_runner: Program, study: Callable[..., Path], here: Path) -> None:
    study("Interrupting('A')")
    assert robot_runner("study.py").code == 130
    assert "mission" not in told(here)


def test_a_profiler_is_probed_with_the_treatments_of_the_first_run(
    robot_runner: Program, study: Callable[..., Path], here: Path
) -> None:
    study("Meter('A', value=treatment('Load'), unit='')")
    assert robot_runner("study.py").code == 0
    [probe] = probes(here)
    assert probe["profilers"]["A"]["measures"]["Power_A"] == "heavy"


@pytest.mark.long
def test_each_execution_that_has_something_to_do_begins_with_a_probe(
    robot_runner: Program, study: Callable[..., Path], here: Path
) -> None:
    study("Meter('A')")
    for _ in range(2):
        assert robot_runner("study.py").code == 0
    assert len(probes(here)) == 1
    assert robot_runner("run", "study.py", "--redo", "r_1").code == 0
    assert len(probes(here)) == 2


def test_a_check_probes_on_request(robot_runner: Program, study: Callable[..., Path], here: Path) -> None:
    study("Meter('A')")
    assert "Power_A" not in robot_runner("check", "study.py").out.partition("Measures")[0]
    assert told(here) == []
    answer = robot_runner("check", "study.py", "--probe")
    assert answer.code == 0
    assert "A: Power_A 1.000 W, Spare_A " in answer.out
    assert not (here / "results").exists()
    study("Meter('A', None, 'nothing came')")
    answer = robot_runner("check", "study.py", "--probe", "--json")
    assert answer.code == 2
    assert [finding["where"] for finding in answer.json["findings"]] == ["plugin A"]
    assert answer.json["probe"]["profilers"]["A"]["reasons"] == ["nothing came"]


TWO_ROBOTS = """\
from pathlib import Path
from robot_runner import *
from robot_runner.plugins import Finding, Measure, Profiler


class Meter(Profiler):
    measures = (Measure("Energy", "J"),)
    probe_s = 0.1

    def check(self, circumstances):
        found = [Finding.warning("Meter", "it is an old one")]
        if circumstances.robot.endswith("{unknown}"):
            found.append(Finding.{severity}("Meter", "it does not know this robot", "Name another."))
        return found

    def populate_run_data(self, context):
        if not context.robot.endswith("9"):
            context.publish("Energy", 1.0)


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "metered"
    results_output_path = Path("results")
    robot = Robots(alice="rosbridge://127.0.0.1:8", bob="rosbridge://127.0.0.1:9")
    plugins = [Meter()]

    def create_run_table(self):
        return RunTableModel([Factor("Load", ["same"])], repetitions=2, data_columns=["Energy"])
"""


@pytest.mark.long
def test_of_several_robots_each_is_checked_and_probed_and_findings_name_it(robot_runner: Program, here: Path) -> None:
    config = here / "study.py"
    config.write_text(TWO_ROBOTS.format(unknown="8", severity="error"), encoding="utf-8")
    refused = robot_runner("check", "study.py")
    assert refused.code == 2
    assert "Meter, robot alice: it does not know this robot" in refused.err + refused.out
    assert "robot bob: it does not know" not in refused.err + refused.out
    assert (refused.err + refused.out).count("it is an old one") == 1

    config.write_text(TWO_ROBOTS.format(unknown="none", severity="error"), encoding="utf-8")
    result = robot_runner("study.py")
    assert result.code == 2, result
    assert "plugin Meter, robot bob: the probe got no value of Energy" in result.err
    assert "robot alice" not in result.err
    seen = robot_runner("check", "study.py", "--probe", "--json").json["probe"]
    assert seen["profilers"]["Meter, robot alice"]["measures"] == {"Energy": 1.0}


def test_for_a_cluster_this_machine_is_not_probed_and_what_it_lacks_is_a_warning(
    robot_runner: Program, here: Path
) -> None:
    text = TWO_ROBOTS.replace('Robots(alice="rosbridge://127.0.0.1:8", bob="rosbridge://127.0.0.1:9")', '"simulated"')
    text = text.replace('context.robot.endswith("9")', "True").format(unknown="simulated", severity="error")
    (here / "study.py").write_text(text, encoding="utf-8")
    assert robot_runner("check", "study.py").code == 2
    seen = robot_runner("check", "study.py", "--probe", "--json", "--set", "cluster=tcp://127.0.0.1:1").json
    assert seen["is_executable"], seen
    problem = "on this machine: it does not know this robot; each worker is looked at when it joins"
    assert problem in [finding["problem"] for finding in seen["findings"]]
    assert seen["probe"]["profilers"] == {}
