"""The policies of the QoS profiles of ROS, for all client libraries: reliability, durability, depth."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from types import MappingProxyType
from typing import NamedTuple

from robot_runner.core.errors import LinkError
from robot_runner.core.links.robot import Qos

#: The depth of each profile: how many messages are queued for a slow subscriber; 0 for no limit (rmw/qos_profiles.h).
DEPTHS = MappingProxyType({Qos.DEFAULT: 10, Qos.SENSOR_DATA: 5, Qos.RELIABLE: 0, Qos.TRANSIENT_LOCAL: 1})
#: The depth of a subscription without a profile: one second at 1 kHz, for callbacks that take long.
KEPT = 1000
#: Durations that a middleware means by infinite begin here, ns: Fast DDS' has 2^31 - 1 s.
FOR_EVER_NS = (2**31 - 1) * 10**9


class Policies(NamedTuple):
    """The policies that a publisher offers, or a subscription requests.

    Attributes:
        is_reliable: whether lost messages are sent again.
        is_kept: whether later subscribers get the last messages (durability).
        depth: how many messages are queued; 0 for no limit.
        deadline: how far apart messages may be, s.
        lease: for how long a publisher that is not heard of counts as alive, s.
        is_manual: whether each publisher has to say by itself that it is alive.
    """

    is_reliable: bool
    is_kept: bool
    depth: int = KEPT
    deadline: float = math.inf
    lease: float = math.inf
    is_manual: bool = False

    @property
    def profile(self) -> Qos:
        """The nearest profile of ROS.

        Example:
            >>> str(Policies(is_reliable=False, is_kept=False).profile)
            'sensor_data'
        """
        if self.is_kept:
            return Qos.TRANSIENT_LOCAL
        return Qos.DEFAULT if self.is_reliable else Qos.SENSOR_DATA

    def shortfall(self, offered: Policies) -> str | None:
        """Return the policy in which an offer is less than what is requested here, or None.

        The rules are those of DDS 1.4, 2.2.3, for the policies that the profiles of ROS set.

        Example:
            >>> Policies(is_reliable=True, is_kept=False).shortfall(Policies(is_reliable=False, is_kept=False))
            'reliability: it is published best effort, and subscribed reliable'
        """
        if self.is_reliable and not offered.is_reliable:
            return "reliability: it is published best effort, and subscribed reliable"
        if self.is_kept and not offered.is_kept:
            return "durability: it is published volatile, and subscribed transient local"
        if self.deadline < offered.deadline:
            return f"deadline: messages are to be at most {self.deadline:g} s apart, which is not promised"
        if self.lease < offered.lease or self.is_manual > offered.is_manual:
            return "liveliness: the publisher is to keep telling that it is alive, which is not promised"
        return None


#: The policies that every publisher satisfies.
WEAKEST = Policies(is_reliable=False, is_kept=False)


def offered_by(qos: Qos) -> Policies:
    """Return the policies that a publisher with this profile offers."""
    return Policies(qos is not Qos.SENSOR_DATA, qos is Qos.TRANSIENT_LOCAL, DEPTHS[qos])


def asked_by(qos: Qos) -> Policies:
    """Return the policies that a subscription with this profile requests."""
    # A transient local subscription gets the last message of each publisher: its depth must be enough for all of them.
    return offered_by(qos)._replace(depth=KEPT) if qos is Qos.TRANSIENT_LOCAL else offered_by(qos)


def seconds_of(nanoseconds: int) -> float:
    """Return the duration of a policy in s; 0, and one about as long as can be, mean none."""
    return nanoseconds / 1e9 if 0 < nanoseconds < FOR_EVER_NS else math.inf


def reachable(demands: Iterable[Policies], offered: Policies) -> int:
    """Return how many subscribers a publisher is to reach: tools that ask for more reliability are passed over.

    One that asks for a deadline or for liveliness is most likely the robot, which must not be.
    """
    plain = (each._replace(deadline=math.inf, lease=math.inf, is_manual=False) for each in demands)
    return sum(each.shortfall(offered) is None for each in plain)


def unmet_demand(topic: str, qos: Qos, demands: Iterable[Policies]) -> LinkError | None:
    """Return the error that all subscribers demand more than a publisher with this profile offers, if they do."""
    unmet = [demand.shortfall(offered_by(qos)) for demand in demands]
    first = unmet[0] if unmet else None
    if first is None or not all(unmet):
        return None
    fix = "Have its node ask for less."
    if first.startswith(("reliability", "durability")):
        fix = "Publish with the QoS 'reliable' or 'transient_local', or have its node ask for less."
    return LinkError(f"a subscriber asks for more than the QoS {str(qos)!r} offers: {first}", where=topic, fix=fix)


def adapted(offers: Sequence[Policies], *, alone: bool) -> Policies:
    """Return the strongest policies that a subscription may request of all these publishers.

    Where there is no publisher yet, `alone` says whether the subscription is reliable.
    """
    is_reliable = all(offer.is_reliable for offer in offers) if offers else alone
    return Policies(is_reliable, is_reliable and bool(offers) and all(offer.is_kept for offer in offers))
