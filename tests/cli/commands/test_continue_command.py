from __future__ import annotations

import os
from typing import TYPE_CHECKING

import pytest

from robot_runner.cli.commands import continue_
from robot_runner.core.execution import experiment_status
from robot_runner.core.execution.experiment_status import ExperimentStatus, read_status
from robot_runner.core.storage.journal import Journal
from robot_runner.core.storage.lock import ExperimentLock, Holder

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

pytestmark = pytest.mark.filterwarnings("ignore:.*multi-threaded:DeprecationWarning")


@pytest.fixture
def folder(robot_runner: Callable, write_config: Callable[..., Path], tmp_path: Path) -> Path:
    write_config("def populate_run_data(self, context): return {'Energy': 1.5}")
    assert robot_runner("run", "config.py", "--only", "r_1").code == 0
    return tmp_path / "results" / "trial"


def test_an_experiment_that_nobody_executes_is_not_told(robot_runner: Callable, folder: Path) -> None:
    answer = robot_runner("continue", "config.py")
    assert answer.code == 2
    assert "error: results/trial: the experiment is not being executed" in answer.err
    assert "fix: Start it with `robot-runner run` and its config: it resumes." in answer.err
    assert not (folder / ".control").exists()


def test_an_experiment_that_does_not_hear_is_said_not_to_and_hears_nothing_later(
    robot_runner: Callable, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    waiting = ExperimentStatus(
        experiment_name="trial",
        folder=folder,
        holder=Holder(1, "elsewhere", "2026-01-31T12:00:00.000Z"),
        is_waiting_for_user=True,
        run_count=4,
        done=1,
        failed=0,
        todo=3,
        current_run=None,
        current_event=None,
        failures=(),
        findings=(),
        started_at=None,
        finished_at=None,
    )
    monkeypatch.setattr(continue_, "read_status", lambda _: waiting)
    monkeypatch.setattr(experiment_status, "_PATIENCE", 0.0)
    answer = robot_runner("continue", "config.py")
    assert answer.code == 2
    assert "the experiment has not taken the request within 0 s; it was taken back" in answer.err
    assert not (folder / ".control").exists()


def test_what_an_execution_that_was_killed_had_asked_is_not_answered_while_the_next_one_is_starting(
    robot_runner: Callable, folder: Path
) -> None:
    """It was said that the experiment goes on, which then asked again."""
    asked = {"next_run": "r_2", "step": "swap", "questions": []}
    with Journal(folder / "journal.jsonl") as journal:
        journal.append("experiment_started", pid=os.getpid() + 1)
        journal.append("waiting", **asked)
    with ExperimentLock(folder / ".lock"):
        answer = robot_runner("continue", "config.py")
        assert answer.code == 2
        assert "the experiment does not wait" in answer.err
        assert not read_status(folder).is_waiting_for_user
        with Journal(folder / "journal.jsonl") as journal:
            journal.append("experiment_started", pid=os.getpid())
            journal.append("waiting", **asked)
        assert read_status(folder).waiting_for is not None
