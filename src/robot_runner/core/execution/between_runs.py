"""Between two runs: pauses, the operator's steps, the robot's rest, and the reboots of hosts."""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from typing import Any

from robot_runner.core.config.parameters import OperationType
from robot_runner.core.design.columns import REPETITION
from robot_runner.core.design.design import HeldOrder
from robot_runner.core.design.factor import texts_of
from robot_runner.core.design.planned_runs import PlannedRun
from robot_runner.core.errors import CommandError, ExecutionError, Finding, LinkError
from robot_runner.core.events.context import RobotRunnerContext
from robot_runner.core.events.measure import CONFIG_OWNER
from robot_runner.core.execution.notices import FindingsNoticed, HostRestarts, OutcomeAmended, Paused
from robot_runner.core.execution.operator import Operator
from robot_runner.core.execution.orchestrator_events import OngoingExperiment
from robot_runner.core.execution.places import Place, Watch
from robot_runner.core.execution.poll_loop import Pause, Steps, UntilEnding
from robot_runner.core.execution.task import AttemptStatus, PendingRun, RunTask
from robot_runner.core.execution.work_beside_runs import executed_beside_runs
from robot_runner.core.links.connect import is_simulated
from robot_runner.core.links.declared_host import Host, Reboot
from robot_runner.core.links.host_commands import HostCommands, Shell, opened_host
from robot_runner.core.storage.journal import read_journal
from robot_runner.core.storage.lock import forget_requests, is_requested

_log = logging.getLogger(__name__)

#: How often it is checked whether a pause is over, s.
_LISTEN = 0.2

# Reboots of hosts (`Host.reboot`).

#: The run id in the context of a reboot.
_RUN = "reboot"
#: How often a host is asked whether it answers again, s.
_EVERY = 0.5
#: How long one question may take, s.
_ASKED = 15.0
#: Beyond the time for the host and for its condition, s: to begin and end the process that waits.
_PATIENCE = 30.0
#: Prints an id that Linux makes at each boot.
_BOOT = "cat /proc/sys/kernel/random/boot_id"


