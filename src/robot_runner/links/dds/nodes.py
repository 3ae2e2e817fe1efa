"""The nodes of the graph: ROS 2 tells them on a topic of its own, and this link tells that it is one."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any

from robot_runner.errors import LinkError
from robot_runner.links.dds.profiles import reader_profile, writer_profile
from robot_runner.links.dds.wire_types import topic_wire_type
from robot_runner.links.robot import Encoding, Qos

if TYPE_CHECKING:
    from uuid import UUID

    from robot_runner.links.dds.session import Session
    from robot_runner.links.dds.wire_types import RawSample

__all__ = ["DISCOVERY_TOPIC", "Nodes"]

#: rmw_dds_common: each participant says here which nodes it has, and which readers and writers are whose.
DISCOVERY_TOPIC = "ros_discovery_info"
_TYPE = "rmw_dds_common/ParticipantEntitiesInfo"

_GUID_BYTES = 16


class Nodes:
    """The nodes that the participants of a graph tell of, this link's own among them."""

    def __init__(self, session: Session, name: str) -> None:
        self._session = session
        self._name = name
        self._lock = threading.Lock()
        self._told: dict[bytes, list[str]] = {}
        self._readers: list[Any] = []
        self._writers: list[Any] = []
        shape = session.types.shape(_TYPE)
        self._gid_bytes = session.types.shape("rmw_dds_common/Gid").fields[0].count
        self._wire_type = topic_wire_type(shape)
        user_data = session.type_hash(_TYPE)
        reader = session.reader(DISCOVERY_TOPIC, self._wire_type, reader_profile(Qos.TRANSIENT_LOCAL, user_data))
        session.reception.add(reader, self._hear, DISCOVERY_TOPIC)
        self._writer = session.writer(DISCOVERY_TOPIC, self._wire_type, writer_profile(Qos.TRANSIENT_LOCAL, user_data))
        self._tell()

    def names(self) -> list[str]:
        """Return the full names of the nodes whose participants are there, sorted."""
        present = {participant.bytes for participant in self._session.graph.participants}
        with self._lock:
            return sorted({name for owner, names in self._told.items() if owner in present for name in names})

    def add_reader(self, reader: Any) -> None:
        """Tell the graph of a reader."""
        with self._lock:
            self._readers.append(reader.guid)
        self._tell()

    def add_writer(self, writer: Any) -> None:
        """Tell the graph of a writer."""
        with self._lock:
            self._writers.append(writer.guid)
        self._tell()

    def remove(self, guid: UUID) -> None:
        """Tell the graph that a reader or writer is no more."""
        with self._lock:
            self._readers = [each for each in self._readers if each != guid]
            self._writers = [each for each in self._writers if each != guid]
        self._tell()

    def _tell(self) -> None:
        with self._lock:
            node = {
                "node_namespace": "/",
                "node_name": self._name,
                "reader_gid_seq": [self._gid(guid) for guid in self._readers],
                "writer_gid_seq": [self._gid(guid) for guid in self._writers],
            }
            message = {"gid": self._gid(self._session.guid), "node_entities_info_seq": [node]}
            self._writer.write(self._wire_type(self._session.types.serialise(_TYPE, message, Encoding.CDR)))

    def _gid(self, guid: UUID) -> dict[str, bytes]:
        return {"data": guid.bytes.ljust(int(self._gid_bytes), b"\0")}  # type: ignore[arg-type]  # an array has a length

    def _hear(self, sample: RawSample) -> None:
        if not sample.sample_info.valid_data:
            return
        try:
            told = self._session.types.deserialise(_TYPE, sample.data, Encoding.CDR)
        except LinkError:  # of a distribution with another message: its topics are seen nevertheless
            return
        names = [f"{node['node_namespace'].rstrip('/')}/{node['node_name']}" for node in told["node_entities_info_seq"]]
        with self._lock:
            self._told[told["gid"]["data"][:_GUID_BYTES]] = names
