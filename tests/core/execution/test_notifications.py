"""Notifications, sent by apprise to real HTTP servers on this machine: one that takes them, and one that hangs."""

from __future__ import annotations

import json
import os
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import pytest
from tests.conftest import written_config
from tests.core.execution.conftest import RecordingObserver

from robot_runner.core.config import notify as notify_module
from robot_runner.core.config.preparation import prepare, prepare_or_refuse
from robot_runner.core.errors import ExecutionError
from robot_runner.core.execution import notifications
from robot_runner.core.execution.interruption import Interruption
from robot_runner.core.execution.notices import AttemptFinished, ExperimentStarted, GateWaiting, WaitingForUser
from robot_runner.core.execution.notifications import Notifications
from robot_runner.core.execution.orchestrator import execute_experiment
from robot_runner.core.execution.processes import children
from robot_runner.core.execution.task import AttemptStatus, RunOutcome, RunTask

if TYPE_CHECKING:
    from robot_runner.core.execution.notices import Notice

Execute = Callable[..., Any]
pytest.importorskip("apprise")
SECRET = "hunter2secret"  # noqa: S105 - it stands for one
# The runs are not forked from here: a server has threads.
HERE = "run_process = RunProcess.IN_PROCESS\n"


class Server:
    """An HTTP server that keeps what it was sent."""

    def __init__(self) -> None:
        self.messages: list[dict[str, Any]] = []
        keep = self.messages.append

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                keep(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
                self.send_response(200)
                self.end_headers()

            def log_message(self, *words: object) -> None:
                pass

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self._thread = threading.Thread(target=self._server.serve_forever)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *raised: object) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

    @property
    def address(self) -> str:
        return f"json://user:{SECRET}@127.0.0.1:{self._server.server_port}/"

    @property
    def titles(self) -> list[str]:
        return [message["title"] for message in self.messages]


@pytest.fixture(autouse=True)
def _busy_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    """Wait as long as a busy machine needs to import apprise."""
    monkeypatch.setattr(notifications, "_DEADLINE", 120.0)


@pytest.fixture
def server() -> Iterator[Server]:
    with Server() as served:
        yield served


