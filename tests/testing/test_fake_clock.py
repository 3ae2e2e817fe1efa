from __future__ import annotations

import pytest

from robot_runner.core.events.context import Clock
from robot_runner.testing import FakeClock


def test_it_is_a_clock():
    assert isinstance(FakeClock(), Clock)


def test_it_moves_only_when_it_is_slept_on_and_never_back():
    clock = FakeClock(start=5.0)
    clock.sleep(1.5)
    clock.sleep(-3.0)
    assert clock.now() == 6.5


def test_what_is_due_happens_in_order_and_at_its_time():
    clock, seen = FakeClock(), []
    for time in (2.0, 1.0, 2.0, 9.0):
        clock.at(time, lambda time=time: seen.append((time, clock.now())))
    clock.sleep(3.0)
    assert seen == [(1.0, 1.0), (2.0, 2.0), (2.0, 2.0)]


def test_a_repetition_goes_on_until_it_is_closed():
    clock, seen = FakeClock(start=10.0), []
    repetition = clock.every(0.5, lambda: seen.append(clock.now()))
    clock.sleep(1.7)
    repetition.close()
    clock.sleep(5.0)
    assert seen == [10.5, 11.0, 11.5]


def test_what_a_callback_raises_comes_out_of_the_sleep_at_its_time():
    clock = FakeClock()

    def fail() -> None:
        raise RuntimeError("unplugged")

    clock.at(1.0, fail)
    with pytest.raises(RuntimeError, match="unplugged"):
        clock.sleep(2.0)
    assert clock.now() == 1.0
