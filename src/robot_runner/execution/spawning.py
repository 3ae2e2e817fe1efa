"""A run in a fresh interpreter: what it is started with, and what it does with it."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from robot_runner.dialects.preparation import prepare_or_refuse
from robot_runner.execution.child import await_task, execute_in_child, settle_streams
from robot_runner.execution.handover import take_over

if TYPE_CHECKING:
    from robot_runner.config.experiment import Experiment

__all__ = ["execute_spawned", "spawn_arguments"]

_WORKER = "robot_runner.execution.worker"


def spawn_arguments(experiment: Experiment, tasks: int, records: int) -> list[str]:
    """Return the command line of the fresh interpreter: it loads the config again, and inherits two descriptors."""
    described = {
        "config": str(experiment.config_path),
        "set": dict(experiment.overrides),
        "tasks": tasks,
        "records": records,
    }
    return [sys.executable, "-m", _WORKER, json.dumps(described)]


def execute_spawned(description: str) -> None:
    """Load the config again, find the treatments again, and execute the run."""
    described = json.loads(description)
    settle_streams()
    experiment = prepare_or_refuse(Path(described["config"]), described["set"])
    execute_in_child(experiment, lambda: take_over(experiment, await_task(described["tasks"])), described["records"])
