"""A request to end the run, or its mission, waits for the end of what must not be left half done."""

from __future__ import annotations

import signal
import threading

import pytest

from robot_runner.core.events.early_end import RunInterrupted, undivided
from robot_runner.core.execution.interruption import InterruptGate


@pytest.fixture
def gate() -> InterruptGate:
    gate = InterruptGate()
    gate.arm()
    return gate


def test_a_request_waits_for_the_end_of_the_outermost_block(gate: InterruptGate) -> None:
    done = []

    def compute() -> None:
        with undivided:
            with undivided:
                gate.request()
            done.append("the rest")

    with pytest.raises(RunInterrupted):
        compute()
    assert done == ["the rest"]


def test_a_request_that_was_raised_at_the_end_of_a_block_is_not_raised_again(gate: InterruptGate) -> None:
    with pytest.raises(RunInterrupted), undivided:
        gate.request()
    with undivided:
        pass


def test_a_request_comes_also_where_the_block_fails(gate: InterruptGate) -> None:
    @undivided
    def compute() -> None:
        gate.request()
        raise OSError("the line is lost")

    with pytest.raises(RunInterrupted) as raised:
        compute()
    assert isinstance(raised.value.__context__, OSError)
    with pytest.raises(RunInterrupted):
        gate.request(at_once=True)


def test_a_request_that_waits_for_the_end_of_a_block_is_not_taken_for_one_that_a_callback_ignores(
    gate: InterruptGate,
) -> None:
    told: list[object] = []
    gate.held_up = told.append
    with pytest.raises(RunInterrupted), undivided:
        gate._take_signal(signal.SIGTERM, None)
    assert told == []


def test_a_request_that_comes_when_nothing_may_be_interrupted_waits_for_the_next_callback(gate: InterruptGate) -> None:
    gate.disarm()
    with undivided:
        gate.request()
    with pytest.raises(RunInterrupted):
        gate.arm()


def test_a_signal_waits_for_the_end_of_a_function(gate: InterruptGate) -> None:
    done = []

    @undivided
    def compute() -> None:
        signal.raise_signal(signal.SIGTERM)
        done.append("all of it")

    earlier = signal.signal(signal.SIGTERM, lambda *_: gate.request())
    try:
        with pytest.raises(RunInterrupted):
            compute()
    finally:
        signal.signal(signal.SIGTERM, earlier)
    assert done == ["all of it"]


def test_a_block_of_another_thread_delays_nothing(gate: InterruptGate) -> None:
    begun, over = threading.Event(), threading.Event()

    def compute() -> None:
        with undivided:
            begun.set()
            over.wait(60)

    thread = threading.Thread(target=compute)
    thread.start()
    begun.wait(60)
    try:
        with pytest.raises(RunInterrupted):
            gate.request()
    finally:
        over.set()
        thread.join()
