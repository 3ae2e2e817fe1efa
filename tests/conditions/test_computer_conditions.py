"""Conditions of computers: here, and at the other end of a real sshd."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from contextlib import ExitStack
from typing import TYPE_CHECKING

import pytest
from tests.core.links.ssh_server import SshServer
from tests.waiting import wait_until

from robot_runner import (
    ConditionError,
    battery_above,
    clock_offset_below,
    host_answers,
    load_above,
    process_running,
    temperature_above,
    temperature_below,
    throttled,
)
from robot_runner.conditions import computers
from robot_runner.core.errors import LinkError
from robot_runner.core.events.context import SystemClock
from robot_runner.core.links.declared_host import LOCAL
from robot_runner.testing import make_context

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from robot_runner import Condition, Look, RobotRunnerContext


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SshServer]:
    started = SshServer(tmp_path_factory.mktemp("sshd"))
    yield started
    started.stop()


@pytest.fixture(params=["here", "over ssh"])
def place(request: pytest.FixtureRequest) -> dict[str, object]:
    if request.param == "here":
        return {"host": LOCAL}
    server = request.getfixturevalue("server")
    return {"host": "robot", "ssh_config": server.config}


@pytest.fixture
def context(tmp_path: Path) -> RobotRunnerContext:
    return make_context(tmp_path, clock=SystemClock(), robot=None)


def seen(context: RobotRunnerContext, condition: Condition, looks: int = 1) -> Look:
    with ExitStack() as opened:
        look_again = condition.watch(context, opened)
        for _ in range(looks - 1):
            look_again()
            time.sleep(0.3)
        return look_again()


def test_a_process_is_there_until_it_has_ended_even_if_nobody_reaps_it(
    tmp_path: Path, place: dict[str, object], context: RobotRunnerContext
) -> None:
    program = shutil.copy(shutil.which("sleep"), tmp_path / "quite(a long) name")
    process = subprocess.Popen([program, "60"])
    try:
        with ExitStack() as opened:
            by_name = process_running("quite(a long) name", **place).watch(context, opened)
            by_number = process_running(process.pid, **place).watch(context, opened)
            for look in (by_name(), by_number()):
                assert look.holds
                assert look.seen == f"process {process.pid}"
            process.kill()
            os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)  # it has ended, and is not reaped
            for look in (by_name(), by_number()):
                assert not look.holds
                assert look.seen == "no such process"
    finally:
        process.kill()
        process.wait()


@pytest.mark.long
def test_a_busy_processor_is_a_load(place: dict[str, object], context: RobotRunnerContext) -> None:
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(os.cpu_count() or 1)]
    try:
        with ExitStack() as opened:
            look_again = load_above(60, **place).watch(context, opened)
            assert look_again().seen == "the second look tells"
            time.sleep(0.5)
            look = look_again()
        assert look.holds
        assert 60 < look.value <= 100
    finally:
        for process in busy:
            process.kill()
            process.wait()


def test_a_temperature_is_read_from_the_sensor_that_is_named(
    tmp_path: Path, place: dict[str, object], context: RobotRunnerContext
) -> None:
    sensor = tmp_path / "temperature"
    with ExitStack() as opened:
        below = temperature_below(50, sensor=str(sensor), **place).watch(context, opened)
        above = temperature_above(50, sensor=str(sensor), **place).watch(context, opened)
        assert "does not report" in below().seen
        for text, is_below, is_above in (("47500\n", True, False), ("50000\n", False, False), ("51000", False, True)):
            sensor.write_text(text)
            assert (below().holds, above().holds) == (is_below, is_above)
        assert above().seen.endswith("51 °C")
        for broken in ("", "hot", "999999999", "-273000"):
            sensor.write_text(broken)
            assert not below().holds


def test_a_computer_without_the_sensor_says_so(place: dict[str, object], context: RobotRunnerContext) -> None:
    look = seen(context, temperature_below(50, sensor="no-such-zone", **place))
    assert not look.holds
    assert "does not report no-such-zone" in look.seen


def test_batteries_and_throttling_are_told_of_where_there_are_any(
    place: dict[str, object], context: RobotRunnerContext
) -> None:
    battery, held_back = seen(context, battery_above(0.5, **place)), seen(context, throttled(**place), looks=2)
    assert battery.holds or "reports no battery" in battery.seen or battery.value == 0
    assert held_back.seen


def test_the_firmware_of_a_raspberry_pi_5_tells_of_throttling(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, context: RobotRunnerContext
) -> None:
    monkeypatch.setattr(computers, "_COUNTERS", str(tmp_path / "none"))
    monkeypatch.setattr(computers, "_FIRMWARE", computers._FIRMWARE.replace("/sys", str(tmp_path)))
    file = tmp_path / "devices/platform/soc@107c000000/soc@107c000000:firmware/get_throttled"
    file.parent.mkdir(parents=True)
    file.write_text("50005\n")
    assert seen(context, throttled(), looks=2).seen.startswith("throttled (firmware 0x5")


def test_a_core_that_comes_back_with_its_old_count_is_not_throttled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, context: RobotRunnerContext
) -> None:
    monkeypatch.setattr(computers, "_COUNTERS", str(tmp_path / "cpu*_throttle_count"))
    monkeypatch.setattr(computers, "_FIRMWARE", str(tmp_path / "none"))
    first, second = (tmp_path / f"cpu{number}_throttle_count" for number in range(2))
    first.write_text("3\n")
    second.write_text("7\n")
    with ExitStack() as opened:
        look = throttled().watch(context, opened)
        assert look().seen == "not throttled"
        second.unlink()
        assert look().seen == "not throttled"
        second.write_text("7\n")
        assert look().seen == "not throttled"
        first.write_text("5\n")
        second.write_text("9\n")  # both cores tell of what happened to their package
        assert look().seen == "throttled (firmware 0x0, counted 2 times since the look before)"
        assert not look().holds


def test_a_host_answers_until_it_is_gone_and_again_when_it_is_back(
    server: SshServer, context: RobotRunnerContext, tmp_path: Path
) -> None:
    config, there = tmp_path / "ssh_config", server.config.read_text()
    config.write_text(there)
    with ExitStack() as opened:
        look = host_answers("robot", ssh_config=config).watch(context, opened)
        assert look().holds
        config.write_text(there.replace(f"Port {server.port}", "Port 1"))  # where nobody listens
        server.cut()
        wait_until(lambda: not look().holds, "the host is gone")
        assert not look().holds, "and stays so"
        config.write_text(there)
        wait_until(lambda: look().holds, "the host is back")
        assert host_answers("robot", ssh_config=config).wait(context, timeout_s=20).holds


def test_a_host_that_is_not_there_does_not_answer_and_is_found_before(
    server: SshServer, context: RobotRunnerContext, tmp_path: Path
) -> None:
    config = tmp_path / "ssh_config"
    config.write_text(server.config.read_text().replace(str(server.port), "1"))
    condition = host_answers("robot", ssh_config=config)
    look = seen(context, condition)
    assert not look.holds
    assert "Connection refused" in look.seen
    (finding,) = condition.check(None)
    assert "robot cannot be reached" in finding.problem


def test_a_clock_that_shows_the_same_is_near(server: SshServer, context: RobotRunnerContext) -> None:
    look = clock_offset_below(0.2, host="robot", ssh_config=server.config).wait(context, timeout_s=20)
    assert 0 < look.value < 0.2
    assert not seen(context, clock_offset_below(1e-9, host="robot", ssh_config=server.config)).holds


@pytest.mark.long
def test_what_names_no_computer_or_process_is_refused() -> None:
    with pytest.raises(LinkError, match="not a host that ssh could connect to"):
        host_answers("-oProxyCommand=x")
    with pytest.raises(LinkError, match="selects no process"):
        process_running("")
    with pytest.raises(ConditionError, match="'subject:Nav' is for profilers"):
        process_running("subject:Nav")
    with pytest.raises(ConditionError, match="compared with itself"):
        clock_offset_below(1, host=LOCAL)
