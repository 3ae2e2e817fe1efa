"""The battery: voltage falls with charge and with load."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_runner.simulator.simulated_turtlebot3 import Simulation
from robot_runner.simulator.supply import Battery
from robot_runner.simulator.turtlebot3_parameters import Turtlebot3Parameters

PARAMETERS = Turtlebot3Parameters()
BATTERY = Battery(PARAMETERS)
CAPACITY = 11.1 * 1.8 * 3600


def current(power, energy=0.0):
    return float(BATTERY.current(np.array([power]), np.array([energy]))[0])


def test_it_holds_the_published_energy():
    assert PARAMETERS.battery_energy == pytest.approx(19.98 * 3600)
    assert float(BATTERY.energy_left(CAPACITY / 4)) == pytest.approx(0.75)


def test_its_voltage_is_that_of_three_lithium_polymer_cells():
    full, half, empty = BATTERY.open_circuit_voltage(np.array([1.0, 0.5, 0.0])).tolist()
    assert full == pytest.approx(12.6)
    assert half == pytest.approx(11.3, abs=0.1)
    assert empty == pytest.approx(9.0)


@given(st.floats(0, CAPACITY), st.floats(0, CAPACITY))
def test_the_voltage_never_rises_while_energy_is_drawn(one, other):
    less, more = sorted((one, other))
    voltages = BATTERY.open_circuit_voltage(BATTERY.energy_left(np.array([less, more])))
    assert voltages[1] <= voltages[0]


@given(power=st.floats(0.1, 30), energy=st.floats(0, 2 * CAPACITY))
def test_the_load_gets_the_power_that_it_asks_for(power, energy):
    amperes = current(power, energy)
    open_circuit = float(BATTERY.open_circuit_voltage(BATTERY.energy_left(np.array([energy])))[0])
    bus = open_circuit - amperes * (PARAMETERS.battery_resistance + PARAMETERS.meter_shunt)
    assert bus * amperes == pytest.approx(power)


def test_a_larger_load_lowers_the_terminal_voltage_over_the_inner_resistance():
    energy = np.array([0.0])
    small, large = np.array([current(7.6)]), np.array([current(10.5)])
    drop = BATTERY.terminal_voltage(small, energy) - BATTERY.terminal_voltage(large, energy)
    assert drop == pytest.approx((large - small) * PARAMETERS.battery_resistance)
    assert drop > 0


@pytest.mark.long
def test_a_robot_that_is_on_for_five_minutes_has_lost_the_charge_that_its_power_takes():
    simulation = Simulation(seed=3)
    states = []
    simulation.clock.sleep(300)
    simulation.turtlebot3().topics["battery_state"].listen(states.append)
    simulation.clock.sleep(0.04)
    [state] = states
    # 7.6 W at the mean of the voltages at the beginning and at the end: 51 mAh of 1.8 Ah.
    assert state["percentage"] == pytest.approx(1 - 7.6 * 300 / 12.4 / 3600 / 1.8, abs=0.001)
    assert state["charge"] == pytest.approx(1.8 * state["percentage"])
    assert state["voltage"] == pytest.approx(12.4, abs=0.1)
    assert state["current"] == pytest.approx(-7.6 / state["voltage"], rel=0.15)


@pytest.mark.long
@pytest.mark.parametrize(("initial", "celsius"), [(100.0, 25.0), (30.0, 25.0), (100.0, -20.0)])
def test_its_charge_falls_by_the_current_that_it_reports(initial, celsius):
    parameters = Turtlebot3Parameters(initial_charge=initial, battery_temperature=celsius)
    simulation = Simulation(seed=5, parameters=parameters)
    robot, states = simulation.turtlebot3(), []
    robot.topics["battery_state"].listen(states.append)
    robot.drive(0.1, 0.5)
    simulation.clock.sleep(20)
    times = [each["header"]["stamp"]["sec"] + each["header"]["stamp"]["nanosec"] * 1e-9 for each in states]
    drawn = -np.trapezoid([each["current"] for each in states], times) / 3600
    assert states[0]["charge"] - states[-1]["charge"] == pytest.approx(drawn, rel=0.005)
    assert states[0]["percentage"] == pytest.approx(initial / 100, abs=1e-4)


def test_a_battery_whose_energy_is_drawn_has_next_to_no_charge_left():
    energy = np.linspace(0.0, CAPACITY, 10_001)
    amperes = BATTERY.current(np.full(len(energy), 8.0), energy)
    assert float(BATTERY.charge(np.trapezoid(amperes, energy / 8.0))) == pytest.approx(0.0, abs=0.01)


def test_in_the_cold_it_resists_more_and_holds_less():
    cold = Battery(Turtlebot3Parameters(battery_temperature=0.0))
    # By hand: exp(25000 / 8.314 * (1 / 273.15 - 1 / 298.15)) = 2.516.
    assert cold.resistance == pytest.approx(0.12 * 2.516, rel=1e-3)
    assert BATTERY.resistance == pytest.approx(0.12)
    # 25 K below 25 degrees: 0.8 of the capacity.
    assert float(cold.energy_left(0.8 * CAPACITY / 2)) == pytest.approx(0.5)


def test_in_the_heat_it_resists_less_and_holds_as_much():
    hot = Battery(Turtlebot3Parameters(battery_temperature=40.0))
    assert hot.resistance < BATTERY.resistance
    assert float(hot.energy_left(CAPACITY / 2)) == pytest.approx(0.5)


@pytest.mark.parametrize("resistance", [5.0, 1000.0])
def test_a_battery_that_cannot_give_the_power_falls_to_half_its_voltage(resistance):
    shunt = 0.001  # behind the battery; with it, the power is greatest where half of the voltage is left behind both
    battery = Battery(Turtlebot3Parameters(battery_resistance=resistance, meter_shunt=shunt))
    power, drawn = np.array([10.0]), np.zeros(1)
    volts = battery.terminal_voltage(battery.current(power, drawn), drawn)
    left = (resistance + 2 * shunt) / (resistance + shunt) / 2
    assert volts == pytest.approx(battery.open_circuit_voltage(battery.energy_left(drawn)) * left)


def test_in_the_cold_it_tells_of_the_charge_that_can_be_had():
    simulation = Simulation(seed=1, parameters=Turtlebot3Parameters(battery_temperature=-20.0))
    robot = simulation.turtlebot3()
    simulation.clock.sleep(20.0)
    told = robot.topics["battery_state"].latest()
    assert told["design_capacity"] == 1.8
    assert told["capacity"] == pytest.approx(1.8 * (1 - 45 * 0.008))
    assert told["charge"] == pytest.approx(told["percentage"] * told["capacity"])
    # 7.6 W at 11.5 V, of which the shunt takes some.
    assert (told["capacity"] - told["charge"]) * 3600 * told["voltage"] == pytest.approx(robot.energy, rel=0.01)
