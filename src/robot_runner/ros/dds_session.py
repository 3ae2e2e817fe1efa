"""A participant of a DDS domain that looks like a node of ROS 2, and its parts."""

from __future__ import annotations

import os
import secrets
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any
from uuid import UUID

from cyclonedds.core import DDSException
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from robot_runner.core.errors import LinkError
from robot_runner.core.links.robot import Encoding, Qos
from robot_runner.ros.dds_graph import LINK_QOS, Endpoint, Graph, ros_type
from robot_runner.ros.dds_qos import reader_profile, writer_profile
from robot_runner.ros.dds_reception import RawSample, Reception, WireType, delete, topic_wire_type
from robot_runner.ros.graph_transport import Lane
from robot_runner.ros.type_catalogue import TypeCatalogue

if TYPE_CHECKING:
    from cyclonedds.qos import Qos as DdsQos

    from robot_runner.ros.graph_addresses import DdsSettings

#: On this topic each participant announces its nodes, and the readers and writers of each (rmw_dds_common).
DISCOVERY_TOPIC = "ros_discovery_info"
_TYPE = "rmw_dds_common/ParticipantEntitiesInfo"

_GUID_BYTES = 16


class Nodes:
    """The nodes of a graph, including this link's own: ROS 2 announces them on a topic of its own.

    A link that has opened nothing announces no node: so the process that stands by to stop a robot is not counted among
    the nodes that are measured.
    """

    def __init__(self, session: Session, name: str) -> None:
        self._session = session
        self._name = name
        self._lock = threading.Lock()
        self._told: dict[bytes, list[str]] = {}
        self._owners: dict[bytes, dict[bytes, str]] = {}  # the node of each endpoint, by participant
        self._endpoints: dict[str, list[UUID]] = {"reader": [], "writer": []}
        shape = session.types.shape(_TYPE)
        self._gid_bytes = session.types.shape("rmw_dds_common/Gid").fields[0].count
        self._wire_type = topic_wire_type(shape)
        user_data = session.type_hash(_TYPE)
        reader = session.reader(DISCOVERY_TOPIC, self._wire_type, reader_profile(Qos.TRANSIENT_LOCAL, user_data))
        session.reception.add(reader, self._take, DISCOVERY_TOPIC)
        self._writer = session.writer(DISCOVERY_TOPIC, self._wire_type, writer_profile(Qos.TRANSIENT_LOCAL, user_data))
        self._tell()

    def names(self) -> list[str]:
        """Return the full names of the nodes of existing participants, sorted."""
        present = {participant.bytes for participant in self._session.graph.participants}
        with self._lock:
            return sorted({name for owner, names in self._told.items() if owner in present for name in names})

    def tellers(self) -> set[UUID]:
        """Return the participants that have announced their nodes."""
        with self._lock:
            return {UUID(bytes=participant) for participant in self._told}

    def without_nodes(self) -> set[UUID]:
        """Return the participants that have announced that they have no nodes."""
        with self._lock:
            return {UUID(bytes=participant) for participant, names in self._told.items() if not names}

    def name_of(self, endpoint: Endpoint) -> str:
        """Return the full name of the node that has an endpoint; empty where its participant has not announced it."""
        participant = endpoint.participant.bytes
        with self._lock:
            names = self._told.get(participant, [])
            owner = self._owners.get(participant, {}).get(endpoint.key.bytes)
        return owner or (names[0] if len(names) == 1 else "")

    def add(self, kind: str, guid: UUID) -> None:
        """Announce a `reader` or a `writer` to the graph."""
        with self._lock:
            self._endpoints[kind].append(guid)
        self._tell()

    def remove(self, guid: UUID) -> None:
        """Announce to the graph that a reader or writer is gone."""
        with self._lock:
            self._endpoints = {
                kind: [each for each in guids if each != guid] for kind, guids in self._endpoints.items()
            }
        self._tell()

    def _tell(self) -> None:
        with self._lock:
            sequences = {f"{kind}_gid_seq": list(map(self._gid, guids)) for kind, guids in self._endpoints.items()}
            node = {"node_namespace": "/", "node_name": self._name, **sequences}
            nodes = [node] if any(self._endpoints.values()) else []
            self._told[self._session.guid.bytes] = [f"/{self._name}" for _ in nodes]
            message = {"gid": self._gid(self._session.guid), "node_entities_info_seq": nodes}
            self._writer.write(self._wire_type(self._session.types.serialise(_TYPE, message, Encoding.CDR)))

    def _gid(self, guid: UUID) -> dict[str, bytes]:
        return {"data": guid.bytes.ljust(int(self._gid_bytes), b"\0")}  # type: ignore[arg-type]  # an array has a length

    def _take(self, sample: RawSample) -> None:
        if not sample.sample_info.valid_data:
            return
        try:
            told = self._session.types.deserialise(_TYPE, sample.data, Encoding.CDR)
        except LinkError:  # of a distribution with another message; its topics are still seen
            return
        names = [f"{node['node_namespace'].rstrip('/')}/{node['node_name']}" for node in told["node_entities_info_seq"]]
        owners = {
            bytes(gid["data"][:_GUID_BYTES]): name
            for node, name in zip(told["node_entities_info_seq"], names, strict=True)
            for gid in (*node["reader_gid_seq"], *node["writer_gid_seq"])
        }
        with self._lock:
            participant = bytes(told["gid"]["data"][:_GUID_BYTES])
            self._told[participant], self._owners[participant] = names, owners


