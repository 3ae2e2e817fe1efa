"""The TurtleBot3 Burger among obstacles as a MuJoCo model (MJCF)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from robot_runner.simulator.rooms import ARENA, ORIGIN, Cylinder, Obstacle, Pose
from robot_runner.simulator.simulated_clock import STEPS_PER_SECOND
from robot_runner.simulator.turtlebot3_parameters import Turtlebot3Parameters


@dataclass(frozen=True, slots=True)
class Body:
    """One robot of a world: the true radii of its wheels, m, left and right, and its pose at the beginning.

    The name, empty for a single robot, is the prefix of the names of its parts.
    """

    wheel_radii: tuple[float, float]
    start: Pose = ORIGIN
    name: str = ""


# Contacts as stiff as the time step allows (MuJoCo: at least two steps), so that the wheels roll on
# their true radius instead of sinking in. With priority these values are used, not their mean with the floor's.
_STIFF = 'priority="1" solref="0.01 1" solimp="0.98 0.99 0.0005"'

# Half the width of the tyre (ROBOTIS' URDF: 18 mm wide).
_TYRE_HALF_WIDTH = 0.009

_CASTER_RADIUS = 0.005
_CASTER_X = -0.081  # ROBOTIS' URDF: caster_back_joint

# The body is on a plate whose centre is 32 mm behind the axle (ROBOTIS' URDF: base_link).
_BODY_X = -0.032
_BODY_MASS_HEIGHT = 0.03  # above the axle; the battery and both boards are low
_BODY_INERTIA = "0.0022124 0.0021194 0.0020064"  # ROBOTIS' URDF: base_link, principal axes
_IMU_HEIGHT = 0.045  # above the axle (ROBOTIS' URDF: imu_joint)
_GROUND_CLEARANCE = 0.01
_CAMERA_X, _CAMERA_HEIGHT = 0.04, 0.06  # our choice: in front of the body, below the scanner; from the axle
_GRAVITY = 9.81


def slope_angle(parameters: Turtlebot3Parameters) -> float:
    """Return the slope of the floor along x in radians."""
    return math.atan(parameters.floor_slope / 100)


def rolling_torque(parameters: Turtlebot3Parameters) -> float:
    """Return the torque in N m of the rolling resistance on each of the two wheels.

    The wheels also have the caster's share. Rolling resistance is a share of the normal force (Gillespie,
    Fundamentals of Vehicle Dynamics, chapter 4).
    """
    weight = parameters.mass * _GRAVITY * math.cos(slope_angle(parameters))
    return parameters.rolling_resistance * weight * parameters.wheel_radius / 2


def holding_torques(parameters: Turtlebot3Parameters, yaw: float) -> tuple[float, float]:
    """Return the torques in N m with which the left and the right motor hold a robot on the slope.

    At a yaw (rad) of 0 it faces up the slope. Across it, its body, whose mass is behind the axle, would turn downwards.
    """
    pull = _GRAVITY * math.sin(slope_angle(parameters)) * parameters.wheel_radius
    ahead = parameters.mass * pull * math.cos(yaw) / 2
    body_mass = parameters.mass - 2 * parameters.wheel_mass
    aside = body_mass * pull * math.sin(yaw) * -_BODY_X / parameters.wheel_separation
    return ahead - aside, ahead + aside


def burger_model(
    parameters: Turtlebot3Parameters, wheel_radii: tuple[float, float], *, obstacles: Sequence[Obstacle] = ARENA
) -> str:
    """Return the MJCF of one robot among obstacles, at the origin and facing along x."""
    return world_model(parameters, [Body(wheel_radii)], obstacles)


def world_model(parameters: Turtlebot3Parameters, bodies: Sequence[Body], obstacles: Sequence[Obstacle]) -> str:
    """Return the MJCF of a world with one or several robots with the same parameters."""
    angle = slope_angle(parameters)  # the world's axes are those of the floor, so gravity is tilted instead
    # Friction ten times as stiff as contacts (impratio), so that a robot does not creep down a slope.
    gravity = f"{-_GRAVITY * math.sin(angle)} 0 {-_GRAVITY * math.cos(angle)}"
    motors = "".join(_motor(_part(body, side), parameters) for body in bodies for side in ("left", "right"))
    units = (_part(body, "imu") for body in bodies)
    sensors = "".join(f'<gyro site="{imu}"/><accelerometer site="{imu}"/>' for imu in units)
    # These cost time without effect: sensors that nobody reads (`Physics.sense`), and, with a single robot, the search
    # for islands of contacts, as it is one island in any case.
    left_out = 'sensor="disable" island="disable"' if len(bodies) == 1 else 'sensor="disable"'
    return f"""
