"""Actions of ROS 1's actionlib: five topics below the action's name, and states that are published periodically.

Source: wiki.ros.org/actionlib/DetailedDescription, and the client and server of actionlib.
"""

from __future__ import annotations

import itertools
import logging
import os
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar

from robot_runner.core.errors import GoalRejectedError, LinkError
from robot_runner.core.links.goals import ActionResult, GoalStatus
from robot_runner.core.links.robot import Message, Qos, Subscription
from robot_runner.ros.action_calls import await_action, check_one_server
from robot_runner.ros.action_server import ActionTypes, Execution, GoalServer, part_of
from robot_runner.ros.graph_transport import GraphTypes, Lane, Reception, TopicPublisher, Transport, already_offered
from robot_runner.ros.shapes import completed, nanoseconds_of, stamp_of

if TYPE_CHECKING:
    from robot_runner.ros.sent_goal import SentGoal

_logger = logging.getLogger(__name__)

_GOAL, _CANCEL, _STATUS, _FEEDBACK, _RESULT = "/goal", "/cancel", "/status", "/feedback", "/result"
#: Of the request to cancel a goal; an empty one cancels all goals of its server.
GOAL_ID_TYPE = "actionlib_msgs/GoalID"
_STATUS_TYPE = "actionlib_msgs/GoalStatusArray"
_GOAL_ENDING, _RESULT_ENDING = "ActionGoal", "ActionResult"
#: actionlib_msgs/GoalStatus: pending, active, preempted, succeeded, aborted, rejected, preempting, recalling, recalled,
#: lost.
_STATES: Mapping[int, GoalStatus] = MappingProxyType(
    {
        0: GoalStatus.ACCEPTED,
        1: GoalStatus.EXECUTING,
        2: GoalStatus.CANCELED,
        3: GoalStatus.SUCCEEDED,
        4: GoalStatus.ABORTED,
        5: GoalStatus.REJECTED,
        6: GoalStatus.CANCELING,
        7: GoalStatus.CANCELING,
        8: GoalStatus.CANCELED,
        9: GoalStatus.ABORTED,
    }
)
#: The number to publish for each status: of several with one meaning, the first.
_NUMBERS: Mapping[GoalStatus, int] = MappingProxyType(
    {GoalStatus.UNKNOWN: 0, **{status: number for number, status in reversed(list(_STATES.items()))}}
)
#: How often a server publishes its states, s, and for how long after a goal is over: as in actionlib.
_STATUS_PERIOD, _STATUS_SECONDS = 0.2, 5.0
#: A server that publishes no states for so long counts as gone, s: actionlib's own limit.
_SILENCE = 5.0
#: A server that has published its states within so long is there, s.
_HEARD = 1.0
#: How long a missing server is waited for, s: as long as a node takes to start.
_PATIENCE = 1.5
#: How long after the final state a result may arrive, s.
_RESULT_SECONDS = 3.0
#: A goal that has not been among the states for so long, s, which come five times a second, is unknown to its server.
_FORGOTTEN = 1.0


def ros1_action_types(types: GraphTypes, action_type: str) -> ActionTypes:
    """Return the parts of an action's type, from the types of its topics; raise a `LinkError` for an unknown type."""
    try:
        parts = ("Goal", "Result", "Feedback")
        return ActionTypes(*(part_of(types.shape(f"{action_type}Action{part}"), part.lower()) for part in parts))
    except LinkError as error:
        problem = f"there is no action type {action_type!r}: {error.problem}"
        raise LinkError(problem, where=action_type, fix=error.fix.replace(_GOAL_ENDING, "")) from error


