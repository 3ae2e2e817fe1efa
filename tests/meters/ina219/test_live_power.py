"""The power is shown while the meter is read, a simulated one too, and what is measured stays the same."""

from __future__ import annotations

import os
import struct
import threading
import time
import tty
from typing import TYPE_CHECKING

import pytest
from tests.meters.scripted_meter import frame, hello, sample

from robot_runner.core.events.context import SystemClock
from robot_runner.measuring import live_samples
from robot_runner.meters.ina219.line_meter import LineMeter, SharedLine
from robot_runner.plugins.profilers import Ina219, PsUtil
from robot_runner.testing import Chunk, FakeClock, FakeSerialLine, make_context, rehearse

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


@pytest.fixture
def port() -> Iterator[str]:
    """A meter at the other end of a pseudo-terminal: 0.613 A at 12.4 V, 100 samples a second."""
    device, host = os.openpty()
    tty.setraw(device)
    tty.setraw(host)
    ended = threading.Event()

    def send() -> None:
        began = time.monotonic()
        for number in range(2000):
            moment = time.monotonic() - began
            os.write(device, sample(number, int(moment * 1e6)))
            if ended.wait(max(0.0, (number + 1) / 100 - moment)):
                return

    sender = threading.Thread(target=send)
    sender.start()
    yield os.ttyname(host)
    ended.set()
    sender.join()
    os.close(device)
    os.close(host)


def test_the_power_is_shown_while_it_is_measured_and_gone_when_the_samples_are_there(tmp_path: Path, port: str) -> None:
    profiler = Ina219(port=port, rate_hz=100.0)
    context = make_context(tmp_path, profiler, clock=SystemClock(), robot=None)
    shown = context.raw_data_folder / ".samples.csv.live"
    seen = []

    def mission() -> None:
        deadline = time.monotonic() + 20.0
        while len(seen) < 3 and time.monotonic() < deadline:
            time.sleep(0.05)
            seen[:] = shown.read_text(encoding="utf-8").splitlines() if shown.exists() else []

    rehearse(context, profiler, mission=mission)
    heading, *rows = seen
    assert heading == "time_s,power_W"
    assert [float(row.split(",")[1]) for row in rows] == [pytest.approx(0.613 * 12.4)] * len(rows)
    assert not shown.exists()
    # A busy machine may leave no value of so short a mission, and never a wrong one.
    assert context.measures["MeanPower"] in (None, pytest.approx(0.613 * 12.4))
    assert (context.raw_data_folder / "samples.csv").exists()


@pytest.mark.parametrize(
    ("profiler", "heading"), [(Ina219, "time_s,power_W"), (PsUtil, "time_s,cpu_percent,memory_percent")]
)
def test_a_simulated_meter_is_shown_as_a_real_one_and_its_samples_are_those_of_a_run_that_nobody_watches(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, profiler: type[Ina219 | PsUtil], heading: str
) -> None:
    def executed(folder: str, every: float) -> tuple[list[str], bytes, dict[str, object]]:
        monkeypatch.setattr(live_samples, "_EVERY", every)
        meter = profiler()
        context = make_context(tmp_path / folder, meter)
        shown = context.raw_data_folder / ".samples.csv.live"
        seen: list[str] = []

        def mission() -> None:
            context.clock.sleep(3.3)
            seen[:] = shown.read_text(encoding="utf-8").splitlines()

        measures = dict(rehearse(context, meter, mission=mission))
        context.resources.close()
        assert not shown.exists()
        return seen, (context.raw_data_folder / "samples.csv").read_bytes(), measures

    (told, *rows), samples, measures = executed("watched", 0.0)
    assert told == heading
    times = [float(row.split(",")[0]) for row in rows]
    assert times == sorted(times)
    assert len(times) >= 6
    values = [float(cell) for row in rows[1:] for cell in row.split(",")[1:]]
    assert all(0 < value < 100 for value in values)
    assert executed("unwatched", float("inf"))[1:] == (samples, measures)


def test_the_first_sensor_is_shown_where_its_address_is_named() -> None:
    clock = FakeClock()
    told = frame(0x14, 0, struct.pack("<IBIHIB", 0, 0x40, 100_000, 0x1CCF, 0, 1))
    line = FakeSerialLine(clock, [Chunk(0.0, hello(0, 0) + told + sample(0, 0))])
    meter = LineMeter(SharedLine(line), clock, address=0x40)
    meter.begin()
    assert meter.latest_power() == pytest.approx(0.613 * 12.4)
