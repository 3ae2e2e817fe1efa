"""The actions of the rosbridge server for tests, with the operations of rosbridge_suite."""

from __future__ import annotations

import time
import uuid
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Protocol

from robot_runner.core.links.goals import GoalStatus
from robot_runner.ros.action_server import ActionTypes
from robot_runner.ros.ros2_actions import FEEDBACK_TOPIC, GOAL_NUMBERS, STATUS_TOPIC, STATUS_TYPE, ros2_action_types
from robot_runner.ros.rosbridge_frames import to_protocol
from robot_runner.ros.shapes import completed, plain_type, stamp_of
from robot_runner.testing.rosbridge_graph import Graph, Refusal, ServedService, received

_CANCEL = "/_action/cancel_goal"
_SPELT_STATUS = STATUS_TYPE.replace("/", "/msg/", 1)


class _Client(Protocol):
    """A connection."""

    def send(self, operation: dict[str, Any]) -> None:
        """Send an operation."""


@dataclass(slots=True)
class _Goal:
    """A goal in progress: its client, and its ids on both sides."""

    action: str
    sender: _Client
    sent_as: Any
    told_as: str
    key: bytes = field(default_factory=lambda: uuid.uuid4().bytes)
    status: GoalStatus = GoalStatus.EXECUTING


@dataclass(slots=True)
class _Action:
    """An action that a client offers."""

    type_name: str
    types: ActionTypes
    owner: _Client
    goals: dict[str, _Goal] = field(default_factory=dict)


