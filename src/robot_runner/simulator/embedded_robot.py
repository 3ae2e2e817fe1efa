"""The kind of link `simulated`, to the embedded robot: announced by an entry point, and imported quickly."""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, fields
from math import inf
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from robot_runner.core.errors import Finding, LinkError, did_you_mean
from robot_runner.core.events.context import Clock, RobotRunnerContext
from robot_runner.core.links.robot import RobotLink
from robot_runner.core.links.robot_name import RobotName
from robot_runner.core.storage.input_files import InputFile, input_file
from robot_runner.core.words import enumerated

if TYPE_CHECKING:
    from robot_runner.core.events.resources import Resources
    from robot_runner.measuring.host import HostLink
    from robot_runner.measuring.serial_line import SerialLine
    from robot_runner.simulator.modelled_robot import RobotModel
    from robot_runner.simulator.rooms import Room
    from robot_runner.simulator.simulated_turtlebot3 import Simulation
    from robot_runner.simulator.turtlebot3_parameters import Turtlebot3Parameters

_WHERE = "robot"
_NAME = "simulated"
_PACKAGES = ("mujoco", "numpy")
_SIMULATION = "robot_runner.simulator.simulated_turtlebot3"  # imports MuJoCo
#: The imports of a run on the robot; NumPy loads two of its own parts only at their first use.
_MODULES = (
    _SIMULATION,
    "robot_runner.simulator.room_file",
    "robot_runner.simulator.simulated_devices",
    "robot_runner.simulator.simulated_link",
    "numpy.ma",
    "numpy.random",
)
_REAL_TIME_FACTOR = "real_time_factor"
_ROOM = "room"
_MODEL = "model"
#: The options for the joints of a model's wheels, if their names do not contain left and right.
_WHEELS = ("left", "right")


class _EmbeddedRobot:
    """The kind of link `simulated`. MuJoCo is imported only when a link is opened."""

    description = "the embedded TurtleBot3 Burger: a physics simulation with a clock of its own"
    takes_address = False
    is_simulated = True
    #: The command topics of a TurtleBot3, and of a model with driven joints, with their types; a model may have either.
    command_topics = MappingProxyType({"cmd_vel": "geometry_msgs/Twist", "joint_commands": "sensor_msgs/JointState"})

    def findings(self, name: RobotName) -> list[Finding]:
        if missing := [package for package in _PACKAGES if importlib.util.find_spec(package) is None]:
            return [_not_installed(missing).as_finding()]
        if not name.options:  # checking options imports NumPy
            return []
        try:
            simulation_options(name.options)
        except LinkError as error:
            return list(error.findings) or [error.as_finding()]
        return []

    def input_files(self, name: RobotName) -> Iterable[InputFile]:
        return inputs_of(*(Path(name.options[each]) if each in name.options else None for each in (_ROOM, _MODEL)))

    def preload(self, name: RobotName) -> None:
        """Import MuJoCo and all other modules that each run of a simulated robot would import; nothing is opened."""
        del name
        for module in _MODULES:
            importlib.import_module(module)

    def open_robot(
        self, name: RobotName, *, resources: Resources, clock: Clock, seed: int, namespace: str
    ) -> RobotLink:
        del clock
        simulation = _simulation(name, resources, seed)
        from robot_runner.simulator.simulated_link import SimulatedRobotLink  # noqa: PLC0415  # it imports MuJoCo

        return SimulatedRobotLink(simulation, namespace=namespace)

    def open_clock(self, name: RobotName, *, resources: Resources, seed: int) -> Clock:
        return _simulation(name, resources, seed).clock

    def open_serial_line(self, name: RobotName, *, resources: Resources, seed: int, namespace: str) -> SerialLine:
        simulation = _simulation(name, resources, seed)
        from robot_runner.simulator.simulated_devices import SimulatedSerialLine  # noqa: PLC0415  # it imports MuJoCo

        return SimulatedSerialLine(simulation, namespace=namespace)

    def open_host(self, name: RobotName, *, resources: Resources, seed: int, namespace: str) -> HostLink:
        simulation = _simulation(name, resources, seed)
        from robot_runner.simulator.simulated_devices import SimulatedHost  # noqa: PLC0415  # it imports MuJoCo

        return SimulatedHost(simulation, namespace=namespace)


#: The object of the entry point `simulated`.
EMBEDDED_ROBOT = _EmbeddedRobot()


def inputs_of(room: Path | None, model: Path | None) -> list[InputFile]:
    """Return the files of a room and a model, with the files that it includes: other models, meshes, textures."""
    found = [] if room is None else [InputFile(room)]
    if model is not None:
        from robot_runner.simulator.mjcf_interface import parts_of_model  # noqa: PLC0415  # it imports MuJoCo

        found.append(InputFile(model, parts_of_model(input_file(model))))
    return found


def run_simulation(context: RobotRunnerContext) -> Simulation:
    """Return the simulation of a run with the embedded robot.

    Raises:
        LinkError: a package is missing, or an option of the robot is invalid.
    """
    return _simulation(RobotName.parse(context.robot or _NAME), context.resources, context.run_seed)


