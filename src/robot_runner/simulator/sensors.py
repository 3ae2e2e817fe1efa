"""The robot's sensors and topics: current readings as ROS messages."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from robot_runner.ros.shapes import stamp_of
from robot_runner.simulator.drive import DifferentialDrive, OdometryState, WheelOdometry
from robot_runner.simulator.rooms import Obstacle, Pose, Wall, ray_distances
from robot_runner.simulator.simulated_clock import SimulatedClock, Ticker
from robot_runner.simulator.supply import CELLS, PowerSupply, ProtectedDrive
from robot_runner.simulator.turtlebot3_parameters import Floats, NumberedNoise, Turtlebot3Parameters

Message = dict[str, Any]
Listener = Callable[[Message], None]

_UNKNOWN_COVARIANCE = [0.0] * 36

_WHEEL_JOINTS = ("wheel_left_joint", "wheel_right_joint")

# Constants of sensor_msgs/BatteryState.
_DISCHARGING = 2
_HEALTH_GOOD = 1
_HEALTH_DEAD = 3
_TECHNOLOGY_LIPO = 3


def odometry(now_ns: int, state: OdometryState) -> Message:
    """Return a nav_msgs/Odometry."""
    half = state.yaw / 2
    pose = {
        "position": _vector(state.x, state.y, 0.0),
        "orientation": _quaternion(0.0, 0.0, math.sin(half), math.cos(half)),
    }
    twist = {"linear": _vector(state.linear, 0.0, 0.0), "angular": _vector(0.0, 0.0, state.angular)}
    return {
        "header": header(now_ns, "odom"),
        "child_frame_id": "base_footprint",
        "pose": {"pose": pose, "covariance": list(_UNKNOWN_COVARIANCE)},
        "twist": {"twist": twist, "covariance": list(_UNKNOWN_COVARIANCE)},
    }


def imu(
    now_ns: int,
    orientation: tuple[float, float, float, float],
    angular: Floats,
    linear: Floats,
    noise: Floats,
    parameters: Turtlebot3Parameters,
) -> Message:
    """Return a sensor_msgs/Imu of true velocity (rad/s) and acceleration (m/s²), with its noise (six numbers)."""
    gyroscope, accelerometer = parameters.gyroscope_deviation, parameters.accelerometer_deviation
    angular_noise, linear_noise = noise.reshape(2, 3)
    return {
        "header": header(now_ns, "imu_link"),
        "orientation": _quaternion(*orientation),
        "orientation_covariance": _diagonal(0.0),
        "angular_velocity": _vector(*(angular + gyroscope * angular_noise).tolist()),
        "angular_velocity_covariance": _diagonal(gyroscope**2),
        "linear_acceleration": _vector(*(linear + accelerometer * linear_noise).tolist()),
        "linear_acceleration_covariance": _diagonal(accelerometer**2),
    }


def laser_scan(now_ns: int, true: Floats, noise: Floats, parameters: Turtlebot3Parameters) -> Message:
    """Return a sensor_msgs/LaserScan of true distances (m) all around, counter-clockwise from straight ahead.

    By REP 117, a distance is infinite if nothing is in range, and minus infinity if something is too near to be
    measured.
    """
    ranges = true * (1 + parameters.scan_deviation / 100 * noise)
    ranges[ranges > parameters.scan_maximum] = np.inf
    ranges[ranges < parameters.scan_minimum] = -np.inf
    increment = 2 * math.pi / len(ranges)
    return {
        "header": header(now_ns, "base_scan"),
        "angle_min": 0.0,
        "angle_max": increment * (len(ranges) - 1),
        "angle_increment": increment,
        "time_increment": 0.0,  # the simulated scan takes no time
        "scan_time": 1 / parameters.scan_rate,
        "range_min": parameters.scan_minimum,
        "range_max": parameters.scan_maximum,
        "ranges": ranges.tolist(),
        "intensities": [],
    }


def joint_state(
    now_ns: int, *, positions: list[float], velocities: list[float], names: Sequence[str] = _WHEEL_JOINTS
) -> Message:
    """Return a sensor_msgs/JointState; by default the joints are the two wheels', left and right."""
    return {
        "header": header(now_ns, "base_link"),
        "name": list(names),
        "position": positions,
        "velocity": velocities,
        "effort": [],
    }


