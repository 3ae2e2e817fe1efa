"""Notifications to a person elsewhere, sent by short-lived processes.

Apprise starts threads and waits for networks; the process that forks runs does neither. So each notification to each
address is sent by a process of its own (`notification_sender`), which ends after `_DEADLINE`. Addresses hold passwords:
they are passed through a pipe, and are in no message, record or command line; a service that fails is named by the
scheme of its address (`ntfy`, `mailto`).
"""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass

from robot_runner.core.config.experiment import Experiment
from robot_runner.core.config.notify import addresses_from
from robot_runner.core.errors import Finding, StorageError
from robot_runner.core.execution import notices
from robot_runner.core.execution.interruption import Interruption
from robot_runner.core.execution.task import AttemptStatus
from robot_runner.core.words import counted, one_line, shown_duration, shown_treatment

_MODULE = "robot_runner.core.execution.notification_sender"
#: How long the sending of one notification may take, s: mail servers think for a while.
_DEADLINE = 15.0
_LOOK = 0.02
#: A notification is sent of gates that are awaited for longer, s.
_GATE_PATIENCE = 60.0
#: The longest text that is sent, in characters: services cut longer ones.
_LONGEST = 1500


@dataclass(frozen=True, slots=True)
class _Message:
    """A notification; the kind is one of apprise's: `info`, `success`, `warning`, `failure`."""

    title: str
    body: str
    kind: str = "info"


