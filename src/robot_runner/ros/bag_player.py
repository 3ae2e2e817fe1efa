"""Players of bags: our own over a link, which tells how late each message was, and the programs of ROS."""

from __future__ import annotations

import threading
from array import array
from collections import defaultdict, deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

from robot_runner.core.errors import Finding, PluginError
from robot_runner.core.events.context import Clock
from robot_runner.core.links.robot import Advertiser, Encoding, Message, Qos, RobotLink
from robot_runner.core.words import enumerated
from robot_runner.measuring.meter_process import MeterProcess
from robot_runner.ros.bag_recorder import ENDING, PROGRAMS
from robot_runner.ros.recorded_bag import RecordedBag, RecordedMessage, RecordedTopic
from robot_runner.ros.shapes import stamp_of

#: The topic of the time that nodes live by where `use_sim_time` is set, and its type.
CLOCK, _CLOCK_TYPE = "/clock", "rosgraph_msgs/Clock"
#: The type of a message with frames.
_FRAMES = "tf2_msgs/TFMessage"
#: How often the time is published, Hz of real time, as `rosbag play` does.
CLOCK_RATE = 100.0
#: How the names of topics end that are meant for many publishers: transforms of different frames, logs, parameters. A
#: SLAM node under test, say, publishes the pose of the map beside the odometry of the bag.
_SHARED = frozenset({"tf", "tf_static", "diagnostics", "rosout", "rosout_agg", "parameter_events"})
#: So many messages, and so many of real time, s, are read ahead at most while the next one is not due, since images are
#: large; and reading ends so long before that, s.
_AHEAD, _SPAN, _MARGIN = 200, 1.0, 0.002
#: A message that is due within so little, s, is published at once: a sleep is no more precise than that.
_SLEEP = 50e-6

#: How long a program of ROS may take until its first message is received, and to end once the bag is over, s.
_STARTUP, _GRACE = 30.0, 10.0
_LOOK = 0.02


@dataclass(frozen=True, slots=True)
class Played:
    """What was published of a bag, message by message.

    Attributes:
        times: when, s on the run's clock.
        moments: when it was recorded, s since the bag's first message.
        lateness: by how much it was published after it was due, s.
    """

    times: array[float] = field(default_factory=lambda: array("d"))
    moments: array[float] = field(default_factory=lambda: array("d"))
    lateness: array[float] = field(default_factory=lambda: array("d"))


class LinkPlayer:
    """Publishes the messages of a bag, which is open until it is played, as far apart as they were recorded.

    What was recorded is not changed: stamps in headers stay those of the recording. Only messages with fixed frames
    hold all earlier ones, too, as a late subscriber gets the last message, and in the bag each publisher had its own.

    `rate` is how many seconds of the bag go by in one second. With `has_clock` the bag's time is published on `/clock`,
    and what was recorded there is left out.
    """

    def __init__(
        self, bag: RecordedBag, topics: Sequence[RecordedTopic], link: RobotLink, *, rate: float, has_clock: bool
    ) -> None:
        self._bag, self._link, self._rate = bag, link, rate
        self._topics = {topic.name: topic for topic in topics if not (has_clock and topic.name == CLOCK)}
        self._has_clock = has_clock
        self._messages: Iterator[RecordedMessage] = iter(())
        self._ready: deque[RecordedMessage] = deque()
        self._frames: dict[str, dict[str, Message]] = defaultdict(dict)  # fixed ones, by topic and name

    def advertise(self) -> None:
        """Have the topics on the graph, and the first messages read, so that the first one is not late."""
        self._reach_subscribers()
        self._messages = self._bag.messages(list(self._topics.values()), self._link.encoding)
        self._read_one()

    def play(self, clock: Clock, played: Played) -> None:
        """Publish everything, and note it; returns with the last message.

        Raises:
            PluginError: the bag breaks off, or has no message of these topics.
            LinkError: a message cannot be published.
        """
        if not self._ready:
            raise PluginError("the bag has no message of these topics", where=str(self._bag.path), fix="Name others.")
        self._reach_subscribers()  # profilers have subscribed since the topics were advertised
        first_ns, begun = self._ready[0].stamp_ns, clock.now()
        for each in self._with_times(first_ns):
            moment = (each.stamp_ns - first_ns) * 1e-9
            due = begun + moment / self._rate
            self._read_ahead(clock, due, round(each.stamp_ns + _SPAN * 1e9 * self._rate))
            if (left := due - clock.now()) > _SLEEP:
                clock.sleep(left)
            now = clock.now()
            if each.topic == CLOCK and self._has_clock:
                self._link.publish(CLOCK, _CLOCK_TYPE, each.message)
                continue
            topic = self._topics[each.topic]
            self._link.publish(topic.name, topic.message_type, self._with_frames(topic, each.message), qos=topic.qos)
            played.times.append(now)
            played.moments.append(moment)
            played.lateness.append(now - due)

    def _reach_subscribers(self) -> None:
        if isinstance(self._link, Advertiser):
            for topic in self._topics.values():
                self._link.advertise(topic.name, topic.message_type, qos=topic.qos)

    def _with_frames(self, topic: RecordedTopic, message: Message) -> Message:
        """Return a message; one with fixed frames holds those of the earlier ones, the newest of each name."""
        if topic.message_type != _FRAMES or topic.qos is not Qos.TRANSIENT_LOCAL:
            return message
        frames = self._frames[topic.name]
        frames.update((each["child_frame_id"], each) for each in message["transforms"])
        return {"transforms": list(frames.values())}

    def _with_times(self, first_ns: int) -> Iterator[RecordedMessage]:
        """Yield the messages, and before each the times to publish by then; the last message ends it."""
        step, told = max(1, round(1e9 * self._rate / CLOCK_RATE)), first_ns
        while self._ready or self._read_one():
            message = self._ready.popleft()
            while self._has_clock and told <= message.stamp_ns:
                yield RecordedMessage(told, CLOCK, {"clock": stamp_of(told)})
                told += step
            yield message

    def _read_ahead(self, clock: Clock, due: float, until_ns: int) -> None:
        """Read while there is nothing to do; a thread would hold the interpreter just when a message is due."""
        while len(self._ready) < _AHEAD and clock.now() < due - _MARGIN:
            if (self._ready and self._ready[-1].stamp_ns >= until_ns) or not self._read_one():
                return

    def _read_one(self) -> bool:
        message = next(self._messages, None)
        if message is not None:
            self._ready.append(message)
        return message is not None


