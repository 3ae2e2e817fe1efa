"""What all subjects share: when they are started, when they are ready, what happens when they die, how they end."""

from __future__ import annotations

import hashlib
import os
import signal
import threading
import time
from abc import abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from robot_runner.core.errors import Finding, PluginError, did_you_mean
from robot_runner.core.events.condition import Condition
from robot_runner.core.events.context import ExperimentContext, RobotRunnerContext
from robot_runner.core.events.measure import Measure, Origin
from robot_runner.core.links.connect import graph_variables, is_simulated
from robot_runner.core.links.declared_host import LOCAL
from robot_runner.core.plugin import Circumstances, System
from robot_runner.core.storage.input_files import InputFile
from robot_runner.core.storage.layout import ExperimentFolder, user_folder
from robot_runner.core.treatments import factors_of
from robot_runner.measuring.host import SUBJECT_VARIABLE
from robot_runner.measuring.measured_machine import machine_clock
from robot_runner.measuring.parameter_checks import named_signal
from robot_runner.subjects import supervised_program
from robot_runner.subjects.commanded_robot import CommandedRobot
from robot_runner.subjects.halting import CommandedTopics, Halting
from robot_runner.subjects.left_subjects import check_within_reach
from robot_runner.subjects.read_files import inputs_in, is_own_setup, missing_findings
from robot_runner.subjects.readiness import Ready, checked_ready
from robot_runner.subjects.surroundings import Surroundings, is_known, started_once_findings, word

if TYPE_CHECKING:
    import re


_SPANS = ("run", "mission", "experiment")
#: How often to look whether it has died, s.
_LOOK = 0.1
#: How often to look whether it commands the robot, s: mostly it does from the beginning.
_ROBOT_LOOK = 2.0


