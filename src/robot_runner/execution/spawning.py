"""A run in a fresh interpreter: what it is told, and what it does with it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robot_runner.dialects.preparation import prepare_or_refuse
from robot_runner.execution.child import execute_in_child, settle_child
from robot_runner.execution.task import RunTask
from robot_runner.storage.run_folders import open_log

if TYPE_CHECKING:
    from collections.abc import Mapping

    from robot_runner.config.experiment import Experiment

__all__ = ["WORKER", "describe_task", "execute_described"]

#: The module that a fresh interpreter is started with.
WORKER = "robot_runner.execution.worker"


def describe_task(experiment: Experiment, task: RunTask, records: int, guardian: int) -> str:
    """Return everything that a fresh interpreter needs to execute the run, as JSON."""
    return json.dumps(
        {
            "config": str(experiment.config_path),
            "set": dict(experiment.overrides),
            "records": records,
            "guardian": guardian,
            "task": {
                "run_id": task.run_id,
                "run_number": task.run_number,
                "run_count": task.run_count,
                "attempt": task.attempt,
                "repetition": task.repetition,
                "experiment_seed": task.experiment_seed,
            },
            "combination": _described(experiment, task.combination),
        }
    )


def execute_described(description: str) -> None:
    """Load the config again, find the treatments again, and execute the run."""
    described = json.loads(description)
    experiment = prepare_or_refuse(Path(described["config"]), described["set"])
    combination = _combination(experiment, described["combination"])
    task = RunTask(combination=combination, **described["task"])
    gate = settle_child(open_log(experiment.folder), described["guardian"])
    execute_in_child(experiment, task, described["records"], gate)


def _described(experiment: Experiment, combination: Mapping[str, Any]) -> dict[str, Any]:
    # A treatment goes by its place in its factor, as it may be an object; a value of a hand-written table is plain.
    factors = {factor.name: factor for factor in experiment.model.factors}
    described = {}
    for name, value in combination.items():
        place = factors[name].position_of(value) if name in factors else None
        described[name] = {"value": value} if place is None else {"place": place}
    return described


def _combination(experiment: Experiment, described: Mapping[str, Any]) -> dict[str, Any]:
    factors = {factor.name: factor for factor in experiment.model.factors}
    return {
        name: factors[name].treatments[each["place"]] if "place" in each else each["value"]
        for name, each in described.items()
    }
