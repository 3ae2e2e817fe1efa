"""Separate connections to a rosbridge for service calls, so that a call that hangs does not delay commands."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from robot_runner.core.errors import LinkError
from robot_runner.ros.graph_transport import link_closed
from robot_runner.ros.rosbridge_session import Reply, Session


class Callers:
    """Calls services, each over a connection that is not used for anything else meanwhile, and that `connect` opens.

    By default a server of ROS 2 handles nothing else of a connection until the service has answered, and waits for ever
    for one that hangs: a stop command would wait behind it. A connection without an answer in time is closed.
    """

    def __init__(self, connect: Callable[[], Session]) -> None:
        self._connect = connect
        self._lock = threading.Lock()
        self._idle: list[Session] = []
        self._busy: list[Session] = []
        self._is_closed = False

    def call(self, service: str, request: Mapping[str, Any], *, timeout: float, where: str) -> Reply:
        """Call a service; otherwise as `calls`."""
        return self.calls([(service, request)], timeout=timeout, where=where)[0]

    def calls(self, questions: list[tuple[str, Mapping[str, Any]]], *, timeout: float, where: str) -> list[Reply]:
        """Call services all at once, and return their answers in the protocol's form; a `LinkError` if one is late."""
        with self._taken(where) as caller:
            return caller.calls(questions, timeout=timeout, where=where)

    def close(self) -> None:
        """Close all connections; pending calls get no answer."""
        with self._lock:
            self._is_closed = True
            sessions, self._idle, self._busy = [*self._idle, *self._busy], [], []
        for each in sessions:
            each.close()

    @contextmanager
    def _taken(self, where: str) -> Iterator[Session]:
        with self._lock:
            caller = self._idle.pop() if self._idle else None
        if caller is None or not caller.is_usable:
            caller = self._connect()
        with self._lock:
            is_late = self._is_closed
            if not is_late:
                self._busy.append(caller)
        if is_late:
            caller.close()
            raise link_closed(where)
        try:
            yield caller
        except LinkError:
            self._give_back(caller, kept=False)
            caller.close()
            raise
        self._give_back(caller, kept=True)

    def _give_back(self, caller: Session, *, kept: bool) -> None:
        with self._lock:
            self._busy = [each for each in self._busy if each is not caller]
            if kept and not self._is_closed:
                self._idle.append(caller)