def header(now_ns: int, frame: str) -> Message:
    """Return a std_msgs/Header."""
    return {"stamp": stamp_of(now_ns), "frame_id": frame}


def _vector(x: float, y: float, z: float) -> Message:
    return {"x": x, "y": y, "z": z}


def _quaternion(x: float, y: float, z: float, w: float) -> Message:
    return {"x": x, "y": y, "z": z, "w": w}


def _diagonal(variance: float) -> list[float]:
    return [variance, 0.0, 0.0, 0.0, variance, 0.0, 0.0, 0.0, variance]


class PublishedTopic:
    """A topic with its type, its rate (1/s) and its subscribers. Messages are made only for subscribers.

    `make` returns the current message; `prepare` is called before a subscription, which an exception refuses.
    """

    def __init__(
        self,
        clock: SimulatedClock,
        message_type: str,
        rate: int,
        make: Callable[[], dict[str, Any]],
        *,
        prepare: Callable[[], object] = lambda: None,
    ) -> None:
        self.message_type = message_type
        self._clock = clock
        self._rate = rate
        self._make = make
        self._prepare = prepare
        self._listeners: dict[Listening, tuple[Listener, Callable[[], bool]]] = {}
        self._ticker: Ticker | None = None

    def listen(self, listener: Listener, is_wanted: Callable[[], bool] = lambda: True) -> Listening:
        """Call `listener` with each message that is wanted, during sleeps on the clock, until the result is closed."""
        self._prepare()
        listening = Listening(self)
        self._listeners[listening] = listener, is_wanted
        if self._ticker is None:
            self._ticker = self._clock.every(self._rate, self._publish)
        return listening

    def latest(self) -> dict[str, Any]:
        """Return the current message, also without subscribers; raise a `LinkError` if no message can be made."""
        self._prepare()
        return self._make()

    def forget(self, listening: Listening) -> None:
        """Remove a subscriber; a topic without subscribers is no longer computed."""
        self._listeners.pop(listening, None)
        if not self._listeners and self._ticker is not None:
            self._ticker.close()
            self._ticker = None

    def _publish(self) -> None:
        wanted = [(listening, listener) for listening, (listener, is_wanted) in self._listeners.items() if is_wanted()]
        message = self._make() if wanted else {}
        for listening, listener in wanted:
            if listening in self._listeners:  # an earlier listener may have closed it
                listener(message)


class Listening:
    """A subscriber of a topic."""

    def __init__(self, topic: PublishedTopic) -> None:
        self._topic = topic

    def close(self) -> None:
        """End the subscription; closing twice does nothing."""
        self._topic.forget(self)


RAYS = 360
_RAY_ANGLES = np.arange(RAYS, dtype=np.float64) * (2 * math.pi / RAYS)
_SCANNER_X = -0.032  # ROBOTIS' URDF: scan_joint
_SCANNER_HEIGHT = 0.182  # above the floor (ROBOTIS' URDF: base_joint and scan_joint)


def seen_by_scanner(obstacles: Sequence[Obstacle]) -> tuple[Obstacle, ...]:
    """Return the obstacles that reach the height of the scanner."""
    return tuple(each for each in obstacles if each.height >= _SCANNER_HEIGHT)


def body_outline(parameters: Turtlebot3Parameters, pose: Pose) -> Wall:
    """Return the outline of a robot at a pose, for the scanners of other robots."""
    x, y = pose.x + _SCANNER_X * math.cos(pose.yaw), pose.y + _SCANNER_X * math.sin(pose.yaw)
    return Wall(x, y, parameters.body_length / 2, parameters.body_width / 2, pose.yaw, parameters.body_height)


