"""The one ROS 2 node of a process, shared by the links to all its robots, and its view of the graph."""

from __future__ import annotations

import logging
import os
import queue
import threading
import time
from collections.abc import Callable, Iterable
from typing import Any

from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, LivelinessPolicy, ReliabilityPolicy

from robot_runner.core.errors import LinkError
from robot_runner.core.events.early_end import raised_in_thread
from robot_runner.core.links.robot import GraphEndpoint
from robot_runner.ros.graph_transport import Lane, until
from robot_runner.ros.qos_policies import Policies, seconds_of
from robot_runner.ros.shapes import plain_type

_logger = logging.getLogger(__name__)

#: How long after joining a graph its content is known, s: DDS announces participants at once and answers them. Fast DDS
#: sometimes does not: whatever must be there is looked for during LONGEST_DISCOVERY.
SETTLING = 1.0
#: An executor checks at least this often whether it has to end, s.
_SPIN = 0.2
#: How long a thread may take to end, s.
_JOIN = 5.0
#: The number of threads that answer requests: a request for the result of a goal takes one until the goal is over.
_ANSWERING = 32

#: How much may wait for the callbacks of a lane, messages and bytes.
_MOST_WAITING, _MOST_WAITING_BYTES = 20_000, 1 << 30

_lock = threading.Lock()
_shared: dict[tuple[int, int | None, bool], GraphNode] = {}


def join_graph(domain: int | None, *, use_sim_time: bool, is_shared: bool = True) -> GraphNode:
    """Return a node on the graph of a domain, or the one that this process shares; leave it once for each call.

    If the domain cannot be joined, that is a `LinkError`.
    """
    key = (os.getpid(), domain, use_sim_time)  # a node does not survive a fork
    with _lock:
        node = _shared.get(key) if is_shared else None
        if node is None:
            node = GraphNode(domain, use_sim_time=use_sim_time, forget=lambda: is_shared and _shared.pop(key, None))
            if is_shared:
                _shared[key] = node
        node.users += 1
        return node


class GraphNode:
    """A separate context, a node in it, and the threads that spin it and execute callbacks.

    The node is made once something is opened on it: a process that only looks at the graph, or is a standby, has only a
    hidden node, whose name begins with an underscore, and which is not spun. Callbacks are executed in a thread that
    does not spin, so that they may call services; there is one for each lane, so that no callback delays what is
    measured, or the end of a goal. Offered services have a node of their own, with an executor of several threads: a
    slow service must delay neither messages and responses nor other services. `users` is how many links use it.
    """

    def __init__(self, domain: int | None, *, use_sim_time: bool, forget: Callable[[], object]) -> None:
        self.users = 0
        self._forget = forget
        self._use_sim_time = use_sim_time
        self._context = Context()
        self._spinning: list[_Spinning] = []
        self._node: Any = None
        self._services: Any = None
        try:
            # Without the arguments of our command line, which are not for ROS, and without ROS' signal handlers.
            self._context.init(args=[], initialize_logging=False, domain_id=domain)
            self.hidden = self._new_node("_robot_runner", use_sim_time=False)
        except Exception as error:  # the class depends on the middleware
            self._context.try_shutdown()
            fix = "Look at ROS_DOMAIN_ID and RMW_IMPLEMENTATION, and whether the network is up."
            raise LinkError(f"the graph of ROS 2 cannot be joined: {error}", where="robot", fix=fix) from error
        self._joined = time.monotonic()
        self._callers = {lane: _Caller() for lane in Lane}

    @property
    def node(self) -> Any:
        """The node for topics and calls; it is made when it is first needed."""
        with _lock:
            if self._node is None:
                self._node = self._spun("robot_runner")
            return self._node

    @property
    def own_name(self) -> str | None:
        """The full name of the node for topics and calls, if there is one."""
        return None if self._node is None else str(self._node.get_fully_qualified_name())

    def services(self) -> Any:
        """Return the node for services that are offered; it is made when it is first needed."""
        with _lock:
            if self._services is None:
                self._services = self._spun("robot_runner_services", threads=_ANSWERING)
            return self._services

    def later(self, todo: Callable[[], None], lane: Lane = Lane.CALLBACKS, *, size: int = 0) -> None:
        """Queue a function, for a message of `size` bytes, for the thread that executes the callbacks of a lane.

        Where more waits than the memory is to hold, the run fails, as dropping messages would falsify its results.
        """
        self._callers[lane].put(todo, size)

    def settle(self, claim: Callable[[], object] = lambda: False, seconds: float = SETTLING) -> None:
        """Wait until something holds, or the graph was joined so many seconds ago."""
        until(claim, self._joined + seconds - time.monotonic())

    def leave(self) -> None:
        """Release the node; the last user ends it."""
        with _lock:
            self.users -= 1
            if self.users > 0:
                return
            self._forget()
        for caller in self._callers.values():
            caller.end()
        for spinning in self._spinning:
            spinning.end()
        self.hidden.destroy_node()
        self._context.try_shutdown()

    def _spun(self, name: str, threads: int = 1) -> Any:
        node = self._new_node(name, use_sim_time=self._use_sim_time)
        self._spinning.append(_Spinning(node, self._context, threads))
        return node

    def _new_node(self, name: str, *, use_sim_time: bool) -> Any:
        return Node(
            f"{name}_{os.getpid()}",
            context=self._context,
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
            parameter_overrides=[Parameter("use_sim_time", Parameter.Type.BOOL, use_sim_time)],
        )


