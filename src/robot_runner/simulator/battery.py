"""The lithium-polymer battery: voltage from the state of charge and from the load."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import numpy.typing as npt

    from robot_runner.simulator.parameters import Turtlebot3Parameters

    Floats = npt.NDArray[np.float64]

__all__ = ["CELLS", "Battery"]

CELLS = 3

# Open-circuit voltage of a cell at states of charge from 0 to 1, for a cell whose nominal voltage is 3.7 V.
_CHARGES = (0.0, 0.05, 0.10, 0.20, 0.35, 0.50, 0.65, 0.80, 0.90, 1.0)
_CELL_VOLTAGES = (3.00, 3.40, 3.55, 3.65, 3.71, 3.77, 3.86, 3.98, 4.08, 4.20)
_NOMINAL_CELL_VOLTAGE = 3.7


class Battery:
    """A battery of three cells in series, with an inner resistance, behind a power meter's shunt.

    Its state of charge counts energy against the published 11.1 V x 1.8 Ah. An empty battery stays at its
    lowest voltage.
    """

    def __init__(self, parameters: Turtlebot3Parameters) -> None:
        self._energy = parameters.battery_energy
        self._initial = parameters.initial_charge / 100
        self._inner = parameters.battery_resistance
        self._outer = parameters.meter_shunt
        scale = parameters.battery_voltage / _NOMINAL_CELL_VOLTAGE
        self._voltages = [scale * voltage for voltage in _CELL_VOLTAGES]

    def charge(self, energy: Floats | float) -> Floats:
        """Return the state of charge (0..1) after so many joules were drawn."""
        return np.clip(self._initial - np.asarray(energy) / self._energy, 0.0, 1.0)

    def open_circuit_voltage(self, charge: Floats) -> Floats:
        """Return the voltage in volts without load at these states of charge (0..1)."""
        return np.interp(charge, _CHARGES, self._voltages)

    def current(self, power: Floats, energy: Floats) -> Floats:
        """Return the current in amperes that feeds a load of so many watts behind inner resistance and shunt.

        The load takes power = current * (U - R * current); of the two solutions the smaller current is the stable one.
        """
        voltage = self.open_circuit_voltage(self.charge(energy))
        resistance = self._inner + self._outer
        root = np.sqrt(np.maximum(voltage**2 - 4 * resistance * power, 0.0))
        return 2 * power / (voltage + root)

    def terminal_voltage(self, current: Floats, energy: Floats) -> Floats:
        """Return the voltage in volts at the battery's terminals under this current."""
        return self.open_circuit_voltage(self.charge(energy)) - self._inner * current
