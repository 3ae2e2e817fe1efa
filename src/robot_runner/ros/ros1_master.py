"""A client of the ROS 1 master, over XML-RPC with a deadline; no ROS need be installed.

Source: wiki.ros.org/ROS/Master_API and wiki.ros.org/ROS/Parameter Server API.
"""

from __future__ import annotations

import os
import socket
import time
import xmlrpc.client
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass
from http.client import HTTPConnection, HTTPException, HTTPResponse
from types import SimpleNamespace
from typing import Any
from urllib.parse import urlsplit
from xml.parsers.expat import ExpatError

from robot_runner.core.errors import LinkError
from robot_runner.ros.undelivered import drop_undelivered

#: The master's address, unless ROS_MASTER_URI says otherwise.
DEFAULT_MASTER = "http://localhost:11311"
_CALLER = "/robot_runner"
_SUCCESS = 1
_URI = "ROS_MASTER_URI"


@dataclass(frozen=True, slots=True)
class SystemState:
    """The nodes that publish, subscribe and offer each topic and service of a graph, by full names."""

    publishers: Mapping[str, tuple[str, ...]]
    subscribers: Mapping[str, tuple[str, ...]]
    services: Mapping[str, tuple[str, ...]]

    @property
    def nodes(self) -> tuple[str, ...]:
        """All nodes, sorted."""
        parts = (self.publishers, self.subscribers, self.services)
        return tuple(sorted({node for part in parts for nodes in part.values() for node in nodes}))


def master_address(uri: str) -> tuple[str, int]:
    """Return the host and the port of a master; raise a `LinkError` if the URI is not valid.

    Example:
        >>> master_address("http://robot:11311/")
        ('robot', 11311)
    """
    try:
        parts = urlsplit(uri)
        host, port = parts.hostname, parts.port
    except ValueError:
        host = port = None
        parts = urlsplit("")
    if parts.scheme != "http" or not host or not port:
        fix = "Write it as in ROS_MASTER_URI=http://robot:11311, or robot = 'ros1:master=http://robot:11311'."
        raise LinkError(f"{uri!r} cannot be the address of a ROS master", where=_URI, fix=fix)
    return host, port


class Master:
    """A master, which may be on another computer, at a URI; None for that in ROS_MASTER_URI.

    Each request has a deadline (s), and raises a `LinkError` where there is no master or node, where it does not answer
    in time, where what answers is none, and where the master refuses to set or to delete a parameter.

    Raises:
        LinkError: the URI cannot be that of a master.

    Example:
        >>> Master("http://robot:11311").uri
        'http://robot:11311'
    """

    def __init__(self, uri: str | None = None, *, timeout: float = 3.0) -> None:
        usual = os.environ.get(_URI) or DEFAULT_MASTER
        self.uri = uri or usual
        self._named_by = _URI if self.uri == usual else f"robot = 'ros1:master={self.uri}'"
        self._host, _ = master_address(self.uri)
        self._timeout = timeout

    def check(self) -> None:
        """Check that the master answers."""
        self._ask("getPid")

    def parameter(self, name: str) -> Any:
        """Return a parameter of the parameter server, or None where it is not set."""
        code, _, value = self._answer("getParam", name)
        return value if code == _SUCCESS else None

    def set_parameter(self, name: str, *, value: Any) -> None:
        """Set a parameter of the parameter server."""
        self._ask("setParam", name, value)

    def delete_parameter(self, name: str) -> None:
        """Delete a parameter."""
        self._ask("deleteParam", name)

    def parameter_names(self) -> list[str]:
        """Return the full names of all parameters of the parameter server."""
        return list(self._ask("getParamNames", shape=_texts))

    def topic_types(self) -> dict[str, str]:
        """Return the type of each topic that was ever registered."""
        types = self._ask("getTopicTypes", shape=lambda value: {each[0]: each[1] for each in map(_texts, value)})
        return {name: topic_type for name, topic_type in types.items() if topic_type != "*"}

    def state(self) -> SystemState:
        """Return the publishers, subscribers and services."""
        return SystemState(*self._ask("getSystemState", shape=_parts))

    def service(self, name: str) -> str | None:
        """Return the URI of a service, or None where there is none."""
        return self._found("lookupService", name)

    def pid_of(self, node: str, *, timeout: float | None = None) -> int | None:
        """Return the process id of a node, as it reports it within `timeout` (s), or None if there is no such node."""
        uri = self.uri_of(node)
        try:
            return None if uri is None else Master(uri, timeout=timeout or self._timeout).pid()
        except LinkError as error:
            problem = f"the node {node} does not answer at {uri}"
            fix = f"Restart {node}, with its ROS_IP set if its host's name is not known here."
            raise LinkError(problem, where=node, fix=fix) from error.__cause__  # tells callers what befell it

    def uri_of(self, node: str) -> str | None:
        """Return the URI of a node, or None where there is no such node."""
        return self._found("lookupNode", node)

    def forget(self, node: str) -> None:
        """Unregister everything of a node, in its name: a killed node does not do so itself.

        Source: wiki.ros.org/ROS/Master_API; `rosnode cleanup` does the same.
        """
        state, uri = self.state(), self.uri_of(node)
        if uri is None:
            return
        for name in (name for name, nodes in state.publishers.items() if node in nodes):
            self._answer("unregisterPublisher", name, uri, caller=node)
        for name in (name for name, nodes in state.subscribers.items() if node in nodes):
            self._answer("unregisterSubscriber", name, uri, caller=node)
        for name in (name for name, nodes in state.services.items() if node in nodes):
            self._answer("unregisterService", name, self.service(name) or "", caller=node)

    def is_serving(self, node: str, topic: str, listener: str) -> bool:
        """Whether a node that publishes a topic says that it sends it to another node; works for our nodes, too.

        Source: wiki.ros.org/ROS/Slave_API, getBusInfo.
        """
        try:
            uri = self.uri_of(node)
            connections = () if uri is None else Master(uri, timeout=self._timeout).connections()
        except LinkError:  # the node is gone, or answers in another form
            return False
        return (listener, "o", topic) in connections

    def connections(self) -> list[tuple[Any, Any, Any]]:
        """Return the connections of a node: other side, direction (`o` is out), topic of each."""
        # Of each, the node tells number, other side, direction, transport, topic and more.
        return list(self._ask("getBusInfo", shape=lambda value: [(each[1], each[2], each[4]) for each in value]))

    def pid(self) -> int:
        """Return the id of the process that answers; a node has this method, too."""
        return int(self._ask("getPid", shape=int))

    def _ask(self, method: str, *arguments: Any, shape: Callable[[Any], Any] = lambda value: value) -> Any:
        """Return what a master answers; `shape` converts it, or raises where no master answers so."""
        code, status, value = self._answer(method, *arguments)
        if code != _SUCCESS:
            fix = "Look at the master's log."
            raise LinkError(f"the ROS master refuses {method}: {status}", where=self.uri, fix=fix)
        with self._as_link_error():
            return shape(value)

    def _found(self, method: str, name: str) -> str | None:
        code, _, uri = self._answer(method, name)
        with self._as_link_error():
            return _texts([uri])[0] if code == _SUCCESS else None

    def _answer(self, method: str, *arguments: Any, caller: str = _CALLER) -> tuple[int, str, Any]:
        transport = _Transport(self._timeout)
        try:
            with (
                self._as_link_error(),
                xmlrpc.client.ServerProxy(self.uri, transport=transport, use_builtin_types=True) as server,
            ):
                code, status, value = getattr(server, method)(caller, *arguments)
        except TimeoutError as error:
            problem = f"the ROS master at {self.uri} does not answer within {self._timeout:g} s"
            fix = f"Check whether the robot is on and in this network, or correct {self._named_by}."
            raise LinkError(problem, where=self._named_by, fix=fix) from error
        except (socket.gaierror, UnicodeError) as error:  # a part of the name is empty, or has more than 63 characters
            problem = f"the host of the ROS master, {self._host!r}, is not known"
            fix = f"Correct {self._named_by}, or give the host's address as a number."
            raise LinkError(problem, where=self._named_by, fix=fix) from error
        except OSError as error:
            problem = f"there is no ROS master at {self.uri}: {(error.strerror or str(error)).lower()}"
            fix = f"Start one (roscore), or correct {self._named_by}."
            raise LinkError(problem, where=self._named_by, fix=fix) from error
        return code, status, value

    @contextmanager
    def _as_link_error(self) -> Iterator[None]:
        """Turn what an answer of another shape raises into the error that no master answers."""
        try:
            yield
        except UnicodeError:  # of the host's name
            raise
        except (xmlrpc.client.Error, ExpatError, HTTPException, LookupError, TypeError, ValueError) as error:
            problem = f"what answers at {self.uri} is not a ROS master"
            fix = f"Correct {self._named_by}: a master is at port 11311, if not started elsewhere."
            raise LinkError(problem, where=self._named_by, fix=fix) from error


