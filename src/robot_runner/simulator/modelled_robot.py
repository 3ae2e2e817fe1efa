"""A robot from a user's MJCF model, with the topics for its parts."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from robot_runner.core.errors import LinkError, did_you_mean
from robot_runner.core.events.early_end import undivided
from robot_runner.core.words import counted
from robot_runner.simulator.camera import Camera, camera_topics
from robot_runner.simulator.drive import OdometryState
from robot_runner.simulator.mjcf_interface import ActuatorKind, Joint, WheelPair, read_interface, read_model
from robot_runner.simulator.physics import MORE_MEMORY, check_physics
from robot_runner.simulator.physics_library import mujoco
from robot_runner.simulator.rooms import Pose, Room
from robot_runner.simulator.sensors import RAYS, PublishedTopic, imu, joint_state, laser_scan, odometry
from robot_runner.simulator.simulated_clock import STEPS_PER_SECOND, SimulatedClock
from robot_runner.simulator.turtlebot3_parameters import Floats, NoiseStreams, Turtlebot3Parameters

Message = Mapping[str, Any]

#: A ray that meets the robot itself goes on this far (m) behind the surface.
_PAST = 1e-6
_TWIST = "geometry_msgs/Twist"
_JOINTS = "sensor_msgs/JointState"
_CALMER = "Give the model a shorter time step, softer actuators or more damping; `python -m mujoco.viewer` shows it."
#: From this value on (mjMAXVAL) MuJoCo rejects a command, and sets all to zero.
_TOO_LARGE = 1e10


class RobotModel:
    """An MJCF model, read once for any number of robots.

    A room has obstacles around it, besides those in the model. `left` and `right` are the joints of its wheels, if
    their names do not contain left and right.

    Raises:
        LinkError: the file is not a model with actuators.
    """

    def __init__(self, path: Path, room: Room | None = None, *, left: str = "", right: str = "") -> None:
        self.path = path
        self.room = room
        self._left, self._right = left, right
        self.model = read_model(path, () if room is None else room.obstacles)
        self.interface = read_interface(self.model, where=str(path), left=left, right=right)

    def within(self, room: Room) -> RobotModel:
        """Return the same model, read again, with this room around it."""
        return RobotModel(self.path, room, left=self._left, right=self._right)


class ModelledRobot:
    """A robot from a model, in its own world; physics is computed on demand, up to the clock's time.

    It has no battery, no power meter and no on-board computer, as its power is unknown.

    Attributes:
        namespace: its name in the simulation: empty, or `/alice`.
        path: of the model's file.
        topics: the topics that it publishes, by name within its namespace: `joint_states`; `odom` and `ground_truth`
            with wheels or a free base; `scan` with a site called `scan`, `lidar`, `laser` or `base_scan`; `imu` with a
            gyroscope and an accelerometer; `camera/image_raw` and `camera/camera_info` with a camera.
        command_topics: those that it subscribes to: `joint_commands`, and `cmd_vel` with two wheels.
        services: none.
    """

    cut_off = None

    def __init__(
        self, namespace: str, clock: SimulatedClock, seed: int, parameters: Turtlebot3Parameters, made_of: RobotModel
    ) -> None:
        self.namespace = namespace
        self.path = made_of.path
        self.parameters = parameters
        self._clock = clock
        self._model, self._interface = made_of.model, made_of.interface
        self._data = mujoco.MjData(self._model)
        self._warnings = self._data.warning.number
        self._substeps = round(1 / STEPS_PER_SECOND / self._model.opt.timestep)
        self._steps = 0
        self._place = None if made_of.room is None else made_of.room.robots.get(namespace)
        self._start()
        streams = NoiseStreams(seed, namespace)
        self._imu_noise = streams.numbered("imu", width=6)
        self._scan_noise = streams.numbered("scan", width=RAYS)
        self.topics = self._published()
        wheels = {"cmd_vel": _TWIST} if self._interface.wheels else {}
        self.command_topics: Mapping[str, str] = MappingProxyType({**wheels, "joint_commands": _JOINTS})
        self.services: Mapping[str, str] = MappingProxyType({})

    def command(self, topic: str, message: Message) -> None:
        """Execute a command, until the next one; raise a `LinkError` if a joint has no actuator."""
        self._reach()
        if topic == "cmd_vel":
            self._drive(float(message["linear"]["x"]), float(message["angular"]["z"]))
        else:
            self._move_joints(message)

    def call(self, service: str) -> dict[str, bool | str]:
        """Raise an error, as it has no services."""
        raise LinkError(f"{service!r} is not a service of the model", where=self.namespace or "/", fix="It has none.")

    def put_back(self) -> None:
        """Put the robot back to its start, with its odometry at zero."""
        self._reach()
        self._start()

    def _seen(self) -> tuple[mujoco.MjModel, mujoco.MjData]:
        self._reach()
        return self._model, self._data

    @undivided
    def _start(self) -> None:
        if self._model.nkey:
            mujoco.mj_resetDataKeyframe(self._model, self._data, 0)
        else:
            mujoco.mj_resetData(self._model, self._data)
        if self._place is not None and self._interface.base is not None:
            self._stand_at(self._place, self._data.qpos[self._interface.base :][:7])
        mujoco.mj_forward(self._model, self._data)
        self._odometry = OdometryState()
        self._angles = self._wheel_angles()

    @staticmethod
    def _stand_at(place: Pose, pose: Floats) -> None:
        """Set the pose to the start in the room, turned relative to the model's pose, at the model's height."""
        turn = np.array([math.cos(place.yaw / 2), 0.0, 0.0, math.sin(place.yaw / 2)])
        pose[:2] = place.x, place.y
        mujoco.mju_mulQuat(pose[3:], turn, pose[3:].copy())

    def _reach(self) -> None:
        try:
            for _ in range(self._steps, self._clock.step):
                self._step()
        except mujoco.FatalError as error:
            problem = f"MuJoCo gave up on the model: {' '.join(str(error).split())}"
            raise LinkError(problem, where=str(self.path), fix=MORE_MEMORY) from error
        check_physics(self._warnings, "model", where=str(self.path), fix=_CALMER)

    @undivided
    def _step(self) -> None:
        mujoco.mj_step(self._model, self._data, nstep=self._substeps)
        if self._interface.wheels is not None:
            self._count_wheels(self._interface.wheels)
        self._steps += 1

    def _drive(self, linear: float, angular: float) -> None:
        if (wheels := self._interface.wheels) is not None:
            turning = angular * wheels.separation / 2
            speeds = (linear - turning, linear + turning)
            for joint, sense, speed in zip((wheels.left, wheels.right), wheels.senses, speeds, strict=True):
                self._actuate(joint, sense * speed / wheels.radius)

    def _move_joints(self, message: Message) -> None:
        driven = {each.name: each for each in self._interface.joints if each.control is not None}
        values = {kind: list(message[kind.value]) for kind in ActuatorKind}
        for kind, given in values.items():
            if len(given) > (named := len(message["name"])):
                problem = f"{kind.value} has {counted(len(given), 'value')} for {counted(named, 'name')}"
                raise LinkError(problem, where="joint_commands", fix="Name the joint of each value in name.")
        moved: list[tuple[Joint, float]] = []
        for place, name in enumerate(message["name"]):
            if name not in driven:
                problem = f"{name!r} is not a joint of the model that is driven"
                raise LinkError(problem, where="joint_commands", fix=did_you_mean(name, driven))
            joint = driven[name]
            given = values[joint.kind]
            if place >= len(given):
                problem = f"{name!r} is driven by its {joint.kind.value}, and none is given"
                raise LinkError(problem, where="joint_commands", fix=f"Give {joint.kind.value}, one for each name.")
            moved.append((joint, given[place]))
        for joint, value in moved:
            self._actuate(joint, value)

    def _actuate(self, joint: Joint, value: float) -> None:
        control = value * joint.scale
        if not abs(control) <= _TOO_LARGE:
            problem = f"{joint.name!r} would be driven by {control:g}, which the physics does not take"
            raise LinkError(problem, where=str(self.path), fix=f"Give a number within {_TOO_LARGE:g} of zero.")
        self._data.ctrl[joint.control] = control

    def _wheel_angles(self) -> tuple[float, float]:
        wheels = self._interface.wheels
        if wheels is None:
            return 0.0, 0.0
        left, right = (float(self._data.qpos[each.position]) for each in (wheels.left, wheels.right))
        return wheels.senses[0] * left, wheels.senses[1] * right

    def _count_wheels(self, wheels: WheelPair) -> None:
        angles = self._wheel_angles()
        left, right = ((now - then) * wheels.radius for now, then in zip(angles, self._angles, strict=True))
        self._odometry = self._odometry.rolled(left, right, wheels.separation, 1 / STEPS_PER_SECOND)
        self._angles = angles

    # Its topics.

    def _published(self) -> dict[str, PublishedTopic]:
        found, parameters, clock = self._interface, self.parameters, self._clock
        rate = parameters.odometry_rate
        topics = {"joint_states": PublishedTopic(clock, _JOINTS, rate, self._joint_states)}
        if found.wheels is not None:
            topics["odom"] = PublishedTopic(clock, "nav_msgs/Odometry", rate, self._odom)
        if found.base is not None:
            topics["ground_truth"] = PublishedTopic(clock, "nav_msgs/Odometry", rate, self._ground_truth)
        if found.scanner is not None:
            topics["scan"] = PublishedTopic(clock, "sensor_msgs/LaserScan", parameters.scan_rate, self._scan)
        if found.gyroscope is not None and found.accelerometer is not None:
            topics["imu"] = PublishedTopic(clock, "sensor_msgs/Imu", parameters.imu_rate, self._imu)
        if found.camera is not None:
            camera = Camera(self._seen, found.camera, parameters, is_painted=False)
            topics |= camera_topics(clock, camera, parameters.camera_rate)
        return topics

    def _odom(self) -> dict[str, Any]:
        self._reach()
        return odometry(self._clock.now_ns, self._odometry)

    def _ground_truth(self) -> dict[str, Any]:
        self._reach()
        base, moving = self._interface.base or 0, self._interface.base_velocity
        x, y, z, w, qx, qy, qz = map(float, self._data.qpos[base : base + 7])
        # MuJoCo's linear velocity is in the world's axes, ROS' twist in those of the robot.
        inverse, linear = np.empty(4), np.empty(3)
        mujoco.mju_negQuat(inverse, self._data.qpos[base + 3 : base + 7])
        mujoco.mju_rotVecQuat(linear, self._data.qvel[moving : moving + 3], inverse)
        angular = self._data.qvel[moving + 3 : moving + 6]
        message = odometry(self._clock.now_ns, OdometryState(x, y))
        message["twist"]["twist"] = {
            part: dict(zip("xyz", vector.tolist(), strict=True))
            for part, vector in (("linear", linear), ("angular", angular))
        }
        message["header"]["frame_id"] = "world"
        message["pose"]["pose"]["position"]["z"] = z
        message["pose"]["pose"]["orientation"] = {"x": qx, "y": qy, "z": qz, "w": w}
        return message

    def _joint_states(self) -> dict[str, Any]:
        self._reach()
        joints, data = self._interface.joints, self._data
        return joint_state(
            self._clock.now_ns,
            names=[each.name for each in joints],
            positions=[float(data.qpos[each.position]) for each in joints],
            velocities=[float(data.qvel[each.velocity]) for each in joints],
        )

    def _imu(self) -> dict[str, Any]:
        self._reach()
        places = (self._interface.gyroscope or 0, self._interface.accelerometer or 0)
        angular, linear = (self._data.sensordata[place : place + 3] for place in places)
        turned = np.empty(4)
        mujoco.mju_mat2Quat(turned, self._data.site_xmat[self._interface.gyroscope_site])
        w, x, y, z = turned.tolist()
        noise = self._imu_noise.of(self._clock.step)
        return imu(self._clock.now_ns, (x, y, z, w), angular, linear, noise, self.parameters)

    def _scan(self) -> dict[str, Any]:
        self._reach()
        noise = self._scan_noise.of(self._clock.step)
        return laser_scan(self._clock.now_ns, self._ray_distances(), noise, self.parameters)

    def _ray_distances(self) -> Floats:
        """Return the length of each ray in the plane of the scanner's site; rays pass through the robot itself."""
        site = self._interface.scanner or 0
        turned = self._data.site_xmat[site].reshape(3, 3)
        angles = np.arange(RAYS) * (2 * math.pi / RAYS)
        rays = np.stack([np.cos(angles), np.sin(angles), np.zeros(RAYS)], axis=1) @ turned.T
        own, start = int(self._model.site_bodyid[site]), self._data.site_xpos[site]
        return np.array([self._ray_distance(start, ray, own) for ray in rays])

    def _ray_distance(self, start: Floats, ray: Floats, own: int) -> float:
        roots, bodies, met = self._model.body_rootid, self._model.geom_bodyid, np.zeros(1, dtype=np.int32)
        gone, left_out = 0.0, own or -1  # a scanner that is part of the world must not leave out the world
        while (further := mujoco.mj_ray(self._model, self._data, start + gone * ray, ray, None, 1, left_out, met)) >= 0:
            gone += float(further)
            # MuJoCo leaves out one body at most: a wheel, or a mast, is another body of the same robot.
            if not own or roots[bodies[met[0]]] != roots[own]:
                return gone
            gone += _PAST
        return math.inf
