"""The interface of an MJCF model: wheels, joints, laser scanner, inertial sensor and camera, found by name and kind."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

import numpy as np

from robot_runner.core.errors import LinkError, did_you_mean
from robot_runner.simulator.physics_library import mujoco
from robot_runner.simulator.rooms import Cylinder, Obstacle
from robot_runner.simulator.simulated_clock import STEPS_PER_SECOND

#: With a shorter one, s, of a model by mistake, no simulation would come to an end.
_SHORTEST_STEP = 1e-6
_SCANNERS = ("base_scan", "scan", "lidar", "laser")
_SIDES = ("left", "right")
# As ints, because in some releases of MuJoCo its enumerations do not equal the numbers in its arrays.
_MOVABLE = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
_ELLIPSOID = int(mujoco.mjtGeom.mjGEOM_ELLIPSOID)
_FREE = int(mujoco.mjtJoint.mjJNT_FREE)
_TO_JOINT = int(mujoco.mjtTrn.mjTRN_JOINT)
_INTEGRATOR = int(mujoco.mjtDyn.mjDYN_INTEGRATOR)
_AFFINE = int(mujoco.mjtBias.mjBIAS_AFFINE)
_FIXED_GAIN = int(mujoco.mjtGain.mjGAIN_FIXED)
_ROUND = tuple(map(int, (mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_CYLINDER, _ELLIPSOID)))


class ActuatorKind(Enum):
    """The meaning of an actuator's control value, by the field of sensor_msgs/JointState that commands it."""

    POSITION = "position"
    VELOCITY = "velocity"
    EFFORT = "effort"


