"""Sees that one node tells a robot's pose and that nobody else commands it, before it moves and while it does."""

from __future__ import annotations

import threading
from contextlib import ExitStack
from typing import TYPE_CHECKING

from robot_runner.core.errors import Finding, LinkError
from robot_runner.core.words import enumerated
from robot_runner.ros.graph_links import full_name
from robot_runner.ros.sent_velocities import is_from_here
from robot_runner.ros.watchdog import TWIST, VELOCITY_COMMANDS, planar, velocity_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from robot_runner.core.links.robot import GraphEndpoint, Message, RobotLink

__all__ = ["SoleControl"]

#: How often the publishers of the pose are looked up, s: a look is a question to the ROS master or to rosapi, which
#: costs the robot's computer some milliseconds.
_PERIOD = 1.0
#: How long our thread may take to end, s: a graph that is lost answers no sooner than its own deadline.
_PATIENCE = 5.0
#: The node of our own watchdog commands the robot to stand still when a run has fallen silent.
_WATCHDOG = "robot_runner_watchdog"


class SoleControl:
    """Watches over the topics of one robot; what it finds is told once.

    Args:
        link: to the robot.
        namespace: the robot's.
        pose_topic: the topic on which it tells its pose.
        command_topic: the topic on which velocities are commanded.
        where: the plugin, for errors.
    """

    def __init__(
        self,
        link: RobotLink,
        *,
        namespace: str,
        pose_topic: str,
        command_topic: str,
        where: str,
    ) -> None:
        self._link = link
        self._pose_topic = full_name(namespace, pose_topic)
        self._command_topic = full_name(namespace, command_topic)
        self._where = where
        self._is_over = threading.Event()
        self._closing = ExitStack()
        self._has_told = False

    def check(self) -> Sequence[Finding]:
        """Return what stands in the way of moving this robot and no other: errors, and warnings.

        Raises:
            LinkError: the graph cannot be asked.
        """
        return [*self._pose_findings(), *self._command_findings()]

    def begin(self, tell: Callable[[str], object]) -> None:
        """Watch until `end`, from threads; `tell` is called with the first thing that is found.

        Raises:
            LinkError: the commands cannot be heard.
        """
        types = {each.message_type for each in self._link.subscribers(self._command_topic)} & VELOCITY_COMMANDS
        for message_type in sorted(types) or [TWIST]:  # a graph that does not tell the type carries what we publish
            hear = self._hearer(message_type, tell)
            self._closing.callback(self._link.subscribe(self._command_topic, message_type, hear).close)
        watching = threading.Thread(target=self._watch, args=(tell,), name="sole control", daemon=True)
        watching.start()
        self._closing.callback(watching.join, _PATIENCE)
        self._closing.callback(self._is_over.set)

    def end(self) -> None:
        """Watch no more; ending twice does nothing."""
        self._closing.close()

    def _pose_findings(self) -> Iterator[Finding]:
        others = self._others(self._link.publishers(self._pose_topic))
        if len(others) > 1:
            problem = f"{_named(others)} publish {self._pose_topic!r}, so that it is not known where the robot is"
            yield Finding.error(self._where, problem, "End all but one of them, or give each robot a namespace.")

    def _command_findings(self) -> Iterator[Finding]:
        listening = self._others(self._link.subscribers(self._command_topic))
        obeying = [each for each in listening if each.message_type in VELOCITY_COMMANDS or not each.message_type]
        if listening and not obeying:
            types = enumerated(sorted({each.message_type for each in listening}))
            problem = f"{_named(listening)} subscribes {self._command_topic!r} as {types}, which is no velocity command"
            fix = f"Have the robot subscribe {' or '.join(sorted(VELOCITY_COMMANDS))}, or correct its namespace."
            yield Finding.error(self._where, problem, fix)
        rivals = [each for each in self._others(self._link.publishers(self._command_topic)) if not _is_watchdog(each)]
        if rivals:
            problem = f"{_named(rivals)} could command the robot, too, on {self._command_topic!r}"
            yield Finding.warning(self._where, problem, "End it: once it commands anything, the run fails.")

    def _hearer(self, message_type: str, tell: Callable[[str], object]) -> Callable[[Message], None]:
        def hear(message: Message) -> None:
            velocity = planar(velocity_of(message_type, message))
            if not is_from_here(self._command_topic, velocity) and not self._is_over.is_set():
                rivals = self._others(self._link.publishers(self._command_topic))
                who = _named(rivals) if rivals else "somebody else"
                figures = f"{velocity[0]:g} m/s, {velocity[1]:g} rad/s"
                self._tell(tell, f"{who} commands the robot on {self._command_topic!r}: {figures}")

        return hear

    def _watch(self, tell: Callable[[str], object]) -> None:
        while not self._is_over.wait(_PERIOD):
            try:
                findings = [finding for finding in self._pose_findings() if finding.is_error]
            except LinkError:  # a graph that is lost falls silent: the odometry says so within its own time
                continue
            for finding in findings:
                self._tell(tell, finding.problem)

    def _tell(self, tell: Callable[[str], object], problem: str) -> None:
        if not self._has_told and not self._is_over.is_set():
            self._has_told = True
            tell(problem)

    def _others(self, endpoints: Sequence[GraphEndpoint]) -> list[GraphEndpoint]:
        return [each for each in endpoints if not each.is_own]


def _named(endpoints: Sequence[GraphEndpoint]) -> str:
    return enumerated(sorted(str(each) for each in endpoints))


def _is_watchdog(endpoint: GraphEndpoint) -> bool:
    return endpoint.node.rpartition("/")[2] == _WATCHDOG
