"""Lists, describes, reads and changes the parameters of nodes, in both generations of ROS.

A node of ROS 2 offers six services for its parameters (design.ros2.org, ROS 2 parameters). In ROS 1 the parameter
server of the master holds them, and a node reads them, mostly when it is started.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Protocol, runtime_checkable

from robot_runner.core.errors import LinkError, did_you_mean
from robot_runner.core.links.robot import Message, RobotLink
from robot_runner.core.words import enumerated
from robot_runner.ros.node_services import call_node, full_node
from robot_runner.ros.parameter_values import (
    ParameterDescription,
    ParameterKind,
    ParameterValue,
    as_wire,
    fitted,
    from_wire,
    kind_of,
    normal,
)

#: The range of whole numbers in XML-RPC, and so in ROS 1.
_INT32 = range(-(2**31), 2**31)
_DECLARED = "List its parameters: ros2 param list."


@runtime_checkable
class ParameterAccess(Protocol):
    """The parameters of the nodes of a graph. Names of nodes are relative to the robot's namespace or begin with `/`.

    Each method raises a `LinkError` where there is no such node or parameter (it names the nearest), and where the node
    does not answer in time.
    """

    def names(self, node: str) -> Sequence[str]:
        """Return the names of all parameters of a node, sorted."""

    def described(self, node: str, names: Sequence[str]) -> Mapping[str, ParameterDescription]:
        """Return what the node tells of these parameters."""

    def values(self, node: str, names: Sequence[str]) -> Mapping[str, ParameterValue]:
        """Return the values that these parameters have; None for one without a value."""

    def objections(self, node: str, values: Mapping[str, Any]) -> Sequence[LinkError]:
        """Return errors for values that are known not to be accepted; nothing is set."""

    def change(self, node: str, values: Mapping[str, Any]) -> None:
        """Set parameters of a node; None removes a value, in ROS 2 with the parameter itself.

        Raises:
            LinkError: one is read-only, of another kind or out of its limits, and nothing is set; or the node refuses
                one, and the others are set.
        """


class ParameterServer(Protocol):
    """The parameter server of ROS 1: all parameters, by full names."""

    def parameter_names(self) -> Sequence[str]:
        """Return the full names of all parameters."""

    def parameter(self, name: str) -> Any:
        """Return the value of one, or None where it is not set."""

    def set_parameter(self, name: str, *, value: Any) -> None:
        """Set one."""

    def delete_parameter(self, name: str) -> None:
        """Take one away."""


def parameters_of(link: RobotLink, *, timeout: float = 5.0) -> ParameterAccess:
    """Return the parameters of the nodes that a link reaches.

    Args:
        link: to the robot; relative names of nodes are below its namespace.
        timeout: of each answer of a node, s.

    Example:
        >>> from robot_runner.testing import FakeClock, FakeRobotLink, ParameterNode
        >>> link = FakeRobotLink(FakeClock())
        >>> node = ParameterNode(link, "/planner", {"speed": 0.2}, read_only=["frame"])
        >>> planner = parameters_of(link)
        >>> planner.change("planner", {"speed": 1})
        >>> planner.values("/planner", ["speed"])
        {'speed': 1.0}
    """
    server: ParameterServer | None = getattr(link, "parameter_server", None)
    return NodeParameters(link, timeout) if server is None else ServerParameters(link, server, timeout)


def all_at_once(errors: Sequence[LinkError], *, where: str) -> None:
    """Raise several errors as one `LinkError`; do nothing if there is none."""
    if len(errors) == 1:
        raise errors[0]
    if errors:
        told = "; ".join(f"{error.where}: {error.problem}" for error in errors)
        raise LinkError(told, where=where, fix=" ".join(dict.fromkeys(error.fix for error in errors)))


class NodeParameters:
    """The parameters of nodes of ROS 2, over the services of the nodes."""

    def __init__(self, link: RobotLink, timeout: float = 5.0) -> None:
        self._link = link
        self._timeout = timeout

    def names(self, node: str) -> list[str]:
        """Return the names of all parameters of a node, sorted."""
        return sorted(self._call(node, "ListParameters", {"prefixes": [], "depth": 0})["result"]["names"])

    def described(self, node: str, names: Sequence[str]) -> dict[str, ParameterDescription]:
        """Return what the node tells of these parameters."""
        told = self._call(node, "DescribeParameters", {"names": list(names)})["descriptors"]
        self._check_known(node, names, [int(each["type"]) for each in told])
        found = {name: _description(name, each) for name, each in zip(names, told, strict=True)}
        vague = [name for name, each in found.items() if each.kind is ParameterKind.NOT_SET]
        for name, value in (self.values(node, vague) if vague else {}).items():  # rclpy of Foxy omits the kind
            found[name] = replace(found[name], kind=kind_of(value))
        return found

    def values(self, node: str, names: Sequence[str]) -> dict[str, ParameterValue]:
        """Return the values that these parameters have; None for one without a value."""
        told = self._call(node, "GetParameters", {"names": list(names)})["values"]
        self._check_known(node, names, [int(each["type"]) for each in told])
        return {name: from_wire(each) for name, each in zip(names, told, strict=True)}

    def objections(self, node: str, values: Mapping[str, Any]) -> list[LinkError]:
        """Return errors for values that do not fit the node's descriptions; nothing is set."""
        return self._checked(node, values)[1]

    def change(self, node: str, values: Mapping[str, Any]) -> None:
        """Set parameters of a node, after all of them were checked."""
        wire, errors = self._checked(node, values)
        all_at_once(errors, where=self._full(node))
        results = self._call(node, "SetParameters", {"parameters": wire})["results"]
        if len(results) != len(wire):
            raise self._odd(node, len(results), len(wire))
        answers = zip(values, results, strict=True)
        refused = [self._refused(node, name, told["reason"]) for name, told in answers if not told["successful"]]
        all_at_once(refused, where=self._full(node))

    def _checked(self, node: str, values: Mapping[str, Any]) -> tuple[list[dict[str, Any]], list[LinkError]]:
        described = self.described(node, list(values))
        wire, errors = [], []
        for name, value in values.items():
            try:
                wire.append({"name": name, "value": _checked(value, described[name], self._where(node, name))})
            except LinkError as error:
                errors.append(error)
        return wire, errors

    def _call(self, node: str, service: str, request: Message) -> Any:
        what, kind = "node that has parameters:", f"rcl_interfaces/{service}"
        return call_node(self._link, node, kind, request, what=what, timeout=self._timeout)

    def _check_known(self, node: str, names: Sequence[str], kinds: Sequence[int]) -> None:
        """Check that the node has these parameters: if one is missing, rclcpp returns nothing, rclpy `not set`."""
        if len(kinds) == len(names) and ParameterKind.NOT_SET not in kinds:
            return
        there = self.names(node)
        full = self._full(node)
        all_at_once([_unknown(full, name, there) for name in names if name not in there], where=full)
        if len(kinds) != len(names):
            raise self._odd(node, len(kinds), len(names))

    def _full(self, node: str) -> str:
        return full_node(self._link, node)

    def _where(self, node: str, name: str) -> str:
        return f"{self._full(node)}: {name}"

    def _odd(self, node: str, told: int, asked: int) -> LinkError:
        problem = f"the node answers for {told} parameters where {asked} were asked for"
        fix = "Look at the node's log. One that was declared without a value has to get one where the node is started."
        return LinkError(problem, where=self._full(node), fix=fix)

    def _refused(self, node: str, name: str, reason: str) -> LinkError:
        told = reason or "it gives no reason"
        fix = "Give another value."
        return LinkError(f"the node refuses the value: {told}", where=self._where(node, name), fix=fix)


