"""What a link to a robot adds to the client library that it stands on, and whether it loses anything."""

from __future__ import annotations

import importlib.util
import multiprocessing
import os
import shutil
import socket
import statistics
import subprocess
import tempfile
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from benchmarks.table import Row, print_table

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from multiprocessing.synchronize import Event

_ODOMETRY = "nav_msgs/Odometry"
_TOPIC = "/odom"
_DOMAIN = 61
_LOOPBACK = (
    "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name='lo' multicast='true'/></Interfaces></General>"
    "</Domain></CycloneDDS>"
)

#: Latencies are taken at the rate of a TurtleBot3's odometry, times four.
_RATE, _COUNT = 100.0, 500
_FAST_RATE, _FAST_COUNT = 1000.0, 10_000
_ROUNDS = 3
_BOUND = 1.5
_DEADLINE = 60.0


def main() -> None:
    """Publish odometry in one process and hear it in another, through each link and through the bare library."""
    os.environ["CYCLONEDDS_URI"] = _LOOPBACK
    rows = _rows("dds", "cyclonedds", _speak_dds, _hear_dds, _speak_cyclone, _hear_cyclone)
    if importlib.util.find_spec("rospy") is None or shutil.which("rosmaster") is None:
        print("ros1 is left out: there is no rospy or no rosmaster here.")
    else:
        with _master():
            rows += _rows("ros1", "rospy", _speak_ros1, _hear_ros1, _speak_rospy, _hear_rospy)
    print_table(f"Links: {_ODOMETRY} from process to process on loopback, median of {_ROUNDS} rounds", rows)


def _rows(
    name: str,
    library: str,
    speak_link: Callable[..., None],
    hear_link: Callable[..., Any],
    speak_bare: Callable[..., None],
    hear_bare: Callable[..., Any],
) -> list[Row]:
    link, bare = [], []
    for _ in range(_ROUNDS):
        link.append(_median_us(_heard(speak_link, hear_link, _RATE, _COUNT)))
        bare.append(_median_us(_heard(speak_bare, hear_bare, _RATE, _COUNT)))
    fast = _heard(speak_link, hear_link, _FAST_RATE, _FAST_COUNT)
    mine, floor = statistics.median(link), statistics.median(bare)
    return [
        Row(
            f"{name}, publish to callback at {_RATE:.0f} Hz",
            f"{mine:.0f} us",
            f"{floor:.0f} us ({library} alone)",
            f"{mine / floor:.2f}",
            f"{_BOUND:g}",
        ),
        Row(
            f"{name}, lost of {_FAST_COUNT} messages at {_FAST_RATE:.0f} Hz",
            str(_FAST_COUNT - len(fast)),
            ratio="",
            bound="0",
        ),
    ]


def _heard(speak: Callable[..., None], hear: Callable[..., Any], rate: float, count: int) -> list[int]:
    """Return the latency of each message that was heard, in ns."""
    latencies: list[int] = []
    context = multiprocessing.get_context("spawn")
    is_heard, is_over = context.Event(), context.Event()
    close = hear(latencies)
    speaker = context.Process(target=speak, args=(rate, count, is_heard, is_over))
    speaker.start()
    try:
        _await(lambda: bool(latencies))
        is_heard.set()
        speaker.join(_DEADLINE + count / rate)
        is_over.set()
    finally:
        close()
        speaker.kill()
    return latencies[-count:] if len(latencies) > count else latencies


def _await(is_so: Callable[[], bool]) -> None:
    deadline = time.monotonic() + _DEADLINE
    while not is_so():
        if time.monotonic() > deadline:
            raise TimeoutError("nothing was heard")
        time.sleep(0.01)


def _speak(publish: Callable[[int], None], rate: float, count: int, is_heard: Event) -> None:
    """Publish until the other side hears, then `count` messages at this rate, each with the time in its stamp."""
    while not is_heard.wait(0.02):
        publish(time.monotonic_ns())
    time.sleep(0.1)
    begun = time.monotonic()
    for number in range(count):
        time.sleep(max(0.0, begun + number / rate - time.monotonic()))
        publish(time.monotonic_ns())
    time.sleep(0.5)


def _speak_dds(rate: float, count: int, is_heard: Event, _is_over: Event) -> None:
    _speak_link(_dds_link(), rate, count, is_heard)


def _hear_dds(latencies: list[int]) -> Callable[[], None]:
    return _hear_link(_dds_link(), latencies)


def _speak_ros1(rate: float, count: int, is_heard: Event, _is_over: Event) -> None:
    _speak_link(_ros1_link(), rate, count, is_heard)


def _hear_ros1(latencies: list[int]) -> Callable[[], None]:
    return _hear_link(_ros1_link(), latencies)


def _speak_link(link: Any, rate: float, count: int, is_heard: Event) -> None:
    from robot_runner.core.links.robot import Qos  # noqa: PLC0415  # a link is opened in the process that uses it

    qos = Qos.RELIABLE if rate >= _FAST_RATE else Qos.DEFAULT
    _speak(lambda now: link.publish(_TOPIC, _ODOMETRY, _message(now), qos=qos), rate, count, is_heard)
    link.close()


def _hear_link(link: Any, latencies: list[int]) -> Callable[[], None]:
    def hear(message: Mapping[str, Any]) -> None:
        stamp = message["header"]["stamp"]
        latencies.append(time.monotonic_ns() - stamp["sec"] * 10**9 - stamp["nanosec"])

    link.subscribe(_TOPIC, _ODOMETRY, hear)
    close: Callable[[], None] = link.close
    return close


