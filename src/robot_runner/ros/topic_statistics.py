"""The messages received on one topic (times, sizes, ages and sequence numbers), and the measures computed from them."""

from __future__ import annotations

import importlib.util
import math
import re
import struct
from array import array
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import ClassVar, NamedTuple

from robot_runner.core.errors import Finding, PluginError
from robot_runner.core.events.context import RobotRunnerContext
from robot_runner.core.events.window import Window
from robot_runner.core.links.connect import connect_robot, is_simulated, is_simulation, robot_namespace
from robot_runner.core.links.graph_names import full_name
from robot_runner.core.links.robot import Encoding, RawMessage, RobotLink
from robot_runner.core.plugin import Circumstances, Profiler
from robot_runner.measuring.parameter_checks import no_robot
from robot_runner.measuring.quality import Column, SampleQuality, quality_of
from robot_runner.ros.opened_bag import INSTALL
from robot_runner.ros.robot_system import OfTheRobot
from robot_runner.ros.sole_control import is_told

_HEADERS = frozenset({"Header", "std_msgs/Header", "std_msgs/msg/Header"})
#: How often missing topics are looked for on the graph, s.
_LOOK = 0.1

#: ROS 1: seq, secs, nsecs. ROS 2, after the four bytes of CDR's header: sec, nanosec.
_ROS1 = struct.Struct("<III")
_CDR = {1: struct.Struct("<iI"), 0: struct.Struct(">iI")}
_CDR_HEADER = 4
#: A line with the type of a field, which may have bounds (`string<=5`), and its name; `=` follows that of a constant.
_FIELD = re.compile(r"^[ \t]*([^\s#]+)[ \t]+\w+(?![\w \t]*=)", re.MULTILINE)


@dataclass(frozen=True, slots=True)
class TypedTopic:
    """A topic that is on the graph: as the user named it, its full name, and its ROS type."""

    name: str
    full_name: str
    message_type: str


class Stamp(NamedTuple):
    """The header of a message.

    Attributes:
        time_ns: the time of the data, ns since the epoch; None where it was left at 0.
        sequence: the number that ROS 1 gives to each message of a publisher; None in ROS 2.
    """

    time_ns: int | None
    sequence: int | None


def robot_findings(name: str, circumstances: Circumstances) -> list[Finding]:
    """Return the finding that the experiment names no robot to subscribe to, if so."""
    return [no_robot(name, "subscribes topics of a robot")] if circumstances.robot is None else []


class TopicProfiler(OfTheRobot, Profiler):
    """A profiler of topics that the experiment's robot publishes; it claims nothing else."""

    #: Topics may have no publisher before the mission.
    probe_s: float | None = None
    needs: ClassVar[str] = "A robot whose topics can be subscribed."
    #: Which robot, where there are several, and how long a topic may take to appear on the graph, s.
    namespace: str
    patience: float

    def check(self, circumstances: Circumstances) -> Iterable[Finding]:
        """Return a finding: no robot, or the embedded one without the package that serialises its messages."""
        if is_simulated(circumstances.robot) and importlib.util.find_spec("rosbags") is None:
            problem = "rosbags, which serialises the simulated robot's messages, cannot be imported"
            return [Finding.error(f"plugin {self.name}", problem, INSTALL)]
        return robot_findings(self.name, circumstances)

    def found(self, names: Iterable[str], context: RobotRunnerContext) -> Mapping[str, TypedTopic | None]:
        """Return each topic with its type; None for a topic that does not appear on the graph in time."""
        link, namespace, clock = self.link(context), robot_namespace(context, self.namespace), context.clock
        wanted = {name: full_name(namespace, name) for name in names}
        deadline = clock.now() + self.patience
        types = _typed(link)
        while not all(full in types for full in wanted.values()) and clock.now() < deadline:
            clock.sleep(_LOOK)
            types = _typed(link)
        return {name: TypedTopic(name, full, types[full]) if full in types else None for name, full in wanted.items()}

    @property
    def unpublished(self) -> str:
        """The problem of a topic that `found` has not found."""
        return f"the topic is not published within {self.patience:g} s of the run's start"

    def link(self, context: RobotRunnerContext) -> RobotLink:
        """Return the link to the robot."""
        return connect_robot(context, namespace=self.namespace)

    def is_of_simulation(self, context: RobotRunnerContext) -> bool:
        """Whether the robot is a simulated one."""
        return is_simulation(self.link(context), robot_namespace(context, self.namespace))