@contextmanager
def hanging_server() -> Iterator[str]:
    """A server that takes connections and never answers."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        yield f"json://user:{SECRET}@127.0.0.1:{listening.getsockname()[1]}/?rto=60&cto=60"


@pytest.mark.long
def test_somebody_is_told_of_failures_progress_and_the_end_and_the_address_stays_secret(
    execute: Execute, server: Server, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("ROBOT_RUNNER_NOTIFY", f"# the lab\n{server.address}\n")
    executed = execute(
        f"""
        {HERE}
        notify = Notify(every=2)
        def launch_mission(self, context): assert context.run_id != "r_2", "the lamp is off"
        """
    )
    assert sorted(server.titles) == [
        "trial ended: 3 of 4 runs done, 1 failed",
        "trial: 1 of 4 runs done, 1 failed",
        "trial: 3 of 4 runs done, 1 failed",
        "trial: r_2 failed",
    ]
    told = {each["title"]: each["message"] for each in server.messages}
    assert told["trial: 1 of 4 runs done, 1 failed"] == "It goes on."
    assert told["trial: 3 of 4 runs done, 1 failed"] == "That was the last one that is planned."
    failure = next(each for each in server.messages if each["title"] == "trial: r_2 failed")
    assert failure["message"] == "launch_mission of config: AssertionError: the lamp is off"
    assert failure["type"] == "warning"
    assert not any("notify" in finding.where for finding in executed.finished.findings)
    kept = [path.read_bytes() for path in executed.config.parent.rglob("*") if path.is_file()]
    said = capfd.readouterr()
    assert not any(SECRET.encode() in text for text in [*kept, said.out.encode(), said.err.encode()])


@pytest.mark.long
def test_a_gate_that_waits_for_long_is_told_once(
    server: Server, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("ROBOT_RUNNER_NOTIFY", server.address)
    experiment = prepare_or_refuse(written_config(tmp_path, "notify = Notify()"))
    sent = Notifications(experiment, lambda *_, **__: None)
    for seconds in (0.5, 60.0, 60.5, 61.0):
        sent.take(GateWaiting("r_3", 3, 4, "the CPU is below 50 °C", "52.3 °C", seconds, None))
    with Interruption() as interruption:
        assert sent.findings(interruption) == ()
    assert [(each["title"], each["message"]) for each in server.messages] == [
        ("trial waits", "Before r_3, until the CPU is below 50 °C. Seen last: 52.3 °C")
    ]


@pytest.fixture
def titles(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[[list[Notice], str], list[str]]:
    """Return what takes notices and returns the titles of what would be sent."""

    def sent(taken: list[Notice], asked: str = "") -> list[str]:
        experiment = prepare_or_refuse(written_config(tmp_path, f"notify = Notify({asked})"))
        messages: list[Any] = []
        told = Notifications(experiment, lambda *_, **__: None)
        monkeypatch.setattr(told, "_send", messages.append)
        for each in taken:
            told.take(each)
        return [f"{each.title}: {each.body.splitlines()[0]}" for each in messages]

    monkeypatch.setenv("ROBOT_RUNNER_NOTIFY", "json://127.0.0.1:9/")
    return sent


def test_gates_that_wait_side_by_side_are_told_once_each(titles: Callable[..., list[str]]) -> None:
    robots = [GateWaiting(run, 3, 4, "the battery is charged", "70 %", 60.0, None) for run in ("r_3", "r_4")]
    told = titles(robots * 5)
    assert [each.partition(",")[0] for each in told] == ["trial waits: Before r_3", "trial waits: Before r_4"]


def test_a_run_that_another_robot_makes_up_for_has_not_failed(titles: Callable[..., list[str]]) -> None:
    def ended(run: str, status: AttemptStatus) -> AttemptFinished:
        task = RunTask(run, 1, 3, 1, {}, 1, 0, 0)
        return AttemptFinished(task, RunOutcome(status), is_last=True)

    failed, done = AttemptStatus.FAILED, AttemptStatus.DONE
    runs = [ended("r_1", failed), ended("r_2", done), ended("r_1", done), ended("r_3", failed)]
    begun = ExperimentStarted("trial", Path(), 4, 0, 1, {}, {})
    assert titles([begun, *runs], "on=[], every=1") == [
        "trial: 0 of 4 runs done, 1 failed: It goes on.",
        "trial: 1 of 4 runs done, 1 failed: It goes on.",
        "trial: 2 of 4 runs done: It goes on.",
        "trial: 2 of 4 runs done, 1 failed: It goes on.",
    ]


class Leaving(RecordingObserver):
    """Somebody who presses Ctrl-C when they are asked."""

    def notice(self, notice: Notice) -> None:
        if isinstance(notice, WaitingForUser):
            os.kill(os.getpid(), signal.SIGINT)


@pytest.mark.long
def test_who_is_waited_for_and_what_cannot_go_on_is_told(server: Server, tmp_path: Path) -> None:
    (tmp_path / "addresses").write_text(server.address, encoding="utf-8")
    config = written_config(
        tmp_path,
        f"""
        notify = Notify(on=["end", "waiting"], url_from={str(tmp_path / "addresses")!r})
        operator_steps = [OperatorStep("swap the battery")]
        def after_experiment(self): raise ValueError("no lamp")
        """,
    )
    with pytest.raises(ExecutionError):
        execute_experiment(prepare_or_refuse(config), Leaving())
    told = {each["title"]: each["message"] for each in server.messages}
    assert told["trial waits for you: swap the battery"] == "Before r_1, run 1 of 4: Task=Video"
    assert told["trial could not go on"].startswith("after_experiment of config: ValueError: no lamp")


@pytest.mark.long
def test_a_server_that_hangs_holds_no_run_up_and_is_warned_of_once(
    execute: Execute, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(notifications, "_DEADLINE", 5.0)
    with hanging_server() as address:
        monkeypatch.setenv("ROBOT_RUNNER_NOTIFY", address)
        before = set(children())  # of other tests
        started = time.monotonic()
        executed = execute(
            f"""
            {HERE}
            notify = Notify(every=4)
            def after_experiment(self):
                (Path(__file__).parent / "runs_over").write_text(str(__import__("time").monotonic()))
            """
        )
    runs_over = float((executed.config.parent / "runs_over").read_text())
    assert executed.finished.done_count == 4
    assert time.monotonic() - runs_over < 30
    told = [str(each) for each in executed.finished.findings if each.where == "notify"]
    assert len(told) == 1
    assert "json did not end within 5 s" in told[0]
    assert [each["service"] for each in executed.journal("notification_failed")] == ["json"]
    assert started < runs_over
    assert set(children()) <= before, "nobody is left"


@pytest.mark.long
def test_services_that_take_nothing_are_warned_of_by_their_scheme_alone(
    execute: Execute, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROBOT_RUNNER_NOTIFY", f"nonsense://{SECRET}\njson://127.0.0.1:1/{SECRET}")
    executed = execute(f"{HERE}\nnotify = Notify(every=4)")
    told = sorted(str(each) for each in executed.finished.findings if each.where == "notify")
    assert len(told) == 2
    assert "json did not take a notification" in told[0]
    assert "nonsense did not take a notification" in told[1]
    assert not any(SECRET in each for each in told)
    assert sorted(each["service"] for each in executed.journal("notification_failed")) == ["json", "nonsense"]


@pytest.mark.parametrize(
    ("written", "problem", "is_error"),
    [
        ("Notify()", "nobody will be notified: the environment variable ROBOT_RUNNER_NOTIFY names no address", False),
        (
            'Notify(url_from="/nowhere/at_all")',
            "nobody will be notified: the file /nowhere/at_all names no address",
            False,
        ),
        (f'Notify(url_from="ntfy://{SECRET}")', "url_from is an address itself", True),
        ('Notify(url_from="a variable")', "'a variable' names no environment variable", True),
        ('Notify(on=["ende"])', "on holds 'ende'", True),
        ("Notify(every=0)", "every is 0", True),
        ("Notify(on=3)", "on is 3", True),
        ("Notify(url_from=3)", "url_from is 3", True),
        (f'"ntfy://{SECRET}"', "", True),
    ],
)
def test_what_keeps_anybody_from_being_told_is_found_beforehand(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, written: str, problem: str, is_error: bool
) -> None:
    monkeypatch.delenv("ROBOT_RUNNER_NOTIFY", raising=False)
    (finding,) = prepare(written_config(tmp_path, f"notify = {written}")).findings
    assert problem in finding.problem
    assert finding.is_error is is_error
    assert SECRET not in str(finding)


def test_apprise_that_is_missing_is_an_error_that_names_the_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROBOT_RUNNER_NOTIFY", "ntfy://topic")
    monkeypatch.setattr(notify_module.importlib.util, "find_spec", lambda name: None)
    (finding,) = notify_module.check_notify("config", notify_module.Notify())
    assert finding.is_error
    assert "robot-runner[notify]" in finding.fix
