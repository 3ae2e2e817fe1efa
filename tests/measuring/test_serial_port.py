"""A real serial line, on pseudo-terminals: what arrives is stamped and kept, and a loss is told once it was taken."""

from __future__ import annotations

import os
import socket
import threading
import time

import pytest
from tests.processor_wait import ProcessorWait

from robot_runner.core.errors import LinkError
from robot_runner.core.events.context import SystemClock
from robot_runner.measuring import serial_line
from robot_runner.measuring.devices import open_serial_line
from robot_runner.measuring.serial_line import SerialLine, SerialPort, found_ports, port_problem
from robot_runner.testing import FakeClock, make_context

PATIENCE = 60.0


class Device:
    """The other end of a pseudo-terminal."""

    def __init__(self) -> None:
        self.end, host = os.openpty()
        self.port = os.ttyname(host)
        self._host = host

    def send(self, data: bytes) -> None:
        os.write(self.end, data)

    def receive(self, count: int) -> bytes:
        return os.read(self.end, count)

    def unplug(self) -> None:
        for end in (self.end, self._host):
            try:
                os.close(end)
            except OSError:
                continue


@pytest.fixture
def device():
    device = Device()
    yield device
    device.unplug()


@pytest.fixture
def line(device):
    line = SerialPort(device.port, SystemClock())
    yield line
    line.close()


def drained(line: SerialPort, count: int) -> list:
    """Drain until so many bytes have come."""
    chunks, deadline = [], time.monotonic() + PATIENCE
    while sum(len(chunk.data) for chunk in chunks) < count:
        assert time.monotonic() < deadline, f"{chunks} arrived"
        chunks += line.drain()
        time.sleep(0.001)
    return chunks


def refusal(line: SerialPort) -> LinkError:
    """Drain until it raises."""
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        try:
            line.drain()
        except LinkError as error:
            return error
        time.sleep(0.001)
    raise AssertionError("the line never said that it was lost")


def test_it_is_a_serial_line_to_something_real(line):
    assert isinstance(line, SerialLine)
    assert not line.is_simulated


def test_what_arrives_is_kept_in_order_until_it_is_drained(device, line):
    for piece in (b"\xa5\x5a", bytes(range(256)), b"\r\n\x03\x11\x13"):
        device.send(piece)
    chunks = drained(line, 263)
    assert b"".join(chunk.data for chunk in chunks) == b"\xa5\x5a" + bytes(range(256)) + b"\r\n\x03\x11\x13"
    assert line.drain() == []


def test_each_piece_is_stamped_on_the_runs_clock_when_it_arrives(device):
    clock = FakeClock(100.0)
    line = SerialPort(device.port, clock)
    device.send(b"first")
    (first,) = drained(line, 5)
    clock.sleep(7.0)
    device.send(b"second")
    chunks = drained(line, 6)
    line.close()
    assert first.received_at == 100.0
    assert {chunk.received_at for chunk in chunks} == {107.0}


def test_what_is_written_reaches_the_device(device, line):
    line.write(b"?")
    assert device.receive(1) == b"?"


def test_a_device_that_is_unplugged_is_told_after_what_it_sent(device, line):
    device.send(b"last words")
    deadline = time.monotonic() + PATIENCE
    while sum(len(chunk.data) for chunk in line._chunks) < 10 and time.monotonic() < deadline:
        time.sleep(0.001)  # a terminal that is closed takes with it what nobody has read
    device.unplug()
    assert b"".join(chunk.data for chunk in drained(line, 10)) == b"last words"
    error = refusal(line)
    assert error.problem == f"{device.port} is gone: its device was unplugged"
    assert device.port in error.where
    with pytest.raises(LinkError, match="unplugged"):
        line.drain()


def test_writing_to_a_device_that_is_unplugged_is_an_error(device, line):
    device.unplug()
    refusal(line)
    with pytest.raises(LinkError, match=device.port):
        line.write(b"?")


def test_closing_ends_the_reader_and_may_be_done_twice(device):
    line = SerialPort(device.port, SystemClock())
    begun, wait = time.monotonic(), ProcessorWait([os.getpid()])
    line.close()
    line.close()
    wait.look()
    assert time.monotonic() - begun - wait.seconds < 2.0
    assert not [thread for thread in threading.enumerate() if device.port in thread.name]
    with pytest.raises(LinkError, match="closed"):
        line.drain()
    with pytest.raises(LinkError, match="closed"):
        line.write(b"?")