def _typed(link: RobotLink) -> dict[str, str]:
    """Return the type of each topic that has one: there is none where it is only subscribed, as any type."""
    return {name: message_type for name, message_type in link.topics().items() if is_told(message_type)}


def topic_label(topic: str, *, where: str) -> str:
    """Return a topic's name as part of a measure's; raise a `PluginError` if it is not the name of a topic.

    Example:
        >>> topic_label("/alice/battery_state", where="RosTopics")
        'AliceBatteryState'
    """
    words = [word for part in topic.strip("/").split("/") for word in part.split("_")]
    label = "".join(word[:1].upper() + word[1:] for word in words)
    if not (label.isascii() and label.isalnum() and label[0].isalpha()):
        fix = "Name it as on the graph, such as 'odom' or '/alice/odom'."
        raise PluginError(f"{topic!r} cannot be the name of a topic", where=where, fix=fix)
    return label


class HeaderReader:
    """Reads the header of raw messages of one type, without decoding the rest.

    Example:
        >>> reader = HeaderReader("std_msgs/Header header", Encoding.CDR)
        >>> reader.read(bytes([0, 1, 0, 0]) + _CDR[1].pack(2, 5) + b"...")
        Stamp(time_ns=2000000005, sequence=None)
    """

    def __init__(self, definition: str, encoding: Encoding) -> None:
        first = _FIELD.search(definition)
        self.has_header = first is not None and first[1] in _HEADERS
        self._is_ros1 = encoding is Encoding.ROS1

    def read(self, data: bytes) -> Stamp:
        """Return the stamp of a message."""
        if not self.has_header or len(data) < _ROS1.size:
            return Stamp(None, None)
        if self._is_ros1:
            sequence, seconds, nanoseconds = _ROS1.unpack_from(data)
        else:
            sequence = None
            seconds, nanoseconds = _CDR[data[1] & 1].unpack_from(data, _CDR_HEADER)
        return Stamp(seconds * 1_000_000_000 + nanoseconds or None, sequence)


#: The measure that only ROS 1 has.
DROPPED = "Dropped"

_UINT32 = 1 << 32

#: The numbers fall once when a publisher is restarted; with fewer messages between falls, there are several publishers.
_STEPS_A_FALL = 100

#: Share of a window's messages beyond which those that were on their way at its end leave it open what was lost: a few
#: always are, and of large ones on a slow network most may be.
_MOST_UNDERWAY = 0.1
_FEW = 3

#: By how much a stamp may be in the future, s, before clocks count as different: they never agree exactly.
_AHEAD = 0.001
#: By how much every stamp may be in the past, s, before clocks count as different: nothing live is as late as that.
_BEHIND = 60.0
#: By how much a stamp may be in the past, s, before it counts as simulated or recorded time: a day.
_ANOTHER_TIME = 86_400.0
#: The number of messages for the rate in the live display.
_RECENT = 20


