"""Parameters of the simulated TurtleBot3, and seeded noise with one stream for each source, independent of others."""

from __future__ import annotations

import sys
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, fields
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robot_runner.core.errors import LinkError
from robot_runner.simulator.simulated_clock import STEPS_PER_SECOND

#: Types of arrays in signatures.
Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

_MAY_BE_ZERO = (
    *("_deviation", "cpu_", "memory_", "initial_charge", "rolling_resistance"),
    *("activation_energy", "cold_loss", "cut_off_voltage"),
)
#: Parameters with a largest value, or that may be negative: slopes up to 45 degrees, the temperatures at which
#: lithium-polymer batteries can be discharged, pictures that a laptop can render without a graphics card, rates up to
#: that of the simulation's grid, and shunts that the meter can send in whole microhms.
_BOUNDS = {
    "floor_slope": (-100.0, 100.0),
    "battery_temperature": (-30.0, 60.0),
    "odometry_rate": (1, STEPS_PER_SECOND),
    "imu_rate": (1, STEPS_PER_SECOND),
    "scan_rate": (1, STEPS_PER_SECOND),
    "camera_rate": (1, 30),
    "camera_width": (16, 1280),
    "camera_height": (16, 960),
    "camera_view": (10.0, 150.0),
    "meter_rate": (1, STEPS_PER_SECOND),
    "meter_shunt": (0.001, 100.0),
    "encoder_ticks": (1, 2**31),
}
#: The parameters of a robot from a user's model, too: all others are in the model, or nobody knows them.
SENSOR_PARAMETERS = frozenset(
    {
        *("odometry_rate", "imu_rate", "gyroscope_deviation", "accelerometer_deviation"),
        *("scan_rate", "scan_minimum", "scan_maximum", "scan_deviation"),
        *("camera_rate", "camera_width", "camera_height"),
    }
)
#: Beginnings of the names of shares of a whole; a task's load is added to that of the idle computer.
_SHARES = ("initial_charge", "turning_motor_share", "motor_efficiency", "cpu_", "memory_")


@dataclass(frozen=True, slots=True, kw_only=True)
class Turtlebot3Parameters:
    """The parameters of the simulated TurtleBot3 Burger. SI units; shares of a whole in percent (0..100).

    A `…_deviation` is the standard deviation of seeded noise. A `cpu_…` or `memory_…` of a task is added to that of the
    idle computer; a `…_power` is the power of the whole robot in that state (paper, Fig. 4).

    Attributes:
        moving_power: at top speed on a level floor, with the default mass and rolling resistance.
        floor_slope: the rise of the floor along x, in percent of the way; negative if it falls.
        rolling_resistance: the resisting force on a rolling robot, as a share of its weight.
        battery_temperature: in degrees Celsius.
        battery_cold_loss: loss of capacity for each kelvin below 25 degrees Celsius, in percent.
        cut_off_voltage: the voltage at the battery's terminals below which the motors are switched off; 0 for never.
        task_power_factor: multiplies the robot's power while a task runs, so that two versions of a software can be
            compared: with 1.1 the power is 10 % higher during every task.

    Raises:
        LinkError: a parameter is not a finite number, or is negative, zero or out of its range where that is invalid.

    Example:
        >>> Turtlebot3Parameters(task_power_factor=1.1).wheel_radius
        0.033
    """

    # Body and drive
    mass: float = 1.0
    wheel_mass: float = 0.0285
    wheel_radius: float = 0.033
    wheel_radius_deviation: float = 0.00003
    wheel_separation: float = 0.160
    body_length: float = 0.138
    body_width: float = 0.178
    body_height: float = 0.192
    max_linear_velocity: float = 0.22
    max_angular_velocity: float = 2.84
    motor_stall_torque: float = 1.4
    motor_stall_current: float = 1.3
    servo_time_constant: float = 0.1
    servo_gain: float = 0.1
    servo_settling_time: float = 0.5
    floor_friction: float = 1.0
    floor_slope: float = 0.0
    rolling_resistance: float = 0.015
    encoder_ticks: int = 4096

    # Power
    asleep_power: float = 7.6
    awake_power: float = 7.95
    moving_power: float = 10.5
    computation_power: float = 9.45
    video_power: float = 9.55
    network_power: float = 8.25
    task_power_factor: float = 1.0
    turning_motor_share: float = 70.0
    motor_efficiency: float = 57.9
    run_power_deviation: float = 0.6
    task_power_deviation: float = 1.0
    sample_power_deviation: float = 0.15
    wandering_power_deviation: float = 0.04

    # Battery
    battery_voltage: float = 11.1
    battery_capacity: float = 1.8
    battery_resistance: float = 0.12
    battery_temperature: float = 25.0
    battery_activation_energy: float = 25000.0
    battery_cold_loss: float = 0.8
    initial_charge: float = 100.0
    cut_off_voltage: float = 9.0

    # Power meter
    meter_rate: int = 200
    meter_shunt: float = 0.1
    meter_shunt_deviation: float = 0.00002
    meter_bus_deviation: float = 0.002

    # On-board computer
    cpu_idle: float = 11.0
    cpu_moving: float = 3.0
    cpu_computation: float = 25.0
    cpu_video: float = 14.4
    cpu_network: float = 18.5
    cpu_deviation: float = 1.5
    run_cpu_deviation: float = 0.4
    memory_idle: float = 23.5
    memory_computation: float = 0.4
    memory_video: float = 3.8
    memory_network: float = 0.95
    memory_deviation: float = 0.15
    run_memory_deviation: float = 0.2

    # Sensors
    odometry_rate: int = 30
    imu_rate: int = 200
    scan_rate: int = 5
    gyroscope_deviation: float = 0.0017
    accelerometer_deviation: float = 0.02
    scan_minimum: float = 0.12
    scan_maximum: float = 3.5
    scan_deviation: float = 1.2
    camera_rate: int = 5
    camera_width: int = 320
    camera_height: int = 240
    camera_view: float = 62.2

    def __post_init__(self) -> None:
        for parameter in fields(self):
            fix = _refused(parameter.name, value := getattr(self, parameter.name), is_whole=parameter.type == "int")
            if fix:
                problem = f"the simulated robot's {parameter.name} is {value!r}"
                raise LinkError(problem, where="Turtlebot3Parameters", fix=fix)
        if self.scan_minimum >= self.scan_maximum:
            problem = f"the simulated robot's scan_minimum is {self.scan_minimum!r} m, and scan_maximum no more"
            raise LinkError(problem, where="Turtlebot3Parameters", fix="Give scan_minimum less, or scan_maximum more.")
        if self.mass <= 2 * self.wheel_mass:
            problem = (
                f"the simulated robot's mass is {self.mass!r} kg, and each of its two wheels has {self.wheel_mass!r} kg"
            )
            raise LinkError(problem, where="Turtlebot3Parameters", fix="Give mass more, or wheel_mass less.")

    @property
    def battery_energy(self) -> float:
        """The energy of the full battery in joules: nominal voltage times capacity (11.1 V, 1.8 Ah: 71.9 kJ)."""
        return self.battery_voltage * self.battery_capacity * 3600.0

    @property
    def max_wheel_speed(self) -> float:
        """The highest speed of a wheel in rad/s, from the robot's highest velocity and turning rate."""
        ground_speed = max(self.max_linear_velocity, self.max_angular_velocity * self.wheel_separation / 2)
        return ground_speed / self.wheel_radius


