"""What stands in the way of the INA219 is found before anything is executed."""

from __future__ import annotations

import os

import pytest

from robot_runner.core.errors import PluginError
from robot_runner.measuring import serial_line
from robot_runner.plugins import Circumstances
from robot_runner.plugins.profilers import Ina219


@pytest.fixture
def port():
    device, host = os.openpty()
    yield os.ttyname(host)
    os.close(device)
    os.close(host)


def found(profiler, robot=None, plugins=()):
    return list(profiler.check(Circumstances(robot=robot, plugins=plugins)))


def test_on_the_simulated_robot_its_own_meter_needs_nothing():
    assert found(Ina219(), robot="simulated") == []
    assert found(Ina219(), robot="simulated:initial_charge=40") == []


@pytest.mark.parametrize("robot", [None, "ros2"])
def test_off_the_simulated_robot_a_way_to_the_meter_must_be_named(robot, monkeypatch):
    monkeypatch.setattr("robot_runner.meters.ina219.profiler.found_ports", lambda: ["/dev/ttyUSB3"])
    (finding,) = found(Ina219(), robot=robot)
    assert finding.is_error
    assert finding.fix == "Name its serial port, as in Ina219(port='/dev/ttyUSB3'). Or: --set robot=simulated."


@pytest.mark.parametrize("way", [{"port": "/dev/ttyUSB0"}, {"card": "INA219.BIN"}, {"sysfs": "auto"}])
def test_a_simulated_robot_has_no_other_meter_than_its_own(way):
    (finding,) = found(Ina219(**way), robot="simulated")
    ((name, value),) = way.items()
    assert finding.problem == f"{name} is {value!r}, and a simulated robot has a power meter of its own"


@pytest.mark.parametrize("robot", [None, "ros2"])
def test_a_port_that_can_be_opened_is_good_for_every_real_robot(robot, port):
    assert found(Ina219(port=port), robot=robot) == []


def test_a_port_that_is_not_there_is_found_with_the_nearest_name(monkeypatch):
    monkeypatch.setattr(serial_line, "found_ports", lambda: ["/dev/ttyACM0"])
    (finding,) = found(Ina219(name="arm", port="/dev/ttyACM1"))
    assert (finding.where, finding.fix) == ("plugin arm", "Did you mean '/dev/ttyACM0'?")


def test_two_meters_on_one_port_are_found_once_whatever_the_port_is_called(port, tmp_path):
    (tmp_path / "meter").symlink_to(port)
    first, second = Ina219(port=port), Ina219(name="again", port=str(tmp_path / "meter"), namespace="/alice")
    plugins = (first, second)
    assert found(first, plugins=plugins) == []
    (finding,) = found(second, plugins=plugins)
    assert finding.problem == "plugin Ina219 has the same serial line, and each would get some of the samples"


def test_two_meters_of_one_simulated_robot_are_found_and_those_of_two_robots_are_not():
    alice, bob, again = (
        Ina219(namespace="/alice"),
        Ina219(name="b", namespace="bob"),
        Ina219(name="a", namespace="alice"),
    )
    plugins = (alice, bob, again)
    assert [len(found(each, robot="simulated", plugins=plugins)) for each in plugins] == [0, 0, 1]


def test_two_meters_on_two_ports_are_good(port):
    device, host = os.openpty()
    plugins = (Ina219(port=port), Ina219(name="motors", port=os.ttyname(host)))
    assert [found(each, plugins=plugins) for each in plugins] == [[], []]
    os.close(device)
    os.close(host)


def test_a_card_must_be_a_file_that_may_yet_come(tmp_path):
    assert found(Ina219(card=str(tmp_path / "INA219.BIN"))) == []
    (finding,) = found(Ina219(card=str(tmp_path)))
    assert "a folder" in finding.problem


def test_a_driver_that_is_not_there_is_found(tmp_path):
    (finding,) = found(Ina219(sysfs=str(tmp_path / "hwmon7")))
    assert finding.problem == f"there is nothing at {tmp_path}/hwmon7"


def test_a_driver_on_a_computer_that_cannot_be_reached_is_found():
    (finding,) = found(Ina219(sysfs="auto", host="ssh://127.0.0.1:1"))
    assert "127.0.0.1" in finding.problem
    assert finding.is_error


def test_one_profiler_has_one_way_to_its_sensor():
    with pytest.raises(PluginError, match="port and sysfs"):
        Ina219(port="/dev/ttyUSB0", sysfs="auto")


def test_what_a_run_takes_on_disk_is_told():
    # 95 s at 200 Hz; a row is some 50 bytes.
    assert Ina219().bytes_per_run == pytest.approx(95 * 200 * 50, rel=0.2)
    assert Ina219(rate_hz=100).bytes_per_run == pytest.approx(95 * 100 * 50, rel=0.2)


def test_two_sensors_of_one_meter_share_its_port_and_one_sensor_has_one_profiler(port):
    first, motors, again = Ina219(port=port), Ina219(name="m", port=port, address=0x41), Ina219(name="a", port=port)
    plugins = (first, motors, again)
    assert [len(found(each, plugins=plugins)) for each in plugins] == [0, 0, 1]


@pytest.mark.parametrize(
    ("parameters", "problem"),
    [
        ({"port": "/dev/ttyUSB0", "address": 0x20}, "address is 32"),
        ({"port": "/dev/ttyUSB0", "address": "0x40"}, "address is '0x40' → .*address=0x40"),
        ({"sysfs": "auto", "address": 0x41}, "and sysfs"),
    ],
)
def test_an_address_that_no_sensor_of_a_meter_has_is_refused(parameters, problem):
    with pytest.raises(PluginError, match=problem):
        Ina219(**parameters)


def test_the_meter_of_a_simulated_robot_has_one_sensor():
    (finding,) = found(Ina219(address=0x41), robot="simulated")
    assert "has one sensor" in finding.problem
