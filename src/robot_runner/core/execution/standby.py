"""The standby of a run: a process that makes the systems safe where the run died before it had done so itself.

A run that is killed, crashes in C or is out of memory closes nothing: a robot without a watchdog would carry out its
last command for ever. The standby is forked by the run's keeper, has imported what reaches the robot, has joined its
graph where that takes long, and waits for the run's death. It needs nobody for that: it acts as well where keeper and
orchestrator have been killed, too.
"""

from __future__ import annotations

import fcntl
import os
import signal
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, suppress
from copy import copy as shallow_copy
from typing import Any, NoReturn

from robot_runner.core.config.experiment import Experiment
from robot_runner.core.errors import LinkError, StorageError
from robot_runner.core.events.context import SystemClock
from robot_runner.core.events.measure import CONFIG_OWNER
from robot_runner.core.events.resources import Resources
from robot_runner.core.execution.left_over import has_locked
from robot_runner.core.execution.processes import ends, forked, settle_streams, use_no_streams
from robot_runner.core.execution.run_events import made_safe, run_contexts
from robot_runner.core.execution.run_records import failure_fields
from robot_runner.core.execution.systems_state import Care, SystemsFile, SystemsState
from robot_runner.core.execution.task import RunTask
from robot_runner.core.links.commanded_topics import MAY_BE_MOVING, STOP_BY_HAND, keep_commanding_zero
from robot_runner.core.links.connect import connect_robot, is_simulated, join_beforehand, preload_robot
from robot_runner.core.plugin import System
from robot_runner.core.storage.guarded_files import MissingFileError, open_descriptor
from robot_runner.core.storage.layout import ExperimentFolder, print_to_log
from robot_runner.core.storage.lock_files import open_to_lock, was_open_to_strangers
from robot_runner.core.treatments import factors_of
from robot_runner.core.words import enumerated

#: How long the standby may take from the run's death on, s. Finding a robot's nodes takes tenths, or up to 8 s where
#: one is switched off; telling the robot to stand still takes 4 to 12 s; and where something fails, all of it is done
#: twice at least.
LONGEST = 40.0
#: For how long after the run's death, and how often, it is begun anew where the robot cannot be reached, s: what has
#: killed the run may have taken a server or the network along, and both come back.
_RETRYING, _AGAIN = 15.0, 0.5
#: How long it may take to die once it was killed, s.
_DYING = 5.0
#: Enough for any process's id.
_DIGITS = 20
#: How often we look whether another process has ended, s.
_LOOK = 0.02


