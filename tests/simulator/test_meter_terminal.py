"""The power meter on a pseudo-terminal is opened, read and reset as the real one on a serial port."""

from __future__ import annotations

import time

import pytest

from robot_runner.core.events.context import SystemClock
from robot_runner.measuring.serial_line import SerialPort, port_problem
from robot_runner.simulator.simulated_devices import MeterTerminal
from robot_runner.simulator.simulated_turtlebot3 import Simulation

HELLO, SAMPLE = b"\xa5\x5a\x12", b"\xa5\x5a\x11"


@pytest.fixture
def simulation():
    made = Simulation(seed=1)
    yield made
    made.close()


@pytest.fixture
def terminal(simulation):
    made = MeterTerminal(simulation)
    yield made
    made.close()


def let_pass(simulation, terminal, seconds):
    for _ in range(round(seconds * 100)):
        simulation.clock.sleep(0.01)
        terminal.exchange()
        time.sleep(0.0005)  # so that who has the port open reads meanwhile


def read(line, count):
    """Wait until so many frames have arrived."""
    data, deadline = b"", time.monotonic() + 60
    while data.count(SAMPLE) < count and time.monotonic() < deadline:
        data += b"".join(chunk.data for chunk in line.drain())
        time.sleep(0.005)
    return data


def opened(terminal):
    return SerialPort(str(terminal.port), SystemClock())


def test_a_meter_that_is_opened_starts_anew_and_sends_samples(simulation, terminal):
    for _ in range(2):
        let_pass(simulation, terminal, 0.3)  # nobody hears this
        line = opened(terminal)
        let_pass(simulation, terminal, 0.5)
        data = read(line, 98)
        line.close()
        assert data.startswith(HELLO + b"\x0c\x00\x00")  # its next sample is number 0
        assert data.count(SAMPLE) == pytest.approx(99, abs=2)


def test_it_answers_the_question_after_a_hello(simulation, terminal):
    line = opened(terminal)
    let_pass(simulation, terminal, 0.2)
    assert read(line, 30).count(HELLO) == 1
    line.write(b"?")
    data, deadline = b"", time.monotonic() + 60
    while HELLO not in data and time.monotonic() < deadline:
        let_pass(simulation, terminal, 0.01)
        data += b"".join(chunk.data for chunk in line.drain())
    let_pass(simulation, terminal, 0.2)
    assert (data + read(line, 30)).count(HELLO) == 1
    line.close()


def test_what_nobody_reads_is_lost_and_holds_nothing_up(simulation, terminal):
    with terminal.port.open("rb", buffering=0):
        began = time.monotonic()
        for _ in range(300):
            simulation.clock.sleep(0.1)
            terminal.exchange()
        assert time.monotonic() - began < 60


def test_the_port_says_that_its_meter_is_simulated(simulation, terminal):
    assert port_problem(str(terminal.port)) is None
    line = opened(terminal)
    assert line.is_simulated
    line.close()


def test_another_port_does_not():
    line = SerialPort("loop://", SystemClock())
    assert not line.is_simulated
    line.close()


def test_the_port_is_gone_when_it_is_closed(simulation):
    terminal = MeterTerminal(simulation)
    terminal.close()
    terminal.close()
    assert not terminal.port.is_symlink()
    assert not terminal.port.parent.exists()
