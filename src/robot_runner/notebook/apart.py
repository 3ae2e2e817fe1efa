"""An experiment executed in a process of its own, for a program that has threads, such as a notebook's."""

from __future__ import annotations

import io
import json
import logging
import os
import signal
import subprocess
import sys
import threading
import traceback
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict
from importlib import import_module
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn, Self

from robot_runner.core import errors
from robot_runner.core.errors import ExecutionError, Finding, RobotRunnerError, Severity
from robot_runner.core.execution.interruption import stop_signals_to_handle
from robot_runner.core.execution.notices import ExperimentFinished
from robot_runner.core.execution.processes import stop_with_parent

_log = logging.getLogger(__name__)

#: Executes the experiment, given what takes lines for the user.
Work = Callable[[Callable[[str], object]], ExperimentFinished]


def execute_in_interpreter(
    function: str, request: dict[str, Any], say: Callable[[str], object] | None
) -> ExperimentFinished:
    """Execute an experiment in a fresh interpreter, and return how it ended; see `execute_forked`.

    Args:
        function: `module:name` of what executes it, given the request and what takes lines.
        request: plain data; not among the words of the command, which every user of the machine can read.
        say: takes lines for the user; None for nobody.
    """
    reader, writer = os.pipe()
    line = [sys.executable, "-c", f"from {__name__} import be_requested; be_requested()", function, str(writer)]
    searched = (each for each in sys.path if isinstance(each, str) and each)  # as Python does, which takes no Path
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(searched)}
    with _Interrupts() as interrupts:
        process = subprocess.Popen(  # noqa: S603 - this interpreter, and our own program
            line, stdin=subprocess.PIPE, pass_fds=[writer], env=environment, start_new_session=True
        )
        os.close(writer)
        assert process.stdin is not None  # noqa: S101 - it is a pipe
        with suppress(BrokenPipeError), process.stdin as asked:  # it has ended already, which its code tells
            asked.write(json.dumps(request).encode())
        last = _followed(process.pid, reader, say, interrupts)
        code = process.wait()
    return _outcome(code, last, interrupts)


def be_requested() -> NoReturn:
    """Be the fresh interpreter: execute what the command line asks for."""
    function, writer = sys.argv[1:]
    request = json.load(sys.stdin)
    module, _, name = function.partition(":")
    execute = getattr(import_module(module), name)
    _be_apart(lambda tell: execute(request, tell), os.fdopen(int(writer), "wb", buffering=0))


def execute_forked(work: Work, say: Callable[[str], object] | None) -> ExperimentFinished:
    """Execute an experiment in one forked copy of this process, and return how it ended.

    The copy has one thread, which is its main one: it takes signals, and forks runs, as `robot-runner run` does. What
    its callbacks print is printed here. Ctrl-C, and a notebook's interrupt, ends it cleanly; it ends with this process.

    Args:
        work: what it executes.
        say: takes lines for the user; None for nobody.

    Raises:
        RobotRunnerError: what the experiment raised.
        KeyboardInterrupt: the user interrupted it before it had begun.
    """
    reader, writer = os.pipe()
    with _Interrupts() as interrupts:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of forking beside threads: the copy uses none of them
            pid = os.fork()
        if pid == 0:
            os.setsid()  # a notebook interrupts its whole process group, and then this process a second time
            os.close(reader)
            _be_apart(work, os.fdopen(writer, "wb", buffering=0))
        os.close(writer)
        last = _followed(pid, reader, say, interrupts)
        code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    return _outcome(code, last, interrupts)


class _Interrupts:
    """Passes Ctrl-C, and a notebook's interrupt, on to the copy, and raises nothing here meanwhile.

    Raised here, it would tear a record, or leave a copy that nobody follows; and in the copy, before that handles it, a
    second program would go on as if it were this one.

    Attributes:
        count: how many came.
    """

    def __init__(self) -> None:
        self.count = self._copy = 0

    def __enter__(self) -> Self:
        is_main = threading.current_thread() is threading.main_thread()  # nothing is raised in other threads
        self._earlier = signal.getsignal(signal.SIGINT) if is_main else None  # None also for one that is not Python's
        if self._earlier is not None:
            signal.signal(signal.SIGINT, self.take)
        return self

    def __exit__(self, *raised: object) -> None:
        if self._earlier is not None:
            signal.signal(signal.SIGINT, self._earlier)

    def pass_on_to(self, pid: int) -> None:
        """Pass them on to the copy from now on, and the first of those that came before."""
        self._copy = pid
        if self.count:
            self._interrupt()

    def stop_passing_on(self) -> None:
        """Pass no more of them on: the copy has ended."""
        self._copy = 0

    def take(self, _number: int = signal.SIGINT, _frame: FrameType | None = None) -> None:
        """Take one, and pass it on, if there is a copy to pass it on to."""
        self.count += 1
        self._interrupt()

    def _interrupt(self) -> None:
        if self._copy:
            with suppress(ProcessLookupError):
                os.kill(self._copy, signal.SIGINT)


