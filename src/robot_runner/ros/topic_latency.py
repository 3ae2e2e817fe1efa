"""The profiler that measures the latency of software: from a message to the one with the same stamp."""

from __future__ import annotations

import math
from array import array
from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from typing import ClassVar

from robot_runner.core.errors import PluginError
from robot_runner.core.events.context import Clock, RobotRunnerContext
from robot_runner.core.events.measure import Measure, Origin, Over
from robot_runner.core.events.window import Window
from robot_runner.core.links.robot import RawMessage, RobotLink, Subscription
from robot_runner.measuring.evaluation import publish_measures
from robot_runner.measuring.parameter_checks import check_numbers
from robot_runner.measuring.quality import Column, write_quality, write_samples
from robot_runner.ros.topic_statistics import HeaderReader, TopicProfiler, TypedTopic, nearest_rank, topic_label

#: How often it is checked whether the last answers have arrived, s.
_LOOK = 0.01
#: By how much an answer may be received before its cause without a finding, s: two threads receive them.
_EARLY = 0.001
#: The share of answers that may be received no later than their causes without a finding. Messages that wait for a busy
#: machine are received together, in any order.
_TOGETHER = 0.05
#: At the beginning, more messages than these without an answer are told where a node that drops as many later on would
#: have them by chance with a probability below this. A filter may need a few messages to begin with.
_FIRST, _BY_CHANCE = 2, 0.001
_KEEP_STAMPS = "Have the node give its output the stamp of the input that it was made from."
_AWAIT = (
    "Await its first answer before the mission where the cause is published by then: "
    "message_on({topic!r}, ...).wait(context, timeout_s=10) in start_run, or ready=message_on(...) of the software."
)
_LOOK_AT_GRAPH = "Check whether the node is alive and publishes there: ros2 topic info, or rostopic info."

_KINDS: Mapping[str, tuple[str, str, Over | None]] = {
    "Latency": ("s", "From a message on {cause} to the one on {topic} with its stamp: mean.", None),
    "MedianLatency": ("s", "From a message on {cause} to the one on {topic} with its stamp: median.", None),
    "P95Latency": ("s", "From a message on {cause} to the one on {topic} with its stamp: 95th percentile.", None),
    "P99Latency": ("s", "From a message on {cause} to the one on {topic} with its stamp: 99th percentile.", None),
    "MaxLatency": ("s", "From a message on {cause} to the one on {topic} with its stamp: maximum.", Over.MAXIMUM),
    "Unanswered": ("1", "Messages on {cause} whose stamp no message on {topic} has.", Over.SUM),
}


@dataclass(slots=True)
class _Stamped:
    """What was received of one topic: when, and with which stamp (-1: none)."""

    label: str
    problem: str = ""
    times: array[float] = field(default_factory=lambda: array("d"))
    stamps: array[int] = field(default_factory=lambda: array("q"))

    def first_by_stamp(self) -> dict[int, float]:
        first: dict[int, float] = {}
        for stamp, time in zip(self.stamps, self.times, strict=True):
            first.setdefault(stamp, time)
        return first

    def within(self, window: Window) -> list[tuple[int, float]]:
        """Return stamp and time of what was received in a window; its end counts and its beginning does not."""
        first, last = bisect_right(self.times, window.start), bisect_right(self.times, window.end)
        return list(zip(self.stamps[first:last], self.times[first:last], strict=True))


