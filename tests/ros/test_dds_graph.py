"""Who a writer or reader has found, while others come and go."""

from __future__ import annotations

import threading
from contextlib import closing

import pytest

pytest.importorskip("cyclonedds", reason="it is not published built for every machine")

from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos, _CQos
from cyclonedds.topic import Topic
from tests.ros.dds_domain import LOOPBACK, claim_domain

from robot_runner.core.events.context import SystemClock
from robot_runner.ros import dds_session
from robot_runner.ros.dds_graph import matched_publications, matched_subscriptions
from robot_runner.ros.dds_reception import READING_QOS, Reception, topic_wire_type
from robot_runner.ros.dds_services import OfferedService
from robot_runner.ros.graph_addresses import DdsSettings
from robot_runner.ros.link_opening import open_dds_link
from robot_runner.ros.type_catalogue import TypeCatalogue


class Moving:
    """A writer whose readers come between two questions of cyclonedds, so many times."""

    def __init__(self, times):
        self.times = times

    def get_matched_subscriptions(self):
        self.times -= 1
        if self.times >= 0:
            raise IndexError("invalid index")
        return [7]

    get_matched_publications = get_matched_subscriptions


def test_readers_that_come_while_they_are_counted_are_counted_again():
    assert matched_subscriptions(Moving(3)) == [7]
    assert matched_publications(Moving(0)) == [7]


def test_a_fault_that_stays_is_raised():
    with pytest.raises(IndexError):
        matched_subscriptions(Moving(100))


def test_a_qos_is_read_by_one_thread_of_the_process_at_a_time(monkeypatch):
    # cyclonedds reads it into variables that all threads share: what several links discovered at once was mixed up.
    read, seen = _CQos.cqos_to_qos, []

    def noting(pointer):
        seen.append(READING_QOS.locked())
        return read(pointer)

    monkeypatch.setattr(_CQos, "cqos_to_qos", noting)
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    domain = {"domain": str(claim_domain())}
    clock = SystemClock()
    with closing(open_dds_link(domain, clock, "")) as robot, closing(open_dds_link(domain, clock, "")) as link:
        robot.offer("count", "std_srvs/Trigger", lambda request: {"success": True})
        discovered = len(seen)
        assert link.call("count", "std_srvs/Trigger", timeout=10.0)["success"]
    assert len(seen) > discovered > 0
    assert all(seen)


def test_a_request_that_comes_while_its_service_is_being_offered_is_answered(monkeypatch):
    serve = Reception.serve

    def serving(reception, source):
        handled, handler = threading.Event(), source.handler

        def handle(sample):
            try:
                handler(sample)
            finally:
                handled.set()

        is_offered = isinstance(getattr(handler, "__self__", None), OfferedService)
        source.handler = handle
        serve(reception, source)
        if is_offered:  # and not before, whatever is scheduled first
            assert handled.wait(30.0)

    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    domain, clock, answers = {"domain": str(claim_domain())}, SystemClock(), []
    with closing(open_dds_link(domain, clock, "")) as robot, closing(open_dds_link(domain, clock, "")) as link:
        asking = threading.Thread(target=lambda: answers.append(link.call("count", "std_srvs/Trigger", timeout=60.0)))
        asking.start()
        monkeypatch.setattr(Reception, "serve", serving)
        robot.offer("count", "std_srvs/Trigger", lambda request: {"success": True})
        asking.join(60.0)
    assert [each["success"] for each in answers] == [True]


def test_links_that_join_a_graph_at_the_same_time_do_not_wait_for_each_other_as_for_a_robot(monkeypatch):
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    settings = DdsSettings(claim_domain(), "jazzy")
    joining = dds_session._joined(settings)  # all that another link is in its first moment
    robot = DomainParticipant(settings.domain, qos=Qos(Policy.Userdata(b"enclave=/;")))
    with closing(dds_session.Session(settings)) as session:
        assert session.graph.wait_for(lambda: {joining.guid, robot.guid} <= session.graph.participants, 60.0)
        assert session.graph.silent() - {session.guid} == {robot.guid}


class Latin(str):
    """The name of a partition in Latin-1, as a program in C may spell it."""

    __slots__ = ()

    def encode(self, *_):
        return b"B\xfcro"


def test_an_endpoint_that_cannot_be_read_hides_no_other_one(monkeypatch):
    # cyclonedds takes many at once, and where it cannot read one it gave none of them.
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    settings = DdsSettings(claim_domain(), "jazzy")
    robot, kept = DomainParticipant(settings.domain), []
    wire_type = topic_wire_type(TypeCatalogue.of(2, "jazzy", ()).shape("std_msgs/String"))
    for number in range(12):
        odd = Qos(Policy.Partition([Latin()]))
        kept += [
            DataWriter(robot, Topic(robot, f"rt/{name}{number}", wire_type), qos)
            for name, qos in (("odd", odd), ("good", Qos()))
        ]
    with closing(dds_session.Session(settings)) as session:
        seen = {f"/good{number}" for number in range(12)}
        assert session.graph.wait_for(lambda: seen <= session.graph.topics().keys(), 20.0)
