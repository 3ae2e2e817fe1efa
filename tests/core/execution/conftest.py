from __future__ import annotations

import csv
from functools import partial
from typing import TYPE_CHECKING, Any

import pytest
from tests.conftest import written_config

from robot_runner.core.config.preparation import prepare_or_refuse
from robot_runner.core.execution.notices import ExperimentFinished, Notice, SilentObserver
from robot_runner.core.execution.orchestrator import execute_experiment
from robot_runner.core.storage.journal import read_journal

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


class RecordingObserver(SilentObserver):
    def __init__(self) -> None:
        self.notices: list[Notice] = []

    def notice(self, notice: Notice) -> None:
        self.notices.append(notice)


class Executed:
    """An experiment that was executed, and what it left on disk."""

    def __init__(self, config: Path, finished: ExperimentFinished, notices: list[Notice]) -> None:
        self.finished = finished
        self.notices = notices
        self.folder = finished.folder
        self.config = config

    @property
    def table(self) -> list[dict[str, str]]:
        with (self.folder / "run_table.csv").open(encoding="utf-8", newline="") as file:
            return list(csv.DictReader(file))

    def journal(self, *kinds: str) -> list[dict[str, Any]]:
        return list(read_journal(self.folder / "journal.jsonl", kinds=kinds or None))

    def log(self, run_id: str) -> str:
        return (self.folder / "runs" / run_id / "log.txt").read_text(encoding="utf-8")


def execute_in(folder: Path, body: str = "", **settings: Any) -> Executed:
    """Write a config into a folder and execute it."""
    overrides = {name: str(settings.pop(name)) for name in list(settings) if name not in {"table", "head", "name"}}
    config = written_config(folder, body, **settings)
    observer = RecordingObserver()
    finished = execute_experiment(prepare_or_refuse(config, overrides), observer)
    return Executed(config, finished, observer.notices)


@pytest.fixture
def execute(tmp_path: Path) -> Callable[..., Executed]:
    """Return what writes a config into the test's own folder and executes it."""
    return partial(execute_in, tmp_path)