class ServedActions:
    """Actions by full name, and their goals; callers hold the server's lock.

    Args:
        graph: for the topics with the states of goals.
        is_known: whether the server supports these operations, as in ROS 2 since rosbridge_suite 2.0.

    Attributes:
        takers: the handler of each operation.
        is_known: as given; may be changed.
        offered: the actions.
        tells_rejection: whether a rejected goal is answered, as servers since 3.0 do.
        rejects: which goals the server's action servers reject, by action.
        keeps_actions: whether a withdrawn action stays on the graph, as with servers of 2.x.
    """

    def __init__(self, graph: Graph, *, is_known: bool) -> None:
        self.is_known = is_known
        self.offered: dict[str, _Action] = {}
        self.tells_rejection = False
        self.keeps_actions = False
        self.rejects: dict[str, Callable[[Mapping[str, Any]], bool]] = {}
        self._graph = graph
        self._count = 0
        self.takers: dict[str, Callable[[Mapping[str, Any], _Client], None]] = {
            "advertise_action": self._advertise,
            "unadvertise_action": self._unadvertise,
            "send_action_goal": self._send,
            "cancel_action_goal": self._cancel,
            "action_feedback": self._feedback,
            "action_result": self._result,
        }
        graph.action_types = lambda: {name: each.type_name for name, each in self.offered.items()}

    def take(self, operation: Mapping[str, Any], client: _Client) -> None:
        """Handle an operation about actions; a `Refusal` says that it is not possible."""
        if not self.is_known:
            raise Refusal(f"Unknown operation: {operation['op']}")
        self.takers[operation["op"]](operation, client)

    def forget(self, client: _Client) -> None:
        """Remove a client: its actions are withdrawn; the goals that it sent go on, as with a real server."""
        for name in [name for name, action in self.offered.items() if action.owner is client]:
            self._withdraw(name)

    def _advertise(self, operation: Mapping[str, Any], client: _Client) -> None:
        name, kind = operation["action"], plain_type(operation["type"])
        types = ros2_action_types(self._graph.types, kind)
        self.offered[name] = _Action(kind, types, client)
        self._graph.advertise(name + STATUS_TOPIC, _SPELT_STATUS, self, is_latched=True)
        spelt_feedback = f"{kind.replace('/', '/action/', 1)}_FeedbackMessage"
        self._graph.advertise(name + FEEDBACK_TOPIC, spelt_feedback, self)
        cancel = ServedService("action_msgs/srv/CancelGoal", self, partial(self._cancel_called, name))
        self._graph.services[name + _CANCEL] = cancel

    def _unadvertise(self, operation: Mapping[str, Any], client: _Client) -> None:
        del client
        if operation["action"] not in self.offered:
            raise Refusal(f"Action {operation['action']} has not been advertised via rosbridge, can't unadvertise.")
        self._withdraw(operation["action"])

    def _withdraw(self, name: str) -> None:
        action = self.offered[name]
        for goal in list(action.goals.values()):
            self._end(action, goal, GoalStatus.ABORTED, {})
        if self.keeps_actions:
            return
        del self.offered[name], self._graph.services[name + _CANCEL]
        self._graph.unadvertise(name + STATUS_TOPIC, self)
        self._graph.unadvertise(name + FEEDBACK_TOPIC, self)

    def _send(self, operation: Mapping[str, Any], client: _Client) -> None:
        name = operation["action"]
        action = self.offered.get(name)
        if action is None or action.type_name != plain_type(operation["action_type"]):
            self._refuse(operation, client, "No action server available")
            return
        values = received(action.types.goal, operation.get("args") or {}, where=name)
        rejects = self.rejects.get(name)
        if rejects is not None and rejects(values):
            self._refuse(operation, client, "Action goal was rejected")
            return
        self._count += 1
        goal = _Goal(name, client, operation.get("id"), f"action_goal:{name}:{self._count}")
        action.goals[goal.told_as] = goal
        told = {"op": "send_action_goal", "id": goal.told_as, "action": name, "feedback": True}
        spelt = to_protocol(action.types.goal, values)
        action.owner.send({**told, "action_type": operation["action_type"], "args": spelt})
        self._publish(action, name)

    def _refuse(self, operation: Mapping[str, Any], client: _Client, text: str) -> None:
        if self.tells_rejection:
            answer = {"op": "action_result", "id": operation.get("id"), "action": operation["action"]}
            client.send({**answer, "values": text, "status": 0, "result": False})

    def _cancel(self, operation: Mapping[str, Any], client: _Client) -> None:
        del client  # any connection may cancel: the server's list of goals is one
        action = self.offered.get(operation["action"])
        for goal in list(action.goals.values()) if action is not None else ():
            if action is not None and goal.sent_as == operation.get("id"):
                self._ask_for_end(action, goal)

    def _cancel_called(self, name: str, request: Mapping[str, Any]) -> Mapping[str, Any]:
        """Answer the action's hidden cancel service, for one goal, or for all where none is named."""
        action, key = self.offered[name], request["goal_info"]["goal_id"]["uuid"]
        for goal in list(action.goals.values()):
            if key in {goal.key, bytes(16)}:
                self._ask_for_end(action, goal)
        return {"return_code": 0}

    def _ask_for_end(self, action: _Action, goal: _Goal) -> None:
        goal.status = GoalStatus.CANCELING
        action.owner.send({"op": "cancel_action_goal", "id": goal.told_as, "action": goal.action})
        self._publish(action, goal.action)

    def _feedback(self, operation: Mapping[str, Any], client: _Client) -> None:
        action, goal = self._goal(operation, client)
        feedback = self._complete(action.types.feedback, operation)
        told = {"goal_id": {"uuid": goal.key}, "feedback": feedback}
        self._graph.publish(goal.action + FEEDBACK_TOPIC, told, self)
        values = to_protocol(action.types.feedback, feedback)
        goal.sender.send({"op": "action_feedback", "id": goal.sent_as, "action": goal.action, "values": values})

    def _result(self, operation: Mapping[str, Any], client: _Client) -> None:
        action, goal = self._goal(operation, client)
        if operation["result"] is not True:
            self._end(action, goal, GoalStatus.ABORTED, {})
            return
        known = {GOAL_NUMBERS[each]: each for each in (GoalStatus.SUCCEEDED, GoalStatus.CANCELED)}
        status = known.get(operation["status"], GoalStatus.ABORTED)
        self._end(action, goal, status, self._complete(action.types.result, operation))

    def _goal(self, operation: Mapping[str, Any], client: _Client) -> tuple[_Action, _Goal]:
        action = self.offered.get(operation["action"])
        if action is None or action.owner is not client:
            raise Refusal(f"Action {operation['action']} has not been advertised via rosbridge.")
        if operation["id"] not in action.goals:
            raise Refusal(f"Received action result for unrecognized id: {operation['id']}")
        return action, action.goals[operation["id"]]

    def _end(self, action: _Action, goal: _Goal, status: GoalStatus, result: Mapping[str, Any]) -> None:
        goal.status = status
        self._publish(action, goal.action)
        del action.goals[goal.told_as]
        values = to_protocol(action.types.result, completed(action.types.result, result, where=goal.action))
        answer = {"op": "action_result", "id": goal.sent_as, "action": goal.action, "values": values}
        goal.sender.send({**answer, "status": GOAL_NUMBERS[status], "result": True})

    def _complete(self, shape: Any, operation: Mapping[str, Any]) -> dict[str, Any]:
        return received(shape, operation.get("values") or {}, where=operation["action"])

    def receive(self, topic: object, message: Mapping[str, Any]) -> None:
        """Do nothing: no topics are subscribed."""

    def _publish(self, action: _Action, name: str) -> None:
        stamp = stamp_of(time.time_ns())
        told = [
            {"goal_info": {"goal_id": {"uuid": goal.key}, "stamp": stamp}, "status": GOAL_NUMBERS[goal.status]}
            for goal in action.goals.values()
        ]
        self._graph.publish(name + STATUS_TOPIC, {"status_list": told}, self)
