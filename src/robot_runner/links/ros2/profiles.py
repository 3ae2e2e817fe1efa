"""The QoS profiles of ROS 2 as rclpy has them, and what of a publisher's offer does not satisfy them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from robot_runner.links.robot import Qos

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["adapted", "incompatibility", "reader_profile", "weakest", "writer_profile"]

#: How much of a topic is kept while the callbacks are behind, where the user names no profile: a second of 1 kHz.
_KEPT = 1000
# rmw/qos_profiles.h of ROS 2, for the depths; 0 is as many as come.
_DEPTHS = {Qos.DEFAULT: 10, Qos.SENSOR_DATA: 5, Qos.RELIABLE: 0, Qos.TRANSIENT_LOCAL: 1}


def writer_profile(qos: Qos) -> QoSProfile:
    """Return a profile of ROS for a publisher."""
    return _profile(_DEPTHS[qos], is_reliable=qos is not Qos.SENSOR_DATA, is_kept=qos is Qos.TRANSIENT_LOCAL)


def reader_profile(qos: Qos) -> QoSProfile:
    """Return a profile of ROS for a subscription."""
    # The last message of each publisher: the depth of a reader is that of them all.
    depth = _KEPT if qos is Qos.TRANSIENT_LOCAL else _DEPTHS[qos]
    return _profile(depth, is_reliable=qos is not Qos.SENSOR_DATA, is_kept=qos is Qos.TRANSIENT_LOCAL)


def adapted(offers: Sequence[QoSProfile]) -> QoSProfile:
    """Return the profile of a subscription that all these publishers satisfy, as strong as they allow.

    Where there is none yet it is reliable, which is what most publishers are.
    """
    is_reliable = all(_is_reliable(offer) for offer in offers)
    is_kept = is_reliable and bool(offers) and all(_is_kept(offer) for offer in offers)
    return _profile(_KEPT, is_reliable=is_reliable, is_kept=is_kept)


def weakest() -> QoSProfile:
    """Return the profile of a subscription that every publisher satisfies."""
    return _profile(_KEPT, is_reliable=False, is_kept=False)


def incompatibility(asked: QoSProfile, offered: QoSProfile) -> str | None:
    """Say which policy of an offer is less than what is asked for, or return None if none is.

    The rules are those of DDS 1.4, 2.2.3, for the policies that the profiles of ROS set.
    """
    if _is_reliable(asked) and not _is_reliable(offered):
        return "reliability: it is published best effort, and heard reliable"
    if _is_kept(asked) and not _is_kept(offered):
        return "durability: it is published volatile, and heard transient local"
    return None


def _profile(depth: int, *, is_reliable: bool, is_kept: bool) -> QoSProfile:
    history: dict[str, Any] = {"history": HistoryPolicy.KEEP_LAST if depth else HistoryPolicy.KEEP_ALL}
    if depth:
        history["depth"] = depth
    return QoSProfile(
        reliability=ReliabilityPolicy.RELIABLE if is_reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if is_kept else DurabilityPolicy.VOLATILE,
        **history,
    )


def _is_reliable(profile: QoSProfile) -> bool:
    return bool(profile.reliability != ReliabilityPolicy.BEST_EFFORT)


def _is_kept(profile: QoSProfile) -> bool:
    return bool(profile.durability == DurabilityPolicy.TRANSIENT_LOCAL)
