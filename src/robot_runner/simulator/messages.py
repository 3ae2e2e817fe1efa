"""The robot's messages as plain mappings that follow the ROS message definitions, complete with every field.

Stamps are `{"sec": …, "nanosec": …}`, as in ROS 2, in the simulation's time.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Sequence

    from robot_runner.simulator.odometry import OdometryState

__all__ = ["battery_state", "imu", "joint_state", "laser_scan", "odometry"]

Message = dict[str, Any]

_SECOND_NS = 1_000_000_000
_UNKNOWN_COVARIANCE = [0.0] * 36

# Constants of sensor_msgs/BatteryState.
_DISCHARGING = 2
_HEALTH_GOOD = 1
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
        "header": _header(now_ns, "odom"),
        "child_frame_id": "base_footprint",
        "pose": {"pose": pose, "covariance": list(_UNKNOWN_COVARIANCE)},
        "twist": {"twist": twist, "covariance": list(_UNKNOWN_COVARIANCE)},
    }


def imu(
    now_ns: int,
    *,
    orientation: tuple[float, float, float, float],
    angular_velocity: Sequence[float],
    acceleration: Sequence[float],
    gyroscope_deviation: float,
    accelerometer_deviation: float,
) -> Message:
    """Return a sensor_msgs/Imu; the deviations become the diagonals of its covariances."""
    return {
        "header": _header(now_ns, "imu_link"),
        "orientation": _quaternion(*orientation),
        "orientation_covariance": _diagonal(0.0),
        "angular_velocity": _vector(*angular_velocity),
        "angular_velocity_covariance": _diagonal(gyroscope_deviation**2),
        "linear_acceleration": _vector(*acceleration),
        "linear_acceleration_covariance": _diagonal(accelerometer_deviation**2),
    }


def laser_scan(now_ns: int, *, ranges: list[float], rate: int, nearest: float, farthest: float) -> Message:
    """Return a sensor_msgs/LaserScan of a whole turn, counter-clockwise from straight ahead."""
    increment = 2 * math.pi / len(ranges)
    return {
        "header": _header(now_ns, "base_scan"),
        "angle_min": 0.0,
        "angle_max": increment * (len(ranges) - 1),
        "angle_increment": increment,
        "time_increment": 0.0,  # the simulated turn happens in one moment
        "scan_time": 1 / rate,
        "range_min": nearest,
        "range_max": farthest,
        "ranges": ranges,
        "intensities": [],
    }


def battery_state(
    now_ns: int, *, voltage: float, current: float, charge: float, capacity: float, cells: int
) -> Message:
    """Return a sensor_msgs/BatteryState; as ROS has it, discharging is negative and the unmeasured is NaN.

    Args:
        now_ns: the moment, in ns.
        voltage: at the terminals, in volts.
        current: drawn, in amperes.
        charge: state of charge, 0..1.
        capacity: in ampere hours.
        cells: how many cells there are in series.
    """
    return {
        "header": _header(now_ns, ""),
        "voltage": voltage,
        "temperature": math.nan,
        "current": -current,
        "charge": charge * capacity,
        "capacity": capacity,
        "design_capacity": capacity,
        "percentage": charge,
        "power_supply_status": _DISCHARGING,
        "power_supply_health": _HEALTH_GOOD,
        "power_supply_technology": _TECHNOLOGY_LIPO,
        "present": True,
        "cell_voltage": [math.nan] * cells,
        "cell_temperature": [math.nan] * cells,
        "location": "",
        "serial_number": "",
    }


def joint_state(now_ns: int, *, positions: list[float], velocities: list[float]) -> Message:
    """Return a sensor_msgs/JointState of the two wheels, left and right."""
    return {
        "header": _header(now_ns, "base_link"),
        "name": ["wheel_left_joint", "wheel_right_joint"],
        "position": positions,
        "velocity": velocities,
        "effort": [],
    }


def _header(now_ns: int, frame: str) -> Message:
    seconds, nanoseconds = divmod(now_ns, _SECOND_NS)
    return {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": frame}


def _vector(x: float, y: float, z: float) -> Message:
    return {"x": x, "y": y, "z": z}


def _quaternion(x: float, y: float, z: float, w: float) -> Message:
    return {"x": x, "y": y, "z": z, "w": w}


def _diagonal(variance: float) -> list[float]:
    return [variance, 0.0, 0.0, 0.0, variance, 0.0, 0.0, 0.0, variance]
