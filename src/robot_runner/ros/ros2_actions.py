"""Actions of ROS 2: three services and two topics, under a hidden name below the action's.

Sources: design.ros2.org/articles/actions.html, and rcl_action for names, profiles and the order of messages.
"""

from __future__ import annotations

import logging
import threading
import time
import uuid
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar

from robot_runner.core.errors import GoalRejectedError, LinkError
from robot_runner.core.links.goals import ActionResult, GoalStatus
from robot_runner.core.links.robot import Message, Qos, Subscription
from robot_runner.ros.action_calls import await_action, check_one_server
from robot_runner.ros.action_server import ActionTypes, Execution, GoalServer, part_of
from robot_runner.ros.action_types import whole_action
from robot_runner.ros.graph_transport import LONGEST_DISCOVERY, GraphTypes, Lane, Reception, Transport, already_offered
from robot_runner.ros.shapes import completed, nanoseconds_of, stamp_of

if TYPE_CHECKING:
    from robot_runner.ros.sent_goal import SentGoal

_logger = logging.getLogger(__name__)

_SEND, _CANCEL, _RESULT = "/_action/send_goal", "/_action/cancel_goal", "/_action/get_result"
FEEDBACK_TOPIC, STATUS_TOPIC = "/_action/feedback", "/_action/status"
_CANCEL_TYPE, STATUS_TYPE = "action_msgs/CancelGoal", "action_msgs/GoalStatusArray"
#: action_msgs/GoalStatus.
GOAL_STATES: Mapping[int, GoalStatus] = MappingProxyType(
    {
        0: GoalStatus.UNKNOWN,
        1: GoalStatus.ACCEPTED,
        2: GoalStatus.EXECUTING,
        3: GoalStatus.CANCELING,
        4: GoalStatus.SUCCEEDED,
        5: GoalStatus.CANCELED,
        6: GoalStatus.ABORTED,
    }
)
GOAL_NUMBERS: Mapping[GoalStatus, int] = MappingProxyType({status: number for number, status in GOAL_STATES.items()})
#: action_msgs/CancelGoal: return codes for no error, and for a goal that is over.
_NOT_REFUSED, _IS_OVER = 0, 3
_REFUSALS = {1: "the server refuses", 2: "the server does not know the goal"}
#: How long the result of a goal that is over may take, s.
_RESULT_SECONDS = 5.0
_EVERY = bytes(16)


def uuid_of(key: str) -> dict[str, bytes]:
    """Return the message `unique_identifier_msgs/UUID` of a goal's key."""
    return {"uuid": bytes.fromhex(key)}


def ros2_action_types(types: GraphTypes, action_type: str) -> ActionTypes:
    """Return the parts of an action's type, from its services and feedback; raise a `LinkError` for an unknown type."""
    return ActionTypes(
        part_of(types.request(f"{action_type}_SendGoal"), "goal"),
        part_of(types.response(f"{action_type}_GetResult"), "result"),
        part_of(types.shape(f"{action_type}_FeedbackMessage"), "feedback"),
    )


class Ros2Actions:
    """The actions of a graph of ROS 2, over the primitives of a transport."""

    def __init__(self, transport: Transport) -> None:
        self._transport = transport

    def types(self, action_type: str) -> ActionTypes:
        """Return the parts of an action's type."""
        return ros2_action_types(self._transport.types, action_type)

    def actions(self) -> dict[str, str]:
        """Return the type of each action that is offered, by full name."""
        return {
            name.removesuffix(_SEND): whole_action(kind)
            for name, kind in sorted(self._transport.services().items())
            if name.endswith(_SEND)
        }

    def client(self, action: str, action_type: str, timeout: float) -> _Client:
        """Return a client of an action, once its server is there."""
        await_action(self.actions, action, action_type, min(timeout, LONGEST_DISCOVERY))
        return _Client(self._transport, self, action, action_type)

    def serve(self, action: str, action_type: str, server: GoalServer) -> Subscription:
        """Let a server of this link execute goals."""
        if action in self.actions():
            raise already_offered(action, what="action")
        return _Served(self._transport, action, action_type, server)


