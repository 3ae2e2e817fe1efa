from __future__ import annotations

import csv
import json
import time
import tracemalloc

import pytest
from tests.meters.rehearsed import problems
from tests.meters.scripted_meter import NOISE, ScriptedMeter, frame, hello, sample

from robot_runner.core.errors import LinkError, PluginError
from robot_runner.core.events.measure import Origin
from robot_runner.core.events.window import Window
from robot_runner.meters.ina219.line_meter import LineMeter, SharedLine
from robot_runner.meters.ina219.registers import Calibration
from robot_runner.meters.ina219.sample_stream import SampleStream
from robot_runner.plugins import Circumstances
from robot_runner.plugins.profilers import Ina219
from robot_runner.testing import Chunk, FakeClock, FakeLinks, FakeSerialLine, ProfilerContract, make_context, rehearse

NOTHING = {"Energy": None, "EnergyPt": None, "MeanPower": None}


class TestIna219OnTheSimulatedRobot(ProfilerContract):
    def make_plugin(self) -> Ina219:
        return Ina219()


class TestIna219OnAScriptedLine(ProfilerContract):
    def make_plugin(self) -> Ina219:
        return Ina219(shunt_ohm=0.1, rate_hz=200.0)

    def make_links(self, clock: FakeClock) -> FakeLinks:
        meter = ScriptedMeter(lambda moment: 8.0 + moment, says_hello=False)
        return FakeLinks(serial=FakeSerialLine(clock, meter.chunks(start=0.0, end=3.0)))


@pytest.fixture
def clock() -> FakeClock:
    return FakeClock()


@pytest.fixture
def measure(tmp_path, clock):
    def execute(chunks, *, seconds=2.0, lost_at=None, is_simulated=False, **parameters):
        profiler = Ina219(**parameters)
        line = FakeSerialLine(clock, chunks, lost_at=lost_at, is_simulated=is_simulated)
        context = make_context(tmp_path, profiler, links=FakeLinks(serial=line), clock=clock)
        rehearse(context, profiler, mission=lambda: clock.sleep(seconds))
        return context

    return execute


def steady(**script) -> ScriptedMeter:
    return ScriptedMeter(lambda _: 8.0, **script)


def test_a_meter_that_says_nothing_yields_no_value_and_a_warning(measure):
    context = measure([])
    assert dict(context.measures) == NOTHING
    assert problems(context) == [
        "no sample arrived in the measured window, where 400 were expected",
        "no byte came in 6 s: is it the right port, and does the meter have power?",
    ]


def test_a_meter_that_needs_its_boot_loader_is_waited_for(measure, clock):
    context = measure(steady().chunks(start=2.5, end=9.0))
    assert context.measures["MeanPower"] == pytest.approx(8.0, rel=1e-3)
    assert clock.now() == pytest.approx(2.5 + 2.0, abs=0.1)


def test_a_meter_that_died_half_way_yields_no_value(measure):
    context = measure(steady().chunks(start=0.0, end=1.0))
    assert dict(context.measures) == NOTHING
    assert any("samples cover 4" in problem for problem in problems(context))
    assert any("no energy was computed" in problem for problem in problems(context))


def test_the_last_sample_stands_for_the_last_moment_of_the_window(measure):
    context = measure(steady().chunks(start=0.0, end=1.995), seconds=2.0)
    assert context.measures["Energy"] == pytest.approx(16.0, rel=1e-4)


def test_the_sample_behind_the_end_of_the_window_is_waited_for(measure):
    context = measure(steady().chunks(start=0.0, end=3.0))
    end = json.loads((context.raw_data_folder / "quality.json").read_text())["window"]["end"]
    with (context.raw_data_folder / "samples.csv").open(newline="") as file:
        assert float(list(csv.DictReader(file))[-1]["time_s"]) > end


def test_a_line_that_was_lost_fails_the_run_and_keeps_the_samples(tmp_path, clock):
    profiler = Ina219()
    line = FakeSerialLine(clock, steady().chunks(start=0.0, end=9.0), lost_at=1.0)
    context = make_context(tmp_path, profiler, links=FakeLinks(serial=line), clock=clock)
    with pytest.raises(LinkError, match="unplugged"):
        rehearse(context, profiler, mission=lambda: clock.sleep(2.0))
    assert dict(context.measures) == {}
    assert len((context.raw_data_folder / "samples.csv").read_text().splitlines()) == 1 + 200


