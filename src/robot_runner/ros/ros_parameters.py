"""The system that sets parameters of nodes for each run, and puts back what they were."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

from robot_runner.core.errors import LinkError, PluginError
from robot_runner.core.links.graph_names import GraphNeed, full_name
from robot_runner.core.links.robot import RobotLink
from robot_runner.ros.parameter_access import ServerParameters, parameters_of
from robot_runner.ros.parameter_values import ParameterValue, normal, to_json
from robot_runner.ros.restored_settings import RestoredSettings

if TYPE_CHECKING:
    from robot_runner.core.plugin import Circumstances
    from robot_runner.ros.kept_settings import Settings


class RosParameters(RestoredSettings):
    """Sets parameters of nodes before each mission, reads back what the nodes have, and puts back what was there.

    What was there before, what was set, what the node had then and at the end is in `parameters.json`, in its folder of
    raw data. A run whose node does not have what was set fails; one in which somebody else has changed it is doubtful.

    Args:
        parameters: values by node and by name. Names of nodes are relative to the robot's namespace unless they begin
            with `/`; in ROS 1 `/` alone is what is set for all nodes. `treatment(...)` may stand for any value.
        name: tells several instances apart; the class's name if left out.
        namespace: which robot, where there are several.
        patience: how long a node may take to appear on the graph before a run starts, s.
        timeout: how long each answer of a node may take, s.

    Raises:
        PluginError: there are no parameters, a name cannot be one, or no parameter can have a value.

    Example:
        >>> RosParameters({"/controller_server": {"FollowPath.max_vel_x": 0.22}}).settings
        {'/controller_server': {'FollowPath.max_vel_x': 0.22}}
    """

    needs: ClassVar[str] = "A robot on ROS whose nodes have parameters."
    kind = "parameters"

    def __init__(
        self,
        parameters: Mapping[str, Mapping[str, Any]],
        *,
        name: str | None = None,
        namespace: str = "",
        patience: float = 5.0,
        timeout: float = 5.0,
    ) -> None:
        super().__init__({}, name=name, namespace=namespace, patience=patience, timeout=timeout)
        if not isinstance(parameters, Mapping) or not parameters:
            raise PluginError(f"parameters is {parameters!r}", where=self.name, fix=_FIX)
        self.settings = {node: self._checked(node, values) for node, values in parameters.items()}

    def required_graph(self, circumstances: Circumstances) -> Iterator[GraphNeed]:
        """Yield the nodes, with the values that they are to have; `/` of ROS 1 is no node."""
        del circumstances
        for node, values in self.settings.items():
            if node != "/":
                yield GraphNeed.parameters(node, {name: to_json(value) for name, value in values.items()})

    def read(self, link: RobotLink, node: str, names: Sequence[str]) -> Mapping[str, ParameterValue]:
        """Return the values of parameters."""
        return parameters_of(link, timeout=self.timeout).values(node, names)

    def write(self, link: RobotLink, node: str, values: Mapping[str, ParameterValue]) -> None:
        """Set parameters."""
        parameters_of(link, timeout=self.timeout).change(node, values)

    def doubts(self, link: RobotLink, settings: Settings) -> Iterator[tuple[str, str]]:
        """Yield what may make it vain to set them: in ROS 1 a node reads them when it likes."""
        access = parameters_of(link, timeout=self.timeout)
        if isinstance(access, ServerParameters):
            for node, values in settings.items():
                yield from access.doubts(node, list(values))

    def _checked(self, node: str, values: object) -> dict[str, ParameterValue]:
        if not isinstance(values, Mapping) or not values or not all(isinstance(name, str) and name for name in values):
            raise PluginError(f"the parameters of {node!r} are {values!r}", where=self.name, fix=_FIX)
        for name, value in values.items():
            if isinstance(value, Mapping):
                inner = next(iter(value), "...")
                problem = f"{name} of {node!r} is {value!r}"
                fix = f"Write the whole name of each: '{name}.{inner}' (in ROS 1 '{name}/{inner}')."
                raise PluginError(problem, where=self.name, fix=fix)
        try:
            if node != "/":
                full_name(self.namespace, node)
            return {name: normal(value, where=f"{node}: {name}") for name, value in values.items()}
        except LinkError as error:
            raise PluginError(f"{error.where}: {error.problem}", where=self.name, fix=error.fix) from error


_FIX = "Give values by node and by name, such as {'/planner': {'speed': 0.2}}."
