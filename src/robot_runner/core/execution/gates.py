"""Gates: what must hold before a run begins, awaited in a process of its own.

A condition may open links, sockets and threads, and the process that forks runs must have none of them.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from robot_runner.core.config.experiment import Experiment
from robot_runner.core.config.gate_parameters import Gate, GatePolicy
from robot_runner.core.errors import ConditionTimeout, Finding, RobotRunnerError
from robot_runner.core.events.context import RobotRunnerContext
from robot_runner.core.events.measure import CONFIG_OWNER, MeasureColumns
from robot_runner.core.execution.notices import FindingsNoticed, GatePassed, GateWaiting
from robot_runner.core.execution.orchestrator_events import OngoingExperiment
from robot_runner.core.execution.places import Watch
from robot_runner.core.execution.poll_loop import NO_MORE_RUNS, Pause, Steps, until_ending
from robot_runner.core.execution.task import PendingRun, Report, RunOutcome, RunTask
from robot_runner.core.execution.work_beside_runs import executed_beside_runs
from robot_runner.core.words import shown_duration

#: How long the process may take beyond the gate's own time, s: to connect, or to begin a simulation.
_MARGIN = 60.0
#: How often the journal records what is seen while a gate is awaited, s: for `status`, from another terminal.
_KEPT_EVERY = 60.0
#: How long to wait before connecting again to a robot that could not be reached, s.
_AGAIN = 1.0
_OWNER = "gate"


@dataclass(frozen=True, slots=True)
class Passage:
    """How the gates before an attempt went.

    Attributes:
        doubts: why the values of the attempt are doubtful.
        failure: why the attempt fails without being executed; empty where it does not.
        stop: why the experiment stops; empty where it goes on.
    """

    doubts: tuple[Finding, ...] = ()
    failure: str = ""
    stop: str = ""

    def report_to(self, report: Report, columns: MeasureColumns) -> None:
        """Report doubts and failure to an attempt; doubts are about all measures of these columns."""
        for finding in self.doubts:
            told = {"problem": finding.problem, "fix": finding.fix}
            report("finding", {"owner": _OWNER, **told, "measures": columns.doubtful_with_run})
        if self.failure:
            report("failure", {"event": "", "owner": _OWNER, "problem": self.failure, "traceback": ""})


class Gates:
    """Awaits the gates of an experiment."""

    def __init__(self, ongoing: OngoingExperiment) -> None:
        self._gates: tuple[Gate, ...] = tuple(ongoing.experiment.parameters.gates)
        self._ongoing = ongoing

    def pass_before(self, run: PendingRun, experiment: Experiment) -> Steps[Passage]:
        """Await all gates, one after another, before the next attempt at a run, unless no more runs begin."""
        if not self._gates:
            return Passage()
        begun = self._ongoing.progress.task_of(run)
        task = replace(begun, attempt=begun.attempt + 1)
        wait = _Wait(self._gates, task, self._ongoing)
        outcome = yield from self._awaited(task, experiment, wait.take)
        while not self._ongoing.is_ending and _robot_is_away(outcome) and wait.goes_on_without(outcome):
            yield Pause(_AGAIN)
            outcome = yield from self._awaited(task, experiment, wait.take)
        if self._ongoing.is_ending:
            if not wait.is_over:
                because = "the experiment was interrupted" if self._ongoing.is_interrupted else NO_MORE_RUNS
                wait.end(because, state="interrupted")
            return Passage()
        if outcome.failure is not None and not wait.is_over:
            wait.end(outcome.failure.problem, state="timed out" if _robot_is_away(outcome) else "failed")
        return wait.passage()

    def _awaited(self, task: RunTask, experiment: Experiment, take: Report) -> Steps[RunOutcome]:
        gates = self._gates
        seconds = sum(gate.patience_s for gate in gates) + _MARGIN
        # Where none can ask the robot, neither its graph nor a simulation is needed to wait.
        asks_robot = not all(gate.condition.is_outside for gate in gates)
        waiting = executed_beside_runs(
            experiment,
            task,
            lambda context: _await_gates(gates, context),
            Watch(self._ongoing.poll_loop.interruption, take),
            deadline_s=seconds if math.isfinite(seconds) else None,
            robot=experiment.parameters.robot if asks_robot else None,
        )
        return until_ending(waiting, lambda: self._ongoing.is_ending)


class _Wait:
    """One wait at the gates, as its process reports it."""

    def __init__(self, gates: Sequence[Gate], task: RunTask, ongoing: OngoingExperiment) -> None:
        self._gates = gates
        self._task = task
        self._progress = ongoing.progress
        self._notify = ongoing.notify
        self._number = 0
        self._began = time.monotonic()
        self._seen, self._seconds = "", 0.0
        self._kept = -math.inf
        self._is_overdue_told = False
        self._problems: list[tuple[Gate, str]] = []

    @property
    def is_over(self) -> bool:
        """Whether all gates were passed, or one of them ended the wait."""
        stopped = any(gate.on_timeout is not GatePolicy.DOUBT for gate, _ in self._problems)
        return stopped or self._number >= len(self._gates)

    @property
    def _gate(self) -> Gate:
        return self._gates[min(self._number, len(self._gates) - 1)]

    def goes_on_without(self, outcome: RunOutcome) -> bool:
        """Show why the robot cannot be reached, and return whether there is time left to wait for it."""
        self._seconds = time.monotonic() - self._began
        self._seen = outcome.failure.problem if outcome.failure is not None else ""
        self._go_on()
        return self._seconds < self._gate.patience_s

    def take(self, kind: str, fields: Mapping[str, Any]) -> None:
        """Take a record of the process; kinds that are not about waiting are ignored."""
        if kind in {"waiting", "waited"} and fields.get("owner") == CONFIG_OWNER:
            self._seen, self._seconds = str(fields["seen"]), float(fields["seconds"])
        if kind == "waiting":
            self._go_on()
        elif kind == "waited" and fields["holds"]:
            self._finish("open", "")
        elif kind == "gate":
            self.end(str(fields["problem"]), state="failed" if fields["is_in_vain"] else "timed out")

    def end(self, problem: str, *, state: str) -> None:
        """Record that the present gate was not passed."""
        if state != "interrupted":
            self._problems.append((self._gate, problem))
        self._finish(state, problem)

    def passage(self) -> Passage:
        """Return the consequence of the gates that were not passed."""
        doubts, failure, stop = [], "", ""
        for gate, problem in self._problems:
            told = f"the gate was not passed: {problem}"
            match gate.on_timeout:
                case GatePolicy.DOUBT:
                    fix = "Repeat the run once the condition can hold, or allow the gate more time."
                    doubts.append(Finding.warning(_OWNER, told, fix))
                case GatePolicy.FAIL:
                    failure = told
                case GatePolicy.STOP | GatePolicy.WAIT:  # nothing more is awaited where waiting is in vain
                    stop = told
        return Passage(tuple(doubts), failure, stop)

    def _go_on(self) -> None:
        gate = self._gate
        now = time.monotonic()
        if now - self._kept >= _KEPT_EVERY:
            self._kept = now
            self._progress.bring_table_up_to_date()  # there is time for it now, and people look at the table meanwhile
            self._keep("waiting")
        task, condition = self._task, str(gate.condition)
        self._notify(
            GateWaiting(
                run_id=task.run_id,
                run_number=task.run_number,
                run_count=task.run_count,
                condition=condition,
                seen=self._seen,
                seconds=self._seconds,
                timeout_s=gate.timeout_s,
            )
        )
        is_overdue = gate.timeout_s is not None and self._seconds > gate.timeout_s
        if is_overdue and not self._is_overdue_told:
            self._is_overdue_told = True
            problem = f"waiting until {condition} takes longer than {shown_duration(gate.timeout_s or 0)}: {self._seen}"
            fix = "Look at what is awaited; Ctrl-C ends the wait, and the same command goes on later."
            self._notify(FindingsNoticed([Finding.warning(f"gate before {task.run_id}", problem, fix)]))

    def _finish(self, state: str, problem: str) -> None:
        self._keep(state, problem)
        condition = str(self._gate.condition)
        self._notify(GatePassed(self._task.run_id, condition, self._seen, self._seconds, state, problem))
        self._number += 1
        self._seen, self._seconds, self._kept, self._is_overdue_told = "", 0.0, -math.inf, False

    def _keep(self, state: str, problem: str = "") -> None:
        self._progress.note(
            "gate",
            flush=True,
            run=self._task.run_id,
            attempt=self._task.attempt,
            condition=str(self._gate.condition),
            state=state,
            seconds=round(self._seconds, 3),
            seen=self._seen,
            **({"problem": problem} if problem else {}),
        )


def _robot_is_away(outcome: RunOutcome) -> bool:
    """Whether the process could not begin to wait: the clock of the robot's graph could not be reached."""
    failure = outcome.failure
    return failure is not None and (failure.event, failure.owner) == ("", "link")


def _await_gates(gates: Sequence[Gate], context: RobotRunnerContext) -> None:
    """Await one gate after another; a failure is reported, and ends the wait unless the gate's policy is DOUBT."""
    for gate in gates:
        try:
            gate.condition.wait(context, timeout_s=gate.patience_s)
        except Exception as error:  # noqa: BLE001 - a user's predicate may raise anything, and a gate must be told of
            problem = error.problem if isinstance(error, RobotRunnerError) else f"{type(error).__name__}: {error}"
            is_in_vain = not isinstance(error, ConditionTimeout)
            context.broker.note(context.owner, "gate", {"problem": problem, "is_in_vain": is_in_vain})
            if gate.on_timeout is not GatePolicy.DOUBT:
                return
