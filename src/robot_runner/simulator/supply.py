"""The robot's electrical side over time: power, energy, current and voltages, one value for each step."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from robot_runner.simulator.clock import STEPS_PER_SECOND

if TYPE_CHECKING:
    import numpy.typing as npt

    from robot_runner.simulator.battery import Battery
    from robot_runner.simulator.power import PowerModel

    Floats = npt.NDArray[np.float64]

__all__ = ["PowerSupply"]

_INITIAL_STEPS = 4096


class PowerSupply:
    """What the battery gives and the robot draws, computed as far as somebody has asked."""

    def __init__(self, model: PowerModel, battery: Battery, *, shunt: float) -> None:
        self._model = model
        self._battery = battery
        self._shunt = shunt
        self._known = 0
        self._rows = np.empty((_INITIAL_STEPS, 3))

    @property
    def power(self) -> Floats:
        """The power in watts that the robot draws, by step."""
        return self._rows[: self._known, 0]

    @property
    def energy(self) -> Floats:
        """The energy in joules that the robot has drawn, by step."""
        return self._rows[: self._known, 1]

    @property
    def current(self) -> Floats:
        """The current in amperes, by step."""
        return self._rows[: self._known, 2]

    def bus_voltage(self, steps: npt.NDArray[np.int64]) -> Floats:
        """Return the voltage in volts behind the shunt, where the robot is connected, at these steps."""
        return self.terminal_voltage(steps) - self._shunt * self.current[steps]

    def terminal_voltage(self, steps: npt.NDArray[np.int64]) -> Floats:
        """Return the voltage in volts at the battery's terminals at these steps."""
        return self._battery.terminal_voltage(self.current[steps], self.energy[steps])

    def charge(self, step: int) -> float:
        """Return the battery's state of charge (0..1) at this step."""
        return float(self._battery.charge(self.energy[step]))

    def extend(self, step: int) -> None:
        """Compute up to this step, which the robot's body must have reached."""
        first = self._known
        if step < first:
            return
        while step >= len(self._rows):
            self._rows = np.concatenate([self._rows, np.empty_like(self._rows)])
        power = self._model.between(first, step)
        drawn = self._rows[first - 1, 1] if first else 0.0
        # One sum from the beginning on, so that it does not matter in which pieces it was asked for.
        energy = np.cumsum(np.concatenate([[drawn], power / STEPS_PER_SECOND]))[1:]
        self._rows[first : step + 1] = np.stack([power, energy, self._battery.current(power, energy)], axis=1)
        self._known = step + 1
