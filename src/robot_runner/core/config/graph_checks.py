"""Checking before any run that the robot's graph has the names that plugins need, with each treatment."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from robot_runner.core.config.parameters import Parameters
from robot_runner.core.config.plugin_checks import failed_check, with_each_treatment
from robot_runner.core.design.run_table_model import RunTableModel
from robot_runner.core.errors import Finding, LinkError
from robot_runner.core.events.manager import EventManager, OwnerKind, RobotRunnerEvents
from robot_runner.core.links.connect import begin_graph_look, link_findings
from robot_runner.core.links.graph_names import GraphNeed, namespace_prefix
from robot_runner.core.plugin import Circumstances, Plugin
from robot_runner.core.words import enumerated

#: The events in which a config may start a robot's nodes before its run needs them.
_BEFORE = (RobotRunnerEvents.BEFORE_EXPERIMENT, RobotRunnerEvents.BEFORE_RUN, RobotRunnerEvents.START_RUN)


class GraphCheck:
    """Looks at the graphs of an experiment's robots, all at the same time; nothing is moved or started."""

    def __init__(
        self, parameters: Parameters, plugins: Sequence[Plugin], model: RunTableModel | None, events: EventManager
    ) -> None:
        self._starters = list(_starters(parameters, plugins, events))
        self._looks = {}
        self._places = {"robot", *(f"plugin {plugin.name}" for plugin in plugins)}
        self._failed: list[Finding] = []
        for robot in dict.fromkeys(parameters.links):
            if any(finding.is_error for finding in link_findings(robot)):
                continue  # which is found already
            needs = _needs(plugins, model, robot, self._failed)
            if not needs and any(plugin.starts_nodes for plugin in plugins):
                continue  # a graph whose nodes the run itself starts
            try:
                self._looks[robot] = begin_graph_look(robot, needs)
            except LinkError as error:
                self._failed.append(error.as_finding())

    def findings(self, robot: str | None) -> Iterator[Finding]:
        """Yield a finding for each name missing on a robot's graph: a warning where the experiment may start it itself.

        A mistake in a plugin, such as a field of its goal, remains an error.
        """
        look = self._looks.get(robot or "")
        found = [*self._failed, *(look() if look is not None else ())]
        for finding in found:
            if finding.is_error and self._starters and finding.where in self._places:
                problem = f"{finding.problem}, unless {enumerated(self._starters)} will start it"
                yield Finding.warning(finding.where, problem, finding.fix)
            else:
                yield finding


def _starters(parameters: Parameters, plugins: Sequence[Plugin], events: EventManager) -> Iterator[str]:
    """Yield in words the parts of an experiment that may start a robot, or wait for it, before a run needs it."""
    yield from (f"plugin {plugin.name}" for plugin in plugins if plugin.starts_nodes)
    heard = [each for each in events.subscribers(*_BEFORE) if each.kind is OwnerKind.CONFIG]
    yield from dict.fromkeys(f"{each.event.callback_name} of the config" for each in heard)
    if parameters.gates:
        yield "the program that a gate waits for"
    if parameters.operator_steps:
        yield "the operator"


def _needs(
    plugins: Sequence[Plugin], model: RunTableModel | None, robot: str, failed: list[Finding]
) -> dict[str, list[GraphNeed]]:
    """Return the needed names of each plugin, below its own namespace, with any of its treatments."""
    needs: dict[str, list[GraphNeed]] = {}
    factors = {factor.name: factor.treatments for factor in model.factors} if model else {}
    for plugin in plugins:
        where = f"plugin {plugin.name}"
        wanted: dict[GraphNeed, None] = {}
        built = plugin
        try:
            for built in with_each_treatment(plugin, model):
                prefix = namespace_prefix(getattr(built, "namespace", "") or "")
                for need in built.required_graph(Circumstances(robot, factors, tuple(plugins))):
                    name = need.name if need.name.startswith("/") or not prefix else f"{prefix[1:]}/{need.name}"
                    wanted[replace(need, name=name)] = None
        except (Exception, SystemExit) as error:  # noqa: BLE001 - a stranger's code; what it raises is a finding like others
            failed.append(failed_check(where, error, "required_graph", built))
        if wanted:
            needs[where] = list(wanted)
    return needs
