"""The life cycle of managed nodes of ROS 2 (design.ros2.org, managed nodes): states and transitions."""

from __future__ import annotations

from enum import IntEnum
from typing import Any

from robot_runner.core.errors import LinkError, did_you_mean
from robot_runner.core.links.robot import Encoding, Message, RobotLink
from robot_runner.core.words import enumerated
from robot_runner.ros.node_services import call_node


class LifecycleState(IntEnum):
    """The states of lifecycle_msgs/State: four primary states, and the transition states between them."""

    UNKNOWN = 0
    UNCONFIGURED = 1
    INACTIVE = 2
    ACTIVE = 3
    FINALIZED = 4
    CONFIGURING = 10
    CLEANING_UP = 11
    SHUTTING_DOWN = 12
    ACTIVATING = 13
    DEACTIVATING = 14
    ERROR_PROCESSING = 15

    @property
    def label(self) -> str:
        """The name that ROS has for it, such as `inactive`."""
        return self.name.lower().replace("_", "")


#: The states that a node can be brought to and back from, in this order.
SETTLED = (LifecycleState.UNCONFIGURED, LifecycleState.INACTIVE, LifecycleState.ACTIVE)
_UP = ("configure", "activate")
_DOWN = ("cleanup", "deactivate")


def state_of(link: RobotLink, node: str, *, timeout: float = 5.0) -> LifecycleState:
    """Return the state of a managed node.

    Args:
        link: to the robot, on ROS 2.
        node: its name, relative to the robot's namespace unless it begins with `/`.
        timeout: of its answer, s.

    Raises:
        LinkError: there is no managed node of this name, it does not answer in time, or the graph is one of ROS 1.
    """
    told = _call(link, node, "GetState", {}, timeout)["current_state"]
    try:
        return LifecycleState(int(told["id"]))
    except ValueError as error:
        problem = f"the node is in the state {told['label']!r} ({told['id']}), which ROS does not know"
        raise LinkError(problem, where=node, fix="Look at the node's log.") from error


def change_state(link: RobotLink, node: str, transition: str, *, timeout: float = 10.0) -> LifecycleState:
    """Request a transition of a managed node, such as `activate`, and return its state afterwards.

    Args:
        link: to the robot, on ROS 2.
        node: its name.
        transition: its label: `configure`, `cleanup`, `activate`, `deactivate` or `shutdown`.
        timeout: how long the transition may take, s: a node that is configured may load a map.

    Raises:
        LinkError: its state has no such transition, the node refuses it, or as `state_of`.
    """
    told = _call(link, node, "GetAvailableTransitions", {}, timeout)["available_transitions"]
    known = {each["transition"]["label"]: each["transition"]["id"] for each in told}
    if transition not in known:
        state = state_of(link, node, timeout=timeout)
        there = enumerated(sorted(known)) if known else "none"
        problem = f"a node that is {state.label} has no transition {transition!r}; it has {there}"
        raise LinkError(problem, where=node, fix=did_you_mean(transition, known))
    request = {"transition": {"id": known[transition], "label": transition}}
    done = _call(link, node, "ChangeState", request, timeout)["success"]
    state = state_of(link, node, timeout=timeout)
    if not done:
        problem = f"the node refuses the transition {transition!r}: it is {state.label} now"
        raise LinkError(problem, where=node, fix="Look at the node's log: its callback of this transition failed.")
    return state


def bring_to(link: RobotLink, node: str, state: str | LifecycleState, *, timeout: float = 10.0) -> None:
    """Bring a managed node to a state by the transitions that lead there; do nothing if it is in that state.

    Args:
        link: to the robot, on ROS 2.
        node: its name.
        state: `unconfigured`, `inactive` or `active`.
        timeout: how long each transition may take, s.

    Raises:
        LinkError: the node ends in another state, or as `change_state`.
    """
    wanted = named_state(state, where=node)
    now = state_of(link, node, timeout=timeout)
    while now is not wanted:
        if now not in SETTLED:
            problem = f"the node is {now.label}, from where no transition leads to {wanted.label}"
            raise LinkError(problem, where=node, fix="Start the node again.")
        label = _UP[SETTLED.index(now)] if wanted > now else _DOWN[SETTLED.index(now) - 1]
        before, now = now, change_state(link, node, label, timeout=timeout)
        if abs(wanted - now) >= abs(wanted - before):
            problem = f"the node is {now.label} after the transition {label!r} from {before.label}"
            raise LinkError(problem, where=node, fix="Look at the node's log.")


def named_state(state: str | LifecycleState, *, where: str) -> LifecycleState:
    """Return the state of this name; it must be one that a node can be brought to.

    Raises:
        LinkError: there is none.

    Example:
        >>> named_state("inactive", where="/slam").name
        'INACTIVE'
    """
    for each in SETTLED:
        if state in {each, each.label}:
            return each
    fix = did_you_mean(str(state), [each.label for each in SETTLED])
    raise LinkError(f"no node can be brought to the state {state!r}", where=where, fix=fix)


def ros1_has_none(where: str) -> LinkError:
    """Return the error that nodes of ROS 1 have no life cycle."""
    fix = "Start and stop the node with RosLaunch, or leave the state out."
    return LinkError("nodes of ROS 1 have no life cycle: it is ROS 2's", where=where, fix=fix)


def _call(link: RobotLink, node: str, service: str, request: Message, timeout: float) -> Any:
    if link.encoding is Encoding.ROS1:
        raise ros1_has_none(node)
    return call_node(link, node, f"lifecycle_msgs/{service}", request, what="managed node", timeout=timeout)
