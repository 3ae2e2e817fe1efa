"""One embedded robot on a graph: its topics, services and commands."""

from __future__ import annotations

import logging
import threading
import time
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from robot_runner.core.errors import LinkError
from robot_runner.core.links.connect import SIMULATION_TOPIC
from robot_runner.core.links.graph_names import full_name
from robot_runner.core.links.robot import Encoding, Message, Qos, RobotLink
from robot_runner.ros.graph_link import GraphLink
from robot_runner.ros.shapes import stamp_of
from robot_runner.ros.watchdog import HEARTBEAT_TOPIC, HEARTBEAT_TYPE, RELEASE_SERVICE, RELEASE_TYPE, Watchdog
from robot_runner.simulator.camera import CAMERA_TOPICS
from robot_runner.simulator.sensors import Listening
from robot_runner.simulator.simulated_devices import MeterTerminal
from robot_runner.simulator.simulated_turtlebot3 import Simulation

#: It comes with tf2, which the smallest installations of ROS 2 lack.
_TRANSFORM_TYPE = "tf2_msgs/TFMessage"
#: Best effort, as of the robot's own drivers; all else is reliable.
_QOS = {"scan": Qos.SENSOR_DATA, "imu": Qos.SENSOR_DATA}

_VELOCITY, _ODOMETRY, _TRANSFORM = "cmd_vel", "odom", "tf"
_CAMERA_INFO = "sensor_msgs/CameraInfo"
_STANDSTILL = {"linear": {"x": 0.0}, "angular": {"z": 0.0}}

_logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulatedPlace:
    """The graph of the embedded robot, and the settings of its simulation.

    Attributes:
        link: to the graph, as for `robot` in a config: `ros1`, `ros2`, `dds`, or `dds:domain=7`.
        namespace: of the robot: empty, or `/alice`.
        seed: of the first simulation; each reset takes the next one.
        real_time_factor: simulated seconds a real second.
        is_clock: whether its time is published on `/clock` and used in stamps; else stamps have this machine's time.
        has_watchdog: whether it stops when the heartbeats of the run that drives it stop.
        room: the file of the room; None for the default room.
        model: the MJCF file of the robot; None for a TurtleBot3.
        has_camera: whether it has its camera's topics; pictures are made only for subscribers.

    Example:
        >>> SimulatedPlace(link="dds:domain=7", namespace="/alice").real_time_factor
        1.0
    """

    link: str
    namespace: str = ""
    seed: int = 1
    real_time_factor: float = 1.0
    is_clock: bool = False
    has_watchdog: bool = True
    room: Path | None = None
    model: Path | None = None
    has_camera: bool = False