def test_a_line_that_cannot_be_opened_fails_the_run(tmp_path, clock):
    profiler = Ina219(port="/dev/no-such-port")
    context = make_context(tmp_path, profiler, robot=None, clock=clock)
    with pytest.raises(LinkError, match="no-such-port"):
        rehearse(context, profiler)


@pytest.mark.parametrize(("is_simulated", "origin"), [(True, Origin.SIMULATED), (False, Origin.MEASURED)])
def test_values_say_where_they_come_from(measure, is_simulated, origin):
    context = measure(steady().chunks(start=0.0, end=3.0), is_simulated=is_simulated)
    assert {published.origin for published in context.broker.measures.values()} == {origin}


def test_a_shunt_or_a_rate_that_contradicts_the_meter_is_told(measure):
    context = measure(steady().chunks(start=0.0, end=3.0), shunt_ohm=0.05, rate_hz=100.0)
    assert problems(context) == [
        "the power meter reports that its shunt has 0.1 ohm, not 0.05 ohm",
        "the power meter reports that it samples at 200 Hz, not at 100 Hz",
    ]


def test_a_current_beyond_the_sensors_range_is_told(measure):
    context = measure(ScriptedMeter(lambda _: 36.0).chunks(start=0.0, end=0.5), seconds=0.4)
    assert any("at the end of the sensor's range" in problem for problem in problems(context))


def test_a_range_that_was_left_before_the_end_is_told_where_it_clipped(measure):
    # At 40 mV a shunt of 0.1 ohm carries 0.4 A; with the range of its end alone, nothing would be clipped.
    meter = ScriptedMeter(lambda moment: 4.44 if moment < 1.0 else 8.88)
    chunks = meter.chunks(start=0.0, end=3.0)
    chunks[0] = Chunk(0.0, hello(0, 0, configuration=0x01DD))
    context = measure([*chunks[:300], Chunk(1.49, hello(299, 1_495_000)), *chunks[300:]])
    assert any("at the end of the sensor's range" in problem for problem in problems(context))


def test_another_meter_with_another_shunt_on_the_same_port_is_told(measure):
    first, second = steady(first_stamp=9_000_000), steady(micro_ohm=10_000)
    context = measure([*first.chunks(start=0.0, end=1.0), *second.chunks(start=1.02, end=3.0)])
    assert (
        "the power meter reported several shunts (0.01, 0.1 ohm), as where it is exchanged: 0.01 ohm counts"
    ) in problems(context)


def test_a_restart_of_the_meter_is_told(measure):
    chunks = [*steady(first_stamp=9_000_000).chunks(start=0.0, end=1.0), *steady().chunks(start=1.02, end=3.0)]
    assert "the power meter was restarted once" in problems(measure(chunks))


def test_another_version_of_the_protocol_is_told(measure):
    chunks = [*steady().chunks(start=0.0, end=3.0), Chunk(1.0, frame(0x21, 0, b"newer"))]
    assert "the power meter speaks another version of the protocol" in problems(measure(chunks))


def test_a_run_that_was_never_measured_publishes_no_values(tmp_path, clock):
    profiler = Ina219()
    context = make_context(tmp_path, profiler, links=FakeLinks(), clock=clock)
    profiler.populate_run_data(context)
    assert dict(context.measures) == NOTHING
    assert problems(context) == ["nothing was measured: the measurement was never started"]


