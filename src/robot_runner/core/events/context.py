"""The contexts that callbacks get: the experiment, the run, and methods to publish, warn, share and stop."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, Protocol, runtime_checkable

from robot_runner.core.errors import Finding, PluginError
from robot_runner.core.events.early_end import Ending, EndingInPlace
from robot_runner.core.events.measure import CONFIG_OWNER, MeasureValue, Origin
from robot_runner.core.events.measure_broker import MeasureBroker
from robot_runner.core.events.resources import HostAccess, Resources
from robot_runner.core.events.window import MissionTimes, Phase, Window
from robot_runner.core.storage.declared_shapes import faults_of, parsed_json
from robot_runner.core.storage.guarded_files import make_experiment_folder, make_folder
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.outliving import program_name, spare
from robot_runner.core.storage.record_shapes import ClockFacts

#: The run id of a probe, in which each profiler is tried for a moment, without a mission.
PROBE = "probe"

# The clock of a run: the machine's own, or that of a simulated robot.


@runtime_checkable
class Clock(Protocol):
    """Time as the robot lives it: a mission that sleeps on it works on a real and on a simulated robot."""

    def now(self) -> float:
        """Return the seconds since some fixed moment; never goes back."""

    def sleep(self, seconds: float) -> None:
        """Let this many seconds of the clock go by; negative counts as zero."""


class SystemClock:
    """The monotonic clock of this machine."""

    def now(self) -> float:
        """Return the seconds of the machine's monotonic clock."""
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        """Block the calling thread for this many real seconds."""
        if seconds > 0:
            time.sleep(seconds)


class StartedProgram(Protocol):
    """A program that was started, such as a `subprocess.Popen`."""

    @property
    def pid(self) -> int:
        """Its process id."""


@dataclass(frozen=True, slots=True)
class NextRun:
    """The run that comes after the one that is over, for `continue_experiment`.

    Attributes:
        run_id: its id in the run table, such as `r_2`.
        run_number: its place in the order of execution, from 1.
        combination: the treatment of each factor, by the factor's name.
        repetition: which repetition of the combination it is, from 1.
    """

    run_id: str
    run_number: int
    combination: Mapping[str, Any]
    repetition: int


@dataclass(frozen=True, slots=True)
class ExperimentEnd:
    """How an experiment ended, for `after_experiment`.

    Attributes:
        done, failed, todo: how many runs of the table are done, failed, and are still to do.
        is_interrupted: whether the user asked for the end.
        is_stopped_by_policy: whether a failed run ended it (`on_failure` STOP).
        failure: what ended it before its time, such as a `before_experiment` that raised; empty where nothing did.
        failures: why each failed run failed, one line each.
        findings: what looked odd.

    Example:
        >>> ExperimentEnd(done=4).is_complete
        True
    """

    done: int = 0
    failed: int = 0
    todo: int = 0
    is_interrupted: bool = False
    is_stopped_by_policy: bool = False
    failure: str = ""
    failures: Sequence[str] = ()
    findings: Sequence[Finding] = ()

    @property
    def is_complete(self) -> bool:
        """Whether all runs are done."""
        return not (self.failed or self.todo or self.failure)


@dataclass(frozen=True, slots=True, kw_only=True)
class ExperimentContext:
    """The context of `before_experiment` and `after_experiment`.

    Attributes:
        experiment_name: as in the config.
        experiment_folder: where everything of this experiment is kept.
        robot: how the robot is reached (`"simulated"`, ...), or None where the config names none.
        seed: the seed of the experiment, from which the runs' order and the runs' own seeds are derived.
        ended: how the experiment ended, in `after_experiment`; None before.
    """

    experiment_name: str
    experiment_folder: Path
    robot: str | None = None
    seed: int = 0
    ended: ExperimentEnd | None = None


