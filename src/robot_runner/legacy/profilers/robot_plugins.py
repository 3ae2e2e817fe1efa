"""Adapters with the methods of Robot Runner's earlier plugins, on our own plugins and the robot's link."""

from __future__ import annotations

import csv
import filecmp
import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from shutil import copyfile
from types import SimpleNamespace
from typing import Any

from robot_runner.core.errors import LinkError
from robot_runner.core.events.context import RobotRunnerContext
from robot_runner.core.links.connect import connect_robot
from robot_runner.core.plugin import find_plugin
from robot_runner.legacy.profilers.programs import Program
from robot_runner.legacy.session import current_run, warn_of_run

#: The time that a person has to insert the memory card, s.
_PATIENCE_S = 3600.0
_LOOK_S = 1.0


class INA219Profiler:
    """Copies the file of an INA219 logger from a memory card; as before, it does not compute the energy."""

    def __init__(self, path_to_data_file: str | Path) -> None:
        self.path_to_data_file = Path(path_to_data_file)

    def halt_and_collect_measures_from_sd_card_and_return_data(self) -> list[list[str]]:
        """Wait for the memory card, and return the cells of its file.

        Raises:
            LinkError: the file is not there within an hour.
        """
        deadline = time.monotonic() + _PATIENCE_S
        while not self.path_to_data_file.is_file():
            if time.monotonic() > deadline:
                problem = f"there is no file {self.path_to_data_file} after {_PATIENCE_S:g} s"
                raise LinkError(problem, where="INA219Profiler", fix="Insert the memory card, or correct the path.")
            time.sleep(_LOOK_S)
        with self.path_to_data_file.open(encoding="utf-8", newline="") as file:
            return list(csv.reader(file))

    def move_data_file_to_run_folder(self, context: Any, file_name: str) -> None:
        """Copy the card's file into the run's folder; warn if another run has the same file."""
        copy = Path(copyfile(self.path_to_data_file, context.run_dir / file_name))
        for other in sorted(copy.parent.parent.glob(f"*/{file_name}")):
            if other != copy and other.is_file() and filecmp.cmp(other, copy, shallow=False):
                problem = f"{self.path_to_data_file} holds what it held in {other.parent.name}"
                fix = "Read the card again after each run, and delete its file."
                warn_of_run(f"{problem}: the energy of this run may not be in it", fix=fix)


class NetworkProfiler:
    """Captures packets into a file in the run's folder by tshark."""

    def __init__(self) -> None:
        self._capture: Program | None = None

    def start_sniffing_to_file_between_robot_and_remotepc(
        self, context: Any, network_interface: str, robot_ip_addr: str, remotepc_ip_addr: str, output_file_name: str
    ) -> None:
        """Capture the packets between two addresses.

        Raises:
            LinkError: tshark cannot be started.
        """
        between = ["-f", f"host {robot_ip_addr} and host {remotepc_ip_addr}"]
        self._start(context, network_interface, output_file_name, between)

    def start_sniffing_to_file_with_filter(
        self, context: Any, network_interface: str, display_filter: str, output_file_name: str
    ) -> None:
        """Capture all packets: the display filter can only be applied when the file is read.

        Raises:
            LinkError: tshark cannot be started.
        """
        self._start(context, network_interface, output_file_name, [])
        problem = f"every packet is in {output_file_name}: tshark takes no display filter while it writes a file"
        warn_of_run(problem, fix=f"Read it with tshark -r {output_file_name} -Y {display_filter!r}.")

    def stop_sniffing(self) -> None:
        """Stop the capture."""
        if self._capture is not None:
            self._capture.end()
            self._capture = None

    def _start(self, context: Any, interface: str, file: str, capture_filter: list[str]) -> None:
        target = str(context.run_dir / file)
        self._capture = Program(["tshark", "-q", "-i", interface, *capture_filter, "-w", target], name="tshark")


