"""One simulated TurtleBot3 Burger: topics, services, power meter, on-board computer, and its true state."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, TypeAlias

from robot_runner.core.errors import LinkError, did_you_mean
from robot_runner.core.events.early_end import undivided
from robot_runner.simulator.camera import Camera, camera_topics
from robot_runner.simulator.drive import DifferentialDrive, WheelOdometry
from robot_runner.simulator.model import Body
from robot_runner.simulator.onboard import OnboardComputer, Task, TaskRunner
from robot_runner.simulator.physics import Physics
from robot_runner.simulator.power_meter import Ina219Meter
from robot_runner.simulator.rooms import DEFAULT_ROOM, Obstacle, Pose, Room
from robot_runner.simulator.sensors import RAYS, SensorBoard, body_outline, published_topics, seen_by_scanner
from robot_runner.simulator.simulated_clock import SimulatedClock
from robot_runner.simulator.supply import Battery, CutOff, PowerModel, PowerSupply, ProtectedDrive
from robot_runner.simulator.turtlebot3_parameters import NoiseStreams, Turtlebot3Parameters

if TYPE_CHECKING:
    from robot_runner.measuring.host import UtilisationSample
    from robot_runner.simulator.modelled_robot import ModelledRobot, RobotModel
    from robot_runner.simulator.physics_library import mujoco
    from robot_runner.simulator.simulated_actions import SimulatedAction

    SimulatedRobot: TypeAlias = "SimulatedTurtlebot3 | ModelledRobot"

#: The topics that the robot subscribes to, with their types.
COMMAND_TOPICS = {"cmd_vel": "geometry_msgs/Twist"}

#: The services that the robot offers, with their types.
SERVICES = {
    "task/stop": "std_srvs/Trigger",
    **{f"task/{task.value}/{verb}": "std_srvs/Trigger" for task in Task for verb in ("start", "stop")},
}


class _World:
    """The room and the physics of one or more robots; a single robot has its own."""

    def __init__(self, room: Room, parameters: Turtlebot3Parameters, seed: int, namespaces: Sequence[str]) -> None:
        radii = [_wheel_radii(parameters, NoiseStreams(seed, each)) for each in namespaces]
        names = namespaces if len(namespaces) > 1 else [""]
        starts = [room.start(each) for each in namespaces]
        bodies = [Body(*each) for each in zip(radii, starts, names, strict=True)]
        self.physics = Physics(parameters, bodies, room.obstacles)
        self.numbers = {namespace: number for number, namespace in enumerate(namespaces)}
        self.protected: list[ProtectedDrive] = []
        self._drives: dict[str, DifferentialDrive] = {}
        self._walls = seen_by_scanner(room.obstacles)
        self._parameters = parameters

    def drive(self, namespace: str) -> DifferentialDrive:
        made = self._drives[namespace] = DifferentialDrive(self._parameters, self.physics, self.numbers[namespace])
        return made

    def surroundings(self, namespace: str) -> Sequence[Obstacle]:
        """Return the obstacles for the scanner of the robot of this namespace: walls and other robots."""
        others = [body_outline(self._parameters, each.pose) for own, each in self._drives.items() if own != namespace]
        return (*self._walls, *seen_by_scanner(others))


class SimulatedTurtlebot3:
    """A robot in its own copy of the room, or in one with others.

    Physics and power are computed on demand, up to the clock's time, and each step once.

    Attributes:
        namespace: its name in the simulation: empty, or `/alice`.
        parameters: its parameters.
        topics: the topics that it publishes, by name within its namespace.
        command_topics, services: those that it subscribes to and offers, with their types.

    Example:
        >>> from robot_runner.simulator.simulated_turtlebot3 import Simulation
        >>> simulation = Simulation(seed=1)
        >>> robot = simulation.turtlebot3()
        >>> robot.drive(0.2, 0.0)
        >>> simulation.clock.sleep(5.0)
        >>> round(robot.pose.x, 1), robot.is_moving
        (1.0, True)
        >>> simulation.close()
    """

    command_topics: Mapping[str, str] = MappingProxyType(COMMAND_TOPICS)
    services: Mapping[str, str] = MappingProxyType(SERVICES)

    def __init__(
        self, namespace: str, clock: SimulatedClock, seed: int, parameters: Turtlebot3Parameters, world: _World
    ) -> None:
        streams = NoiseStreams(seed, namespace)
        self.namespace = namespace
        self.parameters = parameters
        self._clock = clock
        self._tasks = TaskRunner(streams.named("tasks"), deviation=parameters.task_power_deviation)
        self._drive = world.drive(namespace)
        model = PowerModel(parameters, self._drive, self._tasks, streams)
        self._supply = PowerSupply(model, Battery(parameters), shunt=parameters.meter_shunt)
        self._powered = ProtectedDrive(parameters, self._drive, model, self._supply, world.protected)
        self._computer = OnboardComputer(parameters, self._drive, self._tasks, streams)
        self._meter_noise = streams.numbered("ina219", width=2)
        left, right = streams.named("encoders").random(2).tolist()
        self._wheels = WheelOdometry(parameters, self._drive, (left, right))
        board = SensorBoard(
            parameters,
            clock,
            self._drive,
            self._powered,
            self._wheels,
            self._supply,
            partial(world.surroundings, namespace),
            streams.numbered("imu", width=6),
            streams.numbered("scan", width=RAYS),
        )
        camera = Camera(partial(self._seen, world.physics), world.numbers[namespace], parameters, is_painted=True)
        self.topics = published_topics(board) | camera_topics(clock, camera, parameters.camera_rate)

    @property
    def pose(self) -> Pose:
        """The true pose."""
        self._powered.reach(self._clock.step)
        return self._drive.pose

    @property
    def is_moving(self) -> bool:
        """Whether a wheel turns."""
        self._powered.reach(self._clock.step)
        return self._drive.is_moving

    @property
    def running_task(self) -> Task | None:
        """The task that the on-board computer executes, if any."""
        return self._tasks.running

    @property
    def cut_off(self) -> CutOff | None:
        """The moment when low battery voltage switched its motors off; None if they are on."""
        self._powered.reach(self._clock.step)
        return self._powered.cut_off

    @property
    def energy(self) -> float:
        """The true energy in joules that the robot has drawn since the beginning of the simulation."""
        self._powered.extend(self._clock.step)
        return float(self._supply.energy[-1])

    def drive(self, linear: float, angular: float) -> None:
        """Drive at these velocities (m/s, rad/s), within the robot's limits, until the next command.

        Raises:
            LinkError: one of them is not a number.
        """
        if math.isnan(linear + angular):
            problem = f"the robot is told to drive at {linear:g} m/s and {angular:g} rad/s"
            raise LinkError(problem, where=f"robot {self.namespace or '/'}", fix="Give two numbers.")
        self._powered.reach(self._clock.step)
        self._powered.command(linear, angular)

    def command(self, topic: str, message: Mapping[str, Any]) -> None:
        """Execute a message of one of its `command_topics`."""
        del topic  # there is only one
        self.drive(float(message["linear"]["x"]), float(message["angular"]["z"]))

    @undivided
    def put_back(self) -> None:
        """Put the robot back to its start, with its odometry at zero; its battery and its task go on."""
        self._powered.reach(self._clock.step)
        self._drive.put_back()
        self._wheels.restart()

    @undivided
    def call(self, service: str) -> dict[str, bool | str]:
        """Call one of `SERVICES` and return its response: `success` and `message`."""
        _, *name, verb = service.split("/")
        if not name:
            return _response(stopped=self._tasks.stop(step=self._next_step))
        return self._start(Task(name[0])) if verb == "start" else self._stop(Task(name[0]))

    def open_power_meter(self) -> Ina219Meter:
        """Switch the power meter on and return it."""
        extend = self._powered.extend
        return Ina219Meter(self.parameters, self._clock, self._supply, reach=extend, noise=self._meter_noise)

    def utilisation(
        self, *, start_ns: int, stop_ns: int, rate: float, also_ns: Sequence[int] = ()
    ) -> list[UtilisationSample]:
        """Return the on-board computer's samples, `rate` a second (200 at most), between two past moments.

        The moments `also_ns` are sampled, too.
        """
        self._powered.reach(self._clock.step)
        return self._computer.samples(start_ns=start_ns, stop_ns=stop_ns, rate=rate, also_ns=also_ns)

    @property
    def _next_step(self) -> int:
        # A change now has its effect from the next step on, as this one's power may have been read already.
        return self._clock.step + 1

    def _seen(self, physics: Physics) -> tuple[mujoco.MjModel, mujoco.MjData]:
        self._powered.reach(self._clock.step)
        return physics.parts

    def _start(self, task: Task) -> dict[str, bool | str]:
        if self._tasks.start(task, step=self._next_step):
            return {"success": True, "message": f"{task.value} started"}
        running = self._tasks.running
        return {"success": False, "message": f"{running.value if running else 'a task'} is running already"}

    def _stop(self, task: Task) -> dict[str, bool | str]:
        if self._tasks.running is not task:
            return {"success": False, "message": f"{task.value} is not running"}
        return _response(stopped=self._tasks.stop(step=self._next_step))


def _response(*, stopped: Task | None) -> dict[str, bool | str]:
    return {"success": True, "message": f"{stopped.value} stopped" if stopped else "nothing was running"}


def _wheel_radii(parameters: Turtlebot3Parameters, streams: NoiseStreams) -> tuple[float, float]:
    noise = parameters.wheel_radius_deviation * streams.named("wheels").standard_normal(2)
    left, right = (parameters.wheel_radius + noise).tolist()
    return left, right


class Simulation:
    """Robots by namespace on one clock, deterministic for a seed.

    Each robot drives in its own copy of the room and neither sees nor touches others, unless the room has the starts of
    two or more robots: those are in one world.

    Attributes:
        clock: advances only during sleeps on it.
        parameters: of its robots.
        room: of its robots.
        model: of its robots; None for TurtleBot3s.
        real_time_factor: simulated seconds a real second; None for as fast as the physics goes.
        offers: the services that others than the robots offer, by full name: their types and callbacks.
        actions: the offered actions, by full name.
        command_subscribers: the callbacks that take the commands of each topic, by the topic's full name.

    Example:
        >>> simulation = Simulation(seed=1)
        >>> simulation.turtlebot3("/alice") is simulation.turtlebot3("alice")
        True
        >>> simulation.close()
    """

    def __init__(
        self,
        seed: int,
        *,
        parameters: Turtlebot3Parameters | None = None,
        room: Room = DEFAULT_ROOM,
        model: RobotModel | None = None,
        real_time_factor: float | None = None,
    ) -> None:
        self.clock = SimulatedClock(real_time_factor)
        self.parameters = parameters or Turtlebot3Parameters()
        self.room = room
        self.model = model
        self._seed = seed
        self.offers: dict[str, tuple[str, Callable[[Mapping[str, Any]], Mapping[str, Any]]]] = {}
        self.actions: dict[str, SimulatedAction] = {}
        self.command_subscribers: dict[str, dict[object, Callable[[Mapping[str, Any]], None]]] = {}
        self._robots: dict[str, SimulatedRobot] = {}
        self._is_closed = False

    @property
    def robots(self) -> Mapping[str, SimulatedRobot]:
        """The robots that were made so far, by namespace: empty, or `/alice`."""
        return MappingProxyType(self._robots)

    def turtlebot3(self, namespace: str = "") -> SimulatedTurtlebot3:
        """Return the TurtleBot3 of this namespace, as `robot` does.

        Raises:
            LinkError: as for `robot`, or the simulation's robots are not TurtleBot3s.
        """
        found = self.robot(namespace)
        if isinstance(found, SimulatedTurtlebot3):
            return found
        problem = f"the simulated robot is that of {found.path.name}, which has no power meter and no on-board computer"
        fix = "Leave out what measures its power or its computer, or leave out model=."
        raise LinkError(problem, where=f"robot {namespace!r}", fix=fix)

    def robot(self, namespace: str = "") -> SimulatedRobot:
        """Return the robot of this namespace, which is made by the first call.

        Raises:
            LinkError: the simulation was closed, or its room has starts of robots, but none of this one.
        """
        if self._is_closed:
            fix = "Connect to the robot within the run."
            raise LinkError("the simulation was closed", where=f"robot {namespace!r}", fix=fix)
        name = namespace.strip("/")
        full = f"/{name}" if name else ""
        if full not in self._robots:
            self._check_room(full)
            self._make(tuple(self.room.robots) if self.room.is_shared and self.model is None else (full,))
        return self._robots[full]

    def furnish(self, room: Room | None, model: RobotModel | None, *, where: str) -> None:
        """Change the room or the model of its robots; None leaves either as it is.

        Raises:
            LinkError: a robot was made already, or the model cannot be read again with its room.
        """
        if self._robots:
            fix = "List what loads the room before all systems that operate the robot."
            raise LinkError("the robot was made before its room was loaded", where=where, fix=fix)
        self.room, self.model = room or self.room, model or self.model
        # One of them is this plugin's, and the other is from the robot's name or from another plugin.
        if self.model is not None and self.room is not DEFAULT_ROOM and self.model.room is not self.room:
            self.model = self.model.within(self.room)

    def _make(self, namespaces: Sequence[str]) -> None:
        if self.model is not None:
            from robot_runner.simulator.modelled_robot import ModelledRobot  # noqa: PLC0415  # only where asked for

            made = ModelledRobot(namespaces[0], self.clock, self._seed, self.parameters, self.model)
            self._robots[namespaces[0]] = made
            return
        world = _World(self.room, self.parameters, self._seed, namespaces)
        for each in namespaces:
            self._robots[each] = SimulatedTurtlebot3(each, self.clock, self._seed, self.parameters, world)

    def _check_room(self, namespace: str) -> None:
        declared = () if self.model is not None else self.room.robots
        if declared and namespace not in declared:
            fix = did_you_mean(namespace, declared) + " Or say in the room's file where it starts: [[robot]]."
            raise LinkError(f"no robot {namespace or '/'!r} starts in the room", where="the simulation", fix=fix)

    def close(self) -> None:
        """Release all robots; closing twice does nothing. The clock can still be used."""
        self._is_closed = True
        self._robots.clear()
        self.offers.clear()
        self.command_subscribers.clear()
