"""An experiment executed in a process of its own, for a program that has threads, such as a notebook's."""

from __future__ import annotations

import io
import json
import logging
import os
import signal
import subprocess
import sys
import traceback
import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict
from importlib import import_module
from pathlib import Path
from typing import Any, NoReturn

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
    program = f"from {__name__} import be_requested; be_requested()"
    line = [sys.executable, "-c", program, function, str(writer)]
    searched = (each for each in sys.path if isinstance(each, str) and each)  # as Python does, which takes no Path
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(searched)}
    process = subprocess.Popen(  # noqa: S603 - this interpreter, and our own program
        line, stdin=subprocess.PIPE, pass_fds=[writer], env=environment, start_new_session=True
    )
    os.close(writer)
    assert process.stdin is not None  # noqa: S101 - it is a pipe
    with suppress(BrokenPipeError), process.stdin as asked:  # it has ended already, which its code tells
        asked.write(json.dumps(request).encode())
    last = _followed(process.pid, reader, say)
    return _outcome(process.wait(), last)


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
    """
    reader, writer = os.pipe()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of forking beside threads: the copy uses none of them
        pid = os.fork()
    if pid == 0:
        os.setsid()  # a notebook interrupts its whole process group, and then this process a second time
        os.close(reader)
        _be_apart(work, os.fdopen(writer, "wb", buffering=0))
    os.close(writer)
    last = _followed(pid, reader, say)
    return _outcome(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]), last)


def _followed(pid: int, reader: int, say: Callable[[str], object] | None) -> dict[str, Any]:
    """Pass on what the copy says, and return its last record."""
    last: dict[str, Any] = {}
    takers = {"print": _print, "say": say}
    with os.fdopen(reader, "rb") as records:
        while True:
            try:
                line = records.readline()
                if not line:
                    break
                record = json.loads(line)
                if kind := next((each for each in takers if each in record), None):
                    takers[kind] = _told(takers[kind], record[kind])
                else:
                    last = record
            except KeyboardInterrupt:
                with suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGINT)
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


def _outcome(code: int, last: dict[str, Any]) -> ExperimentFinished:
    if "error" in last:
        kind = getattr(errors, str(last["error"]), ExecutionError)
        findings = [Finding(Severity(each.pop("severity")), **each) for each in last["findings"]]
        raise kind.of_findings(findings)
    if "finished" not in last:
        raise ExecutionError(
            f"the process that executed the experiment ended with code {code}",
            where="run_experiment",
            fix="Call it again: it resumes.",
        )
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
    stop_with_parent()
    stops = stop_signals_to_handle()
    for number in stops:
        signal.signal(number, signal.default_int_handler)

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
    code = 1
    try:
        finished = work(lambda line: tell({"say": line}))
        tell({"finished": {**_plain(finished), "findings": list(map(_plain, finished.findings))}})
        code = 0
    except RobotRunnerError as error:
        tell({"error": type(error).__name__, "findings": list(map(_plain, error.findings))})
    except BaseException as error:  # noqa: BLE001 - it is told, whatever it is
        traceback.print_exc()
        finding = Finding.error("run_experiment", f"{type(error).__name__}: {error}", "Look at the traceback.")
        tell({"error": "ExecutionError", "findings": [_plain(finding)]})
    finally:
        os._exit(code)


def _plain(value: Any) -> dict[str, Any]:
    plain = asdict(value)
    if isinstance(value, Finding):
        plain["severity"] = value.severity.value
    return plain
