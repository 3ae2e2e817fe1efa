"""A value that may be wrong is doubted, and the doubt says why, with its figure."""

from __future__ import annotations

import random
from dataclasses import replace

import pytest
from tests.meters.scripted_meter import ScriptedMeter, hello, sample

from robot_runner.core.errors import PluginError
from robot_runner.core.events.window import Window
from robot_runner.measuring.device_clock import fit_clock
from robot_runner.meters.ina219.doubts import silence, stuck_doubts
from robot_runner.meters.ina219.sample_stream import SampleStream, Trouble
from robot_runner.plugins.profilers import Ina219
from robot_runner.testing import Chunk, FakeClock, FakeLinks, FakeSerialLine, make_context, rehearse


def steady(**script) -> ScriptedMeter:
    return ScriptedMeter(lambda _: 8.0, **script)


def measured(tmp_path, chunks, *, seconds=2.0, **parameters):
    clock, profiler = FakeClock(), Ina219(**parameters)
    context = make_context(tmp_path, profiler, links=FakeLinks(serial=FakeSerialLine(clock, chunks)), clock=clock)
    rehearse(context, profiler, mission=lambda: clock.sleep(seconds))
    return context, [finding.problem for finding in context.broker.findings]


def stuck_from(moment: float, *, end: float) -> list[Chunk]:
    moving = steady().chunks(start=0.0, end=moment)
    still = steady(noise=0, first_sequence=round(moment * 200) + 1, first_stamp=round(moment * 1e6) + 5000)
    return [*moving, *still.chunks(start=moment + 0.005, end=end)]


def test_registers_that_stand_still_from_some_moment_on_are_doubted(tmp_path):
    context, problems = measured(tmp_path, stuck_from(1.0, end=5.0), seconds=4.0)
    (problem,) = problems
    assert problem.startswith("the sensor read the same for 3.0 s (60")
    assert context.measures["Energy"] is not None


def test_a_second_is_enough_to_doubt_registers_that_stand_still(tmp_path):
    _, problems = measured(tmp_path, steady(noise=0).chunks(start=0.0, end=2.0), seconds=1.0)
    assert any("read the same for 1.0 s" in problem for problem in problems)


def test_a_constant_load_with_the_noise_of_a_converter_is_not_doubted(tmp_path):
    noisy = random.Random(1)  # noqa: S311 - noise, no secret
    # A tenth of a step, in the middle of a step: the quietest that a converter of 12 bits could be.
    readings = [round(6130 + noisy.gauss(0, 0.31)) for _ in range(20_000)]
    assert list(stuck_doubts(readings, 100.0, 20_000)) == []
    assert measured(tmp_path, steady().chunks(start=0.0, end=3.0))[1] == []


def test_a_constant_load_of_the_simulated_robot_is_not_doubted(tmp_path):
    profiler = Ina219()
    context = make_context(tmp_path, profiler)
    rehearse(context, profiler, mission=lambda: context.clock.sleep(20.0))
    context.resources.close()
    assert context.broker.findings == ()


@pytest.mark.parametrize(
    ("watts", "told"), [(8.0, None), (1.5, "the furthest at 1.50 W"), (34.0, "the furthest at 34.00 W")]
)
def test_power_outside_the_plausible_limits_is_doubted(tmp_path, watts, told):
    meter = ScriptedMeter(lambda moment: watts if moment < 1.0 else 8.0, noise=0, volts=12.0)
    chunks = meter.chunks(start=0.0, end=3.0)
    _, problems = measured(tmp_path, chunks, plausible_w=(2, 30))
    found = [problem for problem in problems if "plausible 2 to 30 W" in problem]
    assert [told in problem for problem in found] == ([True] if told else [])


@pytest.mark.parametrize("limits", [(30, 2), (1,), (2, 2), 30, "2-30", ("2", "30")])
def test_limits_that_are_none_are_refused(limits):
    with pytest.raises(PluginError, match="plausible_w is"):
        Ina219(plausible_w=limits)


def test_a_sensor_that_was_wired_the_wrong_way_round_is_told(tmp_path):
    _, problems = measured(tmp_path, ScriptedMeter(lambda _: -8.0).chunks(start=0.0, end=3.0))
    assert any("VIN+ and VIN- of the sensor are swapped" in problem for problem in problems)


def test_a_bus_without_voltage_is_told(tmp_path):
    chunks = [Chunk(0.0, hello(0, 0))]
    chunks += [Chunk(0.005 * at, sample(at, 5000 * at, 6000 + at % 3, 0)) for at in range(600)]
    assert any("samples show no voltage" in problem for problem in measured(tmp_path, chunks)[1])


def test_an_energy_that_was_clipped_is_a_least_energy(tmp_path):
    meter = ScriptedMeter(lambda moment: 36.0 if moment < 1.0 else 10.0)
    context, problems = measured(tmp_path, meter.chunks(start=0.0, end=3.0))
    joules = context.measures["Energy"]
    assert any(f"the energy is at least {joules:.1f} J: 49" in problem for problem in problems)


