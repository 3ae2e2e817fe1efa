"""A topic that a link hears over rospy."""

from __future__ import annotations

import logging
import time
from typing import TYPE_CHECKING, Any

from robot_runner.links.robot import RawMessage
from robot_runner.links.ros1.node import REGISTERING_SECONDS, within

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["Subscriber"]

_logger = logging.getLogger(__name__)


class Subscriber:
    """Hears one topic as bytes, and sees to the type of what comes.

    rospy shares one connection among all subscribers of a topic, with the class that the first of them asks for; with
    its class for any message there is nothing that they can disagree about.

    Args:
        rospy: the client library.
        name: the topic's full name.
        cls: the class of its messages.
        callback: called with each message, from a thread of rospy's.

    Raises:
        LinkError: the master does not answer.
    """

    def __init__(self, rospy: Any, name: str, cls: Any, callback: Callable[[RawMessage], None]) -> None:
        self._name = name
        self._type: str = cls._type
        self._digest: str = cls._md5sum
        self._callback = callback
        self._foreign: set[str] = set()
        self._is_closed = False
        self._subscriber = within(
            REGISTERING_SECONDS,
            lambda: rospy.Subscriber(name, rospy.AnyMsg, self._hear, tcp_nodelay=True),
            where=name,
            doing="registering the subscriber",
        )

    def close(self) -> None:
        """Hear no more messages; closing twice does nothing.

        Raises:
            LinkError: the master does not answer.
        """
        if not self._is_closed:
            self._is_closed = True
            within(REGISTERING_SECONDS, self._subscriber.unregister, where=self._name, doing="leaving the topic")

    def _hear(self, message: Any) -> None:
        received = time.time_ns()
        if self._is_closed:
            return
        header = message._connection_header  # noqa: SLF001 - where rospy documents it to be
        if header["md5sum"] in {self._digest, "*"}:
            self._callback(RawMessage(message._buff, received))  # noqa: SLF001 - as above
        elif header["callerid"] not in self._foreign:
            self._foreign.add(header["callerid"])
            text = "%s: %s publishes %s, or another version of it, which is not heard as %s"
            _logger.error(text, self._name, header["callerid"], header.get("type"), self._type)
