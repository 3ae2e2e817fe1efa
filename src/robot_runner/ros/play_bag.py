"""The system whose mission is a recorded bag: the same sensor data for each implementation under test."""

from __future__ import annotations

import shutil
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from enum import StrEnum
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from robot_runner.core.errors import Finding, PluginError, did_you_mean
from robot_runner.core.events.context import RobotRunnerContext
from robot_runner.core.events.measure import Measure, Origin
from robot_runner.core.links.commanded_topics import TWISTS, VELOCITIES
from robot_runner.core.links.connect import connect_robot, join_beforehand
from robot_runner.core.links.robot import Encoding, RobotLink
from robot_runner.core.links.robot_name import RobotName
from robot_runner.core.storage.input_files import InputFile
from robot_runner.measuring.parameter_checks import check_numbers
from robot_runner.measuring.quality import Column, write_quality, write_samples
from robot_runner.ros.bag_player import CLOCK, LinkPlayer, Played, ProgramPlayer, playing, refuse_rivals
from robot_runner.ros.bag_recorder import PROGRAMS
from robot_runner.ros.graph_addresses import is_of_environment
from robot_runner.ros.recorded_bag import RecordedBag, RecordedTopic, bag_at
from robot_runner.ros.robot_system import RobotSystem
from robot_runner.ros.shapes import nanoseconds_of
from robot_runner.ros.topic_statistics import nearest_rank, robot_findings
from robot_runner.ros.watchdog import velocity_command

if TYPE_CHECKING:
    import os

    from robot_runner.core.plugin import Circumstances

#: How far the time on a bag's `/clock` may be from that of its recording, s, before it counts as a simulation's.
_SAME_TIME = 1.0
_FIX = "Execute the run again with nothing else going on, or play the bag more slowly (rate)."
#: By which variable each program finds its graph, and over which links a robot may be on that one.
_GRAPH_OF_PROGRAM = {
    PROGRAMS[Encoding.ROS1]: ("ROS_MASTER_URI", {"ros1"}),
    PROGRAMS[Encoding.CDR]: ("ROS_DOMAIN_ID", {"ros2", "dds"}),
}
_OF_PROGRAM = (Measure("PlayTime", "s", "From the bag's first message until the program that played it had ended."),)


class _By(StrEnum):
    LINK = "link"
    PROGRAM = "program"


