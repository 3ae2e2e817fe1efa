"""The simulated robot on a real graph, as a process of its own, and who looks at it from outside."""

from __future__ import annotations

import subprocess
import threading
import time
from bisect import bisect_right
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import takewhile
from operator import itemgetter
from typing import TYPE_CHECKING, Any

from tests.forked_program import SIMULATES, ForkedProgram

from robot_runner.core.events.context import SystemClock
from robot_runner.core.links.robot_name import RobotName
from robot_runner.ros.graph_links import GRAPH_LINKS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

PATIENCE = 60.0
STREAMS = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE}
STANDSTILL = 0.01  # m/s
#: A robot that brakes rocks: its speed goes through zero once before it stands.
_IN_A_ROW = 3


@contextmanager
def simulated_robot(link: str, *options: str) -> Iterator[str]:
    """Offer a robot until the context ends; yields the port of its power meter."""
    words = ["simulate", "turtlebot3", "--link", link, *options]
    process = ForkedProgram("robot_runner", words, SIMULATES, text=True, **STREAMS)
    # Whatever keeps it from getting ready, its output ends at last.
    overdue = threading.Timer(PATIENCE, process.kill)
    overdue.start()
    try:
        assert process.stdout is not None
        lines = list(takewhile(lambda line: line != "ready", map(str.strip, process.stdout)))
        overdue.cancel()
        assert process.poll() is None, "it ended before it was ready"
        yield next(line.partition(": ")[2] for line in lines if line.startswith("power meter: "))
    finally:
        overdue.cancel()
        process.terminate()  # also after a failure: it takes back /use_sim_time, by which all later tests would live
        try:
            process.communicate(timeout=PATIENCE)
        finally:
            process.kill()
            process.communicate(timeout=PATIENCE)
    assert process.returncode == 0


@dataclass
class Witness:
    """Hears a robot's odometry.

    Attributes:
        speeds: when (s since the epoch) the robot drove or turned how fast (m/s and rad/s together).
    """

    speeds: list[tuple[float, float]] = field(default_factory=list)

    def hear(self, message: Any) -> None:
        twist = message["twist"]["twist"]
        self.speeds.append((time.time(), abs(twist["linear"]["x"]) + abs(twist["angular"]["z"])))

    def sees(self, speed: float, *, since: float = 0.0) -> float:
        """Wait until the robot is at least so fast, and return when that was."""
        return self._first(lambda seen: seen >= speed, since)

    def sees_standstill(self, since: float, *, meanwhile: Callable[[], object] = lambda: None) -> float:
        """Wait until the robot stands still and goes on to do so for half a second; return when that began.

        `meanwhile` is called again and again until it stands still.
        """
        while True:
            moment = self._first(lambda seen: seen < STANDSTILL, since, meanwhile, in_a_row=_IN_A_ROW)
            self._first(lambda _: True, moment + 0.5, meanwhile)
            later = self.speeds[bisect_right(self.speeds, moment, key=itemgetter(0)) :]
            moved = [at for at, seen in later if seen >= 3 * STANDSTILL]
            if not moved:
                return moment
            since = moved[-1]  # it rocked on, or was commanded again: that counts

    def _first(
        self, holds: Any, since: float, meanwhile: Callable[[], object] = lambda: None, *, in_a_row: int = 1
    ) -> float:
        deadline = time.monotonic() + PATIENCE
        while time.monotonic() < deadline:
            meanwhile()
            later = self.speeds[bisect_right(self.speeds, since, key=itemgetter(0)) :]
            for place in range(len(later) - in_a_row + 1):
                if all(holds(speed) for _, speed in later[place : place + in_a_row]):
                    return later[place][0]
            time.sleep(0.01)
        raise AssertionError(f"not within {PATIENCE} s; last seen: {self.speeds[-3:]}")


@contextmanager
def rival(link: str, namespace: str, topic: str, message_type: str, message: Any) -> Iterator[None]:
    """Publish a message twenty times a second until the context ends, as another node would."""
    name = RobotName.parse(link)
    connected = GRAPH_LINKS[name.link].open(name, SystemClock(), namespace)
    is_over = threading.Event()

    def publish() -> None:
        while not is_over.wait(0.05):
            connected.publish(topic, message_type, message)

    publishing = threading.Thread(target=publish, daemon=True)
    publishing.start()
    try:
        yield
    finally:
        is_over.set()
        publishing.join()
        connected.close()


@contextmanager
def witness(link: str, namespace: str) -> Iterator[Witness]:
    looking = Witness()
    name = RobotName.parse(link)
    connected = GRAPH_LINKS[name.link].open(name, SystemClock(), namespace)
    try:
        connected.subscribe("odom", "nav_msgs/Odometry", looking.hear)
        yield looking
    finally:
        connected.close()
