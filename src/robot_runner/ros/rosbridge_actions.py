"""Actions of ROS 2 through a rosbridge, by the operations of rosbridge_suite since 2.0.

The behaviour of servers was read from rosbridge_library 2.0 to 3: they do not report that a goal was accepted, and
those of 2.x not even that it was rejected. So the action's topic of states is subscribed, too. It does not show whose
goal is whose: where goals of two clients cannot be distinguished, ours is cancelled, and the error says so. By default
a server handles no other operation of a connection while a goal is executed: so each goal has a connection of its own.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

from robot_runner.core.errors import GoalRejectedError, LinkError
from robot_runner.core.links.goals import ActionResult, GoalStatus
from robot_runner.core.links.robot import Message, Qos, Subscription
from robot_runner.ros.action_calls import await_action
from robot_runner.ros.graph_transport import Lane, Reception, Transport, already_offered, until
from robot_runner.ros.ros2_actions import GOAL_NUMBERS, GOAL_STATES, STATUS_TOPIC, STATUS_TYPE, ros2_action_types
from robot_runner.ros.rosbridge_frames import from_protocol, to_protocol
from robot_runner.ros.rosbridge_session import Session
from robot_runner.ros.shapes import completed

if TYPE_CHECKING:
    from robot_runner.ros.action_server import ActionTypes, Execution, GoalServer
    from robot_runner.ros.rosbridge_types import Rosapi
    from robot_runner.ros.sent_goal import SentGoal

_logger = logging.getLogger(__name__)

_REMEDY = "Have rosbridge_suite 2.0 or newer on the robot, with rosapi beside it."
#: How long a missing server is waited for, and how long offering an action may take, s.
_PATIENCE, _OFFERING = 1.5, 3.0
_POLL = 0.05
#: How late the state of an accepted goal may arrive, s: goals of two clients within this time may be confused.
_AT_ONCE = 1.0
#: How long the states of earlier goals may take to arrive, s.
_EARLIER = 0.2
#: How long after the final state a result may arrive, s.
_RESULT_SECONDS = 5.0
_NOT_OURS = "the goal that was accepted when ours was sent is over, and no result came: it was another client's"
_SWAPPED = "another client sent a goal to this action at the same time, and a rosbridge does not tell which is ours"
_ALONE = "See that nobody else sends goals to this action; or reach the robot by ros2 or dds, which tell goals apart."
_SENDING, _CANCELLING = "send_action_goal", "cancel_action_goal"


class RosbridgeActions:
    """The actions of the ROS 2 graph behind a rosbridge."""

    def __init__(self, transport: Transport, session: Session, rosapi: Rosapi, connect: Callable[[], Session]) -> None:
        self.transport = transport
        self.session = session
        self.connect = connect
        self._rosapi = rosapi
        self._served: dict[str, _Served] = {}
        self.sent: dict[str, str] = {}  # the action of each goal that is not over, by its id
        session.on_action = self._take

    def types(self, action_type: str) -> ActionTypes:
        """Return the parts of an action's type, which a rosbridge cannot report."""
        return ros2_action_types(self.transport.types, action_type)

    def actions(self) -> dict[str, str]:
        """Return the type of each offered action by full name; `*` where the server is too old to report it."""
        names = self._rosapi.action_servers()
        return {name: self._rosapi.action_type(name) or "*" for name in sorted(names)}

    def client(self, action: str, action_type: str, timeout: float) -> _Client:
        """Return a client of an action, once its server is there."""
        await_action(self.actions, action, action_type, min(timeout, _PATIENCE))
        return _Client(self, action, action_type, self.types(action_type))

    def serve(self, action: str, action_type: str, server: GoalServer) -> Subscription:
        """Let a server of this link execute goals."""
        if action in self._served or action in self.actions():
            fault = already_offered(action, what="action")
            # Its action server is never destroyed, so that nobody can offer it again.
            fix = f"{fault.fix} A rosbridge server of 2.x keeps what was offered through it: restart it."
            raise LinkError(fault.problem, where=fault.where, fix=fix)
        served = self._served[action] = _Served(self, action, action_type, server)
        try:
            served.offer()
        except LinkError:
            self.withdraw(action)
            raise
        return served

    def withdraw(self, action: str) -> None:
        """Pass on no more goals."""
        self._served.pop(action, None)

    def wait_for_offer(self, action: str) -> None:
        """Return once an action is on the graph; raise a `LinkError` where the server does not offer it."""
        if not until(lambda: self.is_served(action), _OFFERING, every=_POLL):
            problem = f"the rosbridge server does not offer the action within {_OFFERING:g} s"
            raise LinkError(problem, where=action, fix=f"{_REMEDY} The package of its type must be there, too.")

    def cancel_requests(self) -> list[dict[str, Any]]:
        """Return the operations that cancel all goals that are not over."""
        return [_cancelling(action, key) for key, action in list(self.sent.items())]

    def is_served(self, action: str) -> bool:
        """Whether a server of this action is listed."""
        return action in self._rosapi.action_servers()

    def _take(self, operation: Mapping[str, Any]) -> None:
        if (served := self._served.get(str(operation.get("action")))) is not None:
            served.take(operation)


