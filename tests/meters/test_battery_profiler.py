from __future__ import annotations

import csv
import json
import math
import struct

import pytest

from robot_runner.core.errors import LinkError, PluginError
from robot_runner.core.events.measure import Origin
from robot_runner.core.links.robot import Encoding
from robot_runner.plugins import Circumstances
from robot_runner.plugins.profilers import Battery, Ina219
from robot_runner.plugins.systems import BasicTurtlebot3
from robot_runner.testing import FakeClock, FakeLinks, FakeRobotLink, ProfilerContract, make_context, rehearse


class TestBatteryOnTheSimulatedRobot(ProfilerContract):
    def make_plugin(self) -> Battery:
        return Battery()


class TestBatteryOfAScriptedRobot(ProfilerContract):
    def make_plugin(self) -> Battery:
        return Battery(rate_hz=10.0)

    def make_links(self, clock: FakeClock) -> FakeLinks:
        robot = FakeRobotLink(clock)
        clock.every(0.1, lambda: robot.deliver("battery_state", {"voltage": 12.0, "current": -0.7, "percentage": 0.5}))
        return FakeLinks(robot=robot)


@pytest.fixture
def measure(tmp_path):
    def execute(say, *, seconds=10.0, is_simulated=False):
        clock = FakeClock(50.0)
        robot = FakeRobotLink(clock, is_simulated=is_simulated)
        clock.every(0.1, lambda: say(clock.now()) and robot.deliver("battery_state", say(clock.now())))
        plugin = Battery(rate_hz=10.0)
        context = make_context(tmp_path, plugin, links=FakeLinks(robot=robot), clock=clock)
        rehearse(context, plugin, mission=lambda: clock.sleep(seconds))
        return context

    return execute


def test_voltage_charge_and_energy_are_those_of_the_measured_window(measure):
    def say(time):
        return {"voltage": 12.0 - 0.1 * (time - 50.0), "current": -0.5, "percentage": 0.9 - 0.01 * (time - 50.0)}

    context = measure(say)
    assert context.measures["MeanVoltage"] == pytest.approx(11.5, abs=0.01)
    assert context.measures["MinVoltage"] == pytest.approx(11.0)
    assert context.measures["ChargeUsed"] == pytest.approx(10.0, abs=0.001)
    assert context.measures["Energy"] == pytest.approx(11.5 * 0.5 * 10.0, rel=0.01)


@pytest.mark.parametrize("current", [math.nan, 0.0], ids=["as ROS has it", "as OpenCR has it"])
def test_a_battery_that_does_not_measure_its_current_yields_no_energy(measure, current):
    context = measure(lambda _: {"voltage": 12.0, "current": current, "percentage": math.nan})
    assert context.measures["MeanVoltage"] == pytest.approx(12.0)
    assert context.measures["Energy"] is None
    assert context.measures["ChargeUsed"] is None
    facts = json.loads((context.raw_data_folder / "quality.json").read_text())
    assert facts["measures_current"] is False


def float32(number):
    return struct.unpack("f", struct.pack("f", number))[0]


def test_what_an_autopilot_does_not_measure_is_missing_in_the_messages_of_mavros(measure):
    # MAVLink's UINT16_MAX mV and -1 for the current and the state of charge, as mavros' sys_status.cpp converts them.
    unknown = {"voltage": float32(65.535), "current": float32(0.01), "percentage": float32(-0.01)}
    context = measure(lambda _: unknown)
    assert set(context.measures.values()) == {None}
    context = measure(lambda _: {**unknown, "voltage": 14.8})
    assert context.measures["MeanVoltage"] == pytest.approx(14.8)
    assert context.measures["Energy"] is None


def test_steps_that_are_fine_for_the_mission_may_be_coarse_for_a_phase(tmp_path):
    clock = FakeClock(50.0)
    robot = FakeRobotLink(clock)

    def deliver():  # in steps of 1 %, of which the mission takes 15
        charge = math.floor(90.0 - 0.5 * (clock.now() - 50.0)) / 100
        robot.deliver("battery_state", {"voltage": 12.0, "percentage": charge})

    clock.every(0.1, deliver)
    plugin = Battery(rate_hz=10.0)
    phases = ["climb", "rest", "dock"]
    context = make_context(tmp_path, plugin, links=FakeLinks(robot=robot), clock=clock, phases=phases)

    def mission():
        for phase, seconds in (("climb", 25.0), ("rest", 3.3), ("dock", 0.5), ("rest", 1.0)):
            with context.phase(phase):
                clock.sleep(seconds)

    rehearse(context, plugin, mission=mission)
    told = [(each["problem"], each["measures"]) for kind, each in context.broker.records if kind == "finding"]
    assert told == [
        ("phase 'rest': the charge is reported in steps of 1 %: ChargeUsed may be off by 50 %", ["ChargeUsed.rest"]),
        (
            "phase 'dock': the charge stayed as it was: ChargeUsed lacks what is less than a step of it",
            ["ChargeUsed.dock"],
        ),
    ]


