"""The base of launch files and nodes of ROS as subjects: which ROS, its middleware, its logs, its workspace."""

from __future__ import annotations

import json
import re
import signal
from abc import abstractmethod
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robot_runner.core.errors import Finding, PluginError, did_you_mean
from robot_runner.core.events.context import RobotRunnerContext
from robot_runner.core.links.connect import graph_variables, robot_namespace
from robot_runner.core.words import one_line
from robot_runner.subjects.subject import Subject
from robot_runner.subjects.supervised_program import Start
from robot_runner.subjects.surroundings import Answer, is_known, word

if TYPE_CHECKING:
    from robot_runner.core.events.context import ExperimentContext

#: The program that starts the software of each generation.
PROGRAMS = {1: "roslaunch", 2: "ros2"}
#: roslaunch gives its nodes 15 s after SIGINT and 2 s after SIGTERM; launch of ROS 2 gives them 5 s and 5 s.
_GRACE = 20.0
_RMW = "RMW_IMPLEMENTATION"
#: The implementations that REP 2000 lists.
_KNOWN_RMW = (
    "rmw_fastrtps_cpp",
    "rmw_fastrtps_dynamic_cpp",
    "rmw_cyclonedds_cpp",
    "rmw_connextdds",
    "rmw_zenoh_cpp",
    "rmw_gurumdds_cpp",
)
#: What roslaunch says of an argument that a launch file demands.
_REQUIRED = re.compile(r"requires the '(\w+)' arg")
_ESCAPES = re.compile(r"\x1b\[[0-9;]*m")
_CHATTER = "The traceback for the exception"


def _script(name: str) -> tuple[str, ...]:
    return ("python3", "-I", "-S", "-c", Path(__file__).with_name(name).read_text(encoding="utf-8"))


#: Executed where the subject is: the first has the workspace which is sourced there described.
_DESCRIBE, _PUT_BACK = _script("workspace_packages.py"), _script("launched_parameters.py")