class ServerParameters:
    """The parameters of nodes of ROS 1, below the names of the nodes in the master's parameter server.

    A running node accepts them if it uses dynamic_reconfigure.
    """

    def __init__(self, link: RobotLink, server: ParameterServer, timeout: float = 5.0) -> None:
        self._link = link
        self._server = server
        self._timeout = timeout

    def names(self, node: str) -> list[str]:
        """Return the names of the parameters that are set for a node, sorted; for all nodes if it is `/`."""
        prefix = self._key(node, "")
        return sorted(name.removeprefix(prefix) for name in self._server.parameter_names() if name.startswith(prefix))

    def described(self, node: str, names: Sequence[str]) -> dict[str, ParameterDescription]:
        """Return the kind of each of these parameters, which is all that a parameter server knows."""
        return {
            name: ParameterDescription(name, kind_of(value), may_change_kind=value is None)
            for name, value in self.values(node, names).items()
        }

    def values(self, node: str, names: Sequence[str]) -> dict[str, ParameterValue]:
        """Return the values that are set; None where none is, and the node uses its default."""
        return {name: self._value(self._key(node, name)) for name in names}

    def objections(self, node: str, values: Mapping[str, Any]) -> list[LinkError]:
        """Return errors for values that cannot be set; nothing is set."""
        return self._fitted(node, values)[1]

    def change(self, node: str, values: Mapping[str, Any]) -> None:
        """Set parameters for a node; with None it uses its default at the next start."""
        fits, errors = self._fitted(node, values)
        all_at_once(errors, where=node)
        for key, value in fits.items():
            if value is not None:
                self._server.set_parameter(key, value=value)
            elif self._server.parameter(key) is not None:
                self._server.delete_parameter(key)
        _reconfigure(self._link, fits, timeout=self._timeout)

    def doubts(self, node: str, names: Sequence[str]) -> list[tuple[str, str]]:
        """Return reasons why a change may have no effect, each with a fix: a name that is not set, a running node."""
        there, full = self.names(node), full_node(self._link, node)
        found = []
        for name in names:
            if name not in there:
                fix = did_you_mean(name, there, "See that the node reads a parameter of this name.")
                problem = f"{self._key(node, name)} was not set before, and ROS 1 does not tell which node reads it"
                found.append((problem, fix))
        live = _reconfigurable(self._link, [self._key(node, name) for name in names])
        if len(live) < len(names) and full in self._link.nodes():
            problem = f"{full} is running already, and a node of ROS 1 reads most of its parameters when it starts"
            found.append((problem, "Start it after they are set: list its RosLaunch after RosParameters."))
        return found

    def _fitted(self, node: str, values: Mapping[str, Any]) -> tuple[dict[str, ParameterValue], list[LinkError]]:
        described = self.described(node, list(values))
        fits: dict[str, ParameterValue] = {}
        errors = []
        for name, value in values.items():
            key = self._key(node, name)
            try:
                fits[key] = None if value is None else _fitting_server(value, described[name].kind, key)
            except LinkError as error:
                errors.append(error)
        return fits, errors

    def _key(self, node: str, name: str) -> str:
        return f"{full_node(self._link, node).rstrip('/')}/{name}"

    def _value(self, key: str) -> ParameterValue:
        value = self._server.parameter(key)
        if isinstance(value, dict):
            fix = f"Name one of them: {enumerated(sorted(value))}."
            raise LinkError("the name is that of several parameters", where=key, fix=fix)
        return None if value is None else normal(value, where=key)


