"""Checks of the gates, guards and profilers of a config: conditions that can never hold, or are about another robot."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

from robot_runner.conditions.bounds import Bound, Measured
from robot_runner.conditions.combining import leaves
from robot_runner.conditions.person import Confirmed
from robot_runner.core.config.parameters import Parameters
from robot_runner.core.errors import Finding
from robot_runner.core.events.condition import Condition
from robot_runner.core.links.connect import is_simulated
from robot_runner.core.links.declared_host import LOCAL
from robot_runner.core.plugin import Plugin, Profiler, System, with_parts
from robot_runner.core.words import listed


def check_conditions(where: str, parameters: Parameters, plugins: Sequence[Plugin]) -> Iterator[Finding]:
    """Yield findings on gates and guards that cannot work, and on profilers of simulated robots that do not exist.

    Args:
        where: the config's file and class.
        parameters: of the experiment.
        plugins: all of the experiment.
    """
    gates = {f"{where}.gates[{number}]": gate.condition for number, gate in enumerate(parameters.gates)}
    guards = {f"{where}.guards[{number}]": guard.condition for number, guard in enumerate(parameters.guards)}
    for place, condition in {**gates, **guards}.items():
        for finding in condition.check(parameters.robot):
            yield replace(finding, where=f"{place}, {finding.where}")
    for place, condition in gates.items():
        yield from _without_run(place, condition)
    if parameters.cluster is not None:
        yield from _of_this_machine(gates)
    if is_simulated(parameters.robot):
        yield from _of_robots_apart({**gates, **guards}, plugins)


def _without_run(place: str, condition: Condition) -> Iterator[Finding]:
    """Yield an error for each part of a gate that can hold only during a run."""
    for leaf in leaves(condition):
        if isinstance(leaf, Confirmed):
            problem = f"before a run, a person is asked by a step and not by a gate: {leaf}"
            yield Finding.error(place, problem, f"Write operator_steps = [OperatorStep({leaf.what!r})].")
        if isinstance(leaf, Bound) and isinstance(leaf.quantity, Measured):
            problem = f"before a run nothing is published, so that never is true: {leaf}"
            yield Finding.error(place, problem, "Await it in the mission, with wait(context, timeout_s=...).")


def _of_this_machine(gates: Mapping[str, Condition]) -> Iterator[Finding]:
    """Yield a warning for each part of a gate that is about this machine, while workers execute the runs."""
    for place, subject in _parts(gates):
        if getattr(getattr(subject, "computer", subject), "host", None) == LOCAL:
            problem = "a gate is awaited on this machine, and the workers of a cluster execute the runs"
            fix = "Name the computer that is meant (host=...), or await it in start_run: wait(context, timeout_s=...)."
            yield Finding.warning(place, problem, fix)


def _of_robots_apart(conditions: Mapping[str, Condition], plugins: Sequence[Plugin]) -> Iterator[Finding]:
    """Yield a warning for conditions and profilers of a simulated robot (one for each namespace) without a system."""
    systems = [each for each in with_parts(plugins) if isinstance(each, System)]
    named = {each.namespace for each in systems if hasattr(each, "namespace")}
    if not named or not all(isinstance(each, str) for each in named):  # bound to a factor: any of its treatments
        return
    here = sorted({_as_named(str(each)) for each in named})
    for place, subject in (*_parts(conditions), *_profilers(plugins)):
        namespace = getattr(subject, "namespace", None)
        if isinstance(namespace, str) and _as_named(namespace) not in here:
            problem = f"this is about another simulated robot, which no system commands: they command {listed(here)}"
            yield Finding.warning(place, problem, f"Say which one is meant, as in namespace={here[-1]!r}.")


def _parts(conditions: Mapping[str, Condition]) -> Iterator[tuple[str, object]]:
    for place, condition in conditions.items():
        for leaf in leaves(condition):
            yield f"{place}, condition {str(leaf)!r}", leaf.quantity if isinstance(leaf, Bound) else leaf


def _profilers(plugins: Iterable[Plugin]) -> Iterator[tuple[str, object]]:
    """Yield each profiler that measures at a robot, and not at a named computer."""
    for plugin in plugins:
        if isinstance(plugin, Profiler) and getattr(plugin, "host", None) is None:
            held = (plugin, *vars(plugin).values())  # the host may be an attribute of an attribute
            yield from ((f"plugin {plugin.name}", each) for each in held if hasattr(each, "namespace"))


def _as_named(namespace: str) -> str:
    return f"/{namespace.strip('/')}"
