"""The system that loads the room and the robot's model of each run's treatments into the embedded simulation."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, NamedTuple

from robot_runner.core.errors import Finding, LinkError
from robot_runner.core.events.context import RobotRunnerContext
from robot_runner.core.links.connect import is_simulated
from robot_runner.core.links.robot_name import RobotName
from robot_runner.core.plugin import Circumstances, System
from robot_runner.core.storage.input_files import InputFile, input_file
from robot_runner.ros.robot_system import RobotSystem
from robot_runner.simulator.embedded_robot import inputs_of, run_simulation, vain_parameters

if TYPE_CHECKING:
    from robot_runner.simulator.modelled_robot import RobotModel
    from robot_runner.simulator.rooms import Room

_OPTIONS = ("room", "model")


class _World(NamedTuple):
    room: Room | None
    model: RobotModel | None


class SimulatedWorld(System):
    """Loads a room and a robot's model into the embedded simulation; each may be bound to a factor.

    They are read before the run's process is forked, if it is, and checked with each treatment before the first run.
    List it before the systems that operate the robot, which is made when the first of them connects to it.

    Args:
        room: the TOML file of a room; None for the default room.
        model: the MJCF file of a robot; None for a TurtleBot3.
        folder: the base of relative paths, such as `Path(__file__).parent`; by default the folder in which the command
            is executed.
        left, right: the joints of the model's wheels, if their names do not contain left and right.
        name: distinguishes several instances; None for the class's name.

    Example:
        >>> from robot_runner.plugins import treatment
        >>> world = SimulatedWorld(room=treatment("Room"), folder="rooms")
    """

    needs: ClassVar[str] = "robot='simulated'."

    def __init__(
        self,
        room: Path | str | None = None,
        model: Path | str | None = None,
        *,
        folder: Path | str = "",
        left: str = "",
        right: str = "",
        name: str | None = None,
    ) -> None:
        super().__init__(name=name)
        self.folder = Path(folder)
        self._named = [None if each is None else self.folder / each for each in (room, model)]
        self.room, self.model = (None if each is None else input_file(each) for each in self._named)
        self.left, self.right = left, right
        self._loaded: _World | None = None

    def claims(self, robot: str | None) -> Iterable[str]:
        """Return no claims, as each run has its own simulation."""
        del robot
        return ()

    def input_files(self) -> Iterable[InputFile]:
        """Return the files of the room and of the model, including files that the model includes."""
        room, model = self._named
        return inputs_of(room, model)

    def check(self, circumstances: Circumstances) -> Iterable[Finding]:
        """Return errors of the files, and findings if they would have no effect."""
        where, robot = f"plugin {self.name}", circumstances.robot
        if not is_simulated(robot):
            problem = f"the room is for the embedded simulation, and robot is {robot!r}: nothing is loaded there"
            fix = "Start a simulator with this room (Program, RosLaunch), or build it. Or: --set robot=simulated."
            yield Finding.warning(where, problem, fix)
            return
        yield from self._named_twice(where, robot or "")
        if self.model is not None:
            yield from vain_parameters(RobotName.parse(robot or "").options, self.model, where=where)
        for each in circumstances.before(self):
            if isinstance(each, RobotSystem):
                problem = f"{each.name!r}, which is listed before it, makes the robot before the room is there"
                yield Finding.error(where, problem, f"List {self.name!r} before {each.name!r} in `plugins`.")
        try:
            self._world()
        except LinkError as error:
            yield from error.findings

    def before_run(self, context: RobotRunnerContext) -> None:
        """Read the files before the run is forked."""
        if is_simulated(context.robot):
            self._loaded = self._world()

    def start_run(self, context: RobotRunnerContext) -> None:
        """Load this room and this model into the run's simulation.

        Raises:
            LinkError: its robot was made already, or a file cannot be read.
        """
        if not is_simulated(context.robot):
            return
        world = self._loaded or self._world()
        run_simulation(context).furnish(world.room, world.model, where=f"plugin {self.name}")

    def _world(self) -> _World:
        return _read(self.room, self.model, self.left, self.right, _state(self.room), _state(self.model))

    def _named_twice(self, where: str, robot: str) -> Iterator[Finding]:
        options = RobotName.parse(robot).options
        for name in _OPTIONS:
            if name in options and getattr(self, name) is not None:
                problem = f"the {name} is named by the plugin and by robot = {robot!r}"
                yield Finding.error(where, problem, f"Leave {name}= out of one of them.")


def _state(path: Path | None) -> tuple[int, int] | None:
    """Return a value that differs between versions of a file; None if there is no file."""
    try:
        status = None if path is None else path.stat()
    except OSError:
        return None
    return status and (status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=16)
def _read(room: Path | None, model: Path | None, left: str, right: str, *_: tuple[int, int] | None) -> _World:
    from robot_runner.simulator.modelled_robot import RobotModel  # noqa: PLC0415  # it imports MuJoCo
    from robot_runner.simulator.room_file import read_room  # noqa: PLC0415  # it imports NumPy

    made = None if room is None else read_room(room)
    return _World(made, None if model is None else RobotModel(model, made, left=left, right=right))
