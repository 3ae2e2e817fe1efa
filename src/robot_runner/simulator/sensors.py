"""What the robot publishes: each sensor's reading of this moment as a ROS message."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from robot_runner.simulator import messages
from robot_runner.simulator.arena import ARENA, ray_distances
from robot_runner.simulator.battery import CELLS
from robot_runner.simulator.topic import PublishedTopic

if TYPE_CHECKING:
    from robot_runner.simulator.clock import SimulatedClock
    from robot_runner.simulator.drive import DifferentialDrive
    from robot_runner.simulator.odometry import WheelOdometry
    from robot_runner.simulator.parameters import Turtlebot3Parameters
    from robot_runner.simulator.supply import PowerSupply

__all__ = ["SensorBoard", "published_topics"]

_RAYS = 360
_RAY_ANGLES = np.arange(_RAYS, dtype=np.float64) * (2 * math.pi / _RAYS)
_SCANNER_X = -0.032  # ROBOTIS' URDF: scan_joint


@dataclass(frozen=True, slots=True)
class SensorBoard:
    """The robot's sensors; each method brings physics up to now, reads, and returns a message."""

    parameters: Turtlebot3Parameters
    clock: SimulatedClock
    drive: DifferentialDrive
    wheels: WheelOdometry
    supply: PowerSupply
    imu_noise: np.random.Generator
    scan_noise: np.random.Generator

    def odom(self) -> dict[str, Any]:
        """Return what the wheels' encoders say."""
        self.drive.advance(self.clock.step)
        return messages.odometry(self.clock.now_ns, self.wheels.latest())

    def imu(self) -> dict[str, Any]:
        """Return angular velocity and acceleration with the noise of the sensor."""
        self.drive.advance(self.clock.step)
        noise = self.imu_noise.standard_normal((2, 3))
        angular = self.drive.angular_velocity + self.parameters.gyroscope_deviation * noise[0]
        linear = self.drive.acceleration + self.parameters.accelerometer_deviation * noise[1]
        return messages.imu(
            self.clock.now_ns,
            orientation=self.drive.orientation,
            angular_velocity=angular.tolist(),
            acceleration=linear.tolist(),
            gyroscope_deviation=self.parameters.gyroscope_deviation,
            accelerometer_deviation=self.parameters.accelerometer_deviation,
        )

    def scan(self) -> dict[str, Any]:
        """Return the distances to the walls all around; infinite where nothing is in range (REP 117)."""
        self.drive.advance(self.clock.step)
        pose, parameters = self.drive.pose, self.parameters
        x = pose.x + _SCANNER_X * math.cos(pose.yaw)
        y = pose.y + _SCANNER_X * math.sin(pose.yaw)
        true = ray_distances(ARENA, x, y, pose.yaw + _RAY_ANGLES)
        noise = self.scan_noise.standard_normal(_RAYS)
        read = true * (1 + parameters.scan_deviation / 100 * noise)
        is_in_range = (read >= parameters.scan_minimum) & (read <= parameters.scan_maximum)
        return messages.laser_scan(
            self.clock.now_ns,
            ranges=np.where(is_in_range, read, np.inf).tolist(),
            rate=parameters.scan_rate,
            nearest=parameters.scan_minimum,
            farthest=parameters.scan_maximum,
        )

    def battery_state(self) -> dict[str, Any]:
        """Return voltage, current and charge of the battery."""
        step = self.clock.step
        self.drive.advance(step)
        self.supply.extend(step)
        return messages.battery_state(
            self.clock.now_ns,
            voltage=float(self.supply.terminal_voltage(np.array([step]))[0]),
            current=float(self.supply.current[step]),
            charge=self.supply.charge(step),
            capacity=self.parameters.battery_capacity,
            cells=CELLS,
        )

    def joint_states(self) -> dict[str, Any]:
        """Return angles and speeds of the wheels."""
        step = self.clock.step
        self.drive.advance(step)
        return messages.joint_state(
            self.clock.now_ns,
            positions=self.drive.wheel_angles[step].tolist(),
            velocities=self.drive.wheel_speeds[step].tolist(),
        )


def published_topics(board: SensorBoard) -> dict[str, PublishedTopic]:
    """Return the topics that the robot publishes, by their names within its namespace."""
    parameters = board.parameters
    clock = board.clock
    base_rate = parameters.odometry_rate
    return {
        "odom": PublishedTopic(clock, "nav_msgs/Odometry", base_rate, board.odom),
        "imu": PublishedTopic(clock, "sensor_msgs/Imu", parameters.imu_rate, board.imu),
        "scan": PublishedTopic(clock, "sensor_msgs/LaserScan", parameters.scan_rate, board.scan),
        "battery_state": PublishedTopic(clock, "sensor_msgs/BatteryState", base_rate, board.battery_state),
        "joint_states": PublishedTopic(clock, "sensor_msgs/JointState", base_rate, board.joint_states),
    }
