"""A node of ROS 2 with parameters and a life cycle, for tests: it answers as rclcpp or rclpy does, over any link."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

from robot_runner.core.links.robot import Message, Offerer
from robot_runner.ros.lifecycle import LifecycleState
from robot_runner.ros.parameter_values import ParameterKind, ParameterValue, as_wire, from_wire, kind_of


class _ServingNode:
    """A node that offers services of one package, below its name, until it is closed."""

    def __init__(
        self, link: Offerer, name: str, package: str, answers: Mapping[str, Callable[[Message], Message]]
    ) -> None:
        self.name = name
        self._offers = [
            link.offer(f"{name}/{_snake(service)}", f"{package}/{service}", answer)
            for service, answer in answers.items()
        ]

    def close(self) -> None:
        for offer in self._offers:
            offer.close()


class ParameterNode(_ServingNode):
    """A node with parameters, over any link that can offer services.

    Args:
        link: offers the six services for parameters; of ROS 2.
        name: of the node, such as `/planner`.
        parameters: the initial values; None for one that has no value yet, and accepts any.
        read_only: the read-only parameters.
        limits: the least and the greatest value of some; other values are refused.
        refuses: returns why a value is refused, or an empty text.
        is_rclcpp: whether it answers like rclcpp, which returns nothing if one of several names is unknown; rclpy
            returns the known ones, and the others as not set.

    Attributes:
        values: the parameters, which a test may change as another node would.
        changes: the values that were set over its services, oldest first.

    Example:
        >>> from robot_runner.testing import FakeClock, FakeRobotLink
        >>> link = FakeRobotLink(FakeClock())
        >>> node = ParameterNode(link, "/planner", {"speed": 0.2})
        >>> link.call("/planner/list_parameters", "rcl_interfaces/ListParameters")["result"]["names"]
        ['speed']
    """

    def __init__(
        self,
        link: Offerer,
        name: str,
        parameters: Mapping[str, ParameterValue],
        *,
        read_only: Collection[str] = (),
        limits: Mapping[str, tuple[float, float]] | None = None,
        refuses: Callable[[str, ParameterValue], str] = lambda _name, _value: "",
        is_rclcpp: bool = True,
    ) -> None:
        self.values = dict(parameters)
        self.changes: list[tuple[str, ParameterValue]] = []
        self._read_only = frozenset(read_only)
        self._kinds = {each: kind_of(value) for each, value in parameters.items() if value is not None}
        self._limits = dict(limits or {})
        self._refuses = refuses
        self._is_rclcpp = is_rclcpp
        answers: dict[str, Callable[[Message], Message]] = {
            "GetParameters": lambda asked: {"values": self._told(asked["names"], self._wire)},
            "SetParameters": lambda asked: {"results": [self._set(each) for each in asked["parameters"]]},
            "SetParametersAtomically": self._set_all,
            "ListParameters": self._list,
            "DescribeParameters": lambda asked: {"descriptors": self._descriptors(asked["names"])},
            "GetParameterTypes": lambda asked: {"types": bytes(self._told(asked["names"], self._kind))},
        }
        super().__init__(link, name, "rcl_interfaces", answers)

    def _told(self, names: Sequence[str], tell: Callable[[str], Any]) -> list[Any]:
        if self._is_rclcpp and not all(name in self.values for name in names):
            return []
        return [tell(name) for name in names]

    def _wire(self, name: str) -> Message:
        return as_wire(self.values.get(name), self._kind(name))

    def _kind(self, name: str) -> ParameterKind:
        """Return a parameter's kind: the declared one, unless the parameter accepts any."""
        return self._kinds.get(name) or kind_of(self.values.get(name))

    def _list(self, asked: Message) -> Message:
        prefixes = [f"{prefix}." for prefix in asked.get("prefixes", ())]
        names = [name for name in self.values if not prefixes or any(map(name.startswith, prefixes))]
        return {"result": {"names": names, "prefixes": sorted({name.rpartition(".")[0] for name in names} - {""})}}

    def _descriptors(self, names: Sequence[str]) -> list[Message]:
        kinds = self._told(names, self._kind)
        return [self._descriptor(name, kind) for name, kind in zip(names, kinds, strict=True)] if kinds else []

    def _descriptor(self, name: str, kind: ParameterKind) -> Message:
        found: dict[str, Any] = {"floating_point_range": [], "integer_range": []}
        if name in self._limits:
            least, greatest = self._limits[name]
            field = "integer_range" if kind is ParameterKind.INTEGER else "floating_point_range"
            found[field] = [{"from_value": least, "to_value": greatest}]
        return {
            **found,
            "name": name if name in self.values else "",
            "type": int(kind),
            "description": f"{name} of {self.name}" if name in self.values else "",
            "read_only": name in self._read_only,
            "dynamic_typing": name in self.values and name not in self._kinds,
        }

    def _set(self, parameter: Message) -> dict[str, Any]:
        name, value = parameter["name"], from_wire(parameter["value"])
        reason = self._objection(name, value, ParameterKind(parameter["value"]["type"]))
        if not reason and value is None:  # both libraries undeclare it then
            del self.values[name]
        elif not reason:
            self.values[name] = value
        if not reason:
            self.changes.append((name, value))
        return {"successful": not reason, "reason": reason}

    def _set_all(self, asked: Message) -> Message:
        before, changes = dict(self.values), list(self.changes)
        results = [self._set(each) for each in asked["parameters"]]
        refused = next((each for each in results if not each["successful"]), None)
        if refused is not None:
            self.values, self.changes = before, changes
        return {"result": refused or {"successful": True, "reason": ""}}

    def _objection(self, name: str, value: ParameterValue, kind: ParameterKind) -> str:
        """Return why a value is refused, in rclcpp's words."""
        if name not in self.values:
            return f"parameter '{name}' cannot be set because it was not declared"
        if name in self._read_only:
            return f"parameter '{name}' cannot be set because it is read-only"
        if kind is not self._kinds.get(name, kind):
            return f"Wrong parameter type, parameter {{{name}}} is of type {{{self._kinds[name].words}}}"
        least, greatest = self._limits.get(name, (-math.inf, math.inf))
        if isinstance(value, int | float) and not least <= value <= greatest:
            numbers = "integer" if kind is ParameterKind.INTEGER else "floating point"
            return f"Parameter {{{name}}} doesn't comply with {numbers} range."
        return self._refuses(name, value)