class Notifications:
    """Sends the notifications that the config asks for (`notify`), without delaying the experiment."""

    def __init__(self, experiment: Experiment, note: Callable[..., None]) -> None:
        self._notify = experiment.parameters.notify
        self._name = experiment.parameters.experiment_name
        self._note = note
        self._addresses = addresses_from(self._notify) if self._notify else ()
        self._sending: list[tuple[str, subprocess.Popen[bytes]]] = []
        self._failed: dict[str, Finding] = {}
        self._told_gates: dict[str, str] = {}
        self._ended = self._done = self._run_count = 0
        self._failed_runs: set[str] = set()

    def take(self, notice: notices.Notice) -> None:
        """Send the notifications that are due on a notice."""
        if self._notify is None or not self._addresses:
            return
        self._reap()
        for message in self._messages(notice):
            self._send(message)

    def tell_failure(self, finding: Finding) -> None:
        """Send that the experiment could not go on."""
        if self._notify is not None and "end" in self._notify.on:
            self._send(_Message(f"{self._name} could not go on", one_line(str(finding)), "failure"))

    def findings(self, interruption: Interruption) -> tuple[Finding, ...]:
        """Wait until everything is sent, and return a finding for each kind of service that did not take something.

        The wait ends after the deadline, or when the user insists on the end.
        """
        end = time.monotonic() + _DEADLINE + 1.0
        while self._sending and time.monotonic() < end and not interruption.is_urgent:
            self._reap()
            time.sleep(_LOOK if self._sending else 0.0)
        for _, process in self._sending:
            process.kill()
            process.wait()
        self._reap()
        return tuple(self._failed.values())

    def _messages(self, notice: notices.Notice) -> Iterator[_Message]:
        wanted = self._notify.on if self._notify else ()
        match notice:
            case notices.ExperimentStarted():
                self._run_count, self._done = notice.run_count, notice.done_count
            case notices.NextDecided():
                self._run_count = notice.run_count
            case notices.AttemptFinished(task, outcome, is_last=True) if (
                outcome.status is not AttemptStatus.INTERRUPTED
            ):
                has_failed = outcome.status is AttemptStatus.FAILED
                self._done += not has_failed
                self._failed_runs.discard(task.run_id)  # another robot may have made up for it
                self._failed_runs.update([task.run_id] if has_failed else [])
                if has_failed and "failure" in wanted:
                    yield _Message(f"{self._name}: {task.run_id} failed", one_line(str(outcome.failure)), "warning")
                yield from self._progress()
            case notices.WaitingForUser() if "waiting" in wanted:
                what = notice.step or "may the next run start?"
                treatments = ", ".join(f"{name}={shown_treatment(each)}" for name, each in notice.combination.items())
                place = f", {notice.place}" if notice.place else ""
                when = "After" if notice.is_after else "Before"
                run = f"{notice.run_id}, run {notice.next_run_number} of {notice.run_count}{place}"
                body = f"{when} {run}: {treatments}"
                yield _Message(f"{self._name} waits for you: {what}", body, "warning")
            case notices.GateWaiting() if "waiting" in wanted and notice.seconds >= _GATE_PATIENCE:
                yield from self._gate(notice)
            case notices.ExperimentFinished() if "end" in wanted:
                yield self._end(notice)

    def _gate(self, waiting: notices.GateWaiting) -> Iterator[_Message]:
        if self._told_gates.get(waiting.run_id) != waiting.condition:
            self._told_gates[waiting.run_id] = waiting.condition
            body = f"Before {waiting.run_id}, until {waiting.condition}. Seen last: {waiting.seen or 'nothing'}"
            yield _Message(f"{self._name} waits", one_line(body), "warning")

    def _progress(self) -> Iterator[_Message]:
        self._ended += 1
        if self._notify is not None and self._notify.every and self._ended % self._notify.every == 0:
            failed = len(self._failed_runs)
            is_last = self._done + failed >= self._run_count
            body = "That was the last one that is planned." if is_last else "It goes on."
            yield _Message(f"{self._name}: {self._counts(self._done, self._run_count, failed)}", body)

    @staticmethod
    def _counts(done: int, run_count: int, failed: int) -> str:
        return f"{done:,} of {counted(run_count, 'run')} done" + (f", {failed:,} failed" if failed else "")

    def _end(self, finished: notices.ExperimentFinished) -> _Message:
        run_count = finished.done_count + finished.failed_count + finished.todo_count
        counts = self._counts(finished.done_count, run_count, finished.failed_count)
        why = " was interrupted" if finished.interrupted else " was stopped" if finished.stopped_by else " ended"
        body = [f"After {shown_duration(finished.seconds)}, on {socket.gethostname()}.", *finished.failures]
        kind = "failure" if finished.failed_count else "warning" if finished.todo_count else "success"
        return _Message(f"{self._name}{why}: {counts}", "\n".join(map(one_line, body)), kind)

    def _send(self, message: _Message) -> None:
        for address in self._addresses:
            service = one_line(address.partition("://")[0])[:20] if "://" in address else "an address"
            request: dict[str, object] = {"address": address, "title": message.title, "body": message.body[:_LONGEST]}
            request |= {"kind": message.kind, "deadline": _DEADLINE}
            try:
                # -P: modules beside a config must not take the place of those that apprise imports.
                process = subprocess.Popen(  # noqa: S603 - our own program
                    [sys.executable, "-P", "-m", _MODULE],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL,  # apprise writes addresses there
                    start_new_session=True,  # Ctrl-C in the terminal is not meant for it
                )
            except OSError as error:
                self._fail(service, f"could not be tried: {error.strerror}")
                continue
            self._sending.append((service, process))
            with suppress(OSError), process.stdin as pipe:  # type: ignore[union-attr]  # it is a pipe
                pipe.write(json.dumps(request).encode())

    def _reap(self) -> None:
        for service, process in self._sending:
            code = process.poll()
            if code:
                took_too_long = f"did not end within {_DEADLINE:g} s"
                self._fail(service, took_too_long if code < 0 else "did not take a notification")
        self._sending = [each for each in self._sending if each[1].returncode is None]

    def _fail(self, service: str, problem: str) -> None:
        if service in self._failed:
            return
        fix = "Look at its address and at the network; `apprise -vv` sends one by hand. Nothing else is affected."
        self._failed[service] = Finding.warning("notify", f"{service} {problem}", fix)
        with suppress(StorageError):  # a full disk is told elsewhere
            self._note("notification_failed", service=service, problem=problem)