class Ros1Actions:
    """The actions of a graph of ROS 1, over the primitives of a transport."""

    def __init__(self, transport: Transport) -> None:
        self._transport = transport

    def types(self, action_type: str) -> ActionTypes:
        """Return the parts of an action's type."""
        return ros1_action_types(self._transport.types, action_type)

    def actions(self) -> dict[str, str]:
        """Return the type of each action whose states are published and whose goals are subscribed, by full name."""
        # From the topics that the server publishes: the graph may not know the types of those that it subscribes.
        topics = self._transport.topics()
        return {
            name: kind.removesuffix(_RESULT_ENDING)
            for topic, kind in sorted(topics.items())
            if topic.endswith(_RESULT) and kind.endswith(_RESULT_ENDING)
            for name in [topic.removesuffix(_RESULT)]
            if topics.get(name + _STATUS) == _STATUS_TYPE and self._is_served(name)
        }

    def client(self, action: str, action_type: str, timeout: float) -> _Client:
        """Return a client of an action, once its server is there."""
        await_action(self.actions, action, action_type, min(timeout, _PATIENCE))
        client = _Client(self._transport, action, action_type)
        client.await_server(timeout)
        return client

    def serve(self, action: str, action_type: str, server: GoalServer) -> Subscription:
        """Let a server of this link execute goals."""
        if action in self.actions():
            raise already_offered(action, what="action")
        return _Served(self._transport, action, action_type, server)

    def _is_served(self, name: str) -> bool:
        # A rosbridge server stays a publisher for 10 s after its client has left, but ends subscriptions at once.
        asked = self._transport
        return bool(list(asked.publishers(name + _STATUS))) and bool(list(asked.subscribers(name + _GOAL)))


