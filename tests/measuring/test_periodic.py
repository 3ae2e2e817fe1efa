from __future__ import annotations

import math
import threading
import time
from itertools import count, pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_runner.core.errors import PluginError
from robot_runner.core.events.context import SystemClock
from robot_runner.core.events.window import MissionTimes, Window
from robot_runner.measuring import periodic
from robot_runner.measuring.periodic import PeriodicSampler
from robot_runner.simulator.simulated_clock import SimulatedClock
from robot_runner.testing import FakeClock


@pytest.mark.parametrize("clock", [FakeClock(7.0), SimulatedClock()], ids=["fake", "simulated"])
def test_on_a_clock_that_is_slept_on_readings_come_on_the_way(clock):
    sampler = PeriodicSampler(clock.now, rate=10.0, clock=clock)
    begun = clock.now()
    sampler.start()
    clock.sleep(1.0)
    sampling = sampler.stop()
    assert list(sampling.times) == pytest.approx([begun + number / 10 for number in range(11)])
    assert list(sampling.readings) == list(sampling.times)
    assert (sampling.window.start, sampling.window.end) == (begun, begun + 1.0)
    assert sampling.quality().warnings() == ()


@given(rate=st.floats(0.3, 300.0), seconds=st.floats(0.0, 20.0))
def test_a_simulated_clock_is_sampled_without_drift(rate, seconds):
    clock = SimulatedClock()
    sampler = PeriodicSampler(lambda: 1.0, rate=rate, clock=clock)
    sampler.start()
    clock.sleep(seconds)
    times = sampler.stop().times
    assert all(abs(at - number / rate) < 1e-6 for number, at in enumerate(times[:-1]))
    assert abs(len(times) - 1 - seconds * rate) <= 1.001


def test_nothing_is_read_after_the_stop():
    clock, numbers = FakeClock(), count()
    sampler = PeriodicSampler(lambda: next(numbers), rate=10.0, clock=clock)
    sampler.start()
    clock.sleep(0.35)
    taken = len(sampler.stop().readings)
    clock.sleep(1.0)
    assert next(numbers) == taken == 5  # at 0, 0.1, 0.2, 0.3 and at the stop


def test_on_the_machines_clock_a_thread_keeps_the_rate():
    sampler = PeriodicSampler(lambda: threading.current_thread().name, rate=100.0, clock=SystemClock())
    begun = time.monotonic()
    sampler.start()
    waited, turns = threading.Event(), 0
    while time.monotonic() - begun < 0.3:
        waited.wait(0.01)
        turns += 1  # as often as the machine finds time for a thread that waits as long
    sampling = sampler.stop()
    seconds = sampling.window.duration
    assert turns * 0.5 <= len(sampling.times) <= seconds * 100 + 3
    assert all(sooner <= later for sooner, later in pairwise(sampling.times))
    assert set(sampling.readings[:-1]) == {"sampler"}
    assert "sampler" not in {thread.name for thread in threading.enumerate()}
    assert 0.0 < sampling.cpu_seconds < seconds


def test_a_moment_that_a_slow_meter_missed_is_passed_over():
    begun, slow = time.monotonic(), threading.Event()

    def read():
        slow.wait(0.055)  # longer than two periods of 20 ms
        return time.monotonic() - begun

    sampler = PeriodicSampler(read, rate=50.0, clock=SystemClock())
    sampler.start()
    while time.monotonic() - begun < 0.4:
        slow.wait(0.01)
    sampling = sampler.stop()
    took = time.monotonic() - begun
    # Without passing over it would owe 20 readings by now; with it, it takes one as soon as the last is done.
    assert len(sampling.readings) <= took / 0.055 + 2
    assert sampling.quality().got < sampling.quality().expected
    assert any("samples arrived of" in warning for warning in sampling.quality().warnings())


def test_a_meter_that_fails_costs_samples_and_not_the_mission():
    clock, numbers = FakeClock(), count()

    def read():
        if next(numbers) % 2:
            raise OSError("no such sensor")
        return 1.0

    sampler = PeriodicSampler(read, rate=10.0, clock=clock)
    sampler.start()
    clock.sleep(1.0)
    sampling = sampler.stop()
    assert (len(sampling.readings), sampling.failures) == (6, 5)
    assert "5 readings failed, the first with: OSError: no such sensor" in sampling.quality().warnings()