<mujoco model="turtlebot3_burger">
  <option timestep="{1 / STEPS_PER_SECOND}" integrator="implicitfast" impratio="10" gravity="{gravity}">
    <flag {left_out}/>
  </option>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1" friction="{parameters.floor_friction} 0.005 0.0001"/>
    {"".join(_obstacle(each) for each in obstacles)}
    {"".join(_robot(body, parameters) for body in bodies)}
  </worldbody>
  <actuator>{motors}</actuator>
  <sensor>{sensors}</sensor>
</mujoco>"""


def _part(body: Body, name: str) -> str:
    return f"{body.name} {name}" if body.name else name


def _robot(body: Body, parameters: Turtlebot3Parameters) -> str:
    (left, right), start = body.wheel_radii, body.start
    half = parameters.wheel_separation / 2
    turned = f' euler="0 0 {math.degrees(start.yaw)}"' if start.yaw else ""
    return f"""
    <body name="{_part(body, "base")}" pos="{start.x} {start.y} {max(left, right)}"{turned}>
      <freejoint/>
      {_body(body, parameters)}
      {_caster(body, parameters)}
      {_wheel(_part(body, "left"), left, half, parameters)}
      {_wheel(_part(body, "right"), right, -half, parameters)}
    </body>"""


def _obstacle(obstacle: Obstacle) -> str:
    place, half_height = f"{obstacle.x} {obstacle.y} {obstacle.height / 2}", obstacle.height / 2
    if isinstance(obstacle, Cylinder):
        return f'<geom type="cylinder" pos="{place}" size="{obstacle.radius} {half_height}"/>'
    turned = f' euler="0 0 {math.degrees(obstacle.yaw)}"' if obstacle.yaw else ""
    return f'<geom type="box" pos="{place}" size="{obstacle.half_x} {obstacle.half_y} {half_height}"{turned}/>'


def _body(body: Body, parameters: Turtlebot3Parameters) -> str:
    half_height = (parameters.body_height - _GROUND_CLEARANCE) / 2
    height = _GROUND_CLEARANCE + half_height - parameters.wheel_radius
    return f"""
      <inertial pos="{_BODY_X} 0 {_BODY_MASS_HEIGHT}" mass="{parameters.mass - 2 * parameters.wheel_mass}"
        diaginertia="{_BODY_INERTIA}"/>
      <geom name="{_part(body, "body")}" type="box" pos="{_BODY_X} 0 {height}"
        size="{parameters.body_length / 2} {parameters.body_width / 2} {half_height}"/>
      <site name="{_part(body, "imu")}" pos="{_BODY_X} 0 {_IMU_HEIGHT}"/>
      <camera name="{_part(body, "camera")}" pos="{_CAMERA_X} 0 {_CAMERA_HEIGHT}" xyaxes="0 -1 0 0 0 1"
        fovy="{_vertical_view(parameters)}"/>"""


def _vertical_view(parameters: Turtlebot3Parameters) -> float:
    """Return the camera's vertical angle of view in degrees; the parameter is the horizontal one."""
    half = math.tan(math.radians(parameters.camera_view) / 2) * parameters.camera_height / parameters.camera_width
    return math.degrees(2 * math.atan(half))


def _caster(body: Body, parameters: Turtlebot3Parameters) -> str:
    # For two touching geoms with the same priority the larger friction is used, so the caster would drag with
    # the floor's: with a higher priority its own is used, and condim 1 means none at all.
    return f"""
      <geom name="{_part(body, "caster")}" type="sphere" size="{_CASTER_RADIUS}" condim="1" {_STIFF}
        pos="{_CASTER_X} 0 {_CASTER_RADIUS - parameters.wheel_radius}"/>"""


def _wheel(side: str, radius: float, y: float, parameters: Turtlebot3Parameters) -> str:
    # An ellipsoid touches the floor in one point below the hub; a cylinder would touch along its width and
    # scrub when the robot turns in place.
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
