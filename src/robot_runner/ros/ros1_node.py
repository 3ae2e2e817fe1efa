"""The one ROS 1 node that a process may be, shared by the links to all robots."""

from __future__ import annotations

import logging
import os
import re
import socket
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar

from robot_runner.core.errors import LinkError
from robot_runner.core.links.robot import Qos
from robot_runner.ros.ros1_master import Master, master_address

T = TypeVar("T")

#: The timeout for registering a publisher, subscriber or service at the master, s.
_REGISTERING = 5.0
_NAME = "robot_runner"
#: The names of our nodes: rospy adds the process id, and the time of the start.
_OWN_NODE = re.compile(rf"/{_NAME}_(\d+)_\d+")
_INSTALL = (
    "Source the setup file of ROS 1 (on Debian: apt install python3-rospy) and start robot-runner from that shell."
)
#: rospy's own configuration of logging would remove the handlers of the process: this one changes nothing.
_LOGGING = "version: 1\nincremental: true\n"


class _Joined:
    """The graph that this process has joined: one at a time."""

    master: str | None = None
    process: int | None = None


def join_graph(master: Master) -> Any:
    """Become a node on the graph of a master, and return rospy; a second call only returns it.

    Signal handlers, terminal, log files and the logging of the process are left as they are.

    Raises:
        LinkError: there is no such master, rospy is not installed, or the process has something open on another graph.
    """
    rospy = _rospy()
    master.check()
    if _Joined.master is not None:
        _check_process()
        if _Joined.master != master.uri:
            _move(master)
        return rospy
    if not rospy.core.is_initialized():  # a config may have called rospy.init_node itself
        _initialise(rospy, master)
    _Joined.master, _Joined.process = master.uri, os.getpid()
    return rospy


def within(action: Callable[[], T], *, where: str, doing: str, timeout: float = _REGISTERING) -> T:
    """Call a function of rospy with a deadline, as rospy's requests to the master have none; return its result.

    After the timeout (s) the call goes on in its thread; `where` and `doing` say for the error where and what it does.

    Raises:
        LinkError: it takes too long.
    """
    outcome: list[T] = []
    faults: list[Exception] = []

    def act() -> None:
        try:
            outcome.append(action())
        except Exception as fault:  # noqa: BLE001 - it is raised in the thread that waits for it
            faults.append(fault)

    thread = threading.Thread(target=act, name=f"{doing} {where}", daemon=True)
    thread.start()
    thread.join(timeout)
    if faults:
        raise faults[0]
    if not outcome:
        fix = "Check whether the ROS master is alive."
        raise LinkError(f"{doing} took longer than {timeout:g} s", where=where, fix=fix)
    return outcome[0]


@contextmanager
def completed_first(topic: str, kind: str, complete: Callable[[Any], object]) -> Iterator[None]:
    """Have rospy complete a publisher (`pub`) or subscriber (`sub`) before it registers it at the master, for a while.

    rospy registers first, and sets the options afterwards: depth of the queue, latching, no delay of small messages. A
    node that connects in between would be served without them: without a queue, a subscriber that hangs would block the
    publisher. So `complete` is called with rospy's implementation of the topic, which is given by its absolute name.
    """
    registration = import_module("rospy.impl.registration")

    class Completing(registration.RegistrationListener):  # type: ignore[misc, name-defined]
        def reg_added(self, name: str, _: str, added: str) -> None:
            if (name, added) == (topic, kind):
                complete(registration.get_topic_manager().get_impl(kind, topic))

    listeners, ours = registration.get_registration_listeners(), Completing()
    with listeners.lock:
        listeners.listeners.insert(0, ours)  # before the one that registers at the master
    try:
        yield
    finally:
        with listeners.lock, suppress(ValueError):  # after a shutdown meanwhile, rospy has removed all listeners
            listeners.listeners.remove(ours)


def offers_to_us(topic: str) -> dict[str, Qos]:
    """Return the QoS of the publishers of a topic that are connected to this process, by the names of their nodes."""
    subscriber = import_module("rospy.impl.registration").get_topic_manager().get_impl("sub", topic)
    connections = [] if subscriber is None else list(subscriber.connections)
    return {each.callerid_pub: Qos.TRANSIENT_LOCAL if each.is_latched else Qos.DEFAULT for each in connections}


