"""The services by which each simulator is reset and paused, and its robot placed."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from robot_runner.core.errors import LinkError, PluginError, did_you_mean
from robot_runner.core.links.graph_names import full_name, missing, namespace_prefix
from robot_runner.core.links.robot import Message, RobotLink

#: The place of a robot: x, y (m) and yaw (rad).
Spot = tuple[float, float, float]

_LOOK = 0.02
#: A graph that lists no service for so long, s, cannot list services.
_SILENT = 1.0


@dataclass(frozen=True, slots=True)
class Demand:
    """A call of a simulator's service.

    Attributes:
        services: the possible names, the likeliest first, relative to the robot's namespace unless they begin with `/`;
            if none exists, any other service in that namespace with the same last part is used.
        service_type: its type.
        request: the request.
        refusal: returns from a response why the call was refused; empty if it was done.
    """

    services: tuple[str, ...]
    service_type: str
    request: Mapping[str, Any]
    refusal: Callable[[Message], str]

    def meet(self, link: RobotLink, *, namespace: str, timeout: float) -> None:
        """Call the service; raise a `LinkError` if there is none, it is late, or the simulator refuses."""
        name = self._awaited(link, namespace, time.monotonic() + timeout)
        if refused := self.refusal(link.call(name, self.service_type, self.request, timeout=timeout)):
            problem = f"the simulator refuses the request: {refused}"
            raise LinkError(problem, where=name, fix="Look at the simulator's output.")

    def _awaited(self, link: RobotLink, namespace: str, deadline: float) -> str:
        silent_until = min(deadline, time.monotonic() + _SILENT)
        while True:
            try:
                return self._found(link, namespace)
            except LinkError:
                if time.monotonic() > silent_until and not link.services():  # a graph that cannot list services
                    return full_name(namespace, self.services[0])
                if time.monotonic() > deadline:
                    raise
                time.sleep(_LOOK)

    def _found(self, link: RobotLink, namespace: str) -> str:
        names = [full_name(namespace, each) for each in self.services]
        known = link.services()
        if there := [each for each in names if each in known]:
            return there[0]
        end, below = "/" + names[0].rpartition("/")[2], f"{namespace_prefix(namespace)}/"  # not another robot's
        alike = [
            name
            for name, kind in known.items()
            if name.startswith(below) and name.endswith(end) and kind in {self.service_type, "*"}
        ]
        if len(alike) == 1:
            return alike[0]
        fix = f"Start the simulator with the plugin or the bridge that offers it ({self.service_type})."
        raise missing("service", names[0], known, where="the simulator", fix=fix)


@dataclass(frozen=True, slots=True)
class Dialect:
    """The calls for one simulator; None where it has no documented service.

    Attributes:
        title: the simulator's name.
        pause, unpause: stop its time, or let it go on.
        reset_world: resets all poses; time goes on.
        reset_simulation: resets everything, time included.
        place: places the robot of this name.
        hint: what else must be running, and where that is documented.
    """

    title: str
    pause: Demand | None
    unpause: Demand | None
    reset_world: Demand | None
    reset_simulation: Demand | None
    place: Callable[[str, Spot], Demand] | None
    hint: str


def dialect_of(simulator: str, world: str) -> Dialect:
    """Return the dialect of a simulator, a key of `DIALECTS`; raise a `PluginError` if there is no such simulator.

    `world` is the world's name, or the prefix of its services, where these depend on it.
    """
    if simulator not in DIALECTS:
        fix = did_you_mean(str(simulator), DIALECTS)
        raise PluginError(f"{simulator!r} is not a simulator that is known", where="Simulation", fix=fix)
    return DIALECTS[simulator](world)


def _unless_true(key: str) -> Callable[[Message], str]:
    def refusal(response: Message) -> str:
        if response[key]:
            return ""
        return str(response.get("status_message") or f"{key} is false")

    return refusal


#: simulation_interfaces/Result: OK; SetSimulationState: ALREADY_IN_TARGET_STATE.
_ACCEPTED = {1, 101}


def _unless_accepted(response: Message) -> str:
    result = response["result"]
    if result["result"] in _ACCEPTED:
        return ""
    return result["error_message"] or f"result {result['result']}"


def _pose(spot: Spot) -> dict[str, Any]:
    x, y, yaw = spot
    return {"position": {"x": x, "y": y}, "orientation": {"z": math.sin(yaw / 2), "w": math.cos(yaw / 2)}}


def _by_empty(title: str, prefix: str, hint: str, place: Callable[[str, Spot], Demand] | None = None) -> Dialect:
    """Return a dialect of services with empty requests, below a prefix or in the namespace of the simulator's node."""

    def call(name: str) -> Demand:
        return Demand((f"{prefix}{name}", f"/{name}"), "std_srvs/Empty", {}, lambda _: "")

    pause, unpause = call("pause_physics"), call("unpause_physics")
    return Dialect(title, pause, unpause, call("reset_world"), call("reset_simulation"), place, hint)


