"""The standby of a run: a process that makes the systems safe where the run died before it had done so itself.

A run that is killed, crashes in C or is out of memory closes nothing: a robot without a watchdog would carry out its
last command for ever. The standby is forked by the run's keeper, imports what the link needs, joins the robot's graph
where that takes long, and waits for the run's death. It acts also where keeper and orchestrator have been killed, too;
where the run outlives an orchestrator whose keeper is dead or stopped, it ends the run first.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, closing, suppress
from copy import copy as shallow_copy
from functools import partial
from itertools import chain
from typing import Any, NoReturn, TypeVar

from robot_runner.core.config.experiment import Experiment
from robot_runner.core.errors import LinkError, StorageError
from robot_runner.core.events.context import SystemClock
from robot_runner.core.events.measure import CONFIG_OWNER
from robot_runner.core.execution.left_processes import end_left_processes
from robot_runner.core.execution.processes import await_an_end, await_end, forked, settle_streams, use_no_streams
from robot_runner.core.execution.run_events import has_standby, made_safe, run_contexts
from robot_runner.core.execution.run_records import failure_fields
from robot_runner.core.execution.standby_lock import LONGEST, LOOK, hold_standby_lock, is_at_work, kill_if_stopped
from robot_runner.core.execution.systems_state import Care, SystemsFile, SystemsState
from robot_runner.core.execution.task import RunTask
from robot_runner.core.links.commanded_topics import (
    CANCELLING,
    MAY_BE_MOVING,
    STOP_BY_HAND,
    Commanded,
    keep_commanding_zero,
    zero_first,
)
from robot_runner.core.links.connect import (
    RobotTriedOnce,
    connect_robot,
    join_beforehand,
    preload_robot,
    resolved_robot,
)
from robot_runner.core.links.goal_cancelling import keep_cancelling_goals
from robot_runner.core.links.kinds import link_key
from robot_runner.core.links.robot import RobotLink
from robot_runner.core.plugin import System
from robot_runner.core.storage.layout import print_to_log
from robot_runner.core.storage.outliving import is_stopped
from robot_runner.core.treatments import factors_of
from robot_runner.core.words import enumerated

_T = TypeVar("_T")

#: For how long after the run's death, and how often, it is tried again where the robot cannot be reached, s: whatever
#: killed the run may have killed a server or the network, too, and both may come back.
RETRYING, _AGAIN = 20.0, 0.5
#: How often it is checked whether a standby that is awaited is stopped, s.
_OFTEN = 0.5
#: How much longer than the grace a run may go on without an orchestrator, s: ending it is its keeper's work.
_MARGIN = 2.0


class Standby:
    """Makes the systems of a run safe where the run died before it had done so.

    Args:
        systems: those of the run that have a `make_safe` of their own.
        experiment: of the run; its next execution waits for this process.
        task: the run.
        is_for_all: whether all of the run is safe afterwards; False where other systems are left to be made safe.

    Attributes:
        systems: that are made safe.
        is_there_beforehand: whether its process is forked with the run. Otherwise, as for a simulated robot, there is
            one only where the run is dead and has commanded a robot that the config does not name.
        state: shared by the run, its keeper, the standby and the orchestrator.
    """

    def __init__(
        self, systems: Sequence[System], experiment: Experiment, task: RunTask, *, is_for_all: bool = True
    ) -> None:
        # A system with bound parameters is built anew, in place, for a run that begins while this one goes on.
        self.systems = [shallow_copy(each) if factors_of(each) else each for each in systems]
        self._experiment = experiment
        self._task = task
        self._is_for_all = is_for_all
        self.is_there_beforehand = has_standby(experiment)
        self._orchestrator = os.getpid()
        self._pid = self._parent = 0
        self.state = SystemsState()

    def begin(self, run: int | None, let_go: Sequence[int] = ()) -> None:
        """Fork the process that waits for the death of the run.

        `run` is None where it is known to be dead; the forked process closes the descriptors `let_go`.
        """
        self._parent = os.getpid()
        self._pid = forked()
        if self._pid == 0:
            for descriptor in let_go:
                os.close(descriptor)
            self._stand_by(run)

    def wait(self, seconds: float = LONGEST) -> None:
        """Wait until the process of `begin` has ended, once the run is dead; kill it where it hangs or is stopped."""
        deadline, was_stopped = time.monotonic() + seconds, False
        while not (has_ended := await_end(self._pid, min(seconds, _OFTEN))):
            if (was_stopped := is_stopped(self._pid)) or time.monotonic() >= deadline:
                break
        if not has_ended:
            with suppress(ProcessLookupError):
                os.kill(self._pid, signal.SIGKILL)
        with suppress(ChildProcessError):  # the keeper reaps all its children
            os.waitpid(self._pid, 0)
        if not (has_ended or was_stopped) and self.state.care is Care.STANDBY:
            self.state.set(Care.OUT_OF_REACH, f"that took longer than {LONGEST:g} s")

    def look_after(self, run: int) -> None:
        """Wait for the standby of a run that is dead, and do its work where it was killed or stopped."""
        for seconds in self.looked_after(run):
            time.sleep(seconds)

    def stop_again(self, run: int) -> None:
        """Do its work once more after the end of programs that may have commanded the robot since it was stopped."""
        if self.state.care is Care.MADE_SAFE and self.state.commanded:
            self.state.set(Care.RUN)
            self.look_after(run)

    def looked_after(self, run: int) -> Iterator[float]:
        """Do the same as `look_after` step by step, for the orchestrator: yield how long to wait each time, s."""
        if not self.is_there_beforehand and self.state.care in {Care.NOBODY_YET, Care.SAFE}:
            return
        deadline = time.monotonic() + LONGEST
        while (acts := self._acts()) and time.monotonic() < deadline:
            yield LOOK
        # Once continued, a stopped one would command the robot in the midst of a run; until then, it holds the lock.
        with suppress(StorageError):
            kill_if_stopped(self._experiment.folder)
        # The standby was killed or stopped, or has not woken up yet: making a system safe twice does no harm.
        if self.state.care in {Care.RUN, Care.STANDBY} and not acts:
            self.state.set(Care.RUN)
            self.begin(run)
            deadline = time.monotonic() + LONGEST
            while not (await_end(self._pid, 0.0) or is_stopped(self._pid)) and time.monotonic() < deadline:
                yield LOOK
            self.wait(0.0)

    def _acts(self) -> bool:
        """Return whether the standby is alive, not stopped, and making the systems safe."""
        with suppress(StorageError):
            return self.state.care is Care.STANDBY and is_at_work(self._experiment.folder)
        return False

    def finding(self) -> dict[str, Any] | None:
        """Return the fields of a finding on the state of the systems; None where the run made them safe itself."""
        care, names = self.state.care, enumerated([each.name for each in self.systems]) or "the robot"
        if care in {Care.NOBODY_YET, Care.SAFE}:
            return None
        if care is Care.MADE_SAFE:
            problem = f"the run died before it had made {names} safe; the process that stood by for this did it"
            if self.state.reason:
                problem = f"{problem}, as far as it could: {self.state.reason}"
            return {"owner": "standby", "problem": problem, "fix": "Check where the robot stands before you go on."}
        reason = self.state.reason or "the process that stood by for this died, too"
        return {
            "owner": "standby",
            "problem": f"{MAY_BE_MOVING}: {names} could not be made safe: {reason}",
            "fix": STOP_BY_HAND,
        }

    def _stand_by(self, run: int | None) -> NoReturn:
        use_no_streams()  # client libraries print while they join a graph, which is not for the orchestrator's screen
        try:
            with suppress(Exception):  # a folder that was removed: stopping the robot matters more than the lock
                hold_standby_lock(self._experiment.folder)
            with closing(_Connection(self._experiment, self._task)) as connection:
                if self.is_there_beforehand:
                    self._prepare(connection)
                if run is not None:
                    self._await_end(run)
                if self.state.care is Care.RUN:
                    self._act(connection)
        finally:
            os._exit(0)

    def _prepare(self, connection: _Connection) -> None:
        """Import the link's modules, join the robot's graph where that takes long, and have the systems prepare."""
        with suppress(Exception):  # the run fails for the same reason, and reports it
            preload_robot(self._experiment.parameters.robot)
            join_beforehand(connection.contexts(CONFIG_OWNER))
        for system in self.systems:
            with suppress(Exception):
                system.stand_by(connection.contexts(system.name))

    def _await_end(self, run: int) -> None:
        """Wait until the run has ended; end it where its orchestrator is dead and its keeper is, too, or is stopped."""
        if run in await_an_end([run, self._orchestrator]):
            return
        for number in (signal.SIGTERM, signal.SIGKILL):  # asked twice, by us and by its keeper, it closes once
            with suppress(ProcessLookupError):
                os.kill(run, number)
            if await_end(run, self._experiment.parameters.grace_in_s + _MARGIN):
                return

    def _act(self, connection: _Connection) -> None:
        with suppress(OSError):  # stopping the robot matters more than saying so
            self.state.set(Care.STANDBY)
        deadline = time.monotonic() + RETRYING
        try:
            with suppress(Exception):  # stopping the robot matters more than the log
                print_to_log(self._experiment.folder)
                settle_streams()
            try:
                doubts = self._make_safe(connection)
            except Exception:  # noqa: BLE001 - the connection may have been lost: what fails again is reported
                doubts = self._make_safe_anew(deadline)
            # Programs that take longer to end may have commanded the robot since, and nobody else is left to end them.
            if os.getppid() != self._parent and end_left_processes(self._experiment.folder):
                doubts = self._make_safe_anew(deadline)
        except BaseException as error:  # noqa: BLE001 - whatever it is, a person must know that the robot was not stopped
            self.state.set(Care.OUT_OF_REACH, failure_fields(error)["problem"])
        else:
            if self._is_for_all:
                SystemsFile(self._experiment.folder).remove()  # first: the next run may begin once the state is set
            self.state.set(Care.MADE_SAFE, "; ".join(doubts))

    def _make_safe_anew(self, deadline: float) -> list[str]:
        """Make the systems safe over a new connection; try again until `deadline` where the robot is not reached."""
        while True:
            try:
                with closing(_Connection(self._experiment, self._task)) as another:
                    return self._make_safe(another)
            except LinkError:
                if time.monotonic() >= deadline:
                    raise
            time.sleep(_AGAIN)

    def _make_safe(self, connection: _Connection) -> list[str]:
        """Stop the robot on each topic, make each system safe, and stop the robot again; a failure skips no step.

        Goals are cancelled meanwhile, as the server of an action may hang. Return what remains doubtful: who takes
        the commands, and what systems warn of.
        """
        commanded = self.state.commanded
        topics = [each for each in commanded if each.message_type != CANCELLING]
        doubts, cancelling = list[str](), list[Future[None]]()

        def begin(link: RobotLink, at: Sequence[Commanded]) -> None:
            try:
                _command_zero(link, [each for each in at if each in topics])
            finally:
                actions = [each.topic for each in at if each not in topics]
                cancelling.extend(threads.submit(keep_cancelling_goals, link, each) for each in actions)

        with ThreadPoolExecutor(len(commanded) + 1) as threads, ExitStack() as each_of_them:  # the last one first
            if len(topics) < len(commanded):  # the server of an action may have commanded the robot until now
                each_of_them.callback(connection.at_graphs, _command_zero, topics)
            each_of_them.callback(lambda: [each.result() for each in cancelling])
            each_of_them.callback(lambda: doubts.extend(chain(*connection.at_graphs(_keep_commanding_zero, topics))))
            for system in self.systems:
                each_of_them.callback(made_safe, system, connection.contexts(system.name))
            each_of_them.callback(connection.at_graphs, begin, commanded)  # a config may have commanded, too
        return [*doubts, *connection.warnings]


def _begun(threads: ThreadPoolExecutor, act: Callable[[], _T]) -> Callable[[], _T]:
    """Begin something in a thread, and return what waits for it; where no thread may be had any more, what does it."""
    try:
        return threads.submit(act).result
    except RuntimeError:
        return act


def _command_zero(link: RobotLink, topics: Sequence[Commanded]) -> None:
    """Publish a zero velocity on each topic, also after one has failed."""
    with ExitStack() as each_of_them:
        for topic, message_type, _ in topics:
            each_of_them.callback(link.publish, topic, message_type, {})


def _keep_commanding_zero(link: RobotLink, topics: Sequence[Commanded]) -> list[str]:
    return keep_commanding_zero(link, [(topic, message_type) for topic, message_type, _ in topics])


class _Connection:
    """The links to the systems of a run.

    Attributes:
        contexts: makes the context of each owner.
        warnings: what the owners have warned of.
    """

    def __init__(self, experiment: Experiment, task: RunTask) -> None:
        self._robot = experiment.parameters.robot
        self._resources = RobotTriedOnce()
        self._others: dict[str, RobotTriedOnce] = {}
        self.warnings: list[str] = []
        self.contexts = run_contexts(
            experiment, task, clock=SystemClock(), resources=self._resources, report=self._take
        )

    def _take(self, kind: str, fields: Mapping[str, Any]) -> None:
        if kind == "finding":
            self.warnings.append(str(fields["problem"]))

    def at_graphs(
        self, act: Callable[[RobotLink, Sequence[Commanded]], _T], commanded: Sequence[Commanded]
    ) -> list[_T]:
        """Do something at all graphs at once, so that no robot waits for another, and return what it returned.

        Raises:
            Exception: the first that it has raised; the others are done then.
        """
        by_graph: dict[str, list[Commanded]] = {}
        for each in commanded:
            by_graph.setdefault("" if self._is_of_run(each.graph) else each.graph, []).append(each)
        acts = [partial(self._act_at, graph, act, of) for graph, of in by_graph.items()]
        done, faults = list[_T](), list[Exception]()
        with ThreadPoolExecutor(len(acts) + 1) as threads:
            begun: list[Callable[[], _T]] = [*acts[:1], *(_begun(threads, each) for each in acts[1:])]
            for finish in begun:
                try:
                    done.append(finish())
                except Exception as error:  # noqa: BLE001 - raised once all are done
                    faults.append(error)
        if faults:
            raise faults[0]
        return done

    def _act_at(self, graph: str, act: Callable[[RobotLink, Sequence[Commanded]], _T], of: Sequence[Commanded]) -> _T:
        with zero_first([(each.topic, each.message_type) for each in of if each.message_type != CANCELLING]):
            return act(self._link(graph), of)

    def _is_of_run(self, graph: str) -> bool:
        """Return whether a graph is that of the run's robot, and not one that a callback has reached by itself."""
        return graph in {"", self._robot} or (self._robot is not None and graph == resolved_robot(self._robot)[1].graph)

    def _link(self, graph: str) -> RobotLink:
        """Return the link to a graph; empty for that of the run's robot."""
        if not graph:
            return connect_robot(self.contexts(CONFIG_OWNER))
        # Of its own: while something is opened, whatever else the same resources have to open waits.
        resources = self._others.setdefault(graph, RobotTriedOnce())
        kind, name = resolved_robot(graph)
        opener = partial(
            kind.open_robot, name, resources=resources, clock=SystemClock(), seed=1, namespace=name.namespace
        )
        return resources.open(link_key("robot", graph), opener)

    def close(self) -> None:
        with ExitStack() as each_of_them:
            for resources in (self._resources, *self._others.values()):
                each_of_them.callback(resources.close)
