"""The profiler that records topics into a bag while the robot is measured."""

from __future__ import annotations

import shlex
import shutil
import signal
import subprocess
import time
from enum import StrEnum
from typing import TYPE_CHECKING, ClassVar

from robot_runner.core.errors import Finding, PluginError, did_you_mean
from robot_runner.core.events.context import SystemClock
from robot_runner.core.events.measure import Measure, Origin
from robot_runner.core.events.window import Window
from robot_runner.core.links.connect import connect_robot, is_simulation
from robot_runner.core.links.host import LOCAL
from robot_runner.core.links.robot import Encoding
from robot_runner.core.links.ssh_host import remedy, ssh_command, ssh_findings
from robot_runner.core.plugin import Profiler
from robot_runner.core.sampling.evaluation import note_own_window, publish_measures
from robot_runner.core.sampling.meter_process import MeterProcess
from robot_runner.ros.bag_file import LinkRecorder, messages_in
from robot_runner.ros.topic_statistics import found_topics, robot_findings, topic_label

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from robot_runner.core.events.context import RobotRunnerContext
    from robot_runner.core.plugin import Circumstances

__all__ = ["PROGRAMS", "BagProgram", "RosBag"]


#: The program that records messages of each generation of ROS.
PROGRAMS = {Encoding.ROS1: "rosbag", Encoding.CDR: "ros2"}

#: How long a recorder may take to begin, to finish its bag, and to send it from the robot, s: a bag of a mission has
#: some 20 MB, and Wi-Fi may carry less than 1 MB/s.
_STARTUP, _GRACE, _FETCH = 15.0, 30.0, 600.0
#: How often the folder is looked at until the bag is finished, s.
_LOOK = 0.02

#: What each takes for "finish your bag, and end". `rosbag` passes SIGTERM on to the program behind it as SIGINT, and
#: SIGINT not at all, which a terminal would send to both.
_END = {Encoding.ROS1: signal.SIGTERM, Encoding.CDR: signal.SIGINT}

#: Recording goes on until this script's input ends, as it does when ssh ends, whatever ended it; then the recorder gets
#: its signal. The folder is named on the first line that is said. Without `set -m` the recorder would ignore SIGINT.
_ON_HOST = """set -m
trap : INT TERM
folder=$(mktemp -d) && cd "$folder" || exit 1
{setup}
{command} >record.txt 2>&1 </dev/null &
for i in $(seq 150); do ls bag* >/dev/null 2>&1 && break; kill -0 $! 2>/dev/null || break; sleep 0.1; done
kill -0 $! 2>/dev/null || {{ tail -n 1 record.txt >&2; exit 1; }}
echo "$folder"
exec >/dev/null 2>&1
cat
kill -{signal} $!
wait $!
for i in $(seq 300); do ls ./*.active >/dev/null 2>&1 || break; sleep 0.1; done
touch done
"""