def _refused(name: str, value: float, *, is_whole: bool) -> str:
    """Return the fix for an invalid value of a parameter; empty if it is valid."""
    number = "whole number" if is_whole else "number"
    if isinstance(value, bool) or not isinstance(value, int if is_whole else int | float):
        return f"Give a {number}."
    if name in _BOUNDS:
        low, high = _BOUNDS[name]
        return "" if low <= value <= high else f"Give a {number} from {low:g} to {high:g}."
    is_share = name.startswith(_SHARES) and not name.endswith("_deviation")
    may_be_zero = any(part in name for part in _MAY_BE_ZERO)
    if 0 <= value <= (100 if is_share else sys.float_info.max) and (value or may_be_zero):
        return ""
    least = "of at least" if may_be_zero else "above"
    return f"Give a number {least} 0 and of at most 100." if is_share else f"Give a finite number {least} 0."


_SEED_BITS = 64
#: The noise of this many numbers is drawn at once.
_BLOCK = 256


class NumberedNoise:
    """Normal noise by number, such as that of a step of the simulation's grid: `width` values for each.

    The noise of a number does not depend on earlier calls: so the reading of a sensor at a moment does not depend on
    when the sensor was switched on.
    """

    def __init__(self, entropy: Sequence[int], width: int) -> None:
        self._entropy = tuple(entropy)
        self._width = width
        self._blocks: dict[int, Floats] = {}

    def at(self, numbers: ArrayLike) -> Floats:
        """Return the noise of these numbers (0 and up), one row for each."""
        wanted = np.atleast_1d(np.asarray(numbers, dtype=np.int64))
        rows = np.empty((len(wanted), self._width))
        blocks, places = np.divmod(wanted, _BLOCK)
        for begin, end in pairwise(sorted({0, *(np.flatnonzero(np.diff(blocks)) + 1).tolist(), len(wanted)})):
            rows[begin:end] = self._block(int(blocks[begin]))[places[begin:end]]
        return rows

    def of(self, number: int) -> Floats:
        """Return the noise of one number, as `at` does for several."""
        block, place = divmod(number, _BLOCK)
        noise: Floats = self._block(block)[place]
        return noise

    def _block(self, number: int) -> Floats:
        if number not in self._blocks:
            if len(self._blocks) > 1:  # as time goes on, only the last block may be needed again
                self._blocks.pop(min(self._blocks))
            drawn = np.random.default_rng([*self._entropy, number]).standard_normal((_BLOCK, self._width))
            self._blocks[number] = drawn
        return self._blocks[number]


class NoiseStreams:
    """The random streams of one robot, by name.

    Example:
        >>> streams = NoiseStreams(7, "/alice")
        >>> streams.named("imu").random() == NoiseStreams(7, "/alice").named("imu").random()
        True
    """

    def __init__(self, seed: int, namespace: str) -> None:
        self._entropy = (seed % 2**_SEED_BITS, zlib.crc32(namespace.encode()))

    def named(self, name: str) -> np.random.Generator:
        """Return the stream with this name, from its beginning."""
        return np.random.default_rng([*self._entropy, zlib.crc32(name.encode())])

    def numbered(self, name: str, *, width: int) -> NumberedNoise:
        """Return the noise with this name by number, `width` values for each."""
        return NumberedNoise([*self._entropy, zlib.crc32(name.encode())], width)
