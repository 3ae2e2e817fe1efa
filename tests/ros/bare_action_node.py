"""An action server and an action client as rmw_cyclonedds makes them, of cyclonedds and types written by hand.

Nothing of what it is to test. It offers /count (example_interfaces/Fibonacci): of an order it counts up, one number
each 20 ms. Order 0 is rejected, 13 is never answered, and who asks for the end of order 99 is refused. It sends a goal
to /ours as soon as that is there, and says what comes of it. Argument: the domain.
"""
# Without deferred annotations: cyclonedds does not find built-in types in them.

import json
import signal
import sys
import time
from dataclasses import dataclass, make_dataclass

from cyclonedds.core import InstanceState, ReadCondition, SampleState, ViewState, WaitSet
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, int8, int32, int64, sequence, uint8, uint32, uint64
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

FIBONACCI = "example_interfaces.action.dds_.Fibonacci"


def named(typename, **members):
    kind = make_dataclass(typename.rpartition(".")[2], members.items(), bases=(IdlStruct,))
    kind.__idl_typename__ = typename.rpartition(".")[2]
    kind.__idl__.idl_transformed_typename = typename.replace(".", "::")
    return kind


Time = named("builtin_interfaces.msg.dds_.Time_", sec=int32, nanosec=uint32)
Uuid = named("unique_identifier_msgs.msg.dds_.UUID_", uuid=array[uint8, 16])
Info = named("action_msgs.msg.dds_.GoalInfo_", goal_id=Uuid, stamp=Time)
Status = named("action_msgs.msg.dds_.GoalStatus_", goal_info=Info, status=int8)
Statuses = named("action_msgs.msg.dds_.GoalStatusArray_", status_list=sequence[Status])
Goal = named(f"{FIBONACCI}_Goal_", order=int32)
Result = named(f"{FIBONACCI}_Result_", sequence=sequence[int32])
Feedback = named(f"{FIBONACCI}_Feedback_", sequence=sequence[int32])
HEADER = {"guid": uint64, "seq": int64}
SendRequest = named(f"{FIBONACCI}_SendGoal_Request_", **HEADER, goal_id=Uuid, goal=Goal)
SendReply = named(f"{FIBONACCI}_SendGoal_Response_", **HEADER, accepted=bool, stamp=Time)
ResultRequest = named(f"{FIBONACCI}_GetResult_Request_", **HEADER, goal_id=Uuid)
ResultReply = named(f"{FIBONACCI}_GetResult_Response_", **HEADER, status=int8, result=Result)
FeedbackMessage = named(f"{FIBONACCI}_FeedbackMessage_", goal_id=Uuid, feedback=Feedback)
CancelRequest = named("action_msgs.srv.dds_.CancelGoal_Request_", **HEADER, goal_info=Info)
CancelReply = named(
    "action_msgs.srv.dds_.CancelGoal_Response_", **HEADER, return_code=int8, goals_canceling=sequence[Info]
)

RELIABLE = (Policy.Reliability.Reliable(100_000_000), Policy.History.KeepAll)
KEPT = (RELIABLE[0], Policy.Durability.TransientLocal, Policy.History.KeepLast(1))
EXECUTING, CANCELING, SUCCEEDED, CANCELED = 2, 3, 4, 5
STAMP = Time(sec=7, nanosec=0)


def say(**fact):
    sys.stdout.write(json.dumps(fact) + "\n")
    sys.stdout.flush()


@dataclass
class Execution:
    key: tuple
    order: int
    sequence: list
    status: int = EXECUTING
    asked: object = None


