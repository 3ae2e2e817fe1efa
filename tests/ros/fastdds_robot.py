"""A robot on Fast DDS, the middleware of ROS 2 Humble: its C++ relay, and what a node is on top of it.

The relay (`fastdds_node/relay.cpp`) is built once for all tests, where Debian's Fast DDS and a compiler are installed.
Names, types, QoS and the identities of requests are as rmw_fastrtps_cpp of Humble has them; bytes are made by hand.
"""

from __future__ import annotations

import math
import shutil
import struct
import subprocess
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import pytest
from tests.made_once import made_once

from robot_runner.core.links.robot import Encoding
from robot_runner.ros.shapes import completed
from robot_runner.ros.type_catalogue import TypeCatalogue

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["FastNode", "Sample", "needs_fastdds", "relay_program"]

SOURCE = Path(__file__).parent / "fastdds_node" / "relay.cpp"
LIBRARY = Path("/usr/include/fastdds/dds/domain/DomainParticipant.hpp")
PATIENCE = 30.0
NOBODY = "0" * 32

needs_fastdds = pytest.mark.skipif(
    shutil.which("g++") is None or not LIBRARY.exists(),
    reason="no Fast DDS: Debian's packages libfastrtps-dev and g++ are not installed",
)


def relay_program(factory: pytest.TempPathFactory) -> Path:
    """Return the relay's program, built by whichever process needs it first."""

    def build(folder: Path) -> None:
        command = ["g++", "-std=c++17", "-O0", "-Wall", "-Werror", str(SOURCE), "-o", str(folder / "relay")]
        subprocess.run([*command, "-lfastrtps", "-lfastcdr"], check=True)

    return made_once(factory, "fastdds_relay", build) / "relay"


class Sample(NamedTuple):
    """What was received: who wrote it (GUID, number), which request it belongs to, and its bytes."""

    writer: str
    number: int
    client: str
    request: int
    data: bytes


