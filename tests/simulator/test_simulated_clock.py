"""The simulation's clock: exact, and everything due happens on the way."""

from __future__ import annotations

import threading

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_runner.core.errors import LinkError
from robot_runner.core.events.context import Clock
from robot_runner.simulator.simulated_clock import STEP_NS, SimulatedClock, tick_time


def test_it_is_a_clock():
    assert isinstance(SimulatedClock(), Clock)


def test_it_stands_still_unless_it_is_slept_on():
    clock = SimulatedClock()
    assert clock.now() == clock.now() == 0.0


def test_negative_sleep_counts_as_zero():
    clock = SimulatedClock()
    clock.sleep(-3)
    assert clock.now() == 0.0


@given(st.lists(st.integers(0, 5_000), max_size=50))
def test_many_short_sleeps_add_up_exactly(milliseconds):
    clock = SimulatedClock()
    for duration in milliseconds:
        clock.sleep(duration / 1000)
    assert clock.now_ns == sum(milliseconds) * 1_000_000


@given(rate=st.integers(1, 200), seconds=st.integers(1, 5))
def test_something_at_a_rate_happens_so_often(rate, seconds):
    clock = SimulatedClock()
    times = []
    clock.every(rate, lambda: times.append(clock.now_ns))
    clock.sleep(seconds)
    assert len(times) == rate * seconds
    assert all(time % STEP_NS == 0 for time in times)
    assert times == sorted(times)


@given(rate=st.integers(1, 200), start=st.floats(0, 3), pieces=st.lists(st.floats(0, 0.3), max_size=20))
def test_ticks_do_not_depend_on_when_somebody_began_to_listen_or_how_it_is_slept(rate, start, pieces):
    clock = SimulatedClock()
    clock.sleep(start)
    began = clock.now_ns
    times = []
    clock.every(rate, lambda: times.append(clock.now_ns))
    for piece in pieces:
        clock.sleep(piece)
    every_tick = (tick_time(number, rate) for number in range(2000))
    assert times == [time for time in every_tick if began < time <= clock.now_ns]


def test_a_closed_ticker_is_silent():
    clock = SimulatedClock()
    times = []
    ticker = clock.every(10, lambda: times.append(clock.now()))
    clock.sleep(0.25)
    ticker.close()
    ticker.close()
    clock.sleep(1)
    assert times == [0.1, 0.2]


def test_what_is_due_together_comes_in_the_order_of_asking():
    clock = SimulatedClock()
    heard = []
    clock.every(10, lambda: heard.append("first"))
    clock.every(10, lambda: heard.append("second"))
    clock.sleep(0.2)
    assert heard == ["first", "second", "first", "second"]


def test_sleeping_in_a_callback_is_refused_with_a_fix():
    clock = SimulatedClock()
    clock.every(10, lambda: clock.sleep(1))
    with pytest.raises(LinkError, match="sleep in the mission"):
        clock.sleep(1)
    assert clock.now() == 0.1


def test_a_second_thread_that_sleeps_meanwhile_is_refused_by_its_name():
    clock, caught = SimulatedClock(), []

    def sleep():
        with pytest.raises(LinkError, match="threads MainThread and lamp slept") as error:
            clock.sleep(1)
        caught.append(error)

    def start():
        thread = threading.Thread(target=sleep, name="lamp")
        thread.start()
        thread.join()

    clock.after(0.1, start)
    clock.sleep(1)
    assert caught


def test_after_a_callback_that_failed_the_clock_goes_on():
    clock = SimulatedClock()
    clock.every(10, lambda: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        clock.sleep(1)
    assert clock.now() == 0.1
    with pytest.raises(ZeroDivisionError):
        clock.sleep(1)
    assert clock.now() == 0.2
