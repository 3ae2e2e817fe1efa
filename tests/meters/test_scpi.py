"""Instruments that speak SCPI: a server over TCP through pyvisa-py, and an instrument of pyvisa-sim."""

from __future__ import annotations

import csv
import json
import os
import pty
import threading
import time
import tty
from contextlib import contextmanager
from typing import TYPE_CHECKING

import pytest
from tests.loopback_port import claim_port
from tests.meters.rehearsed import measured, only_finding, problems
from tests.meters.scpi_server import ScpiServer
from tests.waiting import PATIENCE, wait_until

from robot_runner.core.errors import PluginError
from robot_runner.core.events.context import SystemClock
from robot_runner.meters import scpi
from robot_runner.meters.scpi import parse_number
from robot_runner.plugins import Circumstances
from robot_runner.plugins.profilers import Scpi
from robot_runner.testing import FakeClock, ProfilerContract, make_context, rehearse

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

pytest.importorskip("pyvisa", reason="pyvisa is not installed")
pytest.importorskip("pyvisa_py", reason="pyvisa-py is not installed")


@pytest.fixture
def server():
    started = ScpiServer()
    yield started
    started.stop()


def test_power_is_voltage_times_current_over_tcp(tmp_path, server):
    clock = FakeClock(10.0)
    clock.at(15.0, lambda: server.numbers.update(current=1.0))
    context = measured(tmp_path, Scpi(server.resource), clock, 10.0)
    assert context.measures["Energy"] == pytest.approx(12.0 * 0.5 * 5 + 12.0 * 1.0 * 5, rel=0.02)
    assert context.measures["MeanVoltage"] == pytest.approx(12.0)
    facts = json.loads((context.raw_data_folder / "quality.json").read_text())
    assert facts["identity"] == "Robot Runner,Fake Supply,1,1.0"
    with (context.raw_data_folder / "samples.csv").open(newline="") as file:
        assert list(next(csv.DictReader(file))) == ["time_s", "power_W", "voltage_V", "current_A"]


def test_an_analyser_is_asked_for_power_and_its_energy_counter(tmp_path, server):
    clock = FakeClock(0.0)
    server.answers |= {
        "NUM:VAL? 3": "8.5 W",
        "INT:WH?": lambda: f"{clock.now() * 8.5 / 3600:.9f}",
    }
    plugin = Scpi(server.resource, power="NUM:VAL? 3", voltage=None, current=None, energy="INT:WH?")
    context = measured(tmp_path, plugin, clock, 20.0)
    assert context.measures["Energy"] == pytest.approx(170.0, rel=1e-3)
    assert context.measures["MeanVoltage"] is None
    facts = json.loads((context.raw_data_folder / "quality.json").read_text())
    assert facts["energy_from"] == {"": "counter"}


def test_setup_is_sent_before_the_measurement(tmp_path, server):
    measured(tmp_path, Scpi(server.resource, setup=["SYST:REM"]), FakeClock(), 1.0)
    assert next(line for line in server.received if line not in {"SYST:ERR?", "*IDN?"}) == "SYST:REM"


@contextmanager
def hurried(instrument):
    """Have the instrument waited for so shortly meanwhile; what it is to answer may take long on a busy machine."""
    instrument._resource.timeout = 100
    try:
        yield
    finally:
        if instrument._resource is not None:
            instrument._resource.timeout = round(instrument._plugin.timeout_s * 1000)


