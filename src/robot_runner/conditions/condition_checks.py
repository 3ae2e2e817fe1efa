"""What validation finds of the gates and guards of a config: conditions that can never hold, where that is known."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from robot_runner.conditions.bounds import Bound, Measured
from robot_runner.conditions.combining import leaves
from robot_runner.conditions.person import Confirmed
from robot_runner.core.errors import Finding

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from robot_runner.core.config.parameters import Parameters
    from robot_runner.core.events.condition import Condition
    from robot_runner.core.plugin import Plugin


def check_conditions(where: str, parameters: Parameters, plugins: Sequence[Plugin]) -> Iterator[Finding]:
    """Yield what keeps the gates and guards of a config from what they are for.

    Args:
        where: the config's file and class.
        parameters: of the experiment.
        plugins: all of the experiment.
    """
    del plugins
    gates = {f"{where}.gates[{number}]": gate.condition for number, gate in enumerate(parameters.gates)}
    guards = {f"{where}.guards[{number}]": guard.condition for number, guard in enumerate(parameters.guards)}
    for place, condition in {**gates, **guards}.items():
        for finding in condition.check(parameters.robot):
            yield replace(finding, where=f"{place}, {finding.where}")
    for place, condition in gates.items():
        yield from _without_run(place, condition)


def _without_run(place: str, condition: Condition) -> Iterator[Finding]:
    """Yield an error for each part of a gate that waits for what only a run can tell."""
    for leaf in leaves(condition):
        if isinstance(leaf, Confirmed):
            problem = f"before a run, a person is asked by a step and not by a gate: {leaf}"
            yield Finding.error(place, problem, f"Write operator_steps = [OperatorStep({leaf.what!r})].")
        if isinstance(leaf, Bound) and isinstance(leaf.quantity, Measured):
            problem = f"before a run nothing is published, so that never is true: {leaf}"
            yield Finding.error(place, problem, "Await it in the mission, with wait(context, timeout_s=...).")
