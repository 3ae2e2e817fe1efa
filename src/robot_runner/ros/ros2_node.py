"""The one ROS 2 node of a process, shared by the links to all its robots, and what it knows of the graph."""

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
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

from robot_runner.core.errors import LinkError
from robot_runner.core.events.early_end import raised_in_thread
from robot_runner.core.links.robot import GraphEndpoint
from robot_runner.ros.qos_policies import Policies
from robot_runner.ros.shapes import plain_type

_logger = logging.getLogger(__name__)

#: How long after joining a graph what is on it is told, s: DDS announces participants at once and answers to them. Fast
#: DDS does not always: what must be there is looked for during LONGEST_DISCOVERY.
SETTLING = 1.0
#: An executor looks whether it is to end at least this often, s.
_SPIN = 0.2
#: How long a thread may take to end, s.
_JOIN = 5.0
#: So many requests are answered at a time: whoever asks for the result of a goal is answered when it is over.
_ANSWERING = 32
#: How often the graph is looked at where something is waited for, s.
_POLL = 0.02

_lock = threading.Lock()
_shared: dict[tuple[int, int | None, bool], GraphNode] = {}


def join_graph(domain: int | None, *, use_sim_time: bool) -> GraphNode:
    """Return this process's node on the graph of a domain; `GraphNode.leave` must be called once for each call.

    Raises:
        LinkError: the domain cannot be joined.
    """
    key = (os.getpid(), domain, use_sim_time)  # a node does not survive a fork
    with _lock:
        node = _shared.get(key)
        if node is None:
            node = _shared[key] = GraphNode(domain, use_sim_time=use_sim_time, forget=lambda: _shared.pop(key, None))
        node.users += 1
        return node


class GraphNode:
    """A context of its own, a node in it, and the threads that spin it and call back.

    The node is made once something is opened on it: who only looks at the graph, or stands by to stop a robot, is there
    as a hidden node, whose name begins with an underscore. Callbacks are called from a thread that spins nothing, so
    that they may call services. Offered services are a node of their own with an executor of several threads: one that
    takes long to answer must keep up neither messages and responses nor other services.

    Attributes:
        users: how many links use it.
        hidden: knows the graph; spins nothing.
    """

    def __init__(self, domain: int | None, *, use_sim_time: bool, forget: Callable[[], object]) -> None:
        self.users = 0
        self._forget = forget
        self._use_sim_time = use_sim_time
        self._context = Context()
        self._spinning: list[_Spinning] = []
        self._node: Any = None
        self._services: Any = None
        self._todo: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        try:
            # No arguments: those of our command line mean nothing to ROS. No handlers of signals: a run has its own.
            self._context.init(args=[], initialize_logging=False, domain_id=domain)
            self.hidden = self._new_node("_robot_runner", use_sim_time=False)
        except Exception as error:  # rclpy raises what its middleware does
            self._context.try_shutdown()
            raise LinkError(
                f"the graph of ROS 2 cannot be joined: {error}",
                where="robot",
                fix="Look at ROS_DOMAIN_ID and RMW_IMPLEMENTATION, and whether the network is up.",
            ) from error
        self._joined = time.monotonic()
        self._caller = threading.Thread(target=self._call_back, name="ros2 callbacks", daemon=True)
        self._caller.start()

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

    def later(self, todo: Callable[[], None]) -> None:
        """Have something done in the thread that calls back, after what is to be done there already."""
        self._todo.put(todo)

    def until(self, claim: Callable[[], object], seconds: float) -> bool:
        """Wait until something holds on the graph, for so long at most; return whether it does."""
        deadline = time.monotonic() + seconds
        while not claim():
            if time.monotonic() >= deadline:
                return False
            time.sleep(_POLL)
        return True

    def settle(self, claim: Callable[[], object] = lambda: False, seconds: float = SETTLING) -> None:
        """Wait until something holds, or the graph was joined so many seconds ago."""
        self.until(claim, self._joined + seconds - time.monotonic())

    def leave(self) -> None:
        """Give it up; the last one to do so ends it."""
        with _lock:
            self.users -= 1
            if self.users > 0:
                return
            self._forget()
        self._todo.put(None)
        if threading.current_thread() is not self._caller:
            self._caller.join(_JOIN)
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

    def _call_back(self) -> None:
        while (todo := self._todo.get()) is not None:
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
            except Exception:  # of an offered service, or of an entity that was destroyed just now
                if not self._is_over.is_set():
                    _logger.exception("a callback of %s raised", self._node.get_name())

    def end(self) -> None:
        """Spin no more, and take the node from the graph."""
        self._is_over.set()
        self._executor.wake()
        if threading.current_thread() is not self._thread:
            self._thread.join(_JOIN)
        self._executor.shutdown(timeout_sec=_JOIN)
        self._node.destroy_node()


class Graph:
    """What rclpy knows of a graph."""

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
        """Return what there is to know about the publishers of a topic: `topic_type`, `qos_profile`, node's name."""
        return list(self._node.hidden.get_publishers_info_by_topic(topic))

    def subscriptions(self, topic: str) -> list[Any]:
        """Return the same of the subscriptions of a topic."""
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
        # Asked node by node: the list of all services has those that are merely called, too.
        found: dict[str, str] = {}
        for name, namespace in self._names():
            try:
                offered = self._node.hidden.get_service_names_and_types_by_node(name, namespace)
            except RuntimeError:  # it left the graph just now
                continue
            found |= {service: plain_type(types[0]) for service, types in offered if types}
        return dict(sorted(found.items()))

    def _names(self) -> list[tuple[str, str]]:
        return list(self._node.hidden.get_node_names_and_namespaces())


def policies_of(profile: Any) -> Policies:
    """Return what a profile of rclpy asks for or offers."""
    return Policies(
        is_reliable=profile.reliability != ReliabilityPolicy.BEST_EFFORT,
        is_kept=profile.durability == DurabilityPolicy.TRANSIENT_LOCAL,
    )
