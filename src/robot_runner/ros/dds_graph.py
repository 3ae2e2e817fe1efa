"""The graph as DDS discovers it: participants, publishers and subscribers, and the names that ROS 2 gives them."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from cyclonedds.builtin import (
    BuiltinDataReader,
    BuiltinTopicDcpsParticipant,
    BuiltinTopicDcpsPublication,
    BuiltinTopicDcpsSubscription,
)
from cyclonedds.core import InstanceState
from cyclonedds.qos import Policy
from cyclonedds.qos import Qos as DdsQos

if TYPE_CHECKING:
    from uuid import UUID

    from cyclonedds.domain import DomainParticipant

    from robot_runner.ros.dds_reception import Reception

# https://design.ros2.org/articles/topic_and_service_names.html: the prefixes of what ROS 2 puts on DDS.
_TOPIC, _REQUEST, _REPLY = "rt", "rq", "rr"
_REQUEST_END, _REPLY_END = "Request", "Reply"
_TYPE_PARTS = 4
_TYPE_HASH = re.compile(r"typehash=RIHS01_[0-9a-f]{64};")

#: The user data of our links' participants: like that of ROS 2, and with the program's name.
LINK_QOS = DdsQos(Policy.Userdata(b"enclave=/;program=robotrunner;"))


def wire_topic(name: str) -> str:
    """Return the DDS topic of a ROS topic, given by its full name."""
    return _TOPIC + name


def request_topic(service: str) -> str:
    """Return the DDS topic that requests of a service are sent on."""
    return f"{_REQUEST}{service}{_REQUEST_END}"


def reply_topic(service: str) -> str:
    """Return the DDS topic that responses of a service are sent on."""
    return f"{_REPLY}{service}{_REPLY_END}"


def ros_topic(wire_name: str) -> str | None:
    """Return the ROS topic of a DDS topic, or None if it is another topic.

    Example:
        >>> ros_topic("rt/odom"), ros_topic("ros_discovery_info")
        ('/odom', None)
    """
    return wire_name.removeprefix(_TOPIC) if wire_name.startswith(f"{_TOPIC}/") else None


def ros_service(wire_name: str) -> str | None:
    """Return the service whose requests a DDS topic carries, or None if it carries none.

    Example:
        >>> ros_service("rq/task/stopRequest"), ros_service("rr/task/stopReply")
        ('/task/stop', None)
    """
    if wire_name.startswith(f"{_REQUEST}/") and wire_name.endswith(_REQUEST_END):
        return wire_name.removeprefix(_REQUEST).removesuffix(_REQUEST_END)
    return None


def ros_type(wire_name: str) -> str:
    """Return the ROS type of a DDS type; one that is not of ROS stays as it is.

    Example:
        >>> ros_type("geometry_msgs::msg::dds_::Twist_"), ros_type("HelloWorld")
        ('geometry_msgs/Twist', 'HelloWorld')
    """
    parts = wire_name.split("::")
    if len(parts) == _TYPE_PARTS and parts[2] == "dds_":
        return f"{parts[0]}/{parts[3].removesuffix('_')}"
    return wire_name


def ros_service_type(wire_name: str) -> str:
    """Return the service type of the DDS type of its requests.

    Example:
        >>> ros_service_type("std_srvs::srv::dds_::Trigger_Request_")
        'std_srvs/Trigger'
    """
    return ros_type(wire_name).removesuffix("_Request")


@dataclass(frozen=True, slots=True)
class Endpoint:
    """A publisher or subscriber as it was discovered, with its GUID, its participant's, and the DDS names.

    `qos` is what it offers or asks for; `user_data` is text, such as `typehash=RIHS01_…;`.
    """

    key: UUID
    participant: UUID
    topic: str
    type_name: str
    qos: DdsQos
    user_data: str

    @classmethod
    def of(cls, sample: Any) -> Endpoint:
        """Read a sample of one of the built-in topics."""
        qos = sample.qos
        data = qos[Policy.Userdata].data.decode(errors="replace") if Policy.Userdata in qos else ""
        return cls(sample.key, sample.participant_key, sample.topic_name, sample.type_name, qos, data)

    @property
    def type_hash(self) -> str:
        """The hash of the version of its type; empty where it tells none, as before Iron."""
        found = _TYPE_HASH.search(self.user_data)
        return found[0] if found else ""


class Graph:
    """The participants and endpoints of one domain; kept up to date by the reception's thread."""

    def __init__(self, participant: DomainParticipant, reception: Reception) -> None:
        self._reception = reception
        self._lock = threading.Lock()
        self._participants: set[UUID] = set()
        self._links: set[UUID] = set()
        self._writers: dict[UUID, Endpoint] = {}
        self._readers: dict[UUID, Endpoint] = {}
        self.on_writer: Callable[[Endpoint], None] | None = None
        for topic, take in (
            (BuiltinTopicDcpsParticipant, self._take_participant),
            (BuiltinTopicDcpsPublication, self._take_writer),
            (BuiltinTopicDcpsSubscription, partial(self._take, self._readers)),
        ):
            reception.add(BuiltinDataReader(participant, topic), take, "the graph")

    @property
    def participants(self) -> frozenset[UUID]:
        """The GUIDs of all participants, our own among them."""
        with self._lock:
            return frozenset(self._participants)

    def silent(self) -> frozenset[UUID]:
        """Return the participants that have announced no reader or writer, except links that are still being opened.

        These have none yet: two that are opened at the same time would wait for each other.
        """
        with self._lock:
            told = {each.participant for each in (*self._readers.values(), *self._writers.values())}
            return frozenset(self._participants - self._links - told)

    def writers(self, topic: str) -> list[Endpoint]:
        """Return the publishers of a DDS topic."""
        return self._of(self._writers, topic)

    def readers(self, topic: str) -> list[Endpoint]:
        """Return the subscribers of a DDS topic."""
        return self._of(self._readers, topic)

    def topics(self) -> dict[str, str]:
        """Return the ROS type of each ROS topic."""
        return {
            name: ros_type(endpoint.type_name)
            for endpoint in self._endpoints()
            if (name := ros_topic(endpoint.topic)) is not None
        }

    def services(self) -> dict[str, str]:
        """Return the type of each service that is offered."""
        with self._lock:
            readers = list(self._readers.values())
        return {
            name: ros_service_type(endpoint.type_name)
            for endpoint in readers
            if (name := ros_service(endpoint.topic)) is not None
        }

    def wait_for(self, is_so: Callable[[], bool], timeout: float) -> bool:
        """Wait until `is_so` holds of the graph; `timeout` is in seconds."""
        return self._reception.wait_for(is_so, timeout)

    def _endpoints(self) -> list[Endpoint]:
        with self._lock:
            return [*self._readers.values(), *self._writers.values()]

    def _of(self, endpoints: dict[UUID, Endpoint], topic: str) -> list[Endpoint]:
        with self._lock:
            return [endpoint for endpoint in endpoints.values() if endpoint.topic == topic]

    def _take_participant(self, sample: Any) -> None:
        with self._lock:
            if _is_alive(sample):
                self._participants.add(sample.key)
                if Policy.Userdata in sample.qos and sample.qos[Policy.Userdata] == LINK_QOS[Policy.Userdata]:
                    self._links.add(sample.key)
            else:
                self._participants.discard(sample.key)
                self._links.discard(sample.key)

    def _take_writer(self, sample: Any) -> None:
        self._take(self._writers, sample)
        if self.on_writer is not None and _is_alive(sample):
            self.on_writer(self._writers[sample.key])

    def _take(self, endpoints: dict[UUID, Endpoint], sample: Any) -> None:
        with self._lock:
            if _is_alive(sample):
                endpoints[sample.key] = Endpoint.of(sample)
            else:
                endpoints.pop(sample.key, None)


def _is_alive(sample: Any) -> bool:
    return bool(sample.sample_info.valid_data and sample.sample_info.instance_state & InstanceState.Alive)


#: How often to call cyclonedds again; endpoints do not appear ten times between two of its own calls.
_TRIES = 10


def matched_subscriptions(writer: Any) -> list[int]:
    """Return the handles of the readers that are matched with this writer."""
    return _steady(writer.get_matched_subscriptions)


def matched_publications(reader: Any) -> list[int]:
    """Return the handles of the writers that are matched with this reader."""
    return _steady(reader.get_matched_publications)


def _steady(ask: Callable[[], list[int]]) -> list[int]:
    # cyclonedds gets their number, then that many: it fails if another appears in between.
    for _ in range(_TRIES):
        try:
            return ask()
        except IndexError:
            continue
    return ask()