@dataclass(frozen=True, slots=True)
class SensorBoard:
    """The robot's sensors; each method computes the physics up to now, and returns a message."""

    parameters: Turtlebot3Parameters
    clock: SimulatedClock
    drive: DifferentialDrive
    powered: ProtectedDrive
    wheels: WheelOdometry
    supply: PowerSupply
    surroundings: Callable[[], Sequence[Obstacle]]
    imu_noise: NumberedNoise
    scan_noise: NumberedNoise

    def odom(self) -> dict[str, Any]:
        """Return the odometry of the wheels' encoders."""
        self.powered.reach(self.clock.step)
        return odometry(self.clock.now_ns, self.wheels.latest())

    def imu(self) -> dict[str, Any]:
        """Return angular velocity and acceleration, with the sensor's noise."""
        self.powered.reach(self.clock.step)
        drive, noise = self.drive, self.imu_noise.of(self.clock.step)
        return imu(
            self.clock.now_ns, drive.orientation, drive.angular_velocity, drive.acceleration, noise, self.parameters
        )

    def scan(self) -> dict[str, Any]:
        """Return the distances to the obstacles all around."""
        self.powered.reach(self.clock.step)
        pose = self.drive.pose
        x = pose.x + _SCANNER_X * math.cos(pose.yaw)
        y = pose.y + _SCANNER_X * math.sin(pose.yaw)
        true = ray_distances(self.surroundings(), x, y, pose.yaw + _RAY_ANGLES)
        return laser_scan(self.clock.now_ns, true, self.scan_noise.of(self.clock.step), self.parameters)

    def battery_state(self) -> dict[str, Any]:
        """Return a sensor_msgs/BatteryState; as in ROS, discharging is negative and unmeasured values are NaN."""
        step = self.clock.step
        self.powered.extend(step)
        charge, capacity = self.supply.charge(step), self.supply.capacity
        return {
            "header": header(self.clock.now_ns, ""),
            "voltage": float(self.supply.terminal_voltage(np.array([step]))[0]),
            "temperature": math.nan,
            "current": -float(self.supply.current[step]),
            "charge": charge * capacity,
            "capacity": capacity,
            "design_capacity": self.parameters.battery_capacity,
            "percentage": charge,
            "power_supply_status": _DISCHARGING,
            "power_supply_health": _HEALTH_GOOD if self.powered.cut_off is None else _HEALTH_DEAD,
            "power_supply_technology": _TECHNOLOGY_LIPO,
            "present": True,
            "cell_voltage": [math.nan] * CELLS,
            "cell_temperature": [math.nan] * CELLS,
            "location": "",
            "serial_number": "",
        }

    def joint_states(self) -> dict[str, Any]:
        """Return angles and speeds of the wheels."""
        step = self.clock.step
        self.powered.reach(step)
        return joint_state(
            self.clock.now_ns,
            positions=self.drive.wheel_angles_at(step),
            velocities=self.drive.wheel_speeds[step].tolist(),
        )


def published_topics(board: SensorBoard) -> dict[str, PublishedTopic]:
    """Return the topics that the robot publishes, by their names within its namespace."""
    parameters = board.parameters
    clock = board.clock
    base_rate = parameters.odometry_rate
    return {
        "odom": PublishedTopic(clock, "nav_msgs/Odometry", base_rate, board.odom),
        "imu": PublishedTopic(clock, "sensor_msgs/Imu", parameters.imu_rate, board.imu, prepare=board.drive.sense),
        "scan": PublishedTopic(clock, "sensor_msgs/LaserScan", parameters.scan_rate, board.scan),
        "battery_state": PublishedTopic(clock, "sensor_msgs/BatteryState", base_rate, board.battery_state),
        "joint_states": PublishedTopic(clock, "sensor_msgs/JointState", base_rate, board.joint_states),
    }