@pytest.mark.parametrize(("encoding", "rate"), [(Encoding.ROS1, 30.0), (Encoding.CDR, 20.0)])
def test_messages_at_the_rate_of_a_turtlebot3_are_not_doubted(tmp_path, encoding, rate):
    clock = FakeClock(50.0)
    robot = FakeRobotLink(clock)
    robot.encoding = encoding
    clock.every(1 / rate, lambda: robot.deliver("battery_state", {"voltage": 12.0, "percentage": math.nan}))
    plugin = Battery()
    context = make_context(tmp_path, plugin, links=FakeLinks(robot=robot), clock=clock)
    rehearse(context, plugin, mission=lambda: clock.sleep(10.0))
    assert context.measures["MeanVoltage"] == pytest.approx(12.0)
    assert _problems(context) == []


def _problems(context):
    return [finding.problem for finding in context.broker.findings]


def test_a_current_that_is_told_for_a_part_of_the_mission_yields_no_energy_of_the_whole(measure):
    context = measure(lambda time: {"voltage": 12.0, "current": -0.5 if time > 55.0 else math.nan, "percentage": 0.5})
    assert context.measures["MeanVoltage"] == pytest.approx(12.0)
    assert context.measures["Energy"] is None
    assert any(problem.startswith("the battery's current was NaN in ") for problem in _problems(context))


def test_a_message_without_a_number_now_and_then_is_bridged(measure):
    context = measure(lambda time: {"voltage": 12.0, "current": math.nan if round(time * 10) % 4 == 0 else -0.5})
    assert context.measures["Energy"] == pytest.approx(60.0)
    assert not _problems(context)


def test_a_robot_that_falls_silent_shortly_before_the_end_has_used_no_less(measure):
    context = measure(lambda time: time < 69.15 and {"voltage": 12.0, "current": -0.5, "percentage": 0.5}, seconds=20.0)
    assert context.measures["Energy"] == pytest.approx(120.0)


@pytest.mark.parametrize("zero_until", [0.0, 50.35, 99.0], ids=["never", "at first", "throughout"])
def test_a_battery_of_no_volt_is_one_whose_voltage_was_not_measured(measure, zero_until):
    context = measure(lambda time: {"voltage": 12.0 if time > zero_until else 0.0, "current": -0.5, "percentage": 0.5})
    known = zero_until < 60.0
    assert context.measures["MinVoltage"] == (12.0 if known else None)
    assert context.measures["MeanVoltage"] == (pytest.approx(12.0) if known else None)
    assert context.measures["Energy"] == (pytest.approx(60.0, rel=0.01) if known else None)


def test_an_energy_below_nothing_is_doubted(measure):
    context = measure(lambda time: {"voltage": 12.0, "current": 0.5, "percentage": 0.5 + 1e-4 * (time - 50.0)})
    assert context.measures["Energy"] == pytest.approx(-60.0)
    assert _problems(context) == [
        "the energy is -60 J: the robot reports its current with the wrong sign, or was charged"
    ]


@pytest.mark.parametrize("digits", [6, 2], ids=["ROS 1", "ROS 2"])
def test_a_state_of_charge_that_is_the_voltage_is_doubted(measure, digits):
    # turtlebot3_core and turtlebot3_node: percentage = voltage / 11.1, of a voltage in hundredths over ROS 2.
    def say(time):
        volts = round(12.2 - 0.01 * (time - 50.0) - 0.2 * (round(time * 10) % 7 < 3), digits)
        return {"voltage": volts, "current": math.nan, "percentage": round(volts / 11.1, 2 + digits)}

    problem = "the state of charge is the voltage / 11.1 V in all messages, as a TurtleBot3's board reckons it"
    assert _problems(measure(say)) == [f"{problem}: ChargeUsed is how far the voltage fell"]


