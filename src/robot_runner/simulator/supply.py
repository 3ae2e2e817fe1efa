"""The robot's power supply over time: power, energy, current and voltages, one value for each step.

Below the cut-off voltage the motors are switched off.
"""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass

import numpy as np

from robot_runner.core.events.early_end import undivided
from robot_runner.simulator.drive import MOVING_WHEEL_SPEED, DifferentialDrive
from robot_runner.simulator.model import rolling_torque
from robot_runner.simulator.onboard import TaskRunner
from robot_runner.simulator.simulated_clock import STEPS_PER_SECOND
from robot_runner.simulator.turtlebot3_parameters import Floats, Integers, NoiseStreams, Turtlebot3Parameters

CELLS = 3

# Open-circuit voltage at shares of the energy left from 0 to 1, of a cell with a nominal voltage of 3.7 V.
_SHARES_LEFT = (0.0, 0.05, 0.10, 0.20, 0.35, 0.50, 0.65, 0.80, 0.90, 1.0)
_CELL_VOLTAGES = (3.00, 3.40, 3.55, 3.65, 3.71, 3.77, 3.86, 3.98, 4.08, 4.20)
_NOMINAL_CELL_VOLTAGE = 3.7
_ZERO_CELSIUS = 273.15
#: The temperature, degrees Celsius, of a battery's published figures.
_REFERENCE_TEMPERATURE = 25.0
_GAS_CONSTANT = 8.314  # J/(mol K)


class Battery:
    """A battery of three cells in series, with an internal resistance, followed by a power meter's shunt.

    Its voltage falls with the energy drawn, relative to the published 11.1 V x 1.8 Ah less the loss by cold, and its
    state of charge with the current: a full battery gives its energy above 11.1 V, by less current than that of 11.1 V.
    An empty battery stays at its lowest voltage.

    Attributes:
        resistance: the internal one, in ohms, at the battery's temperature (Arrhenius' law).
        capacity: what can be had at that temperature, Ah.
    """

    def __init__(self, parameters: Turtlebot3Parameters) -> None:
        below = max(0.0, _REFERENCE_TEMPERATURE - parameters.battery_temperature)
        share = max(0.01, 1 - below * parameters.battery_cold_loss / 100)
        self._energy, self.capacity = parameters.battery_energy * share, parameters.battery_capacity * share
        self._initial = parameters.initial_charge / 100
        self.resistance = parameters.battery_resistance * _arrhenius(parameters)
        self._outer = parameters.meter_shunt
        scale = parameters.battery_voltage / _NOMINAL_CELL_VOLTAGE
        self._voltages = [scale * voltage for voltage in _CELL_VOLTAGES]

    def energy_left(self, energy: Floats | float) -> Floats:
        """Return the share of its energy (0..1) that is left after this energy in joules was drawn."""
        return np.clip(self._initial - np.asarray(energy) / self._energy, 0.0, 1.0)

    def charge(self, drawn: Floats | float) -> Floats:
        """Return the state of charge (0..1) after this charge in coulombs was drawn."""
        return np.clip(self._initial - np.asarray(drawn) / (3600 * self.capacity), 0.0, 1.0)

    def open_circuit_voltage(self, energy_left: Floats) -> Floats:
        """Return the open-circuit voltage in volts where these shares of its energy (0..1) are left."""
        return np.interp(energy_left, _SHARES_LEFT, self._voltages)

    def current(self, power: Floats, energy: Floats) -> Floats:
        """Return the current in amperes into a load of this power in watts, after internal resistance and shunt.

        The power of the load is current * (U - R * current); the smaller of the two solutions is the stable one. If the
        load is larger than the battery's maximum power, the current is that of the maximum: U / 2R.
        """
        voltage = self.open_circuit_voltage(self.energy_left(energy))
        resistance = self.resistance + self._outer
        root = np.sqrt(np.maximum(voltage**2 - 4 * resistance * power, 0.0))
        return np.minimum(2 * power / (voltage + root), voltage / (2 * resistance))

    def terminal_voltage(self, current: Floats, energy: Floats) -> Floats:
        """Return the voltage in volts at the battery's terminals under this current."""
        return self.open_circuit_voltage(self.energy_left(energy)) - self.resistance * current


def _arrhenius(parameters: Turtlebot3Parameters) -> float:
    """Return the internal resistance relative to that at 25 degrees Celsius."""
    inverse = 1 / (_ZERO_CELSIUS + parameters.battery_temperature) - 1 / (_ZERO_CELSIUS + _REFERENCE_TEMPERATURE)
    return math.exp(parameters.battery_activation_energy / _GAS_CONSTANT * inverse)


