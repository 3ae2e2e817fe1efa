"""The TurtleBot3 Burger and its room as a MuJoCo model (MJCF)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from robot_runner.simulator.simulated_clock import STEPS_PER_SECOND

if TYPE_CHECKING:
    import numpy.typing as npt

    from robot_runner.simulator.turtlebot3_parameters import Turtlebot3Parameters

__all__ = [
    "ARENA",
    "WALL_HEIGHT",
    "Wall",
    "burger_model",
    "holding_torque",
    "ray_distances",
    "rolling_torque",
    "slope_angle",
]


WALL_HEIGHT = 0.5


@dataclass(frozen=True, slots=True)
class Wall:
    """An upright box whose sides are parallel to the axes: its centre and the halves of its sides, in metres."""

    x: float
    y: float
    half_x: float
    half_y: float


#: A room of 5.5 m x 4 m with a pillar; the robot starts at the origin and looks along x.
ARENA = (
    Wall(4.05, 0.0, 0.05, 2.1),
    Wall(-1.55, 0.0, 0.05, 2.1),
    Wall(1.25, 2.05, 2.85, 0.05),
    Wall(1.25, -2.05, 2.85, 0.05),
    Wall(1.0, -1.2, 0.15, 0.15),
)


def ray_distances(
    walls: tuple[Wall, ...], x: float, y: float, angles: npt.NDArray[np.float64]
) -> npt.NDArray[np.float64]:
    """Return how far (m) each ray from a point goes to the first wall; infinite where it meets none.

    Slab method: a ray is inside a box while it is between both pairs of parallel sides
    (Kay and Kajiya, Ray Tracing Complex Scenes, SIGGRAPH 1986).
    """
    centres = np.array([(wall.x - x, wall.y - y) for wall in walls])
    halves = np.array([(wall.half_x, wall.half_y) for wall in walls])
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=1)[:, np.newaxis, :]
    # A ray along an axis never enters or never leaves the sides along that axis: infinities are meant.
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        one_side = (centres - halves) / directions
        other_side = (centres + halves) / directions
    entry = np.minimum(one_side, other_side).max(axis=2)
    leaving = np.maximum(one_side, other_side).min(axis=2)
    hits = np.where((entry <= leaving) & (entry >= 0), entry, np.inf)
    nearest: npt.NDArray[np.float64] = hits.min(axis=1)
    return nearest


# Contacts as stiff as the time step allows (MuJoCo: at least two steps), so that the wheels roll on
# their true radius instead of sinking in. With priority these count, and not their mean with the floor's.
_STIFF = 'priority="1" solref="0.01 1" solimp="0.98 0.99 0.0005"'

# Half the width of the tyre (ROBOTIS' URDF: 18 mm wide).
_TYRE_HALF_WIDTH = 0.009

_CASTER_RADIUS = 0.005
_CASTER_X = -0.081  # ROBOTIS' URDF: caster_back_joint

# The body stands over a plate whose centre is 32 mm behind the axle (ROBOTIS' URDF: base_link).
_BODY_X = -0.032
_BODY_MASS_HEIGHT = 0.03  # above the axle; the battery and both boards are low
_BODY_INERTIA = "0.0022124 0.0021194 0.0020064"  # ROBOTIS' URDF: base_link, principal axes
_IMU_HEIGHT = 0.045  # above the axle (ROBOTIS' URDF: imu_joint)
_GROUND_CLEARANCE = 0.01
_GRAVITY = 9.81


def slope_angle(parameters: Turtlebot3Parameters) -> float:
    """Return by how many radians the floor rises along x."""
    return math.atan(parameters.floor_slope / 100)


def rolling_torque(parameters: Turtlebot3Parameters) -> float:
    """Return the torque in N m with which the floor holds each of the two wheels back while it turns.

    The wheels bear the caster's share too. Rolling resistance is a share of the force onto the floor (Gillespie,
    Fundamentals of Vehicle Dynamics, chapter 4).
    """
    weight = parameters.mass * _GRAVITY * math.cos(slope_angle(parameters))
    return parameters.rolling_resistance * weight * parameters.wheel_radius / 2


def holding_torque(parameters: Turtlebot3Parameters) -> float:
    """Return the torque in N m with which each of the two motors holds a robot that looks up the slope."""
    return parameters.mass * _GRAVITY * math.sin(slope_angle(parameters)) * parameters.wheel_radius / 2


def burger_model(parameters: Turtlebot3Parameters, wheel_radii: tuple[float, float]) -> str:
    """Return the MJCF of the robot at the origin of the arena, looking along x.

    Args:
        parameters: the robot's figures.
        wheel_radii: the true radii of the left and the right wheel in metres.
    """
    left, right = wheel_radii
    angle = slope_angle(parameters)  # the world's axes are those of the floor: it is gravity that is tilted
    # Friction ten times as stiff as contacts (impratio), so that a robot does not creep down a slope.
    gravity = f"{-_GRAVITY * math.sin(angle)} 0 {-_GRAVITY * math.cos(angle)}"
    return f"""