def _dds_link() -> Any:
    from robot_runner.core.events.context import SystemClock  # noqa: PLC0415  # as above
    from robot_runner.ros.link_opening import open_dds_link  # noqa: PLC0415

    return open_dds_link({"domain": str(_DOMAIN), "distro": "jazzy"}, SystemClock())


def _ros1_link() -> Any:
    from robot_runner.core.events.context import SystemClock  # noqa: PLC0415  # as above
    from robot_runner.ros.link_opening import open_ros1_link  # noqa: PLC0415

    return open_ros1_link({}, SystemClock())


def _message(now_ns: int) -> dict[str, Any]:
    stamp = {"sec": now_ns // 10**9, "nanosec": now_ns % 10**9}
    return {
        "header": {"stamp": stamp, "frame_id": "odom"},
        "child_frame_id": "base_footprint",
        "pose": {"pose": {"orientation": {"w": 1.0}}, "covariance": [0.0] * 36},
    }


def _speak_cyclone(rate: float, count: int, is_heard: Event, _is_over: Event) -> None:
    from cyclonedds.pub import DataWriter  # noqa: PLC0415

    from benchmarks.odometry_types import still_odometry  # noqa: PLC0415

    participant, topic, qos = _cyclone()
    writer = DataWriter(participant, topic, qos)
    _speak(lambda now: writer.write(still_odometry(now // 10**9, now % 10**9)), rate, count, is_heard)


def _hear_cyclone(latencies: list[int]) -> Callable[[], None]:
    from cyclonedds.core import Listener  # noqa: PLC0415
    from cyclonedds.sub import DataReader  # noqa: PLC0415

    class Hearing(Listener):
        def on_data_available(self, reader: Any) -> None:
            for sample in reader.take(100):
                if not sample.sample_info.valid_data:
                    continue
                stamp = sample.header.stamp
                latencies.append(time.monotonic_ns() - stamp.sec * 10**9 - stamp.nanosec)

    participant, topic, qos = _cyclone()
    reader: Any = DataReader(participant, topic, qos, listener=Hearing())  # type: ignore[no-untyped-call]

    def close() -> None:
        reader.__del__()
        participant.__del__()

    return close


def _cyclone() -> tuple[Any, Any, Any]:
    from cyclonedds.domain import DomainParticipant  # noqa: PLC0415
    from cyclonedds.qos import Policy, Qos  # noqa: PLC0415
    from cyclonedds.topic import Topic  # noqa: PLC0415

    from benchmarks.odometry_types import Odometry  # noqa: PLC0415

    participant = DomainParticipant(_DOMAIN)
    qos = Qos(Policy.Reliability.Reliable(500_000_000), Policy.History.KeepLast(10))
    return participant, Topic(participant, f"rt{_TOPIC}", Odometry), qos


@contextmanager
def _master() -> Iterator[None]:
    """Start a master on loopback, and end it by its process id."""
    from robot_runner.ros.ros1_master import Master  # noqa: PLC0415

    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    with tempfile.TemporaryDirectory() as folder:
        os.environ |= {"ROS_MASTER_URI": f"http://127.0.0.1:{port}", "ROS_IP": "127.0.0.1"}
        os.environ |= {"ROS_HOME": folder, "ROS_LOG_DIR": folder}
        command = ["/usr/bin/python3", str(shutil.which("rosmaster")), "--core", "-p", str(port)]
        quiet = subprocess.DEVNULL
        with subprocess.Popen(command, stdin=quiet, stdout=quiet, stderr=quiet) as process:
            try:
                _await(lambda: _answers(Master()))
                yield
            finally:
                process.terminate()


def _answers(master: Any) -> bool:
    from robot_runner.core.errors import LinkError  # noqa: PLC0415

    try:
        master.check()
    except LinkError:
        return False
    return True


def _speak_rospy(rate: float, count: int, is_heard: Event, _is_over: Event) -> None:
    rospy, odometry = _rospy("speaker")
    publisher = rospy.Publisher(_TOPIC, odometry, queue_size=10, tcp_nodelay=True)

    def publish(now: int) -> None:
        message = odometry()
        message.header.stamp = rospy.Time(now // 10**9, now % 10**9)
        message.header.frame_id, message.child_frame_id = "odom", "base_footprint"
        message.pose.pose.orientation.w = 1.0
        publisher.publish(message)

    _speak(publish, rate, count, is_heard)
    rospy.signal_shutdown("done")


def _hear_rospy(latencies: list[int]) -> Callable[[], None]:
    rospy, odometry = _rospy("listener")

    def hear(message: Any) -> None:
        latencies.append(time.monotonic_ns() - message.header.stamp.to_nsec())

    subscriber = rospy.Subscriber(_TOPIC, odometry, hear, tcp_nodelay=True)
    close: Callable[[], None] = subscriber.unregister
    return close


def _rospy(name: str) -> tuple[Any, Any]:
    """Return rospy and the class of odometry; the node is the one of the link where there has been one."""
    rospy = importlib.import_module("rospy")
    if not rospy.core.is_initialized():
        rospy.init_node(name, disable_signals=True, disable_rosout=True)
    return rospy, importlib.import_module("nav_msgs.msg").Odometry


def _median_us(latencies: list[int]) -> float:
    return statistics.median(latencies) / 1e3


if __name__ == "__main__":
    main()