class BetweenRuns:
    """The steps between the end of a run and the beginning of the next."""

    def __init__(self, ongoing: OngoingExperiment, operator: Operator) -> None:
        self._ongoing = ongoing
        self._operator = operator
        self._parameters = ongoing.experiment.parameters
        self._is_paused = False
        self._held = HeldOrder.of_facts(ongoing.experiment.model.design_facts)
        self._last_of_unit: dict[str, Mapping[str, Any]] = {}
        journal = ongoing.experiment.folder.journal
        for record in read_journal(journal, kinds={"attempt_started"}) if self._held.rest_in_s else ():
            self._rest_before(record.get("combination") or {})
        self._reboots = _Reboots(ongoing)

    def prepare(
        self, run: PendingRun, finished: PendingRun | None, place: Place, name: str, *, is_cleared: bool = False
    ) -> Steps[None]:
        """Take the steps before a run: pause, operator's steps, the question of SEMI mode, rest, reboots.

        In SEMI mode the user is not asked where a callback or a step of the operator has just asked. `finished` is the
        run before it at this place in this session; `name` is empty where there is no other place. With `is_cleared`, a
        callback has asked already whether the first run may start.
        """
        yield from self.pause_where_requested(run)
        if finished is not None and self._is_semi and not self._ongoing.is_ending:
            is_cleared = self._ongoing.events.user_has_continued(
                finished,
                run,
                lambda factor, owner: self._operator.note_read(run.run_id, factor, owner),
                name,
                place.experiment,
            )
            self._ongoing.notify(OutcomeAmended(finished.run_id, self._ongoing.progress.last_outcome(name)))
        has_asked = yield from self._operator.prepare(run, name)
        if self._is_semi and not (is_cleared or has_asked or self._ongoing.is_ending):
            yield from self._operator.ask_to_start(run, name)
        rest = self._parameters.time_between_runs_in_ms / 1000 if finished is not None else 0.0
        if self._held.rest_in_s:
            # The washout between treatments is kept in full: the unit's last run may have been in another session.
            rest = max(rest, self._rest_before(self._ongoing.progress.task_of(run).combination))
        if rest and not self._ongoing.is_ending:
            yield UntilEnding(Pause(rest), lambda: self._ongoing.is_ending)
        yield from self.pause_where_requested(run)  # it may have been asked for meanwhile
        yield from self._reboots.before(run)

    def _rest_before(self, combination: Mapping[str, Any]) -> float:
        """Return how long the unit of a run rests before it, s, and note that it has this run then."""
        unit = str(combination.get(self._held.one_by_one))
        last, self._last_of_unit[unit] = self._last_of_unit.get(unit), combination
        return self._held.rest_before(combination, last)

    def prepare_again(self, run: PendingRun, name: str) -> Steps[None]:
        """Take the steps before another attempt at a run: pause, operator's steps, the question of SEMI mode."""
        yield from self.pause_where_requested(run)
        has_asked = yield from self._operator.prepare(run, name, is_retry=True)
        if self._is_semi and not (has_asked or self._ongoing.is_ending):
            yield from self._operator.ask_to_start(run, name)

    def pause_where_requested(self, run: PendingRun) -> Steps[bool]:
        """Wait, if `robot-runner pause` has requested it, until the request is taken back or the user interrupts.

        Returns whether anything was awaited.

        An operator's step at another place is awaited first, and none is asked for meanwhile: ENTER has one meaning.
        """
        pause, has_waited = self._ongoing.experiment.folder.pause, False
        while not self._ongoing.is_ending and (
            self._is_paused  # told of before another run
            or (self._operator.is_asking and is_requested(pause))
        ):
            has_waited = True
            yield Pause(_LISTEN)
        if not is_requested(pause) or self._ongoing.is_ending:
            return has_waited
        self._is_paused = self._operator.is_asking = True
        try:
            yield from self._paused(run)
        finally:
            self._is_paused = self._operator.is_asking = False
        return True

    def _paused(self, run: PendingRun) -> Steps[None]:
        progress, folder = self._ongoing.progress, self._ongoing.experiment.folder
        started, user_input = time.monotonic(), self._ongoing.observer.user_input
        progress.note("paused", flush=True, next_run=run.run_id)
        progress.bring_table_up_to_date()
        self._ongoing.notify(Paused(folder.root, run.number, progress.run_count))
        while is_requested(folder.pause) and not self._ongoing.is_ending:
            pause = Pause(_LISTEN, user_input)
            yield pause
            if pause.typed == b"":  # the end of the input
                user_input = None
            elif pause.typed is not None:
                forget_requests(folder.pause)
        progress.note("continued", after="pause", seconds=round(time.monotonic() - started, 3))

    @property
    def _is_semi(self) -> bool:
        return self._parameters.operation_type is OperationType.SEMI


