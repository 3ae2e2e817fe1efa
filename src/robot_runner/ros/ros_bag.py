"""The profiler that records topics into a bag while the robot is measured."""

from __future__ import annotations

import importlib.util
import shutil
import time
from collections.abc import Iterable, Sequence
from enum import StrEnum
from pathlib import Path
from typing import ClassVar

from robot_runner.core.errors import Finding, PluginError, did_you_mean
from robot_runner.core.events.context import RobotRunnerContext, SystemClock
from robot_runner.core.events.measure import Measure, Origin
from robot_runner.core.events.window import Window
from robot_runner.core.links.connect import is_simulated
from robot_runner.core.links.declared_host import LOCAL
from robot_runner.core.links.robot import Encoding
from robot_runner.core.links.ssh_command import ssh_findings
from robot_runner.core.plugin import Circumstances
from robot_runner.measuring.evaluation import note_own_window, publish_measures
from robot_runner.measuring.parameter_checks import check_numbers
from robot_runner.ros.bag_file import LinkRecorder, began_late, messages_in
from robot_runner.ros.bag_recorder import PROGRAMS, BagProgram, await_subscriptions, subscriptions_of
from robot_runner.ros.graph_addresses import is_of_environment
from robot_runner.ros.opened_bag import INSTALL
from robot_runner.ros.topic_statistics import TopicProfiler, TypedTopic, topic_label

_FIX = "Look at the bag before you use this run."
_BEGINS_WITH_RUN = "ROS' own recorders begin as the run does; RosBag(by='link') records the mission alone."
#: How long after the mission's begin a bag may begin without a warning, s.
_LATE = 0.02
#: The package that writes bags of each generation of ROS, and the links that tell which one a robot is of.
_WRITERS = {Encoding.ROS1: "rosbags", Encoding.CDR: "mcap"}
_GENERATIONS = {"ros1": Encoding.ROS1, "ros2": Encoding.CDR, "dds": Encoding.CDR}


class _By(StrEnum):
    AUTO = "auto"
    PROGRAM = "program"
    LINK = "link"