class Standby:
    """Makes the systems of a run safe where the run has died and has not.

    Args:
        systems: of the run; they have a `make_safe` of their own.
        experiment: of the run; who executes it next waits for this process.
        task: the run.
        is_for_all: whether nothing of the run is to be made safe but these systems, and its robot.

    Attributes:
        systems: that are made safe.
        state: what its processes tell each other.
    """

    def __init__(
        self, systems: Sequence[System], experiment: Experiment, task: RunTask, *, is_for_all: bool = True
    ) -> None:
        # One with bound parameters is built again, in its place, for a run that begins beside this one.
        self.systems = [shallow_copy(each) if factors_of(each) else each for each in systems]
        self._experiment = experiment
        self._task = task
        self._is_for_all = is_for_all
        self._pid = 0
        self.state = SystemsState()

    def begin(self, run: int | None, let_go: Sequence[int] = ()) -> None:
        """Fork the process that waits for the death of the run, and let go of these descriptors in it.

        Args:
            run: the process; None where it is known to be dead.
            let_go: what the process that is forked closes.
        """
        self._pid = forked()
        if self._pid == 0:
            for descriptor in let_go:
                os.close(descriptor)
            self._stand_by(run)

    def wait(self, seconds: float = LONGEST) -> None:
        """Wait until the process of `begin` has ended, once the run is dead; kill it where it hangs."""
        if hangs := not ends(self._pid, seconds):
            with suppress(ProcessLookupError):
                os.kill(self._pid, signal.SIGKILL)
        with suppress(ChildProcessError):  # reaped by who reaps all
            os.waitpid(self._pid, 0)
        if hangs and self.state.care is Care.STANDBY:
            self.state.set(Care.OUT_OF_REACH, f"that took longer than {LONGEST:g} s")

    def look_after(self, run: int) -> None:
        """Wait for the standby of a run that is dead, and do its work where it was killed."""
        for seconds in self.looked_after(run):
            time.sleep(seconds)

    def looked_after(self, run: int) -> Iterator[float]:
        """Do the same step by step, for the orchestrator: yield how long to wait each time, s."""
        deadline = time.monotonic() + LONGEST
        while self._acts() and time.monotonic() < deadline:
            yield _LOOK
        # Nobody stood by any more, or it was killed meanwhile, or has not woken up yet: twice does no harm.
        if self.state.care in {Care.RUN, Care.STANDBY} and not self._acts():
            self.state.set(Care.RUN)
            self.begin(run)
            deadline = time.monotonic() + LONGEST
            while not ends(self._pid, 0.0) and time.monotonic() < deadline:
                yield _LOOK
            self.wait(0.0)

    def _acts(self) -> bool:
        """Whether the process that stood by is alive and makes the systems safe."""
        with suppress(StorageError):
            return self.state.care is Care.STANDBY and locked_by(self._experiment.folder) is not None
        return False

    def finding(self) -> dict[str, Any] | None:
        """Return the fields of a finding on what became of the systems; None where the run made them safe itself."""
        care, names = self.state.care, enumerated([each.name for each in self.systems]) or "the robot"
        if care in {Care.NOBODY_YET, Care.SAFE}:
            return None
        if care is Care.MADE_SAFE:
            problem = f"the run died before it had made {names} safe; the process that stood by for this did it"
            if self.state.reason:
                problem = f"{problem}, as far as it could: {self.state.reason}"
            return {"owner": "standby", "problem": problem, "fix": "Look where the robot stands before you go on."}
        reason = self.state.reason or "the process that stood by for this died, too"
        return {
            "owner": "standby",
            "problem": f"{MAY_BE_MOVING}: {names} could not be made safe: {reason}",
            "fix": STOP_BY_HAND,
        }

    def _stand_by(self, run: int | None) -> NoReturn:
        use_no_streams()  # what client libraries print while they join is not for the screen of who has forked this
        try:
            with suppress(Exception):  # a folder that was removed: no lock is worth a robot that drives on
                _lock(self._experiment.folder)
            with closing(_Connection(self._experiment, self._task)) as connection:
                with suppress(Exception):  # the run fails for the same reason, and says so
                    preload_robot(self._experiment.parameters.robot)
                    join_beforehand(connection.contexts(CONFIG_OWNER))
                for system in self.systems:
                    with suppress(Exception):
                        system.stand_by(connection.contexts(system.name))
                if run is not None:
                    ends(run)
                if self.state.care is Care.RUN:
                    self._act(connection)
        finally:
            os._exit(0)

    def _act(self, connection: _Connection) -> None:
        self.state.set(Care.STANDBY)
        deadline = time.monotonic() + _RETRYING
        try:
            with suppress(Exception):  # no log is worth a robot that drives on
                print_to_log(self._experiment.folder)
                settle_streams()
            try:
                unheard = self._make_safe(connection)
            except Exception:  # noqa: BLE001 - the connection may have been lost since: what fails again is told
                unheard = self._make_safe_anew(deadline)
        except BaseException as error:  # noqa: BLE001 - whatever it is, a person has to know that nobody stopped the robot
            self.state.set(Care.OUT_OF_REACH, failure_fields(error)["problem"])
        else:
            names = enumerated(sorted(unheard))
            if self._is_for_all:
                SystemsFile(self._experiment.folder).remove()  # first: the next run may begin once it is known
            self.state.set(Care.MADE_SAFE, f"nobody subscribes to {names} any more" if unheard else "")

    def _make_safe_anew(self, deadline: float) -> list[str]:
        """Do it over a connection of its own, and, until then, again where the robot cannot be reached."""
        while True:
            try:
                with closing(_Connection(self._experiment, self._task)) as another:
                    return self._make_safe(another)
            except LinkError:
                if time.monotonic() >= deadline:
                    raise
            time.sleep(_AGAIN)

    def _make_safe(self, connection: _Connection) -> list[str]:
        """Stop the robot where it was commanded, make each system safe, and stop it again, whatever fails of that.

        Returns:
            the topics to which nobody subscribes any more.
        """
        commanded, unheard = self.state.commanded, list[str]()
        with ExitStack() as each_of_them:  # the last one first, as the run does it
            each_of_them.callback(lambda: unheard.extend(connection.stop_again(commanded)))
            for system in self.systems:
                each_of_them.callback(made_safe, system, connection.contexts(system.name))
            for topic, message_type in commanded:  # also for who has no `make_safe`, such as a config
                each_of_them.callback(connection.stop, topic, message_type)
        return unheard