# A running node of ROS 1 accepts parameters if it uses dynamic_reconfigure: it offers a service below the name of its
# parameters, accepts what it can, and then writes its values into the parameter server.
# Source: wiki.ros.org/dynamic_reconfigure.

_RECONFIGURE = "dynamic_reconfigure/Reconfigure"
#: The field of a dynamic_reconfigure/Config for each kind; there are no arrays.
_CONFIG_FIELDS = {
    ParameterKind.BOOL: "bools",
    ParameterKind.INTEGER: "ints",
    ParameterKind.DOUBLE: "doubles",
    ParameterKind.STRING: "strs",
}


def _reconfigurable(link: RobotLink, keys: Iterable[str]) -> set[str]:
    """Return the parameters, by full names, that their node accepts while it runs."""
    services = link.services()
    return {key for key in keys if services.get(_service_of(key)) == _RECONFIGURE}


def _reconfigure(link: RobotLink, values: Mapping[str, ParameterValue], *, timeout: float) -> None:
    """Set parameters of running nodes, by full names; nodes without dynamic_reconfigure are skipped."""
    configs: dict[str, dict[str, list[dict[str, Any]]]] = {}
    for key in sorted(_reconfigurable(link, values)):
        if (field := _CONFIG_FIELDS.get(kind_of(values[key]))) is not None:
            entry = {"name": key.rpartition("/")[2], "value": values[key]}
            configs.setdefault(_service_of(key), {}).setdefault(field, []).append(entry)
    for service, config in configs.items():
        link.call(service, _RECONFIGURE, {"config": config}, timeout=timeout)


def _service_of(key: str) -> str:
    return f"{key.rpartition('/')[0]}/set_parameters"


def _fitting_server(value: Any, kind: ParameterKind, key: str) -> ParameterValue:
    """Return a value of the kind of the present one, or a number for a number: the server itself checks no kinds."""
    given = normal(value, where=key)
    if any(isinstance(each, int) and each not in _INT32 for each in (given if isinstance(given, list) else [given])):
        raise LinkError(f"{given!r} does not fit the 32 bits of ROS 1", where=key, fix="Give a smaller number.")
    widened = {ParameterKind.INTEGER: ParameterKind.DOUBLE, ParameterKind.INTEGER_ARRAY: ParameterKind.DOUBLE_ARRAY}
    if kind is ParameterKind.NOT_SET or kind_of(given) is widened.get(kind):
        return given
    return fitted(given, kind, where=key)


def _checked(value: Any, described: ParameterDescription, where: str) -> dict[str, Any]:
    if described.is_read_only:
        fix = "Give it where the node is started: as an argument of its launch file, or in its parameter file."
        raise LinkError("the parameter is read-only: it is set when the node starts", where=where, fix=fix)
    if value is None:
        return as_wire(None)
    kind = described.kind
    if described.may_change_kind or kind is ParameterKind.NOT_SET:
        kind = kind_of(normal(value, where=where))
    given = fitted(value, kind, where=where)
    if described.limits is not None and isinstance(given, int | float):
        least, greatest = described.limits
        if not least <= given <= greatest:
            problem = f"{given!r} is not within the limits that the node names, {least:g} to {greatest:g}"
            raise LinkError(problem, where=where, fix="Give a value within them.")
    return as_wire(given, kind)


def _description(name: str, told: Message) -> ParameterDescription:
    ranges = [*told["floating_point_range"], *told["integer_range"]]
    limits = (ranges[0]["from_value"], ranges[0]["to_value"]) if ranges else None
    is_dynamic, kind = bool(told.get("dynamic_typing", False)), ParameterKind(int(told["type"]))
    return ParameterDescription(name, kind, bool(told["read_only"]), is_dynamic, limits, str(told["description"]))


def _unknown(node: str, name: str, known: Sequence[str]) -> LinkError:
    return LinkError(f"the node has no parameter {name!r}", where=node, fix=did_you_mean(name, known, _DECLARED))