@dataclass(frozen=True, slots=True)
class Joint:
    """A movable joint, and its actuator.

    Attributes:
        name: in the model.
        position, velocity: its indices in `qpos` and `qvel`.
        control: the index of its actuator's value in `ctrl`; None without an actuator.
        kind: the meaning of that value.
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
    """Two wheels with velocity actuators: joints, radius (m) and distance from each other (m).

    Attributes:
        senses: 1 for a wheel that rolls forward if its joint turns forward, -1 for one whose axis points to the right.
    """

    left: Joint
    right: Joint
    radius: float
    separation: float
    senses: tuple[float, float] = (1.0, 1.0)


@dataclass(frozen=True, slots=True)
class MjcfInterface:
    """The interface of a model.

    Attributes:
        joints: the movable ones, in the model's order.
        wheels: of a differential drive; None without one.
        base: the index in `qpos` of the robot's free joint, whose pose is the robot's; None if the robot is fixed.
        base_velocity: the index of that joint in `qvel`.
        scanner: the site of a laser scanner; None without one.
        gyroscope, accelerometer: their indices in `sensordata`; None without them.
        gyroscope_site: the site of the gyroscope, whose orientation is that of the inertial sensor.
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
        LinkError: there is no such file, or MuJoCo refuses it.
    """
    if not path.is_file():
        fix = "Give the path of an MJCF file: model=robot.xml."
        raise LinkError("there is no such model", where=str(path), fix=fix)
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        for obstacle in obstacles:
            _stand(spec, obstacle)
        model = spec.compile()
        mujoco.mj_forward(model, mujoco.MjData(model))
    except (ValueError, RuntimeError, mujoco.FatalError) as error:
        problem = f"MuJoCo does not take the model: {' '.join(str(error).split())}"
        fix = "Correct the MJCF; `python -m mujoco.viewer` shows it."
        raise LinkError(problem, where=str(path), fix=fix) from error
    if not model.opt.timestep >= _SHORTEST_STEP:
        problem = f"the time step of the model is {model.opt.timestep:g} s"
        fix = f'Give it one of at least {_SHORTEST_STEP:g} s: <option timestep="0.002"/>.'
        raise LinkError(problem, where=str(path), fix=fix)
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
    """Return the further files of a model: included ones, meshes, textures, height fields.

    Older releases of MuJoCo do not list them: then all files in the folder of the model count.
    """
    told = getattr(mujoco, "mju_getXMLDependencies", None)
    if told is None:
        return tuple(each for each in sorted(path.parent.rglob("*")) if each.is_file() and each != path)
    try:
        found = map(Path, told(str(path)))
    except mujoco.FatalError:  # the model cannot be read, which `read_model` reports
        return ()
    return tuple(sorted(each for each in found if each != path))


def read_interface(model: mujoco.MjModel, *, where: str, left: str = "", right: str = "") -> MjcfInterface:
    """Return the interface of a model of MuJoCo; `where` is its file, for errors.

    `left` and `right` are the joints of its wheels; if empty, the only one with a velocity actuator and left (right) in
    its name.

    Raises:
        LinkError: the model has no actuator for a joint, or a named joint is not a wheel.
    """
    joints = _joints(model)
    driven = next((each for each in joints if each.control is not None), None)
    if driven is None:
        problem = "the model has no actuator that drives a hinge or a slide: it can do nothing"
        fix = 'Give it some: <actuator><velocity joint="left_wheel" kv="1"/></actuator>.'
        raise LinkError(problem, where=where, fix=fix)
    wheels = _wheels(model, joints, {"left": left, "right": right}, where)
    base = _base(model, driven if wheels is None else wheels.left)
    gyroscope = _sensor(model, mujoco.mjtSensor.mjSENS_GYRO)
    accelerometer = _sensor(model, mujoco.mjtSensor.mjSENS_ACCELEROMETER)
    return MjcfInterface(
        joints=joints,
        wheels=wheels,
        base=None if base is None else int(model.jnt_qposadr[base]),
        base_velocity=0 if base is None else int(model.jnt_dofadr[base]),
        scanner=next((number for number in range(model.nsite) if model.site(number).name in _SCANNERS), None),
        gyroscope=None if gyroscope is None else int(model.sensor_adr[gyroscope]),
        gyroscope_site=0 if gyroscope is None else int(model.sensor_objid[gyroscope]),
        accelerometer=None if accelerometer is None else int(model.sensor_adr[accelerometer]),
        camera=0 if model.ncam else None,
    )


def _sensor(model: mujoco.MjModel, kind: mujoco.mjtSensor) -> int | None:
    found = np.flatnonzero(np.asarray(model.sensor_type) == int(kind))
    return int(found[0]) if len(found) else None


def _joint_number(model: mujoco.MjModel, joint: Joint) -> int:
    return int(model.dof_jntid[joint.velocity])


def _base(model: mujoco.MjModel, joint: Joint) -> int | None:
    """Return the free joint of the robot with this joint: loose objects have free joints, too."""
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
    """Return the index of an actuator's value in `ctrl`; None if it takes several, as DC motors of MuJoCo 4 may.

    `sensor_msgs/JointState` has no fields for several values.
    """
    counts = getattr(model, "actuator_ctrlnum", None)
    if counts is None:  # in older releases each takes one
        return actuator
    return int(model.actuator_ctrladr[actuator]) if counts[actuator] == 1 else None


def _drive(model: mujoco.MjModel, actuator: int) -> tuple[ActuatorKind, float]:
    """Return the meaning of a control value, and the value for one unit at the joint.

    MuJoCo's force is gain * control + bias by length and speed, which are the joint's times the gear; an integrator
    integrates the control value first (https://mujoco.readthedocs.io/en/stable/computation/, actuation model).
    """
    is_affine = model.actuator_biastype[actuator] == _AFFINE  # other types, such as muscles, have other parameters
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
            raise LinkError(f"{side}={given[side]!r} is not a joint that is driven by its speed", where=where, fix=fix)
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
        problem = f"the wheels are {separation:g} m apart and have a radius of {radius:g} m"
        fix = "Give each wheel a body with a round geom, to the left and the right."
        raise LinkError(problem, where=where, fix=fix)
    # A wheel rolls forward if it turns about an axis that points to the left.
    left_sense, right_sense = (-1.0 if float(data.xaxis[each] @ across) < 0 else 1.0 for each in numbers)
    return WheelPair(left, right, radius, separation, (left_sense, right_sense))


def _radius(model: mujoco.MjModel, body: int) -> float:
    """Return the radius of a wheel: the largest of the round geoms of its body."""
    geoms = range(int(model.body_geomadr[body]), int(model.body_geomadr[body] + model.body_geomnum[body]))
    return max((_round_radius(model, each) for each in geoms if model.geom_type[each] in _ROUND), default=0.0)


def _round_radius(model: mujoco.MjModel, geom: int) -> float:
    # An ellipsoid may have any of its axes along the axle; the second size of a cylinder is half its width.
    sizes = model.geom_size[geom]
    return float(sizes.max() if model.geom_type[geom] == _ELLIPSOID else sizes[0])
