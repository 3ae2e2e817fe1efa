"""Goals that a link sends to action servers: they are followed until they are over, over any protocol."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Protocol

from robot_runner.core.errors import LinkError, did_you_mean
from robot_runner.core.links.commanded_topics import CANCELLING, tell_commanded
from robot_runner.core.links.goals import GoalStatus
from robot_runner.core.links.robot import GraphEndpoint, Message, Subscription
from robot_runner.core.words import enumerated
from robot_runner.ros.link_faults import as_link_error
from robot_runner.ros.sent_goal import ActionClient, SentGoal
from robot_runner.ros.shapes import completed

if TYPE_CHECKING:
    from robot_runner.ros.action_server import ActionTypes, GoalServer

_logger = logging.getLogger(__name__)

#: How long all goals that are not over may take to end when their link is closed, s.
CLOSING_SECONDS = 2.0
#: How often to look for an action that is not offered yet, s.
_POLL = 0.05


class ActionDialect(Protocol):
    """The protocol of a graph for actions: over services and topics, over topics only, or its own."""

    def types(self, action_type: str) -> ActionTypes:
        """Return the message types of an action; raise a `LinkError` where there is no such type."""

    def actions(self) -> Mapping[str, str]:
        """Return the type of each action that is offered, by full name."""

    def client(self, action: str, action_type: str, timeout: float) -> ActionClient:
        """Return a client of an action; raise a `LinkError` where it is not offered, or has another type."""

    def serve(self, action: str, action_type: str, server: GoalServer) -> Subscription:
        """Offer an action by a server of this link; raise a `LinkError` where it is offered already."""


def missing_action(action: str, action_type: str, known: Mapping[str, str]) -> LinkError:
    """Return the error that no node offers an action of this type; it names a similar one.

    Example:
        >>> missing_action("/navigate_to_pos", "nav2_msgs/NavigateToPose", {"/navigate_to_pose": ""}).fix
        "Did you mean '/navigate_to_pose'?"
    """
    if true := known.get(action):
        problem = f"the action is of the type {true}, not {action_type}"
        return LinkError(problem, where=action, fix=f"Name the type {true!r}.")
    fix = did_you_mean(action, known, "Start the node that offers it.")
    return LinkError(f"there is no action {action!r}", where=action, fix=fix)


def await_action(actions: Callable[[], Mapping[str, str]], action: str, action_type: str, seconds: float) -> None:
    """Return once `actions` has the action with this type, or with an unknown one.

    A `LinkError` says that it has another type, or is not offered within `seconds`.
    """
    deadline = time.monotonic() + seconds
    while (known := actions()).get(action) not in {action_type, "*"}:
        if time.monotonic() > deadline or action in known:
            raise missing_action(action, action_type, known)
        time.sleep(_POLL)


def check_one_server(action: str, servers: Iterable[GraphEndpoint]) -> None:
    """Raise a `LinkError` where several nodes, the publishers of its states, offer an action: each would execute goals.

    Example:
        >>> check_one_server("/dock", [])
    """
    names = sorted(map(str, servers))
    if len(names) > 1:
        problem = f"{len(names)} nodes offer the action: {enumerated(names)}"
        raise LinkError(problem, where=action, fix="End all but one, or give the robots namespaces of their own.")


class LinkGoals:
    """The goals of one link: its clients of actions, and the goals to be cancelled when it is closed.

    `wait` is the transport's; `check_open` raises a `LinkError` where the link is closed, or is about to be;
    `has_threads` says whether the transport may be used in several threads.
    """

    def __init__(
        self,
        dialect: ActionDialect,
        wait: Callable[[threading.Event, float], None],
        check_open: Callable[[str], None],
        *,
        has_threads: bool = True,
    ) -> None:
        self._dialect = dialect
        self._wait = wait
        self._check_open = check_open
        self._has_threads = has_threads
        self._lock = threading.Lock()
        self._clients: dict[tuple[str, str], ActionClient] = {}
        self._goals: list[SentGoal] = []
        self._asked: dict[SentGoal, threading.Event] = {}
        self._told: set[str] = set()
        self._is_closed = False

    def send(
        self,
        action: str,
        action_type: str,
        goal: Message,
        take_feedback: Callable[[Message], None],
        timeout: float,
        graph: str | None = None,
    ) -> SentGoal:
        """Send a goal, and return it once it is accepted, within `timeout` (s).

        Before the first, a standby is told of the action; `graph` is the link's, None for a robot in this process.
        """
        complete = completed(self._dialect.types(action_type).goal, goal, where=action)
        client = self._client(action, action_type, timeout)
        sent = SentGoal(action, self._wait, take_feedback)
        sent.client = client
        if action not in self._told:
            self._tell(action, client, graph)
        with self._lock:
            self._check_open(action)  # again, as finding the server may have taken seconds
            self._goals = [each for each in self._goals if not each.is_over]
            self._goals.append(sent)  # before it is accepted, so that closing the link meanwhile cancels it
        try:
            client.send(complete, sent, timeout)
            if self._is_closed and not sent.is_over:  # the link could not cancel it, as it had not been sent
                sent.ask_for_end(CLOSING_SECONDS)
                self._check_open(action)
        except Exception as error:
            sent.is_abandoned = True
            status = sent.status
            sent.lose(as_link_error(error, where=action))
            if status is not GoalStatus.UNKNOWN and not status.is_over:  # it was accepted before it was given up here
                with suppress(Exception):  # the first exception is the one to raise
                    client.cancel(sent, CLOSING_SECONDS)
            raise
        return sent

    def ask_for_ends(self) -> None:
        """Cancel all goals that are not over at once, without waiting for servers; `close` reports failures."""
        with self._lock:
            fresh = {goal: threading.Event() for goal in self._open_goals() if goal not in self._asked}
            self._asked |= fresh
        for asking in (partial(_ask, goal, asked) for goal, asked in fresh.items()):
            if self._has_threads:
                threading.Thread(target=asking, name="end of a goal", daemon=True).start()
            else:
                asking()

    def close(self) -> None:
        """Cancel the goals that are not over, wait briefly for their ends, and leave the actions.

        A `LinkError` says that one of them could not be cancelled.
        """
        deadline = time.monotonic() + CLOSING_SECONDS
        faults: list[LinkError] = []
        with self._lock:
            self._is_closed = True
            open_goals = self._open_goals()
            clients = list(self._clients.values())
        self.ask_for_ends()
        for asked in list(self._asked.values()):
            with suppress(Exception):  # it is cancelled again below, and failures are reported then
                self._wait(asked, max(0.0, deadline - time.monotonic()))  # this thread may be the one that receives
        for goal in open_goals:
            try:
                goal.cancel(timeout=max(0.1, deadline - time.monotonic()))
            except Exception as error:  # noqa: BLE001 - any failure: it is reported, and the others are cancelled
                faults.append(as_link_error(error, where=goal.action))
        for client in clients:
            _leave(client)
        if faults:
            first = faults[0]
            problem = f"a goal that is not over could not be cancelled: {first.problem}"
            raise LinkError(problem, where=first.where, fix=f"See that the robot stands still. {first.fix}") from first

    def _tell(self, action: str, client: ActionClient, graph: str | None) -> None:
        """Tell a standby of an action; leave it where others have the robot, whose goals must not be cancelled."""
        try:
            tell_commanded(action, CANCELLING, graph)
        except LinkError:
            with self._lock:
                self._clients = {key: each for key, each in self._clients.items() if each is not client}
            _leave(client)
            raise
        self._told.add(action)

    def _open_goals(self) -> list[SentGoal]:
        # In ROS 1, cancelling a goal that has no key yet would cancel those of all clients.
        return [goal for goal in self._goals if goal.key and not goal.is_over]

    def _client(self, action: str, action_type: str, timeout: float) -> ActionClient:
        with self._lock:
            known = self._clients.get((action, action_type))
        if known is not None and known.is_served():
            return known
        fresh = self._dialect.client(action, action_type, timeout)
        stale: ActionClient | None
        with self._lock:
            there = self._clients.get((action, action_type))
            if self._is_closed or there is not known:  # meanwhile another thread has closed the link, or made a client
                stale, chosen = fresh, there or fresh
            else:
                stale, chosen = known, fresh
                self._clients[action, action_type] = fresh
        if stale is not None:
            _leave(stale)
        return chosen


def _ask(goal: SentGoal, is_over: threading.Event) -> None:
    with suppress(Exception):  # as above
        goal.ask_for_end(CLOSING_SECONDS)
    is_over.set()


def _leave(client: ActionClient) -> None:
    try:
        client.close()
    except Exception as error:  # noqa: BLE001 - of whichever kind: nothing depends on it
        _logger.info("an action could not be left: %s", error)