def _model_in_gazebo_classic(robot: str, spot: Spot) -> Demand:
    state = {"model_name": robot, "pose": _pose(spot), "reference_frame": "world"}
    services = ("/gazebo/set_model_state",)
    return Demand(services, "gazebo_msgs/SetModelState", {"model_state": state}, _unless_true("success"))


def _entity_in_gazebo_classic(robot: str, spot: Spot) -> Demand:
    state = {"name": robot, "pose": _pose(spot), "reference_frame": "world"}
    services = ("/gazebo/set_entity_state", "/set_entity_state")
    return Demand(services, "gazebo_msgs/SetEntityState", {"state": state}, _unless_true("success"))


def _gazebo_classic(place: Callable[[str, Spot], Demand]) -> Dialect:
    # In ROS 1 the services are below /gazebo, in ROS 2 in the namespace of gazebo_ros' node.
    hint = "gazebo_ros; on ROS 2 placing a robot takes libgazebo_ros_state.so in the world"
    return _by_empty("Gazebo classic", "/gazebo/", hint, place)


def _gz(world: str) -> Dialect:
    def control(**fields: Any) -> Demand:
        names = (f"/world/{world}/control",)
        return Demand(names, "ros_gz_interfaces/ControlWorld", {"world_control": fields}, _unless_true("success"))

    def place(robot: str, spot: Spot) -> Demand:
        request = {"entity": {"name": robot, "type": 2}, "pose": _pose(spot)}  # ros_gz_interfaces/Entity: MODEL
        names = (f"/world/{world}/set_pose",)
        return Demand(names, "ros_gz_interfaces/SetEntityPose", request, _unless_true("success"))

    return Dialect(
        title="gz sim",
        pause=control(pause=True),
        unpause=control(pause=False),
        reset_world=control(reset={"model_only": True}),
        reset_simulation=control(reset={"all": True}),
        place=place,
        hint=f"ros_gz_bridge parameter_bridge /world/{world}/control@ros_gz_interfaces/srv/ControlWorld",
    )


def _standard(world: str) -> Dialect:
    prefix = world.rstrip("/")

    def state(number: int) -> Demand:
        names, request = (f"{prefix}/set_simulation_state",), {"state": {"state": number}}
        return Demand(names, "simulation_interfaces/SetSimulationState", request, _unless_accepted)

    def reset(scope: int) -> Demand:
        names, request = (f"{prefix}/reset_simulation",), {"scope": scope}
        return Demand(names, "simulation_interfaces/ResetSimulation", request, _unless_accepted)

    return Dialect(
        title="a simulator with simulation_interfaces",
        pause=state(2),  # SimulationState: PAUSED
        unpause=state(1),  # PLAYING
        reset_world=reset(2),  # ResetSimulation: SCOPE_STATE
        reset_simulation=reset(0),  # SCOPE_DEFAULT: all
        place=None,
        hint="the simulator's ROS 2 Simulation Interfaces (Isaac Sim: the extension isaacsim.ros2.sim_control)",
    )


def _webots(world: str) -> Dialect:
    prefix = world.rstrip("/")

    def mode(number: int) -> Demand:
        names = (f"{prefix}/supervisor/simulation_set_mode",)
        return Demand(names, "webots_ros/set_int", {"value": number}, _unless_true("success"))

    names = (f"{prefix}/supervisor/simulation_reset",)
    return Dialect(
        title="Webots",
        pause=mode(0),  # WB_SUPERVISOR_SIMULATION_MODE_PAUSE
        unpause=mode(1),  # WB_SUPERVISOR_SIMULATION_MODE_REAL_TIME
        reset_world=None,
        reset_simulation=Demand(names, "webots_ros/get_bool", {"ask": True}, _unless_true("value")),
        place=None,
        hint="a supervisor with Webots' controller `ros` (ROS 1); webots_ros2 offers no service to reset a world",
    )


#: By the name in a config. Sources of the services' names and types: docs/decisions/0059.
DIALECTS: Mapping[str, Callable[[str], Dialect]] = MappingProxyType(
    {
        "robot_runner": lambda _: _by_empty("robot-runner simulate", "", "robot-runner simulate turtlebot3"),
        "gazebo_classic": lambda _: _gazebo_classic(_model_in_gazebo_classic),
        "gazebo_classic_ros2": lambda _: _gazebo_classic(_entity_in_gazebo_classic),
        "gz": _gz,
        "webots": _webots,
        "isaac": _standard,
        "simulation_interfaces": _standard,
    }
)
