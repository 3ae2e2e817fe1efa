from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from tests.linked_environment import make_linked_environment
from tests.waiting import PATIENCE

import robot_runner as robot_runner_package
from robot_runner.cli.commands import doctor
from robot_runner.cli.commands.doctor import ABSENT, BROKEN, READY, UNTRIED, Question, asked, device_questions
from robot_runner.core.execution.systems_state import SystemsFile
from robot_runner.core.links.kinds import installed_links
from robot_runner.core.plugin import installed_plugins
from robot_runner.core.storage.claim_locks import HeldClaims
from robot_runner.core.storage.layout import ExperimentFolder

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    Answer = tuple[str, str, str]

#: What the core needs, and what that needs.
CORE = ("rich", "markdown-it-py", "mdurl", "pygments")


class PatientClock:
    """A clock that stands still until some questions were answered: they are in time, however busy this machine is."""

    def __init__(self, count: int) -> None:
        self._begun, self._count = time.monotonic(), count
        self._answering: list[threading.Thread] = []
        self._since: float | None = None

    def awaiting(self, answer: Callable[[], Answer]) -> Callable[[], Answer]:
        """Return a question that is one of those."""

        def ask() -> Answer:
            self._answering.append(threading.current_thread())
            return answer()

        return ask

    def monotonic(self) -> float:
        now = time.monotonic()
        if self._since is None and sum(not each.is_alive() for each in self._answering) == self._count:
            self._since = now
        return self._begun if self._since is None else self._begun + now - self._since


@pytest.fixture
def over() -> Iterator[threading.Event]:
    """Return what ends those that hang; none of their threads is left to a test that forks this process."""
    before, event = set(threading.enumerate()), threading.Event()
    yield event
    event.set()
    for each in set(threading.enumerate()) - before:
        each.join(PATIENCE)


@pytest.mark.long
def test_everything_that_is_installed_is_asked_and_told(robot_runner: Callable, program: str) -> None:
    environment = {**os.environ, "PATH": "/usr/bin:/bin"}
    told = subprocess.run([program, "doctor"], env=environment, capture_output=True, text=True, check=False)
    assert told.stderr == "" or "asked once more" in told.stderr  # on a machine that is very busy
    assert "your shell does not find this one by the name robot-runner" in told.stdout
    assert f"Say: . {Path(program).with_name('activate')}" in " ".join(told.stdout.split())
    answer = robot_runner("doctor", "--json")
    found = {(each["area"], each["name"]): each for each in answer.json["found"]}
    assert {name for area, name in found if area == "Meters"} == {each.name for each in installed_plugins("profilers")}
    assert {name for area, name in found if area == "Links"} == set(installed_links()) - {"auto"}
    assert found["Links", "simulated"]["state"] == READY
    assert {"sim", "analysis", "serial"} <= {name for area, name in found if area == "Extras"}
    assert all(each["fix"] for each in found.values() if each["state"] == BROKEN)
    assert "country" in found["Meters", "CodeCarbon"]["detail"]
    assert answer.code == any(each["state"] == BROKEN for each in found.values())
    assert all(each["name"] in told.stdout for each in found.values())


@pytest.mark.long
def test_where_the_core_alone_is_installed_all_is_told_and_nothing_has_to_be_mended(tmp_path: Path) -> None:
    program = make_linked_environment(tmp_path / "core", CORE, code=Path(robot_runner_package.__file__).parents[1])
    told = subprocess.run([program, "doctor", "--json"], capture_output=True, text=True, check=False)
    assert told.stderr == "" or "asked once more" in told.stderr  # on a machine that is very busy
    found = {each["name"]: each for each in json.loads(told.stdout)["found"]}
    assert found["sim"]["detail"] == "without mujoco and numpy"
    broken = {name: each["detail"] for name, each in found.items() if each["state"] == BROKEN}
    # Serial lines are this machine's matter.
    assert {name: detail for name, detail in broken.items() if "cannot be imported" in detail} == {}
    listed = subprocess.run([program, "plugins"], capture_output=True, text=True, check=False)
    assert (listed.returncode, listed.stderr) == (0, "")


def test_a_meter_that_has_to_be_told_more_is_said_to_be_neither_usable_nor_absent() -> None:
    wanted = [each for each in doctor.questions() if each.name in ("CodeCarbon", "TopicLatency", "PowerModel")]
    found = {each.name: each for each in asked(wanted)}
    assert {name: each.state for name, each in found.items()} == dict.fromkeys(found, UNTRIED)
    assert found["CodeCarbon"].detail == "has to be told country"
    assert found["CodeCarbon"].fix == "Try it: robot-runner try CodeCarbon --set country=..."
    assert found["TopicLatency"].detail == "has to be told cause"


