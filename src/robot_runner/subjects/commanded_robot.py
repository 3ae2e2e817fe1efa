"""The robot that software under test commands: it is stopped where that was done once the software is gone."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import suppress

from robot_runner.core.errors import LinkError
from robot_runner.core.events.context import RobotRunnerContext
from robot_runner.core.links.connect import connect_robot, is_simulated, is_slow_to_join, robot_namespace
from robot_runner.core.links.robot import Advertiser, RobotLink

#: A message of these types without any field stops a robot.
_VELOCITIES = frozenset({"geometry_msgs/Twist", "geometry_msgs/TwistStamped"})
#: After how long a graph is known that has to be discovered, s: on Fast DDS, that has taken up to 3.2 s.
_DISCOVERY = 4.0


class CommandedRobot:
    """The run's robot, as far as velocities are published for it.

    A planner that has ended, or has died, takes nothing back: a robot without a watchdog carries out its last command.
    On each topic of a velocity that somebody else publishes and the robot subscribes, the run's link is a publisher as
    well. So it commands zero there when it is closed, which is after the software has ended; and where the run is
    killed, the process that stands by for it does.

    Args:
        context: of the run; where it has no robot, or the embedded one, which other programs cannot reach, nothing is
            done.

    Attributes:
        tell: told each topic on which velocities are published, and its type.
    """

    def __init__(self, context: RobotRunnerContext) -> None:
        self._context = context
        self.tell: Callable[[str, str], object] = lambda *_: None
        self._link: RobotLink | None = None
        self._known_at = 0.0
        self._topics: dict[str, str] = {}
        self._lock = threading.Lock()

    def connect(self) -> None:
        """Join the robot's graph, if it is there already; to be called by the thread that executes callbacks."""
        robot = self._context.robot
        if self._link is None and robot is not None and not is_simulated(robot):
            with suppress(LinkError):  # who cannot do without the robot says so
                self._link = connect_robot(self._context)
                self._known_at = time.monotonic() + (_DISCOVERY if is_slow_to_join(robot) else 0.0)

    def look(self) -> None:
        """Look where velocities are published by now."""
        link = self._link
        if link is None or not isinstance(link, Advertiser):
            return
        with suppress(LinkError), self._lock:
            for topic, message_type in self._commanded_topics(link):
                link.advertise(topic, message_type)
                self._topics[topic] = message_type
                self.tell(topic, message_type)

    def look_at_last(self) -> None:
        """Look before the software is ended: a run may be so short that its graph is not known yet."""
        if not self._topics:
            time.sleep(max(0.0, self._known_at - time.monotonic()))
        self.look()

    def halt(self) -> None:
        """Command zero wherever velocities were published."""
        for topic, message_type in list(self._topics.items()):
            with suppress(LinkError):
                if self._link is not None:
                    self._link.publish(topic, message_type, {})

    def _commanded_topics(self, link: RobotLink) -> list[tuple[str, str]]:
        below = f"{robot_namespace(self._context).rstrip('/')}/"
        return [
            (topic, message_type)
            for topic, message_type in link.topics().items()
            if message_type in _VELOCITIES
            and topic.startswith(below)
            and topic not in self._topics
            and any(not each.is_own for each in link.publishers(topic))
            and any(not each.is_own for each in link.subscribers(topic))
        ]
