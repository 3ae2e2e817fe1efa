"""The profiler that measures the topics of a robot: rate, bandwidth, age, jitter, losses."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from robot_runner.core.errors import PluginError
from robot_runner.core.events.context import RobotRunnerContext
from robot_runner.core.events.measure import Measure, Origin, Over
from robot_runner.core.events.window import Window
from robot_runner.core.execution.clock_jumps import ClockJumps, told_setting
from robot_runner.core.links.robot import RawMessage, RobotLink, Subscription
from robot_runner.measuring.evaluation import NEVER_STARTED, publish_measures
from robot_runner.measuring.live_samples import LiveSamples
from robot_runner.measuring.parameter_checks import check_numbers
from robot_runner.measuring.quality import Column, write_quality, write_samples
from robot_runner.ros.topic_statistics import DROPPED, HeaderReader, ReceivedTopic, TopicProfiler, topic_label

_FIX = "Look at the topic, with `ros2 topic hz` or `rostopic hz`, before you use this run."
_CLOCKS_FIX = "Synchronise the clocks of the robot and of this machine, with chrony or ntpd."

#: The raw data of each message, bytes.
_LINE_BYTES = 48
_MISSION_SECONDS = 95


class RosTopics(TopicProfiler):
    """Measures topics as this machine receives them: rate, bandwidth, age by header stamps, jitter, and losses.

    Messages are not decoded; their sizes are as received. A topic without a header has no age.

    Args:
        topics: names, relative to the robot's namespace, each with its expected rate, Hz (None: any).
        name: tells several instances apart; the class's name if left out.
        namespace: which robot, where there are several.
        losses: whether to measure the number of lost messages, on ROS 1, whose publishers number their messages.
        patience: how long a topic may take to appear on the graph before a run starts, s.

    Raises:
        PluginError: there are no topics, a name or a rate is not valid, or two topics would share a column.

    Example:
        >>> [measure.name for measure in RosTopics({"odom": 30.0}).measures]
        ['OdomRate', 'OdomBandwidth', 'OdomAge', 'OdomMaxAge', 'OdomJitter']
    """

    def __init__(
        self,
        topics: Mapping[str, float | None] | Sequence[str] = ("odom",),
        *,
        name: str | None = None,
        namespace: str = "",
        losses: bool = False,
        patience: float = 5.0,
    ) -> None:
        super().__init__(name=name)
        self.topics = _rates(topics, self.name)
        check_numbers(self.name, may_be_zero=True, patience=patience)
        self.namespace = namespace
        self.patience = patience
        self._labels = labels = _labels(self.topics, self.name)
        self.losses = losses
        self._kinds = tuple(kind for kind in _KINDS if losses or kind != DROPPED)
        self.measures: Sequence[Measure] = [
            measure for topic, label in labels.items() for measure in _measures(topic, label, self._kinds)
        ]
        rates = self.topics.values()
        self.bytes_per_run = sum(round((rate or 50.0) * _MISSION_SECONDS * _LINE_BYTES) for rate in rates)
        self._received: dict[str, ReceivedTopic] = {}
        self._subscriptions: list[Subscription] = []
        self._live: list[LiveSamples] = []
        self._is_measuring = False
        self._is_simulated = False
        self._begun_at = 0.0
        self._jumps = ClockJumps()
        self._clock_set = 0.0
        self._sampled: Window | None = None

    def start_run(self, context: RobotRunnerContext) -> None:
        """Subscribe, so that publishers and subscriptions are connected when the measurement starts."""
        self._sampled, self._is_measuring = None, False
        self._received = {topic: ReceivedTopic(self._labels[topic], rate) for topic, rate in self.topics.items()}
        self._subscriptions, self._live = [], []
        link, found = self.link(context), self.found(self.topics, context)
        for topic, typed in found.items():
            if typed is None:
                self._received[topic].problem = self.unpublished
            else:
                self._subscribe(link, topic, typed.message_type, context)

    def start_measurement(self, context: RobotRunnerContext) -> None:
        """Begin counting."""
        self._begun_at = context.clock.now()
        self._jumps = ClockJumps()
        self._is_measuring = True

    def stop_measurement(self, context: RobotRunnerContext) -> None:
        """End counting."""
        if self._is_measuring:
            self._is_measuring = False
            self._sampled = Window(self._begun_at, context.clock.now())
            self._clock_set = self._jumps.was_set
        self._is_simulated = self.is_of_simulation(context)

    def stop_run(self, context: RobotRunnerContext) -> None:
        """Unsubscribe, and write the raw data."""
        subscriptions, self._subscriptions = self._subscriptions, []
        for subscription in subscriptions:
            subscription.close()
        if self._sampled is not None:
            for received in self._received.values():
                write_samples(context.raw_data_folder / f"{received.label}.csv", received.columns())
        for live in self._live:
            live.close()

    def populate_run_data(self, context: RobotRunnerContext) -> None:
        """Publish the measures; no value for a topic without messages."""
        window = context.window
        if self._sampled is None or window is None:
            context.doubt(NEVER_STARTED, fix=_FIX)
        else:
            self._report(context, window)
        origin = Origin.SIMULATED if self._is_simulated else Origin.MEASURED
        heard = [] if self._sampled is None or window is None else self._heard_in(window)
        publish_measures(context, self.measures, lambda part: _values(heard, part, self._kinds), origin=origin)

    def _heard_in(self, window: Window) -> list[ReceivedTopic]:
        """Return the topics with messages in a window, reduced to these."""
        return [within for received in self._received.values() if (within := received.over(window)).times]

    def _subscribe(self, link: RobotLink, topic: str, message_type: str, context: RobotRunnerContext) -> None:
        received, clock = self._received[topic], context.clock
        header = HeaderReader(link.definition(message_type), link.encoding)
        live = LiveSamples(context.raw_data_folder / f"{received.label}.csv")
        self._live.append(live)

        def receive(message: RawMessage) -> None:
            if self._is_measuring:
                received.take(clock.now(), message, header)
                live.show(lambda: [Column("time_s", [clock.now()]), Column("rate_Hz", [received.recent_rate])])

        self._subscriptions.append(link.subscribe_raw(topic, message_type, receive))

    def _report(self, context: RobotRunnerContext, window: Window) -> None:
        facts: dict[str, Any] = {}
        for topic, heard in self._received.items():
            received = heard.over(window)
            quality = received.quality(window)
            facts[topic] = asdict(quality)
            doubted = [received.label + kind for kind in self._kinds]
            for problem in received.doubts(quality):
                fix = _CLOCKS_FIX if received.is_ahead else _FIX
                context.doubt(f"topic {topic}: {problem}", fix=fix, measures=doubted)
            ages = [received.label + kind for kind in ("Age", "MaxAge")]
            if (old := received.age_doubt()) is not None:
                fix = "Go without them: the rest is counted here."
                if received.is_behind and not received.is_of_another_time:
                    fix = f"{_CLOCKS_FIX} Of a recording, go without ages: the rest is counted here."
                context.doubt(f"topic {topic}: {old}", fix=fix, measures=ages)
            elif self._clock_set and received.known_ages and not self._is_simulated:
                problem, fix = told_setting(self._clock_set)
                context.doubt(f"topic {topic}: {problem}", fix=fix, measures=ages)
            unknown = received.loss_doubt(window) if self.losses else None
            if unknown is not None:
                fix = "Count the messages where they are published, and compare with the recorded ones."
                context.doubt(f"topic {topic}: {unknown}", fix=fix, measures=[received.label + DROPPED])
        details = {"is_simulated": self._is_simulated, "topics": facts}
        write_quality(context.raw_data_folder / "quality.json", None, window, details, sampled=self._sampled)


#: A percentile over several windows does not follow from those of each.
_KINDS: Mapping[str, tuple[str, str, Over | None]] = {
    "Rate": ("Hz", "Messages on {topic} a second, over the measured window.", Over.MEAN),
    "Bandwidth": ("B/s", "Bytes of the messages on {topic} a second, over the measured window.", Over.MEAN),
    "Age": ("s", "Age of messages on {topic} when they arrive, by the stamps in their headers: mean.", Over.MEAN),
    "MaxAge": (
        "s",
        "Age of messages on {topic} when they arrive, by the stamps in their headers: maximum.",
        Over.MAXIMUM,
    ),
    "Jitter": ("s", "Times between messages on {topic}: 95 % are no further than this from their median.", None),
    DROPPED: ("1", "Messages on {topic} that did not arrive, by the numbers in their headers (ROS 1 only).", Over.SUM),
}


def _values(heard: Iterable[ReceivedTopic], window: Window, kinds: Iterable[str]) -> dict[str, float | None]:
    values = ((received.label, received.over(window).values(window)) for received in heard)
    return {label + kind: own[kind] for label, own in values for kind in kinds}


def _measures(topic: str, label: str, kinds: Iterable[str]) -> Iterator[Measure]:
    for kind in kinds:
        unit, text, over = _KINDS[kind]
        yield Measure(label + kind, unit, text.format(topic=topic), over=over)


def _rates(topics: Mapping[str, float | None] | Sequence[str], where: str) -> dict[str, float | None]:
    if isinstance(topics, str) or not topics:
        fix = "Give names with rates, such as {'odom': 30.0}, or a list of names."
        raise PluginError(f"topics is {topics!r}", where=where, fix=fix)
    rates = dict(topics) if isinstance(topics, Mapping) else dict.fromkeys(topics)
    for topic, rate in rates.items():
        check_numbers(f"{where}, {topic}", rate=1.0 if rate is None else rate)
    return rates


def _labels(topics: Iterable[str], where: str) -> dict[str, str]:
    labels: dict[str, str] = {}
    for topic in topics:
        label = topic_label(topic, where=where)
        if label in labels.values():
            fix = "Measure them with two instances of the plugin, with names of their own."
            raise PluginError(f"two topics would have the columns of {label!r}", where=where, fix=fix)
        labels[topic] = label
    return labels
