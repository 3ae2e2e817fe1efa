"""Robot Runner's plugins: their calls, carried out by our own plugins, on whatever link the robot has."""

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

#: How long somebody may take to bring the memory card, s.
_PATIENCE_S = 3600.0
_LOOK_S = 1.0


class INA219Profiler:
    """Takes the file that an INA219 logger left on a memory card; it computed no energy, and computes none here."""

    def __init__(self, path_to_data_file: str | Path) -> None:
        self.path_to_data_file = Path(path_to_data_file)

    def halt_and_collect_measures_from_sd_card_and_return_data(self) -> list[list[str]]:
        """Wait until the card is there; returns the cells of its file.

        Raises:
            LinkError: the file is not there within an hour.
        """
        deadline = time.monotonic() + _PATIENCE_S
        while not self.path_to_data_file.is_file():
            if time.monotonic() > deadline:
                raise LinkError(
                    f"there is no file {self.path_to_data_file} after {_PATIENCE_S:g} s",
                    where="INA219Profiler",
                    fix="Insert the memory card, or mend the path.",
                )
            time.sleep(_LOOK_S)
        with self.path_to_data_file.open(encoding="utf-8", newline="") as file:
            return list(csv.reader(file))

    def move_data_file_to_run_folder(self, context: Any, file_name: str) -> None:
        """Copy the card's file into the run's folder; what another run has got already is doubtful."""
        copy = Path(copyfile(self.path_to_data_file, context.run_dir / file_name))
        for other in sorted(copy.parent.parent.glob(f"*/{file_name}")):
            if other != copy and other.is_file() and filecmp.cmp(other, copy, shallow=False):
                problem = f"{self.path_to_data_file} holds what it held in {other.parent.name}"
                warn_of_run(
                    f"{problem}: the energy of this run may not be in it",
                    fix="Read the card again after each run, and delete its file.",
                )


class NetworkProfiler:
    """Captures packets into a file in the run's folder, with tshark."""

    def __init__(self) -> None:
        self._capture: Program | None = None

    def start_sniffing_to_file_between_robot_and_remotepc(
        self,
        context: Any,
        network_interface: str,
        robot_ip_addr: str,
        remotepc_ip_addr: str,
        output_file_name: str,
    ) -> None:
        """Capture what goes between two addresses.

        Raises:
            LinkError: tshark cannot be started.
        """
        between = ["-f", f"host {robot_ip_addr} and host {remotepc_ip_addr}"]
        self._start(context, network_interface, output_file_name, between)

    def start_sniffing_to_file_with_filter(
        self, context: Any, network_interface: str, display_filter: str, output_file_name: str
    ) -> None:
        """Capture everything: what a display filter is to show is chosen when the file is read.

        Raises:
            LinkError: tshark cannot be started.
        """
        self._start(context, network_interface, output_file_name, [])
        warn_of_run(
            f"every packet is in {output_file_name}: tshark takes no display filter while it writes a file",
            fix=f"Read it with tshark -r {output_file_name} -Y {display_filter!r}.",
        )

    def stop_sniffing(self) -> None:
        """End the capture."""
        if self._capture is not None:
            self._capture.end()
            self._capture = None

    def _start(self, context: Any, interface: str, file: str, capture_filter: list[str]) -> None:
        target = str(context.run_dir / file)
        self._capture = Program(["tshark", "-q", "-i", interface, *capture_filter, "-w", target], name="tshark")


class TopicSubscriber:
    """Subscribes to topics through the link to the run's robot; a callback gets a message with attributes."""

    def subscribe_to_topic(self, topic: str, datatype: Any, callback: Callable[..., Any]) -> Any:
        """Return the subscription of a callback to a topic.

        Raises:
            LinkError: the robot cannot be reached, or has no such topic.
        """
        link = connect_robot(current_run("TopicSubscriber"))
        return link.subscribe(topic, _type_name(datatype), lambda message: callback(_with_attributes(message)))

    def subscribe_to_multiple_topics_on_one_callback(
        self, topic_datatype_map: Mapping[str, Any], callback: Callable[..., Any]
    ) -> list[Any]:
        """Return the subscriptions of one callback to several topics."""
        return [self.subscribe_to_topic(topic, kind, callback) for topic, kind in topic_datatype_map.items()]

    def unregister_from_single_subscription(self, subscription: Any) -> None:
        """End a subscription."""
        subscription.close()

    def unregister_from_multiple_subscriptions(self, subscriptions: Iterable[Any]) -> None:
        """End several subscriptions."""
        for subscription in subscriptions:
            self.unregister_from_single_subscription(subscription)


def _type_name(datatype: Any) -> str:
    """Return the ROS name of a message class: rospy's classes know it, rclpy's are in a module of that name."""
    named = getattr(datatype, "_type", None)
    if isinstance(named, str):
        return named
    return f"{datatype.__module__.partition('.')[0]}/{datatype.__name__}"


def _with_attributes(value: Any) -> Any:
    """Return a message whose fields are attributes, as ROS's own messages have them."""
    if isinstance(value, Mapping):
        return SimpleNamespace(**{str(name): _with_attributes(field) for name, field in value.items()})
    if isinstance(value, list | tuple):
        return [_with_attributes(each) for each in value]
    return value


#: The factor that named the task, and the words for tasks, where they are not ours.
_FACTOR = "mission_task"
_TASKS = {"networking": "Network", "streaming": "Video"}


class BasicTurtleBot3:
    """Executes the circular mission, and records processor, memory and battery ten times a second (`metrics.txt`)."""

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
        """Begin to record."""
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
        """End the recording; a line of the file holds processor, memory (per cent) and battery."""
        if self._utilisation is None:
            return
        utilisation, self._utilisation = self._utilisation, None
        utilisation.stop_measurement(_run())
        utilisation.stop_run(_run())
        self._subscription.close()
        if not self._battery:
            warn_of_run(
                "nothing was heard of the battery: its level is nan", fix="See that battery_state is published."
            )
        lines = [
            f"{cpu},{memory},{self._level_at(float(time_s))}\n"
            for time_s, cpu, memory in _samples(_run().raw_data_folder / "samples.csv")
        ]
        (_run().run_folder / self.metrics_file).write_text("".join(lines), encoding="ascii")

    def _level_at(self, time_s: float) -> float:
        """Return what was heard last of the battery until a time; NaN where that is nothing."""
        return next((level for at, level in reversed(self._battery) if at <= time_s), math.nan)

    def stop_run_mission(self) -> None:
        """Stop the robot."""
        if self._robot is not None:
            self._robot.stop_run(_run())


class BasicTurtleBot3Ros2(BasicTurtleBot3):
    """The same for ROS 2; its file had another name."""

    metrics_file = "metrics.csv"


def _run() -> RobotRunnerContext:
    return current_run("BasicTurtleBot3")


def _samples(path: Path) -> Iterator[tuple[str, str, str]]:
    if not path.exists():
        return
    with path.open(newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            if row["cpu_percent"]:  # a first sample has no utilisation: there is none before it
                yield row["time_s"], row["cpu_percent"], row["memory_percent"]
