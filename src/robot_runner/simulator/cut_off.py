"""The protection of the battery: below its lowest voltage the motors are switched off."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from robot_runner.simulator.simulated_clock import STEPS_PER_SECOND

if TYPE_CHECKING:
    from robot_runner.simulator.drive import DifferentialDrive
    from robot_runner.simulator.supply import PowerModel, PowerSupply
    from robot_runner.simulator.turtlebot3_parameters import Turtlebot3Parameters

_logger = logging.getLogger(__name__)


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
        supply: PowerSupply,
        together: list[ProtectedDrive],
    ) -> None:
        self._together = together
        self._together.append(self)
        self._drive = drive
        self._model = model
        self._supply = supply
        self._threshold = parameters.cut_off_voltage
        self.cut_off: CutOff | None = None

    def command(self, linear: float, angular: float) -> None:
        """Drive at these velocities (m/s, rad/s) until told otherwise; motors that were switched off do not."""
        if self.cut_off is None:
            self._drive.command(linear, angular)

    def reach(self, step: int) -> None:
        """Bring the body up to a step."""
        for second in range(self._drive.steps // STEPS_PER_SECOND + 1, step // STEPS_PER_SECOND + 1):
            for each in self._together:
                each.look(second)
        self._drive.advance(step)

    def extend(self, step: int) -> None:
        """Bring the body and its supply up to a step."""
        self.reach(step)
        self._supply.extend(step)

    def look(self, second: int) -> None:
        """Look at the voltage at this second, and switch the motors off where it is too low."""
        if self.cut_off is not None:
            return
        step = second * STEPS_PER_SECOND
        self._drive.advance(step)
        self._supply.extend(step)
        voltage = float(self._supply.terminal_voltage(np.array([step]))[0])
        if voltage >= self._threshold:
            return
        self.cut_off = CutOff(float(second), voltage)
        self._drive.command(0.0, 0.0)
        self._model.switch_motors_off(step + 1)
        _logger.warning("the battery fell to %.3f V at %d s: the motors are switched off", voltage, second)