class _Client:
    cancels_at_once: ClassVar[bool] = True

    def __init__(self, graph: RosbridgeActions, action: str, action_type: str, types: ActionTypes) -> None:
        self._graph = graph
        self._action = action
        self._type = action_type
        self._types = types
        self._lock = threading.Lock()
        self._sending = threading.Lock()  # one at a time, so that a new state belongs to the last goal
        self._connections: dict[str, Session] = {}
        self._known: dict[str, SentGoal | None] = {}
        self._unnamed: deque[SentGoal] = deque()  # goals whose id on the server is not known yet
        self._latest: tuple[SentGoal, float] | None = None
        self._expected: set[str] = set()
        self._heard = threading.Event()
        self._status = graph.transport.subscribe(
            action + STATUS_TOPIC, STATUS_TYPE, self._take_status, qos=Qos.TRANSIENT_LOCAL, lane=Lane.GOALS
        )
        self._heard.wait(_EARLIER)

    def send(self, goal: Message, sent: SentGoal, timeout: float) -> None:
        with self._sending:
            connection = self._graph.connect()
            sent.key = connection.fresh_id(f"{_SENDING}:{id(sent)}")
            connection.on_action = partial(self._take, sent)
            connection.on_lost = partial(self._lose, sent)
            with self._lock:
                self._connections[sent.key] = connection
                self._graph.sent[sent.key] = self._action
                self._unnamed.append(sent)
                self._latest = sent, time.monotonic()
            try:
                self._send(connection, goal, sent)
                sent.wait_for_status(lambda status: status is not GoalStatus.UNKNOWN, timeout)
                self._check(sent, connection, timeout)
            except LinkError:
                with self._lock, suppress(ValueError):
                    self._unnamed.remove(sent)
                raise

    def cancel(self, sent: SentGoal, timeout: float) -> None:
        del timeout
        # Over the link's own connection: that of the goal may be taken up by it. A server knows all goals by their id.
        self._graph.session.send(_cancelling(self._action, sent.key))

    def is_served(self) -> bool:
        return self._graph.is_served(self._action)

    def close(self) -> None:
        self._status.close()
        with self._lock:
            connections = list(self._connections.values())
            self._connections.clear()
        for connection in connections:
            connection.close()

    def _send(self, connection: Session, goal: Message, sent: SentGoal) -> None:
        spelt = self._type.replace("/", "/action/", 1)
        operation = {"op": _SENDING, "id": sent.key, "action": self._action, "action_type": spelt, "feedback": True}
        connection.send({**operation, "args": to_protocol(self._types.goal, goal)})

    def _check(self, sent: SentGoal, connection: Session, timeout: float) -> None:
        fault = sent.fault
        if fault is None and sent.status is GoalStatus.UNKNOWN:
            sent.is_abandoned = True
            with suppress(LinkError):
                self.cancel(sent, timeout)
            complaint = connection.complaint(sent.key)
            problem = complaint or f"the action server does not accept the goal within {timeout:g} s"
            hint = "" if complaint else "Check whether its node is busy or rejects it: servers of 2.x do not tell. "
            fix = f"{hint}{_REMEDY}"
            fault = LinkError(problem, where=self._action, fix=fix)
        if fault is not None:
            self._leave(sent)
            raise fault

    def _lose(self, sent: SentGoal, error: LinkError) -> None:
        """End a goal whose own connection is lost, as its result can no longer arrive."""
        sent.lose(error)
        with suppress(LinkError):
            self.cancel(sent, 0.0)

    def _take(self, sent: SentGoal, operation: Mapping[str, Any]) -> None:
        if operation.get("id") != sent.key:
            return
        with self._lock:
            connection = self._connections.get(sent.key)
        if connection is None:
            return
        if operation["op"] == "action_feedback":
            connection.later(partial(self._take_feedback, sent, operation.get("values")))
        elif operation["op"] == "action_result":
            connection.later(partial(self._take_result, sent, operation))

    def _take_feedback(self, sent: SentGoal, values: Any) -> None:
        if sent.status in {GoalStatus.UNKNOWN, GoalStatus.ACCEPTED}:
            sent.note(GoalStatus.EXECUTING)
        sent.take_feedback(from_protocol(self._types.feedback, values, where=self._action))

    def _take_result(self, sent: SentGoal, operation: Mapping[str, Any]) -> None:
        if operation.get("result") is False:
            problem = f"the goal failed: {operation.get('values')}"
            kind = GoalRejectedError if "reject" in problem else LinkError
            sent.lose(kind(problem, where=self._action, fix="Look at the log of the action's node."))
        else:
            told = GOAL_STATES.get(operation.get("status", 0), GoalStatus.UNKNOWN)
            if not told.is_over:  # servers before 2.0 leave it out
                told = GoalStatus.CANCELED if sent.status is GoalStatus.CANCELING else GoalStatus.ABORTED
            values = from_protocol(self._types.result, operation.get("values") or {}, where=self._action)
            sent.finish(ActionResult(told, values))
        # In another thread: this one is the connection's own.
        threading.Thread(target=self._leave, args=(sent,), name="action connection", daemon=True).start()

    def _take_status(self, reception: Reception) -> None:
        for told in reception.message()["status_list"]:
            status = GOAL_STATES.get(told["status"], GoalStatus.UNKNOWN)
            goal = self._goal_of(bytes(told["goal_info"]["goal_id"]["uuid"]).hex(), status)
            if goal is not None and not status.is_over:
                goal.note(status)  # the end comes with the result
            elif goal is not None and not goal.is_over and goal.key not in self._expected:
                self._expected.add(goal.key)
                timer = threading.Timer(_RESULT_SECONDS, self._give_up, (goal, _NOT_OURS))
                timer.daemon = True
                timer.start()
        self._heard.set()

    def _goal_of(self, key: str, status: GoalStatus) -> SentGoal | None:
        """Return our goal with this id on the server, as far as that can be known; None for another's."""
        with self._lock:
            if key in self._known:
                return self._known[key]
            if status.is_over:  # one that was there before, or one of ours whose result comes by itself
                self._known[key] = None
                return None
            while self._unnamed and self._unnamed[0].is_over:
                self._unnamed.popleft()
            goal = self._known[key] = self._unnamed.popleft() if self._unnamed else None
            is_swapped = goal is None and self._latest is not None and time.monotonic() - self._latest[1] < _AT_ONCE
        if is_swapped and self._latest is not None:
            self._give_up(self._latest[0], _SWAPPED)
        return goal

    def _give_up(self, sent: SentGoal, why: str) -> None:
        """End a goal whose id on the server is not known; the rosbridge itself knows it by our id."""
        if not sent.is_over:
            with suppress(LinkError):
                error = LinkError(why, where=self._action, fix=_ALONE)
                sent.lose(error, before_told=partial(self.cancel, sent, 0.0))

    def _leave(self, sent: SentGoal) -> None:
        with self._lock:
            connection = self._connections.pop(sent.key, None)
            self._graph.sent.pop(sent.key, None)
        if connection is not None:
            connection.close()