class TopicSubscriber:
    """Subscribes to topics through the link to the run's robot; callbacks get messages with attributes."""

    def subscribe_to_topic(self, topic: str, datatype: Any, callback: Callable[..., Any]) -> Any:
        """Subscribe a callback to a topic, and return the subscription.

        Raises:
            LinkError: the robot cannot be reached, or has no such topic.
        """
        link = connect_robot(current_run("TopicSubscriber"))
        return link.subscribe(topic, _type_name(datatype), lambda message: callback(_with_attributes(message)))

    def subscribe_to_multiple_topics_on_one_callback(
        self, topic_datatype_map: Mapping[str, Any], callback: Callable[..., Any]
    ) -> list[Any]:
        """Subscribe a callback to several topics, and return the subscriptions."""
        return [self.subscribe_to_topic(topic, kind, callback) for topic, kind in topic_datatype_map.items()]

    def unregister_from_single_subscription(self, subscription: Any) -> None:
        """End a subscription."""
        subscription.close()

    def unregister_from_multiple_subscriptions(self, subscriptions: Iterable[Any]) -> None:
        """End several subscriptions."""
        for subscription in subscriptions:
            self.unregister_from_single_subscription(subscription)


def _type_name(datatype: Any) -> str:
    """Return the ROS name of a message class: an attribute in rospy's classes, the module's name in rclpy's."""
    named = getattr(datatype, "_type", None)
    if isinstance(named, str):
        return named
    return f"{datatype.__module__.partition('.')[0]}/{datatype.__name__}"


def _with_attributes(value: Any) -> Any:
    """Return a message with its fields as attributes, as in ROS's own messages."""
    if isinstance(value, Mapping):
        return SimpleNamespace(**{str(name): _with_attributes(field) for name, field in value.items()})
    if isinstance(value, list | tuple):
        return [_with_attributes(each) for each in value]
    return value


#: The factor with the task, and the names of tasks that differ from ours.
_FACTOR = "mission_task"
_TASKS = {"networking": "Network", "streaming": "Video"}


class BasicTurtleBot3:
    """Executes the circular mission, and records CPU, memory and battery ten times a second (`metrics.txt`)."""

    metrics_file = "metrics.txt"

    def __init__(self) -> None:
        self._robot: Any = None
        self._utilisation: Any = None
        self._battery: list[tuple[float, float]] = []
        self._subscription: Any = None

    def start_run_mini_mission_real_world(self, context: Any) -> None:
        """Connect to the robot."""
        task = str(context.run_variation.get(_FACTOR, "Computation"))
        task = _TASKS.get(task.casefold(), task.capitalize())
        self._robot = find_plugin("systems", "BasicTurtlebot3")(task_factor=None, task=task)  # type: ignore[call-arg]
        self._robot.start_run(_run())

    def start_measurement_mission(self) -> None:
        """Start recording."""
        self._battery.clear()
        clock = _run().clock
        self._subscription = connect_robot(_run()).subscribe(
            "battery_state",
            "sensor_msgs/BatteryState",
            lambda message: self._battery.append((clock.now(), message["percentage"])),
        )
        self._utilisation = find_plugin("profilers", "PsUtil")()
        self._utilisation.start_measurement(_run())

    def launch_mini_mission_real_world(self, context: Any) -> None:
        """Execute the mission."""
        del context
        self._robot.launch_mission(_run())

    def stop_measurement_mission(self) -> None:
        """Stop recording, and write the file: CPU (per cent), memory (per cent) and battery on each line."""
        if self._utilisation is None:
            return
        utilisation, self._utilisation = self._utilisation, None
        utilisation.stop_measurement(_run())
        utilisation.stop_run(_run())
        self._subscription.close()
        if not self._battery:
            fix = "See that battery_state is published."
            warn_of_run("nothing was heard of the battery: its level is nan", fix=fix)
        lines = [
            f"{cpu},{memory},{self._level_at(float(time_s))}\n"
            for time_s, cpu, memory in _samples(_run().raw_data_folder / "samples.csv")
        ]
        (_run().run_folder / self.metrics_file).write_text("".join(lines), encoding="ascii")

    def _level_at(self, time_s: float) -> float:
        """Return the last level of the battery until a time; NaN if there was none."""
        return next((level for at, level in reversed(self._battery) if at <= time_s), math.nan)

    def stop_run_mission(self) -> None:
        """Stop the robot."""
        if self._robot is not None:
            self._robot.stop_run(_run())


class BasicTurtleBot3Ros2(BasicTurtleBot3):
    """The same for ROS 2; its file has another name."""

    metrics_file = "metrics.csv"


def _run() -> RobotRunnerContext:
    return current_run("BasicTurtleBot3")


def _samples(path: Path) -> Iterator[tuple[str, str, str]]:
    if not path.exists():
        return
    with path.open(newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            if row["cpu_percent"]:  # the first sample has no utilisation, which needs a previous one
                yield row["time_s"], row["cpu_percent"], row["memory_percent"]