def _simulation(name: RobotName, resources: Resources, seed: int) -> Simulation:
    """Return the run's one simulation, opened at the first call."""

    def opener() -> Simulation:
        try:
            importlib.import_module(_SIMULATION)
        except ModuleNotFoundError as error:
            raise _not_installed([error.name or "mujoco"]) from error
        return simulation_options(name.options).simulation(seed)

    return resources.open("simulation", opener)


def _not_installed(missing: list[str]) -> LinkError:
    fix = "Install the simulator: pip install 'robot-runner[sim]'."
    return LinkError(f"robot is {_NAME!r}, but {enumerated(missing)} cannot be imported", where=_WHERE, fix=fix)


def vain_parameters(options: Iterable[str], model: Path, *, where: str) -> Iterator[Finding]:
    """Yield a warning if the robot is from a model, and options are parameters of the TurtleBot3 alone."""
    from robot_runner.simulator.turtlebot3_parameters import (  # noqa: PLC0415  # it imports NumPy
        SENSOR_PARAMETERS,
        Turtlebot3Parameters,
    )

    own = {each.name for each in fields(Turtlebot3Parameters)} - SENSOR_PARAMETERS
    if vain := sorted(own & set(options)):
        problem = f"{enumerated(vain)} would have no effect on the robot of {model.name}"
        yield Finding.warning(where, problem, "Leave it out of robot, and put it into the model if it is a part of it.")


@dataclass(frozen=True, slots=True)
class SimulationOptions:
    """The options of the simulation and its robots in `robot = "simulated:name=value,..."`.

    `real_time_factor` is simulated seconds a real second; None for as fast as the physics goes. Without a `model` they
    are TurtleBot3s.
    """

    parameters: Turtlebot3Parameters
    real_time_factor: float | None
    room: Room
    model: RobotModel | None = None

    def simulation(self, seed: int) -> Simulation:
        """Return a simulation of this kind, at its beginning."""
        from robot_runner.simulator.simulated_turtlebot3 import Simulation  # noqa: PLC0415  # it imports MuJoCo

        pace = self.real_time_factor
        return Simulation(seed, parameters=self.parameters, room=self.room, model=self.model, real_time_factor=pace)


def simulation_options(options: Mapping[str, str]) -> SimulationOptions:
    """Parse the options of a simulated robot.

    Example:
        >>> simulation_options({"initial_charge": "40", "real_time_factor": "1"}).real_time_factor
        1.0

    Raises:
        LinkError: there is no such parameter, its value is invalid, or the room's file describes no room.
    """
    from robot_runner.simulator.room_file import read_room  # noqa: PLC0415  # it imports NumPy
    from robot_runner.simulator.rooms import DEFAULT_ROOM  # noqa: PLC0415
    from robot_runner.simulator.turtlebot3_parameters import Turtlebot3Parameters  # noqa: PLC0415  # it imports NumPy

    kinds: dict[str, type] = {each.name: int if each.type == "int" else float for each in fields(Turtlebot3Parameters)}
    kinds[_REAL_TIME_FACTOR] = float
    kinds[_ROOM] = kinds[_MODEL] = Path
    kinds |= dict.fromkeys(_WHEELS, str)
    values: dict[str, Any] = {}
    for name, text in options.items():
        if name not in kinds:
            fix = did_you_mean(name, kinds)
            raise LinkError(f"the simulated robot has no parameter {name!r}", where=_WHERE, fix=fix)
        try:
            values[name] = kinds[name](text)
        except ValueError as error:
            kind = "a whole number" if kinds[name] is int else "a number"
            problem = f"the simulated robot's {name} is {text!r}, which is not {kind}"
            raise LinkError(problem, where=_WHERE, fix=f"Give {kind}, as in {name}=1.") from error
    pace = values.pop(_REAL_TIME_FACTOR, None)
    if pace is not None and not 0 < pace < inf:
        problem = f"the simulated robot's {_REAL_TIME_FACTOR} is {pace:g}, which no clock can keep"
        raise LinkError(problem, where=_WHERE, fix="Give 1 for real time, 2 for twice as fast.")
    room = read_room(input_file(values.pop(_ROOM))) if _ROOM in values else None
    model = _model(values, room)
    return SimulationOptions(Turtlebot3Parameters(**values), pace, room or DEFAULT_ROOM, model)


def _model(values: dict[str, Any], room: Room | None) -> RobotModel | None:
    """Take a model and its wheels out of the options, and read it."""
    wheels = {side: values.pop(side) for side in _WHEELS if side in values}
    if (path := values.pop(_MODEL, None)) is not None:
        for vain in vain_parameters(values, path, where=_WHERE):
            raise LinkError(vain.problem, where=vain.where, fix=vain.fix)
        from robot_runner.simulator.modelled_robot import RobotModel  # noqa: PLC0415  # it imports MuJoCo

        return RobotModel(input_file(path), room, **wheels)
    if wheels:
        problem = f"{', '.join(wheels)} names the joint of a wheel, and no model is named"
        raise LinkError(problem, where=_WHERE, fix="Name the MJCF file: model=robot.xml.")
    return None