def _cancelling(action: str, key: str) -> dict[str, Any]:
    return {"op": _CANCELLING, "id": key, "action": action}


class _Served:
    """An action offered through the server, until it is closed."""

    def __init__(self, graph: RosbridgeActions, action: str, action_type: str, server: GoalServer) -> None:
        self._graph = graph
        self._action = action
        self._type = action_type
        self._server = server
        self._lock = threading.Lock()
        # Goals that are not accepted or rejected yet, and whether they have to be cancelled then.
        self._arriving: dict[str, bool] = {}
        server.connect(self)

    def offer(self) -> None:
        operation = {"op": "advertise_action", "action": self._action, "type": self._type.replace("/", "/action/", 1)}
        try:
            self._graph.session.request(operation, where=self._action)
        except LinkError as error:
            raise LinkError(error.problem, where=self._action, fix=_REMEDY) from error
        self._graph.wait_for_offer(self._action)

    def close(self) -> None:
        self._server.close()
        self._graph.withdraw(self._action)
        if self._graph.session.is_usable:
            self._graph.session.request({"op": "unadvertise_action", "action": self._action}, where=self._action)

    def take(self, operation: Mapping[str, Any]) -> None:
        key = str(operation.get("id"))
        with self._lock:
            execution = self._server.find(key)
            if operation["op"] != _CANCELLING:
                self._arriving[key] = False
            elif execution is None and key in self._arriving:
                self._arriving[key] = True
        if operation["op"] != _CANCELLING:
            # In another thread: `accept` may call the robot, whose answers are received in this one.
            threading.Thread(target=self._accept, args=(key, operation), name="rosbridge goal", daemon=True).start()
        elif execution is not None:
            self._server.cancel(execution)

    def _accept(self, key: str, operation: Mapping[str, Any]) -> None:
        text = "the goal is rejected"
        try:
            goal = from_protocol(self._server.types.goal, operation.get("args") or {}, where=self._action)
            execution = self._server.accept(key, goal)
        except LinkError as error:
            execution, text = None, error.problem
        with self._lock:
            is_to_end = self._arriving.pop(key, False)
        if execution is None:
            # The server has accepted it for us: all that is left is to give it up.
            empty = completed(self._server.types.result, {}, where=self._action)
            with suppress(LinkError):  # the connection is lost
                self._tell_end(key, ActionResult(GoalStatus.ABORTED, empty, text))
        elif is_to_end:
            self._server.cancel(execution)

    def tell_feedback(self, execution: Execution, message: Message) -> None:
        values = to_protocol(self._server.types.feedback, message)
        operation = {"op": "action_feedback", "action": self._action, "id": execution.key, "values": values}
        self._graph.session.send(operation)

    def tell_status(self, executions: Sequence[Execution]) -> None:
        """Do nothing: the server reports the states."""

    def tell_result(self, execution: Execution, result: ActionResult) -> None:
        self._tell_end(execution.key, result)

    def _tell_end(self, key: str, result: ActionResult) -> None:
        values = to_protocol(self._server.types.result, result.result)
        operation = {"op": "action_result", "action": self._action, "id": key, "values": values, "result": True}
        self._graph.session.send({**operation, "status": GOAL_NUMBERS[result.status]})
