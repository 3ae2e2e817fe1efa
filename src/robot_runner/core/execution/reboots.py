"""Hosts that are started anew before runs, and awaited until they are ready again (`Host.reboot`)."""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from robot_runner.core.design.columns import REPETITION
from robot_runner.core.errors import CommandError, ExecutionError, Finding, LinkError
from robot_runner.core.events.measure import CONFIG_OWNER
from robot_runner.core.execution.aside import executed_aside
from robot_runner.core.execution.notices import FindingsNoticed, HostRestarts
from robot_runner.core.execution.places import Watch
from robot_runner.core.execution.task import AttemptStatus
from robot_runner.core.links.connect import is_simulated
from robot_runner.core.links.declared_host import Reboot
from robot_runner.core.links.host_commands import DeclaredHosts

if TYPE_CHECKING:
    from collections.abc import Callable

    from robot_runner.core.config.experiment import Experiment
    from robot_runner.core.events.context import RobotRunnerContext
    from robot_runner.core.execution.notices import Notice
    from robot_runner.core.execution.patience import Patience, Steps
    from robot_runner.core.execution.progress_manager import ProgressManager
    from robot_runner.core.execution.task import PendingRun, RunTask
    from robot_runner.core.links.declared_host import Host
    from robot_runner.core.links.host_commands import HostCommands, Shell

__all__ = ["Reboots", "restart"]

_log = logging.getLogger(__name__)

#: The id of the run that starting a host anew is, in its contexts.
_RUN = "reboot"
#: How often it is tried whether a host answers again, s.
_EVERY = 0.5
#: How long one question may take, s.
_ASKED = 15.0
#: Beyond the time for the host and for its condition, s: to begin and end the process that waits.
_PATIENCE = 30.0
#: What is another one each time that Linux starts.
_BOOT = "cat /proc/sys/kernel/random/boot_id"


@dataclass(frozen=True, slots=True)
class Reboots:
    """Starts hosts anew before the runs that their policies name.

    It is done in a process under a keeper, as a run is: what a condition opens there is gone with it.

    Args:
        experiment: whose hosts they are.
        progress: takes down what happens.
        notify: tells the screen.
        patience: what goes on meanwhile.
    """

    experiment: Experiment
    progress: ProgressManager
    notify: Callable[[Notice], None]
    patience: Patience

    def before(self, run: PendingRun, finished: PendingRun | None) -> Steps[None]:
        """Start those hosts anew that are to be before this run.

        Args:
            run: the run that comes.
            finished: the run before it, None before the first one of this session.

        Raises:
            ExecutionError: a host refused, or did not come back.
        """
        for name, host in self.experiment.parameters.hosts.items():
            if not self.patience.interruption.is_requested and self._is_due(host, run, finished):
                yield from self._restart(name, host, self.progress.task_of(run))

    def _is_due(self, host: Host, run: PendingRun, finished: PendingRun | None) -> bool:
        match host.reboot:
            case Reboot.NEVER:
                return False
            case Reboot.PER_RUN:
                return True
            case Reboot.ONCE:
                return finished is None
            case Reboot.PER_BLOCK:
                return finished is None or self._block(run) != self._block(finished)

    def _block(self, run: PendingRun) -> str | None:
        task, blocks = self.progress.task_of(run), self.experiment.model.blocks
        if blocks is None:
            return None
        return str(task.repetition if blocks == REPETITION else task.combination.get(blocks))

    def _restart(self, name: str, host: Host, task: RunTask) -> Steps[None]:
        self.notify(HostRestarts(name, task.run_id))
        facts: dict[str, Any] = {}

        def report(kind: str, fields: dict[str, Any]) -> None:
            if kind == "host_restarted":
                facts.update({key: value for key, value in fields.items() if key != "owner"})
            elif kind == "waited":
                self.progress.note(kind, host=name, next_run=task.run_id, **fields)

        def launch_mission(context: RobotRunnerContext) -> None:
            context.broker.note(CONFIG_OWNER, "host_restarted", restart(name, host, context))

        started, patience = time.monotonic(), self.patience
        robot = self.experiment.parameters.robot
        outcome = yield from executed_aside(
            self.experiment,
            replace(task, run_id=_RUN),
            launch_mission,
            Watch(patience.interruption, report),
            deadline_s=2 * host.back_within_s + _PATIENCE,
            robot=None if is_simulated(robot) else robot,  # hosts live by this machine's clock
        )
        seconds = round(time.monotonic() - started, 3)
        failure = "" if outcome.failure is None else outcome.failure.problem
        if outcome.status is AttemptStatus.INTERRUPTED:
            failure = "interrupted"
        self.progress.note("host_restarted", host=name, next_run=task.run_id, seconds=seconds, failure=failure, **facts)
        if facts.get("is_new_kernel") is False:
            problem = "the host went away and answers again, and its kernel was not started anew"
            finding = Finding.warning(f"hosts[{name!r}]", problem, f"Look at reboot_command: {host.reboot_command!r}.")
            self.notify(FindingsNoticed((finding,)))
        if outcome.status is AttemptStatus.FAILED:
            raise ExecutionError(
                f"the host {name} was to be started anew before {task.run_id}: {failure}",
                where=f"hosts[{name!r}]",
                fix="Then start the experiment again: it resumes.",
            )


def restart(name: str, host: Host, context: RobotRunnerContext) -> dict[str, Any]:
    """Start a host anew and wait until it answers again and its condition holds.

    Returns:
        how long it was away (s), and whether its kernel is another one; None where the host does not tell.

    Raises:
        LinkError: it refused, did not go away, or did not come back in time.
        ConditionError: it was not ready in time.
    """
    access = DeclaredHosts({name: host}).open(name, context)
    began = access.run(_BOOT, check=False, timeout_s=_ASKED).output.strip()
    shell = access.shell
    told = time.monotonic()
    try:
        access.run(host.reboot_command, timeout_s=min(_ASKED, host.back_within_s))
    except CommandError as error:
        if shell.is_alive:  # else the connection went before the command could say that it had succeeded
            raise LinkError(
                f"it cannot be started anew: {error.problem}",
                where=name,
                fix="Let this user do that without a password, or give another reboot_command.",
            ) from error
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
    """Wait until the host is gone."""
    while shell.is_alive:
        if time.monotonic() - told > host.back_within_s:
            raise LinkError(
                f"it was told to start anew ({host.reboot_command!r}), and was still there after "
                f"{host.back_within_s:g} s",
                where=name,
                fix="Look at reboot_command, or allow it more time (back_within_s).",
            )
        time.sleep(_EVERY / 10)


def _await_answer(name: str, host: Host, access: HostCommands, told: float) -> str:
    """Return which kernel runs on the host that answers again."""
    problem = ""
    while (left := host.back_within_s - (time.monotonic() - told)) > 0:
        try:
            return access.run(_BOOT, check=False, timeout_s=min(_ASKED, left)).output.strip()
        except LinkError as error:
            problem = error.problem
        time.sleep(_EVERY)
    raise LinkError(
        f"it did not come back within {host.back_within_s:g} s{f': {problem}' if problem else ''}",
        where=name,
        fix="Look at the host, or allow it more time (back_within_s).",
    )