#: Attributes of the context under names of earlier tools, or as people guess them, which are not similar to ours.
OTHER_NAMES = {
    **dict.fromkeys(("execute_run", "factors", "levels", "run_variation", "treatments", "variation"), "combination"),
    **dict.fromkeys(("run_nr", "current_run"), "run_number"),
    "run_dir": "run_folder",
    "experiment_path": "experiment_folder",
    "sleep": "clock.sleep",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotRunnerContext(ExperimentContext):
    """The context of a run's events.

    Attributes:
        run_id: the run's id in the run table, such as `r_1`.
        run_number: its place in the order of execution, from 1.
        run_count: how many runs the experiment has.
        attempt: how often this run has been tried, this time included, from 1.
        attempts_left: how often it is tried again where this attempt fails.
        combination: the treatment of each factor, by the factor's name.
        repetition: which repetition of the combination this is, from 1; 0 for a warm-up run.
        run_seed: a seed for this run alone, the same each time that it is executed.
        clock: the clock to sleep on; on a simulated robot it is the simulation's.
        resources: links and devices that the run's plugins share.
        owner: for whom this context was made: a plugin's name, or `config`.
        times: when the mission and its phases began and ended.
        broker: takes what is published; use `publish`, `share`, `warn` and `doubt`.
        ending: ends the run or its mission; use `fail` and `stop_mission`.
        hosts: opens the hosts of the config; use `host`.
        run_path: the run's folder, which may not exist yet; use `run_folder` to keep something there.
        usual_origin: the origin of the owner's values, unless it gives another one.
        next_run: in `continue_experiment`, the run that comes next; all else is about the run that is over.
    """

    run_id: str
    run_number: int
    run_count: int
    attempt: int
    combination: Mapping[str, Any]
    repetition: int
    run_seed: int
    run_path: Path
    clock: Clock
    resources: Resources
    owner: str
    times: MissionTimes = field(repr=False)
    broker: MeasureBroker = field(repr=False)
    hosts: Callable[[str, RobotRunnerContext], HostAccess] = field(repr=False)
    attempts_left: int = 0
    ending: Ending = field(default_factory=EndingInPlace, repr=False)
    usual_origin: Origin = field(default=Origin.MEASURED, repr=False)
    next_run: NextRun | None = None

    @property
    def is_warm_up(self) -> bool:
        """Whether the run only warms up: it is executed and kept like any other, and not analysed."""
        return self.repetition == 0

    @property
    def run_folder(self) -> Path:
        """The run's folder; made when first asked for."""
        return self._made(self.run_path)

    @property
    def raw_data_folder(self) -> Path:
        """The folder that is reserved for the owner's raw data; made when first asked for."""
        return self._made(self.run_path / self.owner)

    def _made(self, folder: Path) -> Path:
        if not self.experiment_folder.exists():  # on a machine that only executes runs
            make_experiment_folder(self.experiment_folder)
        make_folder(folder, self.experiment_folder)
        return folder

    @property
    def window(self) -> Window | None:
        """The measured window on the run's clock: the mission, from the emission of `launch_mission` to its end.

        It is the same for all plugins; None while the mission has not ended.
        """
        return self.times.window()

    @property
    def phases(self) -> tuple[Phase, ...]:
        """The phases of the mission that are over, on the run's clock, in the order of their ends."""
        return self.times.phases()

    def phase(self, name: str) -> AbstractContextManager[None]:
        """Take a block of the mission for one of its phases, as in `with context.phase("navigate"):`.

        A name may come several times. Where the config's `phases` lists it, measures are published for it, too.

        Raises:
            PluginError: no phase can have this name, or no mission is going on.
        """
        return self.times.phase(name)

    def begin_window(self) -> None:
        """Begin the measured window here instead of at the beginning of the mission.

        Raises:
            PluginError: no mission is going on, or the window has ended.
        """
        self.times.begin_window()

    def end_window(self) -> None:
        """End the measured window here instead of at the end of the mission; where it has ended, nothing happens.

        Raises:
            PluginError: no mission is going on.
        """
        self.times.end_window()

    @property
    def measures(self) -> Mapping[str, MeasureValue]:
        """The measures published so far in this run, by column of the run table."""
        return MappingProxyType({name: published.value for name, published in self.broker.measures.items()})

    @property
    def plugin_data(self) -> Mapping[str, Mapping[str, object]]:
        """The key-value pairs that plugins shared so far in this run, by the plugin's name."""
        return self.broker.shared

    def publish(self, name: str, value: object, *, origin: Origin | None = None) -> None:
        """Publish a measure of this run; None says that there is no value.

        Args:
            name: the measure.
            value: a number, a text, a boolean or None.
            origin: where the value comes from; by default measured, or simulated where the config or a system publishes
                it on a simulated robot, or the config in a run that has simulated values.

        Raises:
            MeasureError: the name was not declared, the type is wrong, the number is not finite, or it is a text
                and the measure has a unit.
        """
        if origin is None:
            # The name of a graph does not tell that its robot is simulated: what plugins have seen there does.
            is_beside = self.owner == CONFIG_OWNER and self.broker.has_simulated
            origin = Origin.SIMULATED if is_beside else self.usual_origin
        self.broker.publish(self.owner, name, value, origin)

    def host(self, name: str) -> HostAccess:
        """Return a host of the config's `hosts`, to execute commands there, copy to it and fetch from it.

        Its one connection is kept until the run ends; in `before_run`, until all callbacks have returned.

        Raises:
            LinkError: the config names no such host; the nearest is named.
        """
        return self.hosts(name, self)

    def share(self, **values: object) -> None:
        """Pass key-value pairs on to the subscribers of the following events (`plugin_data`), and to the screen.

        Values are to be plain: numbers, strings, booleans, None, or lists and mappings of them.
        """
        self.broker.share(self.owner, values)

    def warn(self, problem: str, *, fix: str = "") -> None:
        """Record a warning about this run; it is shown at the end and kept with the run."""
        self.broker.warn(self.owner, problem, fix)

    def doubt(self, problem: str, *, fix: str = "", measures: Sequence[str] = ()) -> None:
        """Record why values of this run are doubtful, or missing: a warning that is kept with each of them.

        Args:
            problem: the reason, with figures.
            fix: what can be done about it, in one sentence.
            measures: whose values, also per phase, by the names that were declared; none named: all of the owner's.

        Raises:
            MeasureError: the owner declared no such measure.
        """
        self.broker.doubt(self.owner, problem, fix, measures)

    def fail(self, reason: str) -> None:
        """Fail this run and end it at once: what is open is closed, and the robot is made safe.

        Call it from anywhere: a callback of an event, which it ends, or of a topic, or any thread. In another thread
        than the run's own it returns.
        """
        self.ending.fail(self.owner, str(reason))

    def stop_mission(self, reason: str) -> None:
        """End the mission at once, and the measured window at this moment; the run goes on and is not failed.

        Call it from anywhere, as `fail`. Once the mission is over it does nothing.

        Raises:
            PluginError: the mission has not begun.
        """
        if self.times.stop():
            self.ending.stop_mission(self.owner, str(reason))  # the journal takes a text

    def outlives(self, process: StartedProgram | int) -> None:
        """Let a program that this run started go on when the run has ended, with all that it starts itself.

        Nobody ends it then but you.

        Args:
            process: the program, as `subprocess.Popen` returns it, or its process id.

        Raises:
            PluginError: there is no such process.
            StorageError: it cannot be noted in the experiment's folder.
        """
        pid = process if isinstance(process, int) else process.pid
        name = program_name(pid)
        if name is None:
            fix = "Give it the Popen object, or its pid, while it is alive."
            raise PluginError(f"process {pid!r} cannot outlive the run: it is not alive", where=self.owner, fix=fix)
        spare(ExperimentFolder(self.experiment_folder).outliving, pid)
        self.broker.note(self.owner, "outlives", {"pid": pid, "program": name})

    def note_clock(self, facts: Mapping[str, object]) -> None:
        """Record the offset of another computer's clock from the run's, as `ClockRecord.facts` returns it.

        It is kept in the journal, run by run, and summarised for each computer in the manifest.

        Raises:
            PluginError: the facts have another form, and could not be read back.
        """
        if faults := faults_of(parsed_json(json.dumps(dict(facts), default=str)), ClockFacts):
            fix = "Pass on what ClockRecord.facts() returns."
            raise PluginError(f"these are not facts of a clock: {'; '.join(faults)}", where=self.owner, fix=fix)
        self.broker.note(self.owner, "clock", facts)