<mujoco model="turtlebot3_burger">
  <option timestep="{1 / STEPS_PER_SECOND}" integrator="implicitfast" impratio="10" gravity="{gravity}"/>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1" friction="{parameters.floor_friction} 0.005 0.0001"/>
    {"".join(_wall(wall) for wall in ARENA)}
    <body name="base" pos="0 0 {max(wheel_radii)}">
      <freejoint/>
      {_body(parameters)}
      {_caster(parameters)}
      {_wheel("left", left, parameters.wheel_separation / 2, parameters)}
      {_wheel("right", right, -parameters.wheel_separation / 2, parameters)}
    </body>
  </worldbody>
  <actuator>{_motor("left", parameters)}{_motor("right", parameters)}</actuator>
  <sensor><gyro site="imu"/><accelerometer site="imu"/></sensor>
</mujoco>"""


def _wall(wall: Wall) -> str:
    size = f"{wall.half_x} {wall.half_y} {WALL_HEIGHT / 2}"
    return f'<geom type="box" pos="{wall.x} {wall.y} {WALL_HEIGHT / 2}" size="{size}"/>'


def _body(parameters: Turtlebot3Parameters) -> str:
    half_height = (parameters.body_height - _GROUND_CLEARANCE) / 2
    height = _GROUND_CLEARANCE + half_height - parameters.wheel_radius
    return f"""
      <inertial pos="{_BODY_X} 0 {_BODY_MASS_HEIGHT}" mass="{parameters.mass - 2 * parameters.wheel_mass}"
        diaginertia="{_BODY_INERTIA}"/>
      <geom name="body" type="box" pos="{_BODY_X} 0 {height}"
        size="{parameters.body_length / 2} {parameters.body_width / 2} {half_height}"/>
      <site name="imu" pos="{_BODY_X} 0 {_IMU_HEIGHT}"/>"""


def _caster(parameters: Turtlebot3Parameters) -> str:
    # Of two touching geoms of the same priority the larger friction counts, so the caster would drag with
    # the floor's: with a higher priority its own counts, and condim 1 means none at all.
    return f"""
      <geom name="caster" type="sphere" size="{_CASTER_RADIUS}" condim="1" {_STIFF}
        pos="{_CASTER_X} 0 {_CASTER_RADIUS - parameters.wheel_radius}"/>"""


def _wheel(side: str, radius: float, y: float, parameters: Turtlebot3Parameters) -> str:
    # An ellipsoid touches the floor in one point below the hub; a cylinder touches along its width and
    # scrubs when the robot turns in place.
    return f"""
      <body name="{side} wheel" pos="0 {y} 0">
        <joint name="{side}" axis="0 1 0" armature="0.0002" frictionloss="{rolling_torque(parameters)}"/>
        <geom type="ellipsoid" euler="90 0 0" size="{radius} {radius} {_TYRE_HALF_WIDTH}" {_STIFF}
          mass="{parameters.wheel_mass}" friction="{parameters.floor_friction} 0.005 0.0001"/>
      </body>"""


def _motor(side: str, parameters: Turtlebot3Parameters) -> str:
    # A velocity servo whose set point follows the command with a lag: torque = gain * (set point - speed).
    gain, torque = parameters.servo_gain, parameters.motor_stall_torque
    return f"""
      <general joint="{side}" dyntype="filterexact" dynprm="{parameters.servo_time_constant}"
        gaintype="fixed" gainprm="{gain}" biastype="affine" biasprm="0 0 {-gain}"
        forcerange="{-torque} {torque}"/>"""
