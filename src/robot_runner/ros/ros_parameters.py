"""The system that sets parameters of nodes for each run, and restores the former values."""

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
    """Sets parameters of nodes before each mission, reads them back, and restores the former values.

    `parameters.json` in the folder of raw data has the values before, those that were set, and those of the node right
    afterwards and at the end. A run fails if its node has other values than those that were set; it is doubtful if
    somebody else has changed them meanwhile.

    Args:
        parameters: values by node and by name. Names of nodes are relative to the robot's namespace unless they begin
            with `/`; in ROS 1 `/` alone is for all nodes. `treatment(...)` may stand for any value.
        name: tells several instances apart; the class's name if left out.
        namespace: which robot, where there are several.
        patience: how long a node may take to appear on the graph before a run starts, s.
        timeout: of each answer of a node, s.

    Raises:
        PluginError: there are no parameters, a name is not valid, or no parameter can have a value.

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
        """Yield the nodes, with the values to be set; `/` of ROS 1 is not a node."""
        del circumstances
        for node, values in self.settings.items():
            if node != "/":
                yield GraphNeed.parameters(node, {name: to_json(value) for name, value in values.items()})

    def read(self, link: RobotLink, node: str, names: Sequence[str]) -> Mapping[str, ParameterValue]:
        """Return the values of parameters."""
        return parameters_of(link, timeout=self.timeout).values(node, names)

    def known(self, link: RobotLink, node: str, names: Sequence[str]) -> Sequence[str]:
        """Return which of these parameters the node still has; the server of ROS 1 takes any."""
        access = parameters_of(link, timeout=self.timeout)
        there = names if isinstance(access, ServerParameters) else access.names(node)
        return [name for name in names if name in there]

    def write(self, link: RobotLink, node: str, values: Mapping[str, ParameterValue]) -> None:
        """Set parameters."""
        parameters_of(link, timeout=self.timeout).change(node, values)

    def doubts(self, link: RobotLink, settings: Settings) -> Iterator[tuple[str, str]]:
        """Yield reasons why setting them may have no effect: in ROS 1 each node decides when it reads them."""
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
