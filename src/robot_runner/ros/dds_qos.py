"""The QoS profiles of ROS as DDS policies."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from cyclonedds.qos import Policy
from cyclonedds.qos import Qos as DdsQos

from robot_runner.core.links.robot import Qos
from robot_runner.ros.graph_transport import nearest_profile, shortfall

if TYPE_CHECKING:
    from collections.abc import Sequence

#: A writer waits this long in ns for readers that do not keep up before it gives up, where nothing may be lost.
_MAX_BLOCKING_NS = 500_000_000

#: How much of a topic is kept while a callback runs, where the user names no profile: a second of 1 kHz.
_KEPT = 1000

#: XCDR1, the one encoding that all middlewares of ROS 2 speak.
_REPRESENTATION = Policy.DataRepresentation(use_cdrv0_representation=True)

_RELIABLE = Policy.Reliability.Reliable(_MAX_BLOCKING_NS)
_TRANSIENT_LOCAL = Policy.Durability.TransientLocal

# rmw/qos_profiles.h of ROS 2, for the depths.
_PROFILES: dict[Qos, tuple[Any, Any, Any]] = {
    Qos.DEFAULT: (_RELIABLE, Policy.Durability.Volatile, Policy.History.KeepLast(10)),
    Qos.SENSOR_DATA: (Policy.Reliability.BestEffort, Policy.Durability.Volatile, Policy.History.KeepLast(5)),
    Qos.RELIABLE: (_RELIABLE, Policy.Durability.Volatile, Policy.History.KeepAll),
    Qos.TRANSIENT_LOCAL: (_RELIABLE, _TRANSIENT_LOCAL, Policy.History.KeepLast(1)),
}


def writer_profile(qos: Qos, user_data: str = "") -> DdsQos:
    """Return a profile of ROS as policies of a writer."""
    return _policies(*_PROFILES[qos], user_data)


def reader_profile(qos: Qos, user_data: str = "") -> DdsQos:
    """Return a profile of ROS as policies of a reader."""
    reliability, durability, history = _PROFILES[qos]
    if qos is Qos.TRANSIENT_LOCAL:
        # The last message of each publisher: the depth of a reader is that of them all.
        history = Policy.History.KeepLast(_KEPT)
    return _policies(reliability, durability, history, user_data)


def service_profile(user_data: str) -> DdsQos:
    """Return the policies of services: nothing is lost, and nothing is kept for later readers."""
    return writer_profile(Qos.RELIABLE, user_data)


def adapted(offers: Sequence[DdsQos], user_data: str = "") -> DdsQos:
    """Return the policies of a reader that all of these publishers satisfy, as strong as they allow."""
    is_reliable = bool(offers) and all(_is_reliable(offer) for offer in offers)
    is_kept = is_reliable and all(_is_kept(offer) for offer in offers)
    reliability = _RELIABLE if is_reliable else Policy.Reliability.BestEffort
    durability = _TRANSIENT_LOCAL if is_kept else Policy.Durability.Volatile
    return _policies(reliability, durability, Policy.History.KeepLast(_KEPT), user_data)


def incompatibility(asked: DdsQos, offered: DdsQos) -> str | None:
    """Say which policy of an offer is less than what is asked for, or return None if none is."""
    return shortfall(asked=(_is_reliable(asked), _is_kept(asked)), offered=(_is_reliable(offered), _is_kept(offered)))


def profile_of(policies: DdsQos) -> Qos:
    """Return the profile of ROS that comes nearest to these policies."""
    return nearest_profile(is_reliable=_is_reliable(policies), is_kept=_is_kept(policies))


def _policies(reliability: Any, durability: Any, history: Any, user_data: str) -> DdsQos:
    policies = [reliability, durability, history, _REPRESENTATION, Policy.WriterDataLifecycle(autodispose=False)]
    if durability is _TRANSIENT_LOCAL:
        policies.append(Policy.DurabilityService(0, history, -1, -1, -1))
    if user_data:
        policies.append(Policy.Userdata(user_data.encode()))
    return DdsQos(*policies)


def _is_reliable(qos: DdsQos) -> bool:
    return Policy.Reliability.BestEffort not in qos


def _is_kept(qos: DdsQos) -> bool:
    return any(each in qos for each in (_TRANSIENT_LOCAL, Policy.Durability.Transient, Policy.Durability.Persistent))