def motor_power(torques: Floats, speeds: Floats, parameters: Turtlebot3Parameters) -> Floats:
    """Return the electrical power in watts for the load of both motors, without the power of turning without load.

    A motor's current is proportional to its torque. It causes the loss I²R in the winding, and works against the
    voltage that the rotor induces. The winding's R is from the data sheet's stall figures, and the gears lose a share
    of the rotor's power. A motor that is pushed returns nothing to the battery. Torques (N m) and speeds (rad/s) are
    those of the left and the right wheel, shape (steps, 2).
    """
    current = torques * (parameters.motor_stall_current / parameters.motor_stall_torque)
    resistance = parameters.battery_voltage / parameters.motor_stall_current
    work = torques * speeds / (parameters.motor_efficiency / 100)
    return _of_both(np.maximum(current**2 * resistance + work, 0.0))


def _of_both(wheels: Floats) -> Floats:
    """Return the sum of left and right; NumPy's sum along an axis takes four times as long for two columns."""
    both: Floats = wheels[:, 0] + wheels[:, 1]
    return both


def _published_load() -> float:
    """Return the part of the published moving power for the load, W: at top speed, level floor, default mass."""
    usual = Turtlebot3Parameters()
    torques = np.full((1, 2), rolling_torque(usual))
    return float(motor_power(torques, np.full((1, 2), usual.max_linear_velocity / usual.wheel_radius), usual)[0])


# From this speed of a wheel on (rad/s), its motor draws all of the power of turning, which then is constant.
_TURNING_WHEEL_SPEED = 0.5


class PowerModel:
    """The power that the robot draws at each step, computed for many steps at once and each step only once.

    Base level (asleep until the first movement, awake after it), plus the motors, plus the task; each with its seeded
    deviation, and with additional noise at each step.
    """

    def __init__(
        self, parameters: Turtlebot3Parameters, drive: DifferentialDrive, tasks: TaskRunner, streams: NoiseStreams
    ) -> None:
        self._parameters = parameters
        self._drive = drive
        self._tasks = tasks
        self._noise = streams.named("power samples")
        self._wandering = _Wandering(streams.named("wandering power"), parameters.wandering_power_deviation)
        gains = streams.named("run power").standard_normal(2)
        base, motors = (1.0 + parameters.run_power_deviation / 100 * gains).tolist()
        self._base_gain: float = base
        self._awake_from: int | None = None
        self._off_from: int | None = None
        self._turning_cost = (parameters.moving_power - parameters.awake_power) * motors
        self._published_load = _published_load()
        levels = np.array([parameters.computation_power, parameters.video_power, parameters.network_power])
        self._task_powers = np.append(levels * parameters.task_power_factor, parameters.awake_power)

    def switch_motors_off(self, step: int) -> None:
        """Make the motors draw no power from this step on."""
        self._off_from = step

    def between(self, first: int, last: int) -> Floats:
        """Return the power in watts at each of the steps `first` to `last`; call it in order, without gaps."""
        noise = self._parameters.sample_power_deviation * self._noise.standard_normal(last - first + 1)
        power: Floats = (
            self._base(first, last)
            + self._motors(first, last)
            + self._task(first, last)
            + self._wandering.between(first, last)
            + noise
        )
        return np.maximum(power, 0.0)

    def _base(self, first: int, last: int) -> Floats:
        parameters = self._parameters
        if self._awake_from is None:
            turning = np.abs(self._drive.wheel_speeds[first : last + 1]).max(axis=1) > MOVING_WHEEL_SPEED
            self._awake_from = first + int(turning.argmax()) if turning.any() else None
        base = np.full(last - first + 1, parameters.asleep_power * self._base_gain)
        if self._awake_from is not None:
            base[max(0, self._awake_from - first) :] = parameters.awake_power * self._base_gain
        return base

    def _motors(self, first: int, last: int) -> Floats:
        parameters = self._parameters
        speeds = self._drive.wheel_speeds[first : last + 1]
        share = parameters.turning_motor_share / 100
        turning = np.minimum(np.abs(speeds) / _TURNING_WHEEL_SPEED, 1.0)
        running = np.abs(speeds) * (parameters.wheel_radius / parameters.max_linear_velocity)
        rotation = _of_both(share * turning + (1 - share) * running) / 2
        # The published power includes the default load: only the difference from it is added.
        load = motor_power(self._drive.motor_torques[first : last + 1], speeds, parameters)
        usual_load = self._published_load * (_of_both(running) / 2)
        drawn: Floats = np.maximum(self._turning_cost * rotation + load - usual_load, 0.0)
        if self._off_from is not None:
            drawn[max(0, self._off_from - first) :] = 0.0
        return drawn

    def _task(self, first: int, last: int) -> Floats:
        drawn = self._task_powers[self._tasks.numbers(first, last)] * self._tasks.gains(first, last)
        extra: Floats = drawn - self._parameters.awake_power
        return extra


