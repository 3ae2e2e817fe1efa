"""The base of systems that change settings of nodes for a run, and restore the former values afterwards."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any, ClassVar

from robot_runner.core.errors import Finding, LinkError
from robot_runner.core.events.context import RobotRunnerContext
from robot_runner.core.links.connect import connect_robot, is_simulated
from robot_runner.core.links.robot import Encoding, RobotLink
from robot_runner.core.plugin import Circumstances, Plugin, System
from robot_runner.core.words import enumerated
from robot_runner.measuring.parameter_checks import check_numbers, no_robot
from robot_runner.ros.kept_settings import KeptSettings, Settings, left_settings
from robot_runner.ros.link_faults import as_link_error
from robot_runner.ros.node_services import NodeNotReadyError, full_node
from robot_runner.ros.parameter_access import all_at_once
from robot_runner.ros.parameter_values import ParameterValue, kind_of, same_value, to_json
from robot_runner.ros.robot_system import OfTheRobot

_log = logging.getLogger(__name__)

#: How often a missing node is looked for, s.
_LOOK = 0.1
#: The plugin that restores each kind of settings, by name: an experiment without it does not import it.
PUT_BACK_BY = MappingProxyType({"parameters": "RosParameters", "states": "Lifecycle"})
_BY_HAND = "Set it by hand, or restart the node."
_RESTART = "Restart the node where that matters: ROS 2 takes a value away with its parameter alone."


class RestoredSettings(OfTheRobot, System):
    """Sets values of nodes before the mission, checks that the nodes have them, and restores the former values.

    The former values are first written to a file (`kept_settings`). The run restores them at its end, also when it
    failed. If the run was killed, its standby process does so; if that was killed as well, the next run with a plugin
    of this class on this robot.

    `settings` are the values to be set, by node and by name; `kind` is that of the settings, in the plural, and names
    the file of raw data. A node may take `patience` (s) to appear before a run starts, and `timeout` (s) for each
    answer.
    """

    kind: ClassVar[str]

    def __init__(
        self, settings: Settings, *, name: str | None, namespace: str, patience: float, timeout: float
    ) -> None:
        super().__init__(name=name)
        check_numbers(self.name, may_be_zero=True, patience=patience, timeout=timeout)
        self.settings = settings
        self.namespace = namespace
        self.patience = patience
        self.timeout = timeout
        self._kept: KeptSettings | None = None
        self._is_set = False
        self._facts: dict[str, dict[str, dict[str, Any]]] = {}

    def read(self, link: RobotLink, node: str, names: Sequence[str]) -> Mapping[str, ParameterValue]:
        """Return the values of a node; raise a `LinkError` where it does not answer."""
        raise NotImplementedError

    def write(self, link: RobotLink, node: str, values: Mapping[str, ParameterValue]) -> None:
        """Set values of a node; raise a `LinkError` where it does not accept them."""
        raise NotImplementedError

    def known(self, link: RobotLink, node: str, names: Sequence[str]) -> Sequence[str]:
        """Return which of these settings the node still has; all, if not overridden."""
        del link, node
        return names

    def doubts(self, link: RobotLink, settings: Settings) -> Iterable[tuple[str, str]]:
        """Yield reasons why the settings may have no effect, each with a fix; none, if not overridden."""
        del link, settings
        return ()

    def check(self, circumstances: Circumstances) -> Iterable[Finding]:
        """Yield findings: there is no robot, or killed runs have left its settings changed."""
        where = f"plugin {self.name}"
        if circumstances.robot is None:
            yield no_robot(self.name, f"sets {self.kind} of a robot's nodes")
            return
        for kept in left_settings(self.kind, circumstances.robot):
            yield Finding.warning(where, _left(kept), "They are put back before the first run.")

    def start_run(self, context: RobotRunnerContext) -> None:
        """Set the values of the run, and check that the nodes have them.

        Raises:
            LinkError: a node is not there, does not accept a value, or has another one afterwards.
        """
        self._kept, self._is_set, self._facts = None, False, {}
        link = connect_robot(context, namespace=self.namespace)
        self._put_back_left(context, link)
        wanted = {full_node(link, node): dict(values) for node, values in self.settings.items()}
        for problem, fix in self.doubts(link, wanted):
            context.warn(problem, fix=fix)
        before = self._awaited(context, link, wanted)
        self._kept = KeptSettings.of_this_process(self.kind, str(context.robot), self.name, before, wanted)
        if not is_simulated(context.robot):  # a simulated robot ends with its run
            self._kept.write()
        self._note(context, "before", before)
        for node, values in wanted.items():
            self.write(link, node, values)
        found = self._read_all(link, wanted)
        self._note(context, "set", wanted)
        self._note(context, "during", found)
        all_at_once([_not_taken(*each) for each in _differences(wanted, found)], where=self.name)
        self._is_set = True

    def stop_run(self, context: RobotRunnerContext) -> None:
        """Restore the values from before the run; warn of those that something else has changed during it.

        Raises:
            LinkError: a node does not answer, or does not accept a value.
        """
        kept = self._kept
        if kept is None:
            return
        link = connect_robot(context, namespace=self.namespace)
        for problem, fix in self._restore(link, kept, context):
            context.warn(problem, fix=fix)
        self._kept = None
        kept.remove()

    def make_safe(self, context: RobotRunnerContext) -> None:
        """Restore settings that a run could not restore, as it was killed or failed; what fails stays in its file.

        It is warned of.
        """
        kept = [*([self._kept] if self._kept is not None else []), *left_settings(self.kind, context.robot)]
        self._kept = None
        for each in kept:
            try:
                for problem, fix in self._restore(connect_robot(context, namespace=self.namespace), each, None):
                    context.warn(problem, fix=fix)
                each.remove()
            except Exception as error:  # noqa: BLE001 - of whichever kind: what else was left is put back
                each.give_up()
                problem = f"{self.kind} of {enumerated(each.before)} are not put back: {error}"
                context.warn(problem, fix=f"The next run with {self.name} on this robot does it, or do it by hand.")

    def _put_back_left(self, context: RobotRunnerContext, link: RobotLink) -> None:
        for kept in left_settings(self.kind, context.robot):
            try:
                problems = list(self._restore(link, kept, None))
            except LinkError as error:
                problem, fix = f"{_left(kept)}: {error}", f"Put it back by hand, and remove {kept.path}."
                raise LinkError(problem, where=self.name, fix=fix) from error
            kept.remove()
            context.warn(f"{_left(kept)}; that was done before this run", fix="Check how that run ended.")
            for problem, fix in problems:
                context.warn(problem, fix=fix)

    def _restore(
        self, link: RobotLink, kept: KeptSettings, context: RobotRunnerContext | None
    ) -> Iterator[tuple[str, str]]:
        """Restore the former values, node by node, the last one first; yield what is not restored, with a fix.

        Where the run's own `context` is given, all values are restored. Those of a dead run are restored only where
        they are still as that run set them: another program may have changed them since, or restarted the node.
        """
        errors: list[LinkError] = []
        for node, before in reversed(list(kept.before.items())):
            try:
                yield from self._restore_node(link, kept, node, before, context)
            except NodeNotReadyError:
                yield f"{node} is gone, so that its {self.kind} are not put back", "Nothing, if it was to end."
            except Exception as error:  # noqa: BLE001 - any failure: it is reported, and the other nodes are restored
                _log.warning("%s of %s are not put back", self.kind, node, exc_info=error)
                errors.append(as_link_error(error, where=node))
        all_at_once(errors, where=self.name)

    def _restore_node(
        self,
        link: RobotLink,
        kept: KeptSettings,
        node: str,
        before: Mapping[str, ParameterValue],
        context: RobotRunnerContext | None,
    ) -> Iterator[tuple[str, str]]:
        wanted, there = kept.wanted[node], self.known(link, node, list(before))
        now = self.read(link, node, there) if there else {}
        gone = [name for name in before if name not in there]
        odd = [name for name in there if not any(same_value(now[name], each[name]) for each in (before, wanted))]
        if context is not None:
            self._note(context, "after", {node: now})
            self._doubt_changed(context, node, wanted, now)
            left = []
        else:
            for name in odd:
                problem = f"{name} of {node} is {now[name]!r} and not {wanted[name]!r}, as a run set it that died"
                yield f"{problem}: it is left so", _BY_HAND
            left = odd
        for name in gone if context is None or not self._is_set else ():
            yield f"{name} of {node} is not there any more, so that it is not put back", "Nothing, if it was to go."
        names = [each for each in reversed(there) if each not in left and not _is_unchanged(now[each], before[each])]
        # A node of ROS 2 would undeclare the parameter.
        kept_on = [name for name in names if before[name] is None and link.encoding is Encoding.CDR]
        for name in kept_on:
            yield f"{name} of {node} had no value before the run, and keeps {now[name]!r}", _RESTART
        if back := {name: before[name] for name in names if name not in kept_on}:
            self.write(link, node, back)
            found = self.read(link, node, list(back))
            if context is not None:
                self._note(context, "restored", {node: found})
            for _, name, was, found_value in _differences({node: back}, {node: found}):
                yield f"{name} of {node} was {was!r} before the run, and is {found_value!r} now", _BY_HAND

    def _doubt_changed(
        self,
        context: RobotRunnerContext,
        node: str,
        wanted: Mapping[str, ParameterValue],
        now: Mapping[str, ParameterValue],
    ) -> None:
        """Doubt the run where its settings were not in force to the end."""
        for name, value in wanted.items() if self._is_set else ():
            found = f"is {now[name]!r}" if name in now else "is not there"
            if name not in now or not same_value(now[name], value):
                problem = f"{name} of {node} was set to {value!r}, and {found} after the mission"
                context.broker.doubt_run(context.owner, problem, "Find out what else sets it.")

    def _awaited(self, context: RobotRunnerContext, link: RobotLink, wanted: Settings) -> Settings:
        deadline = context.clock.now() + self.patience
        while True:
            try:
                return self._read_all(link, wanted)
            except NodeNotReadyError:
                if context.clock.now() >= deadline:
                    raise
                context.clock.sleep(_LOOK)

    def _read_all(self, link: RobotLink, wanted: Settings) -> Settings:
        found, errors = {}, []
        for node, values in wanted.items():
            try:
                found[node] = self.read(link, node, list(values))
            except NodeNotReadyError:
                raise
            except LinkError as error:
                errors.append(error)
        all_at_once(errors, where=self.name)
        return found

    def _note(self, context: RobotRunnerContext, when: str, settings: Settings) -> None:
        for node, values in settings.items():
            for name, value in values.items():
                self._facts.setdefault(node, {}).setdefault(name, {})[when] = to_json(value)
        text = json.dumps(self._facts, indent=1, ensure_ascii=False)
        (context.raw_data_folder / f"{self.kind}.json").write_text(text, encoding="utf-8")


def left_findings(where: str, robot: str, plugins: Sequence[Plugin]) -> Iterator[Finding]:
    """Yield a finding where nodes of this robot still have the settings of a killed run.

    An experiment with a plugin of the kind restores them itself, and has its own finding.
    """
    cared_for = {plugin.kind for plugin in plugins if isinstance(plugin, RestoredSettings)}
    for kind in PUT_BACK_BY.keys() - cared_for:
        for kept in left_settings(kind, robot):
            plugin = PUT_BACK_BY[kind]
            fix = f"Restart the nodes, or execute an experiment with {plugin} on this robot: it puts them back."
            yield Finding.warning(where, _left(kept), fix)


def _left(kept: KeptSettings) -> str:
    what, who = f"{kept.kind} of {enumerated(kept.before)}", f"{kept.plugin} set them in process {kept.owner[0]}"
    return f"{what} are still as {who}, which did not put them back"


def _is_unchanged(now: ParameterValue, before: ParameterValue) -> bool:
    return same_value(now, before) and kind_of(now) is kind_of(before)


def _differences(wanted: Settings, found: Settings) -> Iterator[tuple[str, str, ParameterValue, ParameterValue]]:
    """Yield node, name, wanted and found value of each setting that differs."""
    for node, values in wanted.items():
        for name, value in values.items():
            if not same_value(value, found[node][name]):
                yield node, name, value, found[node][name]


def _not_taken(node: str, name: str, wanted: ParameterValue, found: ParameterValue) -> LinkError:
    problem = f"{wanted!r} was set, and the node has {found!r}"
    fix = "Set a value that it keeps: a run with another one would not be what its row says."
    return LinkError(problem, where=f"{node}: {name}", fix=fix)
