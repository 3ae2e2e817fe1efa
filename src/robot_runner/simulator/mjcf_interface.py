"""What a model in MJCF offers to drive it by: two wheels, joints, a scanner, an inertial sensor; found by name."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from robot_runner.core.errors import LinkError, did_you_mean
from robot_runner.simulator.rooms import Cylinder
from robot_runner.simulator.simulated_clock import STEPS_PER_SECOND

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from robot_runner.simulator.rooms import Obstacle

_SCANNERS = ("base_scan", "scan", "lidar", "laser")
_SIDES = ("left", "right")
# Its enumerations do not equal the numbers in its arrays in every release.
_MOVABLE = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
_FREE = int(mujoco.mjtJoint.mjJNT_FREE)
_TO_JOINT = int(mujoco.mjtTrn.mjTRN_JOINT)
_ROUND = tuple(
    map(int, (mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_ELLIPSOID))
)


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
        actuator: its actuator's number; None where nothing drives it.
        kind: what that actuator's control value means.
    """

    name: str
    position: int
    velocity: int
    actuator: int | None = None
    kind: ActuatorKind = ActuatorKind.EFFORT


@dataclass(frozen=True, slots=True)
class WheelPair:
    """Two wheels that are driven by their speeds: joints, radius (m) and distance from each other (m)."""

    left: Joint
    right: Joint
    radius: float
    separation: float


@dataclass(frozen=True, slots=True)
class MjcfInterface:
    """What was found in a model.

    Attributes:
        joints: those that move, in the model's order.
        wheels: of a differential drive, if it is one.
        base: the place in `qpos` of a free joint, whose pose is the robot's; None where it is fixed.
        scanner: the site that a laser scanner turns at; None without one.
        gyroscope, accelerometer: their places in `sensordata`; None without them.
        camera: the number of its first camera; None without one.
    """

    joints: tuple[Joint, ...]
    wheels: WheelPair | None
    base: int | None
    scanner: int | None
    gyroscope: int | None
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
    if not any(each.actuator is not None for each in joints):
        raise LinkError(
            "the model has no actuator that drives a hinge or a slide: it can do nothing",
            where=where,
            fix='Give it some: <actuator><velocity joint="left_wheel" kv="1"/></actuator>.',
        )
    bases = [each for each in range(model.njnt) if model.jnt_type[each] == _FREE]
    return MjcfInterface(
        joints=joints,
        wheels=_wheels(model, joints, {"left": left, "right": right}, where),
        base=int(model.jnt_qposadr[bases[0]]) if bases else None,
        scanner=next((place for place, name in _names(model, "site", model.nsite) if name in _SCANNERS), None),
        gyroscope=_sensor(model, mujoco.mjtSensor.mjSENS_GYRO),
        accelerometer=_sensor(model, mujoco.mjtSensor.mjSENS_ACCELEROMETER),
        camera=0 if model.ncam else None,
    )


def _names(model: mujoco.MjModel, kind: str, count: int) -> list[tuple[int, str]]:
    return [(number, getattr(model, kind)(number).name) for number in range(count)]


def _sensor(model: mujoco.MjModel, kind: mujoco.mjtSensor) -> int | None:
    found = np.flatnonzero(np.asarray(model.sensor_type) == int(kind))
    return int(model.sensor_adr[found[0]]) if len(found) else None


def _joints(model: mujoco.MjModel) -> tuple[Joint, ...]:
    by_joint = {
        int(model.actuator_trnid[number][0]): number
        for number in range(model.nu)
        if model.actuator_trntype[number] == _TO_JOINT
    }
    joints = []
    for number in range(model.njnt):
        if model.jnt_type[number] in _MOVABLE:
            actuator = by_joint.get(number)
            kind = ActuatorKind.EFFORT if actuator is None else _kind(model, actuator)
            name = model.joint(number).name or f"joint_{number}"
            places = int(model.jnt_qposadr[number]), int(model.jnt_dofadr[number])
            joints.append(Joint(name, *places, actuator, kind))
    return tuple(joints)


def _kind(model: mujoco.MjModel, actuator: int) -> ActuatorKind:
    """Return what a control value means: MuJoCo's force is gain * control + bias on position and speed."""
    _, on_position, on_speed = model.actuator_biasprm[actuator][:3]
    if on_position:
        return ActuatorKind.POSITION
    return ActuatorKind.VELOCITY if on_speed else ActuatorKind.EFFORT


def _wheels(model: mujoco.MjModel, joints: Sequence[Joint], given: dict[str, str], where: str) -> WheelPair | None:
    driven = {each.name: each for each in joints if each.kind is ActuatorKind.VELOCITY and each.actuator is not None}
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
    mujoco.mj_forward(model, data)
    anchors = [data.xanchor[model.joint(each.name).id] for each in (left, right)]
    separation = float(np.linalg.norm(anchors[0] - anchors[1]))
    radius = _radius(model, int(model.jnt_bodyid[model.joint(left.name).id]))
    if not (separation > 0 and radius > 0):
        problem = f"its wheels are {separation:g} m apart and have a radius of {radius:g} m"
        raise LinkError(
            problem, where=where, fix="Give each wheel a body with a round geom, to the left and the right."
        )
    return WheelPair(left, right, radius, separation)


def _radius(model: mujoco.MjModel, body: int) -> float:
    """Return the radius of a wheel: the largest of the round geoms of its body."""
    geoms = range(int(model.body_geomadr[body]), int(model.body_geomadr[body] + model.body_geomnum[body]))
    return max((float(model.geom_size[each][0]) for each in geoms if model.geom_type[each] in _ROUND), default=0.0)