class _Wandering:
    """Slow noise: a normal value for each second, linearly interpolated."""

    def __init__(self, noise: np.random.Generator, deviation: float) -> None:
        self._noise = noise
        self._deviation = deviation
        self._knots = np.empty(0)

    def between(self, first: int, last: int) -> Floats:
        needed = last // STEPS_PER_SECOND + 2
        if needed > len(self._knots):
            fresh = self._deviation * self._noise.standard_normal(needed - len(self._knots))
            self._knots = np.append(self._knots, fresh)
        return np.interp(np.arange(first, last + 1) / STEPS_PER_SECOND, np.arange(len(self._knots)), self._knots)


_INITIAL_STEPS = 4096


class PowerSupply:
    """The power supply of the robot by its battery, of this `capacity` (Ah), computed on demand."""

    def __init__(self, model: PowerModel, battery: Battery, *, shunt: float) -> None:
        self._model = model
        self._battery = battery
        self.capacity = battery.capacity
        self._shunt = shunt
        self._known = 0
        self._rows = np.empty((_INITIAL_STEPS, 4))

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

    def bus_voltage(self, steps: Integers) -> Floats:
        """Return the voltage in volts after the shunt, where the robot is connected, at these steps."""
        return self.terminal_voltage(steps) - self._shunt * self.current[steps]

    def terminal_voltage(self, steps: Integers) -> Floats:
        """Return the voltage in volts at the battery's terminals at these steps."""
        return self._battery.terminal_voltage(self.current[steps], self.energy[steps])

    def charge(self, step: int) -> float:
        """Return the battery's state of charge (0..1) at this step."""
        return float(self._battery.charge(self._rows[step, 3]))

    @undivided
    def extend(self, step: int) -> None:
        """Compute up to this step, which the robot's body must have reached."""
        first = self._known
        if step < first:
            return
        while step >= len(self._rows):
            self._rows = np.concatenate([self._rows, np.empty_like(self._rows)])
        power = self._model.between(first, step)
        rows = self._rows[first : step + 1]
        rows[:, 0], rows[:, 1] = power, self._sum(1, power)
        rows[:, 2] = self._battery.current(power, rows[:, 1])
        rows[:, 3] = self._sum(3, rows[:, 2])
        self._known = step + 1

    def _sum(self, column: int, rates: Floats) -> Floats:
        """Return the sum over time of what is drawn at these rates (1/s) from now on, added to that of a column."""
        before = self._rows[self._known - 1, column] if self._known else 0.0
        # One sum from the beginning, so that the result does not depend on the pieces of the computation.
        total: Floats = np.cumsum(np.concatenate([[before], rates / STEPS_PER_SECOND]))[1:]
        return total


_logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class CutOff:
    """The time (s on the simulation's clock) when the motors were switched off, and the battery's voltage (V) then."""

    time: float
    voltage: float


class ProtectedDrive:
    """Computes the body and its supply up to a step, and switches the motors off if the battery is too low.

    The voltage is checked once a second, at whole seconds of the simulation's clock, so that the result does not depend
    on when the robot's state is requested. Robots of one world advance together, so all (`together`, to which this one
    is added) are checked when the state of one is requested. `cut_off` is None while the motors are on.
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
        """Drive at these velocities (m/s, rad/s) until the next command, unless the motors were switched off."""
        if self.cut_off is None:
            self._drive.command(linear, angular)

    def reach(self, step: int) -> None:
        """Advance the body to a step."""
        for second in range(self._drive.steps // STEPS_PER_SECOND + 1, step // STEPS_PER_SECOND + 1):
            for each in self._together:
                each.look(second)
        self._drive.advance(step)

    def extend(self, step: int) -> None:
        """Advance the body and its supply to a step."""
        self.reach(step)
        self._supply.extend(step)

    @undivided
    def look(self, second: int) -> None:
        """Check the voltage at this second, and switch the motors off if it is too low."""
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
