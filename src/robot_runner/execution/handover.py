"""A task on its way to the process of its run, as text."""

from __future__ import annotations

import marshal
from dataclasses import fields
from typing import TYPE_CHECKING, Any

from robot_runner.execution.task import RunTask

if TYPE_CHECKING:
    from collections.abc import Mapping

    from robot_runner.config.experiment import Experiment

__all__ = ["hand_over", "take_over"]

_PLAIN = tuple(each.name for each in fields(RunTask) if each.name != "combination")


def hand_over(experiment: Experiment, task: RunTask) -> bytes:
    """Return everything of a task that a process of the same interpreter that knows the experiment does not know."""
    plain = {name: getattr(task, name) for name in _PLAIN}
    # marshal rather than JSON: it is C from end to end, and the run is waiting.
    return marshal.dumps((plain, _described(experiment, task.combination)))


def take_over(experiment: Experiment, handed_over: bytes) -> RunTask | None:
    """Return the task that was handed over; None where there was none."""
    if not handed_over:
        return None
    plain, described = marshal.loads(handed_over)  # noqa: S302 - from our own process, through a pipe of our own
    return RunTask(combination=_combination(experiment, described), **plain)


def _described(experiment: Experiment, combination: Mapping[str, Any]) -> dict[str, Any]:
    # A treatment goes by its place in its factor, as it may be an object; a value of a hand-written table is plain.
    factors = {factor.name: factor for factor in experiment.model.factors}
    described: dict[str, Any] = {}
    for name, value in combination.items():
        place = factors[name].position_of(value) if name in factors else None
        described[name] = (place, value if place is None else None)
    return described


def _combination(experiment: Experiment, described: Mapping[str, Any]) -> dict[str, Any]:
    combination = {name: value for name, (_, value) in described.items()}
    for factor in experiment.model.factors:
        place, _ = described.get(factor.name, (None, None))
        if place is not None:
            combination[factor.name] = factor.treatments[place]
    return combination
