"""A node as rmw_cyclonedds makes one, of cyclonedds and types written by hand: nothing of what it is to test.

It says `hello` on /chatter, offers /lamp (std_srvs/SetBool), and says each velocity that it hears on /cmd_vel and each
node that it is told of, as lines of JSON. Argument: JSON with `domain`, `gid_bytes` (24: Humble, 16: since Iron),
`reliable` (whether /chatter is), `type_hashes`, and `tells_service` (whether the endpoints of /lamp have the identity
that rmw_cyclonedds gives them; those of other middlewares have none).
"""
# Without deferred annotations: cyclonedds does not find built-in types in them.

import json
import signal
import sys
from dataclasses import dataclass, make_dataclass
from types import SimpleNamespace

from cyclonedds.core import InstanceState, ReadCondition, SampleState, ViewState, WaitSet
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, bounded_str, float64, int64, sequence, uint8, uint64
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic


@dataclass
class String(IdlStruct, typename="std_msgs.msg.dds_.String_"):
    data: str


@dataclass
class Vector3(IdlStruct, typename="geometry_msgs.msg.dds_.Vector3_"):
    x: float64
    y: float64
    z: float64


@dataclass
class Twist(IdlStruct, typename="geometry_msgs.msg.dds_.Twist_"):
    linear: Vector3
    angular: Vector3


@dataclass
class Request(IdlStruct, typename="std_srvs.srv.dds_.SetBool_Request_"):
    guid: uint64
    seq: int64
    data: bool


@dataclass
class Reply(IdlStruct, typename="std_srvs.srv.dds_.SetBool_Response_"):
    guid: uint64
    seq: int64
    success: bool
    message: str


def discovery_types(gid_bytes):
    """Return ParticipantEntitiesInfo of rmw_dds_common with identifiers of so many bytes."""
    gid = _struct("Gid", {"data": array[uint8, gid_bytes]})
    node = _struct(
        "NodeEntitiesInfo",
        {
            "node_namespace": bounded_str[256],
            "node_name": bounded_str[256],
            "reader_gid_seq": sequence[gid],
            "writer_gid_seq": sequence[gid],
        },
    )
    info = _struct("ParticipantEntitiesInfo", {"gid": gid, "node_entities_info_seq": sequence[node]})
    return SimpleNamespace(gid=gid, node=node, info=info)


def _struct(name, members):
    kind = make_dataclass(name, members.items(), bases=(IdlStruct,))
    kind.__idl_typename__ = f"rmw_dds_common.msg.dds_.{name}_"
    kind.__idl__.idl_transformed_typename = f"rmw_dds_common::msg::dds_::{name}_"
    return kind


RELIABLE = Policy.Reliability.Reliable(100_000_000)
BEST_EFFORT = Policy.Reliability.BestEffort
KEPT = (RELIABLE, Policy.Durability.TransientLocal, Policy.History.KeepLast(1))


def say(**fact):
    sys.stdout.write(json.dumps(fact) + "\n")
    sys.stdout.flush()


class Node:
    def __init__(self, options):
        self.options = options
        self.participant = DomainParticipant(options["domain"], qos=Qos(Policy.Userdata(b"enclave=/;")))
        self.chatter = self._writer("rt/chatter", String, RELIABLE if options["reliable"] else BEST_EFFORT)
        identity = "serviceid=1.2;" if options["tells_service"] else ""
        self.reply = self._writer("rr/lampReply", Reply, RELIABLE, user_data=identity)
        types = discovery_types(options["gid_bytes"])
        self.told = self._writer("ros_discovery_info", types.info, *KEPT)
        self.hearers = [
            (self._reader("rt/cmd_vel", Twist, RELIABLE), lambda twist: say(velocity=twist.linear.x)),
            (self._reader("rq/lampRequest", Request, RELIABLE, user_data=identity), self.answer),
            (self._reader("ros_discovery_info", types.info, *KEPT[:2], Policy.History.KeepAll), self.meet),
        ]
        gid = types.gid(data=list(self.participant.guid.bytes.ljust(options["gid_bytes"], b"\0")))
        self.told.write(types.info(gid=gid, node_entities_info_seq=[types.node("/", "lamp_node", [], [])]))

    def answer(self, request):
        say(asked=request.data)
        self.reply.write(Reply(request.guid, request.seq, True, f"lamp is {request.data}"))

    def meet(self, info):
        for node in info.node_entities_info_seq:
            endpoints = len(node.reader_gid_seq) + len(node.writer_gid_seq)
            say(node=node.node_namespace + node.node_name, endpoints=endpoints)

    def live(self):
        waitset = WaitSet(self.participant)
        conditions = [
            ReadCondition(reader, ViewState.Any | InstanceState.Any | SampleState.Any) for reader, _ in self.hearers
        ]
        for condition in conditions:
            waitset.attach(condition)
        say(ready=True)
        is_over = []
        signal.signal(signal.SIGTERM, lambda *_: is_over.append(True))
        while not is_over:
            waitset.wait(20_000_000)
            self.chatter.write(String("hello"))
            for reader, hear in self.hearers:
                for sample in reader.take(50):
                    if sample.sample_info.valid_data:
                        hear(sample)

    def _writer(self, topic, kind, *policies, user_data=""):
        return DataWriter(self.participant, Topic(self.participant, topic, kind), self._qos(policies, user_data))

    def _reader(self, topic, kind, *policies, user_data=""):
        return DataReader(self.participant, Topic(self.participant, topic, kind), self._qos(policies, user_data))

    def _qos(self, policies, user_data):
        text = user_data + ("typehash=RIHS01_0;" if self.options["type_hashes"] else "")
        return Qos(*policies, *([Policy.Userdata(text.encode())] if text else []))


if __name__ == "__main__":
    node = Node(json.loads(sys.argv[1]))
    node.live()
    # It says good-bye; else it would stay on the graph until its lease is over, which takes ten seconds.
    node.participant.__del__()