def missed(sequence: Sequence[int]) -> int | None:
    """Return how many numbers of a sequence are missing; None where no publisher counts.

    A publisher counts its messages, modulo 2^32. Where the numbers fall, it was restarted; where they fall often, or
    come twice, there are several publishers with counters of their own, and losses cannot be known.

    Example:
        >>> missed([7, 8, 11, 12]), missed([0, 0, 0]), missed([90, 91, 0, 1]), missed([5, 900, 6, 901, 7, 902])
        (2, None, 0, None)
    """
    steps = [(later - sooner) % _UINT32 for sooner, later in pairwise(sequence)]
    falls = sum(step >= _UINT32 // 2 for step in steps)
    if not steps or 0 in steps or falls > max(1, len(steps) // _STEPS_A_FALL):
        return None
    return sum(step - 1 for step in steps if 1 < step < _UINT32 // 2)


def nearest_rank(ordered: Sequence[float], share: float) -> float | None:
    """Return a percentile of ascending numbers: the least that is not exceeded by this share of them.

    Example:
        >>> nearest_rank([0.1, 0.2, 0.3, 0.9], 0.5), nearest_rank([], 0.99)
        (0.2, None)
    """
    return ordered[max(0, math.ceil(share * len(ordered)) - 1)] if ordered else None


@dataclass(slots=True)
class ReceivedTopic:
    """The messages received on one topic during the measurement.

    Attributes:
        label: the topic's part of the names of measures.
        rate: the expected rate, Hz; None for any.
        problem: why the topic cannot be received; empty if it can.
        times: when each message arrived, s on the run's clock.
        sizes: of each, bytes.
        ages: of each at its arrival, s; NaN where it has no stamp.
        sequence: the number of each; -1 where it has none.
        before: the number of the last message before the window; None where it has none.
    """

    label: str
    rate: float | None
    problem: str = ""
    times: array[float] = field(default_factory=lambda: array("d"))
    sizes: array[int] = field(default_factory=lambda: array("q"))
    ages: array[float] = field(default_factory=lambda: array("d"))
    sequence: array[int] = field(default_factory=lambda: array("q"))
    before: int | None = None

    def take(self, time: float, message: RawMessage, header: HeaderReader) -> None:
        """Record a message that arrived at this time of the run's clock."""
        stamp = header.read(message.data)
        self.times.append(time)
        self.sizes.append(len(message.data))
        self.ages.append(math.nan if stamp.time_ns is None else (message.received_ns - stamp.time_ns) / 1e9)
        self.sequence.append(-1 if stamp.sequence is None else stamp.sequence)

    def over(self, window: Window) -> ReceivedTopic:
        """Return the messages of a window, with its end but without its beginning, so that windows add up."""
        first, last = bisect_right(self.times, window.start), bisect_right(self.times, window.end)
        times, sizes, sequence = self.times[first:last], self.sizes[first:last], self.sequence[first:last]
        before = self.sequence[first - 1] if first and self.sequence[first - 1] >= 0 else None
        return replace(self, times=times, sizes=sizes, ages=self.ages[first:last], sequence=sequence, before=before)

    @property
    def recent_rate(self) -> float | None:
        """The recent rate, Hz, for the live display; None with fewer than two messages."""
        recent = self.times[-_RECENT:]
        return (len(recent) - 1) / (recent[-1] - recent[0]) if len(recent) > 1 and recent[-1] > recent[0] else None

    @property
    def known_numbers(self) -> list[int]:
        """The numbers of the messages that have one."""
        return [number for number in self.sequence if number >= 0]

    @property
    def known_ages(self) -> list[float]:
        """The ages of the messages that have a stamp, s."""
        return [age for age in self.ages if math.isfinite(age)]

    @property
    def is_ahead(self) -> bool:
        """Whether a message was stamped after it arrived, so that two clocks differ."""
        return min(self.known_ages, default=0.0) < -_AHEAD

    @property
    def is_behind(self) -> bool:
        """Whether all messages were stamped so long before they arrived that clocks differ, or it is a recording."""
        return min(self.known_ages, default=0.0) > _BEHIND

    @property
    def is_of_another_time(self) -> bool:
        """Whether a message was stamped so long ago that the stamps are of simulated or recorded time."""
        return max(self.known_ages, default=0.0) > _ANOTHER_TIME

    @property
    def has_ages(self) -> bool:
        """Whether stamps and arrivals seem to be of one clock."""
        return not (self.is_ahead or self.is_behind or self.is_of_another_time)

    def quality(self, window: Window) -> SampleQuality:
        """Return how evenly the messages came over the window."""
        # Without an expected rate, the actual one is used: then only the evenness can be doubted.
        rate = self.rate or max(len(self.times), 1) / (window.duration or 1.0)
        return quality_of(self.times, window, rate)

    def underway(self, window: Window) -> int:
        """Estimate, from the rate, how many messages were sent but had not arrived by the window's end.

        The stamp, or else the arrival, counts as the time of publishing.
        """
        if len(self.times) < 2:  # noqa: PLR2004 - a rate needs two
            return 0
        delays = [age if math.isfinite(age) and self.has_ages else 0.0 for age in (self.ages[0], self.ages[-1])]
        first, last = self.times[0] - delays[0], self.times[-1] - delays[1]
        numbers = self.known_numbers
        count = numbers[-1] - numbers[0] if len(numbers) == len(self.times) else len(self.times) - 1
        return max(0, int((window.end - last) * count / (last - first))) if last > first else 0

    def dropped(self, window: Window) -> int | None:
        """Return how many messages were lost; None where it cannot be known.

        It is not known where messages have no numbers, or where many were on their way when the window ended: these may
        have been dropped, or have arrived later.
        """
        before = [] if self.before is None else [self.before]
        return None if self._is_behind(window) else missed([*before, *self.known_numbers])

    def _is_behind(self, window: Window) -> bool:
        return self.underway(window) > max(_FEW, _MOST_UNDERWAY * len(self.times))

    def values(self, window: Window) -> Mapping[str, float | None]:
        """Return the measures of the window, without the topic's label."""
        ages = self.known_ages if self.has_ages else []
        jitter = self.quality(window).jitter
        seconds = window.duration
        return {
            "Rate": len(self.times) / seconds if seconds else None,
            "Bandwidth": sum(self.sizes) / seconds if seconds else None,
            "Age": math.fsum(ages) / len(ages) if ages else None,
            "MaxAge": max(ages, default=None),
            "Jitter": None if jitter is None else jitter.p95,
            DROPPED: self.dropped(window),
        }

    def columns(self) -> list[Column]:
        """Return the raw data of each message."""
        columns = [
            Column("time_s", self.times),
            Column("size_B", self.sizes, "%d"),
            Column("age_s", [age if math.isfinite(age) else None for age in self.ages]),
        ]
        if not self.known_numbers:
            return columns
        return [*columns, Column("sequence", [None if one < 0 else one for one in self.sequence], "%d")]

    def doubts(self, quality: SampleQuality) -> Iterator[str]:
        """Yield reasons for doubt, with figures."""
        if self.problem:
            yield self.problem
            return
        if self.rate is not None or not self.times:
            yield from quality.warnings()
        if self.is_ahead:
            yield f"a message was stamped {-min(self.known_ages):.3f} s after it arrived, so ages are not known"

    def age_doubt(self) -> str | None:
        """Return the problem that the stamps are of another time or clock, or missing; None if none of them."""
        if self.times and not self.known_ages:
            return "its messages carry no stamp, so ages are not known"
        if self.is_of_another_time:
            days = max(self.known_ages) / _ANOTHER_TIME
            return (
                f"a message was stamped {days:.1f} days before it arrived, as in a simulation's time or a recording, "
                "so ages are not known"
            )
        if self.is_behind:
            return (
                f"all messages were stamped at least {min(self.known_ages):,.0f} s before they arrived, by a clock "
                "that is behind, or in a recording, so ages are not known"
            )
        return None

    def loss_doubt(self, window: Window) -> str | None:
        """Return why the number of lost messages is not known; None if it is."""
        if not self.times or self.dropped(window) is not None:
            return None
        if not self._is_behind(window):
            who = "several publishers number" if len(set(self.known_numbers)) > 1 else "nothing numbers"
            return f"{who} the messages, so that it is not known how many were lost"
        due, arrived = self.underway(window), len(self.times)
        return (
            f"{arrived} messages arrived, and by their rate about {due} more were due when the window ended: it is not "
            "known whether they were lost or came later"
        )
