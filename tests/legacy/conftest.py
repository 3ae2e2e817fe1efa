"""What tests of the dialects share: configs are written to a folder of the test's own, and executed."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

import pytest
from tests.legacy.earlier_configs import EVENTS, ROBOT_TABLE, RUNNER, RUNNER_TABLE, Executed

from robot_runner.core.config.preparation import prepare
from robot_runner.core.errors import ConfigError
from robot_runner.core.execution.notices import SilentObserver
from robot_runner.core.execution.orchestrator import execute_experiment

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from robot_runner.core.execution.resumption import Resumption


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    """Return what writes a config file as it stands."""

    def written(text: str, name: str = "config.py") -> Path:
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(textwrap.dedent(text), encoding="utf-8")
        return path

    return written


@pytest.fixture
def config(write: Callable[..., Path]) -> Callable[..., Path]:
    """Return what writes a config with these methods, each of which it subscribes."""

    def written(
        methods: str = "", *, head: str = RUNNER, table: str | None = None, subscribe: str = "", name: str = "config.py"
    ) -> Path:
        is_runner = "RunnerEvents" in head.replace("RobotRunnerEvents", "")
        events = "RunnerEvents" if is_runner else "RobotRunnerEvents"
        body = textwrap.indent(textwrap.dedent(methods).strip(), "    ")
        names = [event for event in EVENTS if f"def {event}(" in body]
        pairs = [f"({events}.{event.upper()}, self.{event})," for event in names]
        init = ["    def __init__(self):", "        EventSubscriptionController.subscribe_to_multiple_events(["]
        init += [f"            {pair}" for pair in (*pairs, subscribe) if pair] + ["        ])"]
        default_table = RUNNER_TABLE if is_runner else ROBOT_TABLE
        parts = [head, "\n".join(init), body, default_table if table is None else textwrap.indent(table, "")]
        return write("\n".join(part for part in parts if part.strip()) + "\n", name)

    return written


@pytest.fixture
def execute() -> Callable[..., Executed]:
    """Return what executes a config."""

    def executed(path: Path, resumption: Resumption | None = None, **settings: str) -> Executed:
        preparation = prepare(path, settings)
        if preparation.experiment is None:
            raise ConfigError.of_findings(preparation.findings)
        finished = execute_experiment(
            preparation.experiment, SilentObserver(), findings=preparation.findings, resumption=resumption
        )
        return Executed(preparation.experiment, finished)

    return executed
