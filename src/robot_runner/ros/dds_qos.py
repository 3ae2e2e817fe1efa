"""The QoS profiles of ROS as DDS policies."""

from __future__ import annotations

from collections.abc import Sequence

from cyclonedds.qos import Policy
from cyclonedds.qos import Qos as DdsQos

from robot_runner.core.links.robot import Qos
from robot_runner.ros.qos_policies import FOR_EVER_NS, Policies, adapted, asked_by, offered_by, seconds_of

#: How long a reliable writer waits for readers that do not keep up before it gives up, ns.
_MAX_BLOCKING_NS = 500_000_000

_TRANSIENT_LOCAL = Policy.Durability.TransientLocal
#: XCDR1, the one encoding that all middlewares of ROS 2 support.
_REPRESENTATION = Policy.DataRepresentation(use_cdrv0_representation=True)


def writer_profile(qos: Qos, user_data: str = "") -> DdsQos:
    """Return a profile of ROS as policies of a writer."""
    return _as_dds(offered_by(qos), user_data)


def reader_profile(qos: Qos, user_data: str = "") -> DdsQos:
    """Return a profile of ROS as policies of a reader."""
    return _as_dds(asked_by(qos), user_data)


def service_profile(user_data: str) -> DdsQos:
    """Return the policies of services: reliable, and nothing is kept for later readers."""
    return writer_profile(Qos.RELIABLE, user_data)


def adapted_profile(offers: Sequence[DdsQos], user_data: str = "") -> DdsQos:
    """Return the strongest policies of a reader that all of these publishers satisfy."""
    return _as_dds(adapted(list(map(policies_of, offers)), alone=False), user_data)


def policies_of(qos: DdsQos) -> Policies:
    """Return what policies of DDS request or offer."""
    kept = (_TRANSIENT_LOCAL, Policy.Durability.Transient, Policy.Durability.Persistent)
    deadline = qos[Policy.Deadline].deadline if Policy.Deadline in qos else FOR_EVER_NS
    alive = qos[Policy.Liveliness] if Policy.Liveliness in qos else Policy.Liveliness.Automatic(FOR_EVER_NS)
    return Policies(
        Policy.Reliability.BestEffort not in qos,
        any(each in qos for each in kept),
        deadline=seconds_of(deadline),
        lease=seconds_of(alive.lease_duration),
        is_manual=isinstance(alive, Policy.Liveliness.ManualByTopic),
    )


def _as_dds(asked: Policies, user_data: str) -> DdsQos:
    history = Policy.History.KeepLast(asked.depth) if asked.depth else Policy.History.KeepAll
    policies = [
        Policy.Reliability.Reliable(_MAX_BLOCKING_NS) if asked.is_reliable else Policy.Reliability.BestEffort,
        _TRANSIENT_LOCAL if asked.is_kept else Policy.Durability.Volatile,
        history,
        _REPRESENTATION,
        Policy.WriterDataLifecycle(autodispose=False),
    ]
    if asked.is_kept:
        policies.append(Policy.DurabilityService(0, history, -1, -1, -1))
    if user_data:
        policies.append(Policy.Userdata(user_data.encode()))
    return DdsQos(*policies)
