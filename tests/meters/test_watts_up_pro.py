from __future__ import annotations

import contextlib
import csv
import json
import os
import pty
import threading
import tty

import pytest

from robot_runner.core.errors import LinkError, PluginError
from robot_runner.core.events.context import SystemClock
from robot_runner.core.events.measure import Origin
from robot_runner.meters.watts_up_pro import parse_record
from robot_runner.plugins import Circumstances
from robot_runner.plugins.profilers import WattsUpPro
from robot_runner.testing import Chunk, FakeClock, FakeSerialLine, ProfilerContract, make_context, rehearse

PORT = "/dev/null"  # a character device, so that the check has nothing against it


def record(watts: float, volts: float = 230.0, *, factor: float = 1.0) -> bytes:
    """Return a record as the meter sends it: tenths of watts (times a factor) and volts, thousandths of amperes."""
    fields = (round(10 * watts * factor), round(10 * volts), round(1000 * watts / volts))
    return b"#d,-,18,%d,%d,%d,0,0,0,0,9999,9999,9999,0,0,0,100,60,0,500,0;\r\n" % fields


def line_on(clock, power, *, seconds=40, factor=1.0, **script) -> FakeSerialLine:
    start = clock.now()
    greeting = Chunk(start + 0.2, b"#h,-,18,W,V,A,WH,Cost;\r\n")
    chunks = [Chunk(start + number + 0.5, record(power(number), factor=factor)) for number in range(seconds)]
    return FakeSerialLine(clock, [greeting, *chunks], **script)


def context_with(folder, plugin, clock, line):
    context = make_context(folder, plugin, robot=None, clock=clock)
    context.resources.open(f"port {plugin.port}", lambda: line)
    return context


class TestWattsUpProOnAScriptedLine(ProfilerContract):
    robot = None
    measuring_seconds = 3.0

    def make_plugin(self) -> WattsUpPro:
        return WattsUpPro(port=PORT)

    def make_context(self, folder, plugin, *, run_seed=1):
        clock = FakeClock()
        return context_with(folder, plugin, clock, line_on(clock, lambda _: 60.0))


@pytest.fixture
def measure(tmp_path):
    def execute(power, *, seconds=10.0, line=line_on, **script):
        clock, plugin = FakeClock(100.0), WattsUpPro(port=PORT)
        serial = line(clock, power, **script)
        context = context_with(tmp_path, plugin, clock, serial)
        rehearse(context, plugin, mission=lambda: clock.sleep(seconds))
        return context, serial

    return execute


def test_each_record_tells_of_the_second_before_it(measure):
    context, _ = measure(lambda number: 100.0 if number <= 5 else 50.0)
    # The window begins with the first record, so five records of 100 W and five of 50 W tell of it.
    assert context.measures["Energy"] == pytest.approx(750.0, rel=0.01)
    assert context.measures["MeanPower"] == pytest.approx(75.0, rel=0.01)
    assert context.broker.findings == ()
    assert context.broker.measures["Energy"].origin is Origin.MEASURED


def test_a_meter_that_is_stuck_is_doubted(measure):
    context, _ = measure(lambda number: 60.0 + 0.1 * (min(number, 5) % 3), seconds=38.0)
    (finding,) = context.broker.findings
    assert finding.problem == "the meter reported the same value 34 times, for 33.0 s: it may be stuck"


def test_power_that_contradicts_voltage_and_current_is_doubted(measure):
    context, _ = measure(lambda _: 60.0, factor=1000.0)
    assert any("contradicts voltage times current" in finding.problem for finding in context.broker.findings)


def test_the_meter_is_told_to_begin_and_to_end(measure):
    _, line = measure(lambda _: 60.0)
    assert bytes(line.written) == b"#L,W,3,E,1,1;#L,R,0;"