class TopicLatency(TopicProfiler):
    """Measures the latency of software along a chain of topics, by the stamps in the headers of its messages.

    An answer is a message that has the stamp of its cause, as filters, detectors and estimators of ROS publish theirs.
    Its latency is the time between the arrivals of the two on this machine, on one clock. The clock of the stamps does
    not matter, so that a bag of last year can be used as well as a live sensor.

    Args:
        cause: the topic that begins the chain, relative to the robot's namespace.
        answers: one or more topics that answer; each is measured from `cause`.
        name: tells several instances apart; the class's name if left out.
        namespace: which robot, where there are several.
        timeout_s: how long to wait for the last answers after the mission, s.
        patience: how long a topic may take to appear on the graph before a run starts, s.

    Raises:
        PluginError: there is no answer, a name is not valid, or two topics would share a column.

    Example:
        >>> [measure.name for measure in TopicLatency("/scan", "/obstacles").measures][:3]
        ['ScanMessages', 'ObstaclesLatency', 'ObstaclesMedianLatency']
    """

    needs: ClassVar[str] = "A robot whose topics can be subscribed; nodes that keep the stamps of what they answer."
    bytes_per_run: int = 200_000

    def __init__(
        self,
        cause: str,
        *answers: str,
        name: str | None = None,
        namespace: str = "",
        timeout_s: float = 1.0,
        patience: float = 5.0,
    ) -> None:
        super().__init__(name=name)
        if not answers:
            fix = f"Name the topic that answers: TopicLatency({cause!r}, '/obstacles')."
            raise PluginError("no topic answers", where=self.name, fix=fix)
        check_numbers(self.name, may_be_zero=True, timeout_s=timeout_s, patience=patience)
        self.topics = (cause, *answers)
        labels = [topic_label(topic, where=self.name) for topic in self.topics]
        if len(set(labels)) < len(labels):
            fix = "Measure them with two instances of the plugin, with names of their own."
            raise PluginError("two topics would have the same columns", where=self.name, fix=fix)
        self.namespace, self.timeout_s, self.patience = namespace, timeout_s, patience
        self._labels = dict(zip(self.topics, labels, strict=True))
        self.measures: Sequence[Measure] = [*_measures(cause, self._labels)]
        self._received: dict[str, _Stamped] = {}
        self._subscriptions: list[Subscription] = []
        self._is_simulated = False

    def start_run(self, context: RobotRunnerContext) -> None:
        """Subscribe, so that publishers and subscriptions are connected when the mission starts."""
        self._received = {topic: _Stamped(label) for topic, label in self._labels.items()}
        self._subscriptions = []
        link, found = self.link(context), self.found(self.topics, context)
        for topic, typed in found.items():
            if typed is None:
                self._received[topic].problem = self.unpublished
            else:
                self._subscribe(link, topic, typed, context.clock)

    def stop_run(self, context: RobotRunnerContext) -> None:
        """Wait for the last answers, unsubscribe, and write the raw data."""
        if context.window is not None and self._subscriptions:
            deadline = context.window.end + self.timeout_s
            while context.clock.now() < deadline and self._missing(context.window):
                context.clock.sleep(_LOOK)
        subscriptions, self._subscriptions = self._subscriptions, []
        for subscription in subscriptions:
            subscription.close()
        if subscriptions and context.window is not None:
            self._is_simulated = self.is_of_simulation(context)
            self._write(context, context.window)

    def populate_run_data(self, context: RobotRunnerContext) -> None:
        """Publish the measures, and say what is doubtful about them."""
        if context.window is not None and self._received:
            for topic, problem, fix in self._doubts(context.window):
                own = [] if topic == self.topics[0] else [self._labels[topic] + kind for kind in _KINDS]
                context.doubt(f"topic {topic}: {problem}", fix=fix, measures=own)
        origin = Origin.SIMULATED if self._is_simulated else Origin.MEASURED
        publish_measures(context, self.measures, self._values, origin=origin)

    def _subscribe(self, link: RobotLink, topic: str, typed: TypedTopic, clock: Clock) -> None:
        received = self._received[topic]
        header = HeaderReader(link.definition(typed.message_type), link.encoding)
        if not header.has_header:
            received.problem = f"{typed.message_type} has no header, and so no stamp"
            return

        def receive(message: RawMessage) -> None:
            now, stamp = clock.now(), header.read(message.data).time_ns
            received.times.append(now)
            received.stamps.append(-1 if stamp is None else stamp)

        self._subscriptions.append(link.subscribe_raw(topic, typed.message_type, receive))

    def _latencies(self, topic: str, window: Window) -> list[tuple[float, float | None]]:
        """Return when each cause of a window arrived, and the latency of its answer, s; None where there is none."""
        answered = self._received[topic].first_by_stamp()
        causes = self._received[self.topics[0]].within(window)
        return [(time, answered[stamp] - time if stamp in answered else None) for stamp, time in causes if stamp >= 0]

    def _missing(self, window: Window) -> bool:
        return any(
            latency is None
            for topic in self.topics[1:]
            if not self._received[topic].problem
            for _, latency in self._latencies(topic, window)
        )

    def _values(self, window: Window) -> dict[str, float | None]:
        cause = self._received.get(self.topics[0])
        if cause is None or cause.problem:
            return {}
        values: dict[str, float | None] = {f"{cause.label}Messages": len(cause.within(window))}
        for topic in self.topics[1:]:
            received = self._received[topic]
            if received.problem:
                continue
            all_of_them = self._latencies(topic, window)
            known = sorted(latency for _, latency in all_of_them if latency is not None)
            summed = {
                "Latency": math.fsum(known) / len(known) if known else None,
                "MedianLatency": nearest_rank(known, 0.5),
                "P95Latency": nearest_rank(known, 0.95),
                "P99Latency": nearest_rank(known, 0.99),
                "MaxLatency": known[-1] if known else None,
                "Unanswered": len(all_of_them) - len(known),
            }
            values |= {received.label + kind: value for kind, value in summed.items()}
        return values

    def _doubts(self, window: Window) -> Iterator[tuple[str, str, str]]:
        """Yield topic, problem and remedy of what makes values doubtful or missing."""
        cause = self._received[self.topics[0]]
        for topic, received in self._received.items():
            if received.problem:
                yield topic, received.problem, _LOOK_AT_GRAPH
        if cause.problem:
            return
        causes = [stamp for stamp, _ in cause.within(window)]
        repeated, unstamped = len(causes) - len(set(causes)), sum(stamp < 0 for stamp in causes)
        if not causes:
            yield self.topics[0], "no message came while the robot was measured", _LOOK_AT_GRAPH
        elif unstamped:
            yield self.topics[0], f"{unstamped} of {len(causes)} messages have no stamp", _KEEP_STAMPS
        elif repeated:
            told = f"{repeated} of {len(causes)} messages have the stamp of an earlier one, and cannot be told from it"
            yield self.topics[0], told, "Have the sensor's node give each message a stamp of its own."
        for topic in islice(self.topics, 1, None):
            yield from self._doubts_of_answers(topic, window)

    def _doubts_of_answers(self, topic: str, window: Window) -> Iterator[tuple[str, str, str]]:
        received, latencies = self._received[topic], self._latencies(topic, window)
        known = [latency for _, latency in latencies if latency is not None]
        if received.problem or not latencies:
            return
        if not known and received.times:
            count = len(received.times)
            yield topic, f"none of its {count} messages has the stamp of one on {self.topics[0]}", _KEEP_STAMPS
        elif not known:
            yield topic, "nothing was published on it", _LOOK_AT_GRAPH
        elif min(known) < -_EARLY:
            yield topic, f"an answer came {-min(known):.3f} s before its cause", _KEEP_STAMPS
        elif (together := sum(latency <= 0 for latency in known)) > _TOGETHER * len(known):
            told = f"{together} of {len(known)} answers were received no later than their causes"
            problem = f"{told}: this machine cannot resolve the time between them"
            yield topic, problem, "Take load from this machine, or have another process play the bag."
        if first := _not_connected(latencies):
            told = f"none of the first {first} messages on {self.topics[0]} has an answer"
            why = "its node began to answer late, as one that has not discovered the other yet"
            yield topic, f"{told}: {why}", _AWAIT.format(topic=topic)

    def _write(self, context: RobotRunnerContext, window: Window) -> None:
        folder = context.raw_data_folder
        for topic in self.topics[1:]:
            latencies = self._latencies(topic, window)
            times, values = [time for time, _ in latencies], [latency for _, latency in latencies]
            columns = [Column("time_s", times), Column("latency_s", values)]
            write_samples(folder / f"{self._labels[topic]}.csv", columns)
        received = self._received.items()
        facts = {topic: {"messages": len(each.times), "problem": each.problem} for topic, each in received}
        write_quality(folder / "quality.json", None, window, {"is_simulated": self._is_simulated, "topics": facts})


def _not_connected(latencies: Sequence[tuple[float, float | None]]) -> int:
    """Return how many messages have no answer before the first that has one; 0 if the node drops as many later on."""
    answered = [latency is not None for _, latency in latencies]
    first = answered.index(True) if any(answered) else 0
    dropped = 1 - sum(answered) / len(answered[first:])
    return first if first > _FIRST and dropped**first < _BY_CHANCE else 0


def _measures(cause: str, labels: Mapping[str, str]) -> Iterator[Measure]:
    yield Measure(f"{labels[cause]}Messages", "1", f"Messages on {cause} in the measured window.", over=Over.SUM)
    for topic, label in islice(labels.items(), 1, None):
        for kind, (unit, text, over) in _KINDS.items():
            yield Measure(label + kind, unit, text.format(cause=cause, topic=topic), over=over)