class FastNode:
    """A node of ROS 2 over Fast DDS."""

    def __init__(self, program: Path, domain: int, name: str = "fast_robot") -> None:
        self.name = name
        self.types = TypeCatalogue.of(2, "humble", ())
        self.process = subprocess.Popen(
            [program, str(domain)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1
        )
        self._hearers: dict[str, Callable[[Sample], None]] = {}
        self._lines: dict[tuple[str, str], str] = {}
        self._changed = threading.Condition()
        self._count = 0
        self._writing = threading.Lock()
        self._readers: list[str] = []
        self._writers: list[str] = []
        self._reading = threading.Thread(target=self._read, daemon=True)
        self._reading.start()
        self.guid = self._told("ready", "")
        self._discovery = self._make("w", "ros_discovery_info", _INFO_TYPE, "transient_local")
        self._tell()

    def publisher(self, topic: str, kind: str, profile: str = "reliable") -> str:
        """Make a publisher and return its name; `kind` is a DDS type."""
        made, guid = self._endpoint("w", f"rt{topic}", kind, profile)
        self._writers.append(guid)
        self._tell()
        return made

    def subscribe(self, topic: str, kind: str, hear: Callable[[Sample], None], profile: str = "reliable") -> str:
        """Have `hear` called, in the thread that reads, with each sample."""
        made, guid = self._endpoint("r", f"rt{topic}", kind, profile, hear)
        self._readers.append(guid)
        self._tell()
        return made

    def offer(
        self, service: str, kind: str, answer: Callable[[Sample], bytes | None]
    ) -> Callable[[Sample, bytes], None]:
        """Offer a service; returns what replies to a request later, where `answer` returns None."""
        package, folder, name = kind.split("/")
        prefix = f"{package}::{folder}::dds_::{name}"
        writer, guid = self._endpoint("w", f"rr{service}Reply", f"{prefix}_Response_", "reliable")
        self._writers.append(guid)

        def reply(request: Sample, data: bytes) -> None:
            # rmw_fastrtps: a client that tells the GUID of its reader is known by that, any other by its writer.
            client = request.client if request.client != NOBODY else request.writer
            self.write(writer, data, client, request.number)

        taken: set[tuple[str, int]] = set()

        def hear(request: Sample) -> None:
            if (request.writer, request.number) in taken:
                return  # on a busy machine Fast DDS 2.9 hands out some requests twice (decision 0061)
            taken.add((request.writer, request.number))
            data = answer(request)
            if data is not None:
                reply(request, data)

        _, guid = self._endpoint("r", f"rq{service}Request", f"{prefix}_Request_", "reliable", hear)
        self._readers.append(guid)
        self._tell()
        return reply

    def write(self, writer: str, data: bytes, client: str = "", number: int = 0) -> None:
        """Write a sample, as the reply to a request where its client is given."""
        self._send(f"write {writer} {data.hex()}" + (f" {client} {number}" if client else ""))

    def matched(self, endpoint: str) -> int:
        """Return how many are matched with a publisher or subscription."""
        return int(self._lines.get(("matched", endpoint), "0"))

    def wait_for(self, is_so: Callable[[], object], what: str) -> None:
        deadline = time.monotonic() + PATIENCE
        while not is_so():
            assert time.monotonic() < deadline, what
            time.sleep(0.01)

    def pack(self, kind: str, message: object) -> bytes:
        """Return the bytes of a message."""
        types, service = self.types, kind.removesuffix("_Response")
        shape = types.shape(kind) if service == kind else types.response(service)
        return types.serialise(kind, completed(shape, message, where=kind), Encoding.CDR)

    def unpack(self, kind: str, data: bytes) -> dict[str, object]:
        return self.types.deserialise(kind, data, Encoding.CDR)

    def close(self) -> None:
        with self._writing:
            self.process.stdin.close()
        try:
            self.process.wait(PATIENCE)
        finally:
            self.process.kill()
            self._reading.join(PATIENCE)
            self.process.stdout.close()

    def _endpoint(
        self, role: str, topic: str, kind: str, profile: str, hear: Callable[[Sample], None] | None = None
    ) -> tuple[str, str]:
        self._count += 1
        made = f"{role}{self._count}"
        if hear is not None:
            self._hearers[made] = hear
        self._send(f"make {role} {made} {topic} {kind} {profile}")
        return made, self._told("made", made)

    def _make(self, role: str, topic: str, kind: str, profile: str) -> str:
        return self._endpoint(role, topic, kind, profile)[0]

    def _send(self, line: str) -> None:
        with self._writing:
            if self.process.stdin.closed:
                return  # a request came while the node was ending
            self.process.stdin.write(line + "\n")
            self.process.stdin.flush()

    def _told(self, verb: str, name: str) -> str:
        with self._changed:
            assert self._changed.wait_for(lambda: (verb, name) in self._lines, PATIENCE), (verb, name)
            return self._lines[verb, name]

    def _read(self) -> None:
        for line in self.process.stdout:
            verb, *words = line.split() or [""]
            if not words:  # Fast DDS writes its own log between ours, blank lines included
                continue
            if verb == "sample":
                made, writer, number, client, request, *data = words
                sample = Sample(writer, int(number), client, int(request), bytes.fromhex("".join(data)))
                self._hearers[made](sample)
                continue
            with self._changed:
                self._lines[verb, words[0] if len(words) > 1 else ""] = words[-1]
                self._changed.notify_all()

    def _tell(self) -> None:
        """Tell of the node and its endpoints: ParticipantEntitiesInfo of Humble, whose identifiers have 24 bytes."""

        def gids(guids: list[str]) -> bytes:
            return struct.pack("<I", len(guids)) + b"".join(bytes.fromhex(each).ljust(24, b"\0") for each in guids)

        data = b"\0\1\0\0" + bytes.fromhex(self.guid).ljust(24, b"\0") + struct.pack("<I", 1)
        for text in ("/", self.name):
            data += b"\0" * (-(len(data) - 4) % 4) + struct.pack("<I", len(text) + 1) + text.encode() + b"\0"
        data += b"\0" * (-(len(data) - 4) % 4)
        self.write(self._discovery, data + gids(self._readers) + gids(self._writers))


_INFO_TYPE = "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_"
TWIST_TYPE, ODOMETRY_TYPE = "geometry_msgs::msg::dds_::Twist_", "nav_msgs::msg::dds_::Odometry_"
_TWIST = struct.Struct("<4x6d")


def odometry(x: float, y: float, yaw: float, speed: float, turning: float, now: float) -> bytes:
    """Return the bytes of nav_msgs/Odometry, written by hand."""
    data = struct.pack("<iI", int(now), int(now % 1 * 1e9))
    for text in ("odom", "base_footprint"):
        data += b"\0" * (-len(data) % 4) + struct.pack("<I", len(text) + 1) + text.encode() + b"\0"
    data += b"\0" * (-len(data) % 8)
    data += struct.pack("<7d36d", x, y, 0, 0, 0, math.sin(yaw / 2), math.cos(yaw / 2), *[0.0] * 36)
    return b"\0\1\0\0" + data + struct.pack("<6d36d", speed, 0, 0, 0, 0, turning, *[0.0] * 36)


def twist_of(data: bytes) -> tuple[float, float]:
    """Return how fast a geometry_msgs/Twist drives and turns."""
    forwards, _, _, _, _, turning = _TWIST.unpack(data)
    return forwards, turning


class FastRobot(FastNode):
    """Drives as it is told on /cmd_vel, and says where it is on /odom thirty times a second."""

    RATE = 30.0

    def __init__(self, program: Path, domain: int) -> None:
        super().__init__(program, domain, "fast_robot")
        self.command = (0.0, 0.0)
        self.commands: list[tuple[float, float, float]] = []
        self.pose = [0.0, 0.0, 0.0]
        self._odom = self.publisher("/odom", ODOMETRY_TYPE)
        self.subscribe("/cmd_vel", TWIST_TYPE, self._obey)
        self._is_over = threading.Event()
        self._driving = threading.Thread(target=self._drive, daemon=True)
        self._driving.start()

    def close(self) -> None:
        self._is_over.set()
        self._driving.join(PATIENCE)
        super().close()

    def _obey(self, sample: Sample) -> None:
        self.command = twist_of(sample.data)
        self.commands.append((time.time(), *self.command))

    def _drive(self) -> None:
        last = time.monotonic()
        while not self._is_over.wait(1.0 / self.RATE):
            now = time.monotonic()
            (speed, turning), seconds, last = self.command, now - last, now
            self.pose[0] += speed * seconds * math.cos(self.pose[2])
            self.pose[1] += speed * seconds * math.sin(self.pose[2])
            self.pose[2] += turning * seconds
            self.write(self._odom, odometry(*self.pose, speed, turning, time.time()))
