"""The topics of velocities on which software under test may command the run's robot, and zero on them at its end."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from robot_runner.core.errors import LinkError
from robot_runner.core.events.context import RobotRunnerContext
from robot_runner.core.links.commanded_topics import VELOCITIES
from robot_runner.core.links.connect import connect_robot, is_simulated, is_slow_to_join, robot_namespace
from robot_runner.core.links.robot import Advertiser, RobotLink

#: How long the discovery of a graph may take, s: with Fast DDS, it has taken up to 3.2 s.
_DISCOVERY = 4.0
#: How often it is looked whether software commands the robot before it is ready, s.
_LOOK = 0.5
#: How long a look may take once the software is to be ended, s: a rosapi that hangs takes longer, for each question.
_LAST_LOOK = 4.0


class CommandedRobot:
    """The run's robot, which software under test may command.

    A robot without a watchdog carries out the last command of a planner that has ended or died. So on each topic of
    velocities to which the robot subscribes, the run's link is a publisher, too, and commands zero when it is closed,
    which is after the software has ended. It does so even if no other publisher was seen: that of a program which
    commands once and ends, or dies after a second, is gone before it is discovered. If one was seen, zero has to
    arrive, and if the run is killed, the process that stands by for it commands zero. Without a robot, or with the
    embedded one, which other programs cannot reach, nothing is done.

    Attributes:
        tell: called with each topic on which another publisher of velocities is seen, and its type.
    """

    def __init__(self, context: RobotRunnerContext) -> None:
        self._context = context
        self.tell: Callable[[str, str], object] = lambda *_: None
        self._link: RobotLink | None = None
        self._known_at = 0.0
        self._taken: dict[str, str] = {}
        self._commanded: set[str] = set()
        #: Of these, those with another publisher for certain: a shared server may publish for the mission alone.
        self._seen: set[str] = set()
        self._lock = threading.Lock()

    @property
    def was_commanded(self) -> bool:
        """Whether the software has commanded it, as far as its graph tells."""
        return bool(self._commanded)

    def connect(self) -> None:
        """Join the robot's graph, if it is there already; call it in the thread that executes callbacks."""
        robot = self._context.robot
        if self._link is None and robot is not None and not is_simulated(robot):
            with suppress(LinkError):  # who cannot do without the robot says so
                self._link = connect_robot(self._context)
                self._known_at = time.monotonic() + (_DISCOVERY if is_slow_to_join(robot) else 0.0)

    def look(self) -> None:
        """Look to which topics of velocities the robot subscribes by now, and on which it is commanded."""
        link = self._link
        if link is None or not isinstance(link, Advertiser):
            return
        with suppress(LinkError), self._lock:
            for topic, message_type in self._velocities(link):
                with suppress(LinkError):  # whatever fails at one robot, the others are looked after
                    link.advertise(topic, message_type, is_commanded=False)
                    self._taken[topic] = message_type
            for topic in self._taken.keys() - self._seen:
                publishers = link.publishers(topic)
                is_seen = not all(each.is_own for each in publishers)
                if topic not in self._commanded and (is_seen or any(each.is_shared for each in publishers)):
                    self.tell(topic, self._taken[topic])  # before the next, which may take seconds
                    link.advertise(topic, self._taken[topic])
                    self._commanded.add(topic)
                if is_seen:
                    self._seen.add(topic)

    @contextmanager
    def looked_at(self, every_s: float = _LOOK) -> Iterator[None]:
        """Look now and then in a thread: software may command the robot before it is ready, and at any time later."""
        is_over = threading.Event()

        def look() -> None:
            while not is_over.wait(every_s):
                self.look()

        threading.Thread(target=look, name="look at the robot", daemon=True).start()
        try:
            yield
        finally:
            is_over.set()  # a look that goes on holds up the next one, and nothing else

    def look_at_last(self) -> None:
        """Look once more before the software is ended: in a short run its graph may not be known yet."""
        if self._link is None:
            return
        if not self._commanded:
            time.sleep(max(0.0, self._known_at - time.monotonic()))
        looking = threading.Thread(target=self.look, name="look at the robot", daemon=True)
        looking.start()
        looking.join(_LAST_LOOK)  # the software drives the robot until it is ended

    def halt(self) -> None:
        """Command zero on each topic with another publisher; on others the mission itself may command the robot.

        Where only a server is seen that publishes for both, zero is commanded as the link is closed.
        """
        for topic in list(self._seen):
            with suppress(LinkError):
                if self._link is not None:
                    self._link.publish(topic, self._taken[topic], {})

    def _velocities(self, link: RobotLink) -> list[tuple[str, str]]:
        """Return the topics of velocities to which the robot subscribes, and their types, except those known before."""
        below = f"{robot_namespace(self._context).rstrip('/')}/"
        return [
            (topic, message_type)
            for topic, message_type in link.topics().items()
            if message_type in VELOCITIES
            and topic.startswith(below)
            and topic not in self._taken
            and any(each.may_be_others for each in link.subscribers(topic))
        ]
