"""What a model in MJCF offers to drive it by: two wheels, joints, a scanner, an inertial sensor; found by name."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

import mujoco
import numpy as np

from robot_runner.core.errors import LinkError, did_you_mean
from robot_runner.simulator.rooms import Cylinder, Obstacle
from robot_runner.simulator.simulated_clock import STEPS_PER_SECOND

_SCANNERS = ("base_scan", "scan", "lidar", "laser")
_SIDES = ("left", "right")
# Its enumerations do not equal the numbers in its arrays in every release.
_MOVABLE = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
_ELLIPSOID = int(mujoco.mjtGeom.mjGEOM_ELLIPSOID)
_FREE = int(mujoco.mjtJoint.mjJNT_FREE)
_TO_JOINT = int(mujoco.mjtTrn.mjTRN_JOINT)
_INTEGRATOR = int(mujoco.mjtDyn.mjDYN_INTEGRATOR)
_AFFINE = int(mujoco.mjtBias.mjBIAS_AFFINE)
_FIXED_GAIN = int(mujoco.mjtGain.mjGAIN_FIXED)
_ROUND = tuple(map(int, (mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_CYLINDER, _ELLIPSOID)))


class ActuatorKind(Enum):
    """What an actuator's control value means, by the field of sensor_msgs/JointState that commands it."""

    POSITION = "position"
    VELOCITY = "velocity"
    EFFORT = "effort"


@dataclass(frozen=True, slots=True)
class Joint:
    """A joint that moves, and what drives it.

    Attributes:
        name: in the model.
        position, velocity: its places in `qpos` and `qvel`.
        control: the place of its actuator's value in `ctrl`; None where nothing drives it.
        kind: what that value means.
        scale: the control value for one unit (rad or m, a second, N m or N) at the joint, gears included.
    """

    name: str
    position: int
    velocity: int
    control: int | None = None
    kind: ActuatorKind = ActuatorKind.EFFORT
    scale: float = 1.0


@dataclass(frozen=True, slots=True)
class WheelPair:
    """Two wheels that are driven by their speeds: joints, radius (m) and distance from each other (m).

    Attributes:
        senses: 1 of a wheel that rolls forward where its joint turns forward, -1 of one whose axis points to the right.
    """

    left: Joint
    right: Joint
    radius: float
    separation: float
    senses: tuple[float, float] = (1.0, 1.0)


@dataclass(frozen=True, slots=True)
class MjcfInterface:
    """What was found in a model.

    Attributes:
        joints: those that move, in the model's order.
        wheels: of a differential drive, if it is one.
        base: the place in `qpos` of the robot's free joint, whose pose is the robot's; None where it is fixed.
        base_velocity: the place of that joint in `qvel`.
        scanner: the site that a laser scanner turns at; None without one.
        gyroscope, accelerometer: their places in `sensordata`; None without them.
        gyroscope_site: the site that the gyroscope is at, whose orientation is that of the inertial sensor.
        camera: the number of its first camera; None without one.
    """

    joints: tuple[Joint, ...]
    wheels: WheelPair | None
    base: int | None
    base_velocity: int
    scanner: int | None
    gyroscope: int | None
    gyroscope_site: int
    accelerometer: int | None
    camera: int | None


def read_model(path: Path, obstacles: Iterable[Obstacle] = ()) -> mujoco.MjModel:
    """Return the model of a file, with obstacles around it; its time step divides that of the simulation.

    Raises:
        LinkError: there is no such file, or MuJoCo does not take it.
    """
    if not path.is_file():
        raise LinkError(
            "there is no such model", where=str(path), fix="Give the path of an MJCF file: model=robot.xml."
        )
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        for obstacle in obstacles:
            _stand(spec, obstacle)
        model = spec.compile()
        mujoco.mj_forward(model, mujoco.MjData(model))
    except (ValueError, RuntimeError, mujoco.FatalError) as error:
        problem = f"MuJoCo does not take the model: {' '.join(str(error).split())}"
        raise LinkError(problem, where=str(path), fix="Mend the MJCF; `python -m mujoco.viewer` shows it.") from error
    step = 1 / STEPS_PER_SECOND
    model.opt.timestep = step / math.ceil(step / model.opt.timestep - 1e-9)
    return model