@pytest.mark.long
def test_an_extra_that_is_missing_is_told_with_its_packages(
    robot_runner: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("VIRTUAL_ENV", raising=False)
    monkeypatch.setattr(doctor, "_is_installed", lambda package: package != "mujoco")
    found = {each["name"]: each for each in robot_runner("doctor", "--json").json["found"] if each["area"] == "Extras"}
    assert (found["sim"]["state"], found["sim"]["detail"]) == (ABSENT, "without mujoco")
    assert found["sim"]["fix"] == f"Install it: {shlex.quote(sys.executable)} -m pip install 'robot-runner[sim]'"
    assert found["psutil"]["state"] == READY


def test_a_device_of_another_group_is_broken_with_the_group_to_join(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "ttyUSB0").touch()
    (tmp_path / "i2c-1").touch()
    monkeypatch.setattr(doctor, "_group_of", lambda path: "dialout")
    monkeypatch.setattr(os, "access", lambda path, mode: path.name != "ttyUSB0")
    serial, bus, camera = asked(device_questions(tmp_path))
    assert serial.state == BROKEN
    assert serial.detail == f"{tmp_path}/ttyUSB0 cannot be opened: they belong to the group dialout"
    assert serial.fix == "Join the group and log in again: sudo usermod -aG dialout $USER"
    assert (bus.state, bus.detail) == (READY, f"{tmp_path}/i2c-1")
    assert (camera.state, camera.detail) == (ABSENT, "none is connected")


def test_what_hangs_or_raises_is_broken_and_the_others_are_told_at_once(
    monkeypatch: pytest.MonkeyPatch, over: threading.Event
) -> None:
    clock, began = PatientClock(2), time.monotonic()
    monkeypatch.setattr(doctor, "time", clock)

    def raising() -> Any:
        raise ZeroDivisionError("division")

    wanted = [
        Question("Meters", "Hanging", lambda: (READY, str(over.wait(60)), "")),
        Question("Meters", "Raising", clock.awaiting(raising)),
        Question("Meters", "Well", clock.awaiting(lambda: (READY, "", ""))),
    ]
    hanging, broken, well = asked(wanted, deadlines_s=(0.5, 0.1))
    assert time.monotonic() - began < 10.0
    assert hanging.state == BROKEN
    assert hanging.detail.startswith("no answer came within 0.5 s, nor in 0.1 s more")
    assert (broken.state, broken.detail) == (BROKEN, "ZeroDivisionError: division")
    assert well.state == READY


@pytest.mark.parametrize("answers_again", [True, False])
def test_what_is_slow_is_asked_once_more_and_given_more_time(
    monkeypatch: pytest.MonkeyPatch, over: threading.Event, *, answers_again: bool
) -> None:
    asked_again, told, clock = threading.Event(), [], PatientClock(1)
    monkeypatch.setattr(doctor, "time", clock)
    monkeypatch.setattr(os, "getloadavg", lambda: (9.25, 5.0, 1.0))
    monkeypatch.setattr(os, "cpu_count", lambda: 2)

    def slow() -> tuple[str, str, str]:
        """Answer at once where it is asked again, or when it is: whichever comes first counts."""
        if told:
            asked_again.set()
            return (READY, "at last", "") if answers_again else (READY, str(over.wait(60)), "")
        asked_again.wait(60)
        return (READY, "at last", "") if not answers_again else (READY, str(over.wait(60)), "")

    wanted = [Question("Links", "ros2", slow), Question("Links", "simulated", clock.awaiting(lambda: (READY, "", "")))]
    ros2, simulated = asked(wanted, deadlines_s=(0.2, 60.0), tell=told.append)
    assert (ros2.state, ros2.detail) == (READY, "at last")
    assert simulated.state == READY
    busy = "(this machine is busy: load 9.2 on 2 cores)"
    assert told == [f"ros2 did not answer within 0.2 s {busy}: asked once more, for 60 s at most"]


def test_what_stays_silent_on_a_busy_machine_says_that_it_is_busy(
    monkeypatch: pytest.MonkeyPatch, over: threading.Event
) -> None:
    monkeypatch.setattr(os, "getloadavg", lambda: (9.25, 5.0, 1.0))
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    wanted = [Question("Links", "ros2", lambda: (READY, str(over.wait(60)), ""))]
    [silent] = asked(wanted, deadlines_s=(0.1, 0.1))
    assert silent.state == BROKEN
    assert silent.detail.endswith("nor in 0.1 s more (this machine is busy: load 9.2 on 2 cores)")
    assert silent.fix == "Ask again once the machine is less busy. See whether its driver or daemon hangs."


def test_cores_that_this_process_may_not_use_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: 64)
    monkeypatch.setattr(doctor, "usable_cores", lambda: 2)
    (system,) = [each for each in doctor.questions() if each.name == "system"]
    assert next(iter(asked([system]))).detail.endswith(", 64 cores, 2 of them for this process")


@pytest.mark.long
def test_a_program_that_hangs_holds_nothing_up(tmp_path: Path, program: str) -> None:
    for name in ("perf", "docker", "nvidia-smi", "ffmpeg"):
        (tmp_path / name).write_text("#!/bin/sh\nexec sleep 300\n")
        (tmp_path / name).chmod(0o755)
    environment = {**os.environ, "PATH": f"{tmp_path}:/usr/bin:/bin"}
    began = time.monotonic()
    told = subprocess.run([program, "doctor"], env=environment, capture_output=True, text=True, check=False)
    assert time.monotonic() - began < 90.0
    assert told.returncode in {0, 1}
    assert "Devices" in told.stdout


def test_a_robot_that_a_killed_experiment_may_have_left_moving_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    (question,) = (each for each in doctor.questions() if each.area == "Robots")
    assert question.ask()[0] == READY
    folder = ExperimentFolder(tmp_path / "hall")
    folder.root.mkdir()
    with HeldClaims(["robot:dds://alice", "host:localhost"], "hall", folder.root):
        SystemsFile(folder).begin("dds://alice", {"run_id": "r_7"})
    state, detail, fix = question.ask()
    assert (state, detail.count("MAY BE MOVING")) == (BROKEN, 1)
    assert "killed in r_7 (dds://alice)" in detail
    assert str(folder.root) in detail
    assert "Start the experiment again" in fix
    folder.root.rename(tmp_path / "old hall")
    state, detail, fix = question.ask()
    assert (state, detail.count("MAY BE MOVING")) == (BROKEN, 1)
    assert "Start an experiment that uses it" in fix