class BagProgram:
    """A recorder of ROS' own, from its start until it is closed.

    Args:
        encoding: of the messages, which tells the generation of ROS.
        topics: full names.
        folder: takes the bag.
        host: as for ssh; `localhost` is this machine.
        setup: a file to be sourced on the host first, such as `/opt/ros/humble/setup.bash`.
        ssh_config: a file to take the place of the user's ssh config.

    Raises:
        PluginError: it cannot be started.
    """

    def __init__(
        self,
        encoding: Encoding,
        topics: Sequence[str],
        folder: Path,
        *,
        host: str = LOCAL,
        setup: str | None = None,
        ssh_config: Path | None = None,
    ) -> None:
        self._folder = folder
        self._host = host
        self._config = ssh_config
        self._encoding = encoding
        words = shlex.join(recording(encoding, topics))
        if host == LOCAL:
            sourced = f". {shlex.quote(setup)} && " if setup else ""
            command = ["bash", "-c", f"cd {shlex.quote(str(folder))} && {sourced}exec {words}"]
        else:
            sourced = f". {shlex.quote(setup)}" if setup else ""
            script = _ON_HOST.format(setup=sourced, command=words, signal=_END[encoding].name.removeprefix("SIG"))
            command = ssh_command(host, f"bash -c {shlex.quote(script)}", config=ssh_config)
        self._process = MeterProcess(command, output=None, folder=folder, clock=SystemClock())
        self._process.wait(self._has_begun, seconds=_STARTUP)
        if not self._process.is_running:
            ending = self._process.stop(_END[encoding], grace=_GRACE)
            raise PluginError(
                f"{PROGRAMS[encoding]} ended at once: {ending.complaint}",
                where=f"RosBag on {host}",
                fix=remedy(host, self._process.said) if host != LOCAL else "Source the setup file of ROS (`setup`).",
            )

    def close(self) -> str | None:
        """End it, fetch the bag where it is on another computer, and say what went wrong, if anything did."""
        if self._host == LOCAL:
            ending = self._process.stop(_END[self._encoding], grace=_GRACE)
            self._wait_until_renamed()
        else:
            ending = self._process.stop(signal.SIGTERM, grace=_GRACE)
            problem = self._fetched()
            if problem is not None:
                return problem
        return None if ending.was_asked else f"the recorder ended by itself: {ending.complaint}"

    def _wait_until_renamed(self) -> None:
        """Wait for the recorder behind `rosbag`, which outlives it: until it is finished, a bag is called `.active`."""
        deadline = time.monotonic() + _GRACE
        while any(self._folder.glob("*.active")) and time.monotonic() < deadline:
            time.sleep(_LOOK)

    def _has_begun(self) -> bool:
        if self._host != LOCAL:
            return bool(self._process.records)
        return any(path.name.startswith("bag") for path in self._folder.iterdir())

    def _fetched(self) -> str | None:
        """Copy the host's folder into ours and remove it there; return why that failed, if it did."""
        if not self._process.records:
            return "the recorder on the robot did not say where its bag is"
        remote = shlex.quote(self._process.records[0].text)
        # What finishes the bag outlives its ssh by a moment.
        wait = f"for i in $(seq {round(10 * _GRACE)}); do [ -e {remote}/done ] && break; sleep 0.1; done"
        command = ssh_command(self._host, f"{wait}; tar -C {remote} -cf - . && rm -rf {remote}", config=self._config)
        return _unpacked(command, self._folder)


def recording(encoding: Encoding, topics: Sequence[str]) -> list[str]:
    """Return the command that records topics into `bag.bag`, or into the folder `bag`, until it gets SIGINT."""
    if encoding is Encoding.ROS1:
        return ["rosbag", "record", "--quiet", "-O", "bag.bag", *topics]
    return ["ros2", "bag", "record", "-o", "bag", *topics]


def _unpacked(command: Sequence[str], folder: Path) -> str | None:
    try:
        packed = subprocess.run(  # noqa: S603  # an argument list; the host's name was checked
            command, stdin=subprocess.DEVNULL, capture_output=True, timeout=_FETCH, check=True, start_new_session=True
        )
        subprocess.run(  # noqa: S603  # an argument list
            ["tar", "-C", str(folder), "-xf", "-"],  # noqa: S607  # the system's
            input=packed.stdout,
            capture_output=True,
            timeout=_FETCH,
            check=True,
        )
    except subprocess.TimeoutExpired:
        return f"the bag could not be fetched within {_FETCH:g} s"
    except subprocess.CalledProcessError as error:
        return f"the bag could not be fetched: {error.stderr.decode(errors='replace').strip()[-200:]}"
    return None


_FIX = "Look at the bag before you use this run."


class _By(StrEnum):
    AUTO = "auto"
    PROGRAM = "program"
    LINK = "link"