@pytest.mark.parametrize(("begin", "end"), [(0.06, 2.5), (0.0, 1.94)])
def test_a_gap_at_an_edge_is_bridged_and_told_as_one_inside(tmp_path, begin, end):
    quiet = {number for number in range(600) if not begin <= number / 200 <= end}
    context, problems = measured(tmp_path, steady(left_out=quiet).chunks(start=0.0, end=2.5))
    assert context.measures["Energy"] == pytest.approx(8.0 * 2.0, rel=1e-3)
    if begin == 0.0:
        assert any("the largest gap between samples is 0.06" in problem for problem in problems)


@pytest.mark.parametrize("skew", [0.03, -0.03, 0.2])
def test_a_clock_that_drifts_is_mended_by_the_arrivals_and_doubted(tmp_path, skew):
    slow = replace(steady(skew=skew), latency=0.0)
    context, problems = measured(tmp_path, slow.chunks(start=0.0, end=31.0), seconds=30.0)
    way = "slow" if skew > 0 else "fast"
    assert any(f"the meter's clock goes {100 * abs(skew / (1 - skew)):.1f} % {way}" in problem for problem in problems)
    assert context.measures["Energy"] == pytest.approx(8.0 * 30.0, rel=1e-3)


def test_a_clock_that_runs_far_off_is_noticed_within_a_second(tmp_path):
    _, problems = measured(tmp_path, steady(skew=0.5).chunks(start=0.0, end=2.0), seconds=1.0)
    assert any("the meter's clock goes 100.0 % slow" in problem for problem in problems)


def test_a_drift_that_is_not_mended_is_told_all_the_same():
    stamps = [0.1 * number for number in range(300)]
    clock = fit_clock(stamps, [1.04 * stamp for stamp in stamps])
    assert (clock.rate, clock.drift) == (1.0, pytest.approx(0.04))


def test_a_clock_that_stands_still_while_samples_arrive_is_told(tmp_path):
    chunks = [Chunk(0.0, hello(0, 0))]
    chunks += [Chunk(0.005 * at, sample(at, min(5000 * at, 500_000), 6000 + at % 3)) for at in range(600)]
    context, problems = measured(tmp_path, chunks)
    assert context.measures["Energy"] is None
    assert any("the meter's clock stood still while" in problem for problem in problems)


def test_numbers_that_stand_still_are_told_and_are_not_65535_lost_samples(tmp_path):
    chunks = [Chunk(0.005 * at, sample(7, 5000 * at, 6000 + at % 3)) for at in range(600)]
    _, problems = measured(tmp_path, chunks)
    assert any("samples carried the number of the one before" in problem for problem in problems)
    assert not any("lost" in problem for problem in problems if "carried" not in problem)


def test_counts_are_those_of_the_window():
    stream = SampleStream()
    stream.take(steady(left_out={50, 51, 300}, damaged={60, 310, 350}).chunks(start=0.0, end=3.0))
    times = stream.times()
    late = stream.troubles(Window(1.0, 1.7), times)
    assert (stream.troubles()[Trouble.LOST], stream.counts.corrupt) == (6, 3)
    assert (late[Trouble.LOST], late[Trouble.CORRUPT]) == (2, 1)
    assert stream.troubles(Window(2.0, 3.0), times) == {}


def test_samples_lost_before_the_mission_are_not_held_against_it(tmp_path):
    clock, profiler = FakeClock(), Ina219()
    line = FakeSerialLine(clock, steady(left_out={100, 101}).chunks(start=0.0, end=9.0))
    context = make_context(tmp_path, profiler, links=FakeLinks(serial=line), clock=clock)
    profiler.start_measurement(context)
    clock.sleep(2.0)
    context.times.begin()
    clock.sleep(3.0)
    context.times.end()
    clock.sleep(1.0)
    profiler.stop_measurement(context)
    profiler.populate_run_data(context)
    assert context.broker.findings == ()
    assert context.measures["Energy"] == pytest.approx(24.0, rel=1e-3)


def foreign(data: bytes) -> SampleStream:
    stream = SampleStream()
    stream.take([Chunk(0.0, data)])
    stream.finish()
    return stream


@pytest.mark.parametrize(
    ("data", "told"),
    [
        (b"", "no byte came in 10 s: is it the right port, and does the meter have power?"),
        (b"\x7f\x00" * 35_000, "70 kB came in 10 s, none of it frames: wrong baud rate, or another device?"),
        (b"$GPGGA,1*47\r\n" * 3, "39 bytes came in 10 s, none of it frames: wrong baud rate, or another device?"),
        (hello(0, 0), "20 bytes came in 10 s, frames among it, but no sample of this sensor"),
    ],
)
def test_what_came_instead_of_samples_is_said(data, told):
    assert silence(foreign(data), 10.0) == told


def test_another_device_on_the_port_is_the_reason_of_the_missing_value(tmp_path):
    chunks = [Chunk(0.1 * number, b"$GPGGA,101010.00,4717.1,N,00833.9,E,1*47\r\n") for number in range(100)]
    context, problems = measured(tmp_path, chunks, seconds=1.0)
    assert context.measures["Energy"] is None
    assert any("none of it frames: wrong baud rate, or another device?" in problem for problem in problems)