class _Caller:
    """A thread that executes callbacks, one after the other."""

    def __init__(self) -> None:
        self._todo: queue.SimpleQueue[tuple[Callable[[], None] | None, int]] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._waiting_bytes = 0
        self._is_overrun = False
        self._thread = threading.Thread(target=self._call_back, name="ros2 callbacks", daemon=True)
        self._thread.start()

    def put(self, todo: Callable[[], None], size: int) -> None:
        """Queue a function; where too much waits, it is dropped, and the run fails once."""
        with self._lock:
            count, waiting = self._todo.qsize(), self._waiting_bytes + size
            if fits := count < _MOST_WAITING and waiting <= _MOST_WAITING_BYTES:
                self._waiting_bytes = waiting
        if fits:
            self._todo.put((todo, size))
        elif not self._is_overrun:
            self._is_overrun = True
            error = LinkError(
                f"callbacks are too slow: {count:,} messages of {waiting >> 20:,} MiB wait for them",
                where="ros2",
                fix="Have them return sooner, or do their work after the mission, on a bag of it (RosBag).",
            )
            if not raised_in_thread(error, "a callback of ROS 2"):
                _logger.error("%s; what comes now is dropped", error)

    def end(self) -> None:
        """Execute what is queued, and end; called in a callback, this does not wait."""
        self._todo.put((None, 0))
        if threading.current_thread() is not self._thread:
            self._thread.join(_JOIN)

    def _call_back(self) -> None:
        while True:
            todo, size = self._todo.get()
            if todo is None:
                return
            with self._lock:
                self._waiting_bytes -= size
            try:
                todo()
            except Exception as error:
                if not raised_in_thread(error, "a callback of ROS 2"):
                    _logger.exception("a callback raised")


class _Spinning:
    """One node with the executor and the thread that spin it."""

    def __init__(self, node: Any, context: Any, threads: int) -> None:
        self._node = node
        self._context = context
        self._is_over = threading.Event()
        self._executor = (
            SingleThreadedExecutor(context=context)
            if threads == 1
            else MultiThreadedExecutor(num_threads=threads, context=context)
        )
        self._executor.add_node(node)
        self._thread = threading.Thread(target=self._spin, name=f"ros2 {node.get_name()}", daemon=True)
        self._thread.start()

    def _spin(self) -> None:
        while not self._is_over.is_set() and self._context.ok():
            try:
                self._executor.spin_once(timeout_sec=_SPIN)
            except ExternalShutdownException:
                return
            except Exception:  # from an offered service, or an entity that was just destroyed
                if not self._is_over.is_set():
                    _logger.exception("a callback of %s raised", self._node.get_name())

    def end(self) -> None:
        self._is_over.set()
        self._executor.wake()
        if threading.current_thread() is not self._thread:
            self._thread.join(_JOIN)
        self._executor.shutdown(timeout_sec=_JOIN)
        self._node.destroy_node()


class Graph:
    """Queries about a graph, over rclpy."""

    def __init__(self, node: GraphNode) -> None:
        self._node = node

    def topics(self) -> dict[str, str]:
        """Return the type of each topic by its full name."""
        self._node.settle()
        found = self._node.hidden.get_topic_names_and_types()
        return {name: plain_type(types[0]) for name, types in sorted(found) if types}

    def nodes(self) -> list[str]:
        """Return the full names of the nodes, sorted."""
        self._node.settle()
        return sorted(f"{namespace.rstrip('/')}/{name}" for name, namespace in self._names())

    def services(self) -> dict[str, str]:
        """Return the type of each service that a node offers, by its full name."""
        self._node.settle()
        return self._offered()

    def service_type(self, name: str) -> str | None:
        """Return the type of a service, or None where there is none; it does not wait."""
        return self._offered().get(name)

    def publishers(self, topic: str) -> list[Any]:
        """Return rclpy's information on the publishers of a topic: `topic_type`, `qos_profile`, node's name."""
        return list(self._node.hidden.get_publishers_info_by_topic(topic))

    def subscriptions(self, topic: str) -> list[Any]:
        """Return rclpy's information on the subscriptions of a topic."""
        return list(self._node.hidden.get_subscriptions_info_by_topic(topic))

    def endpoints(self, infos: Iterable[Any]) -> list[GraphEndpoint]:
        """Return these publishers or subscriptions as plain data."""
        own = self._node.own_name
        named = [(f"{info.node_namespace.rstrip('/')}/{info.node_name}", info) for info in infos]
        return [
            GraphEndpoint(name, plain_type(info.topic_type), name == own, policies_of(info.qos_profile).profile)
            for name, info in named
        ]

    def _offered(self) -> dict[str, str]:
        # Node by node, as the list of all services contains those that are merely called, too.
        found: dict[str, str] = {}
        for name, namespace in self._names():
            try:
                offered = self._node.hidden.get_service_names_and_types_by_node(name, namespace)
            except RuntimeError:  # it has just left the graph
                continue
            found |= {service: plain_type(types[0]) for service, types in offered if types}
        return dict(sorted(found.items()))

    def _names(self) -> list[tuple[str, str]]:
        return list(self._node.hidden.get_node_names_and_namespaces())


def policies_of(profile: Any) -> Policies:
    """Return the policies of a profile of rclpy."""
    return Policies(
        is_reliable=profile.reliability != ReliabilityPolicy.BEST_EFFORT,
        is_kept=profile.durability == DurabilityPolicy.TRANSIENT_LOCAL,
        deadline=seconds_of(profile.deadline.nanoseconds),
        lease=seconds_of(profile.liveliness_lease_duration.nanoseconds),
        is_manual=profile.liveliness == LivelinessPolicy.MANUAL_BY_TOPIC,
    )