class _Client:
    cancels_at_once: ClassVar[bool] = False
    _numbers = itertools.count(1)

    def __init__(self, transport: Transport, action: str, action_type: str) -> None:
        self._transport = transport
        self._action = action
        self._goals: dict[str, SentGoal] = {}
        self._listed: dict[str, float] = {}
        self._expected: set[str] = set()
        self._lock = threading.Lock()
        self._heard = threading.Event()
        self._heard_at = time.monotonic()
        self._open = ExitStack()
        try:
            # The states last: once they arrive, the server has had the time to connect to the others.
            for name, kind, take in (
                (_RESULT, f"{action_type}ActionResult", self._take_result),
                (_FEEDBACK, f"{action_type}ActionFeedback", self._take_feedback),
                (_STATUS, _STATUS_TYPE, self._take_status),
            ):
                self._open.callback(transport.subscribe(action + name, kind, take, qos=None, lane=Lane.GOALS).close)
            self._send = _advertised(self._open, transport, action + _GOAL, f"{action_type}{_GOAL_ENDING}")
            self._cancel = _advertised(self._open, transport, action + _CANCEL, GOAL_ID_TYPE)
        except Exception:
            self._open.close()
            raise

    def await_server(self, timeout: float) -> None:
        """Wait until the server publishes its states; raise a `LinkError` where it does not in time."""
        self._transport.wait(self._heard, timeout)
        if not self._heard.is_set():
            self.close()
            problem = f"the action server does not report its states within {timeout:g} s"
            raise LinkError(problem, where=self._action, fix="Check whether its node is alive and reachable from here.")

    def send(self, goal: Message, sent: SentGoal, timeout: float) -> None:
        check_one_server(self._action, self._transport.publishers(self._action + _STATUS))
        sent.key = f"/robot_runner_{os.getpid()}-{next(self._numbers)}-{time.time():.6f}"
        with self._lock:
            self._goals[sent.key] = sent
        stamp = stamp_of(time.time_ns())
        header = {"seq": 0, "stamp": stamp, "frame_id": ""}
        self._send.publish({"header": header, "goal_id": {"stamp": stamp, "id": sent.key}, "goal": goal})
        sent.wait_for_status(lambda status: status not in {GoalStatus.UNKNOWN, GoalStatus.ACCEPTED}, timeout)
        if sent.status is GoalStatus.REJECTED:
            self._forget(sent)
            fix = "Look at the log of its node: it may be busy, or not active yet."
            raise GoalRejectedError("the action server rejects the goal", where=self._action, fix=fix)
        if sent.status in {GoalStatus.UNKNOWN, GoalStatus.ACCEPTED}:
            self._publish_cancel(sent)  # a goal without a caller must not begin later
            is_waiting = sent.status is GoalStatus.ACCEPTED
            problem = "leaves the goal waiting" if is_waiting else "does not answer"
            fix = "Check whether it is busy with another goal, or give a longer timeout."
            raise LinkError(f"the action server {problem} for {timeout:g} s", where=self._action, fix=fix)

    def cancel(self, sent: SentGoal, timeout: float) -> None:
        self._publish_cancel(sent)
        self._cancel.flush(timeout)

    def is_served(self) -> bool:
        # A killed server stays registered at the master, but is silent. For one that still publishes, the master
        # is not asked: a master that hangs would delay a request to cancel.
        silence = time.monotonic() - self._heard_at
        return silence < _HEARD or (
            silence < _SILENCE and bool(list(self._transport.publishers(self._action + _STATUS)))
        )

    def close(self) -> None:
        self._open.close()

    def _publish_cancel(self, sent: SentGoal) -> None:
        self._cancel.publish({"stamp": stamp_of(0), "id": sent.key})

    def _take_status(self, reception: Reception) -> None:
        self._heard_at = time.monotonic()
        self._heard.set()
        for told in reception.message()["status_list"]:
            if (goal := self._find(told)) is not None:
                self._listed[goal.key] = self._heard_at
                status = _STATES.get(told["status"], GoalStatus.UNKNOWN)
                goal.note(status)
                if goal.is_abandoned and not status.is_over:
                    self._publish_cancel(goal)  # accepted after its deadline: no caller waits for it
                if status.is_over and status is not GoalStatus.REJECTED:
                    self._expect_result(goal, told["text"])
        self._lose_forgotten()

    def _lose_forgotten(self) -> None:
        """End the goals that the server no longer knows, as one that was started anew; actionlib's clients do, too."""
        with self._lock:
            listed = [(self._listed.get(key), goal) for key, goal in self._goals.items()]
        for at, goal in listed:
            if at is not None and self._heard_at - at > _FORGOTTEN:
                self._forget(goal)
                problem = "the action server does not know the goal any more: it may have been started anew"
                goal.lose(LinkError(problem, where=self._action, fix="Look at the log of its node."))

    def _expect_result(self, goal: SentGoal, text: str) -> None:
        """End the goal as lost if its result does not arrive in time after the final state."""
        with self._lock:
            if goal.key in self._expected or goal.key not in self._goals:
                return
            self._expected.add(goal.key)

        def lose() -> None:
            self._forget(goal)
            problem = f"the goal is {goal.status}, and its result did not come: {text}".rstrip(": ")
            goal.lose(LinkError(problem, where=self._action, fix="Send the goal again."))

        timer = threading.Timer(_RESULT_SECONDS, lose)
        timer.daemon = True
        timer.start()

    def _take_feedback(self, reception: Reception) -> None:
        message = reception.message()
        if (goal := self._find(message["status"])) is not None:
            goal.take_feedback(message["feedback"])

    def _take_result(self, reception: Reception) -> None:
        message = reception.message()
        told = message["status"]
        if (goal := self._find(told)) is not None:
            self._forget(goal)
            goal.finish(ActionResult(_STATES.get(told["status"], GoalStatus.UNKNOWN), message["result"], told["text"]))

    def _find(self, told: Mapping[str, Any]) -> SentGoal | None:
        with self._lock:
            return self._goals.get(told["goal_id"]["id"])

    def _forget(self, goal: SentGoal) -> None:
        with self._lock:
            self._goals.pop(goal.key, None)
            self._expected.discard(goal.key)
            self._listed.pop(goal.key, None)