def test_a_port_can_be_opened_again_after_it_was_closed(device):
    SerialPort(device.port, SystemClock()).close()
    line = SerialPort(device.port, SystemClock())
    device.send(b"again")
    assert drained(line, 5)[0].data == b"again"
    line.close()


def test_a_port_that_somebody_has_open_is_refused(device, line):
    with pytest.raises(LinkError, match="another program has it open") as caught:
        SerialPort(device.port, SystemClock())
    assert "End the other program" in caught.value.fix
    assert line.drain() == []


def test_a_port_that_is_not_there_is_told_with_the_nearest_name(monkeypatch):
    monkeypatch.setattr(serial_line, "found_ports", lambda: ["/dev/ttyS0", "/dev/ttyUSB0"])
    problem = port_problem("/dev/ttyUSB1")
    assert problem.problem == "there is no serial port '/dev/ttyUSB1'"
    assert problem.fix == "Did you mean '/dev/ttyUSB0'?"
    with pytest.raises(LinkError, match="ttyUSB1"):
        SerialPort("/dev/ttyUSB1", SystemClock())


def test_without_any_port_the_fix_is_to_plug_the_device_in(monkeypatch):
    monkeypatch.setattr(serial_line, "found_ports", list)
    assert port_problem("/dev/ttyUSB1").fix.startswith("Plug the device in")


def test_a_file_that_is_no_port_is_refused(tmp_path):
    (file := tmp_path / "notes.txt").write_text("")
    assert "is not a serial port" in port_problem(str(file)).problem
    assert "is not a serial port" in port_problem(str(tmp_path)).problem


def test_a_device_that_is_no_serial_port_is_refused_when_it_is_opened():
    with pytest.raises(LinkError, match="cannot be opened"):
        SerialPort("/dev/null", SystemClock())


def test_a_port_of_another_user_is_told_with_the_group_to_join(device, monkeypatch):
    monkeypatch.setattr(os, "access", lambda *_: False)
    assert "dialout" in port_problem(device.port).fix


def test_a_port_that_can_be_opened_has_no_problem_and_is_not_touched_by_asking(device, line):
    assert port_problem(device.port) is None
    device.send(b"x")
    assert drained(line, 1)[0].data == b"x"


def test_without_pyserial_the_fix_is_to_install_the_extra(device, monkeypatch):
    def refuse(name):
        raise ModuleNotFoundError(f"No module named {name!r}", name=name)

    monkeypatch.setattr(serial_line, "import_module", refuse)
    assert found_ports() == []
    assert port_problem(device.port).fix == "Install it: pip install 'robot-runner[serial]'."
    assert port_problem("rfc2217://robot:4000").fix == "Install it: pip install 'robot-runner[serial]'."
    with pytest.raises(LinkError, match="pyserial"):
        SerialPort(device.port, SystemClock())


def test_a_port_on_the_network_is_opened_by_its_url():
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(PATIENCE)
        line = SerialPort(f"socket://127.0.0.1:{server.getsockname()[1]}", SystemClock())
        peer, _ = server.accept()
        with peer:
            peer.sendall(b"from afar")
            assert b"".join(chunk.data for chunk in drained(line, 9)) == b"from afar"
        assert "was lost" in refusal(line).problem
        line.close()


def test_a_port_on_the_network_that_does_not_answer_is_refused():
    with pytest.raises(LinkError, match="cannot be opened"):
        SerialPort("socket://127.0.0.1:1", SystemClock())


def test_a_run_opens_a_port_once_and_closes_it(device, tmp_path):
    context = make_context(tmp_path, robot=None, clock=SystemClock())
    line = open_serial_line(context, device.port)
    assert isinstance(line, SerialPort)
    assert open_serial_line(context, device.port, namespace="/alice") is line
    context.resources.close()
    with pytest.raises(LinkError, match="closed"):
        line.drain()


def test_two_ports_are_two_lines(device, tmp_path):
    other = Device()
    context = make_context(tmp_path, robot=None, clock=SystemClock())
    first, second = open_serial_line(context, device.port), open_serial_line(context, other.port)
    other.send(b"second")
    assert drained(second, 6)[0].data == b"second"
    assert first.drain() == []
    context.resources.close()
    other.unplug()