def test_raw_samples_are_kept_as_registers_and_in_physical_units(measure):
    context = measure(steady().chunks(start=0.0, end=3.0))
    with (context.raw_data_folder / "samples.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    first = {name: float(value) for name, value in rows[0].items()}
    assert list(first) == ["time_s", "shunt_raw", "bus_raw", "current_A", "voltage_V", "power_W"]
    assert first["voltage_V"] == pytest.approx((int(first["bus_raw"]) >> 3) * 0.004)
    assert first["current_A"] == pytest.approx(first["shunt_raw"] * 1e-4)
    assert first["power_W"] == pytest.approx(first["current_A"] * first["voltage_V"], abs=1e-5)


def test_quality_is_kept_beside_the_samples(measure):
    context = measure(steady(left_out={100}).chunks(start=0.0, end=3.0))
    facts = json.loads((context.raw_data_folder / "quality.json").read_text())
    assert facts["samples"]["lost"] == 1
    assert facts["window"]["end"] - facts["window"]["start"] == pytest.approx(2.0)
    assert facts["hello"]["rate_hz"] == 200


@pytest.mark.parametrize(("shunt_raw", "amperes"), [(6130, 0.613), (-250, -0.025), (0, 0.0), (32000, 3.2)])
def test_a_step_of_the_shunt_register_is_ten_microvolt(shunt_raw, amperes):
    assert Calibration(0.1).current(shunt_raw) == pytest.approx(amperes)


@pytest.mark.parametrize("flags", range(8))
def test_the_flags_of_the_bus_register_are_ignored(flags):
    assert Calibration().voltage((3100 << 3) | flags) == pytest.approx(12.4)


@pytest.mark.parametrize(
    "parameters", [{"shunt_ohm": 0.0}, {"shunt_ohm": -0.1}, {"rate_hz": 0.0}, {"card_patience_s": "5"}]
)
def test_a_shunt_or_a_rate_that_cannot_be_is_refused(parameters):
    with pytest.raises(PluginError, match="is "):
        Ina219(**parameters)


def test_without_a_robot_its_check_says_how_to_name_one():
    (finding,) = Ina219().check(Circumstances())
    assert "--set robot=simulated" in finding.fix


def test_a_serial_port_is_refused_by_its_check_as_long_as_none_can_be_opened():
    (finding,) = Ina219(port="/dev/ttyUSB0").check(Circumstances(robot="simulated"))
    assert finding.is_error
    assert "'/dev/ttyUSB0'" in finding.problem


def test_a_run_of_19000_samples_is_evaluated_without_numpy_in_no_time(measure):
    chunks = steady().chunks(start=0.0, end=96.0)
    begun = time.process_time()
    context = measure(chunks, seconds=95.0)
    assert context.measures["Energy"] == pytest.approx(8.0 * 95.0, rel=1e-3)
    assert time.process_time() - begun < 5.0  # a guard against a quadratic slip, not a benchmark


@pytest.mark.long
def test_a_sample_that_waits_on_the_line_takes_little_more_than_its_bytes(clock):
    """An object for each took ten times as much, and those of ten hours more memory than a laptop has."""
    count = 20_000
    line = TrickledLine(clock, count)
    shared = SharedLine(line)
    tracemalloc.start()
    try:
        while line.sent < count:
            clock.sleep(0.5)
            shared.latest()
        kept = tracemalloc.get_traced_memory()[0]
    finally:
        tracemalloc.stop()
    assert kept < 50 * count
    assert [chunk.received_at for chunk in shared.since(count - 2)] == [(count - 2) / 200, (count - 1) / 200]
    assert len(shared.since(0)) < count, "all at once"


def test_samples_that_come_while_those_of_hours_are_decoded_are_taken(clock):
    """The wait for the sample behind the end was over before they were decoded."""

    class SlowStream(SampleStream):
        def take(self, chunks):
            super().take(chunks)
            clock.sleep(30.0)

    line = TrickledLine(clock, 4000)
    meter = LineMeter(SharedLine(line), clock)
    meter.begin()
    meter._stream = SlowStream()
    meter._taken = 0
    clock.sleep(10.0)
    line.is_held_up = True  # until all that came before is decoded
    meter.end()
    assert meter.evaluate(None).quality.is_bracketed


def test_a_phase_is_evaluated_alike_before_the_whole_mission_and_after_it(clock):
    line = TrickledLine(clock, 400)
    meter = LineMeter(SharedLine(line), clock)
    clock.sleep(1.2)
    meter._take()
    line.sent += 1  # this one is lost
    clock.sleep(1.8)
    meter._take()
    mission, phase = Window(0.0, 2.0), Window(1.0, 1.5)
    before, whole, behind = meter.evaluate(mission, phase), meter.evaluate(mission), meter.evaluate(mission, phase)
    assert before == behind
    assert (before.window, whole.window) == (phase, mission)
    assert (before.quality.got, whole.quality.got) == (100, 399)


class TrickledLine:
    """A line on which 200 samples a second arrive as the clock goes; `sent` of them so far."""

    is_simulated = False

    def __init__(self, clock, count):
        self.clock, self.count, self.sent, self.is_held_up = clock, count, 0, False

    def drain(self):
        if self.is_held_up:
            self.is_held_up = False
            return []
        chunks = []
        while self.sent < self.count and self.sent / 200 <= self.clock.now():
            noise = NOISE[self.sent % 4]
            chunks.append(Chunk(self.sent / 200, sample(self.sent, self.sent * 5000, 6130 + noise)))
            self.sent += 1
        return chunks