def test_an_answer_that_comes_too_late_is_not_taken_for_the_next(tmp_path, server, monkeypatch):
    # The voltage comes once its question was given up: taken for the current it would be 144 W.
    plugin, clock = Scpi(server.resource, timeout_s=20, rate_hz=20.0), SystemClock()
    context = make_context(tmp_path, plugin, robot=None, clock=clock)
    asked, prompt = scpi._Instrument._asked, server.answers["MEAS:VOLT?"]
    is_measuring, is_given_up = threading.Event(), threading.Event()

    def late() -> str:
        server.answers["MEAS:VOLT?"] = prompt
        is_given_up.wait(PATIENCE)
        return prompt()

    def ask(instrument, query):
        if query != "MEAS:VOLT?" or not is_measuring.is_set() or is_given_up.is_set():
            return asked(instrument, query)
        server.answers[query] = late  # not before: else the question before it may be answered late
        try:
            with hurried(instrument):
                return asked(instrument, query)
        finally:
            is_given_up.set()

    def mission() -> None:
        clock.sleep(0.5)
        is_measuring.set()
        assert is_given_up.wait(PATIENCE)
        clock.sleep(0.5)

    monkeypatch.setattr(scpi._Instrument, "_asked", ask)

    rehearse(context, plugin, mission=mission)
    with (context.raw_data_folder / "samples.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["power_W"] for row in rows} == {"6.000000"}
    assert any("failed, the first with: VisaIOError" in problem for problem in problems(context))


@pytest.mark.parametrize("surplus", ["+5.00000E-01", "!FAN WARNING", " "])
@pytest.mark.parametrize("behind", ["MEAS:VOLT?", "MEAS:CURR?"])
def test_what_was_not_asked_for_costs_a_reading_and_is_not_taken_for_the_next_answer(tmp_path, server, surplus, behind):
    voltage, clock = server.answers["MEAS:VOLT?"], FakeClock(10.0)

    def disturb() -> None:
        server.answers["MEAS:VOLT?"] = voltage
        server.surplus = surplus

    def disturbed() -> str:
        disturb()  # the voltage's own answer is out of the way
        return voltage()

    if behind == "MEAS:VOLT?":
        clock.at(15.05, disturb)
    else:
        clock.at(15.05, lambda: server.answers.update({"MEAS:VOLT?": disturbed}))
    context = measured(tmp_path, Scpi(server.resource), clock, 10.0)
    assert context.measures["MeanVoltage"] == pytest.approx(12.0)
    assert context.measures["MeanCurrent"] == pytest.approx(0.5)
    (problem,) = [each for each in problems(context) if "stuck" not in each]
    assert problem.startswith("1 reading failed, the first with: SurplusError: the instrument sends")


@contextmanager
def serial_instrument(answered: Callable[[bytes], bytes]) -> Iterator[str]:
    """Yield the address of an instrument at a serial line."""
    other_end, line = pty.openpty()
    for each in (other_end, line):
        tty.setraw(each)

    def answer() -> None:
        with os.fdopen(other_end, "r+b", buffering=0) as instrument:
            for query in iter(instrument.readline, b"END\n"):
                instrument.write(answered(query.strip()))

    answering = threading.Thread(target=answer)
    answering.start()
    try:
        yield f"ASRL{os.ttyname(line)}::INSTR"
    finally:
        os.write(line, b"END\n")
        answering.join()
        os.close(line)


_SERIAL = {b"*IDN?": b"Robot Runner,Fake Supply,1,1.0\n", b"MEAS:VOLT?": b"12.0\n", b"MEAS:CURR?": b"0.5\n"}


def test_what_comes_byte_by_byte_over_a_serial_line_is_not_taken_for_the_next_answer(tmp_path):
    # Of a notice, "12.5", one byte is there when the current is to be asked for, the others come before its answer.
    heard: list[bytes] = []

    def answered(query: bytes) -> bytes:
        heard.append(query)
        answer = _SERIAL.get(query, b'0,"No error"\n')
        if heard.count(b"MEAS:VOLT?") != 2:  # it has been tried
            return answer
        return {b"MEAS:VOLT?": b"12.0\n1", b"MEAS:CURR?": b"2.5\n0.5\n"}.get(query, answer)

    with serial_instrument(answered) as resource:
        context = measured(tmp_path, Scpi(resource, timeout_s=20), FakeClock(10.0), 10.0)
    assert context.measures["MeanVoltage"] == pytest.approx(12.0)
    assert context.measures["MeanCurrent"] == pytest.approx(0.5)
    (problem,) = [each for each in problems(context) if "stuck" not in each]
    assert "1 reading failed, the first with: SurplusError: the instrument sends what it was not asked for" in problem


@pytest.mark.parametrize("end", [b"\n\r", b" \n", b"\r\n"])
def test_blanks_at_the_end_of_an_answer_are_no_answer(tmp_path, end):
    with serial_instrument(lambda query: _SERIAL.get(query, b'0,"No error"\n').replace(b"\n", end)) as resource:
        context = measured(tmp_path, Scpi(resource, timeout_s=20), FakeClock(), 5.0)
    assert context.measures["MeanVoltage"] == pytest.approx(12.0)
    assert context.measures["MeanCurrent"] == pytest.approx(0.5)
    assert not [each for each in problems(context) if "stuck" not in each]


def test_an_instrument_that_greets_whoever_connects_is_refused_and_not_misread(server):
    server.banner = "Welcome to the supply\n"
    finding = only_finding(Scpi(server.resource))
    assert finding.problem == "the instrument sends what it was not asked for, such as 'Welcome to the supply'"
    assert "5025" in finding.fix


@pytest.mark.parametrize("behind", ["MEAS:VOLT?", "MEAS:CURR?"])
def test_an_instrument_that_sends_more_than_it_is_asked_for_when_tried_is_refused(server, behind):
    known = server.answers[behind]
    server.answers[behind] = lambda: f"{known()}\n!FAN WARNING"
    finding = only_finding(Scpi(server.resource))
    assert finding.problem == "the instrument sends what it was not asked for, such as '!FAN WARNING'"


def test_an_instrument_that_echoes_is_refused_with_what_to_switch_off(server):
    identity = server.answers["*IDN?"]
    server.answers["*IDN?"] = f"*IDN?\n{identity}"
    finding = only_finding(Scpi(server.resource))
    assert finding.problem == "the instrument sends what it was not asked for, such as '*IDN?'"
    assert "switch its echo off" in finding.fix


def test_an_instrument_that_falls_silent_blocks_no_mission(tmp_path, server, monkeypatch):
    plugin, clock = Scpi(server.resource, timeout_s=20, rate_hz=10.0), SystemClock()
    context = make_context(tmp_path, plugin, robot=None, clock=clock)
    asked, falls_silent = scpi._Instrument._asked, threading.Event()

    def ask(instrument, query):
        if not falls_silent.is_set():
            return asked(instrument, query)
        server.is_mute = True
        with hurried(instrument):
            return asked(instrument, query)

    silent_since: list[float] = []

    def mission() -> None:
        clock.sleep(0.3)
        silent_since.append(time.monotonic())
        falls_silent.set()
        clock.sleep(0.7)

    monkeypatch.setattr(scpi._Instrument, "_asked", ask)
    rehearse(context, plugin, mission=mission)
    assert time.monotonic() - silent_since[0] < 5.0
    assert set(context.measures.values()) == {None}


def test_an_overload_is_no_value(tmp_path, server):
    clock = FakeClock()
    clock.at(1.0, lambda: server.answers.update({"MEAS:CURR?": "9.90000E+37"}))
    clock.at(1.5, lambda: server.answers.update({"MEAS:CURR?": "0.5"}))
    context = measured(tmp_path, Scpi(server.resource), clock, 10.0)
    assert context.measures["Energy"] == pytest.approx(60.0)
    assert any("an overload, or no value" in problem for problem in problems(context))


def test_a_good_instrument_has_no_findings(server):
    assert list(Scpi(server.resource).check(Circumstances())) == []


def test_a_query_that_it_does_not_know_is_told_with_its_own_words(server, monkeypatch):
    asked = scpi._Instrument._asked

    def ask(instrument, query):
        if query != "MEAS:PWR?":
            return asked(instrument, query)
        with hurried(instrument):
            try:
                return asked(instrument, query)
            finally:
                wait_until(lambda: server.errors)

    monkeypatch.setattr(scpi._Instrument, "_asked", ask)
    finding = only_finding(Scpi(server.resource, power="MEAS:PWR?", timeout_s=20))
    assert "MEAS:PWR?" in finding.problem
    assert "Undefined header" in finding.problem


def test_a_setup_that_it_refuses_is_told_with_its_own_words(server):
    finding = only_finding(Scpi(server.resource, setup=["SENS:CURRR 3"]))
    assert 'refuses its setup: -113,"Undefined header"' in finding.problem


@pytest.mark.parametrize("setup", [[], ["SYST:REM"]])
def test_errors_that_others_have_left_in_the_queue_are_not_of_this_setup(server, setup):
    server.errors = ['-222,"Data out of range"'] * 3
    assert list(Scpi(server.resource, setup=setup).check(Circumstances())) == []


def test_an_instrument_without_a_queue_of_errors_is_measured_with(server, monkeypatch):
    server.has_queue, complaint = False, scpi._Instrument._complaint

    def complain(instrument):
        with hurried(instrument):
            return complaint(instrument)

    monkeypatch.setattr(scpi._Instrument, "_complaint", complain)
    assert list(Scpi(server.resource, setup=["SYST:REM"], timeout_s=20).check(Circumstances())) == []


def test_nothing_at_the_address_is_told():
    finding = only_finding(Scpi(f"TCPIP::127.0.0.1::{claim_port()}::SOCKET", timeout_s=0.5))
    assert "does not answer" in finding.problem
    assert finding.fix


def test_a_mute_instrument_is_told(server):
    server.is_mute = True
    finding = only_finding(Scpi(server.resource, timeout_s=0.2))
    assert "does not answer" in finding.problem
    assert "terminator" in finding.fix


def test_an_address_that_is_none_is_told():
    assert "TCPIP::192.168.0.5" in only_finding(Scpi("192.168.0.5")).fix


def test_a_machine_without_the_library_is_told_which_extra_brings_it(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert "robot-runner[scpi]" in only_finding(Scpi("TCPIP::127.0.0.1::1::SOCKET")).fix


@pytest.mark.parametrize(
    "settings",
    [{"voltage": None, "current": None}, {"energy_unit": "kwh"}, {"timeout_s": 0}, {"rate_hz": 0}, {"setup": "*RST"}],
)
def test_what_cannot_be_is_refused(settings):
    with pytest.raises(PluginError):
        Scpi("TCPIP::127.0.0.1::1::SOCKET", **settings)


@pytest.mark.parametrize(
    ("answer", "number"),
    [
        ("150 mA", 0.15),
        ("150 mADC", 0.15),
        ("150 mAmps", 0.15),
        ("7600MW", 7.6),
        ("1.2 kW", 1200.0),
        ("12.5 V", 12.5),
        ("1.250E+01A,0.3", 12.5),
        ("3,mA", 3.0),
        ("0.5 AMPS", 0.5),
        ("12.5 V DC\r", 12.5),
        # Behind the reading, a Keithley 2001 tells by an N that it is normal (user's manual, figure 4-19).
        ("+1.2000000E+01NVDC,+0000000.0SECS,+00012RDNG#,00EXTCHAN", 12.0),
        ("+4.9990000E-01NADC", 0.4999),
        ("150 NA", 150e-9),
    ],
)
def test_a_prefix_of_an_answers_unit_counts(answer, number):
    assert parse_number(answer) == pytest.approx(number)


@pytest.mark.parametrize(
    ("answer", "unit", "number"),
    [
        ("1.2 kWh", "kWh", 1.2),
        ("1.2 kWh", "Wh", 1200.0),
        ("500mWh", "Wh", 0.5),
        ("1.2", "kWh", 1.2),
        ("7 kJ", "J", 7e3),
    ],
)
def test_an_energy_is_in_the_answers_unit_where_it_has_one(answer, unit, number):
    assert parse_number(answer, unit) == pytest.approx(number)


@pytest.mark.parametrize(
    ("answer", "unit"), [("1.5A", "V"), ("12.0 V", "W"), ("1.5 kVA", "W"), ("3 Ah", "Wh"), ("+1.0E+01NVDC", "A")]
)
def test_an_answer_in_the_unit_of_another_quantity_is_refused(answer, unit):
    with pytest.raises(ValueError, match=f"not {unit}"):
        parse_number(answer, unit)


def test_a_query_for_another_quantity_is_an_error_of_the_check(server):
    server.answers["MEAS:CURR?"] = "12.0 V"
    finding = only_finding(Scpi(server.resource))
    assert "'12.0 V', which is not A" in finding.problem
    assert "programming manual" in finding.fix


@pytest.mark.parametrize(
    "answer",
    [
        "",
        "ERR",
        "9.9E37",
        "-9.9E37",
        "9.91E+37",
        "+1.2E+01OVDC",
        "1 234.5",
        "0x1F",
        "1.2.3",
        "12V 3A",
        "50 OHM",
        "5.0NAN",
    ],
)
def test_answers_that_are_no_number_are_refused(answer):
    with pytest.raises(ValueError, match="the instrument answered"):
        parse_number(answer)


@pytest.mark.parametrize("answer", ["12,50", "-0,613 A", "+7,5W"])
def test_a_decimal_comma_is_not_taken_for_the_end_of_a_whole_number(answer):
    with pytest.raises(ValueError, match="with a comma"):
        parse_number(answer)


@pytest.mark.parametrize(
    ("answer", "number"), [("12.50,0", 12.5), ("+1.2E+01,+7.0E-01", 12.0), ("12,V", 12.0), ("3,0,1", 3.0)]
)
def test_of_several_numbers_the_first_counts(answer, number):
    assert parse_number(answer) == number


SIMULATED = """\
spec: "1.1"
devices:
  supply:
    eom:
      TCPIP SOCKET:
        q: "\\n"
        r: "\\n"
    error: ERROR
    dialogues:
      - {q: "*IDN?", r: "pyvisa-sim,supply,1,1.0"}
      - {q: "SYST:ERR?", r: '0,"No error"'}
      - {q: "MEAS:VOLT?", r: "+1.10000E+01"}
      - {q: "MEAS:CURR?", r: "+7.00000E-01"}
resources:
  TCPIP::localhost::5025::SOCKET:
    device: supply
"""


@pytest.fixture(scope="module")
def backend(tmp_path_factory):
    pytest.importorskip("pyvisa_sim", reason="pyvisa-sim is not installed")
    path = tmp_path_factory.mktemp("sim") / "supply.yaml"
    path.write_text(SIMULATED)
    return f"{path}@sim"


class TestScpiOnPyvisaSim(ProfilerContract):
    robot = None

    @pytest.fixture(autouse=True)
    def _backend(self, backend):
        self.backend = backend

    def make_plugin(self) -> Scpi:
        return Scpi("TCPIP::localhost::5025::SOCKET", backend=self.backend)

    def test_its_power_is_that_of_the_simulated_instrument(self, tmp_path):
        context = measured(tmp_path, self.make_plugin(), FakeClock(), 10.0)
        assert context.measures["MeanPower"] == pytest.approx(7.7)
        assert context.measures["Energy"] == pytest.approx(77.0)

    def test_a_query_that_is_answered_with_words_is_told(self):
        finding = only_finding(Scpi("TCPIP::localhost::5025::SOCKET", power="MEAS:POW?", backend=self.backend))
        assert "'ERROR', which is not a number" in finding.problem
