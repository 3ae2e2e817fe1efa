from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from robot_runner.cli.commands import continue_
from robot_runner.core.execution import experiment_status
from robot_runner.core.execution.experiment_status import ExperimentStatus
from robot_runner.core.storage.lock import Holder

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