def test_a_meter_that_never_answers_does_not_hold_up_the_end(monkeypatch):
    monkeypatch.setattr(periodic, "_PATIENCE", 0.05)
    never = threading.Event()
    sampler = PeriodicSampler(lambda: never.wait(30), rate=10.0, clock=SystemClock())
    sampler.start()
    sampling = sampler.stop()
    never.set()
    assert (len(sampling.readings), sampling.failures) == (0, 1)
    assert "did not come back within 0.05 s" in sampling.first_failure
    assert not sampling.quality().is_sufficient


def test_stopping_twice_returns_the_same():
    clock = FakeClock()
    sampler = PeriodicSampler(lambda: 1.0, rate=1.0, clock=clock)
    sampler.start()
    clock.sleep(2.0)
    first = sampler.stop()
    clock.sleep(2.0)
    assert sampler.stop() is first


def test_a_sampler_is_for_one_run():
    sampler = PeriodicSampler(lambda: 1.0, rate=1.0, clock=FakeClock())
    with pytest.raises(PluginError, match="never started"):
        sampler.stop()
    sampler.start()
    with pytest.raises(PluginError, match="started twice"):
        sampler.start()


@pytest.mark.parametrize("rate", [0.0, -1.0, float("inf"), float("nan")])
def test_a_rate_that_cannot_be_is_refused(rate):
    with pytest.raises(PluginError, match="sample rate"):
        PeriodicSampler(lambda: 1.0, rate=rate, clock=FakeClock())


def test_a_quantity_is_picked_from_the_readings():
    clock = FakeClock()
    sampler = PeriodicSampler(lambda: {"volts": 12.0, "amperes": clock.now()}, rate=1.0, clock=clock)
    sampler.start()
    clock.sleep(2.0)
    assert sampler.stop().series(lambda reading: reading["amperes"]).values == [0.0, 1.0, 2.0]


def test_readings_at_the_edges_make_a_short_mission_known_however_slow_the_rate():
    counter = iter(range(1000))
    clock = SystemClock()
    sampler = PeriodicSampler(lambda: next(counter), rate=0.01, clock=clock)
    times = MissionTimes(clock)
    times.at_edges(sampler.take_now)
    sampler.start()
    times.begin()
    time.sleep(0.02)
    times.end()
    sampling = sampler.stop().over(times.window())
    before, after = sampling.times[1], sampling.times[2]
    assert before <= times.window().start <= times.window().end <= after
    assert sampling.quality().is_sufficient
    assert sampling.quality().warnings() == ()


def test_an_edge_does_not_wait_for_a_meter_that_hangs(monkeypatch):
    monkeypatch.setattr(periodic, "_FIRST_PATIENCE", 0.05)
    monkeypatch.setattr(periodic, "_PATIENCE", 0.05)
    never = threading.Event()
    sampler = PeriodicSampler(lambda: never.wait(30), rate=10.0, clock=SystemClock())
    sampler.start()
    sampler.take_now()  # returns: else this test hangs until its timeout
    sampler.stop()
    never.set()


def test_only_failures_of_the_window_count():
    clock = FakeClock()
    broken = [2.0, 7.0]

    def read():
        if clock.now() in broken:
            raise OSError("torn")
        return 1.0

    sampler = PeriodicSampler(read, rate=1.0, clock=clock)
    sampler.start()
    clock.sleep(10.0)
    sampling = sampler.stop()
    assert sampling.failures == 2
    assert sampling.over(Window(5.0, 10.0)).failures == 1
    assert sampling.over(Window(3.0, 6.0)).failures == 0


@pytest.mark.parametrize("odd", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("shape", [lambda number: number, lambda number: (1, number)])
def test_a_reading_that_is_no_finite_number_costs_a_sample_as_one_that_fails(odd, shape):
    clock, readings = FakeClock(), iter(map(shape, [7.5, 7.5, odd, *[7.5] * 20]))
    sampler = PeriodicSampler(lambda: next(readings), rate=10.0, clock=clock)
    sampler.start()
    clock.sleep(1.0)
    sampling = sampler.stop()
    assert set(sampling.readings) == {shape(7.5)}
    assert (sampling.failures, sampling.first_failure) == (1, f"ValueError: the meter said {shape(odd)}")