class PlayBag(RobotSystem):
    """Plays a recorded bag: its first message begins the mission, and its last one ends it, `settle_s` later.

    The plugin itself publishes the messages over the link to the robot, as far apart as they were recorded, and
    measures how late each was; or `rosbag play` or `ros2 bag play` does it. The stamps in the messages stay those of
    the recording. A bag of one generation of ROS is played on a graph of the other, too, by the plugin itself.

    Args:
        path: a `.bag`, `.mcap` or `.db3` file, or the folder of a bag; `treatment(...)` may stand for it.
        name: tells several instances apart; the class's name if left out.
        topics: which of its topics, by the names in the bag; left out, all.
        rate: how many seconds of the bag go by in one second.
        clock: whether to publish the bag's time on `/clock`, for nodes with `use_sim_time`.
        by: `link`, or `program` for the player of ROS.
        settle_s: how long the mission lasts after the last message, for its effects, s.
        late_s: how late one message in a hundred may be published, s, before the run's values are doubted.

    Raises:
        PluginError: a parameter is out of its range.

    Example:
        >>> [measure.name for measure in PlayBag("hall.mcap", rate=0.5).measures]
        ['PlayTime', 'PlayedMessages', 'PlayLateness', 'MaxPlayLateness']
    """

    measures: Sequence[Measure] = (
        Measure("PlayTime", "s", "From the bag's first message until its last one was published."),
        Measure("PlayedMessages", "1", "Messages of the bag that were published."),
        Measure("PlayLateness", "s", "How late messages of the bag were published: 99 % were no later than this."),
        Measure("MaxPlayLateness", "s", "How late messages of the bag were published: maximum."),
    )
    needs: ClassVar[str] = "A ROS graph, and the extra `bag`."
    starts_nodes: bool = True  # what others need there comes with the bag
    bytes_per_run: int = 500_000  # three numbers a message, of 100 messages a second for 100 s

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        name: str | None = None,
        topics: Sequence[str] | None = None,
        rate: float = 1.0,
        clock: bool = False,
        by: str = "link",
        settle_s: float = 0.1,
        late_s: float = 0.01,
    ) -> None:
        super().__init__(name=name)
        if isinstance(topics, str) or (topics is not None and not topics):
            fix = "Give a list of names, such as ['/scan', '/odom'], or leave it out."
            raise PluginError(f"topics is {topics!r}", where=self.name, fix=fix)
        check_numbers(self.name, rate=rate, late_s=late_s)
        check_numbers(self.name, may_be_zero=True, settle_s=settle_s)
        if by not in set(_By):
            raise PluginError(f"by is {by!r}", where=self.name, fix=did_you_mean(str(by), list(_By)))
        self.path = Path(path)
        self.topics = None if topics is None else tuple(dict.fromkeys(topics))
        self.rate, self.has_clock, self.by = float(rate), clock, _By(by)
        self.settle_s, self.late_s = settle_s, late_s
        if self.by is _By.PROGRAM:  # when it publishes each message is not known
            self.measures = _OF_PROGRAM
        self._bag: RecordedBag | None = None
        self._link_player: LinkPlayer | None = None
        self._program: ProgramPlayer | None = None
        self._chosen: Sequence[RecordedTopic] = ()
        self._played = Played()
        self._span: float | None = None
        self._is_simulated = self._is_played = False

    def input_files(self) -> Iterable[InputFile]:
        """Return the bag."""
        return [InputFile(self.path)]

    def check(self, circumstances: Circumstances) -> Iterable[Finding]:
        """Yield what stands in the way: no robot, no such bag, nothing to play, no program, two clocks or times."""
        yield from robot_findings(self.name, circumstances)
        tells_time, robot = self.has_clock, circumstances.robot
        try:
            with RecordedBag(self.path) as bag:
                chosen = bag.chosen(self.topics)
                tells_time |= any(topic.name == CLOCK for topic in chosen)
                if bag.has_no_index and self.by is _By.LINK:
                    deque(bag.stamps(chosen), maxlen=0)  # raises where messages are out of order
                if self.has_clock:
                    yield from self._other_time(bag)
                if (count := bag.files_beside) > 1:
                    problem = f"{bag.path.name!r} is one of {count} files of a bag: the others are not played"
                    yield Finding.warning(self._where, problem, f"Name the folder: {str(bag.path.parent)!r}.")
                if self.by is _By.PROGRAM and shutil.which(PROGRAMS[bag.encoding]) is None:
                    problem = f"the program {PROGRAMS[bag.encoding]!r}, which plays this bag, is not there"
                    yield Finding.error(self._where, problem, "Source the setup file of ROS, or say by='link'.")
                if self.by is _By.PROGRAM and robot is not None and not is_of_environment(robot, bag.encoding):
                    yield _elsewhere(PROGRAMS[bag.encoding], self._where, robot)
        except PluginError as error:
            yield from (Finding.error(self._where, each.problem, each.fix) for each in error.findings)
        if tells_time and robot is not None and RobotName.parse(robot).options.get("clock") == "graph":
            problem = f"the run lives by the time on {CLOCK} (robot = {robot!r}), which this plugin tells"
            fix = "Leave clock=graph out of robot: the run takes this machine's time, and the nodes the bag's."
            yield Finding.error(self._where, problem, fix)

    def _other_time(self, bag: RecordedBag) -> Iterable[Finding]:
        """Yield that a simulation told another time than that of its recording: the stamps are of the former."""
        own = bag.topics.get(CLOCK)
        if own is None or not own.count or own.problem:
            return
        first = next(bag.messages([own], bag.encoding))
        apart = abs(nanoseconds_of(first.message["clock"]) - first.stamp_ns) * 1e-9
        if apart > _SAME_TIME:
            problem = (
                f"{CLOCK} told a time {apart:,.0f} s from that at which it was recorded, as in a simulation: "
                "clock=True tells that of the recording, of which the stamps in the messages are not"
            )
            fix = f"Leave clock=True out, and have the recorded {CLOCK} played"
            named = "" if self.topics is None or CLOCK in self.topics else f": topics={[*self.topics, CLOCK]}"
            yield Finding.warning(self._where, problem, f"{fix}{named}.")

    def duration_s(self, combination: Mapping[str, Any]) -> float | None:
        """Return how long the bag takes, s; None where it cannot be read, which `check` says."""
        del combination
        try:
            file = bag_at(self.path)
            return _seconds(file, file.stat().st_mtime_ns) / self.rate + self.settle_s
        except (PluginError, OSError):
            return None

    def start_run(self, context: RobotRunnerContext) -> None:
        """Open the bag, and have its topics on the graph.

        Raises:
            PluginError: the bag cannot be played, or another node publishes one of its topics.
            LinkError: the robot cannot be reached, or does not know one of its types.
        """
        self._played, self._is_played, self._span, self._program = Played(), False, None, None
        self._bag = context.resources.open(f"bag {self.name}", lambda: RecordedBag(self.path))
        self._chosen = self._bag.chosen(self.topics)
        link = connect_robot(context)
        self._is_simulated = link.is_simulated
        refuse_rivals(link, self._names)
        if self.by is _By.PROGRAM:
            self._require_program(link, str(context.robot))
            return
        self._link_player = LinkPlayer(self._bag, self._chosen, link, rate=self.rate, has_clock=self.has_clock)
        self._link_player.advertise()

    def launch_mission(self, context: RobotRunnerContext) -> None:
        """Play the bag, and return once what its last message causes had its time.

        Raises:
            PluginError: the bag breaks off, or the program fails.
        """
        link = connect_robot(context)
        if self.by is _By.PROGRAM:
            self._play_by_program(context, link)
        elif self._link_player is not None:
            self._link_player.play(context.clock, self._played)
            self._is_played = True
            self._doubt_rivals(context, link, allowed=0)
        context.clock.sleep(self.settle_s)

    def stop_run(self, context: RobotRunnerContext) -> None:
        """End what plays, and have a robot that was driven stand still."""
        bag, self._bag, self._link_player = self._bag, None, None
        with ExitStack() as closing:
            if bag is not None:
                closing.callback(bag.close)
                closing.callback(self._write, context, bag)
            self.make_safe(context)
            if self._is_played:
                topics = [(each.name, each.message_type, each.qos) for each in self._chosen]
                self.doubt_unreached(context, connect_robot(context), topics)

    def stand_by(self, context: RobotRunnerContext) -> None:
        """Join the graph, so that the command of `make_safe` arrives at once."""
        if context.robot is not None:
            join_beforehand(context)

    def make_safe(self, context: RobotRunnerContext) -> None:
        """End what plays; where velocities were recorded, command zero, also in a process not connected before."""
        program, self._program = self._program, None
        if not self._chosen and context.robot is not None:
            self._chosen = self._readable_topics()
        with ExitStack() as each_of_them:  # several robots may have been driven: whatever fails with another
            for topic in self._chosen:
                if topic.message_type in VELOCITIES:
                    each_of_them.callback(_command_zero, topic, context)
            if program is not None:
                program.close()

    def populate_run_data(self, context: RobotRunnerContext) -> None:
        """Publish the measures."""
        origin = Origin.SIMULATED if self._is_simulated else Origin.MEASURED
        late = sorted(self._played.lateness)
        p99 = nearest_rank(late, 0.99)
        if self.by is _By.LINK:
            times = self._played.times
            self._span = times[-1] - times[0] if times else None
            context.publish("PlayedMessages", len(times), origin=origin)
            told = sum(each.count for each in self._chosen if not (self.has_clock and each.name == CLOCK))
            if self._is_played and len(times) != told:
                problem = f"{len(times)} messages were played, and the bag counts {told} on these topics"
                fix = "Compare it with its original, or record it again."
                context.doubt(f"{problem}: it is damaged, or its count is wrong", fix=fix)
            context.publish("PlayLateness", p99, origin=origin)
            context.publish("MaxPlayLateness", late[-1] if late else None, origin=origin)
        context.publish("PlayTime", self._span, origin=origin)
        if p99 is not None and p99 > self.late_s:
            figures = (
                f"99 % of the messages were published up to {p99 * 1e3:.1f} ms late, and one {late[-1] * 1e3:.1f} ms"
            )
            context.doubt(f"the bag was not played as it was recorded: {figures}", fix=_FIX)

    @property
    def _where(self) -> str:
        return f"plugin {self.name}"

    @property
    def _names(self) -> list[str]:
        names = [topic.name for topic in self._chosen]
        return names if CLOCK in names or not self.has_clock else [*names, CLOCK]

    def _require_program(self, link: RobotLink, robot: str) -> None:
        if self._bag is not None and (link.encoding is not self._bag.encoding or link.is_simulated):
            problem = f"{PROGRAMS[self._bag.encoding]} cannot play this bag on the graph of this robot"
            raise PluginError(problem, where=self.name, fix="Say by='link'.")
        if self._bag is not None and not is_of_environment(robot, self._bag.encoding):
            raise PluginError.of_findings([_elsewhere(PROGRAMS[self._bag.encoding], self.name, robot)])

    def _play_by_program(self, context: RobotRunnerContext, link: RobotLink) -> None:
        if self._bag is None:
            return
        command = playing(self._bag, self.topics, rate=self.rate, has_clock=self.has_clock)
        self._program = ProgramPlayer(command, self._bag.encoding, context.raw_data_folder, context.clock)
        # The program takes a second until it plays.
        self._program.await_first(link, self._chosen, context.begin_window)
        begun = context.clock.now()
        self._doubt_rivals(context, link, allowed=1)  # the program itself
        self._program.play()
        self._span = context.clock.now() - begun

    def _doubt_rivals(self, context: RobotRunnerContext, link: RobotLink, *, allowed: int) -> None:
        try:
            refuse_rivals(link, self._names, allowed=allowed)
        except PluginError as error:
            context.doubt(f"while the bag was played, {error.problem}", fix=error.fix)

    def _readable_topics(self) -> Sequence[RecordedTopic]:
        try:
            with RecordedBag(self.path) as bag:
                return bag.chosen(self.topics)
        except PluginError:  # nothing of it was ever played
            return ()

    def _write(self, context: RobotRunnerContext, bag: RecordedBag) -> None:
        facts = {
            "bag": str(bag.path),
            "messages": bag.count,
            "seconds": bag.seconds,
            "begin_ns": bag.begin_ns,
            "topics": {topic.name: topic.count for topic in self._chosen},
        }
        folder, played = context.raw_data_folder, self._played
        write_quality(folder / "bag.json", None, context.window, facts)
        if self.by is _By.LINK:
            columns = {"time_s": played.times, "moment_s": played.moments, "late_s": played.lateness}
            write_samples(folder / "played.csv", [Column(name, values) for name, values in columns.items()])


def _command_zero(topic: RecordedTopic, context: RobotRunnerContext) -> None:
    still = velocity_command(topic.message_type, 0.0, 0.0) if topic.message_type in TWISTS else {}
    connect_robot(context).publish(topic.name, topic.message_type, still, qos=topic.qos)


def _elsewhere(program: str, where: str, robot: str) -> Finding:
    problem = f"{program} would play on the graph that this machine's environment names, and not on that of {robot!r}"
    variable, links = _GRAPH_OF_PROGRAM[program]
    fix = "Say by='link'"
    if RobotName.parse(robot).link in links:  # of a rosbridge nothing tells which graph is behind it
        fix += f", or set {variable} to that of the robot"
    return Finding.error(where, problem, f"{fix}.")


@lru_cache(maxsize=32)
def _seconds(path: Path, changed_ns: int) -> float:
    """Return how long a bag takes, s; read once for each state of its file."""
    del changed_ns
    with RecordedBag(path) as bag:
        return bag.seconds
