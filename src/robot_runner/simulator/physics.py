"""One world of MuJoCo with one or several robots in it, advanced in steps of the simulation's grid."""

from __future__ import annotations

import logging
from operator import itemgetter
from typing import TYPE_CHECKING, Protocol

import mujoco
import numpy as np

from robot_runner.core.errors import LinkError
from robot_runner.simulator.model import Body, holding_torque, world_model
from robot_runner.simulator.rooms import ARENA

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy.typing as npt

    from robot_runner.simulator.rooms import Obstacle
    from robot_runner.simulator.turtlebot3_parameters import Turtlebot3Parameters

    Floats = npt.NDArray[np.float64]

_SETTLING_STEPS = 200
_Warning = mujoco.mjtWarning
#: What MuJoCo notes where a number became too large or none, before it begins anew by itself.
_diverged = itemgetter(*map(int, (_Warning.mjWARN_BADQPOS, _Warning.mjWARN_BADQVEL, _Warning.mjWARN_BADQACC)))
#: What it notes where contacts have no room in its memory, before it goes on without them.
_overflown = itemgetter(*map(int, (_Warning.mjWARN_CONTACTFULL, _Warning.mjWARN_CNSTRFULL)))
MORE_MEMORY = 'Give it more memory, as in <size memory="100M"/>, or fewer things that touch each other.'
#: How many numbers a robot has in MuJoCo's arrays: seven of its pose (six of its velocity) and two of its wheels.
_POSITIONS, _VELOCITIES = 9, 8


if mujoco.get_mju_user_warning() is None:
    # Else MuJoCo writes a file of its own, MUJOCO_LOG.TXT, into the folder in which somebody works.
    mujoco.set_mju_user_warning(logging.getLogger(__name__).warning)


def check_physics(warnings: npt.NDArray[np.int32], what: str, *, where: str, fix: str) -> None:
    """See that the physics of something is true so far.

    Args:
        warnings: how often MuJoCo noted each (a view of its `data.warning.number`: looked up each time, it costs more).
        what: has it.
        where: to mend it.
        fix: what to do where it diverged.

    Raises:
        LinkError: it diverged, and MuJoCo went on from the beginning as if nothing had been; or it left contacts out.
    """
    counts = warnings.tolist()
    if any(_overflown(counts)):
        problem = f"MuJoCo's memory is too small for all contacts of the {what}: some had no effect"
        raise LinkError(problem, where=where, fix=MORE_MEMORY)
    if any(_diverged(counts)):
        problem = f"the physics of the {what} diverged, and MuJoCo put the robot back to its beginning"
        raise LinkError(problem, where=where, fix=fix)


class Rider(Protocol):
    """What follows a body from step to step."""

    def note(self, row: int) -> None:
        """Note the state after so many steps."""
        ...


class Physics:
    """The bodies of a world; all of them are always at the same step.

    Attributes:
        steps: how many steps were made since the beginning.
    """

    def __init__(
        self, parameters: Turtlebot3Parameters, bodies: Sequence[Body], obstacles: Sequence[Obstacle] = ARENA
    ) -> None:
        self._model = mujoco.MjModel.from_xml_string(world_model(parameters, bodies, obstacles))
        self._data = mujoco.MjData(self._model)
        self._warnings = self._data.warning.number
        self._riders: list[Rider] = []
        # On a slope the motors hold their robot from the beginning on.
        self._data.act[:] = self._data.ctrl[:] = holding_torque(parameters) / parameters.servo_gain
        self.steps = 0
        mujoco.mj_step(self._model, self._data, nstep=_SETTLING_STEPS)
        self._settled = np.array(self._data.qpos)

    @property
    def parts(self) -> tuple[mujoco.MjModel, mujoco.MjData]:
        """Its model and its state, for pictures."""
        return self._model, self._data

    def ride(self, rider: Rider) -> None:
        """Have a rider note each step from now on."""
        self._riders.append(rider)

    def body(self, number: int) -> BodyState:
        """Return the state of a body, which changes with each step."""
        return BodyState(self._data, number)

    def advance(self, steps: int) -> None:
        """Go on until this many steps were made since the beginning; those already made are not repeated.

        Raises:
            LinkError: the physics went wrong.
        """
        model, data, riders = self._model, self._data, self._riders
        for row in range(self.steps + 1, steps + 1):
            mujoco.mj_step(model, data)
            for rider in riders:
                rider.note(row)
        self.steps = max(self.steps, steps)
        fix = "Give its parameters less extreme values: what is heavy, slippery or stiff."
        check_physics(self._warnings, "simulated robot", where="Turtlebot3Parameters", fix=fix)

    def put_back(self, number: int) -> None:
        """Put a body back where it settled at the beginning, and stop it; its wheels keep their angles."""
        place, speed = number * _POSITIONS, number * _VELOCITIES
        self._data.qpos[place : place + 7] = self._settled[place : place + 7]
        self._data.qvel[speed : speed + _VELOCITIES] = 0.0
        self._data.qacc_warmstart[speed : speed + _VELOCITIES] = 0.0
        self._data.act[2 * number : 2 * number + 2] = self._data.ctrl[2 * number : 2 * number + 2]
        mujoco.mj_forward(self._model, self._data)


class BodyState:
    """Views of one body's part of MuJoCo's arrays.

    Attributes:
        pose: x, y, z (m) and the quaternion w, x, y, z.
        wheel_angles, wheel_speeds: left and right, rad and rad/s.
        set_points: of the motors, as commanded, rad/s.
        lagging: the set points as the motors follow them, rad/s.
        torques: of the motors, N m.
        sensed: gyroscope (rad/s) and accelerometer (m/s²), three numbers each.
    """

    def __init__(self, data: mujoco.MjData, number: int) -> None:
        place, speed = number * _POSITIONS, number * _VELOCITIES
        motors = slice(2 * number, 2 * number + 2)
        self.pose: Floats = data.qpos[place : place + 7]
        self.wheel_angles: Floats = data.qpos[place + 7 : place + 9]
        self.wheel_speeds: Floats = data.qvel[speed + 6 : speed + 8]
        self.set_points: Floats = data.ctrl[motors]
        self.lagging: Floats = data.act[motors]
        self.torques: Floats = data.actuator_force[motors]
        self.sensed: Floats = data.sensordata[6 * number : 6 * number + 6]
