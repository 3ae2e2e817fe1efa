"""The subject that is a launch file of ROS 1 or ROS 2."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robot_runner.core.errors import Finding, LinkError, PluginError, did_you_mean, nearest
from robot_runner.core.links.connect import resolved_robot, robot_namespace
from robot_runner.core.storage.input_files import InputFile, kept_copy
from robot_runner.measuring.own_scripts import is_file, is_installed
from robot_runner.subjects.read_files import with_what_it_names
from robot_runner.subjects.ros_subject import RosSubject
from robot_runner.subjects.surroundings import holds_revision, word

if TYPE_CHECKING:
    from robot_runner.core.events.context import ExperimentContext, RobotRunnerContext
    from robot_runner.core.plugin import Circumstances
    from robot_runner.subjects.supervised_program import Start

#: What the namespace of the run's robot takes the place of, in an argument.
_NAMESPACE = "{namespace}"
#: How both tell of an argument that a launch file takes: `  speed: ...` (ROS 1), and `    'speed':` (ROS 2).
_ARGUMENTS = {1: re.compile(r"^  (\w+)(?: \(.*\))?:", re.MULTILINE), 2: re.compile(r"^\s+'([^']+)':", re.MULTILINE)}
#: Before a line that roslaunch writes in bold or in red.
_ESCAPE = rb"(?:\x1b\[\d*m)?"
#: How both say that a node was started, and that it ended; what a node writes is told in another way.
_STARTED = re.compile(_ESCAPE + rb"(?:process\[(\S+)\]: |\[INFO\] \[(\S+)\]: process )started with pid")
_ENDED = re.compile(
    _ESCAPE
    + rb"\[(?:(?:INFO|ERROR)\] \[)?(\S+?)\]:? process has (?:finished cleanly|died \[pid \d+, (exit code -?\d+))"
)
#: How roslaunch says that one ended with which the launch ends as well; the next line has how, unless it was well.
_REQUIRED_ENDED = re.compile(_ESCAPE + rb"=+REQUIRED process \[(\S+)\] has died!")
_HOW = re.compile(rb"process has died \[pid \d+, (exit code -?\d+)")
_MIND_NODES = "Its output says why. Where a run is to fail at once, let the launch file end with the node: {}."
_MIND_REQUIRED = "Its output says why. The launch was about to end with it when the mission did."
#: By which a launch file ends with a node.
_ENDS_WITH = {1: 'required="true"', 2: "on_exit=Shutdown()"}


class _Nodes:
    """What a launch has told of its nodes so far: how often each was started and ended, and how it died at last.

    Those with which the launch ends are `required`; they die however they end.
    """

    def __init__(self, start: Start) -> None:
        self.starts: Counter[str] = Counter()
        self.ends: Counter[str] = Counter()
        self.deaths: dict[str, str] = {}
        self.required: list[str] = []
        for path in (start.stdout, start.stderr):  # the generations differ in which has what
            with suppress(OSError), path.open("rb") as lines:
                for line in lines:
                    self._take(line)

    def _take(self, line: bytes) -> None:
        if started := _STARTED.match(line):
            self.starts[(started[1] or started[2]).decode(errors="replace")] += 1
        elif required := _REQUIRED_ENDED.match(line):
            self.required.append(required[1].decode(errors="replace"))
            self.ends[self.required[-1]] += 1
            self.deaths[self.required[-1]] = "exit code 0"
        elif self.required and (how := _HOW.match(line)):
            self.deaths[self.required[-1]] = how[1].decode()
        elif ended := _ENDED.match(line):
            node = ended[1].decode(errors="replace")
            self.ends[node] += 1
            if ended[2]:
                self.deaths[node] = ended[2].decode()


class RosLaunch(RosSubject):
    """Launches a launch file with `roslaunch` or `ros2 launch`, and ends its nodes as Ctrl-C would.

    The logs of its nodes go to its folder of raw data, too, where the launch file is executed on this machine. Where
    a node dies and the others go on, all values of the run are doubtful.

    Args:
        package: the package that has the launch file, the path of the launch file itself, or a folder (a `Path`, or a
            treatment of `Factor.revisions`).
        file: the launch file's name in the package or folder.
        arguments: of the launch file, by name; `treatment(...)` may stand for any value, and `{namespace}` in one for
            the namespace of the run's robot: `alice` for `robot = "ros2://alice"`. Where the robot has none, a value
            that is nothing else leaves the argument out.
        **options: `ros` and `rmw`, as of every `RosSubject`, and those of every `Subject`.

    Raises:
        PluginError: it is not clear which ROS is meant, or a parameter cannot be.

    Example:
        >>> RosLaunch("nav", "nav.launch.py", arguments={"planner": "dwa", "rviz": False}, ros=2).words()
        ('ros2', 'launch', 'nav', 'nav.launch.py', 'planner:=dwa', 'rviz:=false')
    """

    def __init__(
        self,
        package: str | Path,
        file: str | Path | None = None,
        *,
        arguments: Mapping[str, Any] | None = None,
        **options: Any,
    ) -> None:
        super().__init__(**options)
        given = (package, file) if file is not None else (package,)
        words = [word(self.name, each) for each in given]
        self.launch_file = (os.path.join(*words),) if isinstance(package, os.PathLike) else tuple(words)  # noqa: PTH118
        self.arguments = {name: word(self.name, value) for name, value in (arguments or {}).items()}
        if not self._is_of_run and any(_NAMESPACE in value for value in self.arguments.values()):
            problem = f"the file is launched once for all runs, and {_NAMESPACE} is the namespace of the run's robot"
            fix = "Start it in each run (per='run'), or write the namespace out."
            raise PluginError(problem, where=self.name, fix=fix)
        self._namespace = ""
        self._ended_before: Counter[str] = Counter()
        named = [] if holds_revision(given) or len(self.launch_file) > 1 else [*self.launch_file]
        named += [self.arguments[name] for name, value in (arguments or {}).items() if not holds_revision(value)]
        self._files = tuple(named)
        self._named = (*given, *(arguments or {}).values())

    def words(self) -> tuple[str, ...]:
        """Return the command."""
        launch = ("roslaunch",) if self.ros == 1 else ("ros2", "launch")
        given = {name: value.replace(_NAMESPACE, self._namespace) for name, value in self.arguments.items()}
        # Both programs refuse `name:=` or take it for the name's default.
        told = (f"{name}:={value}" for name, value in given.items() if value or not self.arguments[name])
        return (*launch, *self.launch_file, *told)

    def dumping(self) -> tuple[str, ...]:
        """Return the command that writes the parameters which it sets at the master of ROS 1."""
        return ("roslaunch", "--dump-params", *self.words()[1:])

    def check(self, circumstances: Circumstances) -> Iterable[Finding]:
        """Yield the findings for this robot."""
        with suppress(LinkError):  # which is told of the robot itself
            robot = circumstances.robot
            self._namespace = "" if robot is None else resolved_robot(robot)[1].namespace.strip("/")
        yield from super().check(circumstances)

    def stop_run(self, context: RobotRunnerContext) -> None:
        """Say which of its nodes died, as the others went on, and end it with everything that it started."""
        if self._current is not None:
            nodes = _Nodes(self._current)
            for node, how in nodes.deaths.items():
                if nodes.ends[node] > self._ended_before[node] or nodes.ends[node] >= nodes.starts[node]:
                    problem = f"{node}, which it launched, has died: {how}"
                    fix = _MIND_REQUIRED if node in nodes.required else _MIND_NODES.format(_ENDS_WITH[self.ros])
                    context.broker.doubt_run(self.name, problem, fix)
        super().stop_run(context)

    def _start(self, context: RobotRunnerContext) -> None:
        super()._start(context)
        if not self._is_of_run and self._current is not None:
            self._ended_before = _Nodes(self._current).ends

    def prepare_start(self, context: ExperimentContext) -> None:
        """Take the namespace of the run's robot for its arguments."""
        self._namespace = robot_namespace(context).strip("/") if self._is_of_run else ""
        super().prepare_start(context)

    def files_read(self) -> Iterable[InputFile]:
        """Yield the launch file if it is given by its path, files that its arguments name, and files named in these."""
        paths = map(self.surroundings.own_path, filter(None, self._files))
        there = [path for path in paths if path is not None and is_file(kept_copy(path) or path)]
        return [with_what_it_names(path) for path in there if not is_installed(path)]

    def ros_findings(self, where: str) -> Iterable[Finding]:
        """Yield the errors of ROS itself about the package, the launch file, and its arguments."""
        ros, what = self.ros, "/".join(self.launch_file)
        asked = ("roslaunch", "--ros-args", *self.launch_file) if ros == 1 else (*self.words()[:2], "--show-args")
        described = self.surroundings.ask(asked if ros == 1 else (*asked, *self.launch_file))
        if described.code != 0:
            yield self.refused(where, what, described)
            return
        known = _ARGUMENTS[ros].findall(described.said)
        for name in (each for each in self.arguments if each not in known):
            fix = did_you_mean(name, known)
            if ros == 1 or nearest(name, known):
                yield Finding.error(where, f"the launch file takes no argument {name!r}: nothing would read it", fix)
            else:  # `ros2 launch` sees no further than paths that are written out, and hands on every argument
                problem = f"the launch file declares no argument {name!r}: only what it includes may read it"
                yield Finding.warning(where, problem, fix)
        if ros == 1:  # which evaluates the file, with what it includes
            answer = self.surroundings.ask(("roslaunch", "--nodes", *self.words()[1:]))
            if answer.code != 0:
                yield self.refused(where, what, answer)
