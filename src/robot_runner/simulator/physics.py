"""One world of MuJoCo with one or several robots, advanced in steps of the simulation's grid."""

from __future__ import annotations

import ctypes
import logging
from collections.abc import Sequence
from copy import copy
from operator import itemgetter
from typing import Protocol

import numpy as np
import numpy.typing as npt

from robot_runner.core.errors import LinkError
from robot_runner.core.events.early_end import undivided
from robot_runner.simulator.model import Body, holding_torques, world_model
from robot_runner.simulator.physics_library import mujoco
from robot_runner.simulator.rooms import ARENA, Obstacle
from robot_runner.simulator.turtlebot3_parameters import Floats, Turtlebot3Parameters

_SETTLING_STEPS = 200
_INITIAL_ROWS = 4096
#: The number of steps between two corrections of the motors' set points (100 ms).
CORRECTION_STEPS = 20
_Warning = mujoco.mjtWarning
#: MuJoCo's warnings of a number that became too large or NaN, before it resets itself.
_diverged = itemgetter(*map(int, (_Warning.mjWARN_BADQPOS, _Warning.mjWARN_BADQVEL, _Warning.mjWARN_BADQACC)))
#: MuJoCo's warnings of contacts that exceed its memory, before it goes on without them.
_overflown = itemgetter(*map(int, (_Warning.mjWARN_CONTACTFULL, _Warning.mjWARN_CNSTRFULL)))
MORE_MEMORY = 'Give it more memory, as in <size memory="100M"/>, or fewer things that touch each other.'
#: The lengths of a robot's parts of MuJoCo's arrays: seven for its pose (six for its velocity) and two for its wheels.
_POSITIONS, _VELOCITIES = 9, 8


if mujoco.get_mju_user_warning() is None:
    # Otherwise MuJoCo writes a file MUJOCO_LOG.TXT into the working folder.
    mujoco.set_mju_user_warning(logging.getLogger(__name__).warning)
if mujoco.get_mjcb_time() is None:
    # Its bindings read the clock a dozen times a step for `MjData.timer`, which is not used here: a tenth of a step's
    # time. They have no function to switch that off; `mujoco.set_mjcb_time(time.perf_counter)` restores it.
    ctypes.c_void_p.in_dll(ctypes.CDLL(mujoco._functions.__file__), "mjcb_time").value = None  # noqa: SLF001


def check_physics(warnings: npt.NDArray[np.int32], what: str, *, where: str, fix: str) -> None:
    """Check that the physics of a robot or model (`what`) has been right so far.

    The count of each warning of MuJoCo is a view of `data.warning.number`, as each look-up costs time; `fix` is what to
    do if the physics diverged.

    Raises:
        LinkError: the physics diverged, and MuJoCo went on after a silent reset; or it left contacts out.
    """
    counts = warnings.tolist()
    if not any(counts):
        return
    if any(_overflown(counts)):
        problem = f"MuJoCo's memory is too small for all contacts of the {what}: some had no effect"
        raise LinkError(problem, where=where, fix=MORE_MEMORY)
    if any(_diverged(counts)):
        problem = f"the physics of the {what} diverged, and MuJoCo put the robot back to its beginning"
        raise LinkError(problem, where=where, fix=fix)


def _flat(numbers: Floats) -> memoryview[float]:
    return numbers.reshape(-1).data.cast("B").cast("d")


class Rider(Protocol):
    """The drive of a body."""

    def correct(self) -> None:
        """Correct the motors' set points."""