class RosBag(TopicProfiler):
    """Records topics of a robot into a bag in the plugin's folder.

    `rosbag record` or `ros2 bag record` is used if it is installed: on the robot's computer if a host is named, else on
    this machine, if its environment (`ROS_MASTER_URI`, `ROS_DOMAIN_ID`) names the robot's graph. It is started at the
    start of the run, because starting takes a while. Otherwise, and for the simulated robot, the plugin itself records
    what this machine receives during the measurement: an MCAP file of the profile of ROS 2, or a bag of ROS 1. A bag is
    not cut: its measures are about the whole recording, and doubted where that exceeds the mission by more than 1 %.

    Args:
        topics: names, relative to the robot's namespace.
        name: tells several instances apart; the class's name if left out.
        namespace: which robot, where there are several.
        by: `auto`, or `program` or `link` to use only this one of the two.
        host: the computer to record on, as for ssh; this machine if left out.
        setup: a file to source before, such as `/opt/ros/humble/setup.bash`.
        ssh_config: a file to use in place of the user's ssh config.
        patience: how long a topic may take to appear on the graph before a run starts, s.

    Raises:
        PluginError: there are no topics, a name is not valid, or `by` is none of the three.

    Example:
        >>> [measure.name for measure in RosBag(["odom", "scan"]).measures]
        ['BagMessages', 'BagSize']
    """

    measures: Sequence[Measure] = (
        Measure("BagMessages", "1", "Messages in the bag, all topics together."),
        Measure("BagSize", "B", "Size of the bag."),
    )
    needs: ClassVar[str] = "A robot whose topics can be subscribed; the extra `bag`, or rosbag or ros2."
    bytes_per_run: int = 20_000_000  # 200 kB a second, as of odometry, laser and battery, for a mission of 95 s

    def __init__(
        self,
        topics: Sequence[str] = ("odom",),
        *,
        name: str | None = None,
        namespace: str = "",
        by: str = "auto",
        host: str = LOCAL,
        setup: str | None = None,
        ssh_config: Path | None = None,
        patience: float = 5.0,
    ) -> None:
        super().__init__(name=name)
        if isinstance(topics, str) or not topics:
            fix = "Give a list of names, such as ['odom', 'scan']."
            raise PluginError(f"topics is {topics!r}", where=self.name, fix=fix)
        for topic in topics:
            topic_label(topic, where=self.name)
        if by not in set(_By):
            raise PluginError(f"by is {by!r}", where=self.name, fix=did_you_mean(by, list(_By)))
        check_numbers(self.name, may_be_zero=True, patience=patience)
        self.topics = tuple(dict.fromkeys(topics))
        self.namespace = namespace
        self.by = _By(by)
        self.host = host
        self.setup = setup
        self.ssh_config = ssh_config
        self.patience = patience
        self._recorder: LinkRecorder | BagProgram | None = None
        self._is_simulated = False
        self._begun_at: float | None = None
        self._measured_from_ns = 0
        self._recorded: Window | None = None
        self._messages: int | None = None
        self._size: int | None = None
        self._problems: list[str] = []
        self._advice = ""

    def check(self, circumstances: Circumstances) -> Iterable[Finding]:
        """Yield findings: no robot, a host that cannot be reached, or nothing here that writes the bag."""
        yield from super().check(circumstances)
        robot, where = circumstances.robot or "", f"plugin {self.name}"
        encoding = Encoding.CDR if is_simulated(robot) else _GENERATIONS.get(robot.partition(":")[0])
        if self.host != LOCAL:
            yield from ssh_findings(where, self.host, config=self.ssh_config)
        if encoding is None or self.host != LOCAL or self.setup is not None:
            return  # it is known on the robot's graph only, or where that file is sourced
        try:
            is_by_program = self._is_by_program(encoding, robot, is_simulated=is_simulated(robot))
        except PluginError as error:
            yield Finding.error(where, error.problem, error.fix)
            return
        if is_by_program and shutil.which(PROGRAMS[encoding]) is None:
            problem = f"the program {PROGRAMS[encoding]!r}, which records the bag, is not there"
            yield Finding.error(where, problem, "Source the setup file of ROS, or say by='link'.")
        if not is_by_program and importlib.util.find_spec(_WRITERS[encoding]) is None:
            yield Finding.error(where, f"{_WRITERS[encoding]}, which writes the bag, cannot be imported", INSTALL)

    def start_run(self, context: RobotRunnerContext) -> None:
        """Prepare the recording, or begin it where ROS' own program records.

        Raises:
            PluginError: none of the topics is there, or the recorder cannot be started.
        """
        self._recorder, self._messages, self._size = None, None, None
        self._begun_at, self._recorded, self._problems, self._advice = None, None, [], ""
        self._measured_from_ns = 0
        link, found = self.link(context), self.found(self.topics, context)
        self._problems = [f"{topic} is not published" for topic, typed in found.items() if typed is None]
        there: dict[str, TypedTopic] = {}
        for typed in found.values():
            if typed is not None:
                there.setdefault(typed.full_name, typed)  # one topic may have two names: odom and /alice/odom
        if not there:
            fix = "Name topics that the robot publishes: " + ", ".join(sorted(link.topics())) + "."
            raise PluginError(f"none of the topics {', '.join(self.topics)} is there", where=self.name, fix=fix)
        folder = context.raw_data_folder
        if self._is_by_program(link.encoding, str(context.robot), is_simulated=link.is_simulated):
            before = subscriptions_of(link, list(there))
            self._begun_at, self._advice = context.clock.now(), _BEGINS_WITH_RUN
            self._recorder = BagProgram(
                link.encoding, list(there), folder, host=self.host, setup=self.setup, ssh_config=self.ssh_config
            )
            for topic in await_subscriptions(link, before, seconds=self.patience):
                self._problems.append(f"the recorder did not subscribe {topic} within {self.patience:g} s")
        else:
            self._recorder = LinkRecorder(link, list(there.values()), folder)

    def start_measurement(self, context: RobotRunnerContext) -> None:
        """Begin the recording."""
        self._measured_from_ns = time.time_ns()
        if isinstance(self._recorder, LinkRecorder):
            self._begun_at = context.clock.now()
            self._recorder.begin()

    def stop_measurement(self, context: RobotRunnerContext) -> None:
        """End the recording."""
        if isinstance(self._recorder, LinkRecorder):
            self._recorder.end()
            self._note_end(context)
        self._is_simulated = self.is_of_simulation(context)

    def stop_run(self, context: RobotRunnerContext) -> None:
        """Finish the bag, and determine its size."""
        recorder, self._recorder = self._recorder, None
        if recorder is None:
            return
        problem = recorder.close()
        self._note_end(context)
        if problem is not None:
            self._problems.append(problem)
        folder = context.raw_data_folder
        self._messages = recorder.messages if isinstance(recorder, LinkRecorder) else messages_in(folder)
        if self._messages is None and problem is None:
            self._problems.append("the bag that its recorder left cannot be read")
        if isinstance(recorder, BagProgram) and self._measured_from_ns and isinstance(context.clock, SystemClock):
            late = began_late(folder, self._measured_from_ns)
            if late > _LATE:
                self._problems.append(f"the bag begins {late:.2f} s after the mission did")
        bags = [path for path in folder.rglob("*") if path.is_file() and path.suffix in {".bag", ".mcap", ".db3"}]
        self._size = sum(path.stat().st_size for path in bags) if bags else None

    def populate_run_data(self, context: RobotRunnerContext) -> None:
        """Publish the measures."""
        if self._recorded is None or context.window is None:
            self._problems.append("nothing was recorded: the measurement was never started")
        elif self._messages == 0:
            self._problems.append("no message came while it recorded")
        for problem in self._problems:
            context.doubt(problem, fix=_FIX)
        if self._recorded is not None:
            note_own_window(context, self._recorded, fix=self._advice)
        totals = {"BagMessages": self._messages, "BagSize": self._size}
        origin = Origin.SIMULATED if self._is_simulated else Origin.MEASURED
        publish_measures(context, self.measures, lambda _: totals, origin=origin)

    def _note_end(self, context: RobotRunnerContext) -> None:
        if self._recorded is None and self._begun_at is not None:
            self._recorded = Window(self._begun_at, context.clock.now())

    def _is_by_program(self, encoding: Encoding, robot: str, *, is_simulated: bool) -> bool:
        program = PROGRAMS[encoding]
        if self.by is _By.LINK or is_simulated:
            if self.by is _By.PROGRAM:
                fix = "Leave `by` out: the simulated robot is on no graph."
                raise PluginError(f"{program} cannot record a simulated robot", where=self.name, fix=fix)
            return False
        if self.host != LOCAL or self.setup is not None or self.by is _By.PROGRAM:
            return True
        return is_of_environment(robot, encoding) and shutil.which(program) is not None