class RosSubject(Subject):
    """Software of ROS under test: its nodes are ended as Ctrl-C would.

    The logs of its nodes go to its folder of raw data, too, where it is executed on this machine. The journal keeps
    versions and git commits of the packages in the workspaces that are sourced. What it sets of the parameters at a
    master of ROS 1 is put back once it has ended; where the run was killed, before it is started again.

    Args:
        ros: 1 or 2; left out, the ROS that is sourced, or whose program is there.
        rmw: the middleware of its nodes, such as `rmw_cyclonedds_cpp` (ROS 2); `treatment(...)` may stand for it.
        stop_signal: what it takes for "end".
        grace_s: how long it may take for that before it is killed with all that it started, s.
        **options: as of every `Subject`; `setup` names the setup file of a workspace.

    Raises:
        PluginError: it is not clear which ROS is meant, or a parameter cannot be.
    """

    #: What it names that may lie in the work tree of a revision.
    _named: tuple[Any, ...] = ()
    needs = "ROS where it is started; on another computer Python 3.6 and a key for ssh."

    def __init__(
        self,
        *,
        ros: int | None = None,
        rmw: str | None = None,
        stop_signal: signal.Signals = signal.SIGINT,
        grace_s: float = _GRACE,
        **options: Any,
    ) -> None:
        if rmw is not None:
            options["environment"] = {**(options.get("environment") or {}), _RMW: rmw}
        super().__init__(stop_signal=stop_signal, grace_s=grace_s, **options)
        if ros not in {None, 1, 2}:
            raise PluginError(f"ros is {ros!r}", where=self.name, fix="Say 1 for ROS 1, 2 for ROS 2, or leave it out.")
        if ros is None and (self.surroundings.host is not None or self.surroundings.setup is not None):
            fix = "Say ros=1 or ros=2."
            raise PluginError("which ROS it is started with depends on the setup there", where=self.name, fix=fix)
        if ros == 1 and rmw is not None:
            fix = "Leave rmw out: nodes of ROS 1 have no middleware to choose."
            raise PluginError(f"rmw is {rmw!r}, and ros is 1", where=self.name, fix=fix)
        self.rmw = None if rmw is None else word(self.name, rmw)
        self._ros = ros
        self._putting_back: tuple[str, ...] = ()

    @property
    def ros(self) -> int:
        """The generation of ROS."""
        if self._ros is not None:
            return self._ros
        sourced = self.surroundings.local_environment.get("ROS_VERSION", "")
        if sourced in {"1", "2"}:
            return int(sourced)
        return next((ros for ros, program in PROGRAMS.items() if not self.surroundings.lacks(program)), 2)

    def variables(self, folder: Path) -> Mapping[str, str]:
        """Have the nodes write their logs beside its output."""
        here = self.surroundings.host is None and "ROS_LOG_DIR" not in self.surroundings.environment
        return {"ROS_LOG_DIR": str(folder.absolute() / "ros_log")} if here else {}

    def program_findings(self, where: str) -> Iterable[Finding]:
        """Yield that the programs of ROS are not there, that the middleware is none, and what ROS itself finds wrong.

        A revision that is not built yet is not looked at.
        """
        program = PROGRAMS[self.ros]
        if not all(map(is_known, self._named)):
            return
        if self.surroundings.lacks(program):
            fix = "Source the setup file of ROS before, or name it: setup='/opt/ros/.../setup.bash'."
            yield Finding.error(where, f"the program {program!r} is not there{self.surroundings.on}", fix)
            return
        if self.rmw is not None:
            yield from self._rmw_findings(where, self.rmw)
        yield from self.ros_findings(where)

    @abstractmethod
    def dumping(self) -> tuple[str, ...]:
        """Return the command that writes the parameters which it sets at the master of ROS 1."""

    @abstractmethod
    def ros_findings(self, where: str) -> Iterable[Finding]:
        """Yield the errors of ROS itself about the software that is to be started."""

    def refused(self, where: str, what: str, answer: Answer) -> Finding:
        """Return the finding that a program of ROS refuses something, with the last line that it wrote."""
        said = last_line(answer)
        lacking = _REQUIRED.search(said)
        by_hand = "Try it by hand: " + " ".join(self.words())
        fix = f"Give it: arguments={{{lacking[1]!r}: ...}}." if lacking else by_hand
        return Finding.error(where, f"{PROGRAMS[self.ros]} refuses {what}: {said}", fix)

    def _rmw_findings(self, where: str, rmw: str) -> Iterable[Finding]:
        if self.ros == 1:
            problem = f"rmw is {rmw!r}, and this is ROS 1, whose nodes have no middleware to choose"
            yield Finding.error(where, problem, "Leave rmw out.")
        elif self.surroundings.ask(("ros2", "pkg", "prefix", rmw)).code != 0:
            fix = did_you_mean(rmw, _KNOWN_RMW) if rmw not in _KNOWN_RMW else ""
            package = f"ros-<distribution>-{rmw.replace('_', '-')}"
            yield Finding.error(where, f"the middleware {rmw!r} is not installed", fix or f"Install it: {package}.")

    def prepare_start(self, context: ExperimentContext) -> None:
        """Keep the parameters at a master of ROS 1 that it is about to set."""
        if self.ros == 1:
            of_graph = graph_variables(context.robot, is_here=self.surroundings.host is None)
            told = [f"{name}={value}" for name, value in of_graph.items() if name not in self.surroundings.environment]
            namespace = robot_namespace(context) if self._is_of_run else ""
            key = f"{self._lock(context).stem}{namespace.replace('/', '_')}"
            self._putting_back = ("env", *told, *_PUT_BACK, key)
            answer = self.surroundings.ask((*self._putting_back, *self.dumping()))
            if answer.code != 0 and isinstance(context, RobotRunnerContext):
                problem = f"which parameters it leaves at the master is not known: {last_line(answer)}"
                context.warn(problem, fix="See that python3 and roslaunch are there, with the workspace sourced.")

    def _end(self) -> None:
        was_begun = self._program is not None
        super()._end()
        if was_begun and self._putting_back:  # where that fails, the next start does it
            self.surroundings.ask(self._putting_back)

    def _facts(self, context: RobotRunnerContext, start: Start) -> dict[str, Any]:
        """Return what the journal keeps of it, with the packages of the workspaces that are sourced."""
        facts = super()._facts(context, start)
        answer = self.surroundings.ask(_DESCRIBE)
        try:
            packages = json.loads(answer.said.splitlines()[-1]) if answer.code == 0 else None
        except (ValueError, IndexError):  # before it stands what a login shell or a setup file writes
            packages = None
        if not isinstance(packages, dict):
            problem = f"the packages of its workspace are not known: {last_line(answer)}"
            context.warn(problem, fix="See that python3 is there, with the workspace sourced.")
            return facts
        return {**facts, "ros": self.ros, **({"packages": packages} if packages else {})}


def last_line(answer: Answer) -> str:
    """Return the last line that a program wrote, without colours; its exit code where it wrote nothing."""
    text = _ESCAPES.sub("", answer.complaint or answer.said)
    lines = [line.strip() for line in text.splitlines() if line.strip() and not line.startswith(_CHATTER)]
    return one_line(lines[-1]) if lines else f"exit code {answer.code}"