class _Served:
    """An offered action: its five topics, until it is closed."""

    def __init__(self, transport: Transport, action: str, action_type: str, server: GoalServer) -> None:
        self._server = server
        self._rejected: list[tuple[str, float]] = []
        self._stamps: dict[str, dict[str, int]] = {}
        self._lock = threading.Lock()
        self._taking = threading.RLock()
        self._is_closed = threading.Event()
        self._open = ExitStack()
        try:
            with self._taking:  # a goal may arrive before the topic of its states exists
                self._begin(transport, action, action_type)
        except Exception:
            server.close()
            self._open.close()
            raise
        self._thread = threading.Thread(target=self._tell_again, name="action states", daemon=True)
        self._thread.start()

    def _begin(self, transport: Transport, action: str, action_type: str) -> None:
        self._result = _advertised(self._open, transport, action + _RESULT, f"{action_type}ActionResult")
        self._feedback = _advertised(self._open, transport, action + _FEEDBACK, f"{action_type}ActionFeedback")
        self._server.connect(self)
        for name, kind, take in (
            (_GOAL, f"{action_type}{_GOAL_ENDING}", self._take_goal),
            (_CANCEL, GOAL_ID_TYPE, self._take_cancel),
        ):
            self._open.callback(transport.subscribe(action + name, kind, take, qos=None, lane=Lane.GOALS).close)
        self._status = _advertised(self._open, transport, action + _STATUS, _STATUS_TYPE)

    def close(self) -> None:
        self._server.close()
        self._is_closed.set()
        if self._thread is not threading.current_thread():
            self._thread.join(_STATUS_SECONDS)
        self._open.close()

    def tell_feedback(self, execution: Execution, message: Message) -> None:
        told = self._told(execution.key, execution.status)
        self._feedback.publish({"header": _header(), "status": told, "feedback": message})

    def tell_status(self, executions: Sequence[Execution]) -> None:
        now = time.monotonic()
        with self._lock:
            self._rejected = [each for each in self._rejected if now - each[1] < _STATUS_SECONDS]
            told = [self._told(key, GoalStatus.REJECTED) for key, _ in self._rejected]
            told += [
                self._told(each.key, each.status, "" if each.result is None else each.result.text)
                for each in executions
                if not each.over.is_set() or now - each.over_since < _STATUS_SECONDS
            ]
            self._status.publish({"header": _header(), "status_list": told})

    def tell_result(self, execution: Execution, result: ActionResult) -> None:
        told = self._told(execution.key, result.status, result.text)
        self._result.publish({"header": _header(), "status": told, "result": result.result})

    def _take_goal(self, reception: Reception) -> None:
        message = reception.message()
        named = message["goal_id"]
        stamp = named["stamp"]
        key = named["id"] or f"{stamp['sec']}.{stamp['nanosec']:09}"
        with self._taking:
            self._stamps[key] = stamp
            is_rejected = self._server.find(key) is None and self._server.accept(key, message["goal"]) is None
            if is_rejected:
                with self._lock:
                    self._rejected.append((key, time.monotonic()))
            self._forget_stamps()
        if is_rejected:
            self._result.publish(
                {
                    "header": _header(),
                    "status": self._told(key, GoalStatus.REJECTED, "the goal is not taken"),
                    "result": completed(self._server.types.result, {}, where=self._server.action),
                }
            )
        self.tell_status(self._server.executions)

    def _forget_stamps(self) -> None:
        """Drop the stamps of goals whose states are no longer published: a server may live for months."""
        with self._lock:
            told = {key for key, _ in self._rejected}
        told |= {each.key for each in self._server.executions}
        self._stamps = {key: stamp for key, stamp in self._stamps.items() if key in told}

    def _take_cancel(self, reception: Reception) -> None:
        asked = reception.message()
        limit = nanoseconds_of(asked["stamp"])
        with self._taking:
            executions = self._server.executions
        for execution in executions:
            stamp = nanoseconds_of(self._stamps.get(execution.key, {"sec": 0, "nanosec": 0}))
            is_all = not asked["id"] and not limit
            if is_all or asked["id"] == execution.key or (limit and stamp <= limit):
                self._server.cancel(execution)

    def _tell_again(self) -> None:
        while not self._is_closed.wait(_STATUS_PERIOD):
            try:
                self.tell_status(self._server.executions)
            except LinkError as error:
                _logger.info("the states of an action are not reported any more: %s", error)
                return

    def _told(self, key: str, status: GoalStatus, text: str = "") -> dict[str, Any]:
        stamp = self._stamps.get(key, {"sec": 0, "nanosec": 0})
        return {"goal_id": {"stamp": stamp, "id": key}, "status": _NUMBERS[status], "text": text}


def _advertised(opened: ExitStack, transport: Transport, topic: str, message_type: str) -> TopicPublisher:
    publisher = transport.advertise(topic, message_type, Qos.DEFAULT)
    opened.callback(publisher.close)
    return publisher


def _header() -> dict[str, Any]:
    return {"seq": 0, "stamp": stamp_of(time.time_ns()), "frame_id": ""}