class Node:
    def __init__(self, domain):
        self.participant = DomainParticipant(domain, qos=Qos(Policy.Userdata(b"enclave=/;")))
        self.goals = {}
        self.readers = []
        self.send, self.result, self.cancel = (
            self.service(f"count/_action/{name}", *kinds, take)
            for name, kinds, take in (
                ("send_goal", (SendRequest, SendReply), self.take_goal),
                ("get_result", (ResultRequest, ResultReply), self.take_result_request),
                ("cancel_goal", (CancelRequest, CancelReply), self.take_cancel),
            )
        )
        self.feedback = self.writer("rt/count/_action/feedback", FeedbackMessage, RELIABLE)
        self.status = self.writer("rt/count/_action/status", Statuses, KEPT)
        # The client.
        self.hello = self.writer("rq/ours/_action/send_goalRequest", SendRequest, RELIABLE, "clientid=1.3;")
        self.ask = self.writer("rq/ours/_action/get_resultRequest", ResultRequest, RELIABLE, "clientid=1.4;")
        for topic, kind, take in (
            ("rr/ours/_action/send_goalReply", SendReply, self.take_acceptance),
            ("rr/ours/_action/get_resultReply", ResultReply, self.take_result),
        ):
            self.reader(topic, kind, RELIABLE, take, "clientid=1.3;" if "send" in topic else "clientid=1.4;")
        self.reader("rt/ours/_action/feedback", FeedbackMessage, RELIABLE, self.take_feedback)
        self.has_asked = False
        self.mine = Uuid(uuid=list(range(16)))

    def service(self, name, request, reply, take):
        self.reader(f"rq/{name}Request", request, RELIABLE, take, "serviceid=1.2;")
        return self.writer(f"rr/{name}Reply", reply, RELIABLE, "serviceid=1.2;")

    def writer(self, topic, kind, policies, user_data=""):
        return DataWriter(self.participant, Topic(self.participant, topic, kind), self.qos(policies, user_data))

    def reader(self, topic, kind, policies, take, user_data=""):
        made = DataReader(self.participant, Topic(self.participant, topic, kind), self.qos(policies, user_data))
        self.readers.append((made, take))

    def qos(self, policies, user_data):
        return Qos(*policies, *([Policy.Userdata(user_data.encode())] if user_data else []))

    # --- the server ---

    def take_goal(self, request):
        if request.goal.order == 13:
            return
        is_taken = request.goal.order != 0
        if is_taken:
            key = tuple(request.goal_id.uuid)
            self.goals[key] = Execution(key, request.goal.order, [0, 1])
        self.send.write(SendReply(guid=request.guid, seq=request.seq, accepted=is_taken, stamp=STAMP))
        self.tell()

    def take_result_request(self, request):
        self.goals[tuple(request.goal_id.uuid)].asked = request

    def take_cancel(self, request):
        goal = self.goals.get(tuple(request.goal_info.goal_id.uuid))
        code = 2 if goal is None else 1 if goal.order == 99 else 0
        if code == 0:
            goal.status = CANCELING
        self.cancel.write(CancelReply(guid=request.guid, seq=request.seq, return_code=code, goals_canceling=[]))
        self.tell()

    def tell(self):
        told = [Status(goal_info=Info(Uuid(list(key)), STAMP), status=each.status) for key, each in self.goals.items()]
        self.status.write(Statuses(status_list=told))

    def count(self):
        for goal in self.goals.values():
            before = goal.status
            if goal.status == CANCELING:
                goal.status = CANCELED
            elif goal.status == EXECUTING and len(goal.sequence) > goal.order:
                goal.status = SUCCEEDED
            elif goal.status == EXECUTING:
                goal.sequence.append((goal.sequence[-1] + goal.sequence[-2]) % 1000)
                told = Feedback(sequence=goal.sequence[-2:])
                self.feedback.write(FeedbackMessage(goal_id=Uuid(list(goal.key)), feedback=told))
            if goal.status != before:
                self.tell()
            if goal.asked is not None and goal.status in {SUCCEEDED, CANCELED}:
                asked, goal.asked = goal.asked, None
                result = Result(sequence=goal.sequence)
                self.result.write(ResultReply(guid=asked.guid, seq=asked.seq, status=goal.status, result=result))

    # --- the client ---

    def send_once(self):
        # A request that is written before the server is found, or its reply can come back, would be lost.
        replies = [reader for reader, take in self.readers if take in (self.take_acceptance, self.take_result)]
        found = [reader.get_matched_publications() for reader in replies]
        if not self.has_asked and all([*found, *(each.get_matched_subscriptions() for each in (self.hello, self.ask))]):
            self.has_asked = True
            guid = self.hello.get_instance_handle() & (2**64 - 1)
            self.hello.write(SendRequest(guid=guid, seq=1, goal_id=self.mine, goal=Goal(order=5)))

    def take_acceptance(self, reply):
        say(accepted=reply.accepted)
        guid = self.ask.get_instance_handle() & (2**64 - 1)
        self.ask.write(ResultRequest(guid=guid, seq=1, goal_id=self.mine))

    def take_result(self, reply):
        say(status=reply.status, result=list(reply.result.sequence))

    def take_feedback(self, told):
        say(feedback=list(told.feedback.sequence), is_mine=list(told.goal_id.uuid) == self.mine.uuid)

    def live(self):
        waitset = WaitSet(self.participant)
        conditions = [
            ReadCondition(reader, ViewState.Any | InstanceState.Any | SampleState.Any) for reader, _ in self.readers
        ]
        for condition in conditions:
            waitset.attach(condition)
        say(ready=True)
        is_over = []
        signal.signal(signal.SIGTERM, lambda *_: is_over.append(True))
        while not is_over:
            begun = time.monotonic()
            waitset.wait(20_000_000)
            for reader, take in self.readers:
                for sample in reader.take(50):
                    if sample.sample_info.valid_data:
                        take(sample)
            self.count()
            self.send_once()
            time.sleep(max(0.0, 0.02 - (time.monotonic() - begun)))


if __name__ == "__main__":
    node = Node(int(sys.argv[1]))
    node.live()
    # It says good-bye; else it would stay on the graph until its lease is over, which takes ten seconds.
    node.participant.__del__()
