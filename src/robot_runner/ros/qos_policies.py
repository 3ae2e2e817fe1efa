"""What the QoS profiles of ROS ask for and offer, whatever the client library: reliability, durability, depth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

from robot_runner.core.links.robot import Qos

#: How many messages wait for a slow subscriber, each; 0 is as many as come (rmw/qos_profiles.h of ROS 2).
DEPTHS: Mapping[Qos, int] = MappingProxyType(
    {Qos.DEFAULT: 10, Qos.SENSOR_DATA: 5, Qos.RELIABLE: 0, Qos.TRANSIENT_LOCAL: 1}
)
#: How much of a topic is kept while a callback runs, where the user names no profile: a second of 1 kHz.
KEPT = 1000


class Policies(NamedTuple):
    """What a publisher offers, or a subscription asks for.

    Attributes:
        is_reliable: whether messages that are lost are sent again.
        is_kept: whether the last ones are there for later subscribers.
        depth: how many messages wait; 0 is as many as come.
    """

    is_reliable: bool
    is_kept: bool
    depth: int = KEPT

    @property
    def profile(self) -> Qos:
        """The profile of ROS that comes nearest.

        Example:
            >>> str(Policies(is_reliable=False, is_kept=False).profile)
            'sensor_data'
        """
        if self.is_kept:
            return Qos.TRANSIENT_LOCAL
        return Qos.DEFAULT if self.is_reliable else Qos.SENSOR_DATA

    def shortfall(self, offered: Policies) -> str | None:
        """Say which policy of an offer is less than what is asked for here, or return None if none is.

        The rules are those of DDS 1.4, 2.2.3, for the policies that the profiles of ROS set.

        Example:
            >>> Policies(is_reliable=True, is_kept=False).shortfall(Policies(is_reliable=False, is_kept=False))
            'reliability: it is published best effort, and subscribed reliable'
        """
        if self.is_reliable and not offered.is_reliable:
            return "reliability: it is published best effort, and subscribed reliable"
        if self.is_kept and not offered.is_kept:
            return "durability: it is published volatile, and subscribed transient local"
        return None


#: What every publisher offers at least.
WEAKEST = Policies(is_reliable=False, is_kept=False)


def offered_by(qos: Qos) -> Policies:
    """Return what a publisher of a profile offers."""
    return Policies(qos is not Qos.SENSOR_DATA, qos is Qos.TRANSIENT_LOCAL, DEPTHS[qos])


def asked_by(qos: Qos) -> Policies:
    """Return what a subscription of a profile asks for."""
    # Of what is kept it is the last message of each publisher: the depth of a reader is that of them all.
    return offered_by(qos)._replace(depth=KEPT) if qos is Qos.TRANSIENT_LOCAL else offered_by(qos)


def adapted(offers: Sequence[Policies], *, alone: bool) -> Policies:
    """Return what a subscription asks for that all of these publishers satisfy, as strong as they allow.

    Where there is none yet, `alone` says whether it is to be reliable.
    """
    is_reliable = all(offer.is_reliable for offer in offers) if offers else alone
    return Policies(is_reliable, is_reliable and bool(offers) and all(offer.is_kept for offer in offers))
