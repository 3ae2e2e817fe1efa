"""The protection of the battery: below its lowest voltage the motors are switched off."""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from robot_runner.simulator.simulated_clock import STEPS_PER_SECOND

if TYPE_CHECKING:
    from robot_runner.simulator.drive import DifferentialDrive
    from robot_runner.simulator.supply import Battery, PowerModel, PowerSupply
    from robot_runner.simulator.turtlebot3_parameters import Turtlebot3Parameters

_logger = logging.getLogger(__name__)

#: At how many energies it is looked up how low the voltage can be there.
_GRID = 2001
#: More deviations than this from its mean no noise is ever (once in 10^23 samples).
_DEVIATIONS = 10.0
_FOREVER = 1e9  # s


@dataclass(frozen=True, slots=True)
class CutOff:
    """When (s on the simulation's clock) the motors were switched off, and the battery's voltage (V) at that moment."""

    time: float
    voltage: float


class ProtectedDrive:
    """Brings the body and its supply up to a step, and switches the motors off once the battery is too low.

    The voltage is looked at once a second, at whole seconds of the simulation's clock, so that it makes no difference
    when somebody asks for the robot's state. Robots of one world move on together, so each is looked at whenever one of
    them is asked for.

    Args:
        parameters: the robot's figures.
        drive: its body.
        model: what it draws.
        battery: what it has.
        supply: its battery over time.
        together: all the protected drives of its world, which this one joins.

    Attributes:
        cut_off: when and at which voltage the motors were switched off; None while they are on.
    """

    def __init__(
        self,
        parameters: Turtlebot3Parameters,
        drive: DifferentialDrive,
        model: PowerModel,
        battery: Battery,
        supply: PowerSupply,
        together: list[ProtectedDrive] | None = None,
    ) -> None:
        self._together = [] if together is None else together
        self._together.append(self)
        self._drive = drive
        self._model = model
        self._supply = supply
        self._threshold = parameters.cut_off_voltage
        self._highest_power = _highest_power(parameters)
        self._safe_energy = self._energy_without_doubt(battery, parameters.battery_energy)
        self._safe_until = 0  # up to this step the voltage cannot be below the threshold
        self.cut_off: CutOff | None = None

    def command(self, linear: float, angular: float) -> None:
        """Drive at these velocities (m/s, rad/s) until told otherwise; motors that were switched off do not."""
        if self.cut_off is None:
            self._drive.command(linear, angular)

    def reach(self, step: int) -> None:
        """Bring the body up to a step."""
        if any(each.is_in_doubt(step) for each in self._together):
            for second in range(self._drive.steps // STEPS_PER_SECOND + 1, step // STEPS_PER_SECOND + 1):
                checked = [each.is_low(second) for each in self._together if each.cut_off is None]
                if all(checked):
                    break
        self._drive.advance(step)

    def is_in_doubt(self, step: int) -> bool:
        """Return whether the voltage could be too low by this step while the motors are on."""
        return step > self._safe_until and self.cut_off is None and not self._is_above_threshold(step)

    def extend(self, step: int) -> None:
        """Bring the body and its supply up to a step."""
        self.reach(step)
        self._supply.extend(step)

    def is_low(self, second: int) -> bool:
        """Look at the voltage at this second, and switch the motors off where it is too low."""
        step = second * STEPS_PER_SECOND
        self._drive.advance(step)
        self._supply.extend(step)
        voltage = float(self._supply.terminal_voltage(np.array([step]))[0])
        if voltage >= self._threshold:
            return False
        self.cut_off = CutOff(float(second), voltage)
        self._drive.command(0.0, 0.0)
        self._model.switch_motors_off(step + 1)
        _logger.warning("the battery fell to %.3f V at %d s: the motors are switched off", voltage, second)
        return True

    def _is_above_threshold(self, step: int) -> bool:
        """Return whether the voltage is above the threshold for certain, without looking, up to this step."""
        known = len(self._supply.energy)
        left = self._safe_energy - (float(self._supply.energy[-1]) if known else 0.0)
        if left > 0:
            self._safe_until = known - 1 + int(min(left / self._highest_power, _FOREVER) * STEPS_PER_SECOND)
        return step <= self._safe_until

    def _energy_without_doubt(self, battery: Battery, capacity: float) -> float:
        """Return how many joules can be drawn before the highest power could bring the voltage below the threshold."""
        energies = np.linspace(0.0, capacity, _GRID)
        currents = battery.current(np.full(_GRID, self._highest_power), energies)
        is_low = battery.terminal_voltage(currents, energies) < self._threshold
        if not is_low.any():
            return math.inf
        return float(energies[is_low.argmax() - 1]) if is_low.argmax() else 0.0


def _highest_power(parameters: Turtlebot3Parameters) -> float:
    """Return a power (W) that the robot never exceeds: each part at its most, both motors stalled and at full speed."""
    tasks = max(parameters.computation_power, parameters.video_power, parameters.network_power)
    levels = max(parameters.asleep_power, parameters.awake_power) + tasks * parameters.task_power_factor
    noise = parameters.sample_power_deviation + parameters.wandering_power_deviation
    spread = 1 + _DEVIATIONS / 100 * (parameters.run_power_deviation + parameters.task_power_deviation)
    work = parameters.motor_stall_torque * parameters.max_wheel_speed / (parameters.motor_efficiency / 100)
    motors = parameters.moving_power + 2 * (parameters.battery_voltage * parameters.motor_stall_current + work)
    return (levels + motors) * spread + _DEVIATIONS * noise