def _stand(spec: mujoco.MjSpec, obstacle: Obstacle) -> None:
    half = obstacle.height / 2
    place = [obstacle.x, obstacle.y, half]
    if isinstance(obstacle, Cylinder):
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_CYLINDER, pos=place, size=[obstacle.radius, half, 0])
        return
    turned = [math.cos(obstacle.yaw / 2), 0, 0, math.sin(obstacle.yaw / 2)]
    size = [obstacle.half_x, obstacle.half_y, half]
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, pos=place, size=size, quat=turned)


def parts_of_model(path: Path) -> tuple[Path, ...]:
    """Return the files that a model is made of beside its own: included ones, meshes, textures, height fields.

    Older releases of MuJoCo do not tell them: then all files in the folder of the model count.
    """
    told = getattr(mujoco, "mju_getXMLDependencies", None)
    if told is None:
        return tuple(each for each in sorted(path.parent.rglob("*")) if each.is_file() and each != path)
    try:
        found = map(Path, told(str(path)))
    except mujoco.FatalError:  # it cannot be read, which its reader tells
        return ()
    return tuple(sorted(each for each in found if each != path))


def read_interface(model: mujoco.MjModel, *, where: str, left: str = "", right: str = "") -> MjcfInterface:
    """Return what a model offers.

    Args:
        model: of MuJoCo.
        where: the file, for errors.
        left: the joint of its left wheel; left out, the only one driven by its speed whose name says left.
        right: likewise.

    Raises:
        LinkError: nothing drives it, or the wheels that are named are none.
    """
    joints = _joints(model)
    driven = next((each for each in joints if each.control is not None), None)
    if driven is None:
        raise LinkError(
            "the model has no actuator that drives a hinge or a slide: it can do nothing",
            where=where,
            fix='Give it some: <actuator><velocity joint="left_wheel" kv="1"/></actuator>.',
        )
    wheels = _wheels(model, joints, {"left": left, "right": right}, where)
    base = _base(model, driven if wheels is None else wheels.left)
    gyroscope = _sensor(model, mujoco.mjtSensor.mjSENS_GYRO)
    accelerometer = _sensor(model, mujoco.mjtSensor.mjSENS_ACCELEROMETER)
    return MjcfInterface(
        joints=joints,
        wheels=wheels,
        base=None if base is None else int(model.jnt_qposadr[base]),
        base_velocity=0 if base is None else int(model.jnt_dofadr[base]),
        scanner=next((place for place, name in _names(model, "site", model.nsite) if name in _SCANNERS), None),
        gyroscope=None if gyroscope is None else int(model.sensor_adr[gyroscope]),
        gyroscope_site=0 if gyroscope is None else int(model.sensor_objid[gyroscope]),
        accelerometer=None if accelerometer is None else int(model.sensor_adr[accelerometer]),
        camera=0 if model.ncam else None,
    )


def _names(model: mujoco.MjModel, kind: str, count: int) -> list[tuple[int, str]]:
    return [(number, getattr(model, kind)(number).name) for number in range(count)]


def _sensor(model: mujoco.MjModel, kind: mujoco.mjtSensor) -> int | None:
    found = np.flatnonzero(np.asarray(model.sensor_type) == int(kind))
    return int(found[0]) if len(found) else None


def _joint_number(model: mujoco.MjModel, joint: Joint) -> int:
    return int(model.dof_jntid[joint.velocity])


def _base(model: mujoco.MjModel, joint: Joint) -> int | None:
    """Return the free joint of the robot that a joint is part of: what else lies around freely has one, too."""
    root = model.body_rootid[model.jnt_bodyid[_joint_number(model, joint)]]
    found = (each for each in range(model.njnt) if model.jnt_type[each] == _FREE and model.jnt_bodyid[each] == root)
    return next(found, None)


def _joints(model: mujoco.MjModel) -> tuple[Joint, ...]:
    by_joint = {
        int(model.actuator_trnid[number][0]): number
        for number in range(len(model.actuator_trntype))
        if model.actuator_trntype[number] == _TO_JOINT and _control(model, number) is not None
    }
    joints = []
    for number in range(model.njnt):
        if model.jnt_type[number] in _MOVABLE:
            actuator = by_joint.get(number)
            drive = (ActuatorKind.EFFORT, 1.0) if actuator is None else _drive(model, actuator)
            name = model.joint(number).name or f"joint_{number}"
            places = int(model.jnt_qposadr[number]), int(model.jnt_dofadr[number])
            joints.append(Joint(name, *places, None if actuator is None else _control(model, actuator), *drive))
    return tuple(joints)


