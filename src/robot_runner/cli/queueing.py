"""Experiments of the queue, executed one after another, each by a process of its own.

`QueueRunner` starts a process for each. That process, and not the runner, takes the experiment from the queue and
writes down how it ended. So either of the two may be killed: without the runner the experiment goes on, and without its
own process it is begun again when the queue is executed next.
"""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from types import FrameType

from robot_runner.cli.commands import run
from robot_runner.cli.console import command_line
from robot_runner.cli.findings import show_findings
from robot_runner.cli.guard import INTERRUPTED, REFUSED, SOME_FAILED, guarded
from robot_runner.cli.parser import parser_of
from robot_runner.cli.queued_experiments import ExperimentQueue, QueuedExperiment
from robot_runner.core.errors import ExecutionError, Finding, RobotRunnerError, StorageError
from robot_runner.core.execution.experiment_status import read_status
from robot_runner.core.execution.interruption import stop_signals_handled
from robot_runner.core.links.commanded_topics import MAY_BE_MOVING, MOVING_ROBOT
from robot_runner.core.storage.claim_locks import claim_holders
from robot_runner.core.storage.journal import utc_now
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.lock import holder_of

#: Variables that say which robot a config means; an experiment has them as they were when it was added.
NAMES_A_ROBOT = ("ROS_DOMAIN_ID", "ROS_MASTER_URI", "ROS_NAMESPACE")
#: Tells the process of an experiment that a runner has begun it, and no user who is to be told that it is executed.
_BY_RUNNER = "ROBOT_RUNNER_QUEUE_RUNNER"
#: How often to look whether something can begin, s.
_LOOK = 0.5
#: How long to rest before an experiment is begun again whose process was killed, s: at first, and at most.
_REST, _LONGEST_REST = 1.0, 60.0


def named(queued: QueuedExperiment) -> str:
    """Return the name of a queued experiment in messages."""
    return f"{queued.number} ({queued.experiment})"


def digest_of(config: str) -> str:
    """Return the SHA-256 of a config file; raise a `StorageError` if it cannot be read."""
    try:
        return hashlib.sha256(Path(config).read_bytes()).hexdigest()
    except OSError as error:
        fix = "Put it back, or take the experiment out of the queue: robot-runner queue drop"
        raise StorageError(f"the config cannot be read: {error.strerror}", where=config, fix=fix) from error


# Which experiment waits for which.


def awaited_by(queue: ExperimentQueue, queued: QueuedExperiment, known: Sequence[QueuedExperiment]) -> str:
    """Return in words why an experiment waits, and since when; empty where it could begin. `known` is the queue."""
    others = [each for each in claim_holders(queued.claims).items() if each[1].folder != queued.results]
    if others:
        return "; ".join(f"{claim}, in use by {holder.in_words()}" for claim, holder in others)
    if not queue.is_taken(queued.number) and (holder := holder_of(ExperimentFolder(Path(queued.results)).lock)):
        return f"process {holder.pid}, which executes the same experiment since {holder.since}"
    for each in known:
        shared = sorted({*each.claims, each.results} & {*queued.claims, queued.results})
        if shared and each.may_have_left_a_robot_moving:
            look = f"look at it, then take it out: robot-runner queue drop {each.number}"
            return f"{named(each)}, after which {MAY_BE_MOVING}: {look}"
        if shared and each.number < queued.number and not each.has_ended:
            return f"{named(each)}, which wants {', '.join(shared)} and is in the queue since {each.added_at}"
    return ""


# One experiment, in a process of its own.


