"""The pose of a robot in a simulator, from a topic of one of several types."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from robot_runner.core.errors import LinkError, PluginError, did_you_mean
from robot_runner.core.links.graph_names import full_name, missing
from robot_runner.core.links.robot import Message, RobotLink
from robot_runner.ros.transforms import yaw_of

if TYPE_CHECKING:
    from robot_runner.ros.simulators.simulator_dialects import Spot

#: How many messages in a row must show the place: the first after a reset may be from before it.
_IN_A_ROW = 2


def distance_between(one: Spot, other: Spot) -> tuple[float, float]:
    """Return the distance of two places, m, and the angle between their headings, rad.

    Example:
        >>> distance_between((0.0, 0.0, 3.1), (3.0, 4.0, 3.1))
        (5.0, 0.0)
    """
    return math.hypot(one[0] - other[0], one[1] - other[1]), abs(math.remainder(one[2] - other[2], 2 * math.pi))


def _of_pose(pose: Message) -> Spot:
    position, turned = pose["position"], pose["orientation"]
    return position["x"], position["y"], yaw_of(*(turned[axis] for axis in "xyzw"))


class WatchedPose:
    """Receives the pose of a robot from a topic, from now on.

    It is of the type nav_msgs/Odometry, geometry_msgs/Pose, PoseStamped or PoseWithCovarianceStamped; or it is
    gazebo_msgs/ModelStates, with the poses of all models, of which the robot's has a name in the simulator.

    Raises:
        LinkError: there is no such topic, or its type has no pose.
    """

    def __init__(self, link: RobotLink, topic: str, *, namespace: str, model: str) -> None:
        self._name = full_name(namespace, topic)
        self._changed = threading.Condition()
        self._latest: Spot | None = None
        self._in_a_row = 0
        self._is_there: Callable[[Spot], bool] = lambda _: False
        readers: Mapping[str, Callable[[Message], Spot | None]] = {
            "nav_msgs/Odometry": lambda message: _of_pose(message["pose"]["pose"]),
            "geometry_msgs/PoseWithCovarianceStamped": lambda message: _of_pose(message["pose"]["pose"]),
            "geometry_msgs/PoseStamped": lambda message: _of_pose(message["pose"]),
            "geometry_msgs/Pose": _of_pose,
            "gazebo_msgs/ModelStates": lambda message: _of_model(message, model),
        }
        topics = link.topics()
        if self._name not in topics:
            fix = "Name the topic that tells where the robot stands: pose_topic='odom'."
            raise missing("topic", self._name, topics, where="the simulator", fix=fix)
        kind = topics[self._name]
        if kind not in readers:
            problem = f"{self._name} is of the type {kind}, which does not tell where a robot stands"
            fix = f"Name another pose_topic. {did_you_mean(kind, readers)}"
            raise LinkError(problem, where="the simulator", fix=fix)
        self._read = readers[kind]
        self._subscription = link.subscribe(self._name, kind, self._take, is_prompt=True)

    def see(self, spot: Spot, *, metres: float, radians: float, timeout: float) -> None:
        """Return once the robot is at this place.

        Raises:
            LinkError: it is not within `timeout` seconds of this machine; the message says where it is.
        """

        def is_there(seen: Spot) -> bool:
            way, turn = distance_between(seen, spot)
            return way <= metres and turn <= radians

        with self._changed:
            self._is_there, self._in_a_row, self._latest = is_there, 0, None
            if self._changed.wait_for(lambda: self._in_a_row >= _IN_A_ROW, timeout):
                return
            latest = self._latest
        if latest is None:
            problem = f"the simulator was reset, and nothing came on {self._name} within {timeout:g} s"
            fix = "Check whether it goes on, and whether its robot is still there."
            raise LinkError(problem, where="the simulator", fix=fix)
        way, turn = distance_between(latest, spot)
        raise LinkError(
            f"the simulator did not reset: after {timeout:g} s the robot stands at ({latest[0]:.3f}, {latest[1]:.3f}, "
            f"{latest[2]:.3f} rad), {way:.3f} m and {turn:.3f} rad from where it is to start",
            where=self._name,
            fix="Say where it starts (start=(x, y, yaw)), name another reset or pose_topic, or widen tolerance_m.",
        )

    def close(self) -> None:
        """End the subscription; closing twice does nothing."""
        self._subscription.close()

    def _take(self, message: Message) -> None:
        spot = self._read(message)
        if spot is None:
            return
        with self._changed:
            self._latest = spot
            self._in_a_row = self._in_a_row + 1 if self._is_there(spot) else 0
            self._changed.notify_all()


def _of_model(message: Message, model: str) -> Spot | None:
    names = list(message["name"])
    return _of_pose(message["pose"][names.index(model)]) if model in names else None


def checked_spot(given: object) -> Spot:
    """Return a place from a config, after checking it; raise a `PluginError` if it is not valid."""
    values = list(given) if isinstance(given, list | tuple) else []
    numbers = [float(each) for each in values if isinstance(each, int | float) and math.isfinite(each)]
    if len(values) != len(numbers) or len(numbers) != 3:  # noqa: PLR2004 - x, y and yaw
        raise PluginError(f"start is {given!r}", where="Simulation", fix="Give (x, y, yaw) in metres and radians.")
    return numbers[0], numbers[1], numbers[2]