#: This long after joining, all participants on the graph have been discovered, s: DDS announces at once.
SETTLING = 1.0
#: This long after opening, they have announced their endpoints and nodes, s: those of Fast DDS do so up to 1.2 s after
#: they are discovered (measured with 2.9 and 2.14). There is a wait only if some have not.
_TELLING = 3.0
#: This long after opening, the subscribers of a robot of Fast DDS have been discovered where there is no multicast, as
#: on a loopback interface, s: it finds us only when it announces itself again, every 3 s.
FINDING = 3.0

#: The distribution of a graph without type hashes, which came with Iron, and that of an empty graph.
_BEFORE_TYPE_HASHES, _LATEST = "humble", "jazzy"
_WITHOUT_TYPE_HASHES = frozenset({"foxy", "galactic", "humble"})

#: Where Cyclone DDS finds its configuration, as XML or as a file, when the first participant of a domain is made.
_CONFIGURATION = "CYCLONEDDS_URI"

#: The participants of this process, including past ones: what they announce about a graph is only this process's guess.
_ours: set[UUID] = set()
#: The process of each open participant: the library's threads do not survive a fork, and it would wait for them.
_open_in: list[int] = []


class Session:
    """The participant with its reception, its graph and the types of its distribution.

    It is opened in the process that uses it: threads of DDS do not survive a fork.

    Raises:
        LinkError: the domain cannot be joined, or the process that has forked this one had joined one.
    """

    def __init__(self, settings: DdsSettings) -> None:
        self.domain = settings.domain
        self._lock = threading.Lock()
        self._topics: dict[tuple[str, str], Topic[Any]] = {}
        self.is_closed = False
        self._joined = self._opened = time.monotonic()
        self._participant = _joined(settings)
        self._process = os.getpid()
        _open_in.append(self._process)
        self.guid: Any = self._participant.guid
        self._own: set[UUID] = set()
        self._tellers: Callable[[], set[UUID]] = set
        self.own(self._participant)
        self.reception = Reception(self._participant)
        self._receptions: dict[Lane, Reception] = {}
        self.graph = Graph(self._participant, self.reception)
        with ExitStack() as undoing:
            undoing.callback(self.close)
            self.reception.start()
            self.distro = settings.distro or self._told_distro()
            self.types = TypeCatalogue.of(2, self.distro, settings.types)
            self.nodes = Nodes(self, f"robot_runner_{os.getpid()}_{secrets.token_hex(2)}")
            self._tellers = self.nodes.tellers
            self._opened = time.monotonic()
            undoing.pop_all()

    def own(self, participant: DomainParticipant) -> None:
        """Count a participant as one of this link's own."""
        self._own.add(participant.guid)
        _ours.add(participant.guid)

    def reception_of(self, lane: Lane) -> Reception:
        """Return what serves the topics of a lane, in a thread of its own: services and the graph wait for none."""
        with self._lock:
            if lane not in self._receptions:
                self._receptions[lane] = Reception(self._participant)
                self._receptions[lane].start()
            return self._receptions[lane]

    def wait_event(self, event: threading.Event, timeout: float) -> None:
        """Wait for an event; in a callback, what arrives meanwhile in its lane is received within it."""
        serving = [each for each in self._receptions.values() if each.is_served_here]
        (serving or [self.reception])[0].wait_event(event, timeout)

    def type_hash(self, name: str) -> str:
        """Return the user data with a type's hash; empty for distributions that have none."""
        return "" if self.distro in _WITHOUT_TYPE_HASHES else f"typehash={self.types.digest(name)};"

    def writer(self, topic: str, wire_type: WireType, qos: DdsQos) -> DataWriter[Any]:
        """Return a new writer of a topic, and announce it to the graph."""
        writer: DataWriter[Any] = DataWriter(self._participant, self._topic(topic, wire_type), qos)
        if topic != DISCOVERY_TOPIC:
            self.nodes.add("writer", writer.guid)
        return writer

    def reader(self, topic: str, wire_type: WireType, qos: DdsQos) -> DataReader[Any]:
        """Return a new reader of a topic, and announce it to the graph."""
        reader: DataReader[Any] = DataReader(self._participant, self._topic(topic, wire_type), qos)
        if topic != DISCOVERY_TOPIC:
            self.nodes.add("reader", reader.guid)
        return reader

    def settle(self, is_so: Callable[[], bool], *, awaits_robot: bool = False) -> bool:
        """Wait until `is_so` holds, at most as long as the discovery of the graph takes.

        With `awaits_robot`, nodes that have been discovered already are not taken for the robot.
        """
        if not self.graph.wait_for(is_so, max(0.0, self._joined + SETTLING - time.monotonic())):
            if awaits_robot:
                self.graph.wait_for(is_so, self._left(FINDING))
            self.graph.wait_for(lambda: is_so() or not self._silent(), self._left(_TELLING))
        return is_so()

    def _left(self, seconds: float) -> float:
        return max(0.0, self._opened + seconds - time.monotonic())

    def _silent(self) -> frozenset[UUID]:
        tellers = {writer.participant for writer in self.graph.writers(DISCOVERY_TOPIC)}
        return (self.graph.silent() | (tellers - self._tellers())) - self._own

    def is_alone(self) -> bool:
        """Whether there are no other participants with nodes on its domain."""
        return not self.graph.participants - self._own - self.nodes.without_nodes()

    def loneliness(self) -> str:
        """Return the fix where no other node is on the graph."""
        return (
            f"No other participant is on domain {self.domain}: give the ROS_DOMAIN_ID of the robot "
            "(robot = 'dds:domain=…'), and see that multicast reaches it."
        )

    def close(self) -> None:
        """Leave the graph; closing twice does nothing."""
        if self.is_closed:
            return
        self.is_closed = True
        _open_in.remove(self._process)
        self.reception.close()
        for lane in list(self._receptions.values()):
            lane.close()
        delete(self._participant)

    def _topic(self, name: str, wire_type: WireType) -> Topic[Any]:
        key = (name, wire_type.__idl_typename__)
        with self._lock:
            if key not in self._topics:
                self._topics[key] = self._new_topic(name, wire_type)
            return self._topics[key]

    def _new_topic(self, name: str, wire_type: WireType) -> Topic[Any]:
        try:
            return Topic(self._participant, name, wire_type)
        except DDSException as error:
            problem = f"the topic cannot carry {ros_type(wire_type.__idl__.idl_transformed_typename)}: {error}"
            raise LinkError(problem, where=name, fix="Use one type for one topic or service.") from error

    def _told_distro(self) -> str:
        """Return the distribution by the endpoints of others: whether all have type hashes, which exist since Iron.

        One without a hash is older. Other links of ours that found no other node when they were opened have hashes.
        """

        def others() -> list[str]:
            writers = self.graph.writers(DISCOVERY_TOPIC)
            return [writer.user_data for writer in writers if writer.participant not in _ours]

        # Endpoints of Fast DDS are discovered later than those of our other links.
        self.settle(lambda: bool(others()) and not self.graph.silent() - self._own)
        return _LATEST if all("typehash=" in data for data in others()) else _BEFORE_TYPE_HASHES


def _joined(settings: DdsSettings) -> DomainParticipant:
    if any(process != os.getpid() for process in _open_in):
        problem = "a link over dds was open as this process was forked, which keeps DDS from working in it"
        fix = "Close that link before a run begins, or set run_process = RunProcess.SPAWN."
        raise LinkError(problem, where="robot", fix=fix)
    configuration = settings.cyclone_configuration()
    if configuration is not None:  # the user's settings for Cyclone DDS take precedence over those for ROS
        os.environ.setdefault(_CONFIGURATION, configuration)
    try:
        return DomainParticipant(settings.domain, qos=LINK_QOS)
    except DDSException as error:
        fix = "Bring up a network interface, and see that CYCLONEDDS_URI, where it is set, names one that is there."
        raise LinkError(f"DDS domain {settings.domain} cannot be joined: {error}", where="robot", fix=fix) from error