def _texts(value: Any) -> tuple[str, ...]:
    """Return a list of texts as a tuple; raises a TypeError for anything else."""
    if not (isinstance(value, list) and all(isinstance(each, str) for each in value)):
        raise TypeError(value)
    return tuple(value)


def _parts(value: Any) -> list[dict[str, tuple[str, ...]]]:
    """Return publishers, subscribers and services of a system state; raises a TypeError or ValueError for others."""
    publishers, subscribers, services = ({str(name): _texts(nodes) for name, nodes in part} for part in value)
    return [publishers, subscribers, services]


class _Transport(xmlrpc.client.Transport):
    """XML-RPC over a connection with a deadline."""

    accept_gzip_encoding = False  # a few bytes may become as many as fill the memory

    def __init__(self, timeout: float) -> None:
        super().__init__(use_builtin_types=True)
        self._timeout = timeout

    def make_connection(self, host: Any) -> HTTPConnection:
        connection = _Connection(host, timeout=self._timeout)
        self._connection = host, connection  # where `close` looks for it
        return connection

    def parse_response(self, response: Any) -> Any:
        with closing(response):
            body: Any = SimpleNamespace(read=response.read)  # by its headers, one compressed unasked would be unpacked
            return super().parse_response(body)


class _Timely(socket.socket):
    """A connected socket from which all has to be read in time, however many pieces come."""

    def __init__(self, descriptor: int, seconds: float) -> None:
        super().__init__(fileno=descriptor)
        self.settimeout(seconds)  # to send
        self._until = time.monotonic() + seconds

    def recv_into(self, *arguments: Any) -> int:
        left = self._until - time.monotonic()
        if left <= 0:
            raise TimeoutError
        self.settimeout(left)
        return super().recv_into(*arguments)


class _Connection(HTTPConnection):
    """A connection whose request is not delivered any more once it was given up, or this process was killed."""

    timeout: float  # never without

    def connect(self) -> None:
        super().connect()
        self.sock = _Timely(self.sock.detach(), self.timeout)
        drop_undelivered(self.sock)

    def getresponse(self) -> HTTPResponse:
        asked = self.sock  # the response may take it over
        response = super().getresponse()
        drop_undelivered(asked, is_dropped=False)
        return response