class RosBag(Profiler):
    """Records topics of a robot into a bag in the plugin's folder.

    `rosbag record` or `ros2 bag record` is used where it is there: on the robot's computer if a host is named, else on
    this machine; it begins when the run starts, because it takes a while to. Where it is not there, and on the
    simulated robot, the plugin itself records what this machine receives while all measure: an MCAP file of the
    profile of ROS 2, or a bag of ROS 1. A bag is kept whole: its measures are about all of the time in which it was
    recorded, and are doubted where that exceeds the mission by more than 1 %.

    Args:
        topics: names, relative to the robot's namespace.
        name: tells several instances apart; the class's name if left out.
        namespace: which robot, where there are several.
        by: `auto`, or `program` or `link` to have one of the two and no other.
        host: the computer to record on, as for ssh; this machine if left out.
        setup: a file to be sourced before, such as `/opt/ros/humble/setup.bash`.
        ssh_config: a file to take the place of the user's ssh config.
        patience: how long a topic may take to appear on the graph before a run starts, s.

    Raises:
        PluginError: there are no topics, a name cannot be one, or `by` is none of the three.

    Example:
        >>> [measure.name for measure in RosBag(["odom", "scan"]).measures]
        ['BagMessages', 'BagSize']
    """

    measures: Sequence[Measure] = (
        Measure("BagMessages", "1", "Messages in the bag, all topics together."),
        Measure("BagSize", "B", "Size of the bag."),
    )
    #: Topics may be published by nobody before the mission.
    probe_s: float | None = None
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
        self._recorded: Window | None = None
        self._messages: int | None = None
        self._size: int | None = None
        self._problems: list[str] = []

    def check(self, circumstances: Circumstances) -> Iterable[Finding]:
        """Return what stands in the way: no robot, or a host that cannot be reached."""
        findings = robot_findings(self.name, circumstances)
        if self.host != LOCAL:
            findings += ssh_findings(f"plugin {self.name}", self.host, config=self.ssh_config)
        return findings

    def start_run(self, context: RobotRunnerContext) -> None:
        """Get ready to record, or begin to where ROS' own program does it.

        Raises:
            PluginError: none of the topics is there, or the recorder cannot be started.
        """
        self._recorder, self._messages, self._size = None, None, None
        self._begun_at, self._recorded, self._problems = None, None, []
        link = connect_robot(context, namespace=self.namespace)
        self._is_simulated = is_simulation(link, self.namespace)
        found = found_topics(link, self.topics, self.namespace, context.clock, patience=self.patience)
        self._problems = [f"{topic} is not published" for topic, typed in found.items() if typed is None]
        topics = [typed for typed in found.values() if typed is not None]
        if not topics:
            fix = "Name topics that the robot publishes: " + ", ".join(sorted(link.topics())) + "."
            raise PluginError(f"none of the topics {', '.join(self.topics)} is there", where=self.name, fix=fix)
        folder = context.raw_data_folder
        if self._is_by_program(PROGRAMS[link.encoding], is_embedded=link.is_simulated):
            names = [topic.full_name for topic in topics]
            self._begun_at = context.clock.now()
            self._recorder = BagProgram(
                link.encoding, names, folder, host=self.host, setup=self.setup, ssh_config=self.ssh_config
            )
        else:
            self._recorder = LinkRecorder(link, topics, folder)

    def start_measurement(self, context: RobotRunnerContext) -> None:
        """Begin to record."""
        if isinstance(self._recorder, LinkRecorder):
            self._begun_at = context.clock.now()
            self._recorder.begin()

    def stop_measurement(self, context: RobotRunnerContext) -> None:
        """Record no more."""
        if isinstance(self._recorder, LinkRecorder):
            self._recorder.end()
            self._note_end(context)

    def stop_run(self, context: RobotRunnerContext) -> None:
        """Finish the bag, and weigh it."""
        recorder, self._recorder = self._recorder, None
        if recorder is None:
            return
        problem = recorder.close()
        self._note_end(context)
        if problem is not None:
            self._problems.append(problem)
        folder = context.raw_data_folder
        self._messages = recorder.messages if isinstance(recorder, LinkRecorder) else messages_in(folder)
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
            note_own_window(context, self._recorded)
        totals = {"BagMessages": self._messages, "BagSize": self._size}
        origin = Origin.SIMULATED if self._is_simulated else Origin.MEASURED
        publish_measures(context, self.measures, lambda _: totals, origin=origin)

    def _note_end(self, context: RobotRunnerContext) -> None:
        if self._recorded is None and self._begun_at is not None:
            self._recorded = Window(self._begun_at, context.clock.now())

    def _is_by_program(self, program: str, *, is_embedded: bool) -> bool:
        if self.by is _By.LINK or is_embedded:
            if self.by is _By.PROGRAM:
                fix = "Leave `by` out: the simulated robot is on no graph."
                raise PluginError(f"{program} cannot record a simulated robot", where=self.name, fix=fix)
            return False
        if self.host != LOCAL or self.setup is not None or self.by is _By.PROGRAM:
            return True
        return shutil.which(program) is not None
