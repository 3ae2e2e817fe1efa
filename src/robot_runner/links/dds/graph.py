"""Who is on the graph: participants, publishers and subscribers as DDS discovers them."""

from __future__ import annotations

import threading
from dataclasses import dataclass
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

from robot_runner.links.dds.names import ros_service, ros_service_type, ros_topic, ros_type

if TYPE_CHECKING:
    from collections.abc import Callable
    from uuid import UUID

    from cyclonedds.domain import DomainParticipant

    from robot_runner.links.dds.reception import Reception

__all__ = ["Endpoint", "Graph"]


@dataclass(frozen=True, slots=True)
class Endpoint:
    """A publisher or subscriber, as it was discovered.

    Attributes:
        key: its GUID.
        participant: the GUID of whose it is.
        topic: DDS name of the topic.
        type_name: DDS name of the type.
        qos: what it offers or asks for.
        user_data: as text, such as `typehash=RIHS01_…;`.
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
        data = qos[Policy.Userdata].data if Policy.Userdata in qos else b""
        return cls(
            sample.key, sample.participant_key, sample.topic_name, sample.type_name, qos, data.decode(errors="replace")
        )


class Graph:
    """The participants and endpoints of one domain; kept up to date by the reception's thread."""

    def __init__(self, participant: DomainParticipant, reception: Reception) -> None:
        self._reception = reception
        self._lock = threading.Lock()
        self._participants: set[UUID] = set()
        self._writers: dict[UUID, Endpoint] = {}
        self._readers: dict[UUID, Endpoint] = {}
        self.on_writer: Callable[[Endpoint], None] | None = None
        for topic, hear in (
            (BuiltinTopicDcpsParticipant, self._hear_participant),
            (BuiltinTopicDcpsPublication, self._hear_writer),
            (BuiltinTopicDcpsSubscription, self._hear_reader),
        ):
            reception.add(BuiltinDataReader(participant, topic), hear, "the graph")

    @property
    def participants(self) -> frozenset[UUID]:
        """The GUIDs of all participants, our own among them."""
        with self._lock:
            return frozenset(self._participants)

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
        """Return the type of each service that somebody answers."""
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

    def _hear_participant(self, sample: Any) -> None:
        with self._lock:
            if _is_alive(sample):
                self._participants.add(sample.key)
            else:
                self._participants.discard(sample.key)

    def _hear_writer(self, sample: Any) -> None:
        self._hear(self._writers, sample)
        if self.on_writer is not None and _is_alive(sample):
            self.on_writer(self._writers[sample.key])

    def _hear_reader(self, sample: Any) -> None:
        self._hear(self._readers, sample)

    def _hear(self, endpoints: dict[UUID, Endpoint], sample: Any) -> None:
        with self._lock:
            if _is_alive(sample):
                endpoints[sample.key] = Endpoint.of(sample)
            else:
                endpoints.pop(sample.key, None)


def _is_alive(sample: Any) -> bool:
    return bool(sample.sample_info.valid_data and sample.sample_info.instance_state & InstanceState.Alive)
