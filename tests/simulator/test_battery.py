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
    assert float(BATTERY.charge(CAPACITY / 4)) == pytest.approx(0.75)


def test_its_voltage_is_that_of_three_lithium_polymer_cells():
    full, half, empty = BATTERY.open_circuit_voltage(np.array([1.0, 0.5, 0.0])).tolist()
    assert full == pytest.approx(12.6)
    assert half == pytest.approx(11.3, abs=0.1)
    assert empty == pytest.approx(9.0)


@given(st.floats(0, CAPACITY), st.floats(0, CAPACITY))
def test_the_voltage_never_rises_while_energy_is_drawn(one, other):
    less, more = sorted((one, other))
    voltages = BATTERY.open_circuit_voltage(BATTERY.charge(np.array([less, more])))
    assert voltages[1] <= voltages[0]


@given(power=st.floats(0.1, 30), energy=st.floats(0, 2 * CAPACITY))
def test_the_load_gets_the_power_that_it_asks_for(power, energy):
    amperes = current(power, energy)
    open_circuit = float(BATTERY.open_circuit_voltage(BATTERY.charge(np.array([energy])))[0])
    bus = open_circuit - amperes * (PARAMETERS.battery_resistance + PARAMETERS.meter_shunt)
    assert bus * amperes == pytest.approx(power)


def test_a_larger_load_lowers_the_terminal_voltage_over_the_inner_resistance():
    energy = np.array([0.0])
    small, large = np.array([current(7.6)]), np.array([current(10.5)])
    drop = BATTERY.terminal_voltage(small, energy) - BATTERY.terminal_voltage(large, energy)
    assert drop == pytest.approx((large - small) * PARAMETERS.battery_resistance)
    assert drop > 0


@pytest.mark.long
def test_a_robot_that_is_on_for_five_minutes_has_lost_a_thirtieth_of_its_charge():
    simulation = Simulation(seed=3)
    states = []
    simulation.clock.sleep(300)
    simulation.turtlebot3().topics["battery_state"].listen(states.append)
    simulation.clock.sleep(0.04)
    [state] = states
    assert state["percentage"] == pytest.approx(1 - 7.6 * 300 / CAPACITY, abs=0.001)
    assert state["charge"] == pytest.approx(1.8 * state["percentage"])
    assert state["voltage"] == pytest.approx(12.4, abs=0.1)
    assert state["current"] == pytest.approx(-7.6 / state["voltage"], rel=0.15)


def test_in_the_cold_it_resists_more_and_holds_less():
    cold = Battery(Turtlebot3Parameters(battery_temperature=0.0))
    # By hand: exp(25000 / 8.314 * (1 / 273.15 - 1 / 298.15)) = 2.516.
    assert cold.resistance == pytest.approx(0.12 * 2.516, rel=1e-3)
    assert BATTERY.resistance == pytest.approx(0.12)
    assert float(cold.charge(0.8 * CAPACITY / 2)) == pytest.approx(0.5)  # 25 K below 25 degrees: 0.8 of the capacity


def test_in_the_heat_it_resists_less_and_holds_as_much():
    hot = Battery(Turtlebot3Parameters(battery_temperature=40.0))
    assert hot.resistance < BATTERY.resistance
    assert float(hot.charge(CAPACITY / 2)) == pytest.approx(0.5)


@pytest.mark.parametrize("resistance", [5.0, 1000.0])
def test_a_battery_that_cannot_give_the_power_falls_to_half_its_voltage(resistance):
    shunt = 0.001  # behind the battery; with it, the power is greatest where half of the voltage is left behind both
    battery = Battery(Turtlebot3Parameters(battery_resistance=resistance, meter_shunt=shunt))
    power, drawn = np.array([10.0]), np.zeros(1)
    volts = battery.terminal_voltage(battery.current(power, drawn), drawn)
    left = (resistance + 2 * shunt) / (resistance + shunt) / 2
    assert volts == pytest.approx(battery.open_circuit_voltage(battery.charge(drawn)) * left)


def test_in_the_cold_it_tells_of_the_charge_that_can_be_had():
    simulation = Simulation(seed=1, parameters=Turtlebot3Parameters(battery_temperature=-20.0))
    robot = simulation.turtlebot3()
    simulation.clock.sleep(20.0)
    told = robot.topics["battery_state"].latest()
    assert told["design_capacity"] == 1.8
    assert told["capacity"] == pytest.approx(1.8 * (1 - 45 * 0.008))
    assert told["charge"] == pytest.approx(told["percentage"] * told["capacity"])
    assert (told["capacity"] - told["charge"]) * 3600 * 11.1 == pytest.approx(robot.energy)
