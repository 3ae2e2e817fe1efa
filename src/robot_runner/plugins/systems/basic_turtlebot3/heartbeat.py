"""The sign of life that the watchdog on the robot waits for."""

from __future__ import annotations

import logging
import threading
from typing import TYPE_CHECKING

from robot_runner.errors import LinkError
from robot_runner.links.watchdog import HEARTBEAT_TOPIC, HEARTBEAT_TYPE

if TYPE_CHECKING:
    from robot_runner.links.robot import RobotLink

__all__ = ["Heartbeat"]

#: The watchdog is patient for 0.4 s: three beats may be lost on the air.
_PERIOD = 0.1
#: How long the thread may take to end, s: publishing does not wait for anybody.
_PATIENCE = 2.0

_logger = logging.getLogger(__name__)


class Heartbeat:
    """Beats from a thread of the run's process until it is ended.

    When the process dies or the link is lost, the beats cease, and the robot's watchdog stops it.

    The embedded robot lives in the run's own process and needs none.

    Args:
        link: to the robot.

    Example:
        >>> from robot_runner.testing import FakeClock, FakeRobotLink
        >>> link = FakeRobotLink(FakeClock())
        >>> heartbeat = Heartbeat(link)
        >>> heartbeat.end()
        >>> heartbeat.say_farewell()
        >>> link.publications[-1].message
        {'data': 0}
    """

    def __init__(self, link: RobotLink) -> None:
        self._link = link
        self._is_over = threading.Event()
        self._thread: threading.Thread | None = None
        if not link.is_simulated:
            self._thread = threading.Thread(target=self._beat, name="heartbeat", daemon=True)
            self._thread.start()

    def end(self) -> None:
        """Beat no more; ending twice does nothing. Without a farewell the watchdog stops the robot."""
        self._is_over.set()
        if self._thread is not None:
            self._thread.join(_PATIENCE)

    def say_farewell(self) -> None:
        """Tell the watchdog that the robot stands still and is left to others.

        Raises:
            LinkError: the robot cannot be reached.
        """
        if self._thread is not None:
            self._link.publish(HEARTBEAT_TOPIC, HEARTBEAT_TYPE, {"data": 0})

    def _beat(self) -> None:
        count = 0
        while not self._is_over.is_set():
            count += 1
            try:
                self._link.publish(HEARTBEAT_TOPIC, HEARTBEAT_TYPE, {"data": count})
            except LinkError as error:
                _logger.warning("the heartbeat ends, so the robot's watchdog stops it: %s", error)
                return
            self._is_over.wait(_PERIOD)