def test_what_was_read_is_kept_in_physical_units(measure):
    context, _ = measure(lambda _: 57.5)
    with (context.raw_data_folder / "samples.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert rows[0] == {"time_s": "100.500000", "power_W": "57.5", "voltage_V": "230.0", "current_A": "0.250"}
    assert len(rows) == 12  # one before the window, ten in it, and the one that tells of its last moments


def test_a_damaged_record_is_counted_and_left_out(measure):
    def noisy(clock, power):
        chunks = [Chunk(chunk.received_at, chunk.data) for chunk in line_on(clock, power)._coming]
        chunks[4] = Chunk(chunks[4].received_at, b"#d,-,18,6\xff0,2300;\r\n")
        return FakeSerialLine(clock, chunks)

    context, _ = measure(lambda _: 60.0, line=noisy)
    assert context.measures["MeanPower"] == pytest.approx(60.0)
    assert "1 sample was damaged and left out" in [finding.problem for finding in context.broker.findings]


def test_a_record_may_come_in_pieces(measure):
    def torn(clock, power):
        pieces = []
        for chunk in line_on(clock, power)._coming:
            pieces += [Chunk(chunk.received_at - 0.01, chunk.data[:9]), Chunk(chunk.received_at, chunk.data[9:])]
        return FakeSerialLine(clock, pieces)

    context, _ = measure(lambda _: 60.0, line=torn)
    assert context.measures["MeanPower"] == pytest.approx(60.0)


def test_a_meter_that_says_nothing_yields_no_value_and_a_warning(measure):
    context, _ = measure(lambda _: 60.0, seconds=10.0, line=lambda clock, _: FakeSerialLine(clock))
    assert set(context.measures.values()) == {None}
    assert any("no sample arrived" in finding.problem for finding in context.broker.findings)


def test_a_line_that_is_lost_leaves_a_warning_and_the_run_alive(measure):
    context, _ = measure(lambda _: 60.0, lost_at=104.0)
    assert set(context.measures.values()) == {None}
    assert any("the line to the power meter was lost" in finding.problem for finding in context.broker.findings)


def test_a_port_that_is_not_there_is_refused(tmp_path):
    plugin = WattsUpPro(port="/dev/no-such-port")
    (finding,) = plugin.check(Circumstances())
    assert "/dev/no-such-port" in finding.problem
    with pytest.raises(LinkError, match="no-such-port"):
        rehearse(make_context(tmp_path, plugin, robot=None), plugin)


def test_it_does_not_measure_a_simulated_robot():
    (finding,) = WattsUpPro(port=PORT).check(Circumstances(robot="simulated"))
    assert "Ina219" in finding.fix


def test_a_port_must_be_given():
    with pytest.raises(PluginError, match="port is ''"):
        WattsUpPro(port="")


class PtyMeter:
    """A meter at the other end of a pseudo-terminal: it sends records, faster than a real one, once it was told to."""

    def __init__(self) -> None:
        self.mine, theirs = pty.openpty()
        tty.setraw(theirs)
        self._theirs = theirs
        self.port = os.ttyname(theirs)
        self.heard = b""
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        while b"#L,W,3,E" not in self.heard:
            self.heard += os.read(self.mine, 64)
        os.write(self.mine, b"noise;#h,-,18,W,V,A;\r\n")
        while not self._is_over.wait(0.05):
            os.write(self.mine, record(42.0))

    def close(self) -> None:
        self._is_over.set()
        self._thread.join(60.0)
        os.set_blocking(self.mine, False)
        with contextlib.suppress(BlockingIOError):
            self.heard += os.read(self.mine, 64)
        os.close(self.mine)
        os.close(self._theirs)


def test_a_meter_on_a_pseudo_terminal_is_read_through_pyserial(tmp_path):
    pytest.importorskip("serial", reason="pyserial is not installed")
    meter = PtyMeter()
    plugin = WattsUpPro(port=meter.port)
    assert list(plugin.check(Circumstances())) == []
    context = make_context(tmp_path, plugin, robot=None, clock=SystemClock())
    try:
        rehearse(context, plugin, mission=lambda: SystemClock().sleep(0.5))
    finally:
        context.resources.close()
        meter.close()
    assert context.measures["MeanPower"] == pytest.approx(42.0)
    window = json.loads((context.raw_data_folder / "quality.json").read_text())["window"]
    assert context.measures["Energy"] == pytest.approx(42.0 * (window["end"] - window["start"]))
    assert meter.heard.endswith(b"#L,R,0;")


@pytest.mark.parametrize("torn", [b"10532301,502", b"1053,2301,502,0", b"1053,2301,502#d,-,18,1053,2301,502"])
def test_a_record_that_lacks_fields_is_damaged_as_where_the_line_lost_bytes(torn):
    # A comma that is lost makes a megawatt of 105.3 W and 230.1 V.
    whole = record(105.3, 230.1).decode()
    assert parse_record(whole.rstrip(";\r\n"), 1.0).watts == pytest.approx(105.3)
    with pytest.raises(ValueError, match=r"fields|invalid literal"):
        parse_record(whole.rstrip(";\r\n").replace(",1053,2301,458", f",{torn.decode()}", 1), 1.0)
