"""The subject that is a launch file of ROS 1 or ROS 2."""

from __future__ import annotations

import os
import re
import signal
from typing import TYPE_CHECKING, Any, ClassVar

from robot_runner.core.errors import Finding, PluginError, did_you_mean
from robot_runner.core.words import one_line
from robot_runner.subjects.subject import Subject
from robot_runner.subjects.surroundings import is_known, word

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping
    from pathlib import Path

    from robot_runner.subjects.supervised_program import Start
    from robot_runner.subjects.surroundings import Answer

__all__ = ["RosLaunch"]

_PROGRAMS = {1: "roslaunch", 2: "ros2"}
#: roslaunch gives its nodes 15 s after SIGINT and 2 s after SIGTERM; launch of ROS 2 gives them 5 s and 5 s.
_GRACE = 20.0
#: How both tell of an argument that a launch file takes: `  speed: ...` (ROS 1), and `    'speed':` (ROS 2).
_ARGUMENTS = {1: re.compile(r"^  (\w+)(?: \(.*\))?:", re.MULTILINE), 2: re.compile(r"^\s+'([^']+)':", re.MULTILINE)}
_REQUIRED = re.compile(r"requires the '(\w+)' arg")
_ESCAPES = re.compile(r"\x1b\[[0-9;]*m")
_CHATTER = "The traceback for the exception"


class RosLaunch(Subject):
    """Launches a launch file with `roslaunch` or `ros2 launch`, and ends its nodes as Ctrl-C would.

    The logs of its nodes go to its folder of raw data, too, where the launch file is executed on this machine.

    Args:
        package: the package that has the launch file, the path of the launch file itself, or a folder (a `Path`, or a
            treatment of `Factor.revisions`).
        file: the launch file's name in the package or folder.
        arguments: of the launch file, by name; `treatment(...)` may stand for any value.
        ros: 1 or 2; left out, the ROS that is sourced, or whose program is there.
        stop_signal: what it takes for "end".
        grace_s: how long it may take for that before it is killed with all that it started, s.
        **options: as of every `Subject`; `setup` names the setup file of a workspace.

    Raises:
        PluginError: it is not clear which ROS is meant, or a parameter cannot be.

    Example:
        >>> RosLaunch("nav", "nav.launch.py", arguments={"planner": "dwa", "rviz": False}, ros=2).words()
        ('ros2', 'launch', 'nav', 'nav.launch.py', 'planner:=dwa', 'rviz:=false')
    """

    needs: ClassVar[str] = "ROS where it is launched; on another computer Python 3.6 and a key for ssh."

    def __init__(
        self,
        package: str | Path,
        file: str | Path | None = None,
        *,
        arguments: Mapping[str, Any] | None = None,
        ros: int | None = None,
        stop_signal: signal.Signals = signal.SIGINT,
        grace_s: float = _GRACE,
        **options: Any,
    ) -> None:
        super().__init__(stop_signal=stop_signal, grace_s=grace_s, **options)
        if ros not in {None, 1, 2}:
            raise PluginError(f"ros is {ros!r}", where=self.name, fix="Say 1 for ROS 1, 2 for ROS 2, or leave it out.")
        if ros is None and (self.surroundings.host is not None or self.surroundings.setup is not None):
            fix = "Say ros=1 or ros=2."
            raise PluginError("which ROS it is launched with depends on the setup there", where=self.name, fix=fix)
        given = (package, file) if file is not None else (package,)
        words = [word(self.name, each) for each in given]
        self.launch_file = (os.path.join(*words),) if isinstance(package, os.PathLike) else tuple(words)  # noqa: PTH118
        self.arguments = {name: word(self.name, value) for name, value in (arguments or {}).items()}
        self._is_known = all(map(is_known, (*given, *(arguments or {}).values())))
        self._ros = ros

    @property
    def ros(self) -> int:
        """The generation of ROS."""
        if self._ros is not None:
            return self._ros
        sourced = self.surroundings.local_environment.get("ROS_VERSION", "")
        if sourced in {"1", "2"}:
            return int(sourced)
        return next((ros for ros, program in _PROGRAMS.items() if not self.surroundings.lacks(program)), 2)

    def words(self) -> tuple[str, ...]:
        """Return the command."""
        launch = ("roslaunch",) if self.ros == 1 else ("ros2", "launch")
        return (*launch, *self.launch_file, *(f"{name}:={value}" for name, value in self.arguments.items()))

    def variables(self, start: Start) -> Mapping[str, str]:
        """Have the nodes write their logs beside its output."""
        here = self.surroundings.host is None and "ROS_LOG_DIR" not in self.surroundings.environment
        return {"ROS_LOG_DIR": str(start.folder.absolute() / "ros_log")} if here else {}

    def program_findings(self, where: str) -> Iterable[Finding]:
        """Yield what ROS itself finds wrong with the package, the launch file, and its arguments."""
        program, ros = _PROGRAMS[self.ros], self.ros
        if not self._is_known:
            return
        if self.surroundings.lacks(program):
            on = f" on {self.surroundings.host}" if self.surroundings.host else ""
            fix = "Source the setup file of ROS before, or name it: setup='/opt/ros/.../setup.bash'."
            yield Finding.error(where, f"the program {program!r} is not there{on}", fix)
            return
        asked = ("roslaunch", "--ros-args", *self.launch_file) if ros == 1 else (*self.words()[:2], "--show-args")
        described = self.surroundings.ask(asked if ros == 1 else (*asked, *self.launch_file))
        if described.code != 0:
            yield self._refused(where, described)
            return
        yield from self._unknown(where, _ARGUMENTS[ros].findall(described.said))
        if ros == 1:  # which evaluates the file, with what it includes
            answer = self.surroundings.ask(("roslaunch", "--nodes", *self.words()[1:]))
            if answer.code != 0:
                yield self._refused(where, answer)

    def _unknown(self, where: str, known: list[str]) -> Iterator[Finding]:
        """Yield arguments that the launch file does not take: nothing would read them."""
        for name in self.arguments:
            if name not in known:
                problem = f"the launch file takes no argument {name!r}: nothing would read it"
                yield Finding.error(where, problem, did_you_mean(name, known))

    def _refused(self, where: str, answer: Answer) -> Finding:
        text = _ESCAPES.sub("", answer.complaint or answer.said)
        lines = [line.strip() for line in text.splitlines() if line.strip() and not line.startswith(_CHATTER)]
        said = one_line(lines[-1]) if lines else f"exit code {answer.code}"
        required = _REQUIRED.search(said)
        by_hand = "Try it by hand: " + " ".join(self.words())
        fix = f"Give it: arguments={{{required[1]!r}: ...}}." if required else by_hand
        return Finding.error(where, f"{_PROGRAMS[self.ros]} refuses {'/'.join(self.launch_file)}: {said}", fix)