def check_running(was_shut_down: Callable[[], bool], where: str) -> None:
    """Check that rospy was not shut down: it would drop messages silently.

    Raises:
        LinkError: it was: by `rosnode kill`, by the config, or by a signal where the config has initialised the node.
    """
    if was_shut_down():
        fix = "Leave this node and rospy.signal_shutdown alone while a run executes."
        raise LinkError("the ROS node of this process was shut down", where=where, fix=fix)


def pid_in_name(node: str) -> int | None:
    """Return the id of the process that started a node of Robot Runner; None for a node of another program.

    Example:
        >>> pid_in_name("/robot_runner_4711_1769853600000"), pid_in_name("/move_base")
        (4711, None)
    """
    found = _OWN_NODE.fullmatch(node)
    return int(found[1]) if found else None


def own_address(master: Master) -> str | None:
    """Return the address from which this machine reaches a master on another one; None if the master is local.

    Nothing is sent.
    """
    host, port = master_address(master.uri)
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.connect((host, port))
            address: str = probe.getsockname()[0]
    except OSError:
        return None
    return None if address.startswith("127.") else address


def rospy_missing(name: str) -> LinkError:
    """Return the error that a package of ROS 1 cannot be imported."""
    return LinkError(f"robot is reached over ROS 1, but {name} cannot be imported", where="robot", fix=_INSTALL)


def _rospy() -> Any:
    own = logging.getLoggerClass()
    try:
        return import_module("rospy")
    except ImportError as error:
        raise rospy_missing(error.name or "rospy") from error
    finally:
        logging.setLoggerClass(own)  # rospy sets its own class for all loggers of the process


def _check_process() -> None:
    if _Joined.process != os.getpid():
        problem = "the orchestrating process is a ROS node already, which a run's process cannot be as well"
        raise LinkError(problem, where="ros1", fix="Connect to the robot within the run's events: from start_run on.")


def _move(master: Master) -> None:
    """Become a node of another master, which rospy does not provide for; nothing may be open at the one before."""
    registration = import_module("rospy.impl.registration")
    topics, services = registration.get_topic_manager(), registration.get_service_manager()
    if topics.pubs or topics.subs or services.get_services():
        problem = f"this process is a node of the master {_Joined.master}, and {master.uri} is another"
        raise LinkError(problem, where="ros1", fix="Name the same master for all robots of the experiment.")
    for listener in registration.get_registration_listeners().listeners:
        listener.master_uri = master.uri
    os.environ["ROS_MASTER_URI"] = _Joined.master = master.uri


def _initialise(rospy: Any, master: Master) -> None:
    os.environ["ROS_MASTER_URI"] = master.uri
    address = own_address(master)
    if address is not None and not {"ROS_IP", "ROS_HOSTNAME"} & set(os.environ):
        # Otherwise rospy registers this machine's host name, which the robot can seldom resolve.
        os.environ["ROS_IP"] = address
    logging.getLogger("rosout").addHandler(logging.NullHandler())  # without any handler it would print
    with tempfile.TemporaryDirectory(prefix="robot-runner-ros-") as folder:
        settings = Path(folder) / "python_logging.yaml"
        settings.write_text(_LOGGING, encoding="ascii")
        changed = {"ROS_LOG_DIR": folder, "ROS_HOME": folder, "ROS_PYTHON_LOG_CONFIG_FILE": str(settings)}
        with _environment({**changed, "ROS_LOG_FILENAME": ""}):
            within(lambda: _init_node(rospy), where=master.uri, doing="joining the graph")


def _init_node(rospy: Any) -> None:
    rospy.init_node(
        _NAME, argv=[_NAME], anonymous=True, disable_signals=True, disable_rostime=True, disable_rosout=True
    )
    # Each node has services to set its log level: a node that ends by os._exit would leave them at the master.
    services = import_module("rospy.impl.registration").get_service_manager()
    for name, _ in services.get_services():
        services.map[name].shutdown()


@contextmanager
def _environment(changed: Mapping[str, str]) -> Iterator[None]:
    before = {name: os.environ.get(name) for name in changed}
    os.environ.update(changed)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