class Physics:
    """The bodies of a world; all of them are always at the same step.

    Attributes:
        steps: the number of steps since the beginning.
        traces: the wheels' angles (rad) and speeds (rad/s) and the motors' torques (N m), shape (rows, bodies, 2) each:
            row i is the state after i steps, the left wheel before the right one. They are views, which are replaced
            when rows are added.

    Raises:
        LinkError: MuJoCo does not take the robot.
    """

    def __init__(
        self, parameters: Turtlebot3Parameters, bodies: Sequence[Body], obstacles: Sequence[Obstacle] = ARENA
    ) -> None:
        try:
            self._model = mujoco.MjModel.from_xml_string(world_model(parameters, bodies, obstacles))
        except ValueError as error:
            problem = f"MuJoCo does not take the simulated robot: {' '.join(str(error).split())}"
            fix = "Give its parameters, or the obstacles of its room, less extreme values."
            raise LinkError(problem, where="Turtlebot3Parameters", fix=fix) from error
        self._data = mujoco.MjData(self._model)
        self._warnings = self._data.warning.number
        self._riders: list[Rider] = []
        self._has_sensors = False
        # On a slope the motors hold their robot from the beginning.
        held = np.ravel([holding_torques(parameters, each.start.yaw) for each in bodies])
        self._data.act[:] = self._data.ctrl[:] = held / parameters.servo_gain
        self.steps = 0
        mujoco.mj_step(self._model, self._data, nstep=_SETTLING_STEPS)
        self._settled = np.array(self._data.qpos)
        self._traced: tuple[Floats, Floats, Floats] = (self._data.qpos, self._data.qvel, self._data.actuator_force)
        self._keep([np.empty((_INITIAL_ROWS, len(each))) for each in self._traced])
        for rows, now in zip(self._rows, self._traced, strict=True):
            rows[0] = now

    @property
    def parts(self) -> tuple[mujoco.MjModel, mujoco.MjData]:
        """Its model and its state, for pictures."""
        return self._model, self._data

    def ride(self, rider: Rider) -> None:
        """Call a rider's `correct` every `CORRECTION_STEPS` from now on."""
        self._riders.append(rider)

    def body(self, number: int) -> BodyState:
        """Return the state of a body as views, which change with each step."""
        return BodyState(self._data, number)

    @undivided
    def sense(self) -> None:
        """Compute the inertial sensors from now on: they take a fifteenth of the time, and are rarely used."""
        if self._has_sensors:
            return
        self._has_sensors = True
        self._model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_SENSOR)
        now = copy(self._data)  # in the state itself, MuJoCo 3.2.4 would slightly change the beginning of the next step
        mujoco.mj_forward(self._model, now)
        self._data.sensordata[:] = now.sensordata

    @undivided
    def advance(self, steps: int) -> None:
        """Advance to this number of steps, unless it is there already; raise a `LinkError` if it went wrong."""
        while steps >= len(self._rows[0]):
            self._keep([np.concatenate([each, np.empty_like(each)]) for each in self._rows])
        model, data = self._model, self._data
        (positions, p, now), (velocities, v, now_too), (forces, f, now_as_well) = self._copies
        for row in range(self.steps + 1, steps + 1):
            mujoco.mj_step(model, data)
            positions[row * p : row * p + p] = now
            velocities[row * v : row * v + v] = now_too
            forces[row * f : row * f + f] = now_as_well
            if not row % CORRECTION_STEPS:
                for rider in self._riders:
                    rider.correct()
        self.steps = max(self.steps, steps)
        fix = "Give its parameters less extreme values: what is heavy, slippery or stiff."
        check_physics(self._warnings, "simulated robot", where="Turtlebot3Parameters", fix=fix)

    def _keep(self, rows: list[Floats]) -> None:
        self._rows = rows
        # By memoryviews, as an assignment in NumPy takes twice as long, and this happens 57,000 times a run.
        pairs = zip(rows, self._traced, strict=True)
        self._copies = [(_flat(kept), len(now), _flat(now)) for kept, now in pairs]
        positions, velocities, forces = rows
        self.traces = [
            positions.reshape(len(positions), -1, _POSITIONS)[:, :, 7:9],
            velocities.reshape(len(velocities), -1, _VELOCITIES)[:, :, 6:8],
            forces.reshape(len(forces), -1, 2),
        ]

    @undivided
    def put_back(self, number: int) -> None:
        """Put a body back to where it settled at the beginning, and stop it; its wheels keep their angles."""
        place, speed = number * _POSITIONS, number * _VELOCITIES
        self._data.qpos[place : place + 7] = self._settled[place : place + 7]
        self._data.qvel[speed : speed + _VELOCITIES] = 0.0
        self._data.qacc_warmstart[speed : speed + _VELOCITIES] = 0.0
        self._data.act[2 * number : 2 * number + 2] = self._data.ctrl[2 * number : 2 * number + 2]
        mujoco.mj_forward(self._model, self._data)


class BodyState:
    """Views of one body's parts of MuJoCo's arrays.

    Attributes:
        pose: x, y, z (m) and the quaternion w, x, y, z.
        wheel_speeds: left and right, rad/s.
        set_points: of the motors, as commanded, rad/s.
        lagging: the set points with the motors' lag, rad/s.
        sensed: gyroscope (rad/s) and accelerometer (m/s²), three numbers each; valid after `Physics.sense`.
    """

    def __init__(self, data: mujoco.MjData, number: int) -> None:
        place, speed = number * _POSITIONS, number * _VELOCITIES
        motors = slice(2 * number, 2 * number + 2)
        self.pose: Floats = data.qpos[place : place + 7]
        self.wheel_speeds: Floats = data.qvel[speed + 6 : speed + 8]
        self.set_points: Floats = data.ctrl[motors]
        self.lagging: Floats = data.act[motors]
        self.sensed: Floats = data.sensordata[6 * number : 6 * number + 6]