def _control(model: mujoco.MjModel, actuator: int) -> int | None:
    """Return the place of an actuator's value in `ctrl`; None of one that takes several, as DC motors of MuJoCo 4 may.

    What each of several means, `sensor_msgs/JointState` has no words for.
    """
    counts = getattr(model, "actuator_ctrlnum", None)
    if counts is None:  # before, each took one
        return actuator
    return int(model.actuator_ctrladr[actuator]) if counts[actuator] == 1 else None


def _drive(model: mujoco.MjModel, actuator: int) -> tuple[ActuatorKind, float]:
    """Return what a control value means, and the one for a unit at the joint.

    MuJoCo's force is gain * control + bias on length and speed, which are the joint's times the gear; an integrator
    adds up the control value first (https://mujoco.readthedocs.io/en/stable/computation/, actuation model).
    """
    is_affine = model.actuator_biastype[actuator] == _AFFINE  # the numbers of muscles and others mean something else
    _, on_position, on_speed = map(float, model.actuator_biasprm[actuator][:3]) if is_affine else (0.0, 0.0, 0.0)
    gear, gain = float(model.actuator_gear[actuator][0]), float(model.actuator_gainprm[actuator][0])
    adds_up = model.actuator_dyntype[actuator] == _INTEGRATOR
    bias = on_position or on_speed
    kind = ActuatorKind.EFFORT
    if bias:
        kind = ActuatorKind.POSITION if on_position and not adds_up else ActuatorKind.VELOCITY
    if model.actuator_gaintype[actuator] != _FIXED_GAIN or not gain or not gear:
        return kind, 1.0
    return kind, -bias * gear / gain if bias else 1 / (gain * gear)


def _wheels(model: mujoco.MjModel, joints: Sequence[Joint], given: dict[str, str], where: str) -> WheelPair | None:
    driven = {each.name: each for each in joints if each.kind is ActuatorKind.VELOCITY and each.control is not None}
    found: dict[str, Joint] = {}
    for side in _SIDES:
        if given[side] and given[side] not in driven:
            fix = did_you_mean(given[side], driven) or "Drive it by its speed: <velocity joint=.../>."
            raise LinkError(f"{side}={given[side]!r} is no joint that is driven by its speed", where=where, fix=fix)
        alike = [given[side]] if given[side] else [name for name in driven if side in name.casefold()]
        if len(alike) != 1:
            return None
        found[side] = driven[alike[0]]
    left, right = found["left"], found["right"]
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    numbers = [_joint_number(model, each) for each in (left, right)]
    across = data.xanchor[numbers[0]] - data.xanchor[numbers[1]]
    separation = float(np.linalg.norm(across))
    radius = _radius(model, int(model.jnt_bodyid[numbers[0]]))
    if not (separation > 0 and radius > 0):
        problem = f"its wheels are {separation:g} m apart and have a radius of {radius:g} m"
        raise LinkError(
            problem, where=where, fix="Give each wheel a body with a round geom, to the left and the right."
        )
    # A wheel rolls forward where it turns about an axis that points to the left.
    left_sense, right_sense = (-1.0 if float(data.xaxis[each] @ across) < 0 else 1.0 for each in numbers)
    return WheelPair(left, right, radius, separation, (left_sense, right_sense))


def _radius(model: mujoco.MjModel, body: int) -> float:
    """Return the radius of a wheel: the largest of the round geoms of its body."""
    geoms = range(int(model.body_geomadr[body]), int(model.body_geomadr[body] + model.body_geomnum[body]))
    return max((_round_radius(model, each) for each in geoms if model.geom_type[each] in _ROUND), default=0.0)


def _round_radius(model: mujoco.MjModel, geom: int) -> float:
    # An ellipsoid may have any of its axes along the axle; of a cylinder the second figure is half its width.
    sizes = model.geom_size[geom]
    return float(sizes.max() if model.geom_type[geom] == _ELLIPSOID else sizes[0])