class _Client:
    cancels_at_once: ClassVar[bool] = False

    def __init__(self, transport: Transport, graph: Ros2Actions, action: str, action_type: str) -> None:
        self._transport = transport
        self._graph = graph
        self._action = action
        self._type = action_type
        self._goals: dict[str, SentGoal] = {}
        self._fetched: set[str] = set()
        self._lock = threading.Lock()
        self._status = transport.subscribe(
            action + STATUS_TOPIC, STATUS_TYPE, self._take_status, qos=None, lane=Lane.GOALS
        )
        self._feedback = transport.subscribe(
            action + FEEDBACK_TOPIC, f"{action_type}_FeedbackMessage", self._take_feedback, qos=None, lane=Lane.GOALS
        )

    def send(self, goal: Message, sent: SentGoal, timeout: float) -> None:
        check_one_server(self._action, self._transport.publishers(self._action + STATUS_TOPIC))
        sent.key = uuid.uuid4().hex
        with self._lock:
            self._goals[sent.key] = sent
        request = {"goal_id": uuid_of(sent.key), "goal": goal}
        answer = self._transport.call(self._action + _SEND, f"{self._type}_SendGoal", request, timeout)
        if not answer["accepted"]:
            sent.note(GoalStatus.REJECTED)
            self._forget(sent)
            fix = "Look at the log of its node: it may be busy, or not active yet."
            raise GoalRejectedError("the action server rejects the goal", where=self._action, fix=fix)
        sent.note(GoalStatus.ACCEPTED)

    def cancel(self, sent: SentGoal, timeout: float) -> None:
        request = {"goal_info": {"goal_id": uuid_of(sent.key), "stamp": {"sec": 0, "nanosec": 0}}}
        answer = self._transport.call(self._action + _CANCEL, _CANCEL_TYPE, request, timeout)
        code = answer["return_code"]
        if code in {_NOT_REFUSED, _IS_OVER}:
            return
        problem = f"the goal is not cancelled: {_REFUSALS.get(code, f'the server answers {code}')}"
        raise LinkError(problem, where=self._action, fix="Look at the log of its node.")

    def is_served(self) -> bool:
        return self._graph.actions().get(self._action) == self._type

    def close(self) -> None:
        self._feedback.close()
        self._status.close()

    def _take_feedback(self, reception: Reception) -> None:
        message = reception.message()
        if (goal := self._find(message)) is not None:
            goal.take_feedback(message["feedback"])

    def _take_status(self, reception: Reception) -> None:
        for told in reception.message()["status_list"]:
            if (goal := self._find(told["goal_info"])) is not None:
                self._note(goal, GOAL_STATES.get(told["status"], GoalStatus.UNKNOWN))

    def _note(self, goal: SentGoal, status: GoalStatus) -> None:
        if status.is_over:
            with self._lock:
                if goal.key in self._fetched:
                    return
                self._fetched.add(goal.key)
            # In another thread: this one has to receive the answer.
            threading.Thread(target=self._fetch, args=(goal, status), name="action result", daemon=True).start()
        goal.note(status)
        if goal.is_abandoned and not status.is_over:
            self._forget(goal)
            threading.Thread(target=self._drop, args=(goal,), name="action cancel", daemon=True).start()

    def _fetch(self, goal: SentGoal, status: GoalStatus) -> None:
        request = {"goal_id": uuid_of(goal.key)}
        try:
            answer = self._transport.call(self._action + _RESULT, f"{self._type}_GetResult", request, _RESULT_SECONDS)
        except LinkError as error:
            problem = f"the goal is {status}, and its result is not reported: {error.problem}"
            goal.lose(LinkError(problem, where=self._action, fix=error.fix))
            return
        except Exception as error:  # noqa: BLE001 - closed meanwhile, as each library says it
            problem = f"the goal is {status}, and its result is not reported: {type(error).__name__}: {error}"
            goal.lose(LinkError(problem, where=self._action, fix="Wait for the result before the link is closed."))
            return
        finally:
            self._forget(goal)
        told = GOAL_STATES.get(answer["status"], GoalStatus.UNKNOWN)
        goal.finish(ActionResult(told if told.is_over else status, answer["result"]))

    def _drop(self, goal: SentGoal) -> None:
        """Cancel a goal that was accepted after its deadline, as no caller waits for it."""
        try:
            self.cancel(goal, _RESULT_SECONDS)
        except LinkError as error:
            _logger.warning("a goal of %s that was accepted too late goes on: %s", self._action, error)

    def _find(self, identified: Mapping[str, Any]) -> SentGoal | None:
        with self._lock:
            return self._goals.get(bytes(identified["goal_id"]["uuid"]).hex())

    def _forget(self, goal: SentGoal) -> None:
        with self._lock:
            self._goals.pop(goal.key, None)
            self._fetched.discard(goal.key)