def execute_queued(queue: ExperimentQueue, number: int) -> int:
    """Execute an experiment of the queue in this process, note how it ended, and return the exit code.

    One that is interrupted stays in the queue, to be resumed later.

    Raises:
        ExecutionError: there is none of this number, it has ended, or another process executes it.
    """
    is_of_runner = os.environ.pop(_BY_RUNNER, "") != ""  # which goes on with what is left where another was faster
    with ExitStack() as held:
        try:
            held.enter_context(queue.taken(number))
        except ExecutionError:
            if is_of_runner:
                return REFUSED
            raise
        queued = queue.read_one(number)
        if queued is None or queued.has_ended:
            if is_of_runner:
                return REFUSED
            problem = f"experiment {number} is not in the queue, or has ended"
            raise ExecutionError(problem, where="robot-runner queue", fix="See `robot-runner queue list`.")
        code, problem = _end_of_earlier(queued)
        if code is None:
            queued = replace(queued, began_at=queued.began_at or utc_now(), problem=_change(queued))
            queue.write(queued)
            code, problem = _executed(queued)
        if code != INTERRUPTED:
            told = "; ".join(filter(None, (queued.problem, problem)))
            queue.write(replace(queued, ended_at=utc_now(), exit_code=code, problem=told))
    return code


def _end_of_earlier(queued: QueuedExperiment) -> tuple[int | None, str]:
    """Return how an experiment ended whose process was killed before noting it; None if it has not ended."""
    try:
        status = read_status(Path(queued.results)) if queued.began_at else None
    except RobotRunnerError:
        return None, ""
    if status is None or status.holder or status.todo or not (status.finished_at and queued.began_at):
        return None, ""
    if datetime.fromisoformat(status.finished_at) < datetime.fromisoformat(queued.began_at):
        return None, ""
    return (SOME_FAILED, _reason(SOME_FAILED, queued)) if status.failed else (0, "")


def _change(queued: QueuedExperiment) -> str:
    """Print to stderr, and return, that the config has changed since the experiment was added; empty if not."""
    try:
        is_changed = digest_of(queued.config) != queued.config_sha256
    except StorageError:
        return ""  # this is reported as the reason why it was not executed
    if not is_changed:
        return ""
    problem = f"the config has changed since it was added at {queued.added_at}; it is executed as it is now"
    show_findings([Finding.warning(queued.config, problem)])
    return problem


def _executed(queued: QueuedExperiment) -> tuple[int, str]:
    """Execute it as `robot-runner run` does, and return the exit code, and the problem."""
    reason: list[str] = []

    def executed() -> int:
        try:
            digest_of(queued.config)
            given = parser_of("run", run).parse([queued.config, *queued.options, "--wait"])
            code, facts = run.prepare_and_execute(given)
        except RobotRunnerError as error:
            reason.append(str(error.findings[0]))
            raise
        if facts.get("stopped_by") == MOVING_ROBOT:
            reason.append(f"{MAY_BE_MOVING}; {_reason(code, queued)}")
        return code

    code = guarded(executed)
    return code, next(iter(reason), _reason(code, queued))


def _reason(code: int, queued: QueuedExperiment) -> str:
    reasons = {
        0: "",
        SOME_FAILED: f"some run failed: {command_line('status', queued.results)}",
        REFUSED: f"it was refused: {command_line('check', queued.config)}",
    }
    return reasons.get(code, f"it ended with exit code {code}")


# All of them.