class _Connection:
    """What is opened to reach the systems of a run.

    Attributes:
        contexts: makes the context of each owner.
    """

    def __init__(self, experiment: Experiment, task: RunTask) -> None:
        self._resources = Resources()
        self.contexts = run_contexts(
            experiment, task, clock=SystemClock(), resources=self._resources, report=lambda _kind, _fields: None
        )

    def stop(self, topic: str, message_type: str) -> None:
        """Command a robot to stand still."""
        connect_robot(self.contexts(CONFIG_OWNER)).publish(topic, message_type, {})

    def stop_again(self, commanded: Sequence[tuple[str, str]]) -> list[str]:
        """Repeat the stop command for some seconds, by topic and type, and until every subscriber is reached.

        Returns:
            the topics without any subscriber.

        Raises:
            LinkError: a subscriber of a topic is not reached.
        """
        return keep_commanding_zero(connect_robot(self.contexts(CONFIG_OWNER)), commanded) if commanded else []

    def close(self) -> None:
        """Close it."""
        self._resources.close()


def _lock(folder: ExperimentFolder) -> None:
    """Hold the lock of `standing_by` until this process ends, as its descriptor stays open."""
    descriptor = open_to_lock(folder.standing_by, folder.root)
    os.ftruncate(descriptor, 0)
    os.pwrite(descriptor, str(os.getpid()).encode(), 0)
    fcntl.flock(descriptor, fcntl.LOCK_SH)


def locked_by(folder: ExperimentFolder) -> int | None:
    """Return the process that stands by; None where nobody does, or where only a stranger has locked the file."""
    try:
        descriptor = open_descriptor(folder.standing_by, folder.root, os.O_RDONLY)
    except MissingFileError:
        return None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        with suppress(ValueError):
            pid, path = int(os.pread(descriptor, _DIGITS, 0)), folder.standing_by
            return pid if not was_open_to_strangers(path, folder.root) or has_locked(pid, path.resolve()) else None
    finally:
        os.close(descriptor)
    return None


def standby_of(experiment: Experiment, task: RunTask) -> Standby | None:
    """Return the standby of a run; None where nothing outlives it that would have to be made safe.

    The embedded simulation lives in the run's own process and dies with it.
    """
    robot = experiment.parameters.robot
    systems = made_safe_of_their_own(experiment)
    if is_simulated(robot) or (robot is None and not systems):
        return None
    return Standby(systems, experiment, task)


def made_safe_of_their_own(experiment: Experiment) -> list[System]:
    """Return the systems that have a `make_safe` of their own."""
    return [each for each in experiment.systems if type(each).make_safe is not System.make_safe]