def test_a_state_of_charge_that_falls_beside_a_voltage_that_sags_is_none_of_it(measure):
    def say(time):
        volts = 12.2 - 0.01 * (time - 50.0) - 0.2 * (round(time * 10) % 7 < 3)
        return {"voltage": volts, "current": math.nan, "percentage": 0.9 - 0.01 * (time - 50.0)}

    assert _problems(measure(say)) == []


def test_a_state_of_charge_that_is_told_in_percent_is_doubted(measure):
    context = measure(lambda time: {"voltage": 12.0, "current": -0.5, "percentage": 85.0 - 0.01 * (time - 50.0)})
    assert _problems(context) == [
        "the robot reports percentage = 85, where sensor_msgs/BatteryState has 0 to 1: ChargeUsed may be 100-fold"
    ]


@pytest.mark.parametrize(("steps", "off"), [(100, "50 %"), (2_000, "")])
def test_a_state_of_charge_that_is_told_in_coarse_steps_is_doubted(measure, steps, off):
    def say(time):
        return {
            "voltage": 12.0,
            "current": -0.5,
            "percentage": math.floor((0.905 - 0.002 * (time - 50.0)) * steps) / steps,
        }

    context = measure(say)
    assert context.measures["ChargeUsed"] == pytest.approx(2.0, abs=0.2)
    told = [each for each in _problems(context) if "steps" in each]
    assert told == ([f"the charge is reported in steps of 1 %: ChargeUsed may be off by {off}"] if off else [])


def test_a_charge_that_never_changed_is_doubted(measure):
    # In steps of 1 %, as many drivers tell it, 0.8 % are used unseen.
    context = measure(lambda time: {"voltage": 12.0, "percentage": math.ceil(100 * (0.9 - 8e-4 * (time - 50.0))) / 100})
    assert context.measures["ChargeUsed"] == 0.0
    assert _problems(context) == ["the charge stayed as it was: ChargeUsed lacks what is less than a step of it"]


def test_a_robot_that_falls_silent_yields_no_value_and_a_warning(measure):
    context = measure(lambda time: {"voltage": 12.0} if time < 55.0 else None)
    assert set(context.measures.values()) == {None}
    assert any("the largest gap" in finding.problem for finding in context.broker.findings)


@pytest.mark.parametrize(("is_simulated", "origin"), [(True, Origin.SIMULATED), (False, Origin.MEASURED)])
def test_values_say_where_they_come_from(measure, is_simulated, origin):
    context = measure(lambda _: {"voltage": 12.0}, is_simulated=is_simulated)
    assert {published.origin for published in context.broker.measures.values()} == {origin}


def test_what_was_heard_is_kept(measure):
    context = measure(lambda _: {"voltage": 12.0, "current": -0.5, "percentage": math.nan})
    with (context.raw_data_folder / "samples.csv").open(newline="") as file:
        row = next(csv.DictReader(file))
    assert row == {"time_s": "50.100000", "voltage_V": "12.0000", "current_A": "0.5000", "charge_percent": ""}


def test_a_robot_that_cannot_be_heard_fails_the_run(tmp_path):
    clock = FakeClock()
    robot = FakeRobotLink(clock)
    robot.fault = LinkError("there is no topic 'battery_state'", where="robot", fix="Start the robot.")
    plugin = Battery()
    context = make_context(tmp_path, plugin, links=FakeLinks(robot=robot), clock=clock)
    with pytest.raises(LinkError, match="no topic"):
        rehearse(context, plugin)


@pytest.mark.long
def test_the_simulated_battery_agrees_with_the_simulated_meter(tmp_path):
    short = {"sleep_s": 2.0, "drive_s": 4.0, "task_s": 5.0, "rotate_s": 5.0}
    system, battery, meter = BasicTurtlebot3(task="Video", task_factor=None, **short), Battery(), Ina219()
    context = make_context(tmp_path, system, battery, meter)
    measures = rehearse(context, system, battery, meter)
    context.resources.close()
    assert measures["Battery.Energy"] == pytest.approx(measures["Ina219.Energy"], rel=0.02)
    assert context.broker.measures["Battery.Energy"].origin is Origin.SIMULATED


def test_without_a_robot_the_check_says_how_to_name_one():
    (finding,) = Battery().check(Circumstances())
    assert "--set robot=simulated" in finding.fix


def test_a_rate_that_cannot_be_is_refused():
    with pytest.raises(PluginError, match="rate_hz is 0"):
        Battery(rate_hz=0.0)