class QueueRunner:
    """Executes the queue: the first experiment whose claims are free, then the next, until none is left.

    None overtakes an earlier one that claims the same. Several runners may work at once, each on another experiment. A
    stop signal is passed on to the experiment that is being executed; the runner ends after it. With `stays`, it waits
    for more where none is left.
    """

    def __init__(self, queue: ExperimentQueue, *, stays: bool = False) -> None:
        self._queue = queue
        self._stays = stays
        self._process: subprocess.Popen[bytes] | None = None
        self._asked: list[int] = []
        self._is_ending = False
        self._told = ""
        self._rest = 0.0

    def execute(self) -> int:
        """Execute them, and return the exit code: 1 where one failed or was refused, 130 where the user ended it."""
        failed = False
        with self._queue.attended(), stop_signals_handled(self._take_signal):
            while not self._is_ending:
                known = self._known()
                left = [each for each in known if not each.has_ended]
                if not left and not self._stays:
                    return SOME_FAILED if failed else 0
                following = next((each for each in left if self._may_begin(each, known)), None)
                if following is None:
                    self._tell_waiting(left, known)
                    time.sleep(_LOOK)
                    continue
                failed = self._execute_one(following) or failed
        return INTERRUPTED

    def _known(self) -> list[QueuedExperiment]:
        known, findings = self._queue.read()
        self._tell("; ".join(map(str, findings)), findings)
        return known

    def _may_begin(self, queued: QueuedExperiment, known: Sequence[QueuedExperiment]) -> bool:
        return not self._queue.is_taken(queued.number) and not awaited_by(self._queue, queued, known)

    def _execute_one(self, queued: QueuedExperiment) -> bool:
        """Execute an experiment in a process of its own; return whether it has failed."""
        print(f"{named(queued)} of the queue begins: {queued.config}", flush=True)
        try:
            code = self._code_of(queued)
            how = f"was killed by signal {-code}" if code < 0 else f"ended with exit code {code}"
        except OSError as error:  # the system has no process left for it, mostly for a while
            code, how = SOME_FAILED, f"cannot be started: {error.strerror}"
        after = self._queue.read_one(queued.number)
        if after is not None and after.has_ended:
            self._rest = 0.0
            how = after.problem or "all that was asked for is done"
            print(f"{named(queued)} of the queue has ended: {how}", flush=True)
            return after.exit_code != 0
        if code == INTERRUPTED:
            self._is_ending = True
        if self._is_ending:
            print(f"{named(queued)} stays in the queue; to go on: robot-runner queue run", flush=True)
        elif after is not None and not self._queue.is_taken(queued.number):
            self._rest = min(_LONGEST_REST, 2 * self._rest or _REST)
            print(f"the process of {named(queued)} {how}; it is begun again in {self._rest:g} s", flush=True)
            self._sleep(self._rest)
        elif after is not None:
            print(f"{named(queued)} of the queue is executed by another process", flush=True)
        return False

    def _code_of(self, queued: QueuedExperiment) -> int:
        environment = {name: text for name, text in os.environ.items() if name not in NAMES_A_ROBOT}
        python = queued.python
        if not os.access(python, os.X_OK):
            python = sys.executable
            print(f"{queued.python}, with which it was added, is gone: {python} executes it", flush=True)
        # No input: a queue goes on without its user. A session of its own: so each signal arrives once.
        with subprocess.Popen(  # noqa: S603 - our own program
            [python, "-P", "-m", "robot_runner", "queue", "run", str(queued.number)],
            stdin=subprocess.DEVNULL,
            cwd=queued.started_in if Path(queued.started_in).is_dir() else None,
            env={**environment, **queued.environment, _BY_RUNNER: "1"},
            start_new_session=True,
        ) as process:
            self._process = process
            self._pass_on()
            try:
                return process.wait()
            finally:
                self._process = None

    def _take_signal(self, number: int, _frame: FrameType | None) -> None:
        self._is_ending = True
        self._asked.append(number)
        self._pass_on()

    def _pass_on(self) -> None:
        """Send each signal to the experiment once, also one that came before its process had started."""
        while self._process is not None and self._asked:
            self._process.send_signal(self._asked.pop(0))

    def _sleep(self, seconds: float) -> None:
        until = time.monotonic() + seconds
        while not self._is_ending and time.monotonic() < until:
            time.sleep(min(_LOOK, seconds))

    def _tell_waiting(self, left: Sequence[QueuedExperiment], known: Sequence[QueuedExperiment]) -> None:
        free = [each for each in left if not self._queue.is_taken(each.number)]
        waiting = [(each, awaited_by(self._queue, each, known)) for each in free]
        self._tell("\n".join(f"{named(each)} waits for {awaited}" for each, awaited in waiting if awaited))

    def _tell(self, text: str, findings: Sequence[Finding] = ()) -> None:
        """Print a text, unless it was the last one printed."""
        if text == self._told:
            return
        if findings:
            show_findings(findings)
            self._told = text
        elif text:
            print(text, flush=True)
            self._told = text