def _followed(pid: int, reader: int, say: Callable[[str], object] | None, interrupts: _Interrupts) -> dict[str, Any]:
    """Pass on what the copy says, and return its last record."""
    last: dict[str, Any] = {}
    takers = {"print": _print, "say": say}
    with os.fdopen(reader, "rb") as records:
        for line in records:
            record = json.loads(line)
            if kind := next((each for each in takers if each in record), None):
                try:
                    takers[kind] = _told(takers[kind], record[kind])
                except KeyboardInterrupt:  # raised by what takes the lines
                    interrupts.take()
            elif "listens" in record:
                interrupts.pass_on_to(pid)
            else:
                last = record
    interrupts.stop_passing_on()
    return last


def _print(text: str) -> None:
    encoding = getattr(sys.stdout, "encoding", None) or "utf-8"
    sys.stdout.write(text.encode(encoding, "replace").decode(encoding))


def _told(take: Callable[[str], object] | None, text: str) -> Callable[[str], object] | None:
    """Pass a text on, and return what takes the next one: nothing once it has failed, as the experiment goes on."""
    try:
        if take is not None:
            take(text)
    except Exception:  # noqa: BLE001 - it is the user's, and may fail in any way
        _log.exception("What takes the lines failed; the experiment goes on.")
        return None
    return take


def _outcome(code: int, last: dict[str, Any], interrupts: _Interrupts) -> ExperimentFinished:
    if interrupts.count and not last.keys() & {"error", "finished"}:
        raise KeyboardInterrupt
    if "findings" in last:
        kind = getattr(errors, str(last.get("error")), ExecutionError)
        findings = [Finding(Severity(each.pop("severity")), **each) for each in last["findings"]]
        raise kind.of_findings(findings)
    if "finished" not in last:
        problem = f"the process that executed the experiment ended with code {code}"
        raise ExecutionError(problem, where="run_experiment", fix="Call it again: it resumes.")
    facts = last["finished"]
    facts["findings"] = tuple(Finding(Severity(each.pop("severity")), **each) for each in facts["findings"])
    return ExperimentFinished(**facts | {"folder": Path(facts["folder"]), "run_table": Path(facts["run_table"])})


class _Told(io.TextIOBase):
    """What is printed in the copy, on its way to the process that shows it."""

    def __init__(self, tell: Callable[[dict[str, Any]], None]) -> None:
        self._tell = tell

    def writable(self) -> bool:
        """Say that it can be written to."""
        return True

    def write(self, text: str) -> int:
        """Pass a text on."""
        self._tell({"print": text})
        return len(text)


def _be_apart(work: Work, records: io.FileIO) -> NoReturn:
    """Execute the experiment in the copy, and leave without what the copied program would do at its end."""
    code = 1
    try:
        stop_with_parent()
        stops = stop_signals_to_handle()

        def tell(record: dict[str, Any]) -> None:
            left = memoryview(json.dumps(record, default=str).encode() + b"\n")
            earlier = signal.pthread_sigmask(signal.SIG_BLOCK, stops)  # what their handlers raise would tear the line
            try:
                with suppress(BrokenPipeError):
                    while left:  # other signals let the system write a part
                        left = left[records.write(left) :]
            finally:
                signal.pthread_sigmask(signal.SIG_SETMASK, earlier)

        sys.stdin = open(os.devnull, encoding="utf-8")  # noqa: SIM115, PTH123 - as long as the process
        sys.stdout = sys.stderr = _Told(tell)
        _tell_outcome(work, tell, stops)
        code = 0
    finally:
        os._exit(code)


def _tell_outcome(work: Work, tell: Callable[[dict[str, Any]], None], stops: Sequence[signal.Signals]) -> None:
    try:
        for number in stops:
            signal.signal(number, signal.default_int_handler)
        tell({"listens": True})
        finished = work(lambda line: tell({"say": line}))
        tell({"finished": {**_plain(finished), "findings": list(map(_plain, finished.findings))}})
    except RobotRunnerError as error:
        tell({"error": type(error).__name__, "findings": list(map(_plain, error.findings))})
    except BaseException as error:  # noqa: BLE001 - it is told, whatever it is
        is_interrupted = isinstance(error, KeyboardInterrupt)
        if not is_interrupted:
            traceback.print_exc()
        fix = "Call it again." if is_interrupted else "Look at the traceback."
        finding = Finding.error("run_experiment", f"{type(error).__name__}: {error}", fix)
        kind = "interrupted" if is_interrupted else "error"
        tell({kind: "ExecutionError", "findings": [_plain(finding)]})


def _plain(value: Any) -> dict[str, Any]:
    plain = asdict(value)
    if isinstance(value, Finding):
        plain["severity"] = value.severity.value
    return plain
