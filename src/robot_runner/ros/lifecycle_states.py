"""The system that brings managed nodes to a state for each run, and back to their former state."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, ClassVar

from robot_runner.core.errors import Finding, LinkError, PluginError
from robot_runner.core.links.graph_names import GraphNeed, full_name
from robot_runner.core.links.robot import RobotLink
from robot_runner.ros.lifecycle import SETTLED, bring_to, named_state, ros1_has_none, state_of
from robot_runner.ros.node_services import NodeNotReadyError
from robot_runner.ros.restored_settings import RestoredSettings

if TYPE_CHECKING:
    from robot_runner.core.plugin import Circumstances
    from robot_runner.ros.parameter_values import ParameterValue

#: The key of a node's state among its settings.
_STATE = "state"


class Lifecycle(RestoredSettings):
    """Brings managed nodes of ROS 2 to a state before each mission, in the order given, and back in the reverse one.

    Listed after `RosParameters`, it configures and activates a node with the parameters of the run.

    Args:
        states: `unconfigured`, `inactive` or `active`, by node; `treatment(...)` may stand for any.
        name: tells several instances apart; the class's name if left out.
        namespace: which robot, where there are several.
        patience: how long a node may take to appear on the graph before a run starts, s.
        timeout: how long each transition may take, s.

    Raises:
        PluginError: there are no states, a name is not valid, or there is no such state.

    Example:
        >>> Lifecycle({"/slam": "active"}).settings
        {'/slam': {'state': 'active'}}
    """

    needs: ClassVar[str] = "A robot on ROS 2 with managed nodes."
    kind = "states"

    def __init__(
        self,
        states: Mapping[str, str],
        *,
        name: str | None = None,
        namespace: str = "",
        patience: float = 5.0,
        timeout: float = 10.0,
    ) -> None:
        super().__init__({}, name=name, namespace=namespace, patience=patience, timeout=timeout)
        if not isinstance(states, Mapping) or not states:
            fix = "Give a state for each node, such as {'/slam': 'active'}."
            raise PluginError(f"states is {states!r}", where=self.name, fix=fix)
        try:
            for node in states:
                full_name(namespace, node)
            self.settings = {node: {_STATE: named_state(state, where=node).label} for node, state in states.items()}
        except LinkError as error:
            raise PluginError(f"{error.where}: {error.problem}", where=self.name, fix=error.fix) from error

    def check(self, circumstances: Circumstances) -> Iterable[Finding]:
        """Yield an error on ROS 1, whose nodes have no life cycle, and the findings for settings of all kinds."""
        yield from super().check(circumstances)
        if (circumstances.robot or "").partition(":")[0].strip() == "ros1":
            yield ros1_has_none(f"plugin {self.name}").as_finding()

    def required_graph(self, circumstances: Circumstances) -> Iterator[GraphNeed]:
        """Yield the services of the nodes' life cycles."""
        del circumstances
        for node in self.settings:
            yield GraphNeed.service(f"{node}/change_state", "lifecycle_msgs/ChangeState", fix="Start the node.")

    def read(self, link: RobotLink, node: str, names: Sequence[str]) -> Mapping[str, ParameterValue]:
        """Return the state of a node."""
        del names
        state = state_of(link, node, timeout=self.timeout)
        if state not in SETTLED:
            problem = f"the node is {state.label}, from where it cannot be brought to a state"
            raise NodeNotReadyError(problem, where=node, fix="Start the node again.")
        return {_STATE: state.label}

    def write(self, link: RobotLink, node: str, values: Mapping[str, ParameterValue]) -> None:
        """Bring a node to a state, by the transitions that lead there."""
        bring_to(link, node, str(values[_STATE]), timeout=self.timeout)