class _Served:
    """An offered action: its services and topics, until it is closed."""

    def __init__(self, transport: Transport, action: str, action_type: str, server: GoalServer) -> None:
        self._server = server
        self._open = ExitStack()
        try:
            self._feedback = transport.advertise(action + FEEDBACK_TOPIC, f"{action_type}_FeedbackMessage", Qos.DEFAULT)
            self._open.callback(self._feedback.close)
            self._status = transport.advertise(action + STATUS_TOPIC, STATUS_TYPE, Qos.TRANSIENT_LOCAL)
            self._open.callback(self._status.close)
            server.connect(self)
            # Clients look for the service of goals: it is offered last, when everything else is there.
            for name, kind, answer in (
                (_RESULT, f"{action_type}_GetResult", self._answer_result),
                (_CANCEL, _CANCEL_TYPE, self._answer_cancel),
                (_SEND, f"{action_type}_SendGoal", self._answer_goal),
            ):
                self._open.callback(transport.serve(action + name, kind, _complete(transport, kind, answer)).close)
        except LinkError:
            self._open.close()
            raise

    def close(self) -> None:
        self._server.close()
        self._open.close()

    def tell_feedback(self, execution: Execution, message: Message) -> None:
        self._feedback.publish({"goal_id": uuid_of(execution.key), "feedback": message})

    def tell_status(self, executions: Sequence[Execution]) -> None:
        told = [{"goal_info": _info(each), "status": GOAL_NUMBERS[each.status]} for each in executions]
        self._status.publish({"status_list": told})

    def tell_result(self, execution: Execution, result: ActionResult) -> None:
        """Do nothing: clients that have requested the result are answered when the execution is over."""

    def _answer_goal(self, request: Message) -> Message:
        execution = self._server.accept(bytes(request["goal_id"]["uuid"]).hex(), request["goal"])
        stamp = time.time_ns() if execution is None else execution.accepted_ns
        return {"accepted": execution is not None, "stamp": stamp_of(stamp)}

    def _answer_cancel(self, request: Message) -> Message:
        asked = request["goal_info"]
        key = bytes(asked["goal_id"]["uuid"])
        limit = nanoseconds_of(asked["stamp"])
        if key != _EVERY and not limit:
            execution = self._server.find(key.hex())
            if execution is None:
                return {"return_code": 2, "goals_canceling": []}
            is_taken = self._server.cancel(execution)
            return {"return_code": 0 if is_taken else 3, "goals_canceling": [_info(execution)] if is_taken else []}
        # All goals, or those that were accepted by then and the one that is named.
        chosen = [
            each
            for each in self._server.executions
            if not limit or each.accepted_ns <= limit or bytes.fromhex(each.key) == key
        ]
        return {"return_code": 0, "goals_canceling": [_info(each) for each in chosen if self._server.cancel(each)]}

    def _answer_result(self, request: Message) -> Message:
        execution = self._server.find(bytes(request["goal_id"]["uuid"]).hex())
        if execution is None:
            return {"status": 0, "result": {}}
        execution.over.wait()
        result = execution.result
        return {"status": GOAL_NUMBERS[execution.status], "result": {} if result is None else result.result}


def _complete(transport: Transport, kind: str, answer: Callable[[Message], Message]) -> Callable[[Message], Message]:
    shape = transport.types.response(kind)
    return lambda request: completed(shape, answer(request), where=kind)


def _info(execution: Execution) -> dict[str, Any]:
    return {"goal_id": uuid_of(execution.key), "stamp": stamp_of(execution.accepted_ns)}
