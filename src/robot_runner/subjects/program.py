"""The subject that is any program."""

from __future__ import annotations

import shlex
import time
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from robot_runner.core.errors import Finding, PluginError
from robot_runner.core.events.context import RobotRunnerContext, SystemClock
from robot_runner.core.events.measure import Measure, Origin
from robot_runner.core.storage.input_files import InputFile
from robot_runner.measuring.own_scripts import script_inputs, scripts_in, unread_findings
from robot_runner.measuring.parameter_checks import checked_codes
from robot_runner.subjects.subject import Subject
from robot_runner.subjects.supervised_program import Ended
from robot_runner.subjects.surroundings import holds_revision, is_known, word

_LOOK = 0.02
_CPU_TIME = (Measure("CPUTime", "s", "CPU time of the program and of the children that it awaited, by the kernel."),)
#: CPU time of processes that it did not await that is not doubted, s: less than a tick of the kernel's.
_ASTRAY = 0.01
#: The share of a program's time before the mission, in all of its time, above which that is doubted.
_UNMEASURED = 0.01


class Program(Subject):
    """Starts a program, waits until it can be used, and ends it with everything that it has started.

    Its output is written to `stdout.txt` and `stderr.txt` in its folder of raw data. If it dies before it is stopped,
    the run fails at once.

    Args:
        command: the program and its arguments, in a list; `treatment(...)` may stand for any of them, and a list for
            one word of several parts: `["--speed=", treatment("Speed")]`.
        exit_codes: exit codes with which it may end by itself, such as `[0]` for one that computes something and is
            done; empty for one that is to go on until it is stopped.
        **options: as of every `Subject`: `name`, `per`, `folder`, `environment`, `setup`, `host`, `ssh_config`,
            `ready`, `ready_timeout_s`, `stop_signal`, `grace_s`.

    Raises:
        PluginError: the command or a parameter is invalid.

    Example:
        >>> Program(["planner", "--port", 8080], name="Planner", ready="listening").words()
        ('planner', '--port', '8080')
    """

    def __init__(self, command: Any, *, exit_codes: Sequence[int] = (), **options: Any) -> None:
        super().__init__(**options)
        if not isinstance(command, list | tuple) or not command:
            words = command.split() if command and isinstance(command, str) else ["planner", "--verbose"]
            fix = f"Give a list of words: {words!r}; or have a shell read it: ['sh', '-c', '...']."
            raise PluginError(f"command is {command!r}", where=self.name, fix=fix)
        self.command = tuple(command)
        self.exit_codes = checked_codes(self.name, exit_codes)
        self._awaited_since: float | None = None
        self.words()  # finds invalid words before anything is executed
        if self.exit_codes and self._is_of_run:
            ended = Measure("ExitCode", "1", f"With what {self.name} ended by itself; none where it was stopped.")
            self.measures = (*self.measures, ended, *(_CPU_TIME if self.per == "mission" else ()))

    def words(self) -> tuple[str, ...]:
        """Return the command."""
        return tuple(word(self.name, each) for each in self.command)

    def program_findings(self, where: str) -> Iterable[Finding]:
        """Yield that the program is missing, or cannot be read."""
        program = self.words()[0]
        if is_known(self.command[0]) and self.surroundings.lacks(program):
            file = Path(self.surroundings.path or ".") / self.surroundings.found(program)
            if self.surroundings.host is None and "/" in program and file.is_file():
                fix = f"Make it so: {shlex.join(['chmod', '+x', str(file)])}"
                yield Finding.error(where, f"the program {program!r} is not executable", fix)
                return
            fix = "Install it, or give its full path."
            yield Finding.error(where, f"the program {program!r} is not there{self.surroundings.on}", fix)
        else:
            yield from unread_findings(where, self._scripts())

    def files_read(self) -> Iterable[InputFile]:
        """Yield the program, if it is one of the user's own, and a script that an interpreter executes."""
        return script_inputs(self._scripts())

    def _scripts(self) -> Iterator[Path]:
        if not holds_revision(self.command):
            paths = map(self.surroundings.own_path, scripts_in(self.words()))
            yield from (path for path in paths if path is not None)

    def may_end(self, ended: Ended) -> bool:
        """Whether it may end with this exit code by itself."""
        return ended.code in self.exit_codes

    def wait(self, context: RobotRunnerContext, *, timeout_s: float) -> int:
        """Wait until the program has ended by itself, in a mission that lasts as long as it, and return its exit code.

        Args:
            context: of the run.
            timeout_s: how long to wait at most, s of real time.

        What it did before the mission began was not measured, which makes values of the run doubtful; with
        `per="mission"` it is started in the mission.

        Raises:
            PluginError: it has not ended in time, was not started, or ended with an exit code other than `exit_codes`.
        """
        program = self._program
        deadline = time.monotonic() + timeout_s
        while program is not None and (ended := program.ended()) is None and time.monotonic() < deadline:
            time.sleep(_LOOK)
        if program is None:
            raise PluginError("it goes on through all runs, or was not started", where=self.name, fix="Say per='run'.")
        if ended is None:
            problem = f"{self.name} has not ended within {timeout_s:g} s"
            said = f"; it wrote last: {lines}" if (lines := program.last_lines()) else ""
            raise PluginError(problem + said, where=context.owner, fix="Allow it more time (timeout_s).")
        if ended.code is None or not self.may_end(ended):
            fix = "Look at its output, or list the exit code among exit_codes."
            raise PluginError(program.death(self.name, ended), where=context.owner, fix=fix)
        self._awaited_since = program.begun_at
        return ended.code

    def stop_run(self, context: RobotRunnerContext) -> None:
        """End the run's own program with everything that it started; doubt values that lack its beginning."""
        window, begun = context.times.window(SystemClock()), self._awaited_since
        self._awaited_since = None
        if window is not None and begun is not None:
            missed, whole = window.start - begun, window.end - begun
            if missed > _UNMEASURED * whole:
                problem = f"{self.name} had been executed for {missed:.3g} s of {whole:.3g} s when the mission began"
                fix = f"Have the mission start {self.name}, so that all of it is measured: per='mission'."
                context.broker.doubt_run(self.name, problem, fix)
        super().stop_run(context)

    def populate_run_data(self, context: RobotRunnerContext) -> None:
        """Publish how long it took to be ready, and its exit code."""
        super().populate_run_data(context)
        if self.exit_codes and self._is_of_run:
            ended = self._ended
            code = ended.code if ended is not None and not ended.was_asked else None
            context.publish("ExitCode", code, origin=Origin.MEASURED)
            if self.per == "mission":
                context.publish("CPUTime", None if code is None or ended is None else ended.cpu, origin=Origin.MEASURED)
                if ended is not None and ended.cpu is not None:
                    self._doubt_what_went_astray(context, ended.cpu, ended)

    def _doubt_what_went_astray(self, context: RobotRunnerContext, used: float, ended: Ended) -> None:
        fix = f"Measure all of them: PsUtil(host='localhost', processes=['subject:{self.name}'])."
        if ended.astray > max(_ASTRAY, _UNMEASURED * (used + ended.astray)):
            astray = f"{ended.astray:.3g} s of CPU time"
            problem = f"processes that {self.name} started and did not await used {astray}, which CPUTime lacks"
            context.doubt(problem, fix=fix, measures=["CPUTime"])
        if ended.uncounted:
            whose = "the kernel counts no CPU time of its children, which CPUTime lacks"
            context.doubt(f"{self.name} ignores SIGCHLD, so that {whose}", fix=fix, measures=["CPUTime"])