#: The transitions of a managed node (design.ros2.org, managed nodes): number, label, from, to.
_TRANSITIONS = (
    (1, "configure", LifecycleState.UNCONFIGURED, LifecycleState.INACTIVE),
    (2, "cleanup", LifecycleState.INACTIVE, LifecycleState.UNCONFIGURED),
    (3, "activate", LifecycleState.INACTIVE, LifecycleState.ACTIVE),
    (4, "deactivate", LifecycleState.ACTIVE, LifecycleState.INACTIVE),
    (5, "shutdown", LifecycleState.UNCONFIGURED, LifecycleState.FINALIZED),
    (6, "shutdown", LifecycleState.INACTIVE, LifecycleState.FINALIZED),
    (7, "shutdown", LifecycleState.ACTIVE, LifecycleState.FINALIZED),
)


class LifecycleNode(_ServingNode):
    """A managed node, over any link that can offer services.

    Args:
        link: offers the services of the life cycle; of ROS 2.
        name: of the node.
        state: the initial state.
        refuses: the labels of the transitions whose callbacks fail.

    Attributes:
        state: the present state.
        transitions: the labels of the past transitions, oldest first.

    Example:
        >>> from robot_runner.plugins import bring_to
        >>> from robot_runner.testing import FakeClock, FakeRobotLink
        >>> link = FakeRobotLink(FakeClock())
        >>> node = LifecycleNode(link, "/slam")
        >>> bring_to(link, "/slam", "active")
        >>> node.transitions
        ['configure', 'activate']
    """

    def __init__(
        self,
        link: Offerer,
        name: str,
        *,
        state: LifecycleState = LifecycleState.UNCONFIGURED,
        refuses: Collection[str] = (),
    ) -> None:
        self.state = state
        self.refuses = set(refuses)
        self.transitions: list[str] = []
        answers: dict[str, Callable[[Message], Message]] = {
            "ChangeState": self._change,
            "GetState": lambda _: {"current_state": _state(self.state)},
            "GetAvailableStates": lambda _: {"available_states": [_state(each) for each in LifecycleState]},
            "GetAvailableTransitions": self._available,
        }
        super().__init__(link, name, "lifecycle_msgs", answers)

    def _change(self, asked: Message) -> Message:
        wanted = asked["transition"]
        for number, label, start, goal in _TRANSITIONS:
            if start is self.state and (number == wanted["id"] or label == wanted.get("label")):
                if label in self.refuses:
                    return {"success": False}
                self.state = goal
                self.transitions.append(label)
                return {"success": True}
        return {"success": False}

    def _available(self, _: Message) -> Message:
        return {
            "available_transitions": [
                {"transition": {"id": number, "label": label}, "start_state": _state(start), "goal_state": _state(goal)}
                for number, label, start, goal in _TRANSITIONS
                if start is self.state
            ]
        }


def _state(state: LifecycleState) -> dict[str, Any]:
    return {"id": int(state), "label": state.label}


def _snake(name: str) -> str:
    return "".join(f"_{letter.lower()}" if letter.isupper() else letter for letter in name).lstrip("_")