class Subject(System):
    """Software under test, which is started and stopped by Robot Runner, here or on another computer.

    Args:
        name: distinguishes several instances; None for the class's name.
        per: `run` to start it in each run, before anything is measured; `mission` to start it when the mission begins,
            so that all that it does is measured; `experiment` to start it once, before the first run.
        folder: where it is executed; a treatment of `Factor.revisions` stands for its work tree.
        reads: further files and folders that it reads, so that a package has them; relative to its folder.
        environment: variables besides those of Robot Runner, or of the user on another computer; None removes one.
        setup: a file to source first, such as the setup file of a ROS workspace.
        host: another computer, in one of ssh's forms (`pi@robot`); None for this machine.
        ssh_config: a file to use instead of your ssh config.
        ready: when it can be used: a condition, or a text (or a pattern) in a line of its output; None for at once.
        ready_timeout_s: how long it may take until then, s of real time.
        stop_signal: the signal at which it ends.
        grace_s: how long it may take for that before it is killed with all that it started, s.

    Raises:
        PluginError: a parameter is invalid.
    """

    measures: Sequence[Measure] = (Measure("StartupTime", "s", "From its start until it was ready, in real time."),)
    needs: ClassVar[str] = "The program; on another computer Python 3.6 and a key for ssh."
    bytes_per_run: int = 100_000
    starts_nodes: bool = True

    def __init__(  # noqa: PLR0913 - keywords of a user's config
        self,
        *,
        name: str | None = None,
        per: str = "run",
        folder: Any = None,
        reads: Sequence[str | Path] = (),
        environment: Mapping[str, Any] | None = None,
        setup: str | Path | None = None,
        host: str | None = None,
        ssh_config: str | Path | None = None,
        ready: Condition | str | re.Pattern[str] | None = None,
        ready_timeout_s: float = 60.0,
        stop_signal: signal.Signals = signal.SIGTERM,
        grace_s: float = 10.0,
    ) -> None:
        super().__init__(name=name)
        if per not in _SPANS:
            raise PluginError(f"per is {per!r}", where=self.name, fix=did_you_mean(str(per), _SPANS))
        for parameter, value in (("ready_timeout_s", ready_timeout_s), ("grace_s", grace_s)):
            if not isinstance(value, int | float) or not value > 0:
                fix = f"Give {parameter} a number of seconds above 0."
                raise PluginError(f"{parameter} is {value!r}", where=self.name, fix=fix)
        self.per = per
        self.surroundings = Surroundings.of(
            self.name, folder=folder, environment=environment or {}, setup=setup, host=host, ssh_config=ssh_config
        )
        if isinstance(reads, str | os.PathLike):
            raise PluginError(f"reads is {reads!r}", where=self.name, fix=f"Give a list: [{str(reads)!r}].")
        self.reads = tuple(word(self.name, each) for each in reads)
        self.ready = checked_ready(self.name, ready)
        self.ready_timeout_s = ready_timeout_s
        self.stop_signal = named_signal(self.name, stop_signal)
        self.grace_s = grace_s
        self.is_for_all_runs = not self._is_of_run
        self.measures = type(self).measures if self._is_of_run else ()
        self._program: supervised_program.SupervisedProgram | None = None
        self._current: supervised_program.Start | None = None
        self._startup_time: float | None = None
        self._ended: supervised_program.Ended | None = None
        self._watch: threading.Thread | None = None
        self._robot: CommandedRobot | None = None
        self._halting: Halting | None = None
        self._is_ending = threading.Event()

    @property
    def _is_of_run(self) -> bool:
        return self.per != "experiment"

    # What subclasses override.

    @abstractmethod
    def words(self) -> Sequence[str]:
        """Return the command that is executed; called at each start."""

    def last_words(self) -> tuple[str, ...] | None:
        """Return a command to execute once everything has ended; None where there is none."""
        return None

    @property
    def stops_group(self) -> bool:
        """Whether its whole process group gets the stop signal, as by Ctrl-C, instead of the program alone."""
        return False

    def variables(self, folder: Path) -> Mapping[str, str]:
        """Return variables of its environment beside those that the user names; the folder takes its output."""
        del folder
        return {}

    def prepare_start(self, context: ExperimentContext) -> None:
        """Do what comes before each start; called before `words`."""

    @abstractmethod
    def program_findings(self, where: str) -> Iterable[Finding]:
        """Yield what prevents the execution of the command; called where its surroundings have no findings."""

    def files_read(self) -> Iterable[InputFile]:
        """Yield files that it is known to read, with paths that are valid here (`surroundings.own_path`)."""
        return ()

    def may_end(self, ended: supervised_program.Ended) -> bool:
        """Whether it may end in this way by itself, before it is stopped."""
        del ended
        return False

    # Its life.

    def input_files(self) -> Iterable[InputFile]:
        """Yield the files that it reads: those that are known, and those that `reads` names."""
        around = self.surroundings
        setup = [around.setup] if around.setup is not None and is_own_setup(Path(around.setup)) else []
        named = map(around.own_path, (*self.reads, *setup))
        inputs = [*self.files_read(), *(InputFile(path) for path in named if path is not None)]
        return inputs_in(around.own_folder, inputs)

    def check(self, circumstances: Circumstances) -> Iterable[Finding]:
        """Yield what prevents its start, such as a missing program or a host that cannot be reached."""
        where = f"plugin {self.name}"
        if not self._is_of_run:
            yield from started_once_findings(where, factors_of(self).values(), circumstances.robots)
        if isinstance(self.ready, Condition):
            yield from self.ready.check(circumstances.robot)
        yield from (findings := list(self.surroundings.findings(where)))
        if not any(finding.is_error for finding in findings) and is_known(self.surroundings.folder):
            yield from self.program_findings(where)
            yield from missing_findings(where, map(self.surroundings.own_path, self.reads))

    def before_experiment(self, context: ExperimentContext) -> None:
        """Start it, if it goes on through all runs; raise a `PluginError` if it cannot be started."""
        if self.per == "experiment":
            self._begin_for_all_runs(context)

    def before_run(self, context: RobotRunnerContext) -> None:
        """Start it again, if it should go on through all runs and has died since.

        Raises:
            PluginError: it cannot be started, or the robot that it had commanded cannot be stopped.
        """
        if self.per != "experiment" or self._program is None or (ended := self._program.ended()) is None:
            return
        context.warn(f"{self._program.death(self.name, ended)}; it is started again before this run")
        self._program.stop()
        halting, self._halting = self._halting, None
        if halting is not None:
            halting.finish()
        self._begin_for_all_runs(context)

    def start_run(self, context: RobotRunnerContext) -> None:
        """Start it, wait until it is ready, and watch over it from then on, unless it is started with the mission.

        Raises:
            PluginError: it cannot be started, or has died.
            ConditionError: it was not ready in time.
        """
        self._current = self._startup_time = self._ended = None
        self._robot = CommandedRobot(context)
        self._robot.connect()
        if self.per != "mission":
            self._start(context)
        self._robot.connect()  # again, as the software may have started the robot's graph
        self._robot.look()

    def start_measurement(self) -> None:
        """Check whether it commands the robot already."""
        if self._robot is not None:
            self._robot.look()

    def launch_mission(self, context: RobotRunnerContext) -> None:
        """Start it, wait until it is ready, and watch over it from then on, if it is started with the mission.

        Raises:
            PluginError: it cannot be started, or has died.
            ConditionError: it was not ready in time.
        """
        if self.per == "mission":
            self._start(context)

    def _start(self, context: RobotRunnerContext) -> None:
        robot = self._robot = self._robot or CommandedRobot(context)
        try:
            # If the run is killed, its supervisor has time to clean up.
            begun = context.outlives if self.last_words() is not None else lambda _: None
            start: supervised_program.Start = (
                self._begin(context, context.raw_data_folder, begun) if self._is_of_run else self._attached(context)
            )
            if context.robot is not None:
                robot.tell = partial(CommandedTopics(start).add, context.robot)
            with robot.looked_at():
                ready = Ready(self.name, start, self.ready, may_end=self.may_end)
                # In real time, as it does not use a simulation's clock.
                ready.wait(replace(context, clock=machine_clock(context)), timeout_s=self.ready_timeout_s)
        except BaseException:
            robot.look_at_last()
            self._end()
            raise
        self._current = start
        self._startup_time = time.monotonic() - start.begun_at
        context.share(pid=start.pid, host=self.surroundings.host or LOCAL)
        context.broker.note(self.name, "subject", self._facts(context, start))
        self._is_ending = threading.Event()
        self._watch = threading.Thread(
            target=self._watch_over, args=(context, start, self._is_ending), name=f"watch over {self.name}", daemon=True
        )
        self._watch.start()

    def stop_run(self, context: RobotRunnerContext) -> None:
        """End it with everything that it started, if it is the run's own, and stop the robot."""
        if self._robot is not None:
            self._robot.look_at_last()
        self._is_ending.set()
        if self._watch is not None and self._watch.is_alive():  # the run may have been ended as it was to be started
            self._watch.join()
        program = self._program
        if not self._is_of_run or program is None:
            return
        self._end()
        if self._ended is not None:
            facts = {"ended": self._ended.how, "exit_code": self._ended.code, "was_asked": self._ended.was_asked}
            context.broker.note(self.name, "subject", facts)
            if self._ended.was_killed:
                problem = f"{self.name} did not end within {self.grace_s:g} s of {self.stop_signal.name} and was killed"
                context.warn(problem, fix="Allow it more time (grace_s), or give the stop_signal that it obeys.")
        for remark in program.remarks(may_drive=self._robot is not None and self._robot.was_commanded):
            context.warn(f"{self.name} {remark}", fix="Look at the computer that it was executed on, and at the robot.")

    def make_safe(self, context: RobotRunnerContext) -> None:
        """End it, whatever has failed before; raise a `PluginError` where it may drive the robot from out of reach."""
        self._is_ending.set()
        if self._is_of_run:
            self._end()
            if self._robot is None:  # not in the process of the run, which was killed
                check_within_reach(self.name, supervised_program.Start(context.raw_data_folder), self.surroundings)

    def after_experiment(self) -> None:
        """End it with everything that it started, if it went on through all runs, and stop the robot.

        Raises:
            PluginError: the robot that it commanded cannot be stopped.
        """
        halting, self._halting = self._halting, None
        if halting is not None:
            halting.prepare()
        self._end()
        if halting is not None:
            halting.finish()

    def populate_run_data(self, context: RobotRunnerContext) -> None:
        """Publish how long it took to be ready."""
        if self._is_of_run:
            context.publish("StartupTime", self._startup_time, origin=Origin.MEASURED)  # a program of this machine

    def _begin_for_all_runs(self, context: ExperimentContext) -> None:
        folder = self._shared_folder(context)
        last = supervised_program.last_start(folder)
        start = self._begin(context, folder / str(1 if last is None else int(last.folder.name) + 1))
        if context.robot is not None and not is_simulated(context.robot):
            self._halting = Halting(start, self.name)

    def _begin(
        self, context: ExperimentContext, folder: Path, begun: Callable[[int], object] = lambda _: None
    ) -> supervised_program.SupervisedProgram:
        self.prepare_start(context)
        around = self.surroundings
        task = supervised_program.Task(
            command=around.wrapped(self.words()),
            # Programs of ROS find their graph by these: with several robots, each may be on a graph of its own.
            environment={
                **graph_variables(context.robot, is_here=around.host is None),
                **self.variables(folder),
                **around.variables,
                SUBJECT_VARIABLE: self.name,
            },
            folder=around.path,
            stop_signal=self.stop_signal,
            stops_group=self.stops_group,
            grace_s=self.grace_s,
            last=around.wrapped(last) if (last := self.last_words()) else None,
            host=around.host,
            ssh_config=around.ssh_config,
            lock=self._lock(context),
        )

        def know(program: supervised_program.SupervisedProgram, supervisor: int) -> None:
            self._program = program  # before it starts anything: it is ended wherever this is interrupted
            begun(supervisor)

        return supervised_program.SupervisedProgram(folder, task, name=self.name, begun=know)

    def _lock(self, context: ExperimentContext) -> Path:
        """Return the file that is locked from each start of this subject until all of it has ended."""
        told = os.fsencode(f"{context.experiment_folder.absolute()}\0{self.name}")
        key = hashlib.sha256(told).hexdigest()[:16]
        return user_folder("XDG_CACHE_HOME") / "subjects" / f"{key}.lock"

    def _attached(self, context: RobotRunnerContext) -> supervised_program.Start:
        """Return the start of a subject for all runs, which another process has started."""
        start = supervised_program.last_start(self._shared_folder(context))
        if start is None:
            raise PluginError("the subject was not started", where=self.name, fix="Start the experiment again.")
        return start

    def _shared_folder(self, context: ExperimentContext) -> Path:
        return ExperimentFolder(context.experiment_folder).subjects / self.name

    def _watch_over(
        self, context: RobotRunnerContext, start: supervised_program.Start, is_ending: threading.Event
    ) -> None:
        """Fail the run as soon as the subject has died, and look meanwhile whether it commands the robot."""
        robot = self._robot or CommandedRobot(context)
        with robot.looked_at(_ROBOT_LOOK):
            while not is_ending.wait(_LOOK):
                if (ended := start.ended()) is None or is_ending.is_set():
                    continue
                robot.halt()  # where it is known to command it: a look may take seconds
                try:
                    if not self.may_end(ended):
                        context.fail(start.death(self.name, ended))
                finally:
                    robot.look_at_last()
                    robot.halt()
                return

    def _end(self) -> None:
        program, self._program = self._program, None
        if program is not None:
            self._ended = program.stop()
            if self._robot is not None:
                self._robot.halt()

    def _facts(self, context: RobotRunnerContext, start: supervised_program.Start) -> dict[str, Any]:
        """Return the facts about it that the journal keeps for a run."""
        folder = start.folder
        if folder.is_relative_to(context.experiment_folder):
            folder = folder.relative_to(context.experiment_folder)
        return {
            "command": list(self.words()),
            "pid": start.pid,
            "per": self.per,
            "output": folder.as_posix(),
            "startup_s": round(self._startup_time or 0.0, 3),
            **self.surroundings.facts(),
        }