class GraphRobot:
    """One robot of a simulation on a graph: its topics and services, its transform and its watchdog.

    The caller closes the link to its namespace. The lock is held while the simulation is used: callbacks come from
    threads of the link. With `has_meter` its power meter is opened on a terminal: `meter`.

    Raises:
        LinkError: the graph cannot be reached, or there is such a robot already.
    """

    def __init__(
        self,
        link: RobotLink,
        simulation: Simulation,
        place: SimulatedPlace,
        *,
        namespace: str = "",
        lock: threading.RLock | None = None,
        has_meter: bool = False,
    ) -> None:
        self._link = link
        self._place = place
        self._pictures: dict[str, Listening] = {}
        self._namespace = namespace
        self._has_transform = _is_known(link, _TRANSFORM_TYPE)
        self._watchdog = Watchdog() if place.has_watchdog else Watchdog(heartbeat_timeout=0.0)
        self._lock = lock or threading.RLock()
        self._closing = ExitStack()
        self._listening = ExitStack()
        self.meter: MeterTerminal | None = None
        with ExitStack() as undoing:
            undoing.callback(self.close)
            self.enter(simulation)
            if has_meter:
                self.meter = MeterTerminal(simulation, namespace=namespace)
                self._closing.callback(self.meter.close)
            self._offer()
            self._subscribe()
            if place.has_camera:
                self._show_camera()
            self._link.publish(SIMULATION_TOPIC, "std_msgs/String", {"data": "turtlebot3"}, qos=Qos.TRANSIENT_LOCAL)
            undoing.pop_all()

    def enter(self, simulation: Simulation) -> None:
        """Switch to the robot of this simulation; the topics go on."""
        self._listening.close()
        self._pictures.clear()
        self._clock = simulation.clock
        self._robot = simulation.robot(self._namespace)
        # Always made: each of these messages advances the physics, which could not be caught up with after hours.
        steady = {_ODOMETRY, next(iter(self._robot.topics))}
        for name, topic in self._robot.topics.items():
            if name in CAMERA_TOPICS:
                continue
            qos = _QOS.get(name, Qos.DEFAULT)
            publish = partial(self._publish, name, topic.message_type, qos)
            is_wanted = (lambda: True) if name in steady else partial(self._is_heard, name, qos)
            self._listening.callback(topic.listen(publish, is_wanted).close)
        if self.meter is not None:
            self.meter.enter(simulation)

    def watch_camera(self) -> None:
        """Make the camera's pictures only while there are subscribers."""
        if not self._place.has_camera:
            return
        for name in CAMERA_TOPICS:
            topic = self._robot.topics.get(name)
            if topic is None:
                continue
            is_seen = any(each.may_be_others for each in self._link.subscribers(full_name(self._namespace, name)))
            if is_seen and name not in self._pictures:
                publish = partial(self._publish, name, topic.message_type, Qos.SENSOR_DATA)
                self._pictures[name] = topic.listen(publish)
            elif not is_seen and name in self._pictures:
                self._pictures.pop(name).close()

    def put_back(self) -> None:
        """Stop the robot, and put it back to its start."""
        self._robot.put_back()

    def watch(self) -> None:
        """Stop the robot when the heartbeats of the run that drives it have stopped."""
        if self._watchdog.must_stop(time.monotonic()):
            self._stop()

    def close(self) -> None:
        """End all offers and subscriptions; closing twice does nothing."""
        self._listening.close()
        self._closing.close()

    def _offer(self) -> None:
        for name, service_type in self._robot.services.items():
            self._keep(self._link.offer(name, service_type, partial(self._call, name)))
        self._keep(self._link.offer(RELEASE_SERVICE, RELEASE_TYPE, self._release))

    def _subscribe(self) -> None:
        for topic, message_type in self._robot.command_topics.items():
            self._keep(self._link.subscribe(topic, message_type, partial(self._command, topic)))
        self._keep(self._link.subscribe(HEARTBEAT_TOPIC, HEARTBEAT_TYPE, self._take_heartbeat))

    def _show_camera(self) -> None:
        """Publish one picture, so that the topics are visible, and an error of the renderer is noticed."""
        for name in CAMERA_TOPICS:
            topic = self._robot.topics.get(name)
            if topic is None:
                fix = "Give it one: <camera pos=... xyaxes=.../>; or leave --camera out."
                raise LinkError("the model has no camera", where="the simulated robot", fix=fix)
            self._publish(name, topic.message_type, Qos.SENSOR_DATA, topic.latest())

    def _keep(self, subscription: Any) -> None:
        self._closing.callback(subscription.close)

    def _is_heard(self, name: str, qos: Qos) -> bool:
        """Whether a message has a receiver: publishing 200 a second to nothing took most of the processor time."""
        return not isinstance(self._link, GraphLink) or self._link.is_heard(name, qos)

    def _publish(self, name: str, message_type: str, qos: Qos, message: dict[str, Any]) -> None:
        stamped = {**message, "header": {**message["header"], "stamp": self._stamp()}}
        if message_type == _CAMERA_INFO and self._link.encoding is Encoding.ROS1:  # which names matrices in capitals
            stamped |= {each.upper(): stamped.pop(each) for each in "dkrp"}
        self._link.publish(name, message_type, stamped, qos=qos)
        if name == _ODOMETRY and self._has_transform and self._is_heard(_TRANSFORM, Qos.DEFAULT):
            self._link.publish(_TRANSFORM, _TRANSFORM_TYPE, {"transforms": [_transform(stamped)]})

    def _stamp(self) -> dict[str, int]:
        return stamp_of(self._clock.now_ns if self._place.is_clock else time.time_ns())

    def _command(self, topic: str, message: Message) -> None:
        is_moving = topic != _VELOCITY or bool(message["linear"]["x"] or message["angular"]["z"])
        with self._lock:
            self._watchdog.hear_command(is_moving=is_moving, now=time.monotonic())
            try:
                self._robot.command(topic, message)
            except LinkError as error:  # a wrong message on the graph must not end the simulation
                _logger.warning("a command was not carried out: %s", error)

    def _stop(self) -> None:
        """Stop the wheels; joints keep their last command."""
        if _VELOCITY in self._robot.command_topics:
            self._robot.command(_VELOCITY, _STANDSTILL)

    def _take_heartbeat(self, message: Message) -> None:
        with self._lock:
            self._watchdog.hear_heartbeat(message["data"], time.monotonic())

    def _call(self, name: str, request: Message) -> Message:
        del request
        with self._lock:
            return self._robot.call(name)

    def _release(self, request: Message) -> Message:
        del request
        with self._lock:
            self._watchdog.release()
        return {"success": True, "message": "the robot may be moved until the next heartbeat"}


def _is_known(link: RobotLink, message_type: str) -> bool:
    try:
        link.definition(message_type)
    except LinkError as error:
        _logger.warning("the robot publishes nothing on tf: %s", error)
        return False
    return True


def _transform(odometry: Message) -> Message:
    pose = odometry["pose"]["pose"]
    return {
        "header": odometry["header"],
        "child_frame_id": odometry["child_frame_id"],
        "transform": {"translation": pose["position"], "rotation": pose["orientation"]},
    }
