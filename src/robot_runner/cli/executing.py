"""Executes an experiment and shows it on the screen, with a live page beside it if requested."""

from __future__ import annotations

import os
import re
import select
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from robot_runner.cli.console import is_live_terminal, output
from robot_runner.cli.findings import show_findings
from robot_runner.cli.guard import INTERRUPTED, SOME_FAILED
from robot_runner.cli.harmless_stream import DroppedOutput, let_go_of
from robot_runner.cli.screens.live import LiveScreen
from robot_runner.cli.screens.plain import PlainScreen
from robot_runner.cli.screens.progress import Progress
from robot_runner.core.config.experiment import Experiment
from robot_runner.core.errors import ExecutionError, Finding, RobotRunnerError
from robot_runner.core.execution.notices import ExperimentFinished
from robot_runner.core.execution.orchestrator import execute_experiment
from robot_runner.core.execution.resumption import Resumption

#: How long the page may take to listen, and to end, s; a Raspberry Pi takes some seconds to import its libraries.
_DEADLINE, _ENDING = 60.0, 3.0
_HERE = "127.0.0.1"
_PLACE = re.compile(r"^(?:--host|--port|\S+:\d+): ")


@dataclass(frozen=True, slots=True)
class Execution:
    """How an experiment was executed.

    Attributes:
        was_shown_live: whether the table of its runs is on the terminal already.
        failure: the errors by which it could not go on, or not end as it should.
    """

    progress: Progress
    was_shown_live: bool
    failure: Sequence[Finding] = ()

    @property
    def finished(self) -> ExperimentFinished | None:
        """How it ended; None where it could not even tell that."""
        return self.progress.finished

    @property
    def exit_code(self) -> int:
        """0: all chosen runs are done; 1: a run failed, or the experiment could not go on; 130: the user ended it."""
        if self.finished is None or self.failure:
            return SOME_FAILED
        if self.finished.interrupted:
            return INTERRUPTED
        return SOME_FAILED if self.finished.failed_count or self.finished.stopped_by else 0


def execute_on_screen(
    experiment: Experiment,
    findings: Sequence[Finding] = (),
    *,
    plain: bool,
    resumption: Resumption | None = None,
    waits_for_claims: bool = False,
) -> Execution:
    """Execute an experiment and show it; with `waits_for_claims` it waits where another one has claimed the same.

    Raises:
        RobotRunnerError: it cannot start.
    """
    with DroppedOutput():
        kind = LiveScreen if is_live_terminal(sys.stdout) and not plain else PlainScreen
        screen = kind(output(), experiment, time.monotonic)
        failure: Sequence[Finding] = ()
        try:
            with screen:
                execute_experiment(
                    experiment, screen, findings=findings, resumption=resumption, waits_for_claims=waits_for_claims
                )
        except RobotRunnerError as error:
            if not screen.progress.has_begun:
                raise
            failure = error.findings
            show_findings(failure)  # it was not refused: it could not go on
        return Execution(screen.progress, was_shown_live=isinstance(screen, LiveScreen), failure=failure)


@contextmanager
def read_or_not() -> Iterator[None]:
    """While the end is printed: ignore a broken pipe, which is no failure of the experiment."""
    try:
        yield
        sys.stdout.flush()
    except OSError:  # a closed pipe, or a terminal that is gone
        let_go_of(sys.stdout)


@contextmanager
def page_beside(folder: Path, address: str | None) -> Iterator[str]:
    """Serve the page of an experiment while the block lasts (`HOST:PORT`, HOST, or None for this machine alone).

    Raises:
        ExecutionError: the page cannot be served; the message says why.
    """
    host, port = (None, None) if address is None else _parts(address)
    words = [f"{option}={value}" for option, value in (("--host", host), ("--port", port)) if value is not None]
    command = [sys.executable, "-P", "-m", "robot_runner", "watch", str(folder), "--until-closed", *words]
    # In a session of its own: Ctrl-C is for the experiment alone; the page goes on and shows how that ends.
    with subprocess.Popen(  # noqa: S603 - our own program
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True
    ) as page:
        try:
            yield _told(page, address)
        finally:
            _end(page)


def _parts(address: str) -> tuple[str | None, str | None]:
    """Return host and port of `HOST:PORT`, each None where it is left out.

    Example:
        >>> [_parts(each) for each in ("0.0.0.0", ":8080", "[::1]:8080", "::1")]
        [('0.0.0.0', None), (None, '8080'), ('[::1]', '8080'), ('::1', None)]
    """
    host, colon, port = address.rpartition(":")
    if not colon or (":" in host and not host.endswith("]")):  # an IPv6 address without brackets has no port
        return address, None
    return host or None, port


def _told(page: subprocess.Popen[bytes], address: str | None) -> str:
    """Return the output of the page, once it listens.

    Raises:
        ExecutionError: it ended, or did not listen in time.
    """
    said, end = b"", time.monotonic() + _DEADLINE
    while page.stdout is not None:
        ready, _, _ = select.select([page.stdout], [], [], max(0.0, end - time.monotonic()))
        if not ready:
            raise _refused(f"the live page does not listen after {_DEADLINE:g} s", "", address)
        piece = os.read(page.stdout.fileno(), 65536)
        if not piece:
            break
        said += piece
    text = said.decode("utf-8", "replace")
    with suppress(subprocess.TimeoutExpired):
        page.wait(0.1 if text.startswith("Live page") else _ENDING)
        raise _refusal(text, address)
    return text


def _refusal(text: str, address: str | None) -> ExecutionError:
    """Return the page's error in terms of the option that asked for it: the page knows only those of `watch`."""
    lines = [line.strip() for line in text.splitlines()]
    problem = next((line.removeprefix("error: ") for line in lines if line.startswith("error: ")), "the page ended")
    fix = next((line.removeprefix("fix: ") for line in lines if line.startswith("fix: ")), "")
    host = (_parts(address)[0] if address else None) or _HERE
    return _refused(_PLACE.sub("", problem, count=1), re.sub(r"--port (\d+)", rf"--page-at {host}:\1", fix), address)


def _refused(problem: str, fix: str, address: str | None) -> ExecutionError:
    option = "--page" if address is None else "--page-at"
    return ExecutionError(problem, where=f"{option} {address or ''}".strip(), fix=fix or f"Leave {option} out.")


def _end(page: subprocess.Popen[bytes]) -> None:
    if page.stdin is not None:
        with suppress(OSError):
            page.stdin.close()
    try:
        page.wait(_ENDING)
    except subprocess.TimeoutExpired:
        page.kill()