class ProgramPlayer:
    """A player of ROS' own, from its start until it has ended; raises a `PluginError` if it cannot be started."""

    def __init__(self, command: Sequence[str], encoding: Encoding, folder: Path, clock: Clock) -> None:
        self._encoding = encoding
        self._clock = clock
        self._process = MeterProcess(command, output=None, folder=folder, clock=clock)

    def await_first(self, link: RobotLink, topics: Sequence[RecordedTopic], begin_window: Callable[[], object]) -> None:
        """Return once a message of one of these topics is received; `begin_window` is called until then.

        So the window contains that message also for others who receive it a moment earlier, and those that follow
        before this is noticed.

        Raises:
            PluginError: the program ended before that, or none came in time.
        """
        received = threading.Event()

        def has_come() -> bool:
            if not received.is_set():
                begin_window()
            return received.is_set()

        with ExitStack() as subscriptions:
            for topic in topics:
                subscription = link.subscribe_raw(topic.name, topic.message_type, lambda _: received.set())
                subscriptions.callback(subscription.close)
            if self._process.wait(has_come, seconds=_STARTUP):
                return
        if not self._process.is_running:
            raise self._failure()
        problem = f"nothing that {PROGRAMS[self._encoding]} plays came within {_STARTUP:g} s"
        fix = "See that it is on the same graph: ROS_DOMAIN_ID, ROS_MASTER_URI."
        raise PluginError(problem, where="PlayBag", fix=fix)

    def play(self) -> None:
        """Return once it has ended by itself, with the bag; raise a `PluginError` if it failed."""
        while self._process.is_running:
            self._clock.sleep(_LOOK)
        ending = self._process.stop(ENDING[self._encoding], grace=_GRACE)
        if ending.exit_code != 0:
            raise self._failure()

    def close(self) -> None:
        """End the player, if it still runs; closing twice does nothing."""
        self._process.stop(ENDING[self._encoding], grace=_GRACE)

    def _failure(self) -> PluginError:
        ending = self._process.stop(ENDING[self._encoding], grace=_GRACE)
        program = PROGRAMS[self._encoding]
        problem = f"{program} ended with exit code {ending.exit_code}: {ending.complaint or 'it wrote no message'}"
        return PluginError(problem, where="PlayBag", fix="Execute it by hand to see why.")


def playing(bag: RecordedBag, topics: Sequence[str] | None, *, rate: float, has_clock: bool) -> list[str]:
    """Return the command that plays topics of a bag (None for all) with the program of its generation of ROS.

    `rate` is how many seconds of the bag go by in one second; with `has_clock` it publishes the bag's time.
    """
    path = str(bag.path.absolute())
    if bag.encoding is Encoding.ROS1:
        clock = [f"--hz={CLOCK_RATE:g}", "--clock"] if has_clock else []
        # What follows --topics is taken for topics, up to the next option.
        chosen = ["--topics", *topics, "--bags"] if topics else []
        return ["rosbag", "play", "--quiet", f"--rate={rate:g}", *clock, *chosen, path]
    clock = ["--clock", f"{CLOCK_RATE:g}"] if has_clock else []
    named = ["--topics", *topics] if topics else []
    storage = {".mcap": ["--storage", "mcap"], ".db3": ["--storage", "sqlite3"]}.get(bag.path.suffix, [])
    return ["ros2", "bag", "play", path, *storage, "--rate", f"{rate:g}", *clock, *named]


def refuse_rivals(link: RobotLink, topics: Sequence[str], *, allowed: int = 0) -> None:
    """Refuse other publishers of what is played, as nodes would get both; topics that many nodes share are left out.

    Of others, `allowed` may publish each: the program that plays is one.

    Raises:
        PluginError: there are others; each is one of its findings.
    """
    faults = []
    for topic in (each for each in topics if each.rpartition("/")[2] not in _SHARED):
        others = [each for each in link.publishers(topic) if not each.is_own]
        if len(others) > allowed:
            named = enumerated(sorted(map(str, others)))
            fix = "End it, or leave the topic out: topics=[...]."
            faults.append(Finding.error("PlayBag", f"{named} publishes {topic}, too", fix))
    PluginError.refuse(faults)