class _Reboots:
    """Reboots hosts before the runs that their policies name, in a process under a keeper, as conditions open links."""

    def __init__(self, ongoing: OngoingExperiment) -> None:
        self._ongoing = ongoing
        self._experiment = ongoing.experiment
        self._progress = ongoing.progress
        self._last: PendingRun | None = None

    def before(self, run: PendingRun) -> Steps[None]:
        """Reboot the hosts that are to be rebooted before this run, wherever the one before it was executed.

        Raises:
            ExecutionError: a host refused, or did not come back.
        """
        for name, host in self._experiment.parameters.hosts.items():
            if not self._ongoing.is_ending and self._is_due(host, run):
                yield from self._restart(name, host, self._progress.task_of(run))
        self._last = run

    def _is_due(self, host: Host, run: PendingRun) -> bool:
        match host.reboot:
            case Reboot.NEVER:
                return False
            case Reboot.PER_RUN:
                return True
            case Reboot.ONCE:
                return self._last is None
            case Reboot.PER_BLOCK:
                return self._last is None or self._block(run) != self._block(self._last)

    def _block(self, run: PendingRun) -> object:
        """Return the number of a run's block in the plan; of a row of the user's own what `blocks` names."""
        task, model = self._progress.task_of(run), self._experiment.model
        planned = self._planned.get(run.run_id)
        if planned is not None and texts_of(planned.combination) == texts_of(task.combination):
            return planned.block
        if model.blocks is None:
            return None
        return task.repetition if model.blocks == REPETITION else str(task.combination.get(model.blocks))

    @cached_property
    def _planned(self) -> Mapping[str, PlannedRun]:
        return {each.run_id: each for each in self._experiment.model.plan(self._progress.seed)}

    def _restart(self, name: str, host: Host, task: RunTask) -> Steps[None]:
        self._ongoing.notify(HostRestarts(name, task.run_id))
        facts: dict[str, Any] = {}

        def report(kind: str, fields: dict[str, Any]) -> None:
            if kind == "host_restarted":
                facts.update({key: value for key, value in fields.items() if key != "owner"})
            elif kind == "waited":
                self._progress.note(kind, host=name, next_run=task.run_id, **fields)

        def launch_mission(context: RobotRunnerContext) -> None:
            context.broker.note(CONFIG_OWNER, "host_restarted", _restarted(name, host, context))

        started = time.monotonic()
        robot = self._experiment.parameters.robot
        outcome = yield from executed_beside_runs(
            self._experiment,
            replace(task, run_id=_RUN),
            launch_mission,
            Watch(self._ongoing.poll_loop.interruption, report),
            deadline_s=2 * host.back_within_s + _PATIENCE,
            robot=None if is_simulated(robot) else robot,  # hosts live by this machine's clock
        )
        seconds = round(time.monotonic() - started, 3)
        failure = "" if outcome.failure is None else outcome.failure.problem
        if outcome.status is AttemptStatus.INTERRUPTED:
            failure = "interrupted"
        self._progress.note(
            "host_restarted", host=name, next_run=task.run_id, seconds=seconds, failure=failure, **facts
        )
        if facts.get("is_new_kernel") is False:
            problem = "the host went away and answers again, but its kernel was not restarted"
            finding = Finding.warning(f"hosts[{name!r}]", problem, f"Look at reboot_command: {host.reboot_command!r}.")
            self._ongoing.notify(FindingsNoticed((finding,)))
        if outcome.status is AttemptStatus.FAILED:
            problem = f"the host {name} was to be restarted before {task.run_id}: {failure}"
            fix = "Look at the host, and start the experiment again: it resumes."
            raise ExecutionError(problem, where=f"hosts[{name!r}]", fix=fix)


def _restarted(name: str, host: Host, context: RobotRunnerContext) -> dict[str, Any]:
    """Reboot a host and wait until it answers again and its condition holds.

    Return `away_s`, for how long it did not answer, and `is_new_kernel`, whether it booted; None without a boot id.

    Raises:
        LinkError: it refused, did not go away, or did not come back in time.
        ConditionError: it was not ready in time.
    """
    access = opened_host({name: host}, name, context)
    began = access.run(_BOOT, check=False, timeout_s=_ASKED).output.strip()
    shell = access.shell
    told = time.monotonic()
    try:
        access.run(host.reboot_command, timeout_s=min(_ASKED, host.back_within_s))
    except CommandError as error:
        if shell.is_connected():  # else the connection went before the command could say that it had succeeded
            fix = "Let this user do that without a password, or give another reboot_command."
            raise LinkError(f"the host cannot be restarted: {error.problem}", where=name, fix=fix) from error
    except LinkError:
        _log.debug("%s went away at once", name)
    _await_end(name, host, shell, told)
    gone = time.monotonic()
    now = _await_answer(name, host, access, told)
    away = time.monotonic() - gone
    if host.ready is not None:
        host.ready.wait(context, timeout_s=max(1.0, host.back_within_s - (time.monotonic() - told)))
    return {"away_s": round(away, 3), "is_new_kernel": now != began if now and began else None}


def _await_end(name: str, host: Host, shell: Shell, told: float) -> None:
    while shell.is_connected():
        if time.monotonic() - told > host.back_within_s:
            raise LinkError(
                f"the host was told to restart ({host.reboot_command!r}), and was still there after "
                f"{host.back_within_s:g} s",
                where=name,
                fix="Look at reboot_command, or allow it more time (back_within_s).",
            )
        time.sleep(_EVERY / 10)


def _await_answer(name: str, host: Host, access: HostCommands, told: float) -> str:
    """Wait until the host answers again, and return its boot id; empty where it has none."""
    problem = ""
    while (left := host.back_within_s - (time.monotonic() - told)) > 0:
        try:
            return access.run(_BOOT, check=False, timeout_s=min(_ASKED, left)).output.strip()
        except LinkError as error:
            problem = error.problem
        time.sleep(_EVERY)
    problem = f"the host did not come back within {host.back_within_s:g} s{f': {problem}' if problem else ''}"
    raise LinkError(problem, where=name, fix="Look at the host, or allow it more time (back_within_s).")
